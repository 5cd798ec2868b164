//! OpenGL contexts by OSMesa (software), which is loaded at run time.

use std::ffi::{CStr, c_char, c_int, c_void};
use std::ptr::{self, NonNull};

use libloading::os::unix::{Library, RTLD_LOCAL, RTLD_NOW};

use super::context::{
    Context, PreviousContext, RTLD_NODELETE, forget, is_ours, library_error, remember,
};
use crate::error::OpenGlContextError;

const OSMESA_RGBA: u32 = 0x1908;
const OSMESA_TYPE: c_int = 0x23;
const GL_UNSIGNED_BYTE: u32 = 0x1401;
const DEPTH_BITS: c_int = 24;
const STENCIL_BITS: c_int = 8;
const ACCUMULATOR_BITS: c_int = 0;

type Raw = *mut c_void;
type Create = unsafe extern "C" fn(u32, c_int, c_int, c_int, Raw) -> Raw;
type MakeCurrent = unsafe extern "C" fn(Raw, Raw, u32, c_int, c_int) -> u8;
type GetCurrent = unsafe extern "C" fn() -> Raw;
type GetInteger = unsafe extern "C" fn(c_int, *mut c_int);
type GetBuffer = unsafe extern "C" fn(Raw, *mut c_int, *mut c_int, *mut c_int, *mut Raw) -> u8;
type Destroy = unsafe extern "C" fn(Raw);
type GetFunction = unsafe extern "C" fn(*const c_char) -> *const c_void;

#[derive(Clone, Copy)]
struct Functions {
    create: Create,
    make_current: MakeCurrent,
    get_current: GetCurrent,
    get_integer: GetInteger,
    get_buffer: GetBuffer,
    destroy: Destroy,
    get_function: GetFunction,
}

/// OSMesa context on a one-pixel buffer.
///
/// MuJoCo draws into a framebuffer object of its own, so the buffer is never drawn on.
pub(super) struct OsMesaContext {
    functions: Functions,
    context: NonNull<c_void>,
    // last, so that it outlives the context
    pixel: Pixel,
}

impl OsMesaContext {
    /// Creates an OSMesa context without making it current.
    pub(super) fn new(library: &str) -> Result<Self, OpenGlContextError> {
        if is_visible(c"eglGetProcAddress") {
            return Err(OpenGlContextError::LinkedToEgl);
        }
        let functions = open(library).map_err(library_error(library))?;
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
        let call = "OSMesaCreateContextExt";
        Ok(Self {
            functions,
            context: NonNull::new(context).ok_or(OpenGlContextError::OsMesaCallFailed { call })?,
            pixel: Pixel::new(),
        })
    }
}

impl Context for OsMesaContext {
    fn make_current(&self) -> Result<PreviousContext, OpenGlContextError> {
        let current = self.functions.current();
        if current == self.context.as_ptr() {
            return Ok(PreviousContext::nothing());
        }
        let foreign = !current.is_null() && !is_ours(current);
        let previous =
            if foreign { self.functions.previous(current)? } else { PreviousContext::nothing() };
        let (context, pixel) = (self.context.as_ptr(), self.pixel.as_ptr());
        // SAFETY: live context, and a buffer of one pixel that outlives it.
        let done = unsafe { (self.functions.make_current)(context, pixel, GL_UNSIGNED_BYTE, 1, 1) };
        check(done, "OSMesaMakeCurrent")?;
        remember(context);
        Ok(previous)
    }

    fn function(&self, name: &CStr) -> *const c_void {
        // SAFETY: NUL-terminated name; an unknown one gives NULL.
        unsafe { (self.functions.get_function)(name.as_ptr()) }
    }
}

impl Drop for OsMesaContext {
    fn drop(&mut self) {
        let context = self.context.as_ptr();
        forget(context);
        // SAFETY: live context, released from this thread first; nothing uses it afterwards.
        unsafe {
            if self.functions.current() == context {
                (self.functions.make_current)(ptr::null_mut(), ptr::null_mut(), 0, 0, 0);
            }
            (self.functions.destroy)(context);
        }
    }
}

impl Functions {
    /// Returns the thread's current OSMesa context; NULL if there is none.
    fn current(&self) -> Raw {
        // SAFETY: takes nothing.
        unsafe { (self.get_current)() }
    }

    /// Returns a restorer of `context`, which must be the thread's current one.
    fn previous(self, context: Raw) -> Result<PreviousContext, OpenGlContextError> {
        let (mut width, mut height, mut format, mut kind) = (0, 0, 0, 0);
        let mut buffer = ptr::null_mut();
        // SAFETY: `context` is the current one, and each pointer is to a local variable.
        let done = unsafe {
            (self.get_integer)(OSMESA_TYPE, &raw mut kind);
            (self.get_buffer)(
                context,
                &raw mut width,
                &raw mut height,
                &raw mut format,
                &raw mut buffer,
            )
        };
        check(done, "OSMesaGetColorBuffer")?;
        Ok(PreviousContext::new(move || {
            // SAFETY: the program had this context current with this buffer a moment ago, and has
            // had no chance to free either.
            let made_current = unsafe {
                (self.make_current)(context, buffer, kind.cast_unsigned(), width, height)
            };
            check(made_current, "OSMesaMakeCurrent")
        }))
    }
}

/// Buffer of one pixel at a fixed address, which OSMesa keeps and may write to.
struct Pixel(NonNull<[u8; 4]>);

impl Pixel {
    fn new() -> Self {
        Self(NonNull::from(Box::leak(Box::new([0; 4]))))
    }

    fn as_ptr(&self) -> Raw {
        self.0.as_ptr().cast()
    }
}

impl Drop for Pixel {
    fn drop(&mut self) {
        // SAFETY: the pointer came from a leaked box, and OSMesa's context is gone.
        drop(unsafe { Box::from_raw(self.0.as_ptr()) });
    }
}

fn check(done: u8, call: &'static str) -> Result<(), OpenGlContextError> {
    match done {
        0 => Err(OpenGlContextError::OsMesaCallFailed { call }),
        _ => Ok(()),
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
            get_integer: *opened.get::<GetInteger>(b"OSMesaGetIntegerv\0")?,
            get_buffer: *opened.get::<GetBuffer>(b"OSMesaGetColorBuffer\0")?,
            destroy: *opened.get::<Destroy>(b"OSMesaDestroyContext\0")?,
            get_function: *opened.get::<GetFunction>(b"OSMesaGetProcAddress\0")?,
        })
    }
}
