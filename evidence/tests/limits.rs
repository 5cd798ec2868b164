//! Sizes of differences at which policies are rejected, and the decisions that follow.

use cluster::{AssignedPolicy, PolicyVerdict};
use evidence::{
    EpisodeSummary, EvidenceError, Recogniser, RequiredTrial, RolloutDecision,
    RolloutDecisionContext,
};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::common::{
    assign, episodes, fresh, knowing_images, must_decide, review, rng, set_returns, settle,
};

/// Motion changes while a policy trains: what is certain and small beside chance is no other group.
#[test]
fn motion_that_changed_by_less_than_three_times_what_chance_makes_is_drift() {
    let (recogniser, mut rng) = knowing_images(&[0.0]);
    let mut test = |motion| {
        let seen = episodes(20, 0.0, motion, &mut rng);
        settle(&recogniser, &seen, 0).tests[0].clone()
    };
    let small = test(1.3);
    assert!(small.motion_change > 0.25 && small.tail_p_value() < 1e-6, "{small:?}");
    assert_eq!(small.verdict, PolicyVerdict::Accepted, "{small:?}");
    let between = test(1.6);
    let ratio = between.test.as_ref().unwrap().sources[2].unwrap().distance_ratio();
    assert!((2.0..3.0).contains(&ratio) && between.tail_p_value() < 1e-6, "{ratio}");
    assert_eq!(between.verdict, PolicyVerdict::Accepted);
    let large = test(2.2);
    assert_eq!(large.verdict, PolicyVerdict::Rejected, "{large:?}");
}

/// A policy that trains moves differently, and its returns rise.
#[test]
fn motion_that_changed_while_returns_rose_is_training() {
    let (recogniser, mut rng) = knowing_images(&[0.0]);
    let mut seen = episodes(20, 0.0, 2.2, &mut rng);
    let verdict = |episodes: &[EpisodeSummary]| settle(&recogniser, episodes, 0).tests[0].verdict;
    assert_eq!(verdict(&seen), PolicyVerdict::Rejected);
    set_returns(&mut seen, |value| value + 100.0);
    let test = settle(&recogniser, &seen, 0).tests[0].clone();
    assert_eq!(test.verdict, PolicyVerdict::Accepted);
    // a difference that does not count ends no test early, however certain it is
    assert!(test.tail_p_value() < 1e-6);
    let splits = test.test.unwrap().overall.null.permutations;
    assert_eq!(splits, recogniser.settings().permutations);
}

/// A false alarm creates a second policy of a group, which looks as right as the first one.
#[test]
fn a_policy_that_has_learnt_nothing_does_not_replace_one_that_has_and_is_only_doubted() {
    let proposed = |learnt: [bool; 2]| {
        let (mut recogniser, mut rng) = (fresh(), rng());
        for (policy, (image, has_learnt)) in [0.0, 0.12].into_iter().zip(learnt).enumerate() {
            let mut first = episodes(20, image, 1.0, &mut rng);
            if has_learnt {
                set_returns(&mut first, |_| 0.0);
            }
            for seen in [first, episodes(40, image, 1.0, &mut rng)] {
                recogniser.record_training(policy, &seen, &mut rng).unwrap();
            }
        }
        let seen = episodes(20, 0.12, 1.0, &mut ChaCha8Rng::seed_from_u64(77));
        let decision = assign(&recogniser, &seen, 0);
        let verdicts = [0, 1].map(|policy: usize| decision.tests[policy].verdict);
        assert_eq!(verdicts, [PolicyVerdict::Doubted, PolicyVerdict::Accepted]);
        decision.policy
    };
    assert_eq!(proposed([true, false]), AssignedPolicy::Undecided);
    for learnt in [[true, true], [false, true], [false, false]] {
        assert_eq!(proposed(learnt), AssignedPolicy::Existing(1), "{learnt:?}");
    }
}

/// Policies know images around these numbers; the second one acts in episodes around `seen`.
fn second_acts(known: &[f32], seen: f32) -> (Recogniser, RolloutDecision) {
    let (recogniser, mut rng) = knowing_images(known);
    let decision = settle(&recogniser, &episodes(20, seen, 1.0, &mut rng), 1);
    (recogniser, decision)
}

fn ratio(decision: &RolloutDecision) -> f64 {
    decision.tests[0].test.as_ref().unwrap().sources[0].unwrap().distance_ratio()
}

