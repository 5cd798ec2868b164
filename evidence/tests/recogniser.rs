//! Decisions on episodes of drawn worlds.

use cluster::{Decision, Verdict};
use evidence::{Account, Accountant, Album, Recogniser, RecogniserSettings, Situation, Trial};
use symmetry::{D2, Irrep};
use worlds::WorldKind;

use crate::common::{
    HORIZON, accounts, accounts_of, courses, episodes, knowing, look, rng, rollout, said, settle,
    stream,
};

#[test]
fn accounts_of_mirror_images_are_equal_to_the_bit() {
    for kind in WorldKind::ALL {
        let of = |g| accounts(stream(kind, 1000, &[(0, 2)], 3).with_variant(g), 2, None);
        let straight = of(D2::Identity);
        for g in D2::ALL {
            assert_eq!(of(g), straight, "{} {g}", kind.name());
        }
    }
}

/// A first look doubts a known group in two cases of a hundred: of twelve, one may be undecided.
#[test]
fn what_looks_different_is_told_apart_at_the_first_look() {
    let mut undecided = 0;
    for kind in [WorldKind::Appearance, WorldKind::Shape] {
        let recogniser = knowing(kind, 1000, 3);
        for (group, collector) in (0..3).flat_map(|g| [(g, g), (g, (g + 1) % 3)]) {
            let seen = rollout(kind, 1000, group, group);
            let finding = look(&recogniser, &seen, collector);
            if finding.decision == Decision::Undecided {
                undecided += 1;
                continue;
            }
            let (name, expected) = (kind.name(), Decision::Existing(group));
            assert_eq!(finding.decision, expected, "{name} {:#?}", said(&finding));
        }
        let unknown = rollout(kind, 1000, 3, 0);
        let finding = look(&recogniser, &unknown, 0);
        assert_eq!(finding.decision, Decision::Undecided);
        let second = settle(&recogniser, &unknown, 0);
        assert_eq!(second.decision, Decision::New);
    }
    assert!(undecided <= 1, "{undecided}");
}

#[test]
fn what_looks_alike_is_told_apart_by_what_happens() {
    for kind in [WorldKind::Target, WorldKind::Reward, WorldKind::Dynamics] {
        let recogniser = knowing(kind, 1000, 2);
        let verdict = |group, policy| {
            let seen = rollout(kind, 1000, group, policy);
            let situation = Situation { collector: policy, ..Situation::default() };
            let finding = recogniser.clone().review(&seen, situation, &mut rng()).unwrap();
            (finding.opinions[policy].verdict, finding.decision)
        };
        let (name, accepted) = (kind.name(), Verdict::Accepted);
        assert_eq!(verdict(0, 0), (accepted, Decision::Existing(0)), "{name}");
        assert_eq!(verdict(1, 1), (accepted, Decision::Existing(1)), "{name}");
        assert_eq!(verdict(1, 0), (Verdict::Rejected, Decision::Existing(1)), "{name}");
    }
}

#[test]
fn no_more_policies_are_created_than_the_settings_allow() {
    let unknown = rollout(WorldKind::Appearance, 1000, 3, 0);
    let state = knowing(WorldKind::Appearance, 1000, 3);
    let state = state.state(serde_json::value::Serializer).unwrap();
    let bounded = |max_policies| {
        let settings = RecogniserSettings { max_policies, ..RecogniserSettings::default() };
        let mut recogniser = Recogniser::new(settings).unwrap();
        recogniser.restore(&state).unwrap();
        recogniser
    };
    assert_eq!(settle(&bounded(4), &unknown, 0).decision, Decision::New);
    // whichever policy acted and whichever were rejected before, the same one is the most similar
    let named = [(0, &[][..]), (1, &[0]), (2, &[0, 1])].map(|(reviewed, rejected)| {
        let mut full = bounded(3);
        let situation = Situation { rejected, can_wait: false, ..Situation::of(reviewed) };
        let found = full.review(&unknown, situation, &mut rng()).unwrap();
        assert!(found.trial == Trial::None && full.policies() == 3, "{found:?}");
        found.decision
    });
    assert!(matches!(named[0], Decision::Existing(0..3)) && named == [named[0]; 3], "{named:?}");
}

