//! OpenGL contexts: the parts that EGL and OSMesa share.

use std::cell::Cell;
use std::ffi::{CStr, c_int, c_void};
use std::fmt::Display;
use std::ptr;

use libloading::os::unix::{Library, RTLD_GLOBAL, RTLD_NOW};

use crate::error::OpenGlContextError;

/// OpenGL context that this crate has made, by EGL or OSMesa.
pub(super) trait Context {
    /// Makes this OpenGL context the thread's current one, unless it is already.
    fn make_current(&self) -> Result<PreviousContext, OpenGlContextError>;
    /// Returns the address of an OpenGL function; NULL if it is unknown.
    fn function(&self, name: &CStr) -> *const c_void;
}

/// OpenGL context of the embedding program, current until this crate made its own current.
///
/// If none was current, or one of this crate's, there is nothing to restore: a context of this
/// crate stays current, so that the next picture of the same renderer needs no switch.
#[must_use]
pub(crate) struct PreviousContext(Option<Restore>);

type Restore = Box<dyn FnOnce() -> Result<(), OpenGlContextError>>;

impl PreviousContext {
    pub(super) fn nothing() -> Self {
        Self(None)
    }

    pub(super) fn new(restore: impl FnOnce() -> Result<(), OpenGlContextError> + 'static) -> Self {
        Self(Some(Box::new(restore)))
    }

    /// Makes the embedding program's OpenGL context current again.
    pub(crate) fn restore(self) -> Result<(), OpenGlContextError> {
        self.0.map_or(Ok(()), |restore| restore())
    }
}

thread_local! {
    /// OpenGL context of this crate that was last made current on this thread.
    static LAST: Cell<*mut c_void> = const { Cell::new(ptr::null_mut()) };
}

pub(super) fn remember(context: *mut c_void) {
    LAST.set(context);
}

/// Returns `true` if `context`, the thread's current one, is an OpenGL context that this crate left
/// current.
pub(super) fn is_ours(context: *mut c_void) -> bool {
    LAST.get() == context
}

/// Stops treating the address `context` as an OpenGL context of this crate before that is
/// destroyed, since a foreign context may get the address.
pub(super) fn forget(context: *mut c_void) {
    if is_ours(context) {
        remember(ptr::null_mut());
    }
}

/// Makes the symbols of the loaded OpenGL library `library` visible to MuJoCo.
pub(super) fn publish(library: &str) -> Result<(), OpenGlContextError> {
    // SAFETY: the library is loaded already; this only widens the visibility of its symbols.
    let visible = unsafe { Library::open(Some(library), RTLD_NOW | RTLD_GLOBAL | RTLD_NODELETE) };
    visible.map(|_| ()).map_err(library_error(library))
}

/// Flag of `dlopen` on Linux: the library stays loaded after its last handle closes.
pub(super) const RTLD_NODELETE: c_int = 0x1000;

pub(super) fn library_error<E: Display>(library: &str) -> impl FnOnce(E) -> OpenGlContextError {
    let library = library.to_owned();
    move |error| OpenGlContextError::LibraryUnusable { library, reason: error.to_string() }
}
