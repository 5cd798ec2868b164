//! Decisions on episodes of drawn worlds.

use cluster::{AssignedPolicy, PolicyVerdict};
use evidence::{
    EpisodeSummariser, EpisodeSummary, ImageFeatureCache, PreviousParameters, Recogniser,
    RecogniserSettings, RequiredTrial, RolloutDecisionContext,
};
use symmetry::{D2, Irrep};
use worlds::WorldKind;

use crate::common::{
    HORIZON, assign, episodes, fresh, knowing, must_decide, review, rng, rollout, set_returns,
    settle, stream, summaries, summaries_of, trajectories,
};

#[test]
fn summaries_of_mirror_images_are_equal_to_the_bit() {
    for kind in WorldKind::ALL {
        let of = |g| summaries(stream(kind, 1000, &[(0, 2)], 3).mirrored_by(g), 2, None);
        let straight = of(D2::Identity);
        for g in D2::ALL {
            assert_eq!(of(g), straight, "{} {g}", kind.name());
        }
    }
}

/// Screening doubts a known group in two cases of a hundred: of twelve, one may be undecided.
#[test]
fn groups_that_look_different_are_told_apart_by_screening() {
    let mut undecided = 0;
    for kind in [WorldKind::Appearance, WorldKind::Shape] {
        let recogniser = knowing(kind, 1000, 3);
        for (group, collector) in (0..3).flat_map(|g| [(g, g), (g, (g + 1) % 3)]) {
            let seen = rollout(kind, 1000, group, group);
            let decision = assign(&recogniser, &seen, collector);
            if decision.policy == AssignedPolicy::Undecided {
                undecided += 1;
                continue;
            }
            let (name, expected) = (kind.name(), AssignedPolicy::Existing(group));
            assert_eq!(decision.policy, expected, "{name} {:#?}", decision.tests);
        }
        let unknown = rollout(kind, 1000, 3, 0);
        let decision = assign(&recogniser, &unknown, 0);
        assert_eq!(decision.policy, AssignedPolicy::Undecided);
        let second = settle(&recogniser, &unknown, 0);
        assert_eq!(second.policy, AssignedPolicy::New);
    }
    assert!(undecided <= 1, "{undecided}");
}

#[test]
fn groups_that_look_alike_are_told_apart_by_motion_and_returns() {
    for kind in [WorldKind::Target, WorldKind::Reward, WorldKind::Dynamics] {
        let recogniser = knowing(kind, 1000, 2);
        let verdict = |group, policy| {
            let seen = rollout(kind, 1000, group, policy);
            let decision = review(&recogniser, &seen, must_decide(policy));
            (decision.tests[policy].verdict, decision.policy)
        };
        let (name, accepted) = (kind.name(), PolicyVerdict::Accepted);
        assert_eq!(verdict(0, 0), (accepted, AssignedPolicy::Existing(0)), "{name}");
        assert_eq!(verdict(1, 1), (accepted, AssignedPolicy::Existing(1)), "{name}");
        assert_eq!(verdict(1, 0), (PolicyVerdict::Rejected, AssignedPolicy::Existing(1)), "{name}");
    }
}

#[test]
fn no_more_policies_are_created_than_the_settings_allow() {
    let unknown = rollout(WorldKind::Appearance, 1000, 3, 0);
    let state = knowing(WorldKind::Appearance, 1000, 3);
    let state = state.serialise_state(serde_json::value::Serializer).unwrap();
    let bounded = |max_policies| {
        let settings = RecogniserSettings { max_policies, ..RecogniserSettings::default() };
        let mut recogniser = Recogniser::new(settings).unwrap();
        recogniser.restore_state(&state).unwrap();
        recogniser
    };
    assert_eq!(settle(&bounded(4), &unknown, 0).policy, AssignedPolicy::New);
    // whichever policy acted and whichever were rejected before, the same one is the most similar
    let named = [(0, &[][..]), (1, &[0]), (2, &[0, 1])].map(|(reviewed, rejected)| {
        let mut full = bounded(3);
        let context = RolloutDecisionContext { rejected, ..must_decide(reviewed) };
        let found = full.review_proposed_policy(&unknown, context, &mut rng()).unwrap();
        assert!(found.trial == RequiredTrial::None && full.policy_count() == 3, "{found:?}");
        found.policy
    });
    assert!(
        matches!(named[0], AssignedPolicy::Existing(0..3)) && named == [named[0]; 3],
        "{named:?}"
    );
}

