//! Training runs, and the policies that they leave.

use std::fs::create_dir_all;
use std::path::PathBuf;
use std::sync::{Mutex, MutexGuard, PoisonError};

use envs::TaskRegistry;
use experiments::evaluation::{OwnPolicyByGroup, average_scores_by_group, policy_of_group};
use experiments::presets::{Budget, Method};
use experiments::{
    Experiment, Run, RunError, RunEvent, RunFolder, SwitchableVecEnv, memory,
    scale_observation_vectors,
};
use learner::overrides::{SettingOverride, apply_overrides};
use learner::{Learner, LearnerError, TaskLabel};
use numpy::{PyReadonlyArray2, PyReadonlyArray4, PyReadwriteArray2};
use pyo3::exceptions::PyRuntimeError;
use pyo3::prelude::*;
use rl::{EnvSpec, Observations, RlError};
use serde::de::DeserializeOwned;
use serde_json::{Map, Value, json};

use crate::{environment_keywords, slice, value_error};

/// Run in progress, as `covers train` runs it.
#[pyclass(frozen, module = "covers_envs._core")]
pub struct TrainingRun(Mutex<Option<Run>>);

#[pymethods]
impl TrainingRun {
    /// Starts a run of a method's preset with changed settings, `path=value` each.
    #[staticmethod]
    fn start(
        py: Python<'_>,
        folder: PathBuf,
        method: &str,
        budget: &str,
        seed: u64,
        threads: usize,
        settings: Vec<String>,
    ) -> PyResult<Self> {
        let method: Method = parse_name("method", method)?;
        let budget: Budget = parse_name("budget", budget)?;
        let overrides = settings
            .iter()
            .map(|text| text.parse::<SettingOverride>().map_err(value_error))
            .collect::<PyResult<Vec<_>>>()?;
        let preset = budget.preset_experiment(method).with_seed(seed).with_threads(threads);
        let started = py.detach(|| {
            let run = apply_overrides(&overrides, preset)?;
            let experiment = method.adapt_to_stream(run, &overrides);
            // before the folder is created, so that a refused run leaves nothing
            experiment.check(&TaskRegistry::with_all())?;
            memory::check_run_memory(&experiment)?;
            create_dir_all(&folder).map_err(RunError::write_error_mapper(&folder))?;
            Run::start(experiment, RunFolder::from_path(&folder))
        });
        Ok(Self(Mutex::new(Some(started.map_err(error)?))))
    }

    /// Resumes the run in `folder` from its newest intact checkpoint.
    #[staticmethod]
    fn resume(py: Python<'_>, folder: PathBuf, threads: usize) -> PyResult<Self> {
        let resumed = py.detach(|| Run::resume(&folder, Some(threads)));
        Ok(Self(Mutex::new(Some(resumed.map_err(error)?))))
    }

    /// Trains on one more rollout or runs the evaluation that is due; returns its figures as a JSON
    /// object, None at the end.
    fn advance(&self, py: Python<'_>) -> PyResult<Option<String>> {
        self.with(py, |run| {
            let event = run.advance()?;
            Ok(event.map(|event| describe_event(&event, run).to_string()))
        })
    }

    /// Writes a checkpoint, unless the newest one is up to date or the run failed.
    fn save(&self, py: Python<'_>) -> PyResult<()> {
        self.with(py, |run| match run.save_checkpoint() {
            Err(RunError::FailedEarlier) => Ok(()),
            saved => saved,
        })
    }

    /// Returns the summary of the finished run, which is written to its folder, as a JSON object.
    fn summary(&self, py: Python<'_>) -> PyResult<String> {
        self.with(py, |run| Ok(json!(run.summary()?).to_string()))
    }

    /// Ends the run's threads and frees its folder, which a kept traceback would hold otherwise.
    fn close(&self, py: Python<'_>) {
        py.detach(|| drop(self.lock().take()));
    }
}

impl TrainingRun {
    fn lock(&self) -> MutexGuard<'_, Option<Run>> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }

    /// Runs `work` without the interpreter's lock, so that other Python threads continue.
    fn with<T: Send>(
        &self,
        py: Python<'_>,
        work: impl FnOnce(&mut Run) -> Result<T, RunError> + Send,
    ) -> PyResult<T> {
        py.detach(|| match self.lock().as_mut() {
            Some(run) => work(run).map_err(error),
            None => Err(PyRuntimeError::new_err("the run is closed: resume it")),
        })
    }
}

/// Returns the figures of an event of `run`, as `covers_envs.train` documents them.
fn describe_event(event: &RunEvent, run: &Run) -> Value {
    let total = run.experiment().schedule.total_decisions();
    match event {
        RunEvent::Rollout(rollout) => json!({
            "event": "rollout",
            "decisions": rollout.decisions,
            "total_decisions": total,
            "group": rollout.group.name(),
            "policy": rollout.iteration.policy,
            "policy_created": rollout.iteration.policy_created,
            "success": rollout.success_rate(),
            "return": rollout.scaled_mean_return(),
            "seconds": rollout.seconds,
        }),
        RunEvent::Evaluation(evaluation) => {
            let scores = average_scores_by_group(&evaluation.results.scores);
            let by_group =
                scores.into_iter().map(|score| (score.group.to_string(), json!(score.success)));
            json!({
                "event": "evaluation",
                "decisions": evaluation.decisions,
                "total_decisions": total,
                "success": by_group.collect::<Map<_, _>>(),
            })
        }
    }
}