/// Rollouts need not be a multiple of the horizon: their last episodes are still running.
#[test]
fn running_tails_do_not_silence_motion_and_earnings() {
    let running = |mut accounts: Vec<Account>, from: usize| {
        accounts[from..].iter_mut().for_each(Account::forget_course);
        accounts
    };
    let mut recogniser = Recogniser::new(RecogniserSettings::default()).unwrap();
    let home = accounts(stream(WorldKind::Dynamics, 1000, &[(0, 8)], 5), 8, None);
    for rollout in home.chunks(20) {
        let rollout = running(rollout.to_vec(), 15);
        recogniser.learn(0, &rollout, &mut rng()).unwrap();
    }
    let review = |group, from| {
        let seen = running(rollout(WorldKind::Dynamics, 1000, group, 0), from);
        let situation = Situation { collector: 0, ..Situation::default() };
        let finding = recogniser.clone().review(&seen, situation, &mut rng()).unwrap();
        let sources = finding.opinions[0].test.as_ref().unwrap().sources.len();
        (sources, finding.opinions[0].verdict)
    };
    assert_eq!(review(0, 15), (5, Verdict::Accepted));
    assert_eq!(review(1, 15), (5, Verdict::Rejected));
    let looks_alone = (2, Verdict::Accepted);
    assert_eq!(review(1, 9), looks_alone, "fewer than half are whole");
}

#[test]
fn a_switch_is_found_before_a_running_tail() {
    let visits = [(0, 2), (1, 2)];
    let mut mixed = accounts(stream(WorldKind::Dynamics, 1000, &visits, 5), 4, Some(0));
    mixed[15..].iter_mut().for_each(Account::forget_course);
    let mut recogniser = Recogniser::new(RecogniserSettings::default()).unwrap();
    recogniser.learn(0, &mixed, &mut rng()).unwrap();
    let state = recogniser.state(serde_json::value::Serializer).unwrap();
    let remembered = state["policies"][0]["accounts"].as_array().unwrap().len();
    assert_eq!(remembered, 10);
}

#[test]
fn a_rejected_policy_is_not_proposed_again() {
    let recogniser = knowing(WorldKind::Target, 1000, 2);
    let seen = rollout(WorldKind::Target, 1000, 1, 0);
    let situation = Situation { collector: 0, rejected: &[1], ..Situation::default() };
    let finding = recogniser.clone().review(&seen, situation, &mut rng()).unwrap();
    assert_eq!(finding.decision, Decision::New);
    assert!(finding.rejected.contains(&0) && finding.rejected.contains(&1));
}

#[test]
fn a_rollout_that_straddles_a_switch_is_cut_at_the_episode() {
    let recogniser = knowing(WorldKind::Appearance, 1000, 2);
    for before in [1, 2, 3] {
        let visits = [(0, before), (1, 4 - before)];
        let mixed = accounts(stream(WorldKind::Appearance, 1000, &visits, 5), 4, Some(0));
        let finding = look(&recogniser, &mixed, 0);
        let began = before * HORIZON * 5;
        assert_eq!((finding.decision, finding.cut), (Decision::Existing(1), Some(began)));
    }
    let whole = accounts(stream(WorldKind::Appearance, 1000, &[(0, 4)], 5), 4, Some(0));
    let finding = look(&recogniser, &whole, 0);
    assert_eq!((finding.decision, finding.cut), (Decision::Existing(0), None));
}

