//! Turns that differ from environment to environment, and experts for all of them.

use envs::{ACTION_DIM, Batch, EnvError, TaskGroup, Turn, VECTOR_DIM, VecEnv, VecEnvSettings};
use symmetry::D2;

const N: usize = 3;
const DECISIONS: usize = 3;
const ACTIONS: [f32; N * ACTION_DIM] = [0.5; N * ACTION_DIM];

struct Rig {
    env: VecEnv,
    batch: Batch,
}

impl Rig {
    fn new() -> Self {
        let mut settings = VecEnvSettings {
            num_envs: N,
            ..VecEnvSettings::default()
        };
        settings.camera.size = 16;
        settings.control.horizon = 10 * DECISIONS;
        Self {
            env: VecEnv::new(settings, TaskGroup::DRAWER_CLOSE, &D2::ALL).unwrap(),
            batch: Batch::new(&settings),
        }
    }

    /// The error messages of those that failed.
    fn advance(&mut self, turns: [Turn; N]) -> Vec<String> {
        let failures = self.env.advance(&ACTIONS, &turns, self.batch.step());
        let failures = failures.unwrap().iter();
        failures.map(|failure| failure.error.to_string()).collect()
    }

    /// Picture and vector of environment `env`.
    fn row(&self, env: usize) -> (&[u8], &[f32]) {
        let image = self.batch.images.len() / N;
        (
            &self.batch.images[env * image..][..image],
            &self.batch.vectors[env * VECTOR_DIM..][..VECTOR_DIM],
        )
    }
}

#[test]
fn episodes_that_are_begun_one_turn_later_are_those_of_steps() {
    let (mut now, mut later) = (Rig::new(), Rig::new());
    now.env.reset(now.batch.observations()).unwrap();
    later.advance([Turn::Reset; N]);
    for _ in 0..2 {
        for decision in 1..=DECISIONS {
            now.env.step(&ACTIONS, now.batch.step()).unwrap();
            later.advance([Turn::StepAndStay; N]);
            assert_eq!(later.batch.rewards, now.batch.rewards);
            assert_eq!(later.batch.truncated, now.batch.truncated);
            assert_eq!(now.batch.truncated, [decision == DECISIONS; N]);
            if decision < DECISIONS {
                assert_eq!(later.batch.images, now.batch.images);
            }
        }
        assert_eq!(later.batch.images, now.batch.final_images);
        assert_eq!(later.batch.vectors, now.batch.final_vectors);
        later.advance([Turn::Reset; N]);
        assert_eq!(later.batch.images, now.batch.images);
        assert_eq!(later.batch.vectors, now.batch.vectors);
        assert_eq!(later.batch.rewards, [0.0; N]);
        assert_eq!(later.batch.truncated, [false; N]);
    }
}

#[test]
fn every_environment_has_the_turn_that_it_is_given() {
    let (mut mixed, mut even) = (Rig::new(), Rig::new());
    for rig in [&mut mixed, &mut even] {
        rig.advance([Turn::Reset; N]);
        rig.advance([Turn::Step; N]);
    }
    mixed.advance([Turn::Reset, Turn::Rest, Turn::Step]);
    assert_eq!(mixed.row(1), even.row(1), "one that rests stays as it is");
    assert_eq!(mixed.batch.rewards[..2], [0.0; 2]);
    even.advance([Turn::Step; N]);
    assert_eq!(
        mixed.row(2),
        even.row(2),
        "one that steps does not feel the others"
    );
    assert_eq!(mixed.batch.rewards[2], even.batch.rewards[2]);
    even.advance([Turn::Reset; N]);
    assert_eq!(
        mixed.row(0),
        even.row(0),
        "the second episode of its stream"
    );
}

#[test]
fn one_that_waits_for_a_reset_fails_alone() {
    let mut rig = Rig::new();
    let turns = [Turn::StepAndStay, Turn::Step, Turn::Step];
    let early = rig.env.advance(&ACTIONS, &turns, rig.batch.step());
    assert!(matches!(early.unwrap_err(), EnvError::NotReset));
    rig.advance([Turn::Reset; N]);
    for _ in 0..DECISIONS {
        assert_eq!(rig.advance(turns), Vec::<String>::new());
    }
    let failures = rig.advance(turns);
    assert_eq!(failures, ["no episode is running: call `reset` first"]);
    assert_eq!(rig.batch.truncated, [true, false, false]);
    let short = rig.env.advance(&ACTIONS, &turns[..2], rig.batch.step());
    let message = short.unwrap_err().to_string();
    assert_eq!(message, "`turns` has 2 elements, expected 3");
}

#[test]
fn experts_close_every_drawer() {
    let settings = VecEnvSettings {
        num_envs: N,
        ..VecEnvSettings::default()
    };
    let mut env = VecEnv::new(settings, TaskGroup::DRAWER_CLOSE, &D2::ALL).unwrap();
    let (mut batch, mut actions) = (Batch::new(&settings), ACTIONS);
    let early = env.expert_actions(&mut actions).unwrap_err();
    assert!(matches!(early, EnvError::NotReset), "{early}");
    env.reset(batch.observations()).unwrap();
    let mut succeeded = [false; N];
    for _ in 0..settings.control.decisions() {
        env.expert_actions(&mut actions).unwrap();
        env.step(&actions, batch.step()).unwrap();
        for (ever, now) in succeeded.iter_mut().zip(&batch.success) {
            *ever |= now;
        }
    }
    assert_eq!(succeeded, [true; N]);
    let short = env.expert_actions(&mut actions[..3]).unwrap_err();
    assert_eq!(short.to_string(), "`actions` has 3 elements, expected 12");
}