/// Rollouts need not be a multiple of the horizon: their last episodes are still running.
#[test]
fn running_episodes_at_the_end_do_not_hide_motion_and_returns() {
    let running = |mut summaries: Vec<EpisodeSummary>, from: usize| {
        summaries[from..].iter_mut().for_each(EpisodeSummary::keep_only_first_observation);
        summaries
    };
    let mut recogniser = fresh();
    let all = summaries(stream(WorldKind::Dynamics, 1000, &[(0, 8)], 5), 8, None);
    for rollout in all.chunks(20) {
        let rollout = running(rollout.to_vec(), 15);
        recogniser.record_training(0, &rollout, &mut rng()).unwrap();
    }
    let tested = |group, from| {
        let seen = running(rollout(WorldKind::Dynamics, 1000, group, 0), from);
        let decision = review(&recogniser, &seen, must_decide(0));
        let sources = decision.tests[0].test.as_ref().unwrap().sources.len();
        (sources, decision.tests[0].verdict)
    };
    assert_eq!(tested(0, 15), (5, PolicyVerdict::Accepted));
    assert_eq!(tested(1, 15), (5, PolicyVerdict::Rejected));
    let first_observations_alone = (2, PolicyVerdict::Accepted);
    assert_eq!(tested(1, 9), first_observations_alone, "fewer than half are whole");
}

/// Number of episodes that a recogniser remembers for a policy.
fn remembered(recogniser: &Recogniser, policy: usize) -> usize {
    let state = recogniser.serialise_state(serde_json::value::Serializer).unwrap();
    state["policies"][policy]["accounts"].as_array().unwrap().len()
}

#[test]
fn a_switch_is_found_before_running_episodes() {
    let visits = [(0, 2), (1, 2)];
    let mut mixed = summaries(stream(WorldKind::Dynamics, 1000, &visits, 5), 4, Some(0));
    mixed[15..].iter_mut().for_each(EpisodeSummary::keep_only_first_observation);
    let mut recogniser = fresh();
    recogniser.record_training(0, &mixed, &mut rng()).unwrap();
    assert_eq!(remembered(&recogniser, 0), 10);
}

#[test]
fn a_rejected_policy_is_not_proposed_again() {
    let recogniser = knowing(WorldKind::Target, 1000, 2);
    let seen = rollout(WorldKind::Target, 1000, 1, 0);
    let context = RolloutDecisionContext { rejected: &[1], ..must_decide(0) };
    let decision = review(&recogniser, &seen, context);
    assert_eq!(decision.policy, AssignedPolicy::New);
    assert!(decision.rejected.contains(&0) && decision.rejected.contains(&1));
}

#[test]
fn a_rollout_that_straddles_a_switch_is_cut_at_the_episode() {
    let recogniser = knowing(WorldKind::Appearance, 1000, 2);
    for before in [1, 2, 3] {
        let visits = [(0, before), (1, 4 - before)];
        let mixed = summaries(stream(WorldKind::Appearance, 1000, &visits, 5), 4, Some(0));
        let decision = assign(&recogniser, &mixed, 0);
        let began = before * HORIZON * 5;
        assert_eq!(
            (decision.policy, decision.changepoint),
            (AssignedPolicy::Existing(1), Some(began))
        );
    }
    let whole = summaries(stream(WorldKind::Appearance, 1000, &[(0, 4)], 5), 4, Some(0));
    let decision = assign(&recogniser, &whole, 0);
    assert_eq!((decision.policy, decision.changepoint), (AssignedPolicy::Existing(0), None));
}

