//! One hostile input for each seed, and the verdict that it must get.

use cluster::{
    CERTIFICATE_RELATIVE_TOLERANCE, ClusterError, MAX_ABS_COST, MAX_RELATIVE_DUALITY_GAP,
    PointWeights, TransportPlan, TransportSolver, WassersteinSolver, certify_optimality,
};
use rand::seq::IndexedRandom;
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::common::distances;
use crate::oracle;

#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub enum Outcome {
    /// Solved and certified; no oracle covers it.
    Certified,
    /// Solved, certified, and of the value that an oracle found.
    Confirmed,
    /// Malformed, and refused.
    Refused,
    /// Refused because rounding leaves too much of the cost open: costs of both signs, or given
    /// weights, whose sums round.
    Imprecise,
}

/// Solves the input of this seed, after another one with the same memory as often as not.
///
/// # Errors
/// A well-formed input that is refused, a malformed one that is answered, an answer that is no
/// optimum.
pub fn run(seed: u64) -> Result<Outcome, String> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let (mut solver, mut workspace) = (TransportSolver::new(), WassersteinSolver::new());
    let with_points = rng.random_ratio(1, 3);
    let mut solve = |draws: &mut ChaCha8Rng| match (with_points, draws.random_ratio(1, 4)) {
        (true, _) => clouds(draws, &mut workspace),
        (false, true) => forbidden_pairs(draws).solve(&mut solver),
        (false, false) => matrix(draws).solve(&mut solver),
    };
    if rng.random() {
        solve(&mut rng)?;
    }
    solve(&mut rng)
}

/// Problem on a cost matrix, and the verdict that it must get.
struct Problem {
    cost: Vec<f64>,
    a: Side,
    b: Side,
    /// `false` for a malformed problem.
    sound: bool,
    /// `true` if the problem may be beyond the precision of an `f64`.
    hard: bool,
}

impl Problem {
    fn solve(&self, solver: &mut TransportSolver) -> Result<Outcome, String> {
        let Self { cost, a, b, sound, hard } = self;
        let result = solver.solve(cost, a.weights(), b.weights());
        let plan = match expected(*sound, *hard, result)? {
            Ok(plan) => plan,
            Err(refused) => return Ok(refused),
        };
        let again =
            certify_optimality(cost, a.weights(), b.weights(), plan).map_err(|e| e.to_string())?;
        if again != plan.certificate || !plan.cost.is_finite() {
            return Err(format!("{again:?} is not {:?}", plan.certificate));
        }
        agree(plan.cost, oracle(cost, a, b), tolerance(cost, a, b, plan))
    }
}

enum Side {
    Uniform(usize),
    Given(Vec<f64>),
}

impl Side {
    fn weights(&self) -> PointWeights<'_> {
        match self {
            Self::Uniform(points) => PointWeights::Uniform(*points),
            Self::Given(weights) => PointWeights::Given(weights),
        }
    }

    /// Weights as fractions of their sum, for the oracles.
    fn fractions(&self) -> Vec<f64> {
        match self {
            Self::Uniform(points) => vec![1.0 / *points as f64; *points],
            Self::Given(weights) => {
                let sum: f64 = weights.iter().sum();
                weights.iter().map(|w| w / sum).collect()
            }
        }
    }
}

/// Returns the value that an oracle finds, if one covers the problem.
///
/// Equal weights are whole numbers to it: fractions do not add up to the last bit, and what is left
/// would be multiplied by the largest cost.
fn oracle(cost: &[f64], a: &Side, b: &Side) -> Option<f64> {
    let (Side::Uniform(n), Side::Uniform(m)) = (a, b) else {
        return oracle::transport(cost, &a.fractions(), &b.fractions());
    };
    let (supplies, demands) = (vec![*m as f64; *n], vec![*n as f64; *m]);
    Some(oracle::transport(cost, &supplies, &demands)? / (n * m) as f64)
}

/// Returns how far a cost may lie from an oracle's: what the crate promises, and what given weights
/// round in the oracle.
fn tolerance(cost: &[f64], a: &Side, b: &Side, plan: &TransportPlan) -> f64 {
    let sinks = plan.sink_potentials.len();
    let paid = plan.entries.iter().map(|e| cost[e.source * sinks + e.sink]);
    let smallest = paid.filter(|c| *c > 0.0).fold(f64::INFINITY, f64::min);
    let least = cost.iter().fold(0.0_f64, |least, c| least.min(*c));
    let near_zero = if least < 0.0 {
        plan.cost - least
    } else if !equal(a, b) && smallest.is_finite() {
        smallest
    } else {
        0.0
    };
    let promised = (MAX_RELATIVE_DUALITY_GAP * plan.cost.abs())
        .max(CERTIFICATE_RELATIVE_TOLERANCE * near_zero);
    let rounded = if equal(a, b) { 0.0 } else { 1e-15 * largest(cost) };
    promised + rounded + 1e-320
}

