//! How a run begins, and how it goes on after an interruption.

use std::path::{Path, PathBuf};

use envs::TaskRegistry;

use crate::error::RunError;
use crate::experiment::Experiment;
use crate::memory;
use crate::sheet::contact_sheet;
use crate::stream::Stream;
use learner::overrides::same;
use learner::{DeviceChoice, Labels, Learner};

use crate::checkpoints::newest;
use crate::folder::RunFolder;
use crate::lock::Lock;
use crate::note::{Note, Signed};

/// A folder that nobody else can write to, and what runs there.
pub(crate) struct Claim {
    pub experiment: Experiment,
    pub tasks: TaskRegistry,
    pub folder: RunFolder,
    pub lock: Lock,
}

/// A run that is ready to go on.
pub(crate) struct Opened {
    pub claim: Claim,
    pub learner: Box<dyn Learner>,
    pub labels: Labels,
    pub note: Note,
    /// Checkpoints that could not be read.
    pub passed_over: Vec<PathBuf>,
    /// What is to be told about the beginning.
    pub notice: String,
}

/// Begins a run in a folder without one.
pub(crate) fn start(
    experiment: Experiment,
    tasks: TaskRegistry,
    folder: RunFolder,
) -> Result<Opened, RunError> {
    experiment.check(&tasks)?;
    memory::check_run(&experiment)?;
    let (folder, lock) = folder.lock()?;
    if !folder.is_free()? {
        return Err(RunError::Occupied { folder: folder.path().to_owned() });
    }
    let claim = Claim { experiment, tasks, folder, lock };
    begin(claim, true, "begun".to_owned())
}

/// Begins; a `new` run removes what is there of another and leaves its settings.
fn begin(claim: Claim, new: bool, notice: String) -> Result<Opened, RunError> {
    let (experiment, folder) = (&claim.experiment, &claim.folder);
    let groups = experiment.schedule.resolve(&claim.tasks)?;
    // First of all, while the process has one thread: loading a model tunes software rendering
    // by an environment variable.
    let sheet = contact_sheet(&experiment.envs, &groups)?;
    let (spec, labels) = (Stream::spec_of(&experiment.envs), Labels::default());
    let learner = experiment.learner.start(&spec, &labels)?;
    // what can fail for other reasons than the disk's has not failed
    if new {
        folder.clear()?;
        folder.write_experiment(experiment)?;
    }
    folder.write_png("contact_sheet.png", &sheet)?;
    let note = Note {
        // what the untrained learner can do, which transfer is measured against
        due: experiment.evaluation.visit_rounds,
        ..Note::default()
    };
    Ok(Opened { learner, claim, labels, note, passed_over: Vec::new(), notice })
}

/// Goes on from the newest intact checkpoint in `folder`, or from the beginning where there is
/// none.
pub(crate) fn resume(
    folder: RunFolder,
    (threads, device): (Option<usize>, DeviceChoice),
    tasks: TaskRegistry,
) -> Result<Opened, RunError> {
    if !folder.holds_run() {
        let folder = folder.path().to_owned();
        return Err(RunError::NoRun { folder });
    }
    let (folder, lock) = folder.lock()?;
    let mut experiment = folder.experiment()?.with_device(device)?;
    experiment.envs.threads = threads.unwrap_or(experiment.envs.threads);
    experiment.check(&tasks)?;
    memory::check_run(&experiment)?;
    let claim = Claim { lock, experiment, tasks, folder };
    let experiment = &claim.experiment;
    let (spec, labels) = (Stream::spec_of(&experiment.envs), Labels::default());
    let read = |path: &Path| {
        let (learner, note) = experiment.learner.resume(path, &spec, &labels)?;
        let mut signed = Signed::parse(path, &note)?;
        signed.recount(path)?;
        Ok((learner, signed))
    };
    let Some(found) = newest(&claim.folder.checkpoints(), read)? else {
        if claim.folder.is_finished() {
            return Err(RunError::NoCheckpoint {
                folder: claim.folder.path().to_owned(),
                problems: "the run has ended, and its checkpoints were removed".to_owned(),
            });
        }
        let notice = "there is no checkpoint yet: begun anew".to_owned();
        return begin(claim, false, notice);
    };
    let (learner, signed) = found.value;
    same(&found.path, &experiment.clone().with_threads(1), &signed.experiment)?;
    let mut notice = notice(&signed.note, &found.path, &found.problems);
    if !claim.folder.holds_settings() {
        claim.folder.write_experiment(experiment)?;
        notice += "; experiment.json was lost and is written again";
    }
    Ok(Opened { notice, passed_over: found.passed_over, claim, learner, labels, note: signed.note })
}

/// What is told about a resumption.
fn notice(note: &Note, path: &Path, problems: &[String]) -> String {
    let rollouts = note.ledger.rollouts;
    let mut notice = format!("goes on after {rollouts} rollouts from {}", path.display());
    for problem in problems {
        notice = format!("{notice}; passed over a newer checkpoint: {problem}");
    }
    notice
}
