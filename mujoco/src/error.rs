//! Errors of MuJoCo models, simulations and renderers, one enum for each.

use std::fmt;

use crate::backend::OpenGlBackend;
use crate::ids::RendererId;

/// Any error of this crate: of a model, a simulation or a renderer.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum MujocoError {
    /// Error of loading a model, or a name that it lacks.
    #[error(transparent)]
    Model(#[from] ModelError),
    /// Divergence of a simulation, or invalid values given to it.
    #[error(transparent)]
    Sim(#[from] SimError),
    /// Error of drawing an image.
    #[error(transparent)]
    Render(#[from] RenderError),
}

/// Error of loading a model, or of finding a name in it.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum ModelError {
    /// Version mismatch between the library at run time and the header at build time.
    #[error(
        "MuJoCo's header is of version {header} but the linked library is of version {library}; \
         rebuild against the library that is installed, or let LD_LIBRARY_PATH name the folder of \
         the library of MUJOCO_DIR"
    )]
    VersionMismatch {
        /// `mjVERSION_HEADER` at build time, e.g. 222.
        header: i32,
        /// `mj_version()` at run time.
        library: i32,
    },
    /// Model that MuJoCo rejected, with its own message.
    #[error("MuJoCo cannot load `{file}`: {message}")]
    LoadFailed {
        /// Name of the rejected file: the main one, or one that it includes.
        file: String,
        /// MuJoCo's message, with file and line where available.
        message: String,
    },
    /// Model with actuators of several controls or outputs, which recent releases have.
    #[error(
        "`{file}` has actuators with more than one control or output, which are not supported: \
         give each actuator one joint, tendon or site direction"
    )]
    VectorActuators {
        /// Name of the model's main file.
        file: String,
    },
    /// New frame of inertia, or new place or axis of a joint, of a body whose inertia MuJoCo
    /// compiled as diagonal.
    #[error(
        "body {index} (`{body}`) cannot get another frame of inertia, joint position or axis: \
         MuJoCo compiled its inertia as diagonal; change the XML"
    )]
    FixedInertiaFrame {
        /// Name of the body; empty if it has none.
        body: String,
        /// Index of the body.
        index: usize,
    },
    /// File name in memory that this crate does not accept.
    #[error("file name `{name}` cannot be used: {reason}")]
    InvalidFileName {
        /// File name as given.
        name: String,
        /// Reason for which the file name is rejected.
        reason: &'static str,
    },
    /// Model file that is empty or has 2 GiB or more.
    #[error("file `{name}` has {size} bytes; a file must have between 1 and 2147483647")]
    InvalidFileSize {
        /// Name of the file.
        name: String,
        /// Size of the file in bytes.
        size: usize,
    },
    /// Main file that is not among the files.
    #[error("main file `{main}` is not among the files given: {}", list(.files))]
    NoMainFile {
        /// Name that was requested as the main file.
        main: String,
        /// Names of the files given.
        files: Vec<String>,
    },
    /// Name that no object of the requested kind has.
    #[error("the model has no {kind} named `{name}`; known: {}", list(.known))]
    UnknownName {
        /// Kind of object, for instance `body`.
        kind: &'static str,
        /// Name that no object has.
        name: String,
        /// Names of all objects of this kind in the model.
        known: Vec<String>,
    },
    /// Body that is requested as a mocap body but is none.
    #[error("body `{name}` is not a mocap body; mocap bodies: {}", list(.known))]
    NotMocapBody {
        /// Name of the requested body.
        name: String,
        /// Names of all mocap bodies of the model.
        known: Vec<String>,
    },
    /// Model with poses that a mirrored or moved copy would keep.
    #[error("the model cannot be {change}: it has {what} there, whose pose would stay; remove it")]
    FixedPoses {
        /// Rejected change of poses: `mirrored` or `moved`.
        change: &'static str,
        /// Object whose pose would stay, for instance `a keyframe`.
        what: &'static str,
    },
}

fn list(names: &[String]) -> String {
    if names.is_empty() { "(none)".into() } else { names.join(", ") }
}