fn matrix(rng: &mut ChaCha8Rng) -> Problem {
    let (mut n, mut m) = (size(rng), size(rng));
    if rng.random_ratio(1, 1000) {
        m = rng.random_range(501..560); // priced through shortlists
    }
    if rng.random_ratio(1, 3) {
        n = m.min(6);
        m = n;
    }
    let (mut cost, mut a, mut b) = (costs(rng, n, m), side(rng, n), side(rng, m));
    let sound = !rng.random_ratio(1, 8);
    if !sound {
        spoil_matrix(rng, &mut cost, &mut a, &mut b);
    }
    let hard = cost.iter().any(|c| *c < 0.0) || !equal(&a, &b);
    Problem { cost, a, b, sound, hard }
}

/// Small whole costs of both signs and forbidden pairs between equal weights, for which rounding is
/// no excuse.
fn forbidden_pairs(rng: &mut ChaCha8Rng) -> Problem {
    let n = rng.random_range(3..=8);
    let prices = [1e9, 1e16, 1e18, 1e30, MAX_ABS_COST];
    let one_price = rng.random::<bool>().then(|| rng.random_range(0..prices.len()));
    let share = rng.random_range(1..6);
    let mut cost = || {
        if rng.random_ratio(share, 10) {
            prices[one_price.unwrap_or_else(|| rng.random_range(0..prices.len()))]
        } else {
            f64::from(rng.random_range(-3..=3))
        }
    };
    let cost = (0..n * n).map(|_| cost()).collect();
    Problem { cost, a: Side::Uniform(n), b: Side::Uniform(n), sound: true, hard: false }
}

/// Returns `true` if the weights of both sides are equal.
fn equal(a: &Side, b: &Side) -> bool {
    matches!((a, b), (Side::Uniform(_), Side::Uniform(_)))
}

fn largest(values: &[f64]) -> f64 {
    values.iter().fold(0.0, |top: f64, v| top.max(v.abs()))
}

fn clouds(rng: &mut ChaCha8Rng, workspace: &mut WassersteinSolver) -> Result<Outcome, String> {
    let (n, m) = (size(rng), size(rng));
    let mut dim = *[1, 1, 2, 3, 64].choose(rng).unwrap_or(&1);
    let (mut x, mut y) = points(rng, n, m, dim);
    let (mut a, mut b) = (side(rng, n), side(rng, m));
    let sound = !rng.random_ratio(1, 8);
    if !sound {
        spoil_clouds(rng, (&mut x, &mut y), (&mut a, &mut b), &mut dim);
    }
    let result = workspace.solve((&x, a.weights()), (&y, b.weights()), dim);
    let plan = match expected(sound, !equal(&a, &b), result)? {
        Ok(plan) => plan,
        Err(refused) => return Ok(refused),
    };
    let cost = distances(&x, &y, dim);
    let tolerance = tolerance(&cost, &a, &b, plan);
    let on_a_line = dim == 1 && equal(&a, &b);
    let expected = if on_a_line { Some(oracle::line(&x, &y)) } else { oracle(&cost, &a, &b) };
    agree(plan.cost, expected, tolerance)
}

/// Holds a verdict to the one that the input deserves: a plan, or the reason why there is none.
/// `hard` inputs may be beyond the precision of an `f64`.
///
/// # Errors
/// The difference.
pub fn expected(
    sound: bool,
    hard: bool,
    result: Result<&TransportPlan, ClusterError>,
) -> Result<Result<&TransportPlan, Outcome>, String> {
    match (sound, result) {
        (true, Ok(plan)) => Ok(Ok(plan)),
        (true, Err(ClusterError::Imprecise { .. })) if hard => Ok(Err(Outcome::Imprecise)),
        (false, Err(_)) => Ok(Err(Outcome::Refused)),
        (true, Err(error)) => Err(format!("a well-formed input was refused: {error}")),
        (false, Ok(_)) => Err("a malformed input was answered".into()),
    }
}

/// Holds a cost to an oracle's, if there is one.
///
/// # Errors
/// Both, where they differ.
pub fn agree(got: f64, value: Option<f64>, tolerance: f64) -> Result<Outcome, String> {
    match value {
        None => Ok(Outcome::Certified),
        Some(value) if (got - value).abs() <= tolerance => Ok(Outcome::Confirmed),
        Some(value) => Err(format!("the cost is {got:e}, an oracle says {value:e}")),
    }
}

/// Small as a rule.
fn size(rng: &mut ChaCha8Rng) -> usize {
    if rng.random_ratio(1, 200) { rng.random_range(13..80) } else { rng.random_range(1..=12) }
}

