//! Native part of the Python package `covers_envs`: an [`envs::VecEnv`] that fills NumPy arrays.
//! Spaces, autoreset modes and infos are in the Python part, `covers_envs/`. The module `training`
//! runs learners.
#![forbid(unsafe_code)]
#![deny(missing_docs, clippy::unwrap_used, clippy::expect_used)]

mod task;
mod training;

use std::sync::{Mutex, PoisonError};

use envs::{
    Camera, Embodiment, EnvCommand, EnvError, EnvFailure, EnvSnapshot, Layout, ObservationsMut,
    StepResultsMut, ViewSettings, VisualDomainRandomisation,
};
use envs::{VecEnv, VecEnvSettings};
use numpy::{Element, PyReadonlyArray1, PyReadonlyArray2};
use numpy::{PyReadwriteArray, PyReadwriteArray1, PyReadwriteArray2, PyReadwriteArray4};
use pyo3::exceptions::{PyRuntimeError, PyValueError};
use pyo3::prelude::*;
use serde_json::{Map, Value, json};

/// Indices of environments that failed, with their error messages.
type Failures = Vec<(usize, String)>;

/// Arrays that [`StepResultsMut`] borrows, in the order of its fields.
type Out<'py> = (
    PyReadwriteArray4<'py, u8>,
    PyReadwriteArray2<'py, f32>,
    PyReadwriteArray4<'py, u8>,
    PyReadwriteArray2<'py, f32>,
    Outcome<'py>,
);

/// Arrays of rewards, success, success at the end, and truncation, each `[N]`.
type Outcome<'py> = (
    PyReadwriteArray1<'py, f32>,
    PyReadwriteArray1<'py, bool>,
    PyReadwriteArray1<'py, bool>,
    PyReadwriteArray1<'py, bool>,
);

/// Environments of one task group. Every call releases the interpreter's lock.
#[pyclass(frozen, module = "covers_envs._core")]
struct Core {
    env: Mutex<Option<VecEnv>>,
    /// Identifier of the process that created the environments. It is outside the mutex, which a
    /// forked child inherits locked for ever if another thread held it.
    process: u32,
}

/// Saved episodes of all environments.
#[pyclass(frozen, module = "covers_envs._core")]
struct Episodes(Vec<EnvSnapshot>);

