//! Small networks and replays of random steps, for the unit tests.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use symmetry::{Group, Irrep};

use crate::encoder::Encoder;
use crate::env::{EnvSpec, Observations, Outcome, Transition};
use crate::network_settings::{Critic, NetworkSettings};
use crate::replay::ring::Replay;
use crate::replay::settings::ReplaySettings;
use crate::sac::network::SacNetwork;
use crate::sac::settings::ContextSettings;

pub const ENVS: usize = 2;

/// Components in an order that is not irrep-major.
pub fn spec() -> EnvSpec {
    EnvSpec {
        num_envs: ENVS,
        image: [8, 8, 2],
        vector: vec![Irrep::X, Irrep::Trivial, Irrep::Y],
        action: vec![Irrep::X, Irrep::Trivial, Irrep::Y],
    }
}

pub fn settings(group: Group, encoder: Encoder) -> NetworkSettings {
    NetworkSettings {
        group,
        encoder,
        top_fields: 3,
        vector_fields: 2,
        actor_fields: 2,
        critic: Critic::Joint { fields: 3 },
        action_gain: 1.0,
        ..NetworkSettings::default()
    }
}

pub fn strided() -> Encoder {
    Encoder::Strided { fields: vec![2] }
}

/// A network with a context that every group takes, or with none.
pub fn network(group: Group, encoder: Encoder, context: bool) -> SacNetwork<f64> {
    let context = context.then_some(ContextSettings { size: 4, length: 3 });
    SacNetwork::new(&settings(group, encoder), context, &spec()).unwrap()
}

/// Fills the arrays of N observations with random numbers.
fn see(rng: &mut ChaCha8Rng, out: &mut Observations) {
    out.images.fill_with(|| rng.random());
    out.vectors.fill_with(|| rng.random_range(-1.0..1.0));
}

/// Six steps of every environment; the first ends an episode by a time-out, the second by a
/// termination.
pub fn replay() -> Replay {
    marked(0)
}

/// The same with a mark before the last `newest` steps.
pub fn marked(newest: usize) -> Replay {
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    let mut replay = Replay::new(ReplaySettings::default(), &spec()).unwrap();
    let (mut now, mut transition) = (Observations::new(&spec()), Transition::new(&spec()));
    see(&mut rng, &mut now);
    for step in 0..6 {
        if ENVS * (6 - step) == newest {
            replay.mark();
        }
        see(&mut rng, &mut transition.observations);
        see(&mut rng, &mut transition.final_observations);
        transition.rewards.fill_with(|| rng.random_range(-1.0..1.0));
        transition.outcomes = match step {
            3 => vec![Outcome::Truncated, Outcome::Terminated],
            _ => vec![Outcome::Running; ENVS],
        };
        let actions: Vec<f32> = (0..ENVS * 3).map(|_| rng.random_range(-1.0..1.0)).collect();
        replay.push(&now, &actions, &transition).unwrap();
        now.clone_from(&transition.observations);
    }
    replay
}
