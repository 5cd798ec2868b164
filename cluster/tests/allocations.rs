//! A workspace that is kept allocates nothing once it has seen a problem of the size.

mod common;

use allocation_counter::measure;
use cluster::{PointWeights, WassersteinSolver};
use common::{normals, random_weights};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// Points, other points, dimensions: dense pricing and shortlists, the largest first, with few
/// enough multiplications that one thread computes the distances.
const SIZES: [(usize, usize, usize); 6] =
    [(300, 600, 16), (100, 600, 16), (80, 80, 1), (80, 80, 16), (300, 200, 8), (1, 1, 1)];

#[test]
fn nothing_is_allocated_in_the_steady_state() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut workspace = WassersteinSolver::new();
    for (index, (n, m, dim)) in SIZES.into_iter().enumerate() {
        for round in 0..4_usize {
            let (x, y) = (normals(&mut rng, n * dim), normals(&mut rng, m * dim));
            let weights = random_weights(round as u64, n);
            let (a, b) = (PointWeights::Given(&weights), PointWeights::Uniform(m));
            let count = measure(|| {
                let plan = workspace.solve((&x, a), (&y, b), dim);
                assert!(n == 1 || plan.unwrap().pivots > 0);
            });
            assert_eq!(
                count.count_total > 0,
                index + round == 0,
                "{n} x {m}, round {round}: {count:?}"
            );
        }
    }
}