#[test]
fn a_policy_whose_group_drifted_is_tried_if_it_is_by_far_the_nearest() {
    for known in [&[0.0, 3.0][..], &[0.0, 3.0, -3.0]] {
        let (recogniser, decision) = second_acts(known, 0.45);
        assert_eq!(decision.tests[0].verdict, PolicyVerdict::Rejected);
        assert!(ratio(&decision) > 1.5, "{}", ratio(&decision));
        assert_eq!(decision.policy, AssignedPolicy::Existing(0), "{}", ratio(&decision));
        assert!(decision.is_provisional);
        // above the limit of a policy that was away and looked alike, and above all limits
        for (seen, ratios, expected) in
            [(0.45, 1.5..1.8, PolicyVerdict::Accepted), (0.8, 1.8..9.0, PolicyVerdict::Rejected)]
        {
            let context =
                RolloutDecisionContext { rejected: &[1], is_provisional: true, ..must_decide(0) };
            let mut rng = ChaCha8Rng::seed_from_u64(77);
            let seen = episodes(20, seen, 1.0, &mut rng);
            let reviewed = review(&recogniser, &seen, context);
            assert!(ratios.contains(&ratio(&reviewed)), "{}", ratio(&reviewed));
            assert_eq!(reviewed.tests[0].verdict, expected);
            assert_eq!(reviewed.group_changed, expected == PolicyVerdict::Rejected);
        }
    }
}

#[test]
fn no_policy_is_tried_that_is_too_far_or_as_far_as_another_one() {
    let far_or_between = [
        (&[0.0, 3.0, -3.0][..], 0.8),
        (&[0.0, -1.0, 1.0], 0.5),
        // the other one acts itself
        (&[0.0, 1.0], 0.5),
    ];
    for (known, seen) in far_or_between {
        let (_, decision) = second_acts(known, seen);
        assert_eq!(decision.policy, AssignedPolicy::New, "{}", ratio(&decision));
    }
}

/// The first updates of a policy may make it worse, which says nothing of its group.
#[test]
fn returns_of_a_policy_that_has_learnt_nothing_reject_nothing() {
    let verdict = |first_returns: [f32; 2]| {
        let (mut recogniser, mut rng) = (fresh(), rng());
        for returns in [first_returns, [0.0, 40.0]] {
            let mut seen = episodes(20, 0.0, 1.0, &mut rng);
            for (episode, &value) in seen.iter_mut().zip(returns.iter().cycle()) {
                episode.episode_return = Some(value);
            }
            recogniser.record_training(0, &seen, &mut rng).unwrap();
        }
        let mut worse = episodes(20, 0.0, 1.0, &mut rng);
        set_returns(&mut worse, |_| 1.0);
        review(&recogniser, &worse, must_decide(0)).tests[0].verdict
    };
    // the later returns are higher by less and by more than a standard deviation
    assert_eq!(verdict([0.0, 20.0]), PolicyVerdict::Accepted);
    assert_eq!(verdict([-20.0, 0.0]), PolicyVerdict::Rejected);
}

#[test]
fn new_groups_wait_while_eight_policies_are_untrained() {
    let (mut recogniser, mut rng) = knowing_images(&[0.0]);
    let groups: Vec<_> =
        (1_u8..=9).map(|group| episodes(20, 10.0 * f32::from(group), 1.0, &mut rng)).collect();
    // two equal rollouts
    let mut twice = |known: &mut Recogniser, group: usize, allow_undecided| {
        let context =
            RolloutDecisionContext { allow_undecided, ..RolloutDecisionContext::for_collector(0) };
        let mut assign =
            || known.assign_rollout(&groups[group - 1], context, &mut rng).unwrap().policy;
        ([assign(), assign()], known.policy_count())
    };
    for group in 1..=8 {
        let waits_once = [AssignedPolicy::Undecided, AssignedPolicy::New];
        assert_eq!(twice(&mut recogniser, group, true), (waits_once, group + 1));
    }
    let mut at_once = recogniser.clone();
    assert_eq!(twice(&mut recogniser, 9, true), ([AssignedPolicy::Undecided; 2], 9));
    // the next rollout creates the policy once another one has trained
    recogniser.record_training(3, &groups[2], &mut ChaCha8Rng::seed_from_u64(5)).unwrap();
    assert_eq!(
        twice(&mut recogniser, 9, true),
        ([AssignedPolicy::New, AssignedPolicy::Existing(9)], 10)
    );
    // where no rollout may stay undecided, there is no limit
    assert_eq!(
        twice(&mut at_once, 9, false),
        ([AssignedPolicy::New, AssignedPolicy::Existing(9)], 10)
    );
}

