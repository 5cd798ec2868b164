//! Scores of task variants and task groups in an evaluation.

use std::collections::BTreeMap;

use envs::TaskGroup;
use serde::Serialize;
use symmetry::D2;

use itertools::Itertools;

/// Index of each group's own policy, by the group's name: the policy that most of its training
/// rollouts were assigned to. [`RunStats`](crate::RunStats) counts them; learners
/// never see the group's name.
pub type OwnPolicyByGroup = BTreeMap<String, usize>;

/// Results of the learner in one task variant, over the episodes of an evaluation.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct VariantScore {
    /// Task group of the variant.
    pub group: TaskGroup,
    /// Element of D2 (a flip, half turn or identity) that transforms the variant's scene.
    pub element: D2,
    /// `true` if the training stream shows the variant.
    #[serde(rename = "seen")]
    pub seen_in_training: bool,
    /// Index of the policy that the learner chose for the variant.
    pub policy: usize,
    /// Number of episodes that were played in the variant.
    pub episodes: usize,
    /// Share of episodes in which the success condition held at any step, in `[0, 1]`.
    pub success: f64,
    /// Share of episodes in which the success condition held at the last step, in `[0, 1]`.
    pub success_at_end: f64,
    /// Mean return of the episodes on the paper's scale, in `[0, 500]`.
    pub reward: f64,
    /// Results of the group's own policy in the same episodes; `None` if the group has none yet.
    #[serde(rename = "own")]
    pub own_policy_score: Option<PolicyScore>,
}

/// Results of one policy in a task variant or a task group.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub struct PolicyScore {
    /// Index of the policy among the learner's policies.
    pub policy: usize,
    /// Share of episodes in which the success condition held at any step, in `[0, 1]`.
    pub success: f64,
    /// Share of episodes in which the success condition held at the last step, in `[0, 1]`.
    pub success_at_end: f64,
    /// Mean return of the episodes on the paper's scale, in `[0, 500]`.
    pub reward: f64,
}

impl VariantScore {
    /// Returns `true` if the learner chose another policy than the group's own; `false` if the
    /// group has none yet.
    pub fn is_policy_mismatch(&self) -> bool {
        self.own_policy_score.is_some_and(|own| own.policy != self.policy)
    }
}

/// Mean results over the variants of one task group, weighted by episodes.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct GroupScore {
    /// Task group of the variants.
    pub group: TaskGroup,
    /// Indices of the policies that the learner chose in any variant, ascending.
    pub policies: Vec<usize>,
    /// Number of episodes over all variants.
    pub episodes: usize,
    /// Share of episodes in which the success condition held at any step, in `[0, 1]`.
    pub success: f64,
    /// Share of episodes in which the success condition held at the last step, in `[0, 1]`.
    pub success_at_end: f64,
    /// Mean return of the episodes on the paper's scale, in `[0, 500]`.
    pub reward: f64,
    /// Number of variants for which the learner chose another policy than the group's own.
    pub mismatches: usize,
    /// Means of the group's own policy; `None` if it was not scored on every variant.
    #[serde(rename = "own")]
    pub own_policy_score: Option<PolicyScore>,
}

/// Averages the scores of the variants of each task group, in the order in which the groups appear.
pub fn average_scores_by_group(scores: &[VariantScore]) -> Vec<GroupScore> {
    let groups: Vec<TaskGroup> = scores.iter().map(|score| score.group).unique().collect();
    let of = |group| scores.iter().filter(move |score| score.group == group);
    let summarise = |group| {
        let episodes: usize = of(group).map(|score| score.episodes).sum();
        let over_episodes = |sum: f64| sum / episodes.max(1) as f64;
        let mean = |figure: fn(&VariantScore) -> f64| {
            over_episodes(of(group).map(|s| figure(s) * s.episodes as f64).sum())
        };
        let own_scores: Option<Vec<(PolicyScore, usize)>> =
            of(group).map(|score| Some((score.own_policy_score?, score.episodes))).collect();
        let own_mean = |pairs: &[(PolicyScore, usize)], figure: fn(&PolicyScore) -> f64| {
            let sums = pairs.iter().map(|(own, n)| figure(own) * *n as f64);
            over_episodes(sums.sum())
        };
        // a mean over some variants would not compare with that of the chosen policies, so one
        // missing score leaves none
        let own = own_scores.and_then(|pairs| {
            Some(PolicyScore {
                policy: pairs.first()?.0.policy,
                success: own_mean(&pairs, |own| own.success),
                success_at_end: own_mean(&pairs, |own| own.success_at_end),
                reward: own_mean(&pairs, |own| own.reward),
            })
        });
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
            mismatches: of(group).filter(|score| score.is_policy_mismatch()).count(),
            own_policy_score: own,
        }
    };
    groups.into_iter().map(summarise).collect()
}

#[cfg(test)]
mod tests {
    use super::*;

    fn score(group: TaskGroup, policy: usize, episodes: usize, success: f64) -> VariantScore {
        VariantScore {
            group,
            element: D2::Identity,
            seen_in_training: true,
            policy,
            episodes,
            success,
            success_at_end: 0.0,
            reward: 100.0 * success,
            own_policy_score: None,
        }
    }

    #[test]
    fn a_groups_own_policy_has_means_where_it_played_all_variants() {
        let own = |policy, success| PolicyScore {
            policy,
            success,
            success_at_end: 0.0,
            reward: 400.0 * success,
        };
        let with =
            |score: VariantScore, scored| VariantScore { own_policy_score: Some(scored), ..score };
        let reach = TaskGroup::GOAL_REACH;
        let right = with(score(reach, 2, 30, 1.0), own(2, 1.0));
        let wrong = with(score(reach, 0, 10, 0.0), own(2, 0.6));
        assert!(wrong.is_policy_mismatch() && !right.is_policy_mismatch());
        let [group] = &average_scores_by_group(&[right.clone(), wrong])[..] else { panic!() };
        assert_eq!((group.mismatches, group.success), (1, 0.75));
        let means = group.own_policy_score.unwrap();
        assert_eq!((means.policy, means.success), (2, 0.9));
        assert!((means.reward - 360.0).abs() < 1e-9, "{means:?}");
        let [partial] = &average_scores_by_group(&[right, score(reach, 2, 10, 0.0)])[..] else {
            panic!()
        };
        assert_eq!((partial.mismatches, partial.own_policy_score), (0, None));
    }

    #[test]
    fn a_group_is_the_mean_of_its_episodes() {
        let (reach, drawer) = (TaskGroup::GOAL_REACH, TaskGroup::DRAWER_CLOSE);
        let groups = average_scores_by_group(&[
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