/// A rollout that is reused creates a policy, which then trains on it.
#[test]
fn a_rollout_that_created_its_policy_is_remembered_once() {
    let mut recogniser = knowing(WorldKind::Appearance, 1000, 1);
    let mut seen = rollout(WorldKind::Appearance, 1000, 1, 0);
    let found = recogniser.assign_rollout(&seen, must_decide(0), &mut rng()).unwrap();
    assert_eq!(found.policy, AssignedPolicy::New);
    seen.iter_mut().for_each(EpisodeSummary::keep_only_first_observation);
    recogniser.record_training(1, &seen, &mut rng()).unwrap();
    assert_eq!(remembered(&recogniser, 1), seen.len());
}

#[test]
fn one_episode_names_its_policy_or_none_and_more_are_surer() {
    let recogniser = knowing(WorldKind::Appearance, 1000, 3);
    for group in 0..4 {
        let seen = rollout(WorldKind::Appearance, 1000, group, 0);
        for episodes in [1, 4, 20] {
            let found = recogniser.task_group_probabilities(&seen[..episodes], &mut rng()).unwrap();
            let sum = found.policies.iter().sum::<f64>() + found.none;
            assert!((sum - 1.0).abs() < 1e-12);
            if episodes > 1 {
                let expected = (group < 3).then_some(group);
                assert_eq!(
                    found.most_probable_policy(),
                    expected,
                    "{episodes} of {group}: {found:?}"
                );
            }
        }
    }
    assert!(recogniser.task_group_probabilities(&[], &mut rng()).is_err());
}

#[test]
fn a_policy_that_remembers_too_little_is_not_named() {
    let mut recogniser = knowing(WorldKind::Appearance, 1000, 1);
    let few = rollout(WorldKind::Appearance, 1000, 1, 1);
    recogniser.record_training(1, &few[..3], &mut rng()).unwrap();
    let seen = rollout(WorldKind::Appearance, 1000, 0, 0);
    let found = recogniser.task_group_probabilities(&seen, &mut rng()).unwrap();
    assert_eq!((found.most_probable_policy(), found.policies[1]), (Some(0), 0.0));
}

/// The first frames of some tasks never vary: nothing is divided by zero, and others differ.
#[test]
fn frames_that_are_all_equal_say_nothing_of_each_other() {
    let mut recogniser = fresh();
    let still = |value: f32| {
        let mut summaries = episodes(20, 0.0, 0.0, &mut rng());
        summaries.iter_mut().for_each(|summary| summary.image_features.fill(value));
        summaries.iter_mut().for_each(EpisodeSummary::keep_only_first_observation);
        summaries
    };
    recogniser.record_training(0, &still(1.0), &mut rng()).unwrap();
    let same = assign(&recogniser, &still(1.0), 0);
    assert_eq!(same.policy, AssignedPolicy::Existing(0));
    let test = same.tests[0].test.as_ref().unwrap();
    assert!(test.sources.iter().all(Option::is_none) && test.overall.score.is_finite());
    assert_eq!(settle(&recogniser, &still(2.0), 0).policy, AssignedPolicy::New);
}

#[test]
fn a_cache_changes_no_summary() {
    let spec = [Irrep::X, Irrep::Y];
    let summariser = EpisodeSummariser::new([48, 48, 6], &spec, &spec, 32).unwrap();
    let trajectories = trajectories(stream(WorldKind::Drift, 1000, &[(0, 2)], 5), 2, None);
    let mut cache = ImageFeatureCache::default();
    let first = summariser.summarise(&trajectories, &mut cache).unwrap();
    assert_eq!(summariser.summarise(&trajectories, &mut cache).unwrap(), first);
    let mut other = trajectories[0].clone();
    other.image[0] ^= 255;
    let changed = summariser.summarise(&[other], &mut cache).unwrap();
    assert_ne!(changed[0].image_features, first[0].image_features);
}

