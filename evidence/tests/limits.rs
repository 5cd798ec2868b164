//! How large a difference must be before it speaks against a policy.

use cluster::{Decision, Verdict};
use evidence::{Account, Finding, Recogniser, RecogniserSettings, Situation};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::common::{rng, settle};

const DIM: usize = 12;

/// Numbers around this one, which scatter widely: most of the distance of two clouds is chance.
fn around(centre: f32, rng: &mut ChaCha8Rng) -> Vec<f32> {
    (0..DIM).map(|_| centre + rng.random_range(-0.5..0.5)).collect()
}

/// Episodes of which the picture scatters around one number and motion around another.
fn episodes(count: usize, picture: f32, motion: f32, rng: &mut ChaCha8Rng) -> Vec<Account> {
    let episode = |began| Account {
        began,
        picture: around(picture, rng),
        vector: vec![0.0],
        motion: Some(around(motion, rng)),
        slope: Some(vec![1.0]),
        earned: Some(1.0),
    };
    (0..count).map(episode).collect()
}

/// Motion changes while a policy learns: what is certain and small beside chance is no other group.
#[test]
fn motion_that_changed_by_less_than_twice_what_chance_makes_is_drift() {
    let mut rng = rng();
    let mut recogniser = Recogniser::new(RecogniserSettings::default()).unwrap();
    let home = episodes(40, 0.0, 1.0, &mut rng);
    recogniser.learn(0, &home, &mut rng).unwrap();
    let mut opinion = |motion| {
        let seen = episodes(20, 0.0, motion, &mut rng);
        let finding = settle(&recogniser, &seen, 0);
        finding.opinions[0].clone()
    };
    let small = opinion(1.3);
    assert!(small.changed() > 0.25 && small.tail_p_value() < 1e-6, "{small}");
    assert_eq!(small.verdict(), Verdict::Accepted, "{small}");
    let large = opinion(2.2);
    assert_eq!(large.verdict(), Verdict::Rejected, "{large}");
}

/// Policies know pictures around these numbers; the second one acts in episodes around `seen`.
fn stranger(known: &[f32], seen: f32) -> (Recogniser, Finding) {
    let mut rng = rng();
    let mut recogniser = Recogniser::new(RecogniserSettings::default()).unwrap();
    for (policy, &picture) in known.iter().enumerate() {
        let home = episodes(40, picture, 1.0, &mut rng);
        recogniser.learn(policy, &home, &mut rng).unwrap();
    }
    let seen = episodes(20, seen, 1.0, &mut rng);
    let finding = settle(&recogniser, &seen, 1);
    (recogniser, finding)
}

fn ratios(finding: &Finding) -> Vec<f64> {
    finding.opinions.iter().map(|o| o.look_ratio()).collect()
}

#[test]
fn a_policy_that_strayed_is_asked_where_it_is_by_far_the_nearest() {
    for known in [&[0.0, 3.0][..], &[0.0, 3.0, -3.0]] {
        let (recogniser, finding) = stranger(known, 0.45);
        assert_eq!(finding.opinions[0].verdict(), Verdict::Rejected);
        assert!(ratios(&finding)[0] > 1.5, "{:?}", ratios(&finding));
        let named = finding.decision;
        assert_eq!(named, Decision::Existing(0), "{:?}", ratios(&finding));
        assert!(finding.is_unproven);
        // above what is excused of one that was away and looked alike, and above what is excused
        for (seen, excused, expected) in
            [(0.45, 1.5..1.8, Verdict::Accepted), (0.8, 1.8..9.0, Verdict::Rejected)]
        {
            let situation = Situation { rejected: &[1], is_unproven: true, ..Situation::default() };
            let mut rng = ChaCha8Rng::seed_from_u64(77);
            let seen = episodes(20, seen, 1.0, &mut rng);
            let reviewed = recogniser.clone().review(&seen, situation, &mut rng).unwrap();
            assert!(excused.contains(&ratios(&reviewed)[0]), "{:?}", ratios(&reviewed));
            assert_eq!(reviewed.opinions[0].verdict(), expected);
        }
    }
}

#[test]
fn nobody_is_asked_who_strayed_too_far_or_as_far_as_another_one() {
    let far_or_between = [
        (&[0.0, 3.0, -3.0][..], 0.8),
        (&[0.0, -1.0, 1.0], 0.5),
        // the other one acts itself
        (&[0.0, 1.0], 0.5),
    ];
    for (known, seen) in far_or_between {
        let (_, finding) = stranger(known, seen);
        assert_eq!(finding.decision, Decision::New, "{:?}", ratios(&finding));
    }
}