/// Rejection of a simulation step, or of a value given to the simulation.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SimError {
    /// Divergence of the physics, after which this crate has reset the state.
    ///
    /// MuJoCo itself only counts a warning and continues: from the initial state after an invalid
    /// position, velocity or acceleration, with all controls set to zero after an invalid control,
    /// and with a changed matrix after a nearly singular inertia matrix.
    #[error(
        "the simulation diverged at time {time} s: bad {what} (element {index}); \
         the state was reset. Use a smaller time step, or less force"
    )]
    Diverged {
        /// Quantity that became NaN, infinite or huge.
        what: SimQuantity,
        /// Index of the diverged element of the quantity, as MuJoCo reports it.
        index: usize,
        /// Simulation time before the failing step, in seconds.
        time: f64,
    },
    /// Overflow of a MuJoCo buffer, so that contacts or constraints were dropped.
    #[error(
        "MuJoCo dropped {what} at time {time} s, for which `{setting}` = {limit} is too small; \
         raise it in the model's <size>"
    )]
    BufferOverflow {
        /// Dropped objects: `contacts` or `constraints`.
        what: &'static str,
        /// Number of contacts or constraints that fit; with MuJoCo 3.2 or later, the memory
        /// (bytes) for both.
        limit: usize,
        /// Attribute of `<size>` in the model's XML to raise.
        setting: &'static str,
        /// Simulation time before the failing step, in seconds.
        time: f64,
    },
    /// Value for the simulation that is NaN or infinite.
    #[error("{what}[{index}] is {value}, which is not finite")]
    NotFinite {
        /// Quantity that has the rejected value.
        what: SimQuantity,
        /// Index of the rejected value within the quantity.
        index: usize,
        /// Value that was rejected.
        value: f64,
    },
    /// Slice of values for the simulation of the wrong length.
    #[error("{what} has {got} elements, expected {expected}")]
    WrongLength {
        /// Quantity that the slice is for.
        what: SimQuantity,
        /// Length that the model requires.
        expected: usize,
        /// Length of the rejected slice.
        got: usize,
    },
    /// Quaternion with a norm too small or too large to make a rotation of it.
    #[error("quaternion {value:?} cannot be normalised; expected a norm between 1e-6 and 1e150")]
    NotNormalisable {
        /// Rejected quaternion, (w, x, y, z).
        value: [f64; 4],
    },
}

/// Quantity of the simulation that an error is about.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum SimQuantity {
    /// Generalised positions `qpos`.
    Qpos,
    /// Generalised velocities `qvel`.
    Qvel,
    /// Generalised accelerations `qacc`.
    Qacc,
    /// Controls `ctrl` of the actuators.
    Ctrl,
    /// Joint-space inertia matrix, which is nearly singular.
    Inertia,
    /// Position or orientation of a mocap body.
    MocapPose,
    /// Saved state of a simulation, see [`State`](crate::State).
    State,
}

impl fmt::Display for SimQuantity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Qpos => "qpos",
            Self::Qvel => "qvel",
            Self::Qacc => "qacc",
            Self::Ctrl => "ctrl",
            Self::Inertia => "inertia",
            Self::MocapPose => "mocap pose",
            Self::State => "state",
        })
    }
}

/// Returns [`SimError::WrongLength`] unless `got`, the length of a slice for `what`, is `expected`.
pub(crate) fn check_length(what: SimQuantity, expected: usize, got: usize) -> Result<(), SimError> {
    let error = SimError::WrongLength { what, expected, got };
    (got == expected).then_some(()).ok_or(error)
}

/// Returns [`SimError::NotFinite`] if one of the values of `what` is infinite or NaN.
pub(crate) fn check_finite(what: SimQuantity, values: &[f64]) -> Result<(), SimError> {
    match values.iter().position(|value| !value.is_finite()) {
        None => Ok(()),
        Some(index) => Err(SimError::NotFinite { what, index, value: values[index] }),
    }
}

