//! Evaluation on every variant of every group: the learner chooses the policy, which acts by its
//! mean action.

mod cache;
mod dormancy;
mod recognition;
mod score;

use envs::{TaskGroup, TaskRegistry, TaskVariant, VecEnvSettings};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rl::{ProcessRanks, RolloutStats};
use symmetry::D2;

use crate::error::RunError;
use crate::experiment::Experiment;
use crate::schedule::TaskSchedule;
use crate::schema::{DormantUnitsRow, RecognitionRow};
use crate::stop::StopSignal;
use crate::stream::SwitchableVecEnv;
use learner::{Learner, PolicyEvaluationResult, RecognisedPolicy, TaskLabel};

use cache::{CacheKey, EvaluationCache};
use dormancy::UnitActivities;

pub use dormancy::DORMANCY_THRESHOLD;
pub use recognition::RECOGNITION_EPISODE_COUNTS;
pub use score::{GroupScore, OwnPolicyByGroup, PolicyScore, VariantScore, average_scores_by_group};

/// Number of the ChaCha stream that learners draw from during recognition. Environments use streams
/// that count up from 0 under the same seed, so this one is counted down from the top.
const RECOGNITION_STREAM: u64 = u64::MAX;

/// Results of one evaluation of a learner: scores, recognitions and dormant units.
#[derive(Clone, Debug, Default)]
pub struct EvaluationResults {
    /// Score of each task variant, in the order of scoring.
    pub scores: Vec<VariantScore>,
    /// Counts of the policies that the learner named for shown episodes; empty if it was not asked.
    pub recognitions: Vec<RecognitionRow>,
    /// Causes of failures of environments, of many the first ones. The episode of a failed
    /// environment counts as one that ended there.
    pub environment_failures: Vec<String>,
    activities: UnitActivities,
}

impl EvaluationResults {
    /// Returns the rows of `units.csv` of the scored policies, over all variants that each was
    /// scored on, for an evaluation after `rollouts` rollouts and `decisions` decisions.
    pub(crate) fn dormant_unit_rows(
        &self,
        rollouts: usize,
        decisions: usize,
    ) -> Vec<DormantUnitsRow> {
        self.activities.dormant_unit_rows(rollouts, decisions)
    }
}

/// Evaluator of a learner, with environments of its own so that evaluations do not affect training.
///
/// Every evaluation plays the same episodes, so that differences come from policies and not from
/// placements. Results of policies whose parameters have not changed are reused: use a new
/// evaluator for another learner.
pub struct Evaluator {
    stream: SwitchableVecEnv,
    groups: Vec<TaskGroup>,
    schedule: TaskSchedule,
    seed: u64,
    distinct_placements: bool,
    labels: TaskLabel,
    cache: EvaluationCache,
}

impl Evaluator {
    /// Creates an evaluator for a learner that trains on `schedule`; `seed` determines the
    /// episodes. A learner with ground truth reads the group's name from `labels`.
    ///
    /// # Errors
    /// A group that `tasks` does not hold, or errors of the environments.
    pub fn new(
        settings: VecEnvSettings,
        tasks: &TaskRegistry,
        schedule: TaskSchedule,
        seed: u64,
        labels: TaskLabel,
    ) -> Result<Self, RunError> {
        Self::on_ranks(settings, tasks, schedule, seed, labels, ProcessRanks::default())
    }

    fn on_ranks(
        settings: VecEnvSettings,
        tasks: &TaskRegistry,
        schedule: TaskSchedule,
        seed: u64,
        labels: TaskLabel,
        ranks: ProcessRanks,
    ) -> Result<Self, RunError> {
        let groups = schedule.resolve_groups(tasks)?;
        Ok(Self {
            stream: SwitchableVecEnv::on_ranks(settings, &groups, ranks)?,
            groups,
            schedule,
            seed,
            distinct_placements: false,
            labels,
            cache: EvaluationCache::default(),
        })
    }

    /// Creates the evaluator of a run. Episodes depend on the evaluation plan alone, so all methods
    /// and seeds are scored on the same ones. Images are not randomised, and the arm hides nothing.
    ///
    /// # Errors
    /// As [`Evaluator::new`].
    pub fn for_experiment(
        run: &Experiment,
        tasks: &TaskRegistry,
        labels: TaskLabel,
    ) -> Result<Self, RunError> {
        let (schedule, seed) = (run.schedule.clone(), run.evaluation_seed());
        let (envs, ranks) = (run.envs.for_evaluation(), run.learner.process_ranks().clone());
        let evaluator = Self::on_ranks(envs, tasks, schedule, seed, labels, ranks)?;
        Ok(evaluator.with_distinct_placements(run.evaluation.distinct_placements))
    }

    /// Sets [`EvaluationPlan::distinct_placements`](crate::EvaluationPlan::distinct_placements),
    /// which is `false` in a new evaluator.
    #[must_use]
    pub fn with_distinct_placements(self, distinct_placements: bool) -> Self {
        Self { distinct_placements, ..self }
    }

    /// Returns the seed of the episodes of a variant.
    fn episode_seed(&self, variant: TaskVariant) -> u64 {
        let offset = if self.distinct_placements { variant.element as u64 } else { 0 };
        self.seed.wrapping_add(offset)
    }

