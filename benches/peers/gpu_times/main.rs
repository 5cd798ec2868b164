//! Times a GPU on request, for `benches/peers/gpu.py`: reads lines of words and answers each with
//! one line, a number or, for `adapter` and `kernels`, text. A line that begins with `error` gives
//! the reason why something cannot be measured.
//!
//! - `adapter`: the name of the adapter.
//! - `<network> training <batch>` and `<network> decisions <batch>`: milliseconds of a forward and
//!   a backward pass, or of a forward pass alone, over a batch that lies on the device.
//! - `<network> kernels <batch>`: a name and microseconds for each kernel of a training pass.
//! - `update <width> gpu` and `update <width> <threads>`: milliseconds of a PPO update on the GPU
//!   or on the CPU; `width` is 1 for the presets' network, 1000 decisions and minibatches of
//!   64, and 4 for four times as many fields, decisions and samples of a minibatch.
//! - `decide <batch> gpu` and `decide <batch> <threads>`: milliseconds of decisions for a batch of
//!   observations, which go to the device and come back.
//!
//! The first argument is a part of the adapter's name. Networks are those of
//! `benches/peers/layer_times.rs`. Passes start without waiting for one another, and the wait
//! for the last is counted.

#[path = "../networks.rs"]
mod networks;
#[path = "../../noise.rs"]
mod noise;
mod passes;
mod policies;

use std::error::Error;
use std::io::{BufRead, Write, stdin, stdout};
use std::time::{Duration, Instant};

use equivariant::gpu::GpuDevice;

/// Least time of one measurement.
const TIME: Duration = Duration::from_millis(400);

fn main() -> Result<(), Box<dyn Error>> {
    let device = GpuDevice::open(std::env::args().nth(1).as_deref())?;
    for line in stdin().lock().lines() {
        let answer = answer(&device, &line?).unwrap_or_else(|error| format!("error {error}"));
        writeln!(stdout(), "{}", answer.replace('\n', " "))?;
        stdout().flush()?;
    }
    Ok(())
}

fn answer(device: &GpuDevice, line: &str) -> Result<String, Box<dyn Error>> {
    let words: Vec<&str> = line.split_whitespace().collect();
    let milliseconds = match words[..] {
        ["adapter"] => return Ok(device.adapter().to_string()),
        [network, "kernels", batch] => {
            return passes::kernel_times(device, network, batch.parse()?);
        }
        ["update", width, place] => policies::time_ppo_update_ms(device, width.parse()?, place)?,
        ["decide", batch, place] => policies::time_decisions_ms(device, batch.parse()?, place)?,
        [network, task, batch] => {
            passes::time_network_pass_ms(device, network, task, batch.parse()?)?
        }
        _ => return Err(format!("got the request `{line}`").into()),
    };
    Ok(milliseconds.to_string())
}

/// Returns the mean milliseconds of a run, over enough runs to take [`TIME`].
fn milliseconds(
    mut run: impl FnMut(u32) -> Result<(), Box<dyn Error>>,
) -> Result<f64, Box<dyn Error>> {
    run(1)?;
    let mut runs = 1;
    loop {
        let clock = Instant::now();
        run(runs)?;
        let time = clock.elapsed();
        if time >= TIME {
            return Ok(1e3 * time.as_secs_f64() / f64::from(runs));
        }
        runs *= 2;
    }
}
