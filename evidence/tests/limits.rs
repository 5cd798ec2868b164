//! How large a difference must be before it speaks against a policy.

use cluster::{Decision, Verdict};
use evidence::{Account, Finding, Look, Recogniser, RecogniserSettings, Situation};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::common::rng;

const DIM: usize = 12;

/// Numbers around this one, which scatter widely: most of the distance of two clouds is chance.
fn around(centre: f32, rng: &mut ChaCha8Rng) -> Vec<f32> {
    (0..DIM)
        .map(|_| centre + rng.random_range(-0.5..0.5))
        .collect()
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

fn second_look(recogniser: &Recogniser, seen: &[Account], collector: usize) -> Finding {
    let look = Look::Second;
    recogniser
        .assign(seen, collector, look, &mut rng())
        .unwrap()
}

/// Motion changes while a policy learns: what is certain and small beside chance is no other group.
#[test]
fn motion_that_changed_by_less_than_chance_makes_of_it_is_drift() {
    let mut rng = rng();
    let mut recogniser = Recogniser::new(RecogniserSettings::default()).unwrap();
    let home = episodes(40, 0.0, 1.0, &mut rng);
    recogniser.learn(0, &home, &mut rng).unwrap();
    let mut opinion = |motion| {
        let seen = episodes(20, 0.0, motion, &mut rng);
        let finding = second_look(&recogniser, &seen, 0);
        finding.opinions[0].clone()
    };
    let small = opinion(1.3);
    assert!(
        small.changed() > 0.25 && small.tail_p_value() < 1e-6,
        "{small}"
    );
    assert_eq!(small.verdict(), Verdict::Accepted, "{small}");
    let large = opinion(2.2);
    assert_eq!(large.verdict(), Verdict::Refused, "{large}");
}

/// Two policies know pictures around zero and around `other`; the second one acts in episodes that
/// look like neither.
fn stranger(other: f32, shift: f32) -> (Recogniser, Finding) {
    let mut rng = rng();
    let mut recogniser = Recogniser::new(RecogniserSettings::default()).unwrap();
    for (policy, picture) in [(0, 0.0), (1, other)] {
        let home = episodes(40, picture, 1.0, &mut rng);
        recogniser.learn(policy, &home, &mut rng).unwrap();
    }
    let third = episodes(40, -other, 1.0, &mut rng);
    recogniser.learn(2, &third, &mut rng).unwrap();
    let seen = episodes(20, shift, 1.0, &mut rng);
    let finding = second_look(&recogniser, &seen, 1);
    (recogniser, finding)
}

#[test]
fn a_policy_that_strayed_is_asked_where_it_is_by_far_the_nearest() {
    let (recogniser, finding) = stranger(3.0, 0.5);
    let ratio = finding.opinions[0].look_ratio();
    assert!(
        finding.opinions[0].verdict() == Verdict::Refused && ratio > 1.5,
        "{ratio}"
    );
    assert_eq!(finding.decision, Decision::Existing(0));
    assert!(finding.is_unproven);
    let review = |shift| {
        let situation = Situation {
            collector: 0,
            refused: &[1],
            is_unproven: true,
        };
        let seen = episodes(20, shift, 1.0, &mut rng());
        let finding = recogniser.review(&seen, situation, &mut rng()).unwrap();
        finding.opinions[0].verdict()
    };
    assert_eq!(review(0.5), Verdict::Accepted);
    assert_eq!(review(0.8), Verdict::Refused);
}

#[test]
fn nobody_is_asked_who_strayed_too_far_or_as_far_as_another_one() {
    let (_, too_far) = stranger(3.0, 0.8);
    assert_eq!(too_far.decision, Decision::New);
    let (_, between) = stranger(-1.0, 0.5);
    let ratios: Vec<f64> = between.opinions.iter().map(|o| o.look_ratio()).collect();
    assert!(ratios[0] < 1.8 && ratios[2] < 2.5, "{ratios:?}");
    assert_eq!(between.decision, Decision::New);
}