/// Colours stray while a policy is away: it is tried before a new one is created, and what it
/// remembers is renewed.
#[test]
fn a_policy_whose_group_drifted_meanwhile_is_tried() {
    let kind = WorldKind::Drift;
    let mut tried = 0;
    for seed in 1000..1006 {
        let mut recogniser = fresh();
        for group in 0..2 {
            let mut all = summaries(stream(kind, seed, &[(group, 12)], 5), 12, None);
            set_returns(&mut all[..20], |_| 0.0);
            for rollout in all.chunks(20) {
                recogniser.record_training(group, rollout, &mut rng()).unwrap();
            }
        }
        let visits = [(1, 8), (0, 242), (1, 8)];
        let late = summaries_of(&trajectories(stream(kind, seed, &visits, 5), 258, None)[1250..]);
        let decision = settle(&recogniser, &late, 0);
        if decision.tests[1].verdict == PolicyVerdict::Accepted {
            continue;
        }
        assert_ne!(decision.policy, AssignedPolicy::Existing(0), "seed {seed}");
        if decision.policy == AssignedPolicy::New {
            continue;
        }
        tried += 1;
        assert!(decision.trial == RequiredTrial::Episodes && !decision.rejected.contains(&1));
        let is_provisional = decision.is_provisional;
        let rejected = &decision.rejected;
        let context = RolloutDecisionContext { rejected, is_provisional, ..must_decide(1) };
        let own = review(&recogniser, &late[..20], context);
        assert_eq!(own.policy, AssignedPolicy::Existing(1), "seed {seed}: {:#?}", own.tests);
        recogniser.record_training(1, &late[..20], &mut rng()).unwrap();
        let next = settle(&recogniser, &late[20..], 1);
        assert_eq!(next.policy, AssignedPolicy::Existing(1), "seed {seed}");
    }
    assert!(tried > 0);
}

/// Images and vectors rejected the policy before it acted: its own episodes with returns a fifth
/// lower than before are no proof, though they are no evidence against it, either.
#[test]
fn a_provisional_policy_must_keep_its_return() {
    let kind = WorldKind::Target;
    let recogniser = knowing(kind, 1000, 2);
    let reviewed = |share: f32, is_provisional, differing| {
        let mut seen = rollout(kind, 1000, 0, 0);
        set_returns(&mut seen, |value| value * share);
        let context = must_decide(0);
        let context =
            RolloutDecisionContext { rejected: &[1], differing, is_provisional, ..context };
        review(&recogniser, &seen, context)
    };
    let decision = |share, is_provisional| {
        let decision = reviewed(share, is_provisional, &[]);
        assert!(!decision.is_provisional || is_provisional);
        decision.policy
    };
    assert_eq!(decision(1.0, true), AssignedPolicy::Existing(0));
    assert_eq!(decision(0.8, false), AssignedPolicy::Existing(0));
    assert_eq!(decision(0.8, true), AssignedPolicy::New);
    // images that it was not proposed for have become its own: the group has changed
    let changed = reviewed(0.8, true, &[0]);
    assert_eq!((changed.policy, changed.group_changed), (AssignedPolicy::Existing(0), true));
}

/// Colours stray over hundreds of rounds; what is remembered is the latest.
#[test]
fn slow_drift_splits_nothing() {
    for seed in 1000..1002 {
        let all = summaries(stream(WorldKind::Drift, seed, &[(0, 100)], 5), 100, None);
        let mut recogniser = fresh();
        for rollout in all.chunks(20) {
            if recogniser.policy_count() > 0 {
                let decision = settle(&recogniser, rollout, 0);
                assert_eq!(decision.policy, AssignedPolicy::Existing(0), "seed {seed}");
            }
            recogniser.record_training(0, rollout, &mut rng()).unwrap();
        }
    }
}

