//! OpenGL contexts without a window.
//!
//! Read this before editing. MuJoCo looks up OpenGL's functions once per process, through the first
//! of `eglGetProcAddress` and `OSMesaGetProcAddress` that is visible to the whole process. Hence
//! neither library is linked; each is first opened privately, and made visible only once it has
//! provided a context. From then on the process keeps to that library.

mod context;
mod egl;
mod osmesa;

use std::env;
use std::ffi::{CStr, c_char, c_void};
use std::mem;
use std::sync::{Mutex, MutexGuard, OnceLock, PoisonError};

use crate::backend::OpenGlBackend;
use crate::error::{OpenGlContextError, RenderError};
use context::{Context, publish};
use egl::{EglContext, Platform};
use osmesa::OsMesaContext;

pub(crate) use context::PreviousContext;

impl OpenGlBackend {
    /// Returns the backends that the environment variable `COVERS_GL` allows: `egl`, `osmesa`, or
    /// all if it is unset.
    ///
    /// # Errors
    /// [`RenderError::UnknownBackend`] for any other value.
    pub fn allowed_by_env() -> Result<&'static [Self], RenderError> {
        parse_choice(&env::var("COVERS_GL").unwrap_or_default())
    }

    fn library(self) -> &'static str {
        match self {
            Self::EglSurfaceless | Self::EglPbuffer => "libEGL.so.1",
            Self::OsMesa => "libOSMesa.so.8",
        }
    }
}

fn parse_choice(value: &str) -> Result<&'static [OpenGlBackend], RenderError> {
    match value {
        "" => Ok(&OpenGlBackend::ALL),
        "egl" => Ok(&[OpenGlBackend::EglSurfaceless, OpenGlBackend::EglPbuffer]),
        "osmesa" => Ok(&[OpenGlBackend::OsMesa]),
        _ => Err(RenderError::UnknownBackend { got: value.into() }),
    }
}

/// OpenGL context of a renderer; it stays on one thread, since `Renderer` is not `Send`.
pub(crate) struct GlContext {
    backend: OpenGlBackend,
    context: Box<dyn Context>,
}

impl GlContext {
    /// Creates an OpenGL context with the first backend that works, and makes it current.
    pub(crate) fn new(backends: &[OpenGlBackend]) -> Result<(Self, PreviousContext), RenderError> {
        Self::first_of(backends.iter().map(|&backend| (backend, backend.library())))
    }

