//! One PPO update and one batch of inferences on 48 x 48 x 6 pictures, on one and two threads.

use std::hint::black_box;

use criterion::{BatchSize, Criterion, Throughput, criterion_group, criterion_main};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rl::{
    ActorCriticPolicy, Algorithm, Decisions, EnvSpec, NetworkSettings, Observations, OnPolicy, Ppo,
    PpoSettings, RlError, RolloutBuffer, Transition,
};

const STEPS: usize = 50;
const ENVS: usize = 20;

fn spec() -> EnvSpec {
    EnvSpec {
        num_envs: ENVS,
        image: [48, 48, envs::IMAGE_CHANNELS],
        vector: envs::VECTOR_IRREPS.to_vec(),
        action: envs::ACTION_IRREPS.to_vec(),
    }
}

/// A rollout of noise: what is computed does not depend on it.
fn rollout(policy: &mut ActorCriticPolicy, rng: &mut ChaCha8Rng) -> Result<RolloutBuffer, RlError> {
    let spec = spec();
    let mut buffer = RolloutBuffer::new(&spec, STEPS)?;
    let (mut observations, mut decisions) = (Observations::new(&spec), Decisions::new(&spec));
    let mut transition = Transition::new(&spec);
    for _ in 0..STEPS {
        observations.images.fill_with(|| rng.random());
        let vectors = &mut observations.vectors;
        vectors.fill_with(|| rng.random_range(-1.0..1.0));
        transition.rewards.fill_with(|| rng.random());
        policy.decide(&observations, &mut (), rng, &mut decisions)?;
        buffer.push(&observations, &decisions, &transition, &[0.0; ENVS])?;
    }
    buffer.finish(&observations, &[0.0; ENVS])?;
    Ok(buffer)
}

/// An optimiser without a limit on the divergence, so that every update runs all of its epochs.
fn unlimited(policy: &ActorCriticPolicy) -> Result<Ppo, RlError> {
    let settings = PpoSettings {
        max_kl: 1e9,
        ..PpoSettings::default()
    };
    Ppo::new(settings, policy)
}

fn measure(c: &mut Criterion, threads: usize) -> Result<(), RlError> {
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let mut policy = ActorCriticPolicy::new(&NetworkSettings::default(), &spec(), 0)?;
    let buffer = rollout(&mut policy, &mut rng)?;
    let mut group = c.benchmark_group(format!("ppo_48x48x6_t{threads}"));
    group.sample_size(10);
    group.throughput(Throughput::Elements((STEPS * ENVS) as u64));
    group.bench_function("update_1000_decisions", |b| {
        let fresh = || unlimited(&policy).map(|ppo| (ppo, policy.clone(), rng.clone()));
        let update = |fresh: Result<(Ppo, ActorCriticPolicy, ChaCha8Rng), RlError>| {
            let stats =
                fresh.and_then(|(mut ppo, mut p, mut rng)| ppo.update(&mut p, &buffer, &mut rng));
            assert!(stats.is_ok_and(|stats| stats.epochs == PpoSettings::default().epochs));
        };
        b.iter_batched(fresh, update, BatchSize::PerIteration);
    });
    let observations = Observations::new(&spec());
    let mut decisions = Decisions::new(&spec());
    group.throughput(Throughput::Elements(ENVS as u64));
    group.bench_function("act_batch_20", |b| {
        b.iter(|| policy.decide(black_box(&observations), &mut (), &mut rng, &mut decisions));
    });
    assert!(decisions.log_probs.iter().all(|p| p.is_finite()));
    group.finish();
    Ok(())
}

fn ppo(c: &mut Criterion) {
    for threads in [1, 2] {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
        let Ok(pool) = pool else {
            panic!("cannot start {threads} threads");
        };
        if let Err(error) =
            pool.install(|| measure(&mut Criterion::default().configure_from_args(), threads))
        {
            panic!("{error}");
        }
    }
    c.final_summary();
}

criterion_group!(benches, ppo);
criterion_main!(benches);
