//! The rollout buffer by itself: its order of calls, what it bootstraps and what it refuses.

use rl::{Decisions, EnvSpec, Observations, RlError, RolloutBuffer, StepOutcome, Transition};
use symmetry::Irrep;

fn spec() -> EnvSpec {
    EnvSpec {
        num_envs: 2,
        image_shape: [2, 2, 1],
        vector_irreps: vec![Irrep::X],
        action_irreps: vec![Irrep::X],
        choices: vec![],
    }
}

/// Pushes one step whose every array carries `mark`.
fn push(buffer: &mut RolloutBuffer, mark: u8, outcome: StepOutcome) -> Result<(), RlError> {
    let value = f32::from(mark);
    let observations = Observations { images: vec![mark; 8], vectors: vec![value; 2] };
    let decisions =
        Decisions { actions: vec![value; 2], log_probs: vec![value; 2], values: vec![value; 2] };
    let mut transition = Transition::new(&spec());
    transition.rewards.fill(value);
    transition.outcomes.fill(outcome);
    buffer.push(&observations, &decisions, &transition, &[10.0, 20.0])
}

#[test]
fn pushing_past_the_end_is_an_error() {
    let mut buffer = RolloutBuffer::new(&spec(), 2).unwrap();
    push(&mut buffer, 1, StepOutcome::Running).unwrap();
    push(&mut buffer, 2, StepOutcome::Running).unwrap();
    assert!(matches!(
        push(&mut buffer, 3, StepOutcome::Running),
        Err(RlError::BufferFull { steps: 2 })
    ));
    assert_eq!(buffer.observations().images, [vec![1; 8], vec![2; 8]].concat());
    buffer.clear();
    push(&mut buffer, 3, StepOutcome::Running).unwrap();
    assert_eq!(buffer.rewards()[..2], [3.0, 3.0]);
}

#[test]
fn a_buffer_is_read_only_when_finished() {
    let mut buffer = RolloutBuffer::new(&spec(), 2).unwrap();
    push(&mut buffer, 1, StepOutcome::Running).unwrap();
    assert!(matches!(
        buffer.finish(&Observations::new(&spec()), &[0.0; 2]),
        Err(RlError::BufferNotFinished { got: 1, steps: 2 })
    ));
    push(&mut buffer, 2, StepOutcome::Truncated).unwrap();
    let (mut advantages, mut returns) = ([0.0; 4], [0.0; 4]);
    assert!(buffer.write_advantages_and_returns(1.0, 1.0, &mut advantages, &mut returns).is_err());
    buffer.finish(&Observations::new(&spec()), &[-1000.0; 2]).unwrap();
    buffer.write_advantages_and_returns(1.0, 1.0, &mut advantages, &mut returns).unwrap();
    // returns bootstrap the final observations (10, 20), never what came after the reset (-1000)
    assert_eq!(returns, [1.0 + 2.0 + 10.0, 1.0 + 2.0 + 20.0, 2.0 + 10.0, 2.0 + 20.0]);
}

/// Settings can ask for any number; allocating it would end the program.
#[test]
fn a_rollout_that_no_memory_holds_is_refused() {
    for (num_envs, steps) in [(usize::MAX, 2), (1 << 20, 1 << 30)] {
        let spec = EnvSpec { num_envs, ..spec() };
        let error = RolloutBuffer::new(&spec, steps).unwrap_err();
        assert!(matches!(error, RlError::NotEnoughMemory { .. }), "{error}");
        assert!(error.to_string().contains("GiB"), "{error}");
    }
}

/// The remaining steps form a complete rollout that bootstraps from the next step, and `clear`
/// restores the capacity.
#[test]
fn a_rollout_may_lose_its_end() {
    let mut buffer = RolloutBuffer::new(&spec(), 3).unwrap();
    for mark in 1..=3 {
        let outcome = if mark == 3 { StepOutcome::Truncated } else { StepOutcome::Running };
        push(&mut buffer, mark, outcome).unwrap();
    }
    assert!(buffer.truncate(2).is_err(), "before it is finished");
    buffer.finish(&Observations::new(&spec()), &[0.0; 2]).unwrap();
    assert!(buffer.truncate(0).is_err());
    buffer.truncate(2).unwrap();
    assert_eq!((buffer.steps_per_env(), buffer.num_samples(), buffer.rewards().len()), (2, 4, 4));
    let (mut advantages, mut returns) = ([0.0; 4], [0.0; 4]);
    buffer.write_advantages_and_returns(1.0, 1.0, &mut advantages, &mut returns).unwrap();
    // pay of 1 and 2, and the value 3 of the step that was cut off
    assert_eq!(returns, [6.0, 6.0, 5.0, 5.0]);
    buffer.clear();
    for mark in 4..=6 {
        push(&mut buffer, mark, StepOutcome::Running).unwrap();
    }
    assert_eq!(buffer.rewards(), [4.0, 4.0, 5.0, 5.0, 6.0, 6.0]);
}
