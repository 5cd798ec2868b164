//! The check of the irreps that an environment declares: it refuses wrong ones and no right ones.

use Irrep::{Trivial, X, XY, Y};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rl::{EnvSpec, Observations, RlError, check_env_symmetry};
use symmetry::{Group, Irrep};

use crate::common::guess::Guess;
use crate::common::toy::{Toy, Toys};
use crate::common::{PIXELS, PointReach};

/// Checks 100 environments for two episodes of the point that reaches a goal.
fn checked(vector: &[Irrep], action: &[Irrep], group: Group, seed: u64) -> Result<(), RlError> {
    let mut env = PointReach::new(100, seed).declaring(vector, action);
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    check_env_symmetry(&mut env, group, 20, &mut rng)
}

#[test]
fn right_irreps_are_not_refused() {
    for seed in 0..20 {
        checked(&[X, Y], &[X, Y], Group::D2, seed).unwrap();
    }
    for group in Group::ALL {
        checked(&[X, Y], &[X, Y], group, 0).unwrap();
    }
}

#[test]
fn wrong_irreps_are_refused() {
    let wrong: [([Irrep; 2], [Irrep; 2]); 7] = [
        ([Y, X], [X, Y]),
        ([X, Y], [Y, X]),
        // consistent with one another, but not with the picture
        ([Y, X], [Y, X]),
        ([X, X], [X, Y]),
        ([Trivial, Y], [X, Y]),
        ([X, Y], [X, Trivial]),
        ([X, Y], [XY, Y]),
    ];
    for (vector, action) in wrong {
        let refused = checked(&vector, &action, Group::D2, 0);
        assert!(
            matches!(refused, Err(RlError::SymmetryViolated { .. })),
            "{vector:?} {action:?}: {refused:?}"
        );
    }
    // where the group has one irrep for both, they are not wrong
    checked(&[Y, X], &[Y, X], Group::C2, 0).unwrap();
    checked(&[Trivial, X], &[XY, Y], Group::C1, 0).unwrap();
}

#[test]
fn the_message_names_the_quantity_and_its_irrep() {
    let error = checked(&[Y, X], &[X, Y], Group::D2, 0).unwrap_err();
    let message = error.to_string();
    assert!(message.contains("component"), "{message}");
    assert!(message.contains("standard errors away"), "{message}");
}

/// Task whose best action depends on a vector that is declared to be the same for all.
#[test]
fn a_dependence_of_rewards_alone_is_seen() {
    for (vector, refused) in [(X, false), (Trivial, true), (Y, true)] {
        let mut env = Guess::new(100, true, 1).declaring(&[vector], &[X]);
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let checked = check_env_symmetry(&mut env, Group::D2, 24, &mut rng);
        assert_eq!(checked.is_err(), refused, "{vector:?}: {checked:?}");
    }
}

/// Numbers without a sense of direction, and with heavy tails: they tell nothing of an action.
struct Noise(ChaCha8Rng);

impl Toy for Noise {
    const EPISODE: usize = 1;

    fn restart(&mut self, _: usize) {}

    fn observe(&self, n: usize, out: &mut Observations) {
        let mut rng = self.0.clone();
        rng.set_word_pos(1000 * n as u128);
        let heavy = |draws: &mut ChaCha8Rng| (1.0 / draws.random_range(0.001..1.0_f32)).powi(2);
        let sign = |draws: &mut ChaCha8Rng| if draws.random() { 1.0 } else { -1.0 };
        let row = &mut out.vectors[3 * n..3 * n + 3];
        row.fill_with(|| sign(&mut rng) * heavy(&mut rng));
    }

    fn act(&mut self, _: usize, _: &[f32]) -> (f32, bool) {
        (1.0, false)
    }
}

#[test]
fn false_alarms_are_rare_whatever_the_distribution() {
    let spec = EnvSpec {
        num_envs: 60,
        image_shape: [1, 1, 1],
        vector_irreps: vec![X, Y, XY],
        action_irreps: vec![X],
        choices: vec![],
    };
    let alarms = (0..300).filter(|&seed| {
        let noise = Noise(ChaCha8Rng::seed_from_u64(seed));
        let mut env = Toys::of(noise, spec.clone());
        let mut rng = ChaCha8Rng::seed_from_u64(1000 + seed);
        check_env_symmetry(&mut env, Group::D2, 1, &mut rng).is_err()
    });
    // nominal 0.3; five or more have a probability of 1e-5
    assert!(alarms.count() < 5);
}

/// The assumption: environments that begin on one side say nothing of their mirror images.
#[test]
fn first_states_on_one_side_and_too_few_episodes_are_refused() {
    struct OneSided;

    impl Toy for OneSided {
        const EPISODE: usize = 2;

        fn restart(&mut self, _: usize) {}

        fn observe(&self, n: usize, out: &mut Observations) {
            out.vectors[n] = 0.8;
        }

        fn act(&mut self, _: usize, _: &[f32]) -> (f32, bool) {
            (0.0, false)
        }
    }

    let spec = EnvSpec {
        num_envs: 10,
        image_shape: [PIXELS, PIXELS, 1],
        vector_irreps: vec![X],
        action_irreps: vec![X],
        choices: vec![],
    };
    let mut env = Toys::of(OneSided, spec);
    let mut check = |steps| {
        let mut rng = ChaCha8Rng::seed_from_u64(0);
        let error = check_env_symmetry(&mut env, Group::D2, steps, &mut rng).unwrap_err();
        error.to_string()
    };
    let message = check(10);
    assert!(message.contains("vector component 0 (x) would be 0"), "{message}");
    let short_message = check(4);
    assert!(short_message.contains("48 episodes"), "{short_message}");
}
