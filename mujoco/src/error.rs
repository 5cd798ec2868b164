//! Everything that can go wrong, one enum per stage: loading, simulating, drawing.

use std::fmt;

use crate::backend::Backend;
use crate::ids::RendererId;

/// Any error of this crate.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MujocoError {
    /// A model could not be loaded, or lacks a name.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// A simulation diverged or was given bad values.
    #[error(transparent)]
    Sim(#[from] SimError),
    /// An image could not be drawn.
    #[error(transparent)]
    Render(#[from] RenderError),
}

/// Why a model could not be loaded, or a name not be found in it.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ModelError {
    /// The library at run time is of another release than the header at build time.
    #[error(
        "MuJoCo's header is of version {header} but the linked library is of version {library}; \
         rebuild against the library that is installed (Debian package libmujoco-dev 2.2.2)"
    )]
    VersionMismatch {
        /// `mjVERSION_HEADER` at build time, e.g. 222.
        header: i32,
        /// `mj_version()` at run time.
        library: i32,
    },
    /// MuJoCo refused the model; its own message follows.
    #[error("MuJoCo cannot load `{file}`: {message}")]
    Load {
        /// Name of the main file.
        file: String,
        /// MuJoCo's message, with file and line where it knows them.
        message: String,
    },
    /// A file name that MuJoCo's virtual file system cannot hold.
    #[error("file name `{name}` cannot be used: {reason}")]
    FileName {
        /// The name as given.
        name: String,
        /// What is wrong with it.
        reason: &'static str,
    },
    /// A file without content, or of 2 GiB and more.
    #[error("file `{name}` has {size} bytes; a file must have between 1 and 2147483647")]
    FileSize {
        /// The file's name.
        name: String,
        /// Its size in bytes.
        size: usize,
    },
    /// The main file is not among the files.
    #[error("main file `{main}` is not among the files given: {}", list(.files))]
    NoMainFile {
        /// Name asked for.
        main: String,
        /// Names of the files given.
        files: Vec<String>,
    },
    /// No object of this kind has this name.
    #[error("the model has no {kind} named `{name}`; known: {}", list(.known))]
    UnknownName {
        /// Kind of object, e.g. `body`.
        kind: &'static str,
        /// Name asked for.
        name: String,
        /// Every name of this kind in the model.
        known: Vec<String>,
    },
    /// The body exists, but is not a mocap body.
    #[error("body `{name}` is no mocap body; mocap bodies: {}", list(.known))]
    NotMocap {
        /// Name asked for.
        name: String,
        /// Every mocap body of the model.
        known: Vec<String>,
    },
}

fn list(names: &[String]) -> String {
    if names.is_empty() { "(none)".into() } else { names.join(", ") }
}

/// Why a simulation step, or a value handed to the simulation, was refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SimError {
    /// The physics diverged, and this crate has reset the state.
    ///
    /// MuJoCo only counts a warning and goes on: from the initial state after a bad position,
    /// velocity or acceleration, with zeros in place of all controls after a bad control, and with
    /// a changed matrix after a nearly singular inertia matrix.
    #[error(
        "the simulation diverged at time {time} s: bad {what} (element {index}); \
         the state was reset. Use a smaller time step, or less force"
    )]
    Diverged {
        /// The quantity that became NaN, infinite or huge.
        what: Quantity,
        /// Element of that quantity, as MuJoCo reports it.
        index: usize,
        /// Simulation time before the failing step, in seconds.
        time: f64,
    },
    /// A buffer of MuJoCo was too small, so that contacts or constraints were dropped.
    #[error(
        "MuJoCo dropped {what} at time {time} s, over the limit of {limit}; \
         raise `{setting}` in the model's <size>"
    )]
    Overflow {
        /// What was dropped.
        what: &'static str,
        /// How many fit.
        limit: usize,
        /// The XML attribute to raise.
        setting: &'static str,
        /// Simulation time before the failing step, in seconds.
        time: f64,
    },
    /// A value that is NaN or infinite.
    #[error("{what}[{index}] is {value}, which is not finite")]
    NotFinite {
        /// The quantity given.
        what: Quantity,
        /// Element of that quantity.
        index: usize,
        /// The refused value.
        value: f64,
    },
    /// A slice of the wrong length.
    #[error("{what} has {got} elements, expected {expected}")]
    Length {
        /// The quantity given.
        what: Quantity,
        /// Length that the model asks for.
        expected: usize,
        /// Length given.
        got: usize,
    },
    /// A quaternion whose norm is too small to stand for a rotation.
    #[error("quaternion {value:?} has no direction; a rotation needs a norm that is not 0")]
    ZeroQuaternion {
        /// The refused value, (w, x, y, z).
        value: [f64; 4],
    },
}

/// A quantity of the simulation that an error speaks of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Quantity {
    /// Generalised positions.
    Qpos,
    /// Generalised velocities.
    Qvel,
    /// Generalised accelerations.
    Qacc,
    /// Controls.
    Ctrl,
    /// Inertia matrix (nearly singular).
    Inertia,
    /// Position or orientation of a mocap body.
    Mocap,
    /// A saved state.
    State,
}

impl fmt::Display for Quantity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Qpos => "qpos",
            Self::Qvel => "qvel",
            Self::Qacc => "qacc",
            Self::Ctrl => "ctrl",
            Self::Inertia => "inertia",
            Self::Mocap => "mocap pose",
            Self::State => "state",
        })
    }
}

/// Refuses a slice whose length is not `expected`.
pub(crate) fn check_length(what: Quantity, expected: usize, got: usize) -> Result<(), SimError> {
    let error = SimError::Length { what, expected, got };
    (got == expected).then_some(()).ok_or(error)
}

/// Refuses infinities and NaN.
pub(crate) fn check_finite(what: Quantity, values: &[f64]) -> Result<(), SimError> {
    match values.iter().position(|value| !value.is_finite()) {
        None => Ok(()),
        Some(index) => Err(SimError::NotFinite { what, index, value: values[index] }),
    }
}

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
    tried.iter().map(|(backend, reason)| format!("\n  {backend}: {reason}")).collect()
}
