//! Observations that an exported policy is tried on.

use envs::{ACTION_DIM, TaskGroup, TaskRegistry, VecEnvSettings};
use rl::{Observations, Transition, VectorEnv};
use symmetry::D2;

use experiments::{Experiment, RunError, Stream};

/// Environments of each group.
const ENVS: usize = 2;
/// Decisions before the observation is taken, so that pictures differ from the first ones.
const DECISIONS: usize = 8;

/// Two observations of each group of a run, some decisions after the start.
///
/// # Errors
/// What the environments say.
pub(super) fn observations(run: &Experiment) -> Result<Observations, RunError> {
    let groups = run.schedule.resolve(&TaskRegistry::standard())?;
    let settings = VecEnvSettings { num_envs: ENVS, threads: 1, ..run.envs.clean() };
    let mut stream = Stream::new(settings, &groups)?;
    let mut all = Observations { images: Vec::new(), vectors: Vec::new() };
    for group in groups {
        let seen = after_a_while(&mut stream, group)?;
        all.images.extend(seen.images);
        all.vectors.extend(seen.vectors);
    }
    Ok(all)
}

fn after_a_while(stream: &mut Stream, group: TaskGroup) -> Result<Observations, RunError> {
    let environment = |source| RunError::from(rl::RlError::Environment(source));
    stream.switch_to(group, &D2::ALL)?;
    let mut transition = Transition::new(stream.spec());
    stream.reset(&mut transition.observations).map_err(environment)?;
    let action = |index: usize| (index as f32).sin();
    let actions: Vec<f32> = (1..=ENVS * ACTION_DIM).map(action).collect();
    for _ in 0..DECISIONS {
        stream.step(&actions, &mut transition).map_err(environment)?;
    }
    Ok(transition.observations)
}
