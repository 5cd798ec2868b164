//! A toy environment whose hidden group changes, and what learners do in it.

use learner::{
    CheckpointExtent, CoversSettings, IterationReport, Learner, LearnerError, MetricValue,
    PolicyCollection, PolicyCollectionSettings,
};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rl::{
    CriticSettings, EncoderSettings, EnvSpec, NetworkSettings, Observations, PpoSettings,
    StepOutcome, Transition, VectorEnv,
};
use symmetry::{D2, Irrep};

const SIZE: usize = 8;
/// Decisions an episode lasts.
pub const HORIZON: usize = 5;

/// Images of one bright bar, standing (group 0) or lying (group 1), at a random mirrored place; the
/// reward is the first action.
#[derive(Clone)]
pub struct Bars {
    pub spec: EnvSpec,
    pub group: usize,
    time: usize,
    rng: ChaCha8Rng,
    /// `true` if learners know the horizon.
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
                choices: vec![],
            },
            group: 0,
            time: 0,
            rng: ChaCha8Rng::seed_from_u64(1),
            limited: false,
        }
    }

    /// Environments with vectors alone, and with images alone.
    pub fn half_blind() -> [Self; 2] {
        let [mut vectors, mut images] = [Self::new(), Self::new()];
        vectors.spec.image_shape = EnvSpec::NO_IMAGE;
        images.spec.vector_irreps.clear();
        [vectors, images]
    }

    /// Lets `learner` train for one iteration in each of these groups.
    pub fn train(&mut self, learner: &mut dyn Learner, groups: &[usize]) -> Vec<IterationReport> {
        let iterations = groups.iter().map(|&group| {
            self.group = group;
            learner.learn(self).unwrap()
        });
        iterations.collect()
    }

    /// The policy that `learner` recognises for a group, the same two times.
    pub fn recognised(
        &mut self,
        learner: &mut dyn Learner,
        group: usize,
        episodes: Option<usize>,
    ) -> Option<usize> {
        self.group = group;
        let [first, second] = [0; 2].map(|_| {
            let mut rng = ChaCha8Rng::seed_from_u64(9);
            let recognised = learner.recognise_policy(&mut self.clone(), episodes, &mut rng);
            recognised.unwrap().accepted_policy()
        });
        assert_eq!(first, second);
        first
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

/// A small network for such images.
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

/// COVERS with such a network, and rollouts of two episodes in each of ten environments.
pub fn covers_settings() -> CoversSettings {
    CoversSettings {
        network: network(CriticSettings::Pooled { width: 8 }),
        ppo: PpoSettings { epochs: 1, minibatch: 20, ..PpoSettings::default() },
        rollout_steps: 100,
        ..CoversSettings::default()
    }
}

/// A metric of an iteration that is one number.
pub fn number(iteration: &IterationReport, name: &str) -> f64 {
    match iteration.metrics.metric(name) {
        Some(MetricValue::Number(value)) => *value,
        other => panic!("{name} is {other:?}"),
    }
}

/// Checks that a result is an error whose message has this part.
#[track_caller]
pub fn assert_refused<T>(result: Result<T, LearnerError>, part: &str) {
    let message = result.err().unwrap().to_string();
    assert!(message.contains(part), "{message}");
}

/// A file for one test of this process.
pub fn scratch(name: &str) -> std::path::PathBuf {
    std::env::temp_dir().join(format!("covers-{name}-{}", std::process::id()))
}

/// Checks that a learner continues to the same bits after it was saved and loaded, untrained and
/// after rollouts of the groups 0, 1, 0.
pub fn assert_continues_alike<S: PolicyCollectionSettings>(settings: S, mut env: Bars, name: &str) {
    let path = scratch(name);
    let whole = CheckpointExtent::Everything;
    let mut learner = PolicyCollection::new(settings, env.spec()).unwrap();
    learner.save(&path, whole, "fresh").unwrap();
    learner = PolicyCollection::load(&path, env.spec()).unwrap().0;
    env.train(&mut learner, &[0, 1, 0]);
    learner.save(&path, whole, "a note").unwrap();
    let (mut copy, note) = PolicyCollection::<S>::load(&path, env.spec()).unwrap();
    std::fs::remove_file(&path).unwrap();
    assert_eq!((note.as_str(), copy.policy_count()), ("a note", learner.policy_count()));
    let mut copied_env = env.clone();
    let iterations = env.train(&mut learner, &[0, 1, 1]);
    for (one, other) in iterations.iter().zip(copied_env.train(&mut copy, &[0, 1, 1])) {
        assert_eq!((&one.metrics, &one.evidence), (&other.metrics, &other.evidence));
    }
    let bytes = |any: &dyn Learner| any.to_checkpoint_bytes(&path, whole, "").unwrap();
    assert!(bytes(&learner) == bytes(&copy), "{name} {:?}", env.spec);
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
