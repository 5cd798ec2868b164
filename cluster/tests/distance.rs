//! Distances against their definition, gradients against central differences; hostile input.

use cluster::{ClusterError, EuclideanDistances, wasserstein1, wasserstein1_gradient};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::common::{distances, normals};

#[track_caller]
fn assert_close(got: f64, expected: f64) {
    assert!((got - expected).abs() <= 1e-9 * expected.max(1.0), "got {got}, expected {expected}");
}

#[test]
fn the_largest_and_smallest_finite_features_are_accepted() {
    let far = wasserstein1(&[f32::MAX; 64], &[f32::MIN; 64], 64).unwrap();
    assert_close(far / f64::from(f32::MAX), 16.0);
    let near = wasserstein1(&[f32::from_bits(1)], &[0.0], 1).unwrap();
    assert_eq!(near, f64::from(f32::from_bits(1)));
}

#[test]
fn hostile_input_is_refused_with_its_values() {
    let message = |x: &[f32], y: &[f32], dim| wasserstein1(x, y, dim).unwrap_err().to_string();
    assert_eq!(message(&[], &[1.0], 1), "x is empty: expected at least one value");
    assert_eq!(message(&[1.0], &[], 1), "y is empty: expected at least one value");
    assert_eq!(message(&[1.0], &[1.0], 0), "dim is 0: expected at least 1");
    let ragged = "y has 3 values, which is not a multiple of 2 (the length of one point)";
    assert_eq!(message(&[1.0, 2.0], &[1.0, 2.0, 3.0], 2), ragged);
    assert_eq!(message(&[1.0, f32::NAN], &[1.0], 1), "x[1] is NaN: expected a finite number");
    assert_eq!(message(&[1.0], &[f32::NEG_INFINITY], 1), "y[0] is -inf: expected a finite number");
    let gradient = wasserstein1_gradient(&[1.0], &[1.0], 0);
    assert!(matches!(gradient, Err(ClusterError::OutOfRange { name: "dim", .. })));
}

#[test]
fn distances_are_accurate_however_much_cancels() {
    // clouds that lie far from the origin and from one another, with near and exact duplicates
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    for dim in [1, 3, 64, 130] {
        let mut x = normals(&mut rng, 70 * dim);
        x.iter_mut().take(30 * dim).for_each(|v| *v = 1000.0 + *v * 1e-3);
        let mut y = x.clone();
        y.iter_mut().skip(50 * dim).for_each(|v| *v += 1e-4);
        let mut costs = EuclideanDistances::new();
        let costs = costs.compute(&x, &y, dim).unwrap();
        for (got, expected) in costs.iter().zip(distances(&x, &y, dim)) {
            assert!((got - expected).abs() <= 1e-11 * expected, "{got} {expected}");
        }
    }
}

#[test]
fn distances_have_the_same_bits_on_any_number_of_threads() {
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    let (x, y) = (normals(&mut rng, 300 * 64), normals(&mut rng, 300 * 64));
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
        pool.install(|| EuclideanDistances::new().compute(&x, &y, 64).unwrap().to_vec())
    };
    let one = on(1);
    assert_eq!(one, on(2));
    assert_eq!(one, on(3));
}

#[test]
fn the_gradient_agrees_with_central_differences() {
    let mut rng = ChaCha8Rng::seed_from_u64(7);
    let step = 2.0_f32.powi(-12);
    for (n, m, dim) in [(1, 1, 3), (6, 6, 2), (9, 5, 3), (5, 9, 3), (20, 12, 16)] {
        // steps and coordinates are exact in f32
        let mut draw = |points: usize| -> Vec<f32> {
            normals(&mut rng, points * dim).iter().map(|v| (v * 256.0).round() / 256.0).collect()
        };
        let (x, y) = (draw(n), draw(m));
        let gradient = wasserstein1_gradient(&x, &y, dim).unwrap();
        assert_close(gradient.distance, wasserstein1(&x, &y, dim).unwrap());
        for (k, got) in gradient.x.iter().chain(&gradient.y).enumerate() {
            let value = |change: f32| {
                let mut moved = [x.clone(), y.clone()].concat();
                moved[k] += change;
                wasserstein1(&moved[..n * dim], &moved[n * dim..], dim).unwrap()
            };
            let expected = (value(step) - value(-step)) / f64::from(2.0 * step);
            assert!((got - expected).abs() < 1e-6, "{n}, {m}, {k}: {got} {expected}");
        }
    }
}

#[test]
fn the_gradient_balances_and_gives_back_the_distance() {
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    for (n, m, shared) in [(7, 7, 0), (12, 5, 3), (30, 40, 10), (6, 6, 6)] {
        // shared points contribute nothing
        let (x, mut y) = (normals(&mut rng, 3 * n), normals(&mut rng, 3 * m));
        y[..3 * shared].copy_from_slice(&x[..3 * shared]);
        let gradient = wasserstein1_gradient(&x, &y, 3).unwrap();
        for d in 0..3 {
            // moving both clouds changes nothing
            let sum = |part: &[f64]| part.iter().skip(d).step_by(3).sum::<f64>();
            assert!((sum(&gradient.x) + sum(&gradient.y)).abs() < 1e-15 * (n + m) as f64);
        }
        // the distance is homogeneous: Euler's theorem
        let by = |part: &[f64], points: &[f32]| {
            part.iter().zip(points).map(|(g, p)| g * f64::from(*p)).sum::<f64>()
        };
        let distance = by(&gradient.x, &x) + by(&gradient.y, &y);
        assert!((distance - gradient.distance).abs() < 1e-13, "{n}, {m}: {gradient:?}");
        // each point moves the distance by its weight at most
        for (part, points) in [(&gradient.x, n), (&gradient.y, m)] {
            for slope in part.chunks_exact(3) {
                let slope = slope.iter().map(|g| g * g).sum::<f64>().sqrt();
                assert!(slope * points as f64 <= 1.0 + 1e-12, "{n}, {m}: {slope}");
            }
        }
    }
}