/// Error of making a renderer or drawing an image; the contents of the output slice are then
/// undefined.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum RenderError {
    /// Failure of every OpenGL backend to make a context.
    #[error(
        "no OpenGL context can be made. Tried:{}\n\
         On Debian install libegl1 and libegl-mesa0 (EGL), or libosmesa6 (OSMesa); \
         COVERS_GL=egl or COVERS_GL=osmesa chooses one.",
        attempts(.tried)
    )]
    NoContext {
        /// OpenGL backends that were tried, each with its error.
        tried: Vec<(OpenGlBackend, OpenGlContextError)>,
    },
    /// Unknown backend in the environment variable `COVERS_GL`.
    #[error("COVERS_GL is `{got}`; it must be `egl` or `osmesa`, or unset")]
    UnknownBackend {
        /// Value of the environment variable `COVERS_GL`.
        got: String,
    },
    /// Size of a renderer's images out of range.
    #[error("image size {width} x {height} is out of range; each side must be 1 to {limit} pixels")]
    ImageSizeOutOfRange {
        /// Requested width of the images, in pixels.
        width: usize,
        /// Requested height of the images, in pixels.
        height: usize,
        /// Largest allowed width or height, in pixels.
        limit: usize,
    },
    /// Output slice that does not hold exactly one image.
    #[error("the output has {got} bytes, expected {expected} (height x width x 3)")]
    WrongImageLength {
        /// Number of bytes that one image has.
        expected: usize,
        /// Number of bytes that the output slice has.
        got: usize,
    },
    /// Data of another model than the renderer's.
    #[error("the data belongs to another model than the renderer; make both from one Arc<Model>")]
    OtherModel,
    /// Camera id that the renderer's model does not have.
    #[error("camera {index} is not of this model, which has {count}")]
    UnknownCamera {
        /// Index of the camera requested.
        index: usize,
        /// Number of cameras of the renderer's model.
        count: usize,
    },
    /// Free camera with a value that is not finite, or without a distance.
    #[error("{camera} cannot draw: expected finite numbers and a distance above 0")]
    InvalidFreeCamera {
        /// Fields of the rejected camera.
        camera: String,
    },
    /// Scene with more geoms than the renderer has room for.
    #[error("the scene has more than {limit} geoms, some would be missing")]
    SceneFull {
        /// Number of geoms that the renderer has room for.
        limit: usize,
    },
    /// Backdrop (picture of the static geoms) that was never drawn, or whose drawing failed.
    #[error("nothing was drawn into this backdrop; call `render_backdrop` first")]
    NoBackdrop,
    /// Backdrop (picture of the static geoms) that another renderer drew.
    #[error("the backdrop was drawn by {drawn_by}, not by {used_by}; draw it with the latter")]
    OtherRenderer {
        /// Renderer that drew the backdrop.
        drawn_by: RendererId,
        /// Renderer that was called with the backdrop.
        used_by: RendererId,
    },
    /// Object that is not mirror-symmetric, such as a mesh, in a view with a mirror.
    #[error(
        "{what} {index} is not mirror-symmetric, as a mesh or a texture may not be; \
         draw it without a mirror"
    )]
    NotMirrorSymmetric {
        /// Kind of the object: `geom` or `skin`.
        what: &'static str,
        /// Index of the object in the model.
        index: usize,
    },
    /// Error reported by OpenGL, for instance a lost context (0x0507) or a lack of memory (0x0505).
    #[error(
        "OpenGL error {code:#06x} while {during}; pictures cannot be trusted: make a new renderer"
    )]
    OpenGl {
        /// Code of `glGetError`.
        code: u32,
        /// Operation of the renderer that failed.
        during: &'static str,
    },
    /// Context of the renderer that cannot be made current on this thread, for instance because it
    /// is lost.
    #[error(
        "the {backend} context cannot be made current, it may be lost: {reason}; \
         make a new renderer"
    )]
    MakeCurrentFailed {
        /// Backend of the renderer.
        backend: OpenGlBackend,
        /// Error of the backend in making the context current.
        reason: OpenGlContextError,
    },
    /// Context of the embedding program that cannot be made current again; the picture itself may
    /// be complete.
    #[error("the {backend} context that was current before cannot be made so again: {reason}")]
    RestoreContextFailed {
        /// Backend of the renderer.
        backend: OpenGlBackend,
        /// Error of the backend in making the earlier context current again.
        reason: OpenGlContextError,
    },
}

/// Error of an [`OpenGlBackend`] in making or using an OpenGL context.
#[derive(Debug, Clone, PartialEq, Eq, thiserror::Error)]
#[non_exhaustive]
pub enum OpenGlContextError {
    /// Shared library of OpenGL that cannot be loaded, or lacks a function.
    #[error("{library} cannot be used: {reason}")]
    LibraryUnusable {
        /// File name of the shared library.
        library: String,
        /// Message of the dynamic loader.
        reason: String,
    },
    /// Use of a second OpenGL library in a process that already draws through another one.
    #[error("this process draws through {in_use} already, and MuJoCo loads OpenGL once")]
    LibraryInUse {
        /// File name of the OpenGL library that the process uses.
        in_use: String,
    },
    /// EGL symbols visible to the whole process, which MuJoCo would prefer to OSMesa's.
    #[error("the program is linked to EGL, which MuJoCo would use with OSMesa's context")]
    LinkedToEgl,
    /// Missing extension of EGL that the backend needs.
    #[error("EGL does not offer {name}")]
    MissingEglExtension {
        /// Name of the missing EGL extension.
        name: &'static str,
    },
    /// Failed call of an EGL function.
    #[error("{call} failed with EGL error {code:#06x} ({meaning})")]
    EglCallFailed {
        /// Name of the EGL function.
        call: &'static str,
        /// Code of `eglGetError`.
        code: i32,
        /// Description of the error code.
        meaning: String,
    },
    /// Failed call of an OSMesa function, which gives no reason.
    #[error("{call} failed")]
    OsMesaCallFailed {
        /// Name of the OSMesa function.
        call: &'static str,
    },
    /// No graphics device listed by EGL.
    #[error("EGL lists no device")]
    NoDevice,
    /// Absence of a suitable framebuffer configuration.
    #[error("no configuration has OpenGL, 8-bit colours and 24-bit depth")]
    NoConfiguration,
    /// OpenGL feature that MuJoCo requires and the context lacks.
    #[error("OpenGL lacks {name}")]
    MissingOpenGlFeature {
        /// Name of the missing OpenGL extension.
        name: &'static str,
    },
}

fn attempts(tried: &[(OpenGlBackend, OpenGlContextError)]) -> String {
    tried.iter().map(|(backend, reason)| format!("\n  {backend}: {reason}")).collect()
}
