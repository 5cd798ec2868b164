//! The assigner on synthetic episodes: 64 dimensions, frames of one episode alike.

use cluster::{
    Assigner, Assignment, Calibrated, Candidate, ClusterError, Decision, Frames, Judgement, Rule,
    Verdict,
};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::common::{calibrated, fixed, normal, normals};

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
    sized(rng, [episodes, 20], shift)
}

/// Episodes of the buffer, which is shifted, and of the rollout.
fn sized(rng: &mut ChaCha8Rng, [buffer, rollout]: [usize; 2], shift: f32) -> Candidate {
    Candidate { buffer: frames(rng, buffer, shift), rollout: frames(rng, rollout, 0.0) }
}

fn scaled(candidate: &Candidate, factor: f32) -> Candidate {
    let scale = |frames: &Frames| {
        let features = frames.features().iter().map(|f| f * factor).collect();
        Frames::new(features, frames.frames_per_episode(), frames.dim())
            .expect("finite after scaling")
    };
    Candidate { buffer: scale(&candidate.buffer), rollout: scale(&candidate.rollout) }
}

fn settle(candidates: &[Candidate], seed: u64) -> Assignment {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    Assigner::default().settle(candidates, &mut rng).expect("comparable candidates")
}

fn decide(candidates: &[Candidate], seed: u64) -> Assignment {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    Assigner::default().assign(candidates, &mut rng).expect("comparable candidates")
}

/// The exact p-value of exchangeable episodes is uniform on its 101 steps, whatever the features.
#[test]
fn the_level_is_exact_for_one_distribution() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let decisions = 600;
    let mut tests = Vec::new();
    for seed in 0..decisions {
        let candidate = sized(&mut rng, [12, 8], 0.0);
        let assignment = decide(&[candidate], seed);
        let doubted = assignment.evidence[0].verdict == Verdict::Doubted;
        assert_eq!(doubted, assignment.decision == Decision::Undecided);
        let test = *assignment.evidence[0].test().unwrap();
        assert_eq!(doubted, test.p_value <= 0.02);
        tests.push(test);
    }
    for level in [0.02_f64, 0.1, 0.3, 0.5, 0.8] {
        let nominal = (level * 101.0).floor() / 101.0;
        let expected = nominal * decisions as f64;
        let count = tests.iter().filter(|t| t.p_value <= level).count() as f64;
        // within four standard deviations of the binomial
        let deviation = 4.0 * (expected * (1.0 - nominal)).sqrt();
        assert!((count - expected).abs() < deviation, "{count} at {level}, expected {expected}");
    }
    let tail = tests.iter().filter(|t| t.tail_p_value <= 0.02).count();
    assert!((2..=24).contains(&tail), "{tail} of 12 expected");
}

#[test]
fn a_shifted_distribution_is_doubted_and_then_refused() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    for seed in 0..4 {
        let one = candidate(&mut rng, 20, 1.0);
        let first = decide(std::slice::from_ref(&one), seed);
        assert_eq!(first.decision, Decision::Undecided, "{:?}", first.evidence);
        let both =
            Candidate { rollout: one.rollout.joined(&frames(&mut rng, 20, 0.0)).unwrap(), ..one };
        let second = settle(&[both], seed);
        assert_eq!(second.decision, Decision::New, "{:?}", second.evidence);
        assert_eq!(second.evidence[0].verdict, Verdict::Rejected);
    }
}

/// Rollouts of a known group that look odd once: the second one clears them up.
#[test]
fn doubts_about_a_known_group_are_settled_in_its_favour() {
    let mut rng = ChaCha8Rng::seed_from_u64(11);
    let mut doubted = 0;
    for seed in 0..200 {
        let one = sized(&mut rng, [10, 10], 0.0);
        if decide(std::slice::from_ref(&one), seed).decision == Decision::Undecided {
            doubted += 1;
            let both = Candidate {
                rollout: one.rollout.joined(&frames(&mut rng, 10, 0.0)).unwrap(),
                ..one
            };
            assert_eq!(settle(&[both], seed).decision, Decision::Existing(0));
        }
    }
    assert!((1..=12).contains(&doubted), "{doubted} of 4 expected");
}

/// What is significant and yet no more than drift opens no policy.
#[test]
fn a_small_effect_is_no_new_group() {
    let mut rng = ChaCha8Rng::seed_from_u64(12);
    let one = sized(&mut rng, [40, 40], 0.4);
    let tolerant = settle(std::slice::from_ref(&one), 1);
    let test = tolerant.evidence[0].test().unwrap();
    assert!(test.tail_p_value <= 1e-4 && test.ratio() < 1.1, "{test:?}");
    assert_eq!(tolerant.decision, Decision::Existing(0));
    let strict = Calibrated { min_ratio: 1.0, ..Calibrated::default() };
    let strict = calibrated(strict).unwrap().settle(&[one], &mut rng).unwrap();
    assert_eq!(strict.decision, Decision::New);
}

