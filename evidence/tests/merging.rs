//! Policies that turn out to serve one group.

use cluster::{Decision, Verdict};
use evidence::{Account, Recogniser, Situation, Trial};
use worlds::WorldKind;

use crate::common::{accounts, knowing, look, rng, rollout, said, settle, stream};

/// Two policies that trained on one group become one, and two that did not stay two; a merged one
/// is not proposed while others will do.
#[test]
fn policies_that_serve_one_group_are_merged() {
    let kind = WorldKind::Target;
    let mut recogniser = knowing(kind, 1000, 2);
    let twin = accounts(stream(kind, 1000, &[(0, 16)], 5), 16, None)[40..].to_vec();
    let mut beginning = twin[..20].to_vec();
    beginning.iter_mut().for_each(|a| a.earned = Some(0.0));
    recogniser.learn(2, &beginning, &mut rng()).unwrap();
    recogniser.learn(2, &twin[20..], &mut rng()).unwrap();
    recogniser.learn(2, &twin[20..], &mut rng()).unwrap();
    let seen = rollout(kind, 1000, 0, 0);
    let finding = look(&recogniser, &seen, 0);
    assert_eq!(recogniser.twin(0, &finding.accepted()), Some(1), "it looks alike");
    let of_other = rollout(kind, 1000, 0, 1);
    assert!(!recogniser.compare(0, 1, &of_other, &mut rng()).unwrap());
    assert_eq!(recogniser.twin(0, &finding.accepted()), Some(2));
    assert!(recogniser.compare(0, 2, &seen[..5], &mut rng()).unwrap());
    recogniser.merge(0, 2, &seen[..5], &seen[5..], &mut rng()).unwrap();
    assert_eq!(recogniser.heirs(), [Some(2), None, None], "policy 2 acted in both groups");
    let after_merge = look(&recogniser, &seen, 2);
    assert_eq!(after_merge.opinions[0].verdict, Verdict::Rejected);
    assert_eq!(recogniser.twin(2, &after_merge.accepted()), None);
    let found = recogniser.recognise(&seen, &mut rng()).unwrap();
    assert_eq!(found.policies[0], 0.0);
}

const KIND: WorldKind = WorldKind::Reward;

/// A recogniser of two policies at home in two groups, the second of which serves in the first
/// group, too, where the first one earns `more` times what it would. Both were merged: returns the
/// one that continues and the merged one.
fn merged(more: f32) -> (Recogniser, [usize; 2]) {
    let mut recogniser = knowing(KIND, 1000, 2);
    let richer = |mut accounts: Vec<Account>| {
        let earned = accounts.iter_mut().filter_map(|a| a.earned.as_mut());
        earned.for_each(|earned| *earned *= more);
        accounts
    };
    let home = accounts(stream(KIND, 1000, &[(0, 8)], 5), 8, None);
    recogniser.learn(0, &richer(home), &mut rng()).unwrap();
    let seen = rollout(KIND, 1000, 0, 0);
    assert!(recogniser.compare(0, 1, &seen[..5], &mut rng()).unwrap());
    let again = richer(seen[5..].to_vec());
    recogniser.merge(0, 1, &seen[..5], &again, &mut rng()).unwrap();
    let pair = if recogniser.heirs()[0].is_some() { [1, 0] } else { [0, 1] };
    assert_eq!(recogniser.heirs()[pair[1]], Some(pair[0]));
    (recogniser, pair)
}

/// The first policy never acted in the second one's group: it would leave that group without a
/// policy.
#[test]
fn of_two_policies_the_one_that_acted_in_both_groups_continues() {
    let (recogniser, pair) = merged(1.05);
    assert_eq!(pair, [1, 0]);
    let finding = look(&recogniser, &rollout(KIND, 1000, 1, 1), 1);
    assert_eq!(finding.decision, Decision::Existing(1));
    assert_eq!(merged(1.25).1, [0, 1], "it earns clearly more");
}

/// A merge can be undone: before a new policy is created, the merged one is tried.
#[test]
fn a_merged_policy_whose_heir_does_not_serve_is_tried_again() {
    for more in [1.05, 1.25] {
        let (mut recogniser, [kept, gone]) = merged(more);
        // the one that continues acts as at home in the group of the other one
        let foreign = rollout(KIND, 1000, gone, kept);
        let finding = settle(&recogniser, &foreign, kept);
        let proposed = Decision::Existing(gone);
        assert_eq!(finding.decision, proposed, "{:#?}", said(&finding));
        assert!(finding.trial == Trial::Episodes && finding.is_provisional);
        assert!(!finding.rejected.contains(&gone));
        let review = |seen: &[Account]| {
            let situation = Situation {
                collector: gone,
                rejected: &finding.rejected,
                is_provisional: true,
                can_wait: false,
            };
            recogniser.clone().review(seen, situation, &mut rng()).unwrap()
        };
        let elsewhere = review(&rollout(KIND, 1000, kept, gone));
        assert_eq!(elsewhere.decision, Decision::New, "tried once");
        let own = rollout(KIND, 1000, gone, gone);
        assert_eq!(review(&own).decision, Decision::Existing(gone));
        recogniser.learn(gone, &own, &mut rng()).unwrap();
        assert_eq!(recogniser.heirs(), [None, None]);
        let of_gone = look(&recogniser, &own, gone);
        assert_eq!(recogniser.twin(gone, &of_gone.accepted()), None, "merged once");
    }
}
