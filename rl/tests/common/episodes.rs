//! Steps of environments whose every observation, action and reward is another, for replays.

use rl::{EnvSpec, Observations, ReplayBuffer, ReplaySettings, RlError, StepOutcome, Transition};
use symmetry::Irrep;

/// Channels that stand still, of three.
pub const STILL: usize = 1;
const PIXELS: usize = 6;

pub fn spec(envs: usize) -> EnvSpec {
    EnvSpec {
        num_envs: envs,
        image_shape: [2, 3, 3],
        vector_irreps: vec![Irrep::X, Irrep::Trivial],
        action_irreps: vec![Irrep::X, Irrep::Y],
        choices: vec![],
    }
}

pub fn settings(capacity: usize) -> ReplaySettings {
    ReplaySettings { capacity, still_channels: STILL, warm_up: 0, ..ReplaySettings::default() }
}

/// An observation, identified by its environment, episode and position.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Seen {
    pub env: usize,
    pub episode: usize,
    pub at: usize,
}

impl Seen {
    pub fn image(self) -> Vec<u8> {
        let Seen { env, episode, at } = self;
        let pixel = |i: usize| [i + at, env + 3 * at, episode + 7 * env].map(|x| x as u8);
        (0..PIXELS).flat_map(pixel).collect()
    }

    pub fn vector(self) -> [f32; 2] {
        [self.at as f32, (self.episode * 10 + self.env) as f32]
    }

    pub fn action(self) -> [f32; 2] {
        [0.5 * self.at as f32, -(self.episode as f32)]
    }

    pub fn reward(self) -> f32 {
        (self.at * self.at + self.env) as f32
    }

    fn after(self) -> Self {
        Self { at: self.at + 1, ..self }
    }

    fn write(self, out: &mut Observations) {
        let image = self.image();
        out.images[self.env * image.len()..][..image.len()].copy_from_slice(&image);
        out.vectors[2 * self.env..2 * self.env + 2].copy_from_slice(&self.vector());
    }
}

/// A step as it was taken.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Step {
    pub seen: Seen,
    pub outcome: StepOutcome,
}

impl Step {
    pub fn next(&self) -> Seen {
        self.seen.after()
    }
}

/// Environments whose episodes last `lengths[n]` steps, with a termination and a time-out by turns.
#[derive(Clone)]
pub struct Episodes {
    lengths: Vec<usize>,
    pub seen: Vec<Seen>,
}

impl Episodes {
    pub fn new(lengths: &[usize]) -> Self {
        let seen = (0..lengths.len()).map(|env| Seen { env, episode: 0, at: 0 });
        Self { lengths: lengths.to_vec(), seen: seen.collect() }
    }

    /// Begins another episode everywhere, as a reset does.
    pub fn reset(&mut self) {
        for seen in &mut self.seen {
            (seen.episode, seen.at) = (seen.episode + 1, 0);
        }
    }

    /// The arrays of the next step of all environments, and the steps themselves.
    pub fn step(&mut self) -> (Observations, Vec<f32>, Transition, Vec<Step>) {
        let spec = spec(self.lengths.len());
        let (mut now, mut transition) = (Observations::new(&spec), Transition::new(&spec));
        let mut steps = Vec::new();
        for seen in &mut self.seen {
            let n = seen.env;
            seen.write(&mut now);
            transition.rewards[n] = seen.reward();
            if seen.at + 1 == self.lengths[n] {
                let ends = [StepOutcome::Terminated, StepOutcome::Truncated];
                transition.outcomes[n] = ends[seen.episode % 2];
            }
            let outcome = transition.outcomes[n];
            steps.push(Step { seen: *seen, outcome });
            *seen = seen.after();
            seen.write(&mut transition.final_observations);
            if outcome.is_ended() {
                (seen.episode, seen.at) = (seen.episode + 1, 0);
            }
            seen.write(&mut transition.observations);
        }
        let actions = steps.iter().flat_map(|step| step.seen.action());
        (now, actions.collect(), transition, steps)
    }

    /// Records the next step; returns what was recorded.
    pub fn record(&mut self, replay: &mut ReplayBuffer) -> Result<Vec<Step>, RlError> {
        let (now, actions, transition, steps) = self.step();
        replay.push(&now, &actions, &transition)?;
        Ok(steps)
    }
}
