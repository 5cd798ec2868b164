//! Evaluations of a run, which take minutes and can be stopped between variants.

use envs::TaskVariant;
use rayon::ThreadPool;

use crate::error::RunError;
use crate::evaluation::{Evaluator, Findings, OwnPolicies};
use crate::experiment::Experiment;
use learner::Learner;

use crate::stop::Stop;
use crate::workers::guarded;

/// How often the learner is asked after the stream which policy a variant belongs to: not at all
/// where it has no choice.
pub(crate) fn looks(experiment: &Experiment) -> usize {
    match experiment.learner.cannot_be_asked() {
        Some(_) => 0,
        None => experiment.evaluation.looks,
    }
}

/// One evaluation of a learner: its environments, its threads, and the request to stop.
pub(crate) struct Scoring<'a> {
    pool: &'a ThreadPool,
    learner: &'a mut dyn Learner,
    evaluator: &'a mut Evaluator,
    own: OwnPolicies,
    stop: &'a Stop,
}

impl<'a> Scoring<'a> {
    pub fn new(
        pool: &'a ThreadPool,
        learner: &'a mut dyn Learner,
        evaluator: &'a mut Evaluator,
        own: OwnPolicies,
        stop: &'a Stop,
    ) -> Self {
        Self { pool, learner, evaluator, own, stop }
    }

    /// Scores all variants, with `rounds` episodes in each environment, then asks which policy each
    /// of them belongs to, `looks` times; none after a stop.
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

    /// Goes through the variants; false after a stop.
    fn each(
        &mut self,
        mut of: impl FnMut(&mut Evaluator, &mut dyn Learner, TaskVariant) -> Result<(), RunError> + Send,
    ) -> Result<bool, RunError> {
        for variant in self.evaluator.variants() {
            if self.stop.requested() {
                return Ok(false);
            }
            let (evaluator, learner) = (&mut *self.evaluator, &mut *self.learner);
            guarded(self.pool, || of(evaluator, learner, variant))?;
        }
        Ok(true)
    }
}
