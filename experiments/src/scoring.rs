//! Evaluation of a run, which may take minutes and can be stopped between variants.

use envs::TaskVariant;
use rayon::ThreadPool;

use crate::error::RunError;
use crate::evaluation::{Evaluator, Findings, OwnPolicies};
use crate::experiment::Experiment;
use learner::Learner;

use crate::stop::StopSignal;
use crate::workers::guarded;

/// Returns the number of times that the learner is asked for the policy of each variant: 0 for
/// learners with one policy or with ground truth, whose answers are known.
pub(crate) fn looks(experiment: &Experiment) -> usize {
    match experiment.learner.cannot_be_asked() {
        Some(_) => 0,
        None => experiment.evaluation.looks,
    }
}

/// Evaluation of a learner that a signal can stop.
pub(crate) struct Scoring<'a> {
    pool: &'a ThreadPool,
    learner: &'a mut dyn Learner,
    evaluator: &'a mut Evaluator,
    own: OwnPolicies,
    stop: &'a StopSignal,
}

impl<'a> Scoring<'a> {
    pub fn new(
        pool: &'a ThreadPool,
        learner: &'a mut dyn Learner,
        evaluator: &'a mut Evaluator,
        own: OwnPolicies,
        stop: &'a StopSignal,
    ) -> Self {
        Self { pool, learner, evaluator, own, stop }
    }

    /// Scores all variants with `rounds` episodes in each environment, then asks the learner
    /// `looks` times for the policy of each variant; `None` after a stop.
    pub fn score(&mut self, rounds: usize, looks: usize) -> Result<Option<Findings>, RunError> {
        let mut findings = Findings::default();
        let own = self.own.clone();
        let scored = self.each(|evaluator, learner, variant| {
            evaluator.variant(learner, variant, &own, rounds, &mut findings)
        })?;
        let done = scored
            && (looks == 0
                || self.each(|evaluator, learner, variant| {
                    let answers = evaluator.recognition(learner, variant, looks)?;
                    findings.recognition.extend(answers);
                    Ok(())
                })?);
        Ok(done.then_some(findings))
    }

    /// Calls `visit` for each variant on the pool's threads; returns `false` after a stop.
    fn each(
        &mut self,
        mut visit: impl FnMut(&mut Evaluator, &mut dyn Learner, TaskVariant) -> Result<(), RunError>
        + Send,
    ) -> Result<bool, RunError> {
        for variant in self.evaluator.variants() {
            if self.stop.requested() {
                return Ok(false);
            }
            let (evaluator, learner) = (&mut *self.evaluator, &mut *self.learner);
            guarded(self.pool, || visit(evaluator, learner, variant))?;
        }
        Ok(true)
    }
}
