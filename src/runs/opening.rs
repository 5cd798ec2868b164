//! How a run begins, and how it goes on after an interruption.

use std::path::Path;

use envs::TaskRegistry;
use serde::{Deserialize, Serialize};

use crate::error::CoversError;
use crate::experiment::Experiment;
use crate::groupings::Labels;
use crate::learners::Learner;
use crate::overrides::same;
use crate::sheet::contact_sheet;
use crate::stream::Stream;

use super::checkpoints::newest;
use super::folder::RunFolder;
use super::ledger::Ledger;
use super::lock::Lock;
use super::logs::Rows;

/// What a checkpoint says beside the learner itself.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(super) struct Note {
    pub ledger: Ledger,
    /// Rounds of an evaluation that is still due after the last rollout.
    pub due: usize,
    pub rows: Rows,
}

/// The note with the settings that the run had; without them for reading.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Signed {
    experiment: Experiment,
    note: Note,
}

impl Note {
    /// The note of a checkpoint of a run with these settings.
    pub fn sign(self, experiment: &Experiment) -> Result<String, serde_json::Error> {
        serde_json::to_string(&Signed {
            // nothing depends on threads, checkpoints included
            experiment: experiment.clone().with_threads(1),
            note: self,
        })
    }
}

/// A folder that nobody else can write to, and what runs there.
pub(super) struct Claim {
    pub experiment: Experiment,
    pub tasks: TaskRegistry,
    pub folder: RunFolder,
    pub lock: Lock,
}

/// A run that is ready to go on.
pub(super) struct Opened {
    pub claim: Claim,
    pub learner: Box<dyn Learner>,
    pub labels: Labels,
    pub note: Note,
    /// What is to be told about the beginning.
    pub notice: String,
}

/// Begins a run in a folder without one.
pub(super) fn start(
    experiment: Experiment,
    tasks: TaskRegistry,
    folder: RunFolder,
) -> Result<Opened, CoversError> {
    experiment.check(&tasks)?;
    let lock = Lock::take(folder.path())?;
    if folder.holds_run() {
        return Err(CoversError::Occupied {
            folder: folder.path().to_owned(),
        });
    }
    folder.write_experiment(&experiment)?;
    let claim = Claim {
        experiment,
        tasks,
        folder,
        lock,
    };
    begin(claim, "begun".to_owned())
}

fn begin(claim: Claim, notice: String) -> Result<Opened, CoversError> {
    let experiment = &claim.experiment;
    let groups = experiment.schedule.resolve(&claim.tasks)?;
    // First of all, while the process has one thread: loading a model tunes software rendering
    // by an environment variable.
    let sheet = contact_sheet(&experiment.envs, &groups)?;
    claim.folder.write_png("contact_sheet.png", &sheet)?;
    let (spec, labels) = (Stream::spec_of(&experiment.envs), Labels::default());
    Ok(Opened {
        learner: experiment.learner.start(&spec, &labels)?,
        claim,
        labels,
        note: Note::default(),
        notice,
    })
}

/// Goes on from the newest intact checkpoint in `folder`, or from the beginning where there is none.
pub(super) fn resume(
    folder: RunFolder,
    threads: Option<usize>,
    tasks: TaskRegistry,
) -> Result<Opened, CoversError> {
    let mut experiment = folder.experiment()?;
    experiment.envs.threads = threads.unwrap_or(experiment.envs.threads);
    experiment.check(&tasks)?;
    let claim = Claim {
        lock: Lock::take(folder.path())?,
        experiment,
        tasks,
        folder,
    };
    let experiment = &claim.experiment;
    let (spec, labels) = (Stream::spec_of(&experiment.envs), Labels::default());
    let read = |path: &Path| {
        let (learner, note) = experiment.learner.resume(path, &spec, &labels)?;
        let signed = serde_json::from_str::<Signed>(&note);
        let signed = signed.map_err(|error| CoversError::read(path, error))?;
        Ok((learner, signed))
    };
    let Some(found) = newest(&claim.folder.checkpoints(), read)? else {
        let notice = "there is no checkpoint yet: begun anew".to_owned();
        return begin(claim, notice);
    };
    let (learner, signed) = found.value;
    same(
        &found.path,
        &experiment.clone().with_threads(1),
        &signed.experiment,
    )?;
    Ok(Opened {
        notice: notice(&signed.note, &found.path, &found.passed_over),
        claim,
        learner,
        labels,
        note: signed.note,
    })
}

/// What is told about a resumption.
fn notice(note: &Note, path: &Path, passed_over: &[String]) -> String {
    let rollouts = note.ledger.rollouts;
    let mut notice = format!("goes on after {rollouts} rollouts from {}", path.display());
    for problem in passed_over {
        notice = format!("{notice}; passed over a newer checkpoint: {problem}");
    }
    notice
}