/// Policy 0 was proposed, and acts where the group has become that of policy 1.
#[test]
fn a_group_that_changed_before_the_trial_is_judged_anew() {
    let review = |images: &[f32], allow_undecided| {
        let (mut recogniser, mut rng) = knowing_images(&[0.0, 10.0]);
        let seen = twenty_each(images, &mut rng);
        let context = RolloutDecisionContext {
            allow_undecided,
            rejected: &[1],
            ..RolloutDecisionContext::for_collector(0)
        };
        let before = recogniser.clone();
        let found = recogniser.review_proposed_policy(&seen, context, &mut rng).unwrap();
        let keeps_rollout = recogniser != before;
        let next = episodes(20, 10.0, 1.0, &mut rng);
        let next = recogniser
            .assign_rollout(&next, RolloutDecisionContext::for_collector(0), &mut rng)
            .unwrap();
        assert_eq!(next.policy, AssignedPolicy::Existing(1));
        let part = found.changepoint.map(|changepoint| (changepoint, keeps_rollout));
        (found.policy, found.trial, part, found.group_changed)
    };
    let other = AssignedPolicy::Existing(1);
    // in the whole rollout, so that policy 1 may train on it
    for allow_undecided in [true, false] {
        assert_eq!(review(&[10.0], allow_undecided), (other, RequiredTrial::Waived, None, true));
    }
    // in a part of the rollout, after a third group, so that policy 1 needs a rollout of its own
    let waits = review(&[20.0, 10.0], true);
    assert_eq!((waits.0, waits.2, waits.3), (AssignedPolicy::Undecided, Some((20, true)), true));
    let decides = review(&[20.0, 10.0], false);
    assert_eq!(decides, (other, RequiredTrial::None, Some((20, false)), true));
    // in the earlier part, on which policy 0 would train, and the later one is its own
    let mixed = review(&[10.0, 0.0], true);
    assert_eq!((mixed.0, mixed.2, mixed.3), (AssignedPolicy::Undecided, Some((20, false)), true));
    // the group of policy 0 came first
    let stays = review(&[0.0, 10.0], true);
    assert_eq!((stays.0, stays.3), (AssignedPolicy::Existing(0), false));
}

/// Episodes one after the other, whose images scatter around these numbers, 20 around each.
fn twenty_each(images: &[f32], rng: &mut ChaCha8Rng) -> Vec<EpisodeSummary> {
    let seen = images.iter().flat_map(|&image| episodes(20, image, 1.0, rng));
    let numbered = seen.enumerate().map(|(began, summary)| EpisodeSummary { began, ..summary });
    numbered.collect()
}

/// Policy 0 acts in two groups, the later of which is its own.
#[test]
fn a_policy_does_not_train_on_what_came_before_its_group() {
    let (mut recogniser, mut rng) = knowing_images(&[0.0, 10.0]);
    let mut decide = |images: &[f32], allow_undecided| {
        let seen = twenty_each(images, &mut rng);
        let context =
            RolloutDecisionContext { allow_undecided, ..RolloutDecisionContext::for_collector(0) };
        let found = recogniser.assign_rollout(&seen, context, &mut rng).unwrap();
        (found.policy, found.changepoint)
    };
    let own = AssignedPolicy::Existing(0);
    assert_eq!(decide(&[0.0, 0.0], true), (own, None));
    for earlier in [10.0, 20.0] {
        assert_eq!(decide(&[earlier, 0.0], true), (AssignedPolicy::Undecided, Some(20)));
        assert_eq!(decide(&[earlier, 0.0], false), (own, Some(20)));
    }
}

#[test]
fn a_policy_trains_on_a_rollout_that_changes_within_its_group() {
    let (mut recogniser, mut rng) = knowing_images(&[0.0]);
    recogniser.record_training(0, &episodes(20, 0.2, 1.0, &mut rng), &mut rng).unwrap();
    let seen = twenty_each(&[0.0, 0.2], &mut rng);
    let context = RolloutDecisionContext::for_collector(0);
    let found = recogniser.assign_rollout(&seen, context, &mut rng).unwrap();
    assert_eq!((found.policy, found.changepoint), (AssignedPolicy::Existing(0), Some(20)));
}

/// Policy 0 was proposed for images that differed from those of policy 1, and acts for so few
/// episodes that they reject it only at the level of screening.
#[test]
fn a_few_episodes_that_fit_a_policy_that_differed_show_that_the_group_changed() {
    let (recogniser, mut rng) = knowing_images(&[0.0, 0.4]);
    let seen = episodes(5, 0.4, 1.0, &mut rng);
    let reviewed = |differing| {
        let context = RolloutDecisionContext {
            rejected: &[1],
            differing,
            ..RolloutDecisionContext::for_collector(0)
        };
        let found = review(&recogniser, &seen, context);
        (found.policy, found.group_changed)
    };
    assert_eq!(reviewed(&[]), (AssignedPolicy::Existing(0), false));
    assert_eq!(reviewed(&[1]), (AssignedPolicy::Existing(1), true));
}

