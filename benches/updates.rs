//! Benchmarks of policy updates on 48 x 48 x 6 images. Rates are sample-passes per second.
//!
//! They measure an update of PPO with its default settings on one and two threads. On one thread
//! they measure the time of one sample in one gradient: soft actor-critic, with and without a
//! context, beside PPO on a network with the same settings.

mod noise;

use criterion::{BatchSize, Criterion, Throughput, criterion_group, criterion_main};
use noise::{HORIZON, RandomEnv, random_env_spec};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rl::{
    Actor, ActorCriticPolicy, Algorithm, ExperienceBuffer, Metrics, NetworkSettings, Ppo,
    PpoSettings, RecurrentContextSettings, ReplayBuffer, ReplaySettings, RlError, RolloutBuffer,
    RolloutState, Sac, SacPolicy, SacSettings, collect_experience,
};
use symmetry::Group;

/// Number of gradient steps of 512 samples in an update of soft actor-critic.
const STEPS: usize = 4;

/// Criterion group of benchmarks on networks with the same settings.
struct Case<'a> {
    name: &'a str,
    network: NetworkSettings,
}

impl Case<'_> {
    /// Collects 1000 decisions.
    fn fill<A: Actor>(
        &self,
        policy: &mut A,
        experience: &mut impl ExperienceBuffer<A>,
    ) -> Result<(), RlError> {
        let (mut env, mut rng) = (RandomEnv::new(), ChaCha8Rng::seed_from_u64(1));
        let mut state = RolloutState::from_env_reset(&mut env, policy)?;
        collect_experience(&mut env, policy, experience, &mut state, &mut rng)?;
        Ok(())
    }

    /// Measures PPO: this number of passes over 1000 decisions.
    fn ppo(&self, c: &mut Criterion, name: &str, epochs: usize) -> Result<(), RlError> {
        let mut policy = ActorCriticPolicy::new(&self.network, &random_env_spec(), 0)?;
        let mut buffer = RolloutBuffer::new(&random_env_spec(), HORIZON)?;
        self.fill(&mut policy, &mut buffer)?;
        // no limit on the divergence, so that every update runs all of its epochs
        let settings = PpoSettings { epochs, max_kl: 1e9, ..PpoSettings::default() };
        let fresh = || Ok((Ppo::new(settings.clone(), &policy)?, policy.clone()));
        let samples = epochs * HORIZON * random_env_spec().num_envs;
        self.measure(c, name, (samples, "epochs", epochs as f64), fresh, &buffer)
    }

    fn sac(
        &self,
        c: &mut Criterion,
        name: &str,
        context: Option<RecurrentContextSettings>,
        settings: SacSettings,
    ) -> Result<(), RlError> {
        let mut policy = SacPolicy::new(&self.network, context, &random_env_spec(), 0)?;
        let replay = ReplaySettings { steps: HORIZON, ..ReplaySettings::default() };
        let mut replay = ReplayBuffer::new(replay, &random_env_spec())?;
        self.fill(&mut policy, &mut replay)?;
        let samples = 512 * STEPS;
        let updates = samples as f32 / settings.batch as f32;
        let settings = SacSettings {
            burn_in: 0,
            // half a step more, since rounding down must not lose a step
            updates_per_step: (updates + 0.5) / replay.len() as f32,
            ..settings
        };
        let fresh = || Ok((Sac::new(settings.clone(), &policy)?, policy.clone()));
        self.measure(c, name, (samples, "steps", updates.into()), fresh, &replay)
    }

    /// Measures updates, each of a fresh copy, and asserts that they report `expected` for the
    /// metric `figure`.
    fn measure<A: Algorithm>(
        &self,
        c: &mut Criterion,
        name: &str,
        (samples, figure, expected): (usize, &str, f64),
        fresh: impl Fn() -> Result<(A, A::Policy), RlError>,
        experience: &A::Experience,
    ) -> Result<(), RlError> {
        let (mut algorithm, mut policy) = fresh()?;
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let stats = algorithm.update(&mut policy, experience, &mut rng)?;
        assert!(stats.metrics().contains(&(figure.to_owned(), expected)));
        let mut group = c.benchmark_group(self.name);
        group.sample_size(10);
        group.throughput(Throughput::Elements(samples as u64));
        group.bench_function(name, |b| {
            let update = |prepared: Result<(A, A::Policy), RlError>| {
                let mut update_rng = ChaCha8Rng::seed_from_u64(2);
                let result = prepared.and_then(|(mut a, mut fresh_policy)| {
                    a.update(&mut fresh_policy, experience, &mut update_rng)
                });
                assert!(result.is_ok());
            };
            b.iter_batched(&fresh, update, BatchSize::PerIteration);
        });
        group.finish();
        Ok(())
    }
}

/// Measures PPO with its default settings.
fn default_ppo(c: &mut Criterion, threads: usize) -> Result<(), RlError> {
    let name = format!("ppo_48x48x6_t{threads}");
    let case = Case { name: &name, network: NetworkSettings::default() };
    case.ppo(c, "update_1000_decisions", PpoSettings::default().epochs)
}

/// Measures soft actor-critic beside PPO.
fn both_algorithms(c: &mut Criterion) -> Result<(), RlError> {
    let plain = Case {
        name: "updates_plain",
        network: NetworkSettings { group: Group::C1, ..NetworkSettings::default() },
    };
    plain.ppo(c, "ppo", 2)?;
    plain.sac(c, "sac", None, SacSettings::paper())?;
    let windows = SacSettings { window: 16, ..SacSettings::paper() };
    let context = Some(RecurrentContextSettings::default());
    plain.sac(c, "sac_with_context", context, windows)?;
    let equivariant = Case { name: "updates_equivariant", network: NetworkSettings::default() };
    equivariant.ppo(c, "ppo", 2)?;
    let augmented = SacSettings { batch: 128, augmentation: Group::D2, ..SacSettings::paper() };
    equivariant.sac(c, "sac_augmented", None, augmented)
}

/// Runs benchmarks on this number of threads.
fn on_threads(threads: usize, run: impl FnOnce(&mut Criterion) -> Result<(), RlError> + Send) {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build();
    let Ok(pool) = pool else {
        panic!("cannot start {threads} threads");
    };
    if let Err(error) = pool.install(|| run(&mut Criterion::default().configure_from_args())) {
        panic!("{error}");
    }
}

fn updates(c: &mut Criterion) {
    for threads in [1, 2] {
        on_threads(threads, |on_pool| default_ppo(on_pool, threads));
    }
    on_threads(1, both_algorithms);
    c.final_summary();
}

criterion_group!(benches, updates);
criterion_main!(benches);
