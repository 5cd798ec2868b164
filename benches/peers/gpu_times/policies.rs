//! Times of updates and decisions of policies, on a device and on the CPU.

use std::error::Error;

use equivariant::gpu::GpuDevice;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rl::{
    ActorCriticPolicy, Algorithm, Decisions, EncoderSettings, EnvSpec, GpuPolicy, NetworkSettings,
    Observations, OnPolicyActor, Ppo, PpoSettings, RlError, RolloutBuffer, RolloutState,
    collect_experience,
};

use crate::milliseconds;
use crate::noise::{HORIZON, RandomEnv, random_env_spec};

/// Largest number of observations on the device at a time.
const AT_A_TIME: usize = 512;

/// Returns the mean milliseconds of a PPO update on the GPU or on `place` CPU threads, with a
/// network, rollout and minibatches `width` times as large as the presets'.
pub fn time_ppo_update_ms(
    device: &GpuDevice,
    width: usize,
    place: &str,
) -> Result<f64, Box<dyn Error>> {
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let mut env = RandomEnv::new();
    let mut policy = ActorCriticPolicy::new(&wide(width), &random_env_spec(), 0)?;
    let mut buffer = RolloutBuffer::new(&random_env_spec(), width * HORIZON)?;
    let mut state = RolloutState::from_env_reset(&mut env, &policy)?;
    collect_experience(&mut env, &mut policy, &mut buffer, &mut state, &mut rng)?;
    let defaults = PpoSettings::default();
    let settings = PpoSettings {
        minibatch: width * defaults.minibatch,
        // no limit on the divergence, so that every update runs all of its epochs
        max_kl: 1e9,
        ..defaults
    };
    let mut ppo = match place {
        "gpu" => Ppo::on_device(settings, &policy, device)?,
        _ => Ppo::new(settings, &policy)?,
    };
    let mut run = move || {
        milliseconds(|runs| {
            for _ in 0..runs {
                ppo.update(&mut policy, &buffer, &mut rng)?;
            }
            Ok(())
        })
        .map_err(|error| error.to_string())
    };
    on(place, &mut run)
}

/// Returns the mean milliseconds in which a policy decides on `num_envs` observations, on the GPU
/// or on `place` CPU threads.
pub fn time_decisions_ms(
    device: &GpuDevice,
    num_envs: usize,
    place: &str,
) -> Result<f64, Box<dyn Error>> {
    let spec = EnvSpec { num_envs, ..random_env_spec() };
    let mut policy = ActorCriticPolicy::new(&NetworkSettings::default(), &spec, 0)?;
    if place == "gpu" {
        let mut there = GpuPolicy::new(policy, device, num_envs.min(AT_A_TIME))?;
        return decisions(&mut there, &spec);
    }
    on(place, &mut || decisions(&mut policy, &spec).map_err(|error| error.to_string()))
}

fn decisions(
    policy: &mut impl OnPolicyActor<Memory = ()>,
    spec: &EnvSpec,
) -> Result<f64, Box<dyn Error>> {
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let mut observations = Observations::new(spec);
    observations.images.fill_with(|| rng.random());
    let mut out = Decisions::new(spec);
    let noise = vec![0.0; out.actions.len()];
    milliseconds(|runs| {
        let mut runs = 0..runs;
        let all: Result<(), RlError> =
            runs.try_for_each(|_| policy.decide(&observations, &mut (), &noise, &mut out));
        Ok(all?)
    })
}

/// Runs on a number of threads, `place`, or on one thread for a GPU.
fn on(
    place: &str,
    run: &mut (dyn FnMut() -> Result<f64, String> + Send),
) -> Result<f64, Box<dyn Error>> {
    let threads = if place == "gpu" { 1 } else { place.parse()? };
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build()?;
    Ok(pool.install(run)?)
}

/// Returns the presets' network with `width` times as many fields.
fn wide(width: usize) -> NetworkSettings {
    let defaults = NetworkSettings::default();
    let encoder = match &defaults.encoder {
        EncoderSettings::Strided { fields } => {
            EncoderSettings::Strided { fields: fields.iter().map(|n| width * n).collect() }
        }
        other => other.clone(),
    };
    NetworkSettings {
        encoder,
        top_fields: width * defaults.top_fields,
        vector_fields: width * defaults.vector_fields,
        actor_fields: width * defaults.actor_fields,
        ..defaults
    }
}
