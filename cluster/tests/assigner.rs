//! The assigner on synthetic episodes: 64 dimensions, frames of one episode alike.

// lints know tests, but not the helpers that tests call
#![allow(clippy::expect_used)]

mod common;

use cluster::{
    Assigner, AssignerSettings, Assignment, Calibrated, Candidate, ClusterError, Decision, Frames,
    Judgement, Rule,
};
use common::{normal, normals};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

const DIM: usize = 64;
/// Frames an episode.
const K: usize = 2;
/// Standard deviation of frames around their episode's own centre, which has standard deviation 1.
const WITHIN: f32 = 0.2;

fn features(rng: &mut ChaCha8Rng, episodes: usize, shift: f32) -> Vec<f32> {
    let mut all = Vec::new();
    for _ in 0..episodes {
        let centre = normals(rng, DIM);
        for _ in 0..K {
            all.extend(centre.iter().map(|c| shift + c + WITHIN * normal(rng)));
        }
    }
    all
}

fn frames(rng: &mut ChaCha8Rng, episodes: usize, shift: f32) -> Frames {
    Frames::new(features(rng, episodes, shift), K, DIM).expect("whole finite episodes")
}

fn candidate(rng: &mut ChaCha8Rng, episodes: usize, shift: f32) -> Candidate {
    Candidate {
        buffer: frames(rng, episodes, shift),
        rollout: frames(rng, 20, 0.0),
    }
}

fn scaled(candidate: &Candidate, factor: f32) -> Candidate {
    let scale = |frames: &Frames| {
        let features = frames.features().iter().map(|f| f * factor).collect();
        Frames::new(features, frames.frames_per_episode(), frames.dim())
            .expect("finite after scaling")
    };
    Candidate {
        buffer: scale(&candidate.buffer),
        rollout: scale(&candidate.rollout),
    }
}

fn calibrated(settings: Calibrated) -> Result<Assigner, ClusterError> {
    Assigner::new(AssignerSettings {
        rule: Rule::Calibrated(settings),
    })
}

fn fixed(threshold: f64) -> Result<Assigner, ClusterError> {
    Assigner::new(AssignerSettings {
        rule: Rule::Fixed { threshold },
    })
}

fn decide(candidates: &[Candidate], seed: u64) -> Assignment {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    Assigner::default()
        .assign(candidates, &mut rng)
        .expect("comparable candidates")
}

#[test]
fn one_distribution_is_accepted() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut scores = Vec::new();
    for seed in 0..100 {
        let assignment = decide(&[candidate(&mut rng, 30, 0.0)], seed);
        assert!(assignment.evidence[0].accepted == (assignment.decision == Decision::Existing(0)));
        scores.push((
            assignment.evidence[0].accepted,
            assignment.evidence[0].score().unwrap(),
        ));
    }
    let accepted = scores.iter().filter(|(accepted, _)| *accepted).count();
    assert!(accepted >= 95, "{accepted} of 100");
    // a calibrated score is about standard normal: the mean of 100 lies within 0.4 of zero
    let mean = scores.iter().map(|(_, score)| score).sum::<f64>() / 100.0;
    assert!(mean.abs() < 0.4, "{mean}");
}

#[test]
fn a_shifted_distribution_is_refused() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    for seed in 0..20 {
        let assignment = decide(&[candidate(&mut rng, 30, 1.0)], seed);
        assert_eq!(
            assignment.decision,
            Decision::New,
            "{:?}",
            assignment.evidence
        );
    }
}

#[test]
fn the_right_one_of_several_policies_is_recalled() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    for (seed, right) in [0, 1, 2, 3, 0].into_iter().enumerate() {
        let shift = |index: usize| {
            if index == right {
                0.0
            } else {
                1.0 + index as f32
            }
        };
        let candidates: Vec<_> = (0..4).map(|i| candidate(&mut rng, 40, shift(i))).collect();
        let assignment = decide(&candidates, seed as u64);
        assert_eq!(
            assignment.decision,
            Decision::Existing(right),
            "{:?}",
            assignment.evidence
        );
        assert_eq!(assignment.evidence.len(), 4);
    }
}

#[test]
fn the_lowest_score_wins_over_the_lowest_distance() {
    let mut rng = ChaCha8Rng::seed_from_u64(10);
    let lenient = Calibrated {
        max_score: 1e9,
        certain_score: 1e9,
        ..Calibrated::default()
    };
    let other_group_small_features = scaled(&candidate(&mut rng, 20, 1.0), 1e-3);
    let candidates = [other_group_small_features, candidate(&mut rng, 20, 0.0)];
    let assigner = calibrated(lenient).unwrap();
    let assignment = assigner.assign(&candidates, &mut rng).unwrap();
    assert!(assignment.evidence.iter().all(|e| e.accepted));
    assert!(assignment.evidence[0].distance < assignment.evidence[1].distance);
    assert_eq!(assignment.decision, Decision::Existing(1));
}

#[test]
fn scale_does_not_matter_to_the_calibrated_rule() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    for (seed, shift) in [0.0, 0.3, 0.6, 1.0].into_iter().enumerate() {
        let original = candidate(&mut rng, 25, shift);
        let of = |factor| decide(&[scaled(&original, factor)], seed as u64);
        let (base, exact) = (of(1.0), of(1024.0));
        assert_eq!(base.evidence[0].score(), exact.evidence[0].score());
        for factor in [1000.0, 1e-3, 1e30, 1e-30] {
            let other = of(factor);
            assert_eq!(base.decision, other.decision);
            let moved = base.evidence[0].score().unwrap() - other.evidence[0].score().unwrap();
            assert!(moved.abs() < 1e-3, "{factor}: {moved}");
        }
    }
}

