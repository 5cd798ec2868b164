//! What EGL and OSMesa have in common.

use std::cell::Cell;
use std::ffi::{CStr, c_int, c_void};
use std::fmt::Display;
use std::ptr;

use libloading::os::unix::{Library, RTLD_GLOBAL, RTLD_NOW};

use crate::error::ContextError;

/// An OpenGL context of this crate.
pub(super) trait Context {
    /// Makes this context the thread's current one, unless it is already.
    fn enter(&self) -> Result<Previous, ContextError>;
    /// Address of an OpenGL function; NULL where it is unknown.
    fn function(&self, name: &CStr) -> *const c_void;
}

/// The context that was current before one of this crate's, where it is the embedding program's.
///
/// Where none was current, or one of this crate's, there is nothing to restore: a context of this
/// crate stays current, so that the next picture of the same renderer switches nothing.
#[must_use]
pub(crate) struct Previous(Option<Restore>);

type Restore = Box<dyn FnOnce() -> Result<(), ContextError>>;

impl Previous {
    pub(super) fn nothing() -> Self {
        Self(None)
    }

    pub(super) fn new(restore: impl FnOnce() -> Result<(), ContextError> + 'static) -> Self {
        Self(Some(Box::new(restore)))
    }

    /// Makes it current again.
    pub(crate) fn restore(self) -> Result<(), ContextError> {
        self.0.map_or(Ok(()), |restore| restore())
    }
}

thread_local! {
    /// The context of this crate that was made current last on this thread.
    static LAST: Cell<*mut c_void> = const { Cell::new(ptr::null_mut()) };
}

pub(super) fn remember(context: *mut c_void) {
    LAST.set(context);
}

/// Whether the thread's current `context` is one of this crate's: then this crate left it so.
pub(super) fn is_ours(context: *mut c_void) -> bool {
    LAST.get() == context
}

/// Forgets a context that is about to go: its address may be given to one of somebody else's.
pub(super) fn forget(context: *mut c_void) {
    if is_ours(context) {
        remember(ptr::null_mut());
    }
}

/// Lets MuJoCo find the way to OpenGL's functions of a library that has given a context.
pub(super) fn publish(library: &str) -> Result<(), ContextError> {
    // SAFETY: the library is loaded already; this only widens the visibility of its symbols.
    let visible = unsafe { Library::open(Some(library), RTLD_NOW | RTLD_GLOBAL | RTLD_NODELETE) };
    visible.map(|_| ()).map_err(unusable(library))
}

/// Linux's flag to keep a library loaded when its last handle closes.
pub(super) const RTLD_NODELETE: c_int = 0x1000;

pub(super) fn unusable<E: Display>(library: &str) -> impl FnOnce(E) -> ContextError {
    let library = library.to_owned();
    move |error| ContextError::Library { library, reason: error.to_string() }
}