#[test]
fn a_new_policy_remembers_only_the_group_it_was_created_for() {
    let mut recogniser = knowing(WorldKind::Appearance, 1000, 1);
    let mixed = summaries(stream(WorldKind::Appearance, 1000, &[(1, 2), (2, 2)], 5), 4, Some(1));
    recogniser.record_training(1, &mixed, &mut rng()).unwrap();
    let one = recogniser
        .task_group_probabilities(&rollout(WorldKind::Appearance, 1000, 1, 0), &mut rng());
    assert_eq!(one.unwrap().most_probable_policy(), Some(1));
    let other = recogniser
        .task_group_probabilities(&rollout(WorldKind::Appearance, 1000, 2, 0), &mut rng());
    assert_eq!(other.unwrap().most_probable_policy(), None);
}

/// Episodes that look like those a policy trained on, with other motion and without returns: its
/// latest update made it worse, or the group is another one.
#[test]
fn a_policy_that_its_own_update_made_worse_is_no_foreign_group() {
    let mut generator = rng();
    let mut trained = fresh();
    for returns in [0.0, 1.0, 1.0] {
        let mut seen = episodes(20, 1.0, 1.0, &mut generator);
        set_returns(&mut seen, |_| returns);
        trained.record_training(0, &seen, &mut generator).unwrap();
    }
    let mut changed = || {
        let mut seen = episodes(20, 1.0, 9.0, &mut generator);
        set_returns(&mut seen, |_| 0.0);
        seen
    };
    let [first, second, third, later] = [changed(), changed(), changed(), changed()];
    let as_before = episodes(20, 1.0, 1.0, &mut generator);
    let mut look_different = || episodes(20, 9.0, 1.0, &mut generator);
    let other_images = [look_different(), look_different()];
    let [unavailable, available, acted] =
        [PreviousParameters::Unavailable, PreviousParameters::Available, PreviousParameters::Acted];
    let mut decide = |recogniser: &mut Recogniser, seen: &[EpisodeSummary], previous_parameters| {
        let context = RolloutDecisionContext {
            previous_parameters,
            ..RolloutDecisionContext::for_collector(0)
        };
        let decision = recogniser.assign_rollout(seen, context, &mut generator).unwrap();
        (decision.policy, decision.trial == RequiredTrial::PreviousParameters)
    };
    let (same, new) = ((AssignedPolicy::Existing(0), false), (AssignedPolicy::New, false));
    let (undecided, retry) =
        ((AssignedPolicy::Undecided, false), (AssignedPolicy::Undecided, true));

    // without the previous parameters two such rollouts create a policy
    let mut without = trained.clone();
    assert_eq!(decide(&mut without, &first, unavailable), undecided);
    assert_eq!(decide(&mut without, &second, unavailable), new);

    let mut recogniser = trained.clone();
    assert_eq!(decide(&mut recogniser, &first, available), undecided);
    assert_eq!(decide(&mut recogniser, &second, available), retry);
    let mut in_foreign_group = recogniser.clone();
    assert_eq!(decide(&mut in_foreign_group, &third, acted), new);
    // the previous parameters serve: the group is the same, and the doubted rollouts are remembered
    assert_eq!(decide(&mut recogniser, &as_before, acted), same);
    let state = recogniser.serialise_state(serde_json::value::Serializer).unwrap();
    let mut restored = fresh();
    restored.restore_state(state).unwrap();
    assert_eq!(restored, recogniser);
    recogniser.record_training(0, &as_before, &mut rng()).unwrap();
    assert_eq!(decide(&mut recogniser, &later, available), same);

    // the latest update cannot explain what was doubted before it
    let mut updated = trained.clone();
    assert_eq!(decide(&mut updated, &first, available), undecided);
    updated.record_training(0, &as_before, &mut rng()).unwrap();
    assert_eq!(decide(&mut updated, &second, available), new);

    // images that differ are not due to an update
    assert_eq!(decide(&mut trained, &other_images[0], available), undecided);
    assert_eq!(decide(&mut trained, &other_images[1], available), new);
}
