//! Benchmarks of the time of one sample in one gradient, on one thread: soft actor-critic, with and
//! without a context, beside PPO on a network with the same settings. Rates are sample-passes per
//! second.

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

/// Benchmarks on networks of one symmetry group.
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

    /// Measures PPO: two passes over 1000 decisions.
    fn ppo(&self, c: &mut Criterion) -> Result<(), RlError> {
        let mut policy = ActorCriticPolicy::new(&self.network, &random_env_spec(), 0)?;
        let mut buffer = RolloutBuffer::new(&random_env_spec(), HORIZON)?;
        self.fill(&mut policy, &mut buffer)?;
        let settings = PpoSettings { epochs: 2, max_kl: 1e9, ..PpoSettings::default() };
        let fresh = || Ok((Ppo::new(settings.clone(), &policy)?, policy.clone()));
        let samples = 2 * HORIZON * random_env_spec().num_envs;
        self.measure(c, "ppo", (samples, "epochs", 2.0), fresh, &buffer)
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
        let mut group = c.benchmark_group(format!("updates_{}", self.name));
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

fn all(c: &mut Criterion) -> Result<(), RlError> {
    let plain = Case {
        name: "plain",
        network: NetworkSettings { group: Group::C1, ..NetworkSettings::default() },
    };
    plain.ppo(c)?;
    plain.sac(c, "sac", None, SacSettings::paper())?;
    let windows = SacSettings { window: 16, ..SacSettings::paper() };
    let context = Some(RecurrentContextSettings::default());
    plain.sac(c, "sac_with_context", context, windows)?;
    let equivariant = Case { name: "equivariant", network: NetworkSettings::default() };
    equivariant.ppo(c)?;
    let augmented = SacSettings { batch: 128, augmentation: Group::D2, ..SacSettings::paper() };
    equivariant.sac(c, "sac_augmented", None, augmented)
}

fn updates(c: &mut Criterion) {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(1).build();
    let Ok(pool) = pool else {
        panic!("cannot start a thread");
    };
    if let Err(error) = pool.install(|| all(&mut Criterion::default().configure_from_args())) {
        panic!("{error}");
    }
    c.final_summary();
}

criterion_group!(benches, updates);
criterion_main!(benches);