/// A rollout that is reused creates a policy, which then trains on it.
#[test]
fn a_rollout_that_created_its_policy_is_remembered_once() {
    let mut recogniser = knowing(WorldKind::Appearance, 1000, 1);
    let mut seen = rollout(WorldKind::Appearance, 1000, 1, 0);
    let situation = Situation { can_wait: false, ..Situation::of(0) };
    let found = recogniser.assign(&seen, situation, &mut rng()).unwrap();
    assert_eq!(found.decision, Decision::New);
    seen.iter_mut().for_each(Account::forget_course);
    recogniser.learn(1, &seen, &mut rng()).unwrap();
    let state = recogniser.state(serde_json::value::Serializer).unwrap();
    let remembered = state["policies"][1]["accounts"].as_array().unwrap();
    assert_eq!(remembered.len(), seen.len());
}

#[test]
fn one_episode_names_its_policy_or_none_and_more_are_surer() {
    let recogniser = knowing(WorldKind::Appearance, 1000, 3);
    for group in 0..4 {
        let seen = rollout(WorldKind::Appearance, 1000, group, 0);
        for episodes in [1, 4, 20] {
            let found = recogniser.recognise(&seen[..episodes], &mut rng()).unwrap();
            let sum = found.policies.iter().sum::<f64>() + found.none;
            assert!((sum - 1.0).abs() < 1e-12);
            if episodes > 1 {
                let expected = (group < 3).then_some(group);
                assert_eq!(found.likeliest(), expected, "{episodes} of {group}: {found:?}");
            }
        }
    }
    assert!(recogniser.recognise(&[], &mut rng()).is_err());
}

#[test]
fn a_policy_that_remembers_too_little_is_not_named() {
    let mut recogniser = knowing(WorldKind::Appearance, 1000, 1);
    let few = rollout(WorldKind::Appearance, 1000, 1, 1);
    recogniser.learn(1, &few[..3], &mut rng()).unwrap();
    let seen = rollout(WorldKind::Appearance, 1000, 0, 0);
    let found = recogniser.recognise(&seen, &mut rng()).unwrap();
    assert_eq!((found.likeliest(), found.policies[1]), (Some(0), 0.0));
}

/// The first frames of some tasks never vary: nothing is divided by zero, and others differ.
#[test]
fn frames_that_are_all_equal_say_nothing_of_each_other() {
    let mut recogniser = Recogniser::new(RecogniserSettings::default()).unwrap();
    let still = |value: f32| {
        let mut accounts = episodes(20, 0.0, 0.0, &mut rng());
        accounts.iter_mut().for_each(|account| account.picture.fill(value));
        accounts.iter_mut().for_each(Account::forget_course);
        accounts
    };
    recogniser.learn(0, &still(1.0), &mut rng()).unwrap();
    let same = look(&recogniser, &still(1.0), 0);
    assert_eq!(same.decision, Decision::Existing(0));
    let test = same.opinions[0].test.as_ref().unwrap();
    assert!(test.sources.iter().all(Option::is_none) && test.overall.score.is_finite());
    assert_eq!(settle(&recogniser, &still(2.0), 0).decision, Decision::New);
}

#[test]
fn an_album_changes_no_account() {
    let spec = [Irrep::X, Irrep::Y];
    let accountant = Accountant::new([48, 48, 6], &spec, &spec, 32).unwrap();
    let courses = courses(stream(WorldKind::Drift, 1000, &[(0, 2)], 5), 2, None);
    let mut album = Album::default();
    let first = accountant.accounts(&courses, &mut album).unwrap();
    assert_eq!(accountant.accounts(&courses, &mut album).unwrap(), first);
    let mut other = courses[0].clone();
    other.image[0] ^= 255;
    let changed = accountant.accounts(&[other], &mut album).unwrap();
    assert_ne!(changed[0].picture, first[0].picture);
}

