//! What a run reports: rollouts and evaluations.

use std::collections::BTreeMap;

use envs::TaskGroup;
use learner::Iteration;
use rl::RewardWarning;
use serde::Serialize;

use crate::error::RunError;
use crate::evaluation::{Findings, GroupScore, Score};
use crate::folder::{RunFolder, SUMMARY};

/// One rollout as it is logged. The true group is the stream's knowledge; the learner never sees
/// it.
#[derive(Clone, Debug)]
pub struct Progress {
    /// Index of the rollout, from 0.
    pub rollout: usize,
    /// Decisions taken so far.
    pub decisions: usize,
    /// The group that ran when the learner's turn began.
    pub group: TaskGroup,
    /// The group that ran when it ended.
    pub last_group: TaskGroup,
    /// Whether the group changed within the turn.
    pub straddles: bool,
    /// Report of the learner.
    pub turn: Iteration,
    /// Rewards too large or too small to be learnt from: once after a start, where they first were.
    pub warning: Option<RewardWarning>,
    /// Factor from a return to the paper's scale, on which a perfect episode earns 500.
    pub reward_scale: f64,
    /// Wall-clock seconds of all that the learner did, without the evaluation.
    pub seconds: f64,
    /// Those of them in which the environments worked (physics and pictures).
    pub environment_seconds: f64,
}

impl Progress {
    /// Mean return of the episodes that ended in the rollout, on the paper's scale, in `[0, 500]`;
    /// none where none ended.
    pub fn reward(&self) -> Option<f64> {
        let sum = self.turn.rollout.mean_return()?;
        Some(sum * self.reward_scale)
    }

    /// Share of those episodes that succeeded at any step, in `[0, 1]`.
    pub fn success(&self) -> Option<f64> {
        self.turn.rollout.success_rate()
    }
}

/// An evaluation as it is logged.
#[derive(Clone, Debug)]
pub struct Evaluation {
    /// Rollouts learnt from before it; 0 before the stream.
    pub rollouts: usize,
    /// Decisions taken so far while learning.
    pub decisions: usize,
    /// What it found. The learner is asked for its policies after the stream alone.
    pub findings: Findings,
}

/// One step of a run.
#[derive(Clone, Debug)]
pub enum Event {
    /// The learner learnt from a rollout.
    Rollout(Box<Progress>),
    /// All variants were scored.
    Evaluation(Evaluation),
}

/// Figures of a whole run.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Summary {
    /// Decisions taken while learning.
    pub decisions: usize,
    /// Wall-clock seconds of learning, without evaluations, as far as they are known.
    pub seconds: f64,
    /// Decisions per second of learning, over the rollouts whose seconds are known; none where no
    /// rollout's are.
    pub decisions_per_second: Option<f64>,
    /// Policies created.
    pub policies: usize,
    /// Those of them for whose groups others act since they were merged.
    pub merged: usize,
    /// Failures of single environments while learning, see [`crate::Stream::failures`].
    pub failures: usize,
    /// Rollouts within which the group changed; the shares below leave them out.
    pub straddled: usize,
    /// Share of rollouts assigned to the policy of their group ([`Ledger::right`](super::Ledger)),
    /// in `[0, 1]`; none where there was no rollout of one group.
    pub assignment_accuracy: Option<f64>,
    /// The same share among rollouts of groups that came back; none where none did.
    pub return_accuracy: Option<f64>,
    /// Scores of the groups after the stream.
    pub groups: Vec<GroupScore>,
    /// Scores of all their variants.
    pub variants: Vec<Score>,
    /// CRC-32 of each table of the finished run by file name, as eight hexadecimal digits. Tables
    /// that change later no longer belong to these figures.
    pub tables: BTreeMap<String, String>,
}

impl Summary {
    /// Leaves the figures in the folder of a run, which says that it is finished.
    pub(crate) fn write(&self, folder: &RunFolder) -> Result<(), RunError> {
        let text = serde_json::to_string_pretty(self);
        let text = text.map_err(|error| RunError::write(folder.path(), error))?;
        folder.replace(SUMMARY, text.as_bytes())
    }
}
