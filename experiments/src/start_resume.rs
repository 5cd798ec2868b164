//! Start of a run, and its resumption after an interruption.

use std::path::{Path, PathBuf};

use envs::TaskRegistry;

use crate::error::RunError;
use crate::experiment::Experiment;
use crate::memory;
use crate::sheet::contact_sheet;
use crate::stream::SwitchableVecEnv;
use learner::overrides::check_same_settings;
use learner::{DeviceChoice, Learner, TaskLabel};

use crate::checkpoints::read_newest;
use crate::folder::RunFolder;
use crate::lock::FolderLock;
use crate::note::{RunState, SavedRun};

/// Locked folder of a run with the settings of that run.
pub(crate) struct LockedRun {
    pub experiment: Experiment,
    pub tasks: TaskRegistry,
    pub folder: RunFolder,
    /// Lock of the folder, on the first rank.
    pub lock: Option<FolderLock>,
}

/// Run that is ready to train.
pub(crate) struct PreparedRun {
    pub locked: LockedRun,
    pub learner: Box<dyn Learner>,
    pub labels: TaskLabel,
    pub state: RunState,
    /// Paths of checkpoints that could not be read.
    pub unreadable_checkpoints: Vec<PathBuf>,
    /// Message about the start or the resumption.
    pub start_message: String,
}

/// Prepares a new run in `folder`, which must not hold another run.
pub(crate) fn start(
    mut experiment: Experiment,
    tasks: TaskRegistry,
    folder: RunFolder,
) -> Result<PreparedRun, RunError> {
    experiment.learner.set_process_ranks(folder.process_ranks().clone())?;
    experiment.check(&tasks)?;
    memory::check_run_memory(&experiment)?;
    let (folder, lock) = folder.lock()?;
    folder.check_accepts_new_run()?;
    let locked = LockedRun { experiment, tasks, folder, lock };
    begin(locked, true, "begun".to_owned())
}

/// Prepares a run from its first rollout on. A `new` run first removes the files of another run
/// and writes its settings.
fn begin(locked: LockedRun, new: bool, start_message: String) -> Result<PreparedRun, RunError> {
    let (experiment, folder) = (&locked.experiment, &locked.folder);
    let groups = experiment.schedule.resolve_groups(&locked.tasks)?;
    // First of all, while the process has one thread: loading a model sets an environment variable
    // for software rendering.
    let sheet = contact_sheet(&experiment.envs, &groups)?;
    let (spec, labels) = (SwitchableVecEnv::env_spec(&experiment.envs), TaskLabel::default());
    let learner = experiment.learner.new_learner(&spec, &labels)?;
    // from here on only the disk can fail, so no invalid settings cost the files of another run
    if new {
        folder.remove_run_files()?;
        folder.write_experiment(experiment)?;
    }
    folder.write_png("contact_sheet.png", &sheet)?;
    let state = RunState {
        // the scores of the untrained learner are the baseline of transfer
        due_episodes_per_env: experiment.evaluation.visit_episodes_per_env,
        ..RunState::default()
    };
    Ok(PreparedRun {
        learner,
        locked,
        labels,
        state,
        unreadable_checkpoints: Vec::new(),
        start_message,
    })
}

/// Prepares the run in `folder` to continue from its newest intact checkpoint, or from the
/// beginning if it has none yet. `threads` is `None` for the number in the run's settings.
pub(crate) fn resume(
    folder: RunFolder,
    threads: Option<usize>,
    device: DeviceChoice,
    tasks: TaskRegistry,
) -> Result<PreparedRun, RunError> {
    if !folder.holds_run() {
        return Err(folder.no_run());
    }
    let (folder, lock) = folder.lock()?;
    let mut experiment = folder.read_experiment()?.with_device(device)?;
    folder.verify_robot(&experiment)?;
    experiment.learner.set_process_ranks(folder.process_ranks().clone())?;
    experiment.envs.threads = threads.unwrap_or(experiment.envs.threads);
    experiment.check(&tasks)?;
    memory::check_run_memory(&experiment)?;
    let locked = LockedRun { lock, experiment, tasks, folder };
    let settings = &locked.experiment;
    let (spec, labels) = (SwitchableVecEnv::env_spec(&settings.envs), TaskLabel::default());
    let read = |path: &Path| {
        let (learner, note) = settings.learner.load_for_training(path, &spec, &labels)?;
        let mut saved = SavedRun::parse(path, &note)?;
        saved.recount_rollouts(path)?;
        Ok((learner, saved))
    };
    let Some(found) = read_newest(&locked.folder.checkpoint_folder(), read)? else {
        // a finished run always has a checkpoint, and starting again would replace its results
        if locked.folder.is_finished() {
            return Err(RunError::NoCheckpoint {
                folder: locked.folder.path().to_owned(),
                problems: "the run has ended, and its checkpoints were removed".to_owned(),
            });
        }
        let notice = "there is no checkpoint yet: started from the beginning".to_owned();
        return begin(locked, false, notice);
    };
    let (learner, saved) = found.contents;
    check_same_settings(&found.path, &settings.clone().with_threads(1), &saved.experiment)?;
    let mut start_message = resumption_message(&saved.state, &found.path, &found.problems);
    if !locked.folder.holds_settings() {
        locked.folder.write_experiment(settings)?;
        start_message += "; experiment.json was lost and is written again";
    }
    let (unreadable_checkpoints, state) = (found.unreadable, saved.state);
    Ok(PreparedRun { start_message, unreadable_checkpoints, locked, learner, labels, state })
}

/// Returns the message about a resumption: its checkpoint, and the damaged ones that were skipped.
fn resumption_message(state: &RunState, path: &Path, problems: &[String]) -> String {
    let rollouts = state.stats.rollouts;
    let mut notice = format!("continues after {rollouts} rollouts from {}", path.display());
    for problem in problems {
        notice = format!("{notice}; passed over a newer checkpoint: {problem}");
    }
    notice
}
