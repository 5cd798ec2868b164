//! Errors of drawing and of getting at OpenGL.

use crate::backend::Backend;
use crate::renderer_id::RendererId;

/// Why an image could not be drawn, or a renderer not be made. Do not use the output slice then.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum RenderError {
    /// No way to an OpenGL context worked.
    #[error(
        "no OpenGL context can be made. Tried:{}\n\
         On Debian install libegl1 and libegl-mesa0 (EGL), or libosmesa6 (OSMesa); \
         COVERS_GL=egl or COVERS_GL=osmesa chooses one.",
        attempts(.tried)
    )]
    NoContext {
        /// Each backend tried, and why it failed.
        tried: Vec<(Backend, ContextError)>,
    },
    /// The environment variable `COVERS_GL` names no backend.
    #[error("COVERS_GL is `{got}`; it must be `egl` or `osmesa`, or unset")]
    UnknownBackend {
        /// Value of the variable.
        got: String,
    },
    /// An image size that cannot be drawn.
    #[error("image size {width} x {height} is out of range; each side must be 1 to {limit} pixels")]
    Size {
        /// Width asked for, in pixels.
        width: usize,
        /// Height asked for, in pixels.
        height: usize,
        /// Largest side, in pixels.
        limit: usize,
    },
    /// The output slice does not hold one image.
    #[error("the output has {got} bytes, expected {expected} (height x width x 3)")]
    Buffer {
        /// Bytes of one image.
        expected: usize,
        /// Bytes given.
        got: usize,
    },
    /// The data belongs to another model than the renderer.
    #[error("the data belongs to another model than the renderer; make both from one Arc<Model>")]
    OtherModel,
    /// The camera's id comes from a larger model.
    #[error("camera {index} is not of this model, which has {count}")]
    UnknownCamera {
        /// Index of the camera asked for.
        index: usize,
        /// Cameras of the renderer's model.
        count: usize,
    },
    /// The scene holds more geoms than the renderer made room for.
    #[error("the scene has more than {limit} geoms, some would be missing")]
    SceneFull {
        /// Geoms that fit.
        limit: usize,
    },
    /// The backdrop holds no picture: it was never drawn, or drawing it failed.
    #[error("nothing was drawn into this backdrop; call `draw_backdrop` first")]
    NoBackdrop,
    /// The backdrop was drawn by another renderer.
    #[error("the backdrop was drawn by {drawn_by}, not by {used_by}; draw it with the latter")]
    OtherRenderer {
        /// The renderer that drew the backdrop.
        drawn_by: RendererId,
        /// The renderer that was to draw over it.
        used_by: RendererId,
    },
    /// Something that is not its own mirror image, such as a mesh, in a view with a mirror.
    #[error(
        "{what} {index} is not mirror-symmetric, as a mesh or a texture may not be; \
         draw it without a mirror"
    )]
    NotMirrorSymmetric {
        /// `geom` or `skin`.
        what: &'static str,
        /// Its index in the model.
        index: usize,
    },
    /// OpenGL reported an error, for instance that it lost the context (0x0507) or has no memory
    /// left (0x0505).
    #[error(
        "OpenGL error {code:#06x} while {during}; pictures cannot be trusted: make a new renderer"
    )]
    OpenGl {
        /// Code of `glGetError`.
        code: u32,
        /// What was being done.
        during: &'static str,
    },
    /// The renderer's context could not be made current on this thread, as one that is lost cannot.
    #[error(
        "the {backend} context cannot be made current, it may be lost: {reason}; \
         make a new renderer"
    )]
    Current {
        /// The renderer's backend.
        backend: Backend,
        /// What the backend said.
        reason: ContextError,
    },
    /// The context of the program around this crate could not be made current again; the picture
    /// itself may be whole.
    #[error("the {backend} context that was current before cannot be made so again: {reason}")]
    Restore {
        /// The renderer's backend.
        backend: Backend,
        /// What the backend said.
        reason: ContextError,
    },
}

/// Why a [`Backend`] gives no OpenGL context, or a context cannot be used.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ContextError {
    /// The library cannot be loaded, or lacks a function.
    #[error("{library} cannot be used: {reason}")]
    Library {
        /// File name of the library.
        library: String,
        /// What the dynamic loader said.
        reason: String,
    },
    /// The process draws through another library already.
    #[error("this process draws through {in_use} already, and MuJoCo loads OpenGL once")]
    LibraryInUse {
        /// File name of the library in use.
        in_use: String,
    },
    /// EGL is visible to the whole process, so MuJoCo would prefer it to OSMesa.
    #[error("the program is linked to EGL, which MuJoCo would use with OSMesa's context")]
    LinkedToEgl,
    /// EGL lacks an extension.
    #[error("EGL does not offer {name}")]
    Extension {
        /// Name of the extension.
        name: &'static str,
    },
    /// A call of EGL failed.
    #[error("{call} failed with EGL error {code:#06x} ({meaning})")]
    Egl {
        /// The function that was called.
        call: &'static str,
        /// Code of `eglGetError`.
        code: i32,
        /// The code in words.
        meaning: String,
    },
    /// A call of OSMesa failed, which tells no reason.
    #[error("{call} failed")]
    OsMesa {
        /// The function that was called.
        call: &'static str,
    },
    /// EGL lists no graphics device.
    #[error("EGL lists no device")]
    NoDevice,
    /// No framebuffer configuration fits.
    #[error("no configuration has OpenGL, 8-bit colours and 24-bit depth")]
    NoConfiguration,
    /// OpenGL lacks something that MuJoCo cannot do without.
    #[error("OpenGL lacks {name}")]
    Feature {
        /// Name of the OpenGL extension.
        name: &'static str,
    },
}

fn attempts(tried: &[(Backend, ContextError)]) -> String {
    tried
        .iter()
        .map(|(backend, reason)| format!("\n  {backend}: {reason}"))
        .collect()
}
