//! Policies that turn out to serve one group.

use cluster::{AssignedPolicy, PolicyVerdict};
use evidence::{EpisodeSummary, Recogniser, RequiredTrial, RolloutDecisionContext};
use worlds::WorldKind;

use crate::common::{
    assign, knowing, must_decide, review, rng, rollout, set_returns, settle, stream, summaries,
    train,
};

/// Two policies that trained on one group become one, and two that did not stay two; a merged one
/// is not proposed while others will do.
#[test]
fn policies_that_serve_one_group_are_merged() {
    let kind = WorldKind::Target;
    let mut recogniser = knowing(kind, 1000, 2);
    let of_group = summaries(stream(kind, 1000, &[(0, 16)], 5), 16, None);
    train(&mut recogniser, 2, of_group[40..].to_vec());
    let seen = rollout(kind, 1000, 0, 0);
    let decision = assign(&recogniser, &seen, 0);
    assert_eq!(
        recogniser.find_possible_duplicate(0, &decision.accepted_policies()),
        Some(1),
        "it looks alike"
    );
    let of_other = rollout(kind, 1000, 0, 1);
    assert!(!recogniser.confirm_duplicate(0, 1, &of_other, &mut rng()).unwrap());
    assert_eq!(recogniser.find_possible_duplicate(0, &decision.accepted_policies()), Some(2));
    assert!(recogniser.confirm_duplicate(0, 2, &seen[..5], &mut rng()).unwrap());
    recogniser.recheck_and_merge(0, 2, &seen[..5], &seen[5..], &mut rng()).unwrap();
    assert_eq!(recogniser.merged_into(), [Some(2), None, None], "policy 2 acted in both groups");
    let after_merge = assign(&recogniser, &seen, 2);
    assert_eq!(after_merge.tests[0].verdict, PolicyVerdict::Rejected);
    assert_eq!(recogniser.find_possible_duplicate(2, &after_merge.accepted_policies()), None);
    let found = recogniser.task_group_probabilities(&seen, &mut rng()).unwrap();
    assert_eq!(found.policies[0], 0.0);
}

const KIND: WorldKind = WorldKind::Reward;

/// A recogniser of the policies of two groups, the second of which serves in the first group, too,
/// where the returns of the first one are `more` times as high. Both were merged: returns the one
/// that continues and the merged one.
fn merged(more: f32) -> (Recogniser, [usize; 2]) {
    let mut recogniser = knowing(KIND, 1000, 2);
    let richer = |mut seen: Vec<EpisodeSummary>| {
        set_returns(&mut seen, |value| value * more);
        seen
    };
    let first = summaries(stream(KIND, 1000, &[(0, 8)], 5), 8, None);
    recogniser.record_training(0, &richer(first), &mut rng()).unwrap();
    let seen = rollout(KIND, 1000, 0, 0);
    assert!(recogniser.confirm_duplicate(0, 1, &seen[..5], &mut rng()).unwrap());
    let again = richer(seen[5..].to_vec());
    recogniser.recheck_and_merge(0, 1, &seen[..5], &again, &mut rng()).unwrap();
    let pair = if recogniser.merged_into()[0].is_some() { [1, 0] } else { [0, 1] };
    assert_eq!(recogniser.merged_into()[pair[1]], Some(pair[0]));
    (recogniser, pair)
}

/// The first policy never acted in the second one's group: it would leave that group without a
/// policy.
#[test]
fn of_two_policies_the_one_that_acted_in_both_groups_continues() {
    let (recogniser, pair) = merged(1.05);
    assert_eq!(pair, [1, 0]);
    let decision = assign(&recogniser, &rollout(KIND, 1000, 1, 1), 1);
    assert_eq!(decision.policy, AssignedPolicy::Existing(1));
    assert_eq!(merged(1.25).1, [0, 1], "its returns are clearly higher");
}

/// A merge can be undone: before a new policy is created, the merged one is tried.
#[test]
fn a_merged_policy_is_tried_again_where_the_other_does_not_serve() {
    for more in [1.05, 1.25] {
        let (mut recogniser, [kept, gone]) = merged(more);
        // the one that continues acts as in its own group in the group of the other one
        let foreign = rollout(KIND, 1000, gone, kept);
        let decision = settle(&recogniser, &foreign, kept);
        let proposed = AssignedPolicy::Existing(gone);
        assert_eq!(decision.policy, proposed, "{:#?}", decision.tests);
        assert!(decision.trial == RequiredTrial::Episodes && decision.is_provisional);
        assert!(!decision.rejected.contains(&gone));
        let rejected = &decision.rejected;
        let context =
            RolloutDecisionContext { rejected, is_provisional: true, ..must_decide(gone) };
        let elsewhere = review(&recogniser, &rollout(KIND, 1000, kept, gone), context);
        assert_eq!(elsewhere.policy, AssignedPolicy::New, "tried once");
        let own = rollout(KIND, 1000, gone, gone);
        assert_eq!(review(&recogniser, &own, context).policy, AssignedPolicy::Existing(gone));
        recogniser.record_training(gone, &own, &mut rng()).unwrap();
        assert_eq!(recogniser.merged_into(), [None, None]);
        let of_gone = assign(&recogniser, &own, gone);
        assert_eq!(
            recogniser.find_possible_duplicate(gone, &of_gone.accepted_policies()),
            None,
            "merged once"
        );
    }
}
