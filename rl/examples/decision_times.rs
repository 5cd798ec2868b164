//! Times of decisions for batches of observations, here and on a GPU: the learner's network and
//! 48 x 48 x 6 pictures.
//!
//! `cargo run --release -p covers-rl --features wgpu --example decision_times -- [ADAPTER]`
//!
//! Observations go to the device, 512 at a time, and the outputs of the network come back. The
//! processor has as many threads as rayon gives it (`RAYON_NUM_THREADS`).

use std::time::{Duration, Instant};

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rl::gpu::{Device, adapters};
use rl::{
    ActorCriticPolicy, Decisions, DevicePolicy, EnvSpec, NetworkSettings, Observations, OnPolicy,
    RlError,
};
use symmetry::Irrep;

const BATCHES: [usize; 4] = [10, 64, 512, 4096];
/// Observations on the device at a time, at most.
const AT_A_TIME: usize = 512;
/// How long each batch is measured, at least.
const TIME: Duration = Duration::from_secs(1);

fn main() -> Result<(), RlError> {
    adapters().iter().for_each(|adapter| println!("{adapter}"));
    let name = std::env::args().nth(1);
    let device = Device::open(name.as_deref())?;
    println!("\n{}\nbatch   ms here   ms there", device.adapter().name);
    for batch in BATCHES {
        let spec = spec(batch);
        let mut here = ActorCriticPolicy::new(&NetworkSettings::default(), &spec, 0)?;
        let mut there = DevicePolicy::new(here.clone(), &device, batch.min(AT_A_TIME))?;
        let [here, there] = [time(&mut here, &spec)?, time(&mut there, &spec)?];
        println!("{batch:5}   {here:7.3}   {there:8.3}");
    }
    Ok(())
}

/// What the policies of docs/ppo.md see and do.
fn spec(num_envs: usize) -> EnvSpec {
    let action = vec![Irrep::X, Irrep::Y, Irrep::Trivial, Irrep::Trivial];
    EnvSpec {
        num_envs,
        image: [48, 48, 6],
        vector: action.clone(),
        action,
    }
}

/// Milliseconds of the decisions for a batch.
fn time(policy: &mut impl OnPolicy<Memory = ()>, spec: &EnvSpec) -> Result<f64, RlError> {
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let mut observations = Observations::new(spec);
    observations.images.fill_with(|| rng.random());
    let mut out = Decisions::new(spec);
    let noise = vec![0.0; out.actions.len()];
    policy.decide(&observations, &mut (), &noise, &mut out)?;
    let (clock, mut runs) = (Instant::now(), 0);
    while clock.elapsed() < TIME {
        policy.decide(&observations, &mut (), &noise, &mut out)?;
        runs += 1;
    }
    Ok(1e3 * clock.elapsed().as_secs_f64() / f64::from(runs))
}
