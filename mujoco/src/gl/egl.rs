//! OpenGL contexts by EGL, which is loaded at run time.

use std::ffi::{CStr, c_void};
use std::mem;
use std::ptr;
use std::rc::Rc;

use khronos_egl as egl;
use libloading::os::unix::{Library, RTLD_LOCAL, RTLD_NOW};

use super::context::{
    Context, PreviousContext, RTLD_NODELETE, forget, is_ours, library_error, remember,
};
use crate::error::OpenGlContextError;

type Egl = egl::DynamicInstance<egl::EGL1_5>;

const PLATFORM_SURFACELESS_MESA: egl::Enum = 0x31DD;
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

/// Kind of EGL display: without a surface, or on a graphics device.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(super) enum Platform {
    Surfaceless,
    Device,
}

/// EGL context, with a one-pixel buffer if the platform needs a surface.
///
/// MuJoCo draws into a framebuffer object of its own, so the surface is never drawn on.
pub(super) struct EglContext {
    egl: Rc<Egl>,
    display: egl::Display,
    surface: Option<egl::Surface>,
    context: egl::Context,
}

impl EglContext {
    /// Creates an EGL context without making it current.
    pub(super) fn new(library: &str, platform: Platform) -> Result<Self, OpenGlContextError> {
        let egl = open(library)?;
        let display = connect(&egl, platform)?;
        let config = egl
            .choose_first_config(display, &CONFIG)
            .map_err(explain("eglChooseConfig"))?
            .ok_or(OpenGlContextError::NoConfiguration)?;
        let mut made = Self {
            context: create_context(&egl, display, config)?,
            egl: Rc::new(egl),
            display,
            surface: None,
        };
        if platform == Platform::Device {
            made.add_surface(config)?;
        }
        Ok(made)
    }

    fn add_surface(&mut self, config: egl::Config) -> Result<(), OpenGlContextError> {
        let size = [egl::WIDTH, 1, egl::HEIGHT, 1, egl::NONE];
        let surface = self.egl.create_pbuffer_surface(self.display, config, &size);
        self.surface = Some(surface.map_err(explain("eglCreatePbufferSurface"))?);
        Ok(())
    }

    fn is_current(&self) -> bool {
        self.egl.get_current_context() == Some(self.context)
    }

    /// Returns a restorer of `context`, the thread's current EGL context.
    fn previous(&self, context: egl::Context) -> PreviousContext {
        let egl = Rc::clone(&self.egl);
        let display = egl.get_current_display().unwrap_or(self.display);
        let draw = egl.get_current_surface(egl::DRAW);
        let read = egl.get_current_surface(egl::READ);
        PreviousContext::new(move || {
            egl.make_current(display, draw, read, Some(context)).map_err(explain("eglMakeCurrent"))
        })
    }
}

impl Context for EglContext {
    fn make_current(&self) -> Result<PreviousContext, OpenGlContextError> {
        let current = self.egl.get_current_context();
        if current == Some(self.context) {
            return Ok(PreviousContext::nothing());
        }
        let foreign = current.filter(|context| !is_ours(context.as_ptr()));
        let previous =
            foreign.map_or_else(PreviousContext::nothing, |context| self.previous(context));
        self.egl
            .make_current(self.display, self.surface, self.surface, Some(self.context))
            .map_err(explain("eglMakeCurrent"))?;
        remember(self.context.as_ptr());
        Ok(previous)
    }

    fn function(&self, name: &CStr) -> *const c_void {
        let function = name.to_str().ok().and_then(|name| self.egl.get_proc_address(name));
        function.map_or(ptr::null(), |function| function as *const c_void)
    }
}

impl Drop for EglContext {
    fn drop(&mut self) {
        // the display is shared by every context of the process, so it is never terminated; errors
        // cannot be reported from `drop`
        forget(self.context.as_ptr());
        if self.is_current() {
            let _ = self.egl.make_current(self.display, None, None, None);
        }
        if let Some(surface) = self.surface {
            let _ = self.egl.destroy_surface(self.display, surface);
        }
        let _ = self.egl.destroy_context(self.display, self.context);
    }
}