/// Images that differ by more than those of one group do, and less than those of a group that
/// drifted while another policy trained.
#[test]
fn a_policy_that_collects_after_others_trained_may_differ_more() {
    let (recogniser, mut random) = knowing_images(&[0.0, 10.0]);
    let seen = episodes(20, 0.28, 1.0, &mut random);
    let first_group = episodes(20, 0.0, 1.0, &mut random);
    let decided = |trains_again| {
        let mut own = recogniser.clone();
        if trains_again {
            own.record_training(0, &first_group, &mut rng()).unwrap();
        }
        let found = own.assign_rollout(&seen, must_decide(0), &mut rng()).unwrap();
        assert!((1.2..1.5).contains(&ratio(&found)), "{}", ratio(&found));
        found.policy
    };
    assert_eq!(decided(true), AssignedPolicy::New);
    assert_eq!(decided(false), AssignedPolicy::Existing(0));
}

/// Six remembered episodes are too few to reject the next ones at the final level, and forty are
/// not.
#[test]
fn a_policy_that_remembers_few_episodes_is_not_named_by_default() {
    let decided = |remembered, allow_undecided| {
        let (mut recogniser, mut rng) = (fresh(), rng());
        recogniser.record_training(0, &episodes(remembered, 0.0, 1.0, &mut rng), &mut rng).unwrap();
        let context =
            RolloutDecisionContext { allow_undecided, ..RolloutDecisionContext::for_collector(0) };
        let seen = episodes(10, 0.28, 1.0, &mut rng);
        let mut assign = || recogniser.assign_rollout(&seen, context, &mut rng).unwrap().policy;
        [assign(), assign()]
    };
    let own = AssignedPolicy::Existing(0);
    assert_eq!(decided(6, true), [AssignedPolicy::Undecided; 2]);
    assert_eq!(decided(6, false)[0], own);
    assert_eq!(decided(40, true), [AssignedPolicy::Undecided, AssignedPolicy::New]);
}

/// A policy collects where first images fit it much better than the current one, and no other one.
#[test]
fn first_images_choose_the_policy_that_collects() {
    let (recogniser, mut rng) = knowing_images(&[0.0, 10.0, 10.0]);
    let mut chosen = |count, image, current| {
        let mut seen = episodes(count, image, 1.0, &mut rng);
        seen.iter_mut().for_each(EpisodeSummary::keep_only_first_observation);
        recogniser.choose_collector(&seen, current, &mut rng)
    };
    assert_eq!(chosen(10, 0.0, 0), Ok(0));
    assert_eq!(chosen(10, 0.0, 1), Ok(0));
    for current in [1, 2] {
        assert_eq!(chosen(10, 10.0, current), Ok(current));
    }
    // two that look alike need a trial
    assert_eq!(chosen(10, 10.0, 0), Ok(0));
    // images that no policy knows, or too few of them
    assert_eq!(chosen(10, 20.0, 1), Ok(1));
    assert_eq!(chosen(3, 10.0, 0), Ok(0));
    assert_eq!(chosen(10, 10.0, 4), Err(EvidenceError::NoPolicy { policy: 4, policies: 3 }));
}

/// An arm settles at a slightly different height in each of the mirrored variants, always alike.
#[test]
fn vectors_that_differ_too_little_to_count_do_not_hide_a_group() {
    let starts_at = |seen: &mut [EpisodeSummary], heights: [f32; 2]| {
        for (episode, height) in seen.iter_mut().zip(heights.iter().cycle()) {
            episode.first_vector = vec![*height];
        }
    };
    let (mut rng, mut recogniser) = (rng(), fresh());
    let mut known = episodes(40, 0.0, 1.0, &mut rng);
    starts_at(&mut known, [0.50, 0.51]);
    recogniser.record_training(0, &known, &mut rng).unwrap();
    let mut seen = episodes(20, 0.0, 1.0, &mut rng);
    let mut named = |heights| {
        starts_at(&mut seen, heights);
        let found = recogniser.task_group_probabilities(&seen, &mut rng).unwrap();
        (found.most_probable_policy(), found.fits_any_policy())
    };
    assert_eq!(named([0.51, 0.51]), (Some(0), true));
    assert_eq!(named([0.60, 0.60]), (None, false));
}
