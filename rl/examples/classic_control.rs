//! CartPole and Pendulum, environments of one's own that PPO trains in: a discrete action with
//! terminations, and a continuous one.
//!
//! ```sh
//! cargo run --release -p covers-rl --example classic_control cart-pole 0
//! ```
//!
//! `benches/peers/classic_control.py` compares it with Stable-Baselines3.

use std::collections::VecDeque;
use std::f32::consts::PI;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rl::{
    ActorCriticPolicy, Algorithm, BoxedEnvError, EncoderSettings, EnvSpec, LearningRateSchedule,
    NetworkSettings, Observations, Ppo, PpoSettings, RolloutBuffer, RolloutState, StepOutcome,
    Transition, VectorEnv, collect_experience,
};
use symmetry::Irrep;

/// Physics of one task with a state of K numbers, as in Gymnasium 1.4.
trait Physics<const K: usize> {
    /// Largest magnitudes of the first state's numbers.
    const START: [f32; K];
    /// Number of steps of the longest episode.
    const HORIZON: usize;

    fn spec(num_envs: usize) -> EnvSpec;

    fn observe(state: &[f32; K]) -> Vec<f32>;

    /// Advances `state`; returns the reward, and `true` if the task ends the episode.
    fn step(state: &mut [f32; K], action: &[f32]) -> (f32, bool);
}

/// Pole on a cart that is pushed to the left or to the right (Barto, Sutton and Anderson, 1983):
/// position and velocity of the cart, angle and angular velocity of the pole.
struct CartPole;

impl Physics<4> for CartPole {
    const START: [f32; 4] = [0.05; 4];
    const HORIZON: usize = 500;

    fn spec(num_envs: usize) -> EnvSpec {
        EnvSpec {
            num_envs,
            image_shape: EnvSpec::NO_IMAGE,
            vector_irreps: vec![Irrep::X; 4],
            // a flip of x exchanges the two choices
            action_irreps: vec![Irrep::Trivial, Irrep::X],
            choices: vec![2],
        }
    }

    fn observe(state: &[f32; 4]) -> Vec<f32> {
        state.to_vec()
    }

    fn step(state: &mut [f32; 4], action: &[f32]) -> (f32, bool) {
        const POLE_MASS: f32 = 0.1;
        const MASS: f32 = 1.0 + POLE_MASS;
        const HALF_LENGTH: f32 = 0.5;
        let [_, v, angle, rate] = *state;
        let force = if action[1] == 1.0 { 10.0 } else { -10.0 };
        let (sin, cos) = angle.sin_cos();
        let push = (force + POLE_MASS * HALF_LENGTH * rate * rate * sin) / MASS;
        let angular =
            (9.8 * sin - cos * push) / (HALF_LENGTH * (4.0 / 3.0 - POLE_MASS * cos * cos / MASS));
        let linear = push - POLE_MASS * HALF_LENGTH * angular * cos / MASS;
        let change = [v, linear, rate, angular];
        state.iter_mut().zip(change).for_each(|(s, d)| *s += 0.02 * d);
        (1.0, state[0].abs() > 2.4 || state[2].abs() > 12.0 / 180.0 * PI)
    }
}

/// Pendulum that a small torque swings up: angle from the top and angular velocity.
struct Pendulum;

impl Physics<2> for Pendulum {
    const START: [f32; 2] = [PI, 1.0];
    const HORIZON: usize = 200;

    fn spec(num_envs: usize) -> EnvSpec {
        EnvSpec {
            num_envs,
            image_shape: EnvSpec::NO_IMAGE,
            vector_irreps: vec![Irrep::Trivial, Irrep::X, Irrep::X],
            action_irreps: vec![Irrep::X],
            choices: vec![],
        }
    }

    fn observe(&[angle, rate]: &[f32; 2]) -> Vec<f32> {
        vec![angle.cos(), angle.sin(), rate]
    }

    fn step(state: &mut [f32; 2], action: &[f32]) -> (f32, bool) {
        let ([angle, rate], torque) = (*state, action[0].clamp(-2.0, 2.0));
        let off = (angle + PI).rem_euclid(2.0 * PI) - PI;
        let cost = off * off + 0.1 * rate * rate + 0.001 * torque * torque;
        state[1] = (rate + 0.05 * (15.0 * angle.sin() + 3.0 * torque)).clamp(-8.0, 8.0);
        state[0] = angle + 0.05 * state[1];
        (-cost, false)
    }
}

/// Environments of one task that step together.
struct Envs<P, const K: usize> {
    spec: EnvSpec,
    states: Vec<([f32; K], usize)>,
    rng: ChaCha8Rng,
    physics: std::marker::PhantomData<P>,
}

impl<P: Physics<K>, const K: usize> Envs<P, K> {
    fn new(num_envs: usize, seed: u64) -> Self {
        Self {
            spec: P::spec(num_envs),
            states: vec![([0.0; K], 0); num_envs],
            rng: ChaCha8Rng::seed_from_u64(seed),
            physics: std::marker::PhantomData,
        }
    }

