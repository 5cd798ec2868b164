//! Detects changepoints in a stream of points, with the `cluster` crate alone.
//!
//! `cargo run --release --example embed_cluster`

use cluster::{ClusterError, PointWeights, WassersteinSolver};
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const DIM: usize = 3;
const STREAM: usize = 1600;
/// Changepoints, at which the distribution moves, widens and splits in two.
const CHANGES: [usize; 3] = [400, 800, 1200];
/// Number of first points of a regime, with which later points are compared.
const REFERENCE: usize = 120;
/// Number of latest points, which are compared with the reference every `STRIDE` points.
const WINDOW: usize = 40;
const STRIDE: usize = 5;
/// Number of random splits of a reference. The largest distance between the parts of a split, times
/// a margin for the many comparisons of a stream, is the limit for points of one regime.
const SPLITS: usize = 200;
const MARGIN: f64 = 1.15;

fn main() -> Result<(), ClusterError> {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let stream: Vec<[f32; DIM]> = (0..STREAM).map(|time| point(time, &mut rng)).collect();
    let mut workspace = WassersteinSolver::new();
    let mut changes = CHANGES.iter();
    let mut start = 0;
    while start + REFERENCE + WINDOW <= STREAM {
        let reference = &stream[start..start + REFERENCE];
        let limit = MARGIN * farthest_split(&mut workspace, reference, &mut rng)?;
        let mut now = start + REFERENCE + WINDOW;
        let mut distance = w1(&mut workspace, reference, &stream[now - WINDOW..now])?;
        while distance <= limit && now + STRIDE <= STREAM {
            now += STRIDE;
            distance = w1(&mut workspace, reference, &stream[now - WINDOW..now])?;
        }
        if distance > limit {
            let window = now - WINDOW..now;
            println!("a change within {window:?}: W1 {distance:.2}, at most {limit:.2} before");
            assert!(changes.next().is_some_and(|change| window.contains(change)));
        }
        start = now;
    }
    assert_eq!(changes.next(), None, "a change went by unseen");
    println!("the changes were at {CHANGES:?}");
    Ok(())
}

/// Draws a point: around 0, around 1, with more width around 1, or around two centres with mean 1.
fn point(time: usize, rng: &mut ChaCha8Rng) -> [f32; DIM] {
    let regime = CHANGES.iter().filter(|change| time >= **change).count();
    let side = if rng.random() { 1.0 } else { -1.0 };
    let (centre, width) = [(0.0, 1.0), (1.0, 1.0), (1.0, 2.0), (1.0 + 2.0 * side, 1.0)][regime];
    [0; DIM].map(|_| centre + width * rng.random_range(-1.0..1.0))
}

/// Returns the 1-Wasserstein distance between two sets of points with equal weights.
fn w1(
    workspace: &mut WassersteinSolver,
    x: &[[f32; DIM]],
    y: &[[f32; DIM]],
) -> Result<f64, ClusterError> {
    let (a, b) = (PointWeights::Uniform(x.len()), PointWeights::Uniform(y.len()));
    let plan = workspace.solve((x.as_flattened(), a), (y.as_flattened(), b), DIM)?;
    Ok(plan.cost)
}

/// Returns the largest distance between a random window of the reference and the rest of it.
fn farthest_split(
    workspace: &mut WassersteinSolver,
    reference: &[[f32; DIM]],
    rng: &mut ChaCha8Rng,
) -> Result<f64, ClusterError> {
    let mut points = reference.to_vec();
    let mut farthest = 0.0_f64;
    for _ in 0..SPLITS {
        points.shuffle(rng);
        let (window, rest) = points.split_at(WINDOW);
        farthest = farthest.max(w1(workspace, rest, window)?);
    }
    Ok(farthest)
}
