//! An algorithm that learns from a replay: it fits `Algorithm`, and `collect` fills its replay.

#![allow(clippy::unwrap_used, reason = "helpers of tests fail like tests")]

#[path = "common/constant.rs"]
mod constant;

use constant::Constant;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rl::{
    Actor, Algorithm, AlgorithmState, BoxError, EnvSpec, Experience, Metrics, Observations,
    Outcome, RlError, RolloutState, Transition, Values, VectorEnv, collect,
};
use symmetry::Irrep;

const PLACES: usize = 4;
const GAMMA: f32 = 0.5;
/// By hand: the last place pays 1 and ends the episode, the others pay nothing and lead on.
const TRUTH: [f32; PLACES] = [0.125, 0.25, 0.5, 1.0];

/// Walks through the places, whatever the actions are; environment n starts at place n.
struct Walk {
    spec: EnvSpec,
    places: Vec<usize>,
}

impl Walk {
    fn new() -> Self {
        Self {
            spec: EnvSpec {
                num_envs: 2,
                image: [2, 3, 1],
                vector: vec![Irrep::Trivial; PLACES],
                action: vec![Irrep::Trivial],
            },
            places: vec![0, 1],
        }
    }

    fn observe(&self, out: &mut Observations) {
        out.vectors.fill(0.0);
        for (row, &place) in out.vectors.chunks_mut(PLACES).zip(&self.places) {
            row[place] = 1.0;
        }
    }
}

impl VectorEnv for Walk {
    fn spec(&self) -> &EnvSpec {
        &self.spec
    }

    fn reset(&mut self, out: &mut Observations) -> Result<(), BoxError> {
        self.places = vec![0, 1];
        self.observe(out);
        Ok(())
    }

    fn step(&mut self, _: &[f32], out: &mut Transition) -> Result<(), BoxError> {
        *out = Transition::new(&self.spec);
        for (n, place) in self.places.iter_mut().enumerate() {
            *place += 1;
            if *place == PLACES {
                (out.rewards[n], out.outcomes[n]) = (1.0, Outcome::Terminated);
                *place = 0;
            }
        }
        self.observe(&mut out.observations);
        Ok(())
    }
}

/// Stands still and values a place by a weight of its own.
type Weights = Constant<Vec<f32>>;

fn no_weights() -> Weights {
    Constant(0.0, vec![0.0; PLACES])
}

impl Values for Weights {
    fn values(&mut self, observations: &Observations, out: &mut [f32]) -> Result<(), RlError> {
        for (value, vector) in out.iter_mut().zip(observations.vectors.chunks(PLACES)) {
            *value = dot(&self.1, vector);
        }
        Ok(())
    }
}

fn dot(a: &[f32], b: &[f32]) -> f32 {
    a.iter().zip(b).map(|(a, b)| a * b).sum()
}

/// What one environment met in one step; `next` is none after a termination.
struct Step {
    vector: Vec<f32>,
    reward: f32,
    next: Option<Vec<f32>>,
}

/// A ring of the latest steps.
struct Replay {
    steps: Vec<Step>,
    capacity: usize,
    next: usize,
    actions: Vec<f32>,
}

impl Replay {
    fn new(capacity: usize) -> Self {
        Self {
            steps: Vec::new(),
            capacity,
            next: 0,
            actions: Vec::new(),
        }
    }

    fn push(&mut self, step: Step) {
        if self.steps.len() < self.capacity {
            self.steps.push(step);
        } else {
            self.steps[self.next] = step;
        }
        self.next = (self.next + 1) % self.capacity;
    }
}

impl<A: Actor> Experience<A> for Replay {
    fn steps(&self) -> usize {
        3
    }

    fn begin(&mut self, spec: &EnvSpec) -> Result<(), RlError> {
        self.actions.resize(spec.num_envs * spec.action.len(), 0.0);
        Ok(())
    }

    fn decide(
        &mut self,
        actor: &mut A,
        observations: &Observations,
        memory: &mut A::Memory,
        rng: &mut ChaCha8Rng,
    ) -> Result<&[f32], RlError> {
        actor.act(observations, memory, rng, &mut self.actions)?;
        Ok(&self.actions)
    }

    fn record(
        &mut self,
        _: &mut A,
        observations: &Observations,
        transition: &Transition,
    ) -> Result<(), RlError> {
        let row = |from: &Observations, n: usize| from.vectors[n * PLACES..][..PLACES].to_vec();
        for (n, outcome) in transition.outcomes.iter().enumerate() {
            self.push(Step {
                vector: row(observations, n),
                reward: transition.rewards[n],
                next: match outcome {
                    Outcome::Running => Some(row(&transition.observations, n)),
                    Outcome::Terminated => None,
                    Outcome::Truncated => Some(row(&transition.final_observations, n)),
                },
            });
        }
        Ok(())
    }

