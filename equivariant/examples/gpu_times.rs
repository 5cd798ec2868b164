//! Times of training passes on a GPU: the reference network of docs/performance.md, 64 x 64 x 6
//! pictures through 8, 16, 32 and 32 fields.
//!
//! `cargo run --release -p covers-equivariant --features wgpu --example gpu_times -- [ADAPTER]`
//!
//! A step is a forward and a backward pass over a batch that lies on the device, in one command
//! buffer. Steps are started without waiting for one another, and the wait for the last is counted.

#![allow(clippy::unwrap_used, reason = "an example")]

mod networks;

use std::time::{Duration, Instant};

use equivariant::gpu::{Batch, Device, GpuError, Passes, Plan, Program, adapters};
use equivariant::{Layer, Signature};
use networks::network;
use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};

const BATCHES: [usize; 3] = [64, 512, 4096];
/// How long each batch is measured, at least.
const TIME: Duration = Duration::from_secs(2);

fn main() -> Result<(), GpuError> {
    adapters().iter().for_each(|adapter| println!("{adapter}"));
    let name = std::env::args().nth(1);
    let device = Device::open(name.as_deref())?;
    println!("\n{}\nbatch   kernels   ms a step", device.adapter().name);
    for samples in BATCHES {
        match step(&device, samples) {
            Ok((kernels, time)) => {
                let time = time.as_secs_f64() * 1e3;
                println!("{samples:5}   {kernels:7}   {time:9.3}");
            }
            Err(error) => println!("{samples:5}   {error}"),
        }
    }
    Ok(())
}

/// Kernels and time of a training step.
fn step(device: &Device, samples: usize) -> Result<(usize, Duration), GpuError> {
    let network = network(64, &[8, 16, 32, 32], false).unwrap();
    let mut plan = Plan::new();
    let x = plan.input(network.in_shape());
    let y = plan.layer(&network, x)?;
    let program = Program::new(device, &plan, samples)?;
    let mut params = vec![0.0; network.num_params()];
    network.init(&mut ChaCha8Rng::seed_from_u64(0), &mut params);
    program.write(plan.params(), &plan.placed(&params));
    let picture = (0..samples * x.shape.len()).map(|i| (i % 251) as f32 / 251.0);
    program.write(x.values, &picture.collect::<Vec<f32>>());
    program.write(y.gradient.unwrap(), &vec![1.0; samples * y.shape.len()]);
    let run = |steps: usize| {
        let clock = Instant::now();
        for _ in 0..steps {
            let batch = Batch {
                samples,
                ..Batch::default()
            };
            program.submit(Passes::All, batch);
        }
        program
            .read([(plan.gradient(), 1)])
            .map(|_| clock.elapsed())
    };
    run(1)?;
    let mut steps = 1;
    loop {
        let time = run(steps)?;
        if time >= TIME {
            return Ok((plan.dispatches().iter().sum(), time / steps as u32));
        }
        steps *= 2;
    }
}
