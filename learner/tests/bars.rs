//! A toy environment whose hidden group changes, and what learners do in it.

use learner::{Iteration, Learner, Metric};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rl::{
    CriticSettings, EncoderSettings, EnvSpec, NetworkSettings, Observations, StepOutcome,
    Transition, VectorEnv,
};
use symmetry::{D2, Irrep};

const SIZE: usize = 8;
/// Decisions an episode lasts.
pub const HORIZON: usize = 5;

/// Pictures of one bright bar, standing (group 0) or lying (group 1), at a random mirrored place;
/// the reward is the first action.
#[derive(Clone)]
pub struct Bars {
    pub spec: EnvSpec,
    pub group: usize,
    time: usize,
    rng: ChaCha8Rng,
    /// Whether the time limit is told.
    pub limited: bool,
}

impl Bars {
    pub fn new() -> Self {
        Self {
            spec: EnvSpec {
                num_envs: 10,
                image_shape: [SIZE, SIZE, 1],
                vector_irreps: vec![Irrep::X, Irrep::Y],
                action_irreps: vec![Irrep::Trivial],
            },
            group: 0,
            time: 0,
            rng: ChaCha8Rng::seed_from_u64(1),
            limited: false,
        }
    }

    /// Environments with vectors alone, and with pictures alone.
    pub fn half_blind() -> [Self; 2] {
        let [mut vectors, mut pictures] = [Self::new(), Self::new()];
        vectors.spec.image_shape = EnvSpec::NO_IMAGE;
        pictures.spec.vector_irreps.clear();
        [vectors, pictures]
    }

    /// Lets `learner` take a turn in each of these groups.
    pub fn teach(&mut self, learner: &mut dyn Learner, groups: &[usize]) -> Vec<Iteration> {
        let turns = groups.iter().map(|&group| {
            self.group = group;
            learner.learn(self).unwrap()
        });
        turns.collect()
    }

    /// The policies that `learner` finds for the two groups.
    pub fn recognised(&mut self, learner: &mut dyn Learner) -> [usize; 2] {
        [0, 1].map(|group| {
            self.group = group;
            let mut rng = ChaCha8Rng::seed_from_u64(9);
            let recognised = learner.recognise_policy(self, None, &mut rng).unwrap();
            assert!(recognised.fits);
            recognised.policy
        })
    }

    fn draw(&mut self, out: &mut Observations) {
        let [image, vector] =
            [self.spec.image_shape.iter().product(), self.spec.vector_irreps.len()];
        for i in 0..self.spec.num_envs {
            let mut bar: Vec<u8> = (0..SIZE * SIZE).map(|_| self.rng.random_range(0..40)).collect();
            for offset in 0..3 {
                let (row, column) = if self.group == 0 { (offset, 1) } else { (1, offset) };
                bar[row * SIZE + column] = 250;
            }
            let element = D2::ALL[self.rng.random_range(0..4)];
            let drawn = element.transform_image(&bar, SIZE, SIZE, 1);
            out.images[i * image..][..image].copy_from_slice(&drawn[..image]);
            out.vectors[i * vector..][..vector].fill_with(|| self.rng.random_range(-0.1..0.1));
        }
    }
}

/// A small network for such pictures.
pub fn network(critic: CriticSettings) -> NetworkSettings {
    NetworkSettings {
        encoder: EncoderSettings::Strided { fields: vec![4, 8] },
        top_fields: 8,
        vector_fields: 4,
        actor_fields: 4,
        critic,
        ..NetworkSettings::default()
    }
}

/// A metric of a turn that is one number.
pub fn number(turn: &Iteration, name: &str) -> f64 {
    match turn.metrics.get(name) {
        Some(Metric::Number(value)) => *value,
        other => panic!("{name} is {other:?}"),
    }
}

impl VectorEnv for Bars {
    fn spec(&self) -> &EnvSpec {
        &self.spec
    }

    fn horizon(&self) -> Option<usize> {
        self.limited.then_some(HORIZON)
    }

    fn reset(&mut self, out: &mut Observations) -> Result<(), rl::BoxedEnvError> {
        self.time = 0;
        self.draw(out);
        Ok(())
    }

    fn step(&mut self, actions: &[f32], out: &mut Transition) -> Result<(), rl::BoxedEnvError> {
        self.time += 1;
        out.rewards.copy_from_slice(actions);
        self.draw(&mut out.observations);
        let ended = self.time.is_multiple_of(HORIZON);
        if ended {
            self.draw(&mut out.final_observations);
        }
        let outcome = [StepOutcome::Running, StepOutcome::Truncated][usize::from(ended)];
        out.outcomes.fill(outcome);
        Ok(())
    }
}