#[test]
fn frames_of_one_episode_stay_together() {
    // the same frames, declared as episodes of one frame each: near-copies land on both sides of
    // every split, and episodes of one distribution look like two
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let right = candidate(&mut rng, 20, 0.0);
    let torn = |frames: &Frames| Frames::new(frames.features().to_vec(), 1, DIM).unwrap();
    let wrong = Candidate {
        buffer: torn(&right.buffer),
        rollout: torn(&right.rollout),
    };
    let all = Calibrated {
        rollout_episodes: 40,
        buffer_episodes: 40,
        ..Calibrated::default()
    };
    let assigner = calibrated(all).unwrap();
    let accepted =
        |c: Candidate, rng: &mut _| assigner.assign(&[c], rng).unwrap().evidence[0].accepted;
    assert!(accepted(right, &mut rng));
    assert!(!accepted(wrong, &mut rng));
}

#[test]
fn equal_generators_give_equal_assignments() {
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    let candidates = [candidate(&mut rng, 60, 0.0), candidate(&mut rng, 60, 0.5)];
    assert_eq!(decide(&candidates, 9), decide(&candidates, 9));
    assert_ne!(
        decide(&candidates, 9).evidence,
        decide(&candidates, 10).evidence
    );
}

#[test]
fn without_candidates_the_decision_is_new() {
    let assignment = decide(&[], 1);
    assert_eq!(
        (assignment.decision, assignment.evidence.len()),
        (Decision::New, 0)
    );
}

#[test]
fn the_papers_rule_compares_with_its_threshold() {
    // two points 3 apart: the distance is exactly 3, and the paper refuses only what exceeds the
    // threshold
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let points = |x: f32| Frames::new(vec![x], 1, 1).unwrap();
    let away = |x: f32| Candidate {
        buffer: points(x),
        rollout: points(0.0),
    };
    let mut at = |threshold, candidates: &[Candidate]| {
        fixed(threshold)
            .unwrap()
            .assign(candidates, &mut rng)
            .unwrap()
    };
    assert_eq!(at(3.0, &[away(3.0)]).decision, Decision::Existing(0));
    assert_eq!(at(2.999, &[away(3.0)]).decision, Decision::New);
    assert_eq!(
        at(3.0, &[away(2.0), away(-1.0), away(1.0)]).decision,
        Decision::Existing(1)
    );
    let evidence = at(1.0, &[away(2.0)]).evidence[0];
    assert_eq!(
        (evidence.distance, evidence.judgement, evidence.score()),
        (2.0, Judgement::Threshold, None)
    );
    assert_eq!(Rule::PAPER, Rule::Fixed { threshold: 1.0 });
}

#[test]
fn identical_frames_are_accepted_without_nan() {
    let same = Frames::new(vec![7.0; 20 * K * DIM], K, DIM).unwrap();
    let assignment = decide(
        &[Candidate {
            buffer: same.clone(),
            rollout: same,
        }],
        1,
    );
    let evidence = assignment.evidence[0];
    assert_eq!((evidence.score(), evidence.ratio()), (Some(0.0), Some(0.0)));
    assert_eq!(assignment.decision, Decision::Existing(0));
}

#[test]
fn two_constant_clouds_are_told_apart() {
    let constant = |x: f32| Frames::new(vec![x; 20 * K * DIM], K, DIM).unwrap();
    let assignment = decide(
        &[Candidate {
            buffer: constant(1.0),
            rollout: constant(2.0),
        }],
        1,
    );
    let evidence = assignment.evidence[0];
    assert_eq!(
        (assignment.decision, evidence.distance),
        (Decision::New, 8.0)
    );
    assert!(evidence.score().unwrap().is_finite() && evidence.ratio().unwrap().is_finite());
}

#[test]
fn a_small_buffer_is_taken_only_if_no_tested_one_fits() {
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    let (small, fits) = (candidate(&mut rng, 1, 0.0), candidate(&mut rng, 20, 0.0));
    let (nearer, refused) = (candidate(&mut rng, 7, 0.0), candidate(&mut rng, 20, 2.0));
    let assignment = decide(&[small.clone(), fits], 1);
    assert_eq!(assignment.decision, Decision::Existing(1));
    assert_eq!(
        assignment.evidence[0].judgement,
        Judgement::BufferTooSmall {
            episodes: 1,
            needed: 8
        }
    );
    assert_eq!(
        decide(&[small, refused, nearer], 1).decision,
        Decision::Existing(2)
    );
}

#[test]
fn rollouts_and_candidates_that_cannot_be_compared_are_refused() {
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    let short = Candidate {
        buffer: frames(&mut rng, 20, 0.0),
        rollout: frames(&mut rng, 7, 0.0),
    };
    let error = Assigner::default().assign(&[short], &mut rng).unwrap_err();
    assert_eq!(
        error,
        ClusterError::RolloutTooSmall {
            episodes: 7,
            needed: 8
        }
    );

    let narrow = Frames::new(vec![0.0; 40], 2, 2).unwrap();
    let good = candidate(&mut rng, 8, 0.0);
    let odd = Candidate {
        buffer: narrow,
        rollout: good.rollout.clone(),
    };
    let error = Assigner::default()
        .assign(&[good, odd], &mut rng)
        .unwrap_err();
    let expected = "candidate 1: dim is 2 in the buffer and 64 in the rollout, expected the same";
    assert_eq!(error.to_string(), expected);
}
