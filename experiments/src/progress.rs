//! What a run reports: rollouts and evaluations.

use envs::TaskGroup;
use rl::RewardWarning;

use crate::evaluation::Findings;
use learner::Iteration;

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