    fn first_of(
        candidates: impl Iterator<Item = (OpenGlBackend, &'static str)>,
    ) -> Result<(Self, PreviousContext), RenderError> {
        let mut in_use = library_in_use();
        let mut tried = Vec::new();
        for (backend, library) in candidates {
            match Self::open(backend, library, *in_use) {
                Ok(opened) => {
                    *in_use = Some(library);
                    return Ok(opened);
                }
                Err(reason) => tried.push((backend, reason)),
            }
        }
        Err(RenderError::NoContext { tried })
    }

    fn open(
        backend: OpenGlBackend,
        library: &str,
        in_use: Option<&str>,
    ) -> Result<(Self, PreviousContext), OpenGlContextError> {
        if let Some(other) = in_use.filter(|&other| other != library) {
            let loaded = other.into();
            return Err(OpenGlContextError::LibraryInUse { in_use: loaded });
        }
        let context: Box<dyn Context> = match backend {
            OpenGlBackend::EglSurfaceless => {
                Box::new(EglContext::new(library, Platform::Surfaceless)?)
            }
            OpenGlBackend::EglPbuffer => Box::new(EglContext::new(library, Platform::Device)?),
            OpenGlBackend::OsMesa => Box::new(OsMesaContext::new(library)?),
        };
        let previous = context.make_current()?;
        let opened = Self { backend, context };
        match opened.require_features().and_then(|()| publish(library)) {
            Ok(()) => {
                DESCRIPTION.get_or_init(|| opened.description());
                Ok((opened, previous))
            }
            Err(reason) => {
                drop(opened);
                previous.restore().and(Err(reason))
            }
        }
    }

    /// Returns the backend that provides the OpenGL context.
    pub(crate) fn backend(&self) -> OpenGlBackend {
        self.backend
    }

    /// Makes this OpenGL context the thread's current one, unless it is already.
    pub(crate) fn make_current(&self) -> Result<PreviousContext, RenderError> {
        self.context
            .make_current()
            .map_err(|reason| RenderError::MakeCurrentFailed { backend: self.backend, reason })
    }

    /// Returns the name of the backend, and OpenGL's own description of its renderer and version.
    fn description(&self) -> String {
        let names = [GL_RENDERER, GL_VERSION].map(|name| self.string(name).unwrap_or_default());
        format!("{}: {}, OpenGL {}", self.backend, names[0], names[1])
    }

    /// Checks the OpenGL extensions without which MuJoCo would end the process.
    fn require_features(&self) -> Result<(), OpenGlContextError> {
        let extensions = self.string(GL_EXTENSIONS).unwrap_or_default();
        let has = |name: &&str| extensions.split(' ').any(|extension| extension == *name);
        match ["GL_ARB_framebuffer_object", "GL_ARB_vertex_buffer_object"]
            .into_iter()
            .find(|name| !has(name))
        {
            None => Ok(()),
            Some(name) => Err(OpenGlContextError::MissingOpenGlFeature { name }),
        }
    }

    fn string(&self, name: u32) -> Option<String> {
        type GetString = unsafe extern "C" fn(u32) -> *const c_char;
        let pointer = self.context.function(c"glGetString");
        if pointer.is_null() {
            return None;
        }
        // SAFETY: not null, and `glGetString` has this signature in every OpenGL.
        let get_string = unsafe { mem::transmute::<*const c_void, GetString>(pointer) };
        // SAFETY: the context is current; an unknown name yields NULL.
        let text = unsafe { get_string(name) };
        if text.is_null() {
            return None;
        }
        // SAFETY: OpenGL's strings are NUL-terminated and static.
        Some(unsafe { CStr::from_ptr(text) }.to_string_lossy().into_owned())
    }
}

const GL_RENDERER: u32 = 0x1F01;
const GL_VERSION: u32 = 0x1F02;
const GL_EXTENSIONS: u32 = 0x1F03;

/// Description of the first OpenGL context of the process.
static DESCRIPTION: OnceLock<String> = OnceLock::new();

/// Returns OpenGL's description in this process (backend, renderer, version); `None` before the
/// first [`Renderer`](crate::Renderer) is made.
pub fn opengl_description() -> Option<&'static str> {
    DESCRIPTION.get().map(String::as_str)
}

/// Locks and returns the name of the library that MuJoCo got OpenGL from. The lock is held while a
/// context is made, so that two threads cannot choose two libraries. MuJoCo fills its global table
/// of OpenGL functions later, under a guard of its own, and only once.
fn library_in_use() -> MutexGuard<'static, Option<&'static str>> {
    static IN_USE: Mutex<Option<&'static str>> = Mutex::new(None);
    IN_USE.lock().unwrap_or_else(PoisonError::into_inner)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn no_backend_lists_attempts_and_packages() {
        let candidates = OpenGlBackend::ALL.map(|backend| (backend, "libNoSuchLibrary.so.1"));
        let Err(error) = GlContext::first_of(candidates.into_iter()) else {
            panic!("a library that does not exist gave a context");
        };
        let text = error.to_string();
        for part in ["EGL (surfaceless)", "EGL (pixel buffer)", "OSMesa", "libNoSuchLibrary.so.1"] {
            assert!(text.contains(part), "{part} is not in: {text}");
        }
        for package in ["libegl1", "libegl-mesa0", "libosmesa6"] {
            assert!(text.contains(package), "{package} is not in: {text}");
        }
    }

    #[test]
    fn choice_is_parsed() {
        assert_eq!(parse_choice(""), Ok(OpenGlBackend::ALL.as_slice()));
        assert_eq!(parse_choice("osmesa"), Ok([OpenGlBackend::OsMesa].as_slice()));
        assert_eq!(parse_choice("egl").unwrap().len(), 2);
        assert_eq!(parse_choice("glx"), Err(RenderError::UnknownBackend { got: "glx".into() }));
    }

    #[test]
    fn a_second_library_is_refused() {
        let Err(reason) =
            GlContext::open(OpenGlBackend::OsMesa, "libOSMesa.so.8", Some("libEGL.so.1"))
        else {
            panic!("two OpenGL libraries in one process");
        };
        let in_use = "libEGL.so.1".into();
        assert_eq!(reason, OpenGlContextError::LibraryInUse { in_use });
    }
}
