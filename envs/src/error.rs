//! Errors of environments: settings, tasks, embodiments and simulation.

use crate::task::TaskGroup;

/// Error of building or stepping an environment.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum EnvError {
    /// Task group whose name is not in the registry.
    #[error("unknown task `{name}`: expected one of {}", known.join(", "))]
    UnknownTask {
        /// Task name that is unknown.
        name: String,
        /// Names of the task groups in the registry.
        known: Vec<&'static str>,
    },
    /// Task name that is not in kebab-case.
    #[error(
        "the task's name is `{name}`, expected kebab-case: \
         lower-case letters and digits in words that are joined by hyphens"
    )]
    InvalidTaskName {
        /// Task name that is malformed.
        name: String,
    },
    /// Task group whose name another task group has already.
    #[error("another task group is called `{name}` already: choose another name")]
    DuplicateTask {
        /// Name that both task groups have.
        name: String,
    },
    /// Embodiment whose name is neither built in nor registered.
    #[error(
        "unknown embodiment `{name}`: expected one of {}, or the path of an arm's `.urdf` or \
         `.json`", known.join(", ")
    )]
    UnknownEmbodiment {
        /// Embodiment name that is unknown.
        name: String,
        /// Names of this crate's and of registered embodiments.
        known: Vec<&'static str>,
    },
    /// Embodiment name that is not words of lower-case letters and digits, joined by `-` or `_`.
    #[error(
        "the embodiment's name is `{name}`, expected lower-case letters and digits in words that \
         are joined by hyphens or underscores, or the path of an arm's `.urdf` or `.json`"
    )]
    InvalidEmbodimentName {
        /// Embodiment name that is malformed.
        name: String,
    },
    /// Embodiment whose name another embodiment has already.
    #[error("the embodiment name `{name}` is taken by another one: choose another name")]
    DuplicateEmbodiment {
        /// Name that both embodiments have.
        name: String,
    },
    /// Setting of an environment whose value is out of range.
    #[error("setting `{name}` is {value}, expected {expected}")]
    InvalidSetting {
        /// Name of the setting whose value is out of range.
        name: &'static str,
        /// Rejected value of the setting.
        value: String,
        /// Description of the setting's accepted values.
        expected: &'static str,
    },
    /// Action with a component that is NaN or infinite.
    #[error(
        "component {component} of the action is {value}, \
         expected a finite number (it is clipped to [-1, 1])"
    )]
    NonFiniteAction {
        /// Index of the action's component, 0 to 3.
        component: usize,
        /// Rejected value of the component.
        value: f32,
    },
    /// Slice argument of the wrong length.
    #[error("`{what}` has {got} elements, expected {expected}")]
    LengthMismatch {
        /// Name of the argument that has the wrong length.
        what: &'static str,
        /// Number of elements that the argument has.
        got: usize,
        /// Number of elements that the settings require.
        expected: usize,
    },
    /// Step before a reset, after the end of an episode, or after a failure of the simulation.
    #[error("no episode is running: call `reset` first")]
    NotReset,
    /// Error of one environment of a [`VecEnv`](crate::VecEnv).
    #[error("environment {index}: {source}")]
    InEnv {
        /// Index of the environment that failed, from 0.
        index: usize,
        /// Error of that environment.
        source: Box<EnvError>,
    },
    /// Task variant that the layout does not have.
    #[error(
        "the layout `{layout}` has no variant under {element}: \
         use `identity`, or the layout `symmetric`"
    )]
    NoSuchVariant {
        /// Name of the layout.
        layout: &'static str,
        /// Element of D2 of the requested variant.
        element: symmetry::D2,
    },
    /// Task group that the layout does not support.
    #[error(
        "the layout `{layout}` does not support {group}: \
         use the layout `symmetric`, or implement `Task::meta_world_settings` for the task"
    )]
    NoSuchLayout {
        /// Name of the layout.
        layout: &'static str,
        /// Task group that the layout does not support.
        group: TaskGroup,
    },
    /// Placement with a coordinate that is NaN or infinite.
    #[error("the placement's {what} is {value}, expected finite numbers of metres")]
    NonFinitePlacement {
        /// Part of the placement that is not finite: `object` or `goal`.
        what: &'static str,
        /// Rejected position (metres).
        value: glam::DVec3,
    },
    /// Command of a scripted expert that is NaN or infinite.
    #[error(
        "the expert of {group} commands the hand to {hand} and the fingers to {finger}, \
         expected finite numbers"
    )]
    NonFiniteCommand {
        /// Task group of the scripted expert.
        group: TaskGroup,
        /// Commanded target of the hand (metres, canonical frame).
        hand: glam::DVec3,
        /// Commanded finger action.
        finger: f64,
    },
    /// Snapshot of another scene, task, control or camera than those of the environment.
    #[error("the snapshot is of {got}, this environment is {expected}")]
    SceneMismatch {
        /// Task, embodiment, layout and control of the snapshot, or its camera and randomisation.
        got: String,
        /// Task, embodiment, layout and control of the environment, or its camera and
        /// randomisation.
        expected: String,
    },
    /// Empty set of variants to draw episodes from.
    #[error("no variants of {group} to draw from: name at least one element of D2")]
    NoVariants {
        /// Task group for which no variant was given.
        group: TaskGroup,
    },
    /// Panic while simulating one environment.
    #[error("the environment panicked: {message}")]
    Panicked {
        /// Message of the panic.
        message: String,
    },
    /// Use of a vector environment in another process than the one that made it.
    #[error(
        "the vector environment was made in process {made_in}, this is process {process}: a fork \
         does not copy its worker threads, so make environments after the fork, or use `spawn`"
    )]
    UsedAfterFork {
        /// Identifier of the process that made the vector environment.
        made_in: u32,
        /// Identifier of the calling process.
        process: u32,
    },
    /// Worker thread that ended without an answer.
    #[error("worker thread {worker} of the vector environment panicked: {message}")]
    WorkerLost {
        /// Index of the worker thread, from 0.
        worker: usize,
        /// Message of the panic that ended the worker thread.
        message: String,
    },
    /// Worker thread that could not be started.
    #[error("cannot start worker thread {worker}: {source}")]
    Spawn {
        /// Index of the worker thread, from 0.
        worker: usize,
        /// Error of the operating system.
        source: std::io::Error,
    },
    /// Robot arm from a file that cannot do the tasks, wherever its base stands.
    #[error(transparent)]
    OutOfReach(#[from] Box<ReachShortfall>),
    /// Fingers of a robot arm that cannot be used.
    #[error("the fingers {} and {} cannot be used: {reason}", .fingers[0], .fingers[1])]
    InvalidFingers {
        /// Names of the fingers' links.
        fingers: [String; 2],
        /// Reason for the rejection of the fingers.
        reason: &'static str,
    },
    /// Invalid robot description.
    #[error(transparent)]
    Robot(#[from] robots::DescriptionError),
    /// Robot target out of reach, or control settings out of range.
    #[error(transparent)]
    Control(#[from] robots::ControlError),
    /// Arm that cannot be painted out of a picture.
    #[error(transparent)]
    Inpainting(#[from] inpainting::InpaintingError),
    /// Scene that MuJoCo rejects, or that lacks a name.
    #[error(transparent)]
    Model(#[from] mujoco::ModelError),
    /// Simulation that diverged or was given invalid values.
    #[error(transparent)]
    Simulation(#[from] mujoco::SimError),
    /// Error of off-screen rendering.
    #[error(transparent)]
    Render(#[from] mujoco::RenderError),
}

/// Shortfall of an arm that does not reach all positions of the hand in the tasks.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[error(
    "the arm `{name}` cannot bring its hand, pointing down, to all positions of the four groups of \
     the paper. With its base at {base} m it reaches {reached} of {required}; the first that it \
     misses, {missed} m, is {distance:.2} m from the first joint, and the hand comes at most \
     {reach:.2} m from there. Use an arm with a longer reach, or correct `hand`, `approach_axis` \
     or `base_position` in a JSON file of its settings"
)]
pub struct ReachShortfall {
    /// Name of the robot.
    pub name: String,
    /// Number of required positions that the hand reaches.
    pub reached: usize,
    /// Number of positions of the hand in the tasks, all of which an arm must reach.
    pub required: usize,
    /// Position of the base from which the hand reaches the most (metres).
    pub base: glam::DVec3,
    /// First position that is not reached (metres).
    pub missed: glam::DVec3,
    /// Distance of that position from the first joint (metres), counted like `reach`.
    pub distance: f64,
    /// Bound on the distance of the hand from the first joint (metres):
    /// [`robots::Chain::max_reach`].
    pub reach: f64,
}

impl EnvError {
    /// Wraps the error with the index of the environment in which it occurred.
    pub(crate) fn in_env(self, index: usize) -> Self {
        Self::InEnv { index, source: Box::new(self) }
    }
}

/// Returns [`EnvError::InvalidSetting`] for the setting `name` unless `holds`.
pub(crate) fn require(
    holds: bool,
    name: &'static str,
    value: &dyn ToString,
    expected: &'static str,
) -> Result<(), EnvError> {
    if holds {
        return Ok(());
    }
    let value = value.to_string();
    Err(EnvError::InvalidSetting { name, value, expected })
}
