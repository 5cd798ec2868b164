//! Benchmarks of exact 1-Wasserstein distances on one thread, and of one assignment among 16
//! policies on all threads.

use std::hint::black_box;

use cluster::{AssignedPolicy, wasserstein1};
use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use envs::{ACTION_DIM, VECTOR_OBSERVATION_DIM};
use evidence::{
    EpisodeSummary, EvidenceError, Recogniser, RecogniserSettings, RolloutDecisionContext,
};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

const DIM: usize = 64;
const POLICIES: usize = 16;

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

/// Returns the summaries of 20 episodes whose first images, vectors, motion and returns all differ
/// with `policy`.
fn episodes(policy: usize, rng: &mut ChaCha8Rng) -> Vec<EpisodeSummary> {
    let mut values = |length: usize, centre: f32| -> Vec<f32> {
        (0..length).map(|_| centre + rng.random_range(-0.1..0.1)).collect()
    };
    let centre = policy as f32;
    let episode = |began| EpisodeSummary {
        began,
        image_features: values(DIM, centre),
        first_vector: values(VECTOR_OBSERVATION_DIM, centre),
        motion: Some(values(VECTOR_OBSERVATION_DIM * ACTION_DIM, centre)),
        reward_gradient: Some(values(ACTION_DIM, centre)),
        episode_return: Some(values(1, centre)[0]),
    };
    (0..20).map(episode).collect()
}

fn assign(rng: &mut ChaCha8Rng) -> Result<impl FnMut() -> Option<AssignedPolicy>, EvidenceError> {
    let mut recogniser = Recogniser::new(RecogniserSettings::default())?;
    for policy in 0..POLICIES {
        for _ in 0..2 {
            recogniser.record_training(policy, &episodes(policy, rng), rng)?;
        }
    }
    let (rollout, mut rng) = (episodes(1, rng), rng.clone());
    // the policy that acted is rejected, and all others are compared
    Ok(move || {
        let found =
            recogniser.assign_rollout(&rollout, RolloutDecisionContext::for_collector(0), &mut rng);
        found.ok().map(|found| found.policy)
    })
}

fn decision(c: &mut Criterion) {
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let Ok(mut assign) = assign(&mut rng) else {
        panic!("the episodes are refused");
    };
    c.bench_function("assign_among_16_policies", |b| {
        b.iter(|| assert_eq!(assign(), Some(AssignedPolicy::Existing(1))));
    });
}

criterion_group!(benches, distances, decision);
criterion_main!(benches);
