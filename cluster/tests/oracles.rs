//! The solver against solvers of others: a general linear program, an assignment solver, recordings
//! of POT and of SciPy.

use cluster::{PointWeights, WassersteinSolver, solve_transport};
use lapjv::{Matrix, lapjv};
use microlp::{ComparisonOp, OptimizationDirection, Problem, SolveOutcome};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use serde_json::Value;

use crate::common::{normals, random_costs, random_weights, uniform};

/// The transport problem as a linear program in all `n m` entries of the plan.
fn linear_program(cost: &[f64], a: &[f64], b: &[f64]) -> f64 {
    let (n, m) = (a.len(), b.len());
    let mut program = Problem::new(OptimizationDirection::Minimize);
    let entries: Vec<_> = cost.iter().map(|&c| program.add_var(c, (0.0, f64::INFINITY))).collect();
    for (i, &weight) in a.iter().enumerate() {
        let row: Vec<_> = (0..m).map(|j| (entries[i * m + j], 1.0)).collect();
        program.add_constraint(row.as_slice(), ComparisonOp::Eq, weight);
    }
    // the last column follows from the others; rounding would make it contradict them
    for (j, &weight) in b.iter().enumerate().take(m - 1) {
        let column: Vec<_> = (0..n).map(|i| (entries[i * m + j], 1.0)).collect();
        program.add_constraint(column.as_slice(), ComparisonOp::Eq, weight);
    }
    match program.solve().expect("a feasible, bounded program") {
        SolveOutcome::Solution(solution) => solution.objective(),
        SolveOutcome::Interrupted(_) => panic!("no limit was set"),
    }
}

/// Weights of sum one, the first `zeros` of them zero.
fn weights_with_zeros(seed: u64, len: usize, zeros: usize) -> Vec<f64> {
    let mut weights = vec![0.0; zeros];
    weights.extend(random_weights(seed, len - zeros));
    weights
}

#[test]
fn weighted_problems_agree_with_a_linear_program() {
    for (seed, (n, m, zeros)) in
        [(2, 2, 0), (1, 9, 0), (9, 4, 2), (5, 12, 1), (13, 13, 3), (30, 20, 5)]
            .into_iter()
            .enumerate()
    {
        let seed = seed as u64;
        let (a, b) = (
            weights_with_zeros(seed, n, zeros.min(n - 1)),
            weights_with_zeros(100 + seed, m, zeros),
        );
        let random = random_costs(200 + seed, n * m);
        let tied: Vec<f64> = random.iter().map(|c| (3.0 * c).round()).collect();
        for cost in [random, tied] {
            let plan =
                solve_transport(&cost, PointWeights::Given(&a), PointWeights::Given(&b)).unwrap();
            let expected = linear_program(&cost, &a, &b);
            assert!(
                (plan.cost - expected).abs() <= 1e-9,
                "{n} x {m}: {} and {expected}",
                plan.cost
            );
        }
    }
}

#[test]
fn clouds_agree_with_an_assignment_solver_through_shortlists() {
    // more than 500 sinks
    let (n, dim) = (520, 8);
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let (x, y) = (normals(&mut rng, n * dim), normals(&mut rng, n * dim));
    let mut costs = cluster::EuclideanDistances::new();
    let cost = costs.compute(&x, &y, dim).unwrap();
    let matrix = Matrix::from_shape_vec((n, n), cost.to_vec()).unwrap();
    let (columns, _) = lapjv(&matrix).unwrap();
    let expected = lapjv::cost(&matrix, &columns) / n as f64;
    let got = cluster::wasserstein1(&x, &y, dim).unwrap();
    assert!((got - expected).abs() <= 1e-12 * expected, "{got} and {expected}");
}

fn numbers(problem: &Value, key: &str) -> Vec<f64> {
    let list = problem[key].as_array().expect("a list");
    list.iter().map(|v| v.as_f64().expect("a number")).collect()
}

/// Recorded integers as weights of sum one.
fn shares(problem: &Value, key: &str) -> Vec<f64> {
    let counts = numbers(problem, key);
    let sum: f64 = counts.iter().sum();
    counts.iter().map(|count| count / sum).collect()
}

fn cloud(problem: &Value, key: &str) -> Vec<f32> {
    numbers(problem, key).iter().map(|&v| v as f32).collect()
}

/// `benches/peers/ot_golden.py` made the recordings.
#[test]
fn weighted_clouds_agree_with_the_recordings_of_pot() {
    let recorded: Value = serde_json::from_str(include_str!("golden/pot.json")).unwrap();
    let mut workspace = WassersteinSolver::new();
    for problem in recorded["problems"].as_array().unwrap() {
        let (x, a) = (cloud(problem, "x"), shares(problem, "a"));
        let (y, b) = (cloud(problem, "y"), shares(problem, "b"));
        let dim = problem["dim"].as_u64().unwrap() as usize;
        let expected = problem["value"].as_f64().unwrap();
        let (x, y) = ((&x[..], PointWeights::Given(&a)), (&y[..], PointWeights::Given(&b)));
        let got = workspace.solve(x, y, dim).unwrap().cost;
        assert!(
            (got - expected).abs() <= 1e-9 * expected,
            "{}: {got} and {expected}",
            problem["name"]
        );
    }
}

/// `benches/peers/assignment_golden.py` made the recordings.
#[test]
fn block_matrices_with_forbidden_pairs_agree_with_the_recordings_of_scipy() {
    let recorded: Value = serde_json::from_str(include_str!("golden/scipy.json")).unwrap();
    let prices = numbers(&recorded, "prices");
    for matrix in recorded["matrices"].as_array().unwrap() {
        let [rows, columns, values] = ["rows", "columns", "values"].map(|key| numbers(matrix, key));
        let n = rows.len();
        for (case, expected) in values.into_iter().enumerate() {
            let mut allowed = numbers(matrix, "costs").into_iter();
            // the last case has all prices in one matrix
            let mixed = |i, j| prices[(5 * i + 7 * j) % prices.len()];
            let cost: Vec<f64> = (0..n * n)
                .map(|k| match (k / n, k % n) {
                    (i, j) if rows[i] == columns[j] => allowed.next().unwrap() / 1e4,
                    (i, j) => prices.get(case).copied().unwrap_or(mixed(i, j)),
                })
                .collect();
            let plan = uniform(&cost, n, n).unwrap();
            let got = plan.cost * n as f64;
            assert!((got - expected).abs() <= 1e-9 * expected, "{n}, {case}: {got} {expected}");
            let forbidden = plan.entries.iter().filter(|e| rows[e.source] != columns[e.sink]);
            let (used, least) = (forbidden.count() as u64, matrix["forbidden"].as_u64().unwrap());
            assert!(used == least || case == prices.len() && used > least, "{n}, {case}: {used}");
        }
    }
}
