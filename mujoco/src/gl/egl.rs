//! EGL, opened at run time.

use std::ffi::{CStr, c_void};
use std::mem;
use std::ptr;

use khronos_egl as egl;
use libloading::os::unix::{Library, RTLD_GLOBAL, RTLD_LOCAL, RTLD_NOW};

use super::{Context, RTLD_NODELETE};

type Egl = egl::DynamicInstance<egl::EGL1_5>;

/// `EGL_PLATFORM_SURFACELESS_MESA` of the extension EGL_MESA_platform_surfaceless.
const PLATFORM_SURFACELESS_MESA: egl::Enum = 0x31DD;
/// `EGL_PLATFORM_DEVICE_EXT` of the extension EGL_EXT_platform_device.
const PLATFORM_DEVICE_EXT: egl::Enum = 0x313F;

const CONFIG: [egl::Int; 13] = [
    egl::RENDERABLE_TYPE,
    egl::OPENGL_BIT,
    egl::SURFACE_TYPE,
    egl::PBUFFER_BIT,
    egl::RED_SIZE,
    8,
    egl::GREEN_SIZE,
    8,
    egl::BLUE_SIZE,
    8,
    egl::DEPTH_SIZE,
    24,
    egl::NONE,
];

/// Which display is asked for.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum Platform {
    Surfaceless,
    Device,
}

/// An EGL context, with a one-pixel buffer where the platform needs a surface.
///
/// MuJoCo draws into a framebuffer object of its own, so the surface is never drawn on.
pub(crate) struct EglContext {
    egl: Egl,
    library: String,
    display: egl::Display,
    surface: Option<egl::Surface>,
    context: egl::Context,
}

impl EglContext {
    pub(crate) fn new(library: &str, platform: Platform) -> Result<Self, String> {
        let egl = open(library)?;
        let display = connect(&egl, platform)?;
        egl.bind_api(egl::OPENGL_API)
            .map_err(explain("OpenGL is not offered"))?;
        let config = egl.choose_first_config(display, &CONFIG);
        let config = config.map_err(explain("configurations cannot be read"))?;
        let config = config.ok_or("no configuration has OpenGL, 8-bit colours and 24-bit depth")?;
        let context = egl.create_context(display, config, None, &[egl::NONE]);
        let context = context.map_err(explain("no context"))?;
        let mut made = Self {
            egl,
            library: library.into(),
            display,
            surface: None,
            context,
        };
        if platform == Platform::Device {
            made.add_surface(config)?;
        }
        made.make_current()?;
        Ok(made)
    }

    fn add_surface(&mut self, config: egl::Config) -> Result<(), String> {
        let size = [egl::WIDTH, 1, egl::HEIGHT, 1, egl::NONE];
        let surface = self.egl.create_pbuffer_surface(self.display, config, &size);
        self.surface = Some(surface.map_err(explain("no pixel buffer"))?);
        Ok(())
    }

    fn is_current(&self) -> bool {
        self.egl.get_current_context() == Some(self.context)
    }
}

impl Context for EglContext {
    fn make_current(&self) -> Result<(), String> {
        if self.is_current() {
            return Ok(());
        }
        let current =
            self.egl
                .make_current(self.display, self.surface, self.surface, Some(self.context));
        current.map_err(|error| error.to_string())
    }

    fn publish(&self) -> Result<(), String> {
        // SAFETY: the library is loaded already; this only widens the visibility of its symbols.
        let visible =
            unsafe { Library::open(Some(&self.library), RTLD_NOW | RTLD_GLOBAL | RTLD_NODELETE) };
        visible.map(|_| ()).map_err(|error| error.to_string())
    }

    fn function(&self, name: &CStr) -> *const c_void {
        let function = name
            .to_str()
            .ok()
            .and_then(|name| self.egl.get_proc_address(name));
        function.map_or(ptr::null(), |function| function as *const c_void)
    }
}

impl Drop for EglContext {
    fn drop(&mut self) {
        // the display is shared by every context of the process, so it is never terminated;
        // an error here has nobody to go to
        if self.is_current() {
            let _ = self.egl.make_current(self.display, None, None, None);
        }
        if let Some(surface) = self.surface {
            let _ = self.egl.destroy_surface(self.display, surface);
        }
        let _ = self.egl.destroy_context(self.display, self.context);
    }
}

fn open(library: &str) -> Result<Egl, String> {
    // SAFETY: loading EGL runs no initialisers with preconditions. It stays loaded, because Mesa's
    // thread-exit handlers crash once it is gone.
    let opened = unsafe { Library::open(Some(library), RTLD_NOW | RTLD_LOCAL | RTLD_NODELETE) };
    let opened = opened.map_err(|error| error.to_string())?;
    // SAFETY: the library exports EGL's functions with EGL's signatures.
    unsafe { Egl::load_required_from(opened.into()) }
        .map_err(|error| format!("no EGL 1.5: {error}"))
}

fn connect(egl: &Egl, platform: Platform) -> Result<egl::Display, String> {
    let offered = egl.query_string(None, egl::EXTENSIONS);
    let offered = offered
        .map_err(explain("extensions cannot be read"))?
        .to_string_lossy();
    let require = |name: &str| match offered.contains(name) {
        true => Ok(()),
        false => Err(format!("{name} is not offered")),
    };
    if platform == Platform::Surfaceless {
        require("EGL_MESA_platform_surfaceless")?;
        return initialised(egl, PLATFORM_SURFACELESS_MESA, egl::DEFAULT_DISPLAY);
    }
    require("EGL_EXT_platform_device")?;
    require("EGL_EXT_device_enumeration")?;
    let mut last = Err("no device is listed".into());
    for device in devices(egl)? {
        last = initialised(egl, PLATFORM_DEVICE_EXT, device);
        if last.is_ok() {
            break;
        }
    }
    last
}

fn initialised(
    egl: &Egl,
    platform: egl::Enum,
    native: *mut c_void,
) -> Result<egl::Display, String> {
    // SAFETY: `native` is what the platform takes: the default display, or a device that EGL listed.
    let display = unsafe { egl.get_platform_display(platform, native, &[egl::ATTRIB_NONE]) };
    let display = display.map_err(explain("no display"))?;
    egl.initialize(display)
        .map_err(explain("the display cannot be initialised"))?;
    Ok(display)
}

/// Graphics devices, as `eglQueryDevicesEXT` lists them.
fn devices(egl: &Egl) -> Result<Vec<*mut c_void>, String> {
    type QueryDevices =
        unsafe extern "system" fn(egl::Int, *mut *mut c_void, *mut egl::Int) -> egl::Boolean;
    let function = egl
        .get_proc_address("eglQueryDevicesEXT")
        .ok_or("no eglQueryDevicesEXT")?;
    // SAFETY: the extension, which the caller has found on offer, declares this signature.
    let query = unsafe { mem::transmute::<extern "system" fn(), QueryDevices>(function) };
    let mut devices = [ptr::null_mut(); 16];
    let mut count = 0;
    // SAFETY: the array has the length given; EGL writes `count` entries of it.
    let done = unsafe {
        query(
            devices.len() as egl::Int,
            devices.as_mut_ptr(),
            &raw mut count,
        )
    };
    if done == egl::FALSE {
        Err("devices cannot be listed".into())
    } else {
        Ok(devices[..count as usize].to_vec())
    }
}

fn explain(what: &'static str) -> impl Fn(egl::Error) -> String {
    move |error| format!("{what}: {error}")
}
