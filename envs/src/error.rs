//! What can go wrong in this crate.

use crate::task::TaskGroup;

/// Error of building or stepping an environment.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum EnvError {
    /// A task name that no group has.
    #[error("unknown task `{name}`: expected one of {}", known.join(", "))]
    UnknownTask {
        /// The name given.
        name: String,
        /// The names of the registry.
        known: Vec<&'static str>,
    },
    /// A task's name that options and files cannot spell.
    #[error(
        "the task's name is `{name}`, expected kebab-case: \
         lower-case letters and digits in words that are joined by hyphens"
    )]
    TaskName {
        /// The name given.
        name: String,
    },
    /// A second group of one name.
    #[error("another task group is called `{name}` already: choose another name")]
    DuplicateTask {
        /// The name given.
        name: String,
    },
    /// An embodiment's name that none has.
    #[error("unknown embodiment `{name}`: expected one of {}", known.join(", "))]
    UnknownEmbodiment {
        /// The name given.
        name: String,
        /// The names that exist: the crate's and the registered ones.
        known: Vec<&'static str>,
    },
    /// An embodiment's name that settings cannot spell.
    #[error(
        "the embodiment's name is `{name}`, expected lower-case letters and digits in words that \
         are joined by hyphens or underscores"
    )]
    EmbodimentName {
        /// The name given.
        name: String,
    },
    /// A second embodiment of one name.
    #[error("the embodiment name `{name}` is taken by another one: choose another name")]
    DuplicateEmbodiment {
        /// The name given.
        name: String,
    },
    /// A setting outside its range.
    #[error("setting `{name}` is {value}, expected {expected}")]
    Setting {
        /// Name of the setting.
        name: &'static str,
        /// The value given.
        value: String,
        /// What would be accepted.
        expected: &'static str,
    },
    /// An action that is not a number.
    #[error(
        "component {component} of the action is {value}, \
         expected a finite number (it is clipped to [-1, 1])"
    )]
    NonFiniteAction {
        /// Index of the component, 0..4.
        component: usize,
        /// The value given.
        value: f32,
    },
    /// A slice of the wrong length.
    #[error("`{what}` has {got} elements, expected {expected}")]
    Length {
        /// What the slice holds.
        what: &'static str,
        /// Its length.
        got: usize,
        /// The length that the settings ask for.
        expected: usize,
    },
    /// An environment was stepped before a reset, after its episode's end, or after its simulation
    /// failed.
    #[error("no episode is running: call `reset` first")]
    NotReset,
    /// One environment of many.
    #[error("environment {index}: {source}")]
    InEnv {
        /// Index of the environment.
        index: usize,
        /// What happened there.
        source: Box<EnvError>,
    },
    /// A variant that a layout does not have.
    #[error(
        "the layout `{layout}` has no variant under {element}: \
         use `identity`, or the layout `symmetric`"
    )]
    NoSuchVariant {
        /// The layout.
        layout: &'static str,
        /// The element asked for.
        element: symmetry::D2,
    },
    /// A group that a layout has no figures for.
    #[error(
        "the layout `{layout}` has no figures of {group}: \
         use the layout `symmetric`, or give the task `Task::stock`"
    )]
    NoSuchLayout {
        /// The layout.
        layout: &'static str,
        /// The group.
        group: TaskGroup,
    },
    /// A placement that is not a number.
    #[error("the placement's {what} is {value}, expected finite numbers of metres")]
    NonFinitePlacement {
        /// `object` or `goal`.
        what: &'static str,
        /// The value given.
        value: glam::DVec3,
    },
    /// A scripted expert's command that is not a number.
    #[error(
        "the expert of {group} asks for the hand at {hand} and fingers of {finger}, \
         expected finite numbers"
    )]
    NonFiniteCommand {
        /// The group.
        group: TaskGroup,
        /// Where the hand should go (metres, canonical frame).
        hand: glam::DVec3,
        /// The finger action.
        finger: f64,
    },
    /// A snapshot of another scene.
    #[error("the snapshot is of {got}, this environment is {expected}")]
    OtherScene {
        /// Task, embodiment, layout and control of the snapshot.
        got: String,
        /// Those of the environment.
        expected: String,
    },
    /// No variants to draw from.
    #[error("no variants of {group} to draw from: name at least one element of D2")]
    NoVariants {
        /// The group.
        group: TaskGroup,
    },
    /// Simulating one environment panicked.
    #[error("the environment panicked: {message}")]
    Panicked {
        /// What it said.
        message: String,
    },
    /// A vector environment in another process than the one that made it.
    #[error(
        "the vector environment was made in process {made_in}, this is process {process}: a fork \
         does not copy its worker threads, so make environments after the fork, or use `spawn`"
    )]
    OtherProcess {
        /// Identifier of the process that made it.
        made_in: u32,
        /// Identifier of the process that calls it.
        process: u32,
    },
    /// A worker thread ended without an answer.
    #[error("worker thread {worker} of the vector environment panicked: {message}")]
    WorkerLost {
        /// Index of the worker.
        worker: usize,
        /// What it said.
        message: String,
    },
    /// A worker thread could not be started.
    #[error("cannot start worker thread {worker}: {source}")]
    Spawn {
        /// Index of the worker.
        worker: usize,
        /// The operating system's reason.
        source: std::io::Error,
    },
    /// A robot that is not described well.
    #[error(transparent)]
    Robot(#[from] robots::DescriptionError),
    /// A robot that cannot be where it should be, or control settings out of range.
    #[error(transparent)]
    Control(#[from] robots::ControlError),
    /// A scene that MuJoCo does not take, or that lacks a name.
    #[error(transparent)]
    Model(#[from] mujoco::ModelError),
    /// A simulation that diverged or was given bad values.
    #[error(transparent)]
    Simulation(#[from] mujoco::SimError),
    /// Off-screen rendering.
    #[error(transparent)]
    Render(#[from] mujoco::RenderError),
}

impl EnvError {
    /// Says which environment of many the error is from.
    pub(crate) fn of(self, index: usize) -> Self {
        Self::InEnv { index, source: Box::new(self) }
    }
}

/// Refuses a setting where a condition does not hold.
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
    Err(EnvError::Setting { name, value, expected })
}
