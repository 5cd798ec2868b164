//! A workspace that is kept allocates nothing once it has seen a problem of the size.

mod common;

use allocation_counter::measure;
use cluster::{Solver, Wasserstein, Weights};
use common::{normals, random_costs, random_weights};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

/// Points, other points, dimensions: dense pricing and shortlists, with few enough multiplications
/// that one thread computes the distances.
const SIZES: [(usize, usize, usize); 4] =
    [(80, 80, 1), (80, 80, 128), (300, 200, 64), (100, 600, 64)];

#[test]
fn clouds_allocate_nothing_in_the_steady_state() {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    for (n, m, dim) in SIZES {
        let mut workspace = Wasserstein::new();
        let mut first = 0;
        for round in 0..8 {
            let (x, y) = (normals(&mut rng, n * dim), normals(&mut rng, m * dim));
            let weights = random_weights(round, n);
            let (a, b) = (Weights::Given(&weights), Weights::Uniform(m));
            let count = measure(|| {
                let plan = match round % 2 {
                    0 => workspace.solve((&x, a), (&y, b), dim),
                    _ => workspace.solve_again((&x, a), (&y, b), dim),
                };
                assert!(plan.unwrap().pivots > 0);
            });
            match round {
                // the first cold and the first warm start
                0 | 1 => first += count.count_total,
                _ => assert_eq!(count.count_total, 0, "{n} x {m}, round {round}: {count:?}"),
            }
        }
        assert!(first > 0, "the counter is not counting");
    }
}

#[test]
fn a_solver_allocates_nothing_on_smaller_problems() {
    let mut solver = Solver::new();
    let mut solve = |n: usize, m: usize, warm: bool| {
        let cost = random_costs(2, n * m);
        let (a, b) = (Weights::Uniform(n), Weights::Uniform(m));
        let count = measure(|| {
            let plan =
                if warm { solver.solve_again(&cost, a, b) } else { solver.solve(&cost, a, b) };
            plan.unwrap();
        });
        count.count_total
    };
    assert!(solve(100, 600, false) > 0);
    assert!(solve(100, 600, true) > 0, "a warm start keeps lists of its own");
    for (n, m) in [(99, 600), (100, 550), (60, 200), (1, 1), (100, 600)] {
        assert_eq!((solve(n, m, false), solve(n, m, true)), (0, 0), "{n} x {m}");
    }
}
