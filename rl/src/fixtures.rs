//! Small networks and replay buffers of random steps, for the unit tests.

use std::ops::Range;

use equivariant::Sequential;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use symmetry::{Group, Irrep};

use crate::activity::UnitActivity;
use crate::encoder::EncoderSettings;
use crate::env::{EnvSpec, Observations, StepOutcome, Transition};
use crate::network_settings::{CriticSettings, NetworkSettings};
use crate::replay::{ReplayBuffer, ReplaySettings};
use crate::sac::network::SacNetwork;
use crate::sac::settings::RecurrentContextSettings;

pub const ENVS: usize = 2;

/// Returns a spec whose components are not in irrep-major order.
pub fn spec() -> EnvSpec {
    EnvSpec {
        num_envs: ENVS,
        image_shape: [8, 8, 2],
        vector_irreps: vec![Irrep::X, Irrep::Trivial, Irrep::Y],
        action_irreps: vec![Irrep::X, Irrep::Trivial, Irrep::Y],
        choices: vec![],
    }
}

pub fn settings(group: Group, encoder: EncoderSettings) -> NetworkSettings {
    NetworkSettings {
        group,
        encoder,
        top_fields: 3,
        vector_fields: 2,
        actor_fields: 2,
        critic: CriticSettings::Joint { fields: 3 },
        action_gain: 1.0,
        ..NetworkSettings::default()
    }
}

pub fn strided() -> EncoderSettings {
    EncoderSettings::Strided { fields: vec![2] }
}

/// Builds a network, with a context whose size fits every group if `context`.
pub fn network(group: Group, encoder: EncoderSettings, context: bool) -> SacNetwork<f64> {
    let context = context.then_some(RecurrentContextSettings { size: 4, length: 3 });
    SacNetwork::new(&settings(group, encoder), context, &spec()).unwrap()
}

fn fill_random(rng: &mut ChaCha8Rng, out: &mut Observations) {
    out.images.fill_with(|| rng.random());
    out.vectors.fill_with(|| rng.random_range(-1.0..1.0));
}

/// Returns six steps of two environments; at the fourth, the first one's episode ends by a time-out
/// and the second one's by a termination.
pub fn replay() -> ReplayBuffer {
    replay_with_newest(0)
}

/// Returns the steps of [`replay`] with a mark before the last `newest` ones.
pub fn replay_with_newest(newest: usize) -> ReplayBuffer {
    let mut rng = ChaCha8Rng::seed_from_u64(8);
    let mut replay = ReplayBuffer::new(ReplaySettings::default(), &spec()).unwrap();
    let (mut now, mut transition) = (Observations::new(&spec()), Transition::new(&spec()));
    fill_random(&mut rng, &mut now);
    for step in 0..6 {
        if ENVS * (6 - step) == newest {
            replay.mark_newest_from_now();
        }
        fill_random(&mut rng, &mut transition.observations);
        fill_random(&mut rng, &mut transition.final_observations);
        transition.rewards.fill_with(|| rng.random_range(-1.0..1.0));
        transition.outcomes = match step {
            3 => vec![StepOutcome::Truncated, StepOutcome::Terminated],
            _ => vec![StepOutcome::Running; ENVS],
        };
        let actions: Vec<f32> = (0..ENVS * 3).map(|_| rng.random_range(-1.0..1.0)).collect();
        replay.push(&now, &actions, &transition).unwrap();
        now.clone_from(&transition.observations);
    }
    replay
}

/// Returns the derivative of `loss` with respect to number `i` by central differences of step `h`.
pub fn central_difference(
    at: &mut [f64],
    i: usize,
    h: f64,
    mut loss: impl FnMut(&[f64]) -> f64,
) -> f64 {
    let centre = at[i];
    let [high, low] = [centre + h, centre - h].map(|moved| {
        at[i] = moved;
        loss(at)
    });
    at[i] = centre;
    (high - low) / (2.0 * h)
}

/// Returns random observations of `samples` environments.
pub fn observations(samples: usize) -> Observations {
    let (spec, mut rng) = (spec(), ChaCha8Rng::seed_from_u64(5));
    let mut out = Observations {
        images: vec![0; samples * spec.image_len()],
        vectors: vec![0.0; samples * spec.vector_irreps.len()],
    };
    fill_random(&mut rng, &mut out);
    out
}

/// Sets the bias of a field of the first layer of `head` with parameters `params`, and its weights
/// to zero unless `weights`.
fn set_bias(head: &Sequential<f32>, params: &mut [f32], field: usize, bias: f32, weights: bool) {
    let first = &head.layers()[0];
    let (from, to) = (first.in_shape().fields, first.out_shape().fields);
    let fields = to.num_regular_fields().unwrap();
    let mut start = 0;
    for irrep in to.group().irreps() {
        let width = from.multiplicity(*irrep);
        if !weights {
            params[start + field * width..start + (field + 1) * width].fill(0.0);
        }
        start += fields * width;
    }
    params[start + field] = bias;
}

/// Activates all units of the hidden layer of `head` with parameters `params`.
pub fn activate_units(head: &Sequential<f32>, params: &mut [f32]) {
    let hidden = head.layers()[0].out_shape().fields;
    for field in 0..hidden.num_regular_fields().unwrap() {
        set_bias(head, params, field, 100.0, true);
    }
}

/// Activates all units of the hidden layer of `head` by large biases, then deactivates one field
/// after the other: the number of dormant units must grow by those of the field each time.
pub fn check_killed_units(
    head: &Sequential<f32>,
    mut params: Vec<f32>,
    own: Range<usize>,
    activity: impl Fn(&[f32]) -> UnitActivity,
) {
    let hidden = head.layers()[0].out_shape().fields;
    let fields = hidden.num_regular_fields().unwrap();
    activate_units(head, &mut params[own.clone()]);
    let awake = activity(&params);
    for killed in 1..=fields {
        set_bias(head, &mut params[own.clone()], killed - 1, -1.0, false);
        let found = activity(&params);
        assert_eq!(found.num_units(), awake.num_units());
        let expected = awake.num_dormant_units(0.025) + killed * hidden.group().order();
        assert_eq!(found.num_dormant_units(0.025), expected, "{head}");
    }
}
