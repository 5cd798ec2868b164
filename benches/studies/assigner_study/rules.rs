//! Rules that decide whether a rollout belongs to a group.

use cluster::{
    Assigner, AssignerSettings, Calibrated, Candidate, ClusterError, Decision, PermutationTest,
    Rule, wasserstein1,
};
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

use crate::population::{Case, DIM, ROLLOUT};

/// Answer of a rule.
#[derive(Clone, Copy, Debug, Default)]
pub struct Answer {
    pub refused: bool,
    /// `true` if the rule asked for a second rollout.
    pub looked_twice: bool,
}

/// Names of the rules, in the order of [`answers`].
pub const NAMES: [&str; 8] = [
    "buffer's splits: W1 <= 1.25 max of 20",
    "buffer's splits: score <= 5 of 25",
    "pooled 20:20, W1 <= 1.12 max of 60",
    "pooled 20:20, score <= 4 of 60",
    "pooled 20:40, score and ratio, of 60",
    "pooled 20:40, one-frame limits, of 60",
    "as the one above, with a second look",
    "default",
];

/// Returns the answers of all rules; the default comes last.
pub fn answers(case: &Case, rng: &mut ChaCha8Rng) -> Result<[Answer; 8], ClusterError> {
    let (buffer_max, buffer_score) = split_buffer(case, rng)?;
    let even = pooled(case, false, 20, rng)?;
    let uneven = pooled(case, false, 40, rng)?;
    let one = |refused| Answer { refused, looked_twice: false };
    let doubted = limits(&uneven, 5.5, 7.0);
    let again = doubted && limits(&pooled(case, true, 40, rng)?, 5.5, 7.0);
    Ok([
        one(buffer_max > 1.25),
        one(buffer_score > 5.0),
        one(even.distance > 1.12 * even.null.max),
        one(even.score > 4.0),
        one(limits(&uneven, 3.5, 6.0)),
        one(doubted),
        Answer { refused: again, looked_twice: doubted },
        default(case, rng)?,
    ])
}

/// Returns both p-values of the default rule on the first rollout: by counting and by the fitted
/// tail.
pub fn p_values(case: &Case, rng: &mut ChaCha8Rng) -> Result<[f64; 2], ClusterError> {
    let assignment = Assigner::default().assign(&[candidate(case, false)?], rng)?;
    let test = assignment.evidence[0].test();
    Ok(test.map_or([1.0; 2], |test| [test.p_value, test.tail_p_value]))
}

/// Applies the default rule, as a learner with one policy does.
pub fn default(case: &Case, rng: &mut ChaCha8Rng) -> Result<Answer, ClusterError> {
    let assigner = Assigner::default();
    let first = assigner.assign(&[candidate(case, false)?], rng)?.decision;
    if first != Decision::Undecided {
        return Ok(Answer::default());
    }
    let second = assigner.settle(&[candidate(case, true)?], rng)?.decision;
    Ok(Answer { refused: second == Decision::New, looked_twice: true })
}

fn candidate(case: &Case, both: bool) -> Result<Candidate, ClusterError> {
    Ok(Candidate {
        buffer: case.buffer.clone(),
        rollout: if both { case.rollout.joined(&case.another)? } else { case.rollout.clone() },
    })
}

/// Returns `true`, to refuse, if score and ratio exceed their limits, or if the score exceeds a
/// higher one.
fn limits(test: &PermutationTest, score: f64, certain: f64) -> bool {
    let ratio = test.distance / test.null.max;
    test.score > certain || (test.score > score && ratio > 1.12)
}

/// Runs the permutation test on 60 splits with at most `episodes` of the buffer.
fn pooled(
    case: &Case,
    both: bool,
    episodes: usize,
    rng: &mut ChaCha8Rng,
) -> Result<PermutationTest, ClusterError> {
    let settings = Calibrated {
        permutations: 60,
        rollout_episodes: if both { 2 * ROLLOUT } else { ROLLOUT },
        buffer_episodes: episodes,
        ..Calibrated::default()
    };
    let rule = Rule::Calibrated(settings);
    let assigner = Assigner::new(AssignerSettings { rule })?;
    let assignment = assigner.assign(&[candidate(case, both)?], rng)?;
    let test = assignment.evidence[0].test();
    Ok(*test.ok_or(ClusterError::Empty { what: "the test" })?)
}

/// Compares W1(O, B) with W1 between random parts of B, the smaller one as large as the rollout.
/// Returns its ratio to the largest of 20, and its score among 25.
fn split_buffer(case: &Case, rng: &mut ChaCha8Rng) -> Result<(f64, f64), ClusterError> {
    let distance = wasserstein1(case.rollout.features(), case.buffer.features(), DIM)?;
    let mut order: Vec<usize> = (0..case.buffer.episodes()).collect();
    let part = ROLLOUT.min(order.len() / 2);
    let mut null = Vec::new();
    for _ in 0..25 {
        order.shuffle(rng);
        let side = |episodes: &[usize]| -> Vec<f32> {
            let features = episodes.iter().map(|&e| case.buffer.episode(e));
            features.flatten().copied().collect()
        };
        let (left, right) = order.split_at(part);
        null.push(wasserstein1(&side(left), &side(right), DIM)?);
    }
    let max = null[..20].iter().copied().fold(0.0, f64::max);
    let count = null.len() as f64;
    let mean = null.iter().sum::<f64>() / count;
    let sd = (null.iter().map(|w| (w - mean).powi(2)).sum::<f64>() / (count - 1.0)).sqrt();
    Ok((distance / max, (distance - mean) / sd))
}