/// Colours stray while a policy is away: it is tried before a new one is created, and what it
/// remembers is renewed.
#[test]
fn a_policy_whose_group_drifted_meanwhile_is_tried() {
    let kind = WorldKind::Drift;
    let mut tried = 0;
    for seed in 1000..1006 {
        let mut recogniser = Recogniser::new(RecogniserSettings::default()).unwrap();
        for group in 0..2 {
            let mut home = accounts(stream(kind, seed, &[(group, 12)], 5), 12, None);
            let beginning = home[..20].iter_mut();
            beginning.for_each(|a| a.earned = Some(0.0));
            for rollout in home.chunks(20) {
                recogniser.learn(group, rollout, &mut rng()).unwrap();
            }
        }
        let visits = [(1, 8), (0, 242), (1, 8)];
        let late = accounts_of(&courses(stream(kind, seed, &visits, 5), 258, None)[1250..]);
        let finding = settle(&recogniser, &late, 0);
        if finding.opinions[1].verdict == Verdict::Accepted {
            continue;
        }
        assert_ne!(finding.decision, Decision::Existing(0), "seed {seed}");
        if finding.decision == Decision::New {
            continue;
        }
        tried += 1;
        assert!(finding.trial == Trial::Episodes && !finding.rejected.contains(&1));
        let situation = Situation {
            collector: 1,
            rejected: &finding.rejected,
            is_provisional: finding.is_provisional,
            can_wait: false,
        };
        let own = recogniser.clone().review(&late[..20], situation, &mut rng()).unwrap();
        assert_eq!(own.decision, Decision::Existing(1), "seed {seed}: {:#?}", said(&own));
        recogniser.learn(1, &late[..20], &mut rng()).unwrap();
        let next = settle(&recogniser, &late[20..], 1);
        assert_eq!(next.decision, Decision::Existing(1), "seed {seed}");
    }
    assert!(tried > 0);
}

/// What looks said of a policy before it acted stands: episodes of its own in which it earns a
/// fifth less than at home are no proof, though they do not speak against it, either.
#[test]
fn a_provisional_policy_must_earn_what_it_earned() {
    let kind = WorldKind::Target;
    let recogniser = knowing(kind, 1000, 2);
    let decision = |share: f32, is_provisional| {
        let mut seen = rollout(kind, 1000, 0, 0);
        let earned = seen.iter_mut().filter_map(|a| a.earned.as_mut());
        earned.for_each(|earned| *earned *= share);
        let situation = Situation { rejected: &[1], is_provisional, ..Situation::default() };
        let finding = recogniser.clone().review(&seen, situation, &mut rng()).unwrap();
        assert!(!finding.is_provisional || is_provisional);
        finding.decision
    };
    assert_eq!(decision(1.0, true), Decision::Existing(0));
    assert_eq!(decision(0.8, false), Decision::Existing(0));
    assert_eq!(decision(0.8, true), Decision::New);
}

/// Colours stray over hundreds of rounds; what is remembered is the latest.
#[test]
fn slow_drift_splits_nothing() {
    for seed in 1000..1002 {
        let all = accounts(stream(WorldKind::Drift, seed, &[(0, 100)], 5), 100, None);
        let mut recogniser = Recogniser::new(RecogniserSettings::default()).unwrap();
        for rollout in all.chunks(20) {
            if recogniser.policies() > 0 {
                let finding = settle(&recogniser, rollout, 0);
                assert_eq!(finding.decision, Decision::Existing(0), "seed {seed}");
            }
            recogniser.learn(0, rollout, &mut rng()).unwrap();
        }
    }
}

#[test]
fn a_new_policy_remembers_only_the_group_it_was_opened_for() {
    let mut recogniser = knowing(WorldKind::Appearance, 1000, 1);
    let mixed = accounts(stream(WorldKind::Appearance, 1000, &[(1, 2), (2, 2)], 5), 4, Some(1));
    recogniser.learn(1, &mixed, &mut rng()).unwrap();
    let one = recogniser.recognise(&rollout(WorldKind::Appearance, 1000, 1, 0), &mut rng());
    assert_eq!(one.unwrap().likeliest(), Some(1));
    let other = recogniser.recognise(&rollout(WorldKind::Appearance, 1000, 2, 0), &mut rng());
    assert_eq!(other.unwrap().likeliest(), None);
}
