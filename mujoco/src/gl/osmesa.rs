//! OSMesa, opened at run time.

use std::ffi::{CStr, c_char, c_int, c_void};
use std::ptr::{self, NonNull};

use libloading::os::unix::{Library, RTLD_GLOBAL, RTLD_LOCAL, RTLD_NOW};

use super::{Context, RTLD_NODELETE};

const OSMESA_RGBA: u32 = 0x1908;
const GL_UNSIGNED_BYTE: u32 = 0x1401;
const DEPTH_BITS: c_int = 24;
const STENCIL_BITS: c_int = 8;
const ACCUMULATOR_BITS: c_int = 0;

type Raw = *mut c_void;
type Create = unsafe extern "C" fn(u32, c_int, c_int, c_int, Raw) -> Raw;
type MakeCurrent = unsafe extern "C" fn(Raw, Raw, u32, c_int, c_int) -> u8;
type GetCurrent = unsafe extern "C" fn() -> Raw;
type Destroy = unsafe extern "C" fn(Raw);
type GetFunction = unsafe extern "C" fn(*const c_char) -> *const c_void;

struct Functions {
    create: Create,
    make_current: MakeCurrent,
    get_current: GetCurrent,
    destroy: Destroy,
    get_function: GetFunction,
}

/// An OSMesa context on a one-pixel buffer.
///
/// MuJoCo draws into a framebuffer object of its own, so the buffer is never drawn on.
pub(crate) struct OsMesaContext {
    functions: Functions,
    library: String,
    context: NonNull<c_void>,
    // OSMesa keeps its address while the context is current
    pixel: Box<[u8; 4]>,
}

impl OsMesaContext {
    pub(crate) fn new(library: &str) -> Result<Self, String> {
        if is_visible(c"eglGetProcAddress") {
            return Err(
                "the program is linked to EGL, which MuJoCo would use with OSMesa's context".into(),
            );
        }
        let functions = open(library).map_err(|error| error.to_string())?;
        // SAFETY: valid format and sizes, and no context to share with.
        let context = unsafe {
            (functions.create)(
                OSMESA_RGBA,
                DEPTH_BITS,
                STENCIL_BITS,
                ACCUMULATOR_BITS,
                ptr::null_mut(),
            )
        };
        let context = NonNull::new(context).ok_or("OSMesaCreateContextExt gave no context")?;
        let made = Self {
            functions,
            library: library.into(),
            context,
            pixel: Box::new([0; 4]),
        };
        made.make_current()?;
        Ok(made)
    }

    fn is_current(&self) -> bool {
        // SAFETY: takes nothing; gives NULL where no context is current.
        unsafe { (self.functions.get_current)() == self.context.as_ptr() }
    }
}

impl Context for OsMesaContext {
    fn make_current(&self) -> Result<(), String> {
        if self.is_current() {
            return Ok(());
        }
        let pixel = self.pixel.as_ptr().cast_mut().cast();
        // SAFETY: live context, and a buffer of one pixel that lives as long as it.
        let done = unsafe {
            (self.functions.make_current)(self.context.as_ptr(), pixel, GL_UNSIGNED_BYTE, 1, 1)
        };
        if done == 0 {
            Err("OSMesaMakeCurrent failed".into())
        } else {
            Ok(())
        }
    }

    fn publish(&self) -> Result<(), String> {
        // SAFETY: the library is loaded already; this only widens the visibility of its symbols.
        let visible =
            unsafe { Library::open(Some(&self.library), RTLD_NOW | RTLD_GLOBAL | RTLD_NODELETE) };
        visible.map(|_| ()).map_err(|error| error.to_string())
    }

    fn function(&self, name: &CStr) -> *const c_void {
        // SAFETY: NUL-terminated name; an unknown one gives NULL.
        unsafe { (self.functions.get_function)(name.as_ptr()) }
    }
}

impl Drop for OsMesaContext {
    fn drop(&mut self) {
        // SAFETY: live context, released from this thread first; nothing uses it afterwards.
        unsafe {
            if self.is_current() {
                (self.functions.make_current)(ptr::null_mut(), ptr::null_mut(), 0, 0, 0);
            }
            (self.functions.destroy)(self.context.as_ptr());
        }
    }
}

fn is_visible(symbol: &CStr) -> bool {
    // SAFETY: the symbol is only looked for, never used.
    unsafe { Library::this().get::<Raw>(symbol.to_bytes_with_nul()) }.is_ok()
}

fn open(library: &str) -> Result<Functions, libloading::Error> {
    // SAFETY: loading OSMesa runs no initialisers with preconditions. It stays loaded, so that the
    // functions below stay valid and Mesa's thread-exit handlers can run.
    let opened = unsafe { Library::open(Some(library), RTLD_NOW | RTLD_LOCAL | RTLD_NODELETE)? };
    // SAFETY: OSMesa's header declares these functions with these signatures.
    unsafe {
        Ok(Functions {
            create: *opened.get::<Create>(b"OSMesaCreateContextExt\0")?,
            make_current: *opened.get::<MakeCurrent>(b"OSMesaMakeCurrent\0")?,
            get_current: *opened.get::<GetCurrent>(b"OSMesaGetCurrentContext\0")?,
            destroy: *opened.get::<Destroy>(b"OSMesaDestroyContext\0")?,
            get_function: *opened.get::<GetFunction>(b"OSMesaGetProcAddress\0")?,
        })
    }
}
