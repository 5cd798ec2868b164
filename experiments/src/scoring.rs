//! Evaluation of a run, which may take minutes and can be stopped at any decision.

use envs::TaskVariant;
use rayon::ThreadPool;

use crate::error::RunError;
use crate::evaluation::{EvaluationResults, Evaluator, OwnPolicyByGroup};
use crate::experiment::Experiment;
use learner::Learner;

use crate::stop::StopSignal;
use crate::workers::run_catching_panics;

/// Returns the number of times that the recognition test after the stream asks about each variant:
/// that of the settings, but 0 for learners with one policy or with ground truth, whose answers are
/// known.
pub(crate) fn recognition_repeats(experiment: &Experiment) -> usize {
    match experiment.learner.recognition_obstacle() {
        Some(_) => 0,
        None => experiment.evaluation.recognition_repeats,
    }
}

/// Evaluation of a learner that a signal can stop.
pub(crate) struct StoppableEvaluation<'a> {
    pool: &'a ThreadPool,
    learner: &'a mut dyn Learner,
    evaluator: &'a mut Evaluator,
    own: OwnPolicyByGroup,
    stop: &'a StopSignal,
}

impl<'a> StoppableEvaluation<'a> {
    pub fn new(
        pool: &'a ThreadPool,
        learner: &'a mut dyn Learner,
        evaluator: &'a mut Evaluator,
        own: OwnPolicyByGroup,
        stop: &'a StopSignal,
    ) -> Self {
        evaluator.set_stop_signal(stop.clone());
        Self { pool, learner, evaluator, own, stop }
    }

    /// Scores all variants with `rounds` episodes in each environment, then asks the learner for
    /// the policy of each variant, `repeats` times with each number of shown episodes; `None` after a
    /// stop.
    pub fn score(
        &mut self,
        rounds: usize,
        repeats: usize,
    ) -> Result<Option<EvaluationResults>, RunError> {
        let mut results = EvaluationResults::default();
        let own = self.own.clone();
        let scored = self.each(|evaluator, learner, variant| {
            evaluator.score_variant(learner, variant, &own, rounds, &mut results)
        })?;
        let done = scored
            && (repeats == 0
                || self.each(|evaluator, learner, variant| {
                    let answers = evaluator.test_recognition(learner, variant, repeats)?;
                    results.recognitions.extend(answers);
                    Ok(())
                })?);
        // failures of recognition, too
        results.environment_failures = self.evaluator.take_failure_causes();
        Ok(done.then_some(results))
    }

    /// Calls `visit` for each task variant on the threads of the pool; returns `false` after a
    /// stop.
    fn each(
        &mut self,
        mut visit: impl FnMut(&mut Evaluator, &mut dyn Learner, TaskVariant) -> Result<(), RunError>
        + Send,
    ) -> Result<bool, RunError> {
        for variant in self.evaluator.task_variants() {
            if self.stop.is_requested() {
                return Ok(false);
            }
            let (evaluator, learner) = (&mut *self.evaluator, &mut *self.learner);
            match run_catching_panics(self.pool, || visit(evaluator, learner, variant)) {
                // a panic may have left the learner half changed, which no checkpoint may hold
                Err(error @ RunError::Panicked { .. }) => return Err(error),
                // The stream refuses to go on. Any other error comes again when the evaluation is
                // repeated after the resumption.
                Err(_) if self.stop.was_seen() => return Ok(false),
                visited => visited?,
            }
        }
        Ok(true)
    }
}