    /// Returns all variants of the scheduled task groups, in the order in which they are scored.
    pub fn task_variants(&self) -> Vec<TaskVariant> {
        self.groups
            .iter()
            .flat_map(|&group| D2::ALL.map(|element| TaskVariant { group, element }))
            .collect()
    }

    /// Returns [`SwitchableVecEnv::take_failure_causes`] of the evaluator's environments.
    pub fn take_failure_causes(&mut self) -> Vec<String> {
        self.stream.take_failure_causes()
    }

    /// Sets the signal after which every decision of an evaluation is an error.
    pub(crate) fn set_stop_signal(&mut self, stop: StopSignal) {
        self.stream.set_stop_signal(stop);
    }

    /// Switches the environments to a variant and returns the policy that the learner chooses for
    /// it.
    ///
    /// # Errors
    /// Errors of the environments, the policies or the assigner.
    pub fn recognise_policy(
        &mut self,
        learner: &mut dyn Learner,
        variant: TaskVariant,
    ) -> Result<RecognisedPolicy, RunError> {
        let mut rng = recognition_rng(self.episode_seed(variant));
        self.labels.set(variant.group.name());
        self.stream.switch_task_group(variant.group, &[variant.element])?;
        self.stream.reseed(self.episode_seed(variant))?;
        Ok(learner.recognise_policy(&mut self.stream, None, &mut rng)?)
    }

    /// Scores the learner on one variant and adds the results to `results`.
    ///
    /// The learner chooses a policy from the first frames of the episodes that are then played,
    /// without the group's label. If it chooses another policy than the group's own, the own policy
    /// plays the same episodes, too.
    ///
    /// # Errors
    /// [`RunError::InvalidSetting`] if `rounds` is 0; errors of the environments, the policies or
    /// the assigner.
    pub fn score_variant(
        &mut self,
        learner: &mut dyn Learner,
        variant: TaskVariant,
        own: &OwnPolicyByGroup,
        rounds: usize,
        results: &mut EvaluationResults,
    ) -> Result<(), RunError> {
        if rounds == 0 {
            return Err(RunError::invalid("rounds", "0", "at least 1"));
        }
        let policy = self.recognise_policy(learner, variant)?.policy;
        let chosen = self.play(learner, variant, policy, rounds)?;
        results.activities.add(policy, &chosen.activity);
        let score = self.policy_score(policy, &chosen.stats);
        // the same episodes for the own policy, so that the difference is the cost of recognition
        let own = match own.get(variant.group.name()) {
            Some(&own) if own != policy => {
                let played = self.play(learner, variant, own, rounds)?;
                Some(self.policy_score(own, &played.stats))
            }
            own => own.map(|_| score),
        };
        results.scores.push(VariantScore {
            group: variant.group,
            element: variant.element,
            seen_in_training: self
                .schedule
                .trains_on_variant(variant.group.name(), variant.element),
            policy,
            episodes: chosen.stats.episodes.len(),
            success: score.success,
            success_at_end: score.success_at_end,
            reward: score.reward,
            own_policy_score: own,
        });
        Ok(())
    }

    /// Plays `rounds` episodes in each environment with one policy, from the same placements every
    /// time.
    fn play(
        &mut self,
        learner: &mut dyn Learner,
        variant: TaskVariant,
        policy: usize,
        rounds: usize,
    ) -> Result<PolicyEvaluationResult, RunError> {
        let seed = self.episode_seed(variant);
        let stream = &mut self.stream;
        stream.reseed(seed)?;
        let key = CacheKey { variant, episodes_per_env: rounds, policy };
        self.cache.get_or_play(key, learner, |learner| {
            Ok(learner.evaluate_policy(policy, stream, rounds)?)
        })
    }

    fn policy_score(&self, policy: usize, stats: &RolloutStats) -> PolicyScore {
        PolicyScore {
            policy,
            success: stats.success_rate().unwrap_or(0.0),
            success_at_end: stats.success_at_end_rate().unwrap_or(0.0),
            reward: stats.mean_return().unwrap_or(0.0) * self.stream.reward_scale(),
        }
    }
}

/// Returns the generator that the learner draws from during recognition on episodes of `seed`.
fn recognition_rng(seed: u64) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(RECOGNITION_STREAM);
    rng
}

/// Returns the policy of a group: that of `own`, or else the one that the learner chooses from
/// images of the group, as for a group that did not run yet and for a packed folder, which holds no
/// counts of rollouts.
///
/// # Errors
/// A group that the run does not schedule; errors of the environments and the learner.
pub fn policy_of_group(
    group: &str,
    experiment: &Experiment,
    learner: &mut dyn Learner,
    own: &OwnPolicyByGroup,
    labels: TaskLabel,
) -> Result<RecognisedPolicy, RunError> {
    let tasks = TaskRegistry::with_all();
    let variant = experiment.schedule.resolve_group_or_all(Some(group), &tasks)?[0].variants()[0];
    match own.get(group) {
        Some(&policy) => Ok(RecognisedPolicy { policy, fits: true }),
        None => {
            let mut evaluator = Evaluator::for_experiment(experiment, &tasks, labels)?;
            evaluator.recognise_policy(learner, variant)
        }
    }
}

/// Returns the mean of the values; NaN for an empty slice.
pub fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

#[cfg(test)]
mod tests;