fn open(library: &str) -> Result<Egl, OpenGlContextError> {
    // SAFETY: loading EGL runs no initialisers with preconditions. It stays loaded, because Mesa's
    // thread-exit handlers crash once it is gone.
    let opened = unsafe { Library::open(Some(library), RTLD_NOW | RTLD_LOCAL | RTLD_NODELETE) }
        .map_err(library_error(library))?;
    // SAFETY: the library exports EGL's functions with EGL's signatures.
    unsafe { Egl::load_required_from(opened.into()) }.map_err(library_error(library))
}

/// Creates an EGL context of desktop OpenGL; the thread's choice of API is preserved.
fn create_context(
    egl: &Egl,
    display: egl::Display,
    config: egl::Config,
) -> Result<egl::Context, OpenGlContextError> {
    let api = egl.query_api();
    egl.bind_api(egl::OPENGL_API).map_err(explain("eglBindAPI"))?;
    // the error is returned last, so that the API is restored in any case
    let context = egl
        .create_context(display, config, None, &[egl::NONE])
        .map_err(explain("eglCreateContext"));
    egl.bind_api(api).map_err(explain("eglBindAPI"))?;
    context
}

fn connect(egl: &Egl, platform: Platform) -> Result<egl::Display, OpenGlContextError> {
    let offered = egl
        .query_string(None, egl::EXTENSIONS)
        .map_err(explain("eglQueryString"))?
        .to_string_lossy();
    let require = |name: &'static str| {
        if offered.contains(name) {
            Ok(())
        } else {
            Err(OpenGlContextError::MissingEglExtension { name })
        }
    };
    if platform == Platform::Surfaceless {
        require("EGL_MESA_platform_surfaceless")?;
        return initialised(egl, PLATFORM_SURFACELESS_MESA, egl::DEFAULT_DISPLAY);
    }
    require("EGL_EXT_platform_device")?;
    require("EGL_EXT_device_enumeration")?;
    let mut last = Err(OpenGlContextError::NoDevice);
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
) -> Result<egl::Display, OpenGlContextError> {
    // SAFETY: `native` is what the platform takes: the default display, or a device that EGL
    // listed.
    let display = unsafe { egl.get_platform_display(platform, native, &[egl::ATTRIB_NONE]) }
        .map_err(explain("eglGetPlatformDisplay"))?;
    egl.initialize(display).map_err(explain("eglInitialize"))?;
    Ok(display)
}

/// Returns the graphics devices that `eglQueryDevicesEXT` lists.
fn devices(egl: &Egl) -> Result<Vec<*mut c_void>, OpenGlContextError> {
    type QueryDevices =
        unsafe extern "system" fn(egl::Int, *mut *mut c_void, *mut egl::Int) -> egl::Boolean;
    let name = "eglQueryDevicesEXT";
    let function =
        egl.get_proc_address(name).ok_or(OpenGlContextError::MissingEglExtension { name })?;
    // SAFETY: the extension, which the caller has found on offer, declares this signature.
    let query = unsafe { mem::transmute::<extern "system" fn(), QueryDevices>(function) };
    let mut devices = [ptr::null_mut(); 16];
    let mut count = 0;
    // SAFETY: the array has the length given; EGL writes `count` entries of it.
    let done = unsafe { query(devices.len() as egl::Int, devices.as_mut_ptr(), &raw mut count) };
    if done == egl::FALSE {
        return Err(egl.get_error().map_or(OpenGlContextError::NoDevice, explain(name)));
    }
    Ok(devices[..count as usize].to_vec())
}

fn explain(call: &'static str) -> impl Fn(egl::Error) -> OpenGlContextError {
    move |error| OpenGlContextError::EglCallFailed {
        call,
        code: error.native(),
        meaning: error.to_string(),
    }
}