    fn restart(&mut self, n: usize) {
        self.states[n] = (P::START.map(|bound| self.rng.random_range(-bound..bound)), 0);
    }

    fn write(&self, n: usize, out: &mut Observations) {
        let vector = P::observe(&self.states[n].0);
        out.vectors[n * vector.len()..(n + 1) * vector.len()].copy_from_slice(&vector);
    }
}

impl<P: Physics<K>, const K: usize> VectorEnv for Envs<P, K> {
    fn spec(&self) -> &EnvSpec {
        &self.spec
    }

    fn horizon(&self) -> Option<usize> {
        Some(P::HORIZON)
    }

    fn reset(&mut self, out: &mut Observations) -> Result<(), BoxedEnvError> {
        for n in 0..self.states.len() {
            self.restart(n);
            self.write(n, out);
        }
        Ok(())
    }

    fn step(&mut self, actions: &[f32], out: &mut Transition) -> Result<(), BoxedEnvError> {
        out.success.fill(false);
        out.success_at_end.fill(false);
        for (n, action) in actions.chunks(self.spec.action_irreps.len()).enumerate() {
            let (state, age) = &mut self.states[n];
            let (reward, over) = P::step(state, action);
            *age += 1;
            out.rewards[n] = reward;
            out.outcomes[n] = if over {
                StepOutcome::Terminated
            } else if *age == P::HORIZON {
                StepOutcome::Truncated
            } else {
                StepOutcome::Running
            };
            if out.outcomes[n].is_ended() {
                self.write(n, &mut out.final_observations);
                self.restart(n);
            }
            self.write(n, &mut out.observations);
        }
        Ok(())
    }
}

/// Number of decisions after which training ends.
const MAX_DECISIONS: usize = 200_000;

/// Trains in `envs` with rollouts of `steps` steps; returns the number of decisions after which the
/// last 100 episodes returned `solved` on average.
fn train(
    mut envs: impl VectorEnv,
    settings: PpoSettings,
    steps: usize,
    solved: f64,
    seed: u64,
) -> Result<Option<usize>, Box<dyn std::error::Error>> {
    let network =
        NetworkSettings { encoder: EncoderSettings::Blind, log_std: 0.0, ..Default::default() };
    let mut policy = ActorCriticPolicy::new(&network, envs.spec(), seed)?;
    let mut ppo = Ppo::new(settings, &policy)?;
    let mut buffer = RolloutBuffer::new(envs.spec(), steps)?;
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut state = RolloutState::from_env_reset(&mut envs, &policy)?;
    let (mut decisions, mut returns) = (0, VecDeque::new());
    while decisions < MAX_DECISIONS {
        let rollout =
            collect_experience(&mut envs, &mut policy, &mut buffer, &mut state, &mut rng)?;
        ppo.update(&mut policy, &buffer, &mut rng)?;
        decisions += rollout.decisions;
        returns.extend(rollout.episodes.iter().map(|episode| episode.total_reward));
        returns.drain(..returns.len().saturating_sub(100));
        let mean = returns.iter().sum::<f64>() / returns.len().max(1) as f64;
        if returns.len() == 100 && mean >= solved {
            return Ok(Some(decisions));
        }
    }
    Ok(None)
}

fn main() -> Result<(), Box<dyn std::error::Error>> {
    let usage = "usage: classic_control cart-pole|pendulum SEED";
    let args: Vec<String> = std::env::args().skip(1).collect();
    let [task, seed] = &args[..] else { return Err(usage.into()) };
    let seed = seed.parse()?;
    // as in benches/peers/classic_control.py; no divergence ends an update there
    let settings = PpoSettings {
        entropy_weight: 0.0,
        value_weight: 0.5,
        max_kl: f32::MAX,
        head_learning_rate: 1e-3,
        ..PpoSettings::default()
    };
    let decisions = match task.as_str() {
        "cart-pole" => {
            let (gamma, lambda, epochs, minibatch) = (0.98, 0.8, 20, 256);
            // one gradient step for each pass over a rollout of 256 decisions
            let schedule =
                LearningRateSchedule::Linear { steps: (MAX_DECISIONS / minibatch * epochs) as u64 };
            let settings = PpoSettings { gamma, lambda, epochs, minibatch, schedule, ..settings };
            train(Envs::<CartPole, 4>::new(8, seed), settings, 32, 475.0, seed)?
        }
        "pendulum" => {
            let settings = PpoSettings { gamma: 0.9, lambda: 0.95, epochs: 10, ..settings };
            train(Envs::<Pendulum, 2>::new(4, seed), settings, 1024, -200.0, seed)?
        }
        _ => return Err(usage.into()),
    };
    match decisions {
        Some(decisions) => println!("{decisions}"),
        None => println!("not within {MAX_DECISIONS} decisions"),
    }
    Ok(())
}
