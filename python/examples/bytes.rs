//! Writes the observations and outcomes of a `VecEnv` over an episode's end, byte by byte, for
//! `tests/test_numbers.py`. An optional argument names the extra images, as in settings.

use std::error::Error;
use std::io::{Write, stdout};

use envs::{ACTION_DIM, StepBuffers, TaskGroup, VecEnv, VecEnvSettings};
use symmetry::D2;

const N: usize = 3;
const DECISIONS: usize = 6;

fn main() -> Result<(), Box<dyn Error>> {
    let mut settings = VecEnvSettings { num_envs: N, seed: 7, ..VecEnvSettings::default() };
    settings.camera.size = 16;
    if let Some(beside) = std::env::args().nth(1) {
        settings.camera.extra_views = serde_json::from_value(beside.into())?;
    }
    settings.control.horizon = 40;
    let mut env = VecEnv::new(settings, TaskGroup::DRAWER_CLOSE, &D2::ALL)?;
    let mut batch = StepBuffers::new(&settings);
    env.reset(batch.observations_mut())?;
    show(&batch)?;
    for decision in 0..DECISIONS {
        let action = |i| ((i * 7 + decision * 3) % 5) as f32 / 2.0 - 1.0;
        let actions: Vec<f32> = (0..N * ACTION_DIM).map(action).collect();
        env.step(&actions, batch.step_results_mut())?;
        show(&batch)?;
    }
    Ok(())
}

fn show(batch: &StepBuffers) -> std::io::Result<()> {
    let mut out = stdout().lock();
    out.write_all(&batch.images)?;
    for value in batch.vectors.iter().chain(&batch.rewards) {
        out.write_all(&value.to_le_bytes())?;
    }
    for flags in [&batch.success, &batch.success_at_end, &batch.truncated] {
        out.write_all(&flags.iter().map(|&flag| u8::from(flag)).collect::<Vec<_>>())?;
    }
    Ok(())
}