#[pymethods]
impl Core {
    #[new]
    #[pyo3(signature = (tasks, num_envs, threads, camera, layout, embodiment, randomisation, *,
                        action_repeat = None, displacement = None, horizon = None,
                        decisions = None))]
    #[expect(clippy::too_many_arguments, reason = "keywords of one Python call")]
    fn new(
        py: Python<'_>,
        tasks: Vec<String>,
        num_envs: usize,
        threads: usize,
        camera: &str,
        layout: &str,
        embodiment: &str,
        randomisation: Option<&str>,
        action_repeat: Option<usize>,
        displacement: Option<f64>,
        horizon: Option<usize>,
        decisions: Option<usize>,
    ) -> PyResult<Self> {
        let layout = find_layout(layout)?;
        let mut settings = VecEnvSettings {
            num_envs,
            threads,
            layout,
            embodiment: embodiment.parse::<Embodiment>().map_err(error)?,
            camera: find_camera(camera)?,
            // each layout has its own control; keywords override its parts below
            control: layout.control_settings(),
            randomisation: find_randomisation(randomisation)?,
            ..VecEnvSettings::default()
        };
        let control = &mut settings.control;
        control.action_repeat = action_repeat.unwrap_or(control.action_repeat);
        control.displacement = displacement.unwrap_or(control.displacement);
        control.horizon = match (horizon, decisions) {
            (Some(_), Some(_)) => {
                let message = "settings `horizon` and `max_episode_steps` both say how many steps \
                               an episode has: give one of them";
                return Err(value_error(message));
            }
            (None, Some(decisions)) => decisions.saturating_mul(control.action_repeat),
            (horizon, None) => horizon.unwrap_or(control.horizon),
        };
        let (group, elements) = task::parse_group_and_variants(&tasks, layout)?;
        let env = py.detach(|| VecEnv::new(settings, group, &elements));
        Ok(Self { env: Mutex::new(Some(env.map_err(error)?)), process: std::process::id() })
    }

    /// Returns the number of decisions in an episode.
    fn decisions(&self, py: Python<'_>) -> PyResult<usize> {
        self.with(py, |env| Ok(env.settings().control.decisions_per_episode()))
    }

    /// Returns the number of channels of an observation's image.
    fn image_channels(&self, py: Python<'_>) -> PyResult<usize> {
        self.with(py, |env| Ok(env.settings().camera.extra_views.num_total_channels()))
    }

    /// Returns the settings that determine observations and the effect of actions: keywords of
    /// `CoversVectorEnv`, as a JSON object.
    fn settings(&self, py: Python<'_>) -> PyResult<String> {
        self.with(py, |env| Ok(environment_keywords(env.settings()).to_string()))
    }

    fn reseed(&self, py: Python<'_>, seed: u64) -> PyResult<()> {
        self.with(py, |env| env.reseed(seed))
    }

    fn reseed_each(&self, py: Python<'_>, seeds: Vec<u64>) -> PyResult<()> {
        self.with(py, |env| env.reseed_each(&seeds))
    }

    fn set_tasks(&self, py: Python<'_>, tasks: Vec<String>) -> PyResult<()> {
        let layout = self.with(py, |env| Ok(env.settings().layout))?;
        let (group, elements) = task::parse_group_and_variants(&tasks, layout)?;
        self.with(py, |env| env.set_task_group(group, &elements))
    }

    /// Advances every environment by its entry of `commands`, `[N]`: 0 steps, 1 steps without
    /// automatic reset, 2 resets, 3 rests. Returns the failures.
    fn advance(
        &self,
        py: Python<'_>,
        actions: PyReadonlyArray2<'_, f32>,
        commands: PyReadonlyArray1<'_, u8>,
        out: Out<'_>,
    ) -> PyResult<Failures> {
        let actions = actions.as_slice().map_err(value_error)?;
        let commands = commands.as_array().into_iter().map(|&code| find_command(code));
        let commands = commands.collect::<PyResult<Vec<EnvCommand>>>()?;
        let (mut images, mut vectors, mut final_images, mut final_vectors, ended) = out;
        let (mut rewards, mut success, mut success_at_end, mut truncated) = ended;
        let step = StepResultsMut {
            observations: ObservationsMut {
                images: slice(&mut images)?,
                vectors: slice(&mut vectors)?,
            },
            final_observations: ObservationsMut {
                images: slice(&mut final_images)?,
                vectors: slice(&mut final_vectors)?,
            },
            rewards: slice(&mut rewards)?,
            success: slice(&mut success)?,
            success_at_end: slice(&mut success_at_end)?,
            truncated: slice(&mut truncated)?,
        };
        self.with(py, |env| Ok(texts(env.execute_commands(actions, &commands, step)?)))
    }

    /// Writes the scripted experts' actions for the current states, `[N, 4]`.
    fn expert_actions(
        &self,
        py: Python<'_>,
        mut actions: PyReadwriteArray2<'_, f32>,
    ) -> PyResult<()> {
        let actions = slice(&mut actions)?;
        self.with(py, |env| env.expert_actions(actions))
    }

    /// Writes the details of the present states, `[N, DETAILS_DIM]`.
    fn details(&self, py: Python<'_>, mut details: PyReadwriteArray2<'_, f32>) -> PyResult<()> {
        let details = slice(&mut details)?;
        self.with(py, |env| env.state_details(details))
    }

    /// Renders the present states in a view, `[N, size, size, 3]`.
    fn render(
        &self,
        py: Python<'_>,
        camera: &str,
        arm: bool,
        mut pictures: PyReadwriteArray4<'_, u8>,
    ) -> PyResult<()> {
        let size = pictures.as_array().shape()[1];
        let view = ViewSettings { from_corner: camera == "corner", shows_arm: arm, size };
        let pictures = slice(&mut pictures)?;
        self.with(py, |env| env.render(view, pictures))
    }

    fn save(&self, py: Python<'_>) -> PyResult<Episodes> {
        self.with(py, VecEnv::save).map(Episodes)
    }

    /// Restores episodes, and writes their last observations.
    fn restore(
        &self,
        py: Python<'_>,
        episodes: &Episodes,
        mut images: PyReadwriteArray4<'_, u8>,
        mut vectors: PyReadwriteArray2<'_, f32>,
    ) -> PyResult<()> {
        let out = ObservationsMut { images: slice(&mut images)?, vectors: slice(&mut vectors)? };
        self.with(py, |env| env.restore(&episodes.0, out))
    }

    /// Ends the worker threads. A forked child has none, and nothing happens there.
    fn close(&self, py: Python<'_>) {
        if self.require_own_process().is_ok() {
            py.detach(|| drop(self.lock().take()));
        }
    }

    /// Raises an error in a forked child, which has no worker threads.
    fn require_own_process(&self) -> PyResult<()> {
        let (made_in, process) = (self.process, std::process::id());
        if made_in == process {
            return Ok(());
        }
        Err(error(EnvError::UsedAfterFork { made_in, process }))
    }
}

impl Drop for Core {
    fn drop(&mut self) {
        // a fork in the middle of another thread's call leaves environments in an inconsistent
        // state, which must not be dropped
        if self.require_own_process().is_err() {
            let env = self.env.get_mut().unwrap_or_else(PoisonError::into_inner);
            std::mem::forget(env.take());
        }
    }
}

impl Core {
    fn lock(&self) -> std::sync::MutexGuard<'_, Option<VecEnv>> {
        self.env.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Runs `work` without the interpreter's lock, so that other Python threads continue.
    fn with<T: Send>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&mut VecEnv) -> Result<T, EnvError> + Send,
    ) -> PyResult<T> {
        self.require_own_process()?;
        py.detach(|| match self.lock().as_mut() {
            Some(env) => work(env).map_err(error),
            None => {
                let message = "the environment is closed: make a new one";
                Err(PyRuntimeError::new_err(message))
            }
        })
    }
}