fn costs(rng: &mut ChaCha8Rng, n: usize, m: usize) -> Vec<f64> {
    let kind = rng.random_range(0..13);
    let constant = rng.random_range(-3.0..3.0);
    let forbidden = *[1e9, 1e15, 1e18, 1e30, MAX_ABS_COST].choose(rng).unwrap_or(&0.0);
    let blocks = rng.random_range(2..5);
    (0..n * m)
        .map(|k| match kind {
            0 => rng.random_range(-1.0..1.0),
            1 => f64::from(rng.random_range(0..4)),
            2 => constant,
            3 => magnitude(rng, -30..31),
            4 => magnitude(rng, -323..-300),
            5 => MAX_ABS_COST * rng.random_range(-1.0..=1.0),
            6 => *[0.1, 0.2, 0.3, 1e9].choose(rng).unwrap_or(&0.0),
            7 => 1.0 + f64::EPSILON * f64::from(rng.random_range(0..4)),
            8 => (k / m).abs_diff(k % m) as f64 * 0.1,
            9 => magnitude(rng, -30..31).abs(),
            10 if k / m % blocks == k % m % blocks => rng.random_range(0.0..4.0),
            10 => forbidden,
            11 if rng.random() => forbidden,
            11 => magnitude(rng, -3..4).abs(),
            _ => f64::from_bits(rng.random_range(0..4)),
        })
        .collect()
}

fn magnitude(rng: &mut ChaCha8Rng, exponents: std::ops::Range<i32>) -> f64 {
    let sign = if rng.random() { 1.0 } else { -1.0 };
    sign * rng.random_range(1.0..10.0) * 10.0_f64.powi(rng.random_range(exponents))
}

fn side(rng: &mut ChaCha8Rng, points: usize) -> Side {
    let kind = rng.random_range(0..6);
    let heaviest = rng.random_range(0..points);
    let raw: Vec<f64> = (0..points)
        .map(|i| match kind {
            0..3 => 1.0,
            3 => f64::from(rng.random_range(0..4)) + f64::from(u8::from(i == heaviest)),
            4 => 10.0_f64.powi(-rng.random_range(0..320)) + f64::from(u8::from(i == heaviest)),
            _ => f64::from(u8::from(i == heaviest)),
        })
        .collect();
    if kind < 2 {
        return Side::Uniform(points);
    }
    let off = 1.0 + rng.random_range(-9e-7..9e-7);
    let sum: f64 = raw.iter().sum();
    Side::Given(raw.iter().map(|w| w / sum * off).collect())
}

/// Makes an input that must be refused.
fn spoil_matrix(rng: &mut ChaCha8Rng, cost: &mut Vec<f64>, a: &mut Side, b: &mut Side) {
    let place = rng.random_range(0..cost.len());
    match rng.random_range(0..5) {
        0 => cost[place] = unfit(rng),
        1 => cost.truncate(place),
        2 => cost.push(0.0),
        3 => spoil_side(rng, a),
        _ => spoil_side(rng, b),
    }
}

fn unfit(rng: &mut ChaCha8Rng) -> f64 {
    let unfit = [f64::NAN, f64::INFINITY, f64::NEG_INFINITY, 2.0 * MAX_ABS_COST, f64::MIN];
    *unfit.choose(rng).unwrap_or(&f64::NAN)
}

fn spoil_side(rng: &mut impl Rng, side: &mut Side) {
    match side {
        Side::Uniform(points) => {
            let wrong = [0, *points + 1, usize::MAX, usize::MAX / *points];
            *points = *wrong.choose(rng).unwrap_or(&0);
        }
        Side::Given(weights) => {
            let place = rng.random_range(0..weights.len());
            match rng.random_range(0..6) {
                0 => weights[place] = f64::NAN,
                1 => weights[place] = f64::INFINITY,
                2 => weights[place] = -f64::MIN_POSITIVE,
                3 => weights[place] += 1e-5,
                4 => weights.fill(0.0),
                _ => weights.push(0.0),
            }
        }
    }
}

fn points(rng: &mut ChaCha8Rng, n: usize, m: usize, dim: usize) -> (Vec<f32>, Vec<f32>) {
    let kind = rng.random_range(0..7);
    let far = 10.0_f32.powi(rng.random_range(6..31));
    let mut cloud = |points: usize| -> Vec<f32> {
        (0..points * dim)
            .map(|k| match kind {
                0 => rng.random_range(-1.0..1.0),
                1 => f32::from(rng.random_range(0_i8..3)),
                2 => 1e30 * rng.random_range(-1.0_f32..1.0),
                3 => f32::from_bits(rng.random_range(0..100)),
                4 => 1e6 + rng.random_range(0.0..1.0),
                // an outlier, in the same place in both clouds
                5 if k < dim => far,
                5 => rng.random_range(-1.0..1.0),
                _ => (k / dim) as f32,
            })
            .collect()
    };
    (cloud(n), cloud(m))
}

fn spoil_clouds(
    rng: &mut ChaCha8Rng,
    (x, y): (&mut Vec<f32>, &mut Vec<f32>),
    (a, b): (&mut Side, &mut Side),
    dim: &mut usize,
) {
    let place = rng.random_range(0..x.len());
    match rng.random_range(0..7) {
        0 => x[place] = f32::NAN,
        1 => x[place] = f32::NEG_INFINITY,
        2 => y.clear(),
        3 => *dim = 0,
        4 => y.push(0.0), // half a point, or one without a weight
        5 => spoil_side(rng, a),
        _ => spoil_side(rng, b),
    }
}
