//! Evaluation: every variant of every group, with the policy that the learner itself recognises,
//! acting by its mean.

mod dormancy;
mod played;
mod recognition;
mod score;

use envs::{TaskGroup, TaskRegistry, TaskVariant, VecEnvSettings};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rl::RolloutStats;
use symmetry::D2;

use crate::error::RunError;
use crate::experiment::Experiment;
use crate::schedule::Schedule;
use crate::stream::Stream;
use learner::{Labels, Learner, Performance};

use dormancy::Activities;
use played::Played;

pub use dormancy::{Dormancy, TAU};
pub use recognition::{Recognition, SHOWN};
pub use score::{GroupScore, OwnPolicies, PolicyScore, Score, by_group};

/// Random stream of the learner's draws while it looks: environments count theirs from 0 under the
/// same seed.
const LOOKING: u64 = u64::MAX;

/// What one evaluation found.
#[derive(Clone, Debug, Default)]
pub struct Findings {
    /// One item a variant.
    pub scores: Vec<Score>,
    /// What the learner answered when it was asked for its policies; nothing where it was not.
    pub recognition: Vec<Recognition>,
    activities: Activities,
}

impl Findings {
    /// The dormant units of each policy that was scored, in their order, over all variants that it
    /// was scored on.
    pub fn dormancies(&self) -> Vec<Dormancy> {
        self.activities.dormancies()
    }
}

/// Environments of their own for evaluations: looking changes nothing of what is learnt. Every
/// evaluation shows the same episodes, so that two of them compare policies and not placements. A
/// policy whose parameters have not changed is not played again: take another evaluator for another
/// learner.
pub struct Evaluator {
    stream: Stream,
    groups: Vec<TaskGroup>,
    schedule: Schedule,
    seed: u64,
    labels: Labels,
    played: Played,
}

impl Evaluator {
    /// Environments like the learner's, which learns from `schedule`; their episodes depend on
    /// `seed`. A learner that was told labels is told them here, too, by the same `labels`.
    ///
    /// # Errors
    /// A group that `tasks` does not hold, or what the environments say.
    pub fn new(
        settings: VecEnvSettings,
        tasks: &TaskRegistry,
        schedule: Schedule,
        seed: u64,
        labels: Labels,
    ) -> Result<Self, RunError> {
        let groups = schedule.resolve(tasks)?;
        Ok(Self {
            stream: Stream::new(settings, &groups)?,
            groups,
            schedule,
            seed,
            labels,
            played: Played::default(),
        })
    }

    /// The environments that score a run: their episodes depend on the plan of the evaluation
    /// alone, so all methods and seeds are scored on the same ones. Their pictures are perfect.
    ///
    /// # Errors
    /// As [`Evaluator::new`].
    pub fn of(run: &Experiment, tasks: &TaskRegistry, labels: Labels) -> Result<Self, RunError> {
        let (schedule, seed) = (run.schedule.clone(), run.evaluation_seed());
        Self::new(run.envs.clean(), tasks, schedule, seed, labels)
    }

    /// All variants of the groups of the schedule, in the order in which they are scored.
    pub fn variants(&self) -> Vec<TaskVariant> {
        let groups = self.groups.iter();
        let variants =
            groups.flat_map(|&group| D2::ALL.map(|element| TaskVariant { group, element }));
        variants.collect()
    }

    /// Scores all variants, with `rounds` episodes in each environment.
    ///
    /// # Errors
    /// As [`Evaluator::variant`].
    pub fn all(
        &mut self,
        learner: &mut dyn Learner,
        own: &OwnPolicies,
        rounds: usize,
    ) -> Result<Findings, RunError> {
        let mut findings = Findings::default();
        for variant in self.variants() {
            self.variant(learner, variant, own, rounds, &mut findings)?;
        }
        Ok(findings)
    }

    /// Lets the learner choose the policy for a variant, whose episodes run from then on.
    ///
    /// # Errors
    /// What the environments, the policies or the assigner say.
    pub fn recognise(
        &mut self,
        learner: &mut dyn Learner,
        variant: TaskVariant,
    ) -> Result<usize, RunError> {
        let mut rng = looking(self.seed);
        self.labels.set(variant.group.name());
        self.stream.switch_to(variant.group, &[variant.element])?;
        self.stream.reseed(self.seed)?;
        let recognised = learner.recognise(&mut self.stream, None, &mut rng)?;
        Ok(recognised.policy)
    }

    /// Scores one variant and adds what it finds. The learner chooses a policy from the first
    /// frames of the very episodes that are then played; nobody tells it the group. Where it
    /// chooses another policy than the group's own, the own one plays the same episodes, too.
    ///
    /// # Errors
    /// [`RunError::Setting`] for no rounds; what the environments, the policies or the assigner
    /// say.
    pub fn variant(
        &mut self,
        learner: &mut dyn Learner,
        variant: TaskVariant,
        own: &OwnPolicies,
        rounds: usize,
        findings: &mut Findings,
    ) -> Result<(), RunError> {
        if rounds == 0 {
            return Err(RunError::Setting {
                name: "rounds",
                value: "0".to_owned(),
                expected: "at least 1",
            });
        }
        let policy = self.recognise(learner, variant)?;
        let chosen = self.play(learner, variant, policy, rounds)?;
        findings.activities.add(policy, &chosen.activity);
        let score = self.policy_score(policy, &chosen.stats);
        let own = match own.get(variant.group.name()) {
            Some(&own) if own != policy => {
                let played = self.play(learner, variant, own, rounds)?;
                Some(self.policy_score(own, &played.stats))
            }
            own => own.map(|_| score),
        };
        findings.scores.push(Score {
            group: variant.group,
            element: variant.element,
            seen: self.schedule.shows(variant.group.name(), variant.element),
            policy,
            episodes: chosen.stats.episodes.len(),
            success: score.success,
            success_at_end: score.success_at_end,
            reward: score.reward,
            own,
        });
        Ok(())
    }

    /// Plays `rounds` episodes of the variant that the environments show, from the same placements
    /// every time.
    fn play(
        &mut self,
        learner: &mut dyn Learner,
        variant: TaskVariant,
        policy: usize,
        rounds: usize,
    ) -> Result<Performance, RunError> {
        let stream = &mut self.stream;
        stream.reseed(self.seed)?;
        let what = (variant, rounds);
        self.played
            .recall(what, learner, policy, |learner| Ok(learner.perform(policy, stream, rounds)?))
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

/// The generator of what the learner draws while it looks at episodes of `seed`.
fn looking(seed: u64) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(LOOKING);
    rng
}

/// The mean; NaN of nothing.
pub fn mean(values: &[f64]) -> f64 {
    values.iter().sum::<f64>() / values.len() as f64
}

#[cfg(test)]
mod tests;
