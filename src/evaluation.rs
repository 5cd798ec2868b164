//! Evaluation: every variant of every group, with the policy that the learner itself recognises,
//! acting by its mean.

use envs::{TaskGroup, TaskRegistry, TaskVariant, VecEnvSettings};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use serde::Serialize;
use symmetry::D2;

use crate::error::CoversError;
use crate::groupings::Labels;
use crate::learners::Learner;
use crate::schedule::Schedule;
use crate::stream::Stream;

/// Random stream of the learner's draws while it looks: environments count theirs from 0 under the
/// same seed.
const LOOKING: u64 = u64::MAX;

/// Results of one variant.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct Score {
    /// The variant's group.
    pub group: TaskGroup,
    /// The variant's element of the group of symmetries.
    pub element: D2,
    /// Whether the learner met the variant while it learnt.
    pub seen: bool,
    /// Index of the policy that the learner chose.
    pub policy: usize,
    /// Episodes evaluated.
    pub episodes: usize,
    /// Share of episodes in which the success condition held at any step, in `[0, 1]`.
    pub success: f64,
    /// Share of episodes in which it held at the last step, in `[0, 1]`.
    pub success_at_end: f64,
    /// Mean return on the paper's scale, in `[0, 500]`.
    pub reward: f64,
}

/// Means over variants of one group.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct GroupScore {
    /// The group.
    pub group: TaskGroup,
    /// The policy that the learner chose, one entry for each policy chosen in any variant, in
    /// order.
    pub policies: Vec<usize>,
    /// Episodes evaluated.
    pub episodes: usize,
    /// As in [`Score`], over all episodes.
    pub success: f64,
    /// As in [`Score`], over all episodes.
    pub success_at_end: f64,
    /// As in [`Score`], over all episodes.
    pub reward: f64,
}

/// Environments of their own for evaluations: looking changes nothing of what is learnt. Every
/// evaluation shows the same episodes, so that two of them compare policies and not placements.
pub struct Evaluator {
    stream: Stream,
    groups: Vec<TaskGroup>,
    schedule: Schedule,
    seed: u64,
    labels: Labels,
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
    ) -> Result<Self, CoversError> {
        let groups = schedule.resolve(tasks)?;
        Ok(Self {
            stream: Stream::new(settings, &groups)?,
            groups,
            schedule,
            seed,
            labels,
        })
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
        rounds: usize,
    ) -> Result<Vec<Score>, CoversError> {
        let variants = self.variants().into_iter();
        variants
            .map(|variant| self.variant(learner, variant, rounds))
            .collect()
    }

    /// Scores one variant. The learner chooses a policy from the first frames of the very episodes
    /// that are then played; nobody tells it the group.
    ///
    /// # Errors
    /// [`CoversError::Setting`] for no rounds; what the environments, the policies or the assigner
    /// say.
    pub fn variant(
        &mut self,
        learner: &mut dyn Learner,
        variant: TaskVariant,
        rounds: usize,
    ) -> Result<Score, CoversError> {
        if rounds == 0 {
            return Err(CoversError::Setting {
                name: "rounds",
                value: "0".to_owned(),
                expected: "at least 1",
            });
        }
        let stream = &mut self.stream;
        let mut rng = looking(self.seed);
        self.labels.set(variant.group.name());
        stream.switch_to(variant.group, &[variant.element])?;
        stream.reseed(self.seed)?;
        let policy = learner.recognise(stream, &mut rng)?;
        stream.reseed(self.seed)?;
        let stats = learner.perform(policy, stream, rounds)?;
        Ok(Score {
            group: variant.group,
            element: variant.element,
            seen: self.schedule.shows(variant.group.name(), variant.element),
            policy,
            episodes: stats.episodes.len(),
            success: stats.success_rate().unwrap_or(0.0),
            success_at_end: stats.success_at_end_rate().unwrap_or(0.0),
            reward: stats.mean_return().unwrap_or(0.0) * stream.reward_scale(),
        })
    }
}

/// The generator of what the learner draws while it looks at episodes of `seed`.
fn looking(seed: u64) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(LOOKING);
    rng
}

/// Means over the variants of each group, in the order in which the groups appear.
pub fn by_group(scores: &[Score]) -> Vec<GroupScore> {
    let mut groups: Vec<TaskGroup> = scores.iter().map(|score| score.group).collect();
    groups.dedup();
    let of = |group| scores.iter().filter(move |score| score.group == group);
    let summarise = |group| {
        let episodes: usize = of(group).map(|score| score.episodes).sum();
        let mean = |figure: fn(&Score) -> f64| {
            let sum: f64 = of(group).map(|s| figure(s) * s.episodes as f64).sum();
            sum / episodes.max(1) as f64
        };
        let mut policies: Vec<usize> = of(group).map(|score| score.policy).collect();
        policies.sort_unstable();
        policies.dedup();
        GroupScore {
            group,
            policies,
            episodes,
            success: mean(|score| score.success),
            success_at_end: mean(|score| score.success_at_end),
            reward: mean(|score| score.reward),
        }
    };
    groups.into_iter().map(summarise).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn score(group: TaskGroup, policy: usize, episodes: usize, success: f64) -> Score {
        Score {
            group,
            element: D2::Identity,
            seen: true,
            policy,
            episodes,
            success,
            success_at_end: 0.0,
            reward: 100.0 * success,
        }
    }

    #[test]
    fn a_group_is_the_mean_of_its_episodes() {
        let (reach, drawer) = (TaskGroup::GOAL_REACH, TaskGroup::DRAWER_CLOSE);
        let groups = by_group(&[
            score(reach, 2, 30, 1.0),
            score(reach, 0, 10, 0.5),
            score(reach, 2, 0, 0.0),
            score(drawer, 1, 20, 0.25),
        ]);
        assert_eq!(groups.len(), 2);
        assert_eq!(groups[0].policies, [0, 2]);
        assert_eq!((groups[0].episodes, groups[0].success), (40, 0.875));
        assert_eq!((groups[1].policies[0], groups[1].reward), (1, 25.0));
    }

    #[test]
    fn what_the_learner_draws_is_not_what_places_the_episodes() {
        use rand::RngExt;
        let words = |mut rng: ChaCha8Rng| -> [u64; 2] { [rng.random(), rng.random()] };
        let placing = |index| {
            let mut rng = ChaCha8Rng::seed_from_u64(7);
            rng.set_stream(index);
            words(rng)
        };
        assert!((0..1000).all(|index| placing(index) != words(looking(7))));
    }
}
