//! Benchmarks of exact 1-Wasserstein distances and of one decision of the calibrated assigner, on
//! one thread.

use std::hint::black_box;

use cluster::{Assigner, Candidate, ClusterError, Decision, Frames, wasserstein1};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const DIM: usize = 64;
const FRAMES: usize = 4;

fn cloud(points: usize, shift: f32, rng: &mut ChaCha8Rng) -> Vec<f32> {
    (0..points * DIM).map(|_| shift + rng.random_range(-1.0..1.0)).collect()
}

fn distances(c: &mut Criterion) {
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let mut group = c.benchmark_group("wasserstein1_d64");
    for (n, m) in [(80, 80), (80, 160), (80, 400), (80, 2000), (1000, 1000)] {
        let (x, y) = (cloud(n, 0.0, &mut rng), cloud(m, 0.5, &mut rng));
        group.throughput(Throughput::Elements((n * m) as u64));
        group.bench_function(format!("{n}x{m}"), |b| {
            b.iter(|| {
                let distance = wasserstein1(black_box(&x), &y, DIM);
                assert!(distance.is_ok_and(|d| d > 1.0));
            });
        });
    }
    group.finish();
}

fn candidate(shift: f32, rng: &mut ChaCha8Rng) -> Result<Candidate, ClusterError> {
    Ok(Candidate {
        buffer: Frames::new(cloud(20 * FRAMES, shift, rng), FRAMES, DIM)?,
        rollout: Frames::new(cloud(20 * FRAMES, 0.0, rng), FRAMES, DIM)?,
    })
}

fn decision(c: &mut Criterion) {
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let shifts = [2.0, 0.0, 1.0, 3.0, 4.0, 5.0, 6.0, 7.0];
    let candidates: Result<Vec<_>, _> =
        shifts.map(|s| candidate(s, &mut rng)).into_iter().collect();
    let Ok(candidates) = candidates else {
        panic!("the clouds are refused");
    };
    let assigner = Assigner::default();
    c.bench_function("assign_among_8_policies", |b| {
        b.iter(|| {
            let assignment = assigner.assign(black_box(&candidates), &mut rng);
            assert!(assignment.is_ok_and(|a| a.decision == Decision::Existing(1)));
        });
    });
}

criterion_group!(benches, distances, decision);
criterion_main!(benches);