#[test]
fn the_right_one_of_several_policies_is_recalled() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    for (seed, right) in [0, 1, 2, 3, 0].into_iter().enumerate() {
        let shift = |index: usize| {
            if index == right { 0.0 } else { 1.0 + index as f32 }
        };
        let candidates: Vec<_> = (0..4).map(|i| candidate(&mut rng, 40, shift(i))).collect();
        let assignment = decide(&candidates, seed as u64);
        assert_eq!(assignment.decision, Decision::Existing(right), "{:?}", assignment.evidence);
        assert_eq!(assignment.evidence.len(), 4);
    }
}

#[test]
fn the_lowest_score_counts_and_not_the_lowest_distance() {
    let mut rng = ChaCha8Rng::seed_from_u64(10);
    let other_group_small_features = scaled(&candidate(&mut rng, 20, 1.0), 1e-3);
    let candidates = [other_group_small_features, candidate(&mut rng, 20, 0.0)];
    let assignment = decide(&candidates, 1);
    assert!(assignment.evidence[0].distance < assignment.evidence[1].distance);
    assert!(assignment.evidence[0].score() > assignment.evidence[1].score());
    assert_eq!(assignment.nearest(), Some(1));
}

#[test]
fn scale_does_not_matter_to_the_calibrated_rule() {
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    for (seed, shift) in [0.0, 0.6].into_iter().enumerate() {
        let original = candidate(&mut rng, 20, shift);
        let of = |factor| decide(&[scaled(&original, factor)], seed as u64);
        let base = of(1.0);
        for factor in [2.0, 1024.0, 0.125] {
            let (one, other) = (base.evidence[0].test().unwrap(), of(factor));
            let other = other.evidence[0].test().unwrap();
            let scaled = |x: f64| (x * f64::from(factor)).to_bits();
            assert_eq!(scaled(one.distance), other.distance.to_bits());
            assert_eq!(scaled(one.null.max), other.null.max.to_bits());
            let bits = [one, other]
                .map(|t| [t.score, t.p_value, t.tail_p_value, t.ratio()].map(f64::to_bits));
            assert_eq!(bits[0], bits[1]);
        }
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
    let wrong = Candidate { buffer: torn(&right.buffer), rollout: torn(&right.rollout) };
    let all = Calibrated { rollout_episodes: 40, buffer_episodes: 40, ..Calibrated::default() };
    let assigner = calibrated(all).unwrap();
    let score = |c, draws: &mut _| assigner.assign(&[c], draws).unwrap().evidence[0].score();
    assert!(score(right, &mut rng).unwrap() < 2.5);
    assert!(score(wrong, &mut rng).unwrap() > 4.0);
}

#[test]
fn equal_generators_give_equal_assignments() {
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    let candidates = [candidate(&mut rng, 60, 0.0), candidate(&mut rng, 60, 0.5)];
    assert_eq!(decide(&candidates, 9), decide(&candidates, 9));
    assert_ne!(decide(&candidates, 9).evidence, decide(&candidates, 10).evidence);
}

#[test]
fn without_candidates_the_decision_is_new() {
    let assignment = decide(&[], 1);
    assert_eq!((assignment.decision, assignment.evidence.len()), (Decision::New, 0));
}

#[test]
fn the_papers_rule_compares_with_its_threshold() {
    // two points 3 apart: the distance is exactly 3, and the paper refuses only what exceeds the
    // threshold
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let points = |x: f32| Frames::new(vec![x], 1, 1).unwrap();
    let away = |x: f32| Candidate { buffer: points(x), rollout: points(0.0) };
    let mut at = |threshold, candidates: &[Candidate]| {
        fixed(threshold).unwrap().assign(candidates, &mut rng).unwrap()
    };
    assert_eq!(at(3.0, &[away(3.0)]).decision, Decision::Existing(0));
    assert_eq!(at(2.999, &[away(3.0)]).decision, Decision::New);
    assert_eq!(at(3.0, &[away(2.0), away(-1.0), away(1.0)]).decision, Decision::Existing(1));
    let evidence = at(1.0, &[away(2.0)]).evidence[0];
    assert_eq!(
        (evidence.distance, evidence.judgement, evidence.score()),
        (2.0, Judgement::Threshold { limit: 1.0 }, None)
    );
    let settled = fixed(1.0).unwrap().settle(&[away(2.0)], &mut rng).unwrap();
    assert_eq!(settled.decision, Decision::New);
    assert_eq!(Rule::PAPER, Rule::Fixed { threshold: 1.0 });
}

#[test]
fn identical_frames_are_accepted_without_nan() {
    let same = Frames::new(vec![7.0; 20 * K * DIM], K, DIM).unwrap();
    let assignment = decide(&[Candidate { buffer: same.clone(), rollout: same }], 1);
    let evidence = assignment.evidence[0];
    let test = evidence.test().unwrap();
    assert_eq!((test.score, test.ratio(), test.p_value), (0.0, 0.0, 1.0));
    assert_eq!(assignment.decision, Decision::Existing(0));
}

#[test]
fn two_constant_clouds_are_told_apart() {
    let constant = |x: f32| Frames::new(vec![x; 20 * K * DIM], K, DIM).unwrap();
    let candidates = [Candidate { buffer: constant(1.0), rollout: constant(2.0) }];
    assert_eq!(decide(&candidates, 1).decision, Decision::Undecided);
    let settled = settle(&candidates, 1);
    assert_eq!(settled.decision, Decision::New);
    let test = settled.evidence[0].test().unwrap();
    assert_eq!(test.distance, 8.0);
    assert!(test.score.is_finite() && test.ratio().is_finite());
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
        Judgement::BufferTooSmall { episodes: 1, needed: 8 }
    );
    assert_eq!(decide(&[small, refused, nearer], 1).decision, Decision::Existing(2));
}