/// Returns the settings that determine observations and the effect of actions, as a JSON object:
/// keywords of `CoversVectorEnv`.
fn environment_keywords(settings: &VecEnvSettings) -> Value {
    json!({
        "layout": settings.layout,
        "embodiment": settings.embodiment,
        "camera": settings.camera,
        "randomisation": settings.randomisation,
        "action_repeat": settings.control.action_repeat,
        "displacement": settings.control.displacement,
        "horizon": settings.control.horizon,
    })
}

fn find_command(code: u8) -> PyResult<EnvCommand> {
    // the order is that of the codes in `covers_envs/vector.py`
    let commands =
        [EnvCommand::Step, EnvCommand::StepNoAutoReset, EnvCommand::Reset, EnvCommand::Idle];
    let found = commands.get(usize::from(code)).copied();
    found.ok_or_else(|| value_error(format!("command {code}, expected 0 to 3")))
}

fn find_layout(name: &str) -> PyResult<Layout> {
    let found = Layout::ALL.into_iter().find(|layout| layout.name() == name);
    found.ok_or_else(|| {
        let known = Layout::ALL.map(Layout::name).join(", ");
        value_error(format!("unknown layout `{name}`: expected one of {known}"))
    })
}

/// Returns the default camera with the fields of a JSON object in place of its own.
fn find_camera(fields: &str) -> PyResult<Camera> {
    let refused = |error| value_error(format!("setting `camera`: {error}"));
    let fields: Map<String, Value> = serde_json::from_str(fields).map_err(refused)?;
    let mut camera = json!(Camera::default());
    for (name, value) in fields {
        camera[name] = value;
    }
    serde_json::from_value(camera).map_err(refused)
}

/// Returns the randomisation of a JSON object, with defaults for fields that it lacks.
fn find_randomisation(fields: Option<&str>) -> PyResult<Option<VisualDomainRandomisation>> {
    let refused = |error| value_error(format!("setting `randomisation`: {error}"));
    fields.map(|fields| serde_json::from_str(fields).map_err(refused)).transpose()
}

fn texts(failures: &[EnvFailure]) -> Failures {
    let text = |failure: &EnvFailure| (failure.env, failure.error.to_string());
    failures.iter().map(text).collect()
}

fn slice<'a, T: Element, D: numpy::ndarray::Dimension>(
    array: &'a mut PyReadwriteArray<'_, T, D>,
) -> PyResult<&'a mut [T]> {
    array.as_slice_mut().map_err(value_error)
}

fn value_error(message: impl ToString) -> PyErr {
    PyValueError::new_err(message.to_string())
}

/// Converts an error: a mistake of the caller becomes a `ValueError`, other failures a
/// `RuntimeError`.
fn error(error: EnvError) -> PyErr {
    let message = error.to_string();
    // the position in the vector is wrapped around the error that decides
    let mut cause = &error;
    while let EnvError::InEnv { source, .. } = cause {
        cause = source;
    }
    match cause {
        EnvError::UnknownTask { .. }
        | EnvError::UnknownEmbodiment { .. }
        | EnvError::InvalidSetting { .. }
        | EnvError::NonFiniteAction { .. }
        | EnvError::LengthMismatch { .. }
        | EnvError::SceneMismatch { .. }
        | EnvError::NoSuchVariant { .. }
        | EnvError::NoSuchLayout { .. }
        | EnvError::NoVariants { .. } => PyValueError::new_err(message),
        _ => PyRuntimeError::new_err(message),
    }
}

#[pymodule]
mod _core {
    #[pymodule_export]
    use super::Core;
    #[pymodule_export]
    use super::training::Policies;
    #[pymodule_export]
    use super::training::TrainingRun;
    #[pymodule_export]
    use super::training::run_environment_settings;
    #[pymodule_export]
    const ACTION_DIM: usize = envs::ACTION_DIM;
    #[pymodule_export]
    const DETAILS_DIM: usize = envs::STATE_DETAILS_DIM;

    /// Returns the indices of the irreps of the vector observation's components.
    #[pyo3::pyfunction]
    fn vector_irreps() -> Vec<usize> {
        envs::VECTOR_OBSERVATION_IRREPS.map(|irrep| irrep.index()).to_vec()
    }

    /// Returns the indices of the irreps of the action's components.
    #[pyo3::pyfunction]
    fn action_irreps() -> Vec<usize> {
        envs::ACTION_IRREPS.map(|irrep| irrep.index()).to_vec()
    }

    /// Returns the names of the groups, then those of their variants.
    #[pyo3::pyfunction]
    fn task_names() -> Vec<String> {
        super::task::task_names()
    }

    /// Returns the sets of groups, each with the names of its groups.
    #[pyo3::pyfunction]
    fn task_sets() -> Vec<(&'static str, Vec<&'static str>)> {
        super::task::task_sets()
    }
}
