//! Benchmarks of one PPO update and one batch of inferences on 48 x 48 x 6 images, on one and two
//! threads.

mod noise;

use std::hint::black_box;

use criterion::{BatchSize, Criterion, Throughput, criterion_group, criterion_main};
use noise::{HORIZON, RandomEnv, random_env_spec};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rl::{
    ActorCriticPolicy, Algorithm, Decisions, NetworkSettings, Observations, OnPolicyActor, Ppo,
    PpoSettings, RlError, RolloutBuffer, RolloutState, collect_experience,
};

/// Collects a rollout of random observations.
fn rollout(policy: &mut ActorCriticPolicy, rng: &mut ChaCha8Rng) -> Result<RolloutBuffer, RlError> {
    let mut env = RandomEnv::new();
    let mut buffer = RolloutBuffer::new(&random_env_spec(), HORIZON)?;
    let mut state = RolloutState::from_env_reset(&mut env, policy)?;
    collect_experience(&mut env, policy, &mut buffer, &mut state, rng)?;
    Ok(buffer)
}

/// Creates an optimiser without a limit on the divergence, so that every update runs all of its
/// epochs.
fn unlimited(policy: &ActorCriticPolicy) -> Result<Ppo, RlError> {
    let settings = PpoSettings { max_kl: 1e9, ..PpoSettings::default() };
    Ppo::new(settings, policy)
}

fn measure(c: &mut Criterion, threads: usize) -> Result<(), RlError> {
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let mut policy = ActorCriticPolicy::new(&NetworkSettings::default(), &random_env_spec(), 0)?;
    let buffer = rollout(&mut policy, &mut rng)?;
    let mut group = c.benchmark_group(format!("ppo_48x48x6_t{threads}"));
    group.sample_size(10);
    group.throughput(Throughput::Elements((HORIZON * random_env_spec().num_envs) as u64));
    group.bench_function("update_1000_decisions", |b| {
        let fresh = || unlimited(&policy).map(|ppo| (ppo, policy.clone(), rng.clone()));
        let update = |prepared: Result<(Ppo, ActorCriticPolicy, ChaCha8Rng), RlError>| {
            let stats = prepared.and_then(|(mut ppo, mut p, mut own_rng)| {
                ppo.update(&mut p, &buffer, &mut own_rng)
            });
            assert!(stats.is_ok_and(|stats| stats.epochs == PpoSettings::default().epochs));
        };
        b.iter_batched(fresh, update, BatchSize::PerIteration);
    });
    let observations = Observations::new(&random_env_spec());
    let mut decisions = Decisions::new(&random_env_spec());
    let noise = vec![0.0; decisions.actions.len()];
    group.throughput(Throughput::Elements(random_env_spec().num_envs as u64));
    group.bench_function("act_batch_20", |b| {
        b.iter(|| policy.decide(black_box(&observations), &mut (), &noise, &mut decisions));
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
