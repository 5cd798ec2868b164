//! Rollouts that are moved by random elements of a group.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rl::{
    ActorCriticPolicy, Encoder, NetworkSettings, RlError, RolloutBuffer, RolloutState, VectorEnv,
    collect,
};
use symmetry::Group;

use crate::common::parts::largest;
use crate::common::{EPISODE, PointReach};

const ENVS: usize = 5;

/// A rollout with time-outs in the middle, and its policy.
fn rollout(group: Group) -> (ActorCriticPolicy, RolloutBuffer) {
    let settings = NetworkSettings {
        group,
        encoder: Encoder::Strided { fields: vec![4] },
        action_gain: 1.0,
        ..NetworkSettings::default()
    };
    let mut env = PointReach::new(ENVS, 1);
    let mut policy = ActorCriticPolicy::new(&settings, env.spec(), 2).unwrap();
    let mut buffer = RolloutBuffer::new(env.spec(), EPISODE + 3).unwrap();
    let mut state = RolloutState::reset(&mut env, &policy).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    collect(&mut env, &mut policy, &mut buffer, &mut state, &mut rng).unwrap();
    (policy, buffer)
}

/// Log-probabilities, and advantages, which tell values and those that bootstrap.
fn figures(buffer: &RolloutBuffer) -> Vec<f32> {
    let [mut advantages, mut returns] = [(); 2].map(|()| vec![0.0; buffer.samples()]);
    buffer
        .advantages(0.9, 0.8, &mut advantages, &mut returns)
        .unwrap();
    [buffer.decisions().log_probs.clone(), advantages].concat()
}

/// How much a policy's view of its own rollout changes when it is moved by elements of `by`.
fn change(group: Group, by: Group) -> f32 {
    let (mut policy, mut buffer) = rollout(group);
    buffer.revalue(&mut policy).unwrap();
    let before = figures(&buffer);
    buffer
        .augment(by, &mut ChaCha8Rng::seed_from_u64(4))
        .unwrap();
    buffer.revalue(&mut policy).unwrap();
    let pairs = before.iter().zip(figures(&buffer));
    largest(pairs.map(|(a, b)| (a - b).abs()))
}

#[test]
fn a_symmetric_policy_sees_no_difference_and_a_plain_one_does() {
    assert!(change(Group::D2, Group::D2) < 1e-4);
    assert!(change(Group::D1x, Group::D1x) < 1e-4);
    assert!(change(Group::D1x, Group::D2) > 1e-2);
    assert!(change(Group::C1, Group::D2) > 1e-2);
}

#[test]
fn pictures_vectors_and_actions_move_and_the_trivial_group_moves_nothing() {
    let (_, buffer) = rollout(Group::C1);
    let moved = |by| {
        let mut moved = buffer.clone();
        moved
            .augment(by, &mut ChaCha8Rng::seed_from_u64(4))
            .unwrap();
        moved
    };
    let (all, none) = (moved(Group::D2), moved(Group::C1));
    assert_ne!(all.observations().images, buffer.observations().images);
    assert_ne!(all.observations().vectors, buffer.observations().vectors);
    assert_ne!(all.decisions().actions, buffer.decisions().actions);
    assert_eq!(all.rewards(), buffer.rewards());
    assert_eq!(none.observations(), buffer.observations());
    assert_eq!(none.decisions(), buffer.decisions());
}

#[test]
fn an_unfinished_rollout_is_refused() {
    let (_, mut buffer) = rollout(Group::C1);
    buffer.clear();
    let result = buffer.augment(Group::D2, &mut ChaCha8Rng::seed_from_u64(4));
    assert!(matches!(result, Err(RlError::BufferNotFinished { .. })));
}
