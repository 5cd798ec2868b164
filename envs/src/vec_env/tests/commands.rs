//! Commands that differ between environments, and experts for all of them.

use super::*;

const ACTIONS: [f32; N * ACTION_DIM] = [0.5; N * ACTION_DIM];

/// Executes the commands and returns the error messages of the failures.
fn advance(rig: &mut Rig, commands: [EnvCommand; N]) -> Vec<String> {
    let failures = rig.env.execute_commands(&ACTIONS, &commands, rig.batch.step_results_mut());
    let failures = failures.unwrap().iter();
    failures.map(|failure| failure.error.to_string()).collect()
}

#[test]
fn resets_by_command_give_the_episodes_of_automatic_resets() {
    let (mut now, mut later) = (Rig::new(2), Rig::new(2));
    now.env.reset(now.batch.observations_mut()).unwrap();
    advance(&mut later, [EnvCommand::Reset; N]);
    for _ in 0..2 {
        for decision in 1..=DECISIONS {
            now.env.step(&ACTIONS, now.batch.step_results_mut()).unwrap();
            advance(&mut later, [EnvCommand::StepNoAutoReset; N]);
            assert_eq!(later.batch.rewards, now.batch.rewards);
            assert_eq!(later.batch.truncated, now.batch.truncated);
            assert_eq!(now.batch.truncated, [decision == DECISIONS; N]);
            if decision < DECISIONS {
                assert_eq!(later.batch.images, now.batch.images);
            }
        }
        assert_eq!(later.batch.images, now.batch.final_images);
        assert_eq!(later.batch.vectors, now.batch.final_vectors);
        advance(&mut later, [EnvCommand::Reset; N]);
        assert_eq!(later.batch.images, now.batch.images);
        assert_eq!(later.batch.vectors, now.batch.vectors);
        assert_eq!(later.batch.rewards, [0.0; N]);
        assert_eq!(later.batch.truncated, [false; N]);
    }
}

#[test]
fn every_environment_executes_its_own_command() {
    let (mut mixed, mut even) = (Rig::new(2), Rig::new(2));
    for rig in [&mut mixed, &mut even] {
        advance(rig, [EnvCommand::Reset; N]);
        advance(rig, [EnvCommand::Step; N]);
    }
    advance(&mut mixed, [EnvCommand::Reset, EnvCommand::Idle, EnvCommand::Step]);
    assert_eq!(mixed.observation(1), even.observation(1), "one that rests stays as it is");
    assert_eq!(mixed.batch.rewards[..2], [0.0; 2]);
    advance(&mut even, [EnvCommand::Step; N]);
    assert_eq!(
        mixed.observation(2),
        even.observation(2),
        "one that steps does not feel the others"
    );
    assert_eq!(mixed.batch.rewards[2], even.batch.rewards[2]);
    advance(&mut even, [EnvCommand::Reset; N]);
    assert_eq!(mixed.observation(0), even.observation(0), "the second episode of its stream");
}

#[test]
fn one_that_waits_for_a_reset_fails_alone() {
    let mut rig = Rig::new(2);
    let commands = [EnvCommand::StepNoAutoReset, EnvCommand::Step, EnvCommand::Step];
    let early = rig.env.execute_commands(&ACTIONS, &commands, rig.batch.step_results_mut());
    assert!(matches!(early.unwrap_err(), EnvError::NotReset));
    advance(&mut rig, [EnvCommand::Reset; N]);
    for _ in 0..DECISIONS {
        assert_eq!(advance(&mut rig, commands), Vec::<String>::new());
    }
    let failures = advance(&mut rig, commands);
    assert_eq!(failures, ["no episode is running: call `reset` first"]);
    assert_eq!(rig.batch.truncated, [true, false, false]);
    let short = rig.env.execute_commands(&ACTIONS, &commands[..2], rig.batch.step_results_mut());
    let message = short.unwrap_err().to_string();
    assert_eq!(message, "`commands` has 2 elements, expected 3");
}

#[test]
fn experts_close_every_drawer() {
    let settings = VecEnvSettings { num_envs: N, ..VecEnvSettings::default() };
    let mut env = VecEnv::new(settings, TaskGroup::DRAWER_CLOSE, &D2::ALL).unwrap();
    let (mut batch, mut actions) = (StepBuffers::new(&settings), ACTIONS);
    let early = env.expert_actions(&mut actions).unwrap_err();
    assert!(matches!(early, EnvError::NotReset), "{early}");
    env.reset(batch.observations_mut()).unwrap();
    let mut succeeded = [false; N];
    for _ in 0..settings.control.decisions_per_episode() {
        env.expert_actions(&mut actions).unwrap();
        env.step(&actions, batch.step_results_mut()).unwrap();
        for (ever, now) in succeeded.iter_mut().zip(&batch.success) {
            *ever |= now;
        }
    }
    assert_eq!(succeeded, [true; N]);
    let short = env.expert_actions(&mut actions[..3]).unwrap_err();
    assert_eq!(short.to_string(), "`actions` has 3 elements, expected 12");
}
