//! What an evaluation says of variants and groups.

use envs::TaskGroup;
use serde::Serialize;
use symmetry::D2;

use crate::distinct::distinct;

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

/// Means over the variants of each group, in the order in which the groups appear.
pub fn by_group(scores: &[Score]) -> Vec<GroupScore> {
    let groups: Vec<TaskGroup> = distinct(scores.iter().map(|score| score.group));
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
            score(drawer, 1, 20, 0.25),
            score(reach, 2, 0, 0.0),
        ]);
        assert_eq!(groups.len(), 2);
        assert_eq!(groups[0].policies, [0, 2]);
        assert_eq!((groups[0].episodes, groups[0].success), (40, 0.875));
        assert_eq!((groups[1].policies[0], groups[1].reward), (1, 25.0));
    }
}