    fn end(&mut self, _: &mut A, _: &Observations) -> Result<(), RlError> {
        Ok(())
    }
}

/// Regression of values on one-step targets, by gradient descent with momentum.
struct Regression {
    velocity: Vec<f32>,
    steps: u64,
}

/// Mean squared error of a minibatch.
struct RegressionStats(f64);

impl Metrics for RegressionStats {
    fn metrics(&self) -> Vec<(String, f64)> {
        vec![("value_loss".to_owned(), self.0)]
    }
}

impl Algorithm for Regression {
    type Policy = Weights;
    type Experience = Replay;
    type Stats = RegressionStats;

    fn update(
        &mut self,
        policy: &mut Weights,
        replay: &Replay,
        rng: &mut ChaCha8Rng,
    ) -> Result<RegressionStats, RlError> {
        let mut loss = 0.0;
        for _ in 0..8 {
            let step = &replay.steps[rng.random_range(0..replay.steps.len())];
            let next = step.next.as_ref().map_or(0.0, |v| dot(&policy.1, v));
            let error = dot(&policy.1, &step.vector) - step.reward - GAMMA * next;
            let weights = policy.1.iter_mut().zip(&mut self.velocity);
            for ((w, v), x) in weights.zip(&step.vector) {
                *v = 0.5 * *v + error * x;
                *w -= 0.1 * *v;
            }
            loss += f64::from(error).powi(2) / 8.0;
        }
        self.steps += 1;
        Ok(RegressionStats(loss))
    }

    fn save(&self) -> AlgorithmState<'_> {
        AlgorithmState {
            tensors: vec![("velocity", &self.velocity)],
            counters: vec![("steps", self.steps)],
        }
    }

    fn restore(&mut self, state: &AlgorithmState<'_>) -> Result<(), RlError> {
        state.check_like(&self.save())?;
        self.velocity.copy_from_slice(state.tensors[0].1);
        self.steps = state.counters[0].1;
        Ok(())
    }
}

fn regression() -> Regression {
    Regression {
        velocity: vec![0.0; PLACES],
        steps: 0,
    }
}

/// Collects and updates in turn, for any algorithm, as a learner that knows the traits alone does;
/// returns the last update's first metric.
fn learn<A: Algorithm>(
    algorithm: &mut A,
    policy: &mut A::Policy,
    experience: &mut A::Experience,
    turns: usize,
) -> f64
where
    A::Policy: Actor,
    A::Experience: Experience<A::Policy>,
{
    let mut env = Walk::new();
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let mut state = RolloutState::reset(&mut env, policy).unwrap();
    let mut last = f64::NAN;
    for _ in 0..turns {
        collect(&mut env, policy, experience, &mut state, &mut rng).unwrap();
        let stats = algorithm.update(policy, experience, &mut rng).unwrap();
        last = stats.metrics()[0].1;
    }
    last
}

#[test]
fn values_are_learnt_from_a_replay() {
    let (mut policy, mut replay) = (no_weights(), Replay::new(40));
    let loss = learn(&mut regression(), &mut policy, &mut replay, 300);
    assert_eq!(
        replay.steps.len(),
        40,
        "the ring is full and grows no further"
    );
    for (weight, truth) in policy.1.iter().zip(TRUTH) {
        assert!((weight - truth).abs() < 1e-3, "{policy:?}");
    }
    assert!(loss < 1e-6, "{loss}");
}

#[test]
fn a_saved_state_goes_on_alike_and_another_one_is_refused() {
    let (mut policy, mut replay) = (no_weights(), Replay::new(40));
    let mut algorithm = regression();
    learn(&mut algorithm, &mut policy, &mut replay, 20);
    let (mut twin_policy, mut twin) = (policy.clone(), regression());
    twin.restore(&algorithm.save()).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(6);
    algorithm
        .update(&mut policy, &replay, &mut rng.clone())
        .unwrap();
    twin.update(&mut twin_policy, &replay, &mut rng).unwrap();
    assert_eq!(policy, twin_policy);
    let other = Regression {
        velocity: vec![0.0; 3],
        steps: 0,
    };
    let message = twin.restore(&other.save()).unwrap_err().to_string();
    let expected = r#"holds: "velocity" [3], "steps"; expected: "velocity" [4], "steps""#;
    assert!(message.contains(expected), "{message}");
}