/// Returns the settings of the environments of the run in `folder`, as `Core.settings` does.
#[pyfunction]
pub fn run_environment_settings(py: Python<'_>, folder: PathBuf) -> PyResult<String> {
    let experiment = py.detach(|| RunFolder::from_path(&folder).read_experiment());
    Ok(environment_keywords(&experiment.map_err(error)?.envs).to_string())
}

/// Policies of a run, from its newest checkpoint.
#[pyclass(frozen, module = "covers_envs._core")]
pub struct Policies {
    learner: Mutex<Box<dyn Learner>>,
    spec: EnvSpec,
    experiment: Experiment,
    own: OwnPolicyByGroup,
    labels: TaskLabel,
}

#[pymethods]
impl Policies {
    #[new]
    fn new(py: Python<'_>, folder: PathBuf) -> PyResult<Self> {
        py.detach(|| Self::read(&RunFolder::from_path(&folder))).map_err(error)
    }

    /// Returns the number of policies.
    fn count(&self) -> usize {
        self.lock().policy_count()
    }

    /// Returns the settings of the run's environments, as `Core.settings` does.
    fn settings(&self) -> String {
        environment_keywords(&self.experiment.envs).to_string()
    }

    /// Returns the index of a group's policy, and whether it fits; see [`policy_of_group`].
    fn policy_of_group(&self, py: Python<'_>, group: &str) -> PyResult<(usize, bool)> {
        let find = || {
            let (learner, labels) = (&mut **self.lock(), self.labels.clone());
            policy_of_group(group, &self.experiment, learner, &self.own, labels)
        };
        let found = py.detach(find).map_err(error)?;
        Ok((found.policy, found.fits))
    }

    /// Writes a policy's mean actions `[N, 4]` for observations: `images` `[N, size, size, C]` and
    /// `vectors` `[N, 10]`.
    fn actions(
        &self,
        py: Python<'_>,
        policy: usize,
        images: PyReadonlyArray4<'_, u8>,
        vectors: PyReadonlyArray2<'_, f32>,
        mut actions: PyReadwriteArray2<'_, f32>,
    ) -> PyResult<()> {
        let [height, width, channels] = self.spec.image_shape;
        let samples = vectors.as_array().nrows();
        let components = self.spec.vector_irreps.len();
        check_shape("images", images.as_array().shape(), &[samples, height, width, channels])?;
        check_shape("vectors", vectors.as_array().shape(), &[samples, components])?;
        let action_dim = self.spec.action_irreps.len();
        check_shape("actions", actions.as_array().shape(), &[samples, action_dim])?;
        let mut observations = Observations {
            images: images.as_slice().map_err(value_error)?.to_vec(),
            vectors: vectors.as_slice().map_err(value_error)?.to_vec(),
        };
        scale_observation_vectors(&mut observations.vectors);
        let output = py.detach(|| self.lock().policy_output(policy, &observations));
        let output = output.map_err(|problem| error(problem.into()))?;
        slice(&mut actions)?.copy_from_slice(&output.actions);
        Ok(())
    }
}

impl Policies {
    /// Reads the settings and the learner of a run, and the policies by group.
    fn read(folder: &RunFolder) -> Result<Self, RunError> {
        let (experiment, labels) = (folder.read_experiment()?, TaskLabel::default());
        let spec = SwitchableVecEnv::env_spec(&experiment.envs);
        let (learner, own) =
            folder.load_learner_with_own_policies(&experiment.learner, &spec, &labels)?;
        Ok(Self { learner: Mutex::new(learner), spec, experiment, own, labels })
    }

    fn lock(&self) -> MutexGuard<'_, Box<dyn Learner>> {
        self.learner.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

fn check_shape(what: &str, found: &[usize], expected: &[usize]) -> PyResult<()> {
    if found == expected {
        return Ok(());
    }
    let message = format!("{what} have the shape {found:?}, the policy expects {expected:?}");
    Err(value_error(message))
}

/// Returns the method or budget called `name`; the error lists all names.
fn parse_name<T: DeserializeOwned>(setting: &str, name: &str) -> PyResult<T> {
    let refused = |error| value_error(format!("setting `{setting}`: {error}"));
    serde_json::from_value(json!(name)).map_err(refused)
}

/// Converts an error: a mistake in the settings becomes a `ValueError`, other failures a
/// `RuntimeError`.
fn error(error: RunError) -> PyErr {
    let message = error.to_string();
    match error {
        RunError::InvalidSetting { .. }
        | RunError::SettingOutOfRange { .. }
        | RunError::Learner(
            LearnerError::InvalidSetting { .. }
            | LearnerError::UnknownSetting { .. }
            | LearnerError::WrongSetting { .. }
            | LearnerError::Rl(RlError::InvalidSetting { .. } | RlError::NeedsEpisode),
        )
        | RunError::Rl(RlError::InvalidSetting { .. }) => value_error(message),
        RunError::Env(source) => crate::error(source),
        _ => PyRuntimeError::new_err(message),
    }
}
