//! What a run writes into its checkpoints beside the learner.

use std::path::Path;

use serde::{Deserialize, Serialize};

use crate::error::RunError;
use crate::experiment::Experiment;
use crate::schedule::MAX_DECISIONS;
use learner::read_note;

use crate::checkpoints::rollouts_of;
use crate::ledger::Ledger;
use crate::rows::Rows;

/// Decisions that no run takes: learners throw some away, so that there are more than the stream
/// has.
const TOO_MANY: usize = 1000 * MAX_DECISIONS;

/// Where a run stands.
#[derive(Clone, Debug, Default, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Note {
    pub ledger: Ledger,
    /// Rounds of an evaluation that is due before the next rollout; 0 for none.
    pub due: usize,
    pub rows: Rows,
}

/// The note with the settings that the run had.
#[derive(Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Signed {
    pub experiment: Experiment,
    pub note: Note,
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

impl Signed {
    /// Reads the note of the checkpoint at `path`.
    ///
    /// # Errors
    /// [`RunError::Read`], [`learner::LearnerError::NewerFormat`].
    pub fn read(path: &Path) -> Result<Self, RunError> {
        Self::parse(path, &read_note(path)?)
    }

    /// Reads a note that stands in the checkpoint at `path`.
    ///
    /// # Errors
    /// [`RunError::Read`], also for counts and rows that no run has, and for a checkpoint under
    /// another one's name.
    pub fn parse(path: &Path, note: &str) -> Result<Self, RunError> {
        let signed: Self = serde_json::from_str(note).map_err(|e| RunError::read(path, e))?;
        let wrong = |what: &str| RunError::damaged(path, format!("the run's note: {what}"));
        signed.check().map_err(wrong)?;
        let rollouts = signed.note.ledger.rollouts;
        match rollouts_of(path) {
            // under a higher number it would stay the newest for ever
            Some(named) if named != rollouts => Err(RunError::damaged(
                path,
                format!(
                    "it is the checkpoint after {rollouts} rollouts under the name of the one \
                     after {named}"
                ),
            )),
            _ => Ok(signed),
        }
    }

    /// Counts what a checkpoint leaves out, from the rows that it keeps.
    ///
    /// # Errors
    /// [`RunError::Read`] for rows that do not say which policy served a group.
    pub fn recount(&mut self, path: &Path) -> Result<(), RunError> {
        let rows = &mut self.note.rows;
        let wrong = |error| RunError::damaged(path, format!("the rows of the run: {error}"));
        self.note.ledger.served = rows.served().map_err(wrong)?;
        rows.upgrade().map_err(wrong)
    }

    fn check(&self) -> Result<(), &'static str> {
        let (Note { ledger, due, rows }, plan) = (&self.note, &self.experiment.evaluation);
        if !ledger.adds_up() || ledger.decisions > TOO_MANY {
            return Err("its counts do not add up");
        }
        if ![0, plan.rounds, plan.visit_rounds].contains(due) {
            return Err("it is no evaluation of its settings that is due");
        }
        if rows.rollouts() != Some(ledger.rollouts) {
            return Err("its rows are not those of its rollouts");
        }
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::presets::{Budget, Method};

    fn rows(metrics: &str) -> Rows {
        Rows {
            metrics: metrics.to_owned(),
            scores: "rollouts\n0\n0\n".to_owned(),
            ..Rows::default()
        }
    }

    fn note(change: impl FnOnce(&mut Note)) -> Result<Signed, RunError> {
        let mut note = Note {
            ledger: Ledger { rollouts: 2, decisions: 160, right: 2, ..Ledger::default() },
            due: 0,
            rows: rows("rollout,group\n0,a\n1,\"b\nc\"\n"),
        };
        change(&mut note);
        let text = note.sign(&Budget::Smoke.experiment(Method::Covers));
        Signed::parse(Path::new("file"), &text.unwrap())
    }

    #[test]
    fn a_note_comes_back() {
        let read = note(|_| {}).unwrap();
        assert_eq!((read.note.ledger.rollouts, read.note.due), (2, 0));
        assert!(note(|note| note.due = 1).is_ok());
    }

    #[test]
    fn notes_that_no_run_writes_are_refused() {
        type Spoil = fn(&mut Note);
        let cases: [(Spoil, &str); 6] = [
            (|note| note.ledger.straddled = 1, "do not add up"),
            (|note| note.ledger.right_returns = 1, "do not add up"),
            (|note| note.ledger.rollouts = usize::MAX, "do not add up"),
            (|note| note.ledger.decisions = usize::MAX, "do not add up"),
            (|note| note.due = 7, "evaluation"),
            (|note| note.rows = rows("rollout\n0\n"), "rows"),
        ];
        for (change, expected) in cases {
            let message = note(change).err().unwrap().to_string();
            assert!(message.contains(expected), "{message}");
        }
    }
}