#[test]
fn rollouts_and_candidates_that_cannot_be_compared_are_refused() {
    let mut rng = ChaCha8Rng::seed_from_u64(9);
    let short = sized(&mut rng, [20, 7], 0.0);
    let error = Assigner::default().assign(&[short], &mut rng).unwrap_err();
    assert_eq!(error, ClusterError::RolloutTooSmall { episodes: 7, needed: 8 });

    let narrow = Frames::new(vec![0.0; 40], 2, 2).unwrap();
    let good = candidate(&mut rng, 8, 0.0);
    let odd = Candidate { buffer: narrow, rollout: good.rollout.clone() };
    let dims_error = Assigner::default().assign(&[good, odd], &mut rng).unwrap_err();
    let expected = "candidate 1: dim is 2 in the buffer and 64 in the rollout, expected the same";
    assert_eq!(dims_error.to_string(), expected);

    let few_frames = frames(&mut rng, 8, 0.0);
    let many_frames = Frames::new(vec![0.0; 8 * 3 * DIM], 3, DIM).unwrap();
    let joined_error = few_frames.joined(&many_frames).unwrap_err().to_string();
    let expected_frames =
        "frames_per_episode is 2 in one rollout and 3 in the other, expected the same";
    assert_eq!(joined_error, expected_frames);
}

/// When each of 20 episodes began: ten environments show one after the other, environment by
/// environment.
fn two_rounds() -> Vec<usize> {
    (0..20).map(|episode| 500 * (episode % 2)).collect()
}

/// Episodes of two groups in turns, as two rounds of ten environments show them.
fn straddling(rng: &mut ChaCha8Rng, shift: f32) -> Candidate {
    let groups = [0.0, shift].map(|shift| frames(rng, 10, shift));
    let both = groups[0].joined(&groups[1]).unwrap();
    let turns: Vec<usize> = (0..20).map(|episode| episode / 2 + 10 * (episode % 2)).collect();
    Candidate { buffer: frames(rng, 20, 0.0), rollout: both.select(&turns).unwrap() }
}

fn cut(candidates: &[Candidate], began: &[usize], seed: u64) -> Option<usize> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    Assigner::default().cut(candidates, began, &mut rng).expect("comparable candidates")
}

#[test]
fn rollouts_of_two_groups_are_cut_where_the_second_begins() {
    let mut rng = ChaCha8Rng::seed_from_u64(12);
    for seed in 0..4 {
        let both = [straddling(&mut rng, 1.0), straddling(&mut rng, 0.0)];
        assert_eq!(cut(&both, &two_rounds(), seed), Some(500));
        // what began together cannot be told apart
        assert_eq!(cut(&both, &[500; 20], seed), None);
    }
}

#[test]
fn one_group_is_cut_as_seldom_as_it_is_doubted() {
    let mut rng = ChaCha8Rng::seed_from_u64(13);
    let one = |draws: &mut ChaCha8Rng| [straddling(draws, 0.0)];
    let cuts = (0..300).filter(|&seed| cut(&one(&mut rng), &two_rounds(), seed).is_some());
    let cuts = cuts.count();
    assert!((1..=16).contains(&cuts), "{cuts} of 6 expected");
}

#[test]
fn a_cut_needs_a_time_for_each_episode_and_a_test() {
    let mut rng = ChaCha8Rng::seed_from_u64(14);
    let both = [straddling(&mut rng, 1.0)];
    let short = Assigner::default().cut(&both, &[0; 19], &mut rng);
    let message = short.unwrap_err().to_string();
    assert!(message.contains("began is 19: expected a time for each episode"), "{message}");
    let paper = fixed(1.0).unwrap().cut(&both, &two_rounds(), &mut rng);
    assert_eq!(paper.unwrap(), None);
}
