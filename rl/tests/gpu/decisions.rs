//! Decisions of a policy.

use equivariant::gpu::{GpuDevice, GpuError};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rl::{
    Actor, ActorCriticPolicy, Algorithm, CriticSettings, Decisions, EncoderSettings, EnvSpec,
    GpuPolicy, NetworkSettings, Observations, OnPolicyActor, Ppo, PpoSettings, RlError,
    RolloutBuffer, ValueFunction, VectorEnv,
};
use symmetry::{D2, Group, Irrep};

use crate::common::steps::{
    OnPolicyRun, error as deviation, random_observations, transform_vector, transformed,
};
use crate::common::{EPISODE, PointReach};
use crate::{TOLERANCE, device};

/// Observations in a test, and how many of them fit the device at a time.
const OBSERVATIONS: usize = 7;
const SAMPLES: usize = 3;

/// Components that are not irrep-major, in an order that is not its own inverse.
fn spec(num_envs: usize) -> EnvSpec {
    let vector = vec![Irrep::X, Irrep::Y, Irrep::Trivial, Irrep::XY, Irrep::X];
    EnvSpec {
        num_envs,
        image_shape: [6, 6, 3],
        action_irreps: vector[..3].to_vec(),
        choices: vec![],
        vector_irreps: vector,
    }
}

fn networks() -> Vec<NetworkSettings> {
    let strided = EncoderSettings::Strided { fields: vec![3] };
    let pooled = CriticSettings::Pooled { width: 5 };
    let joint = CriticSettings::Joint { fields: 7 };
    let mut networks = Vec::new();
    for group in [Group::D2, Group::C1] {
        for (encoder, critic) in
            [(strided.clone(), joint), (strided.clone(), pooled), (EncoderSettings::Blind, joint)]
        {
            networks.push(NetworkSettings {
                group,
                encoder,
                critic,
                top_fields: 6,
                vector_fields: 5,
                action_gain: 1.0,
                ..NetworkSettings::default()
            });
        }
    }
    networks
}

fn policy(network: &NetworkSettings) -> ActorCriticPolicy {
    ActorCriticPolicy::new(network, &spec(OBSERVATIONS), 2).unwrap()
}

fn there(network: &NetworkSettings) -> GpuPolicy {
    GpuPolicy::new(policy(network), device(), SAMPLES).unwrap()
}

fn observations() -> Observations {
    random_observations(&spec(OBSERVATIONS), &mut ChaCha8Rng::seed_from_u64(11))
}

/// Mean actions and values.
fn outputs(
    policy: &mut (impl Actor<Memory = ()> + ValueFunction),
    of: &Observations,
) -> [Vec<f32>; 2] {
    let (width, n) = (spec(1).action_irreps.len(), of.vectors.len() / spec(1).vector_irreps.len());
    let mut out = [width, 1].map(|width| vec![0.0; n * width]);
    policy.mean_actions(of, &mut (), &mut out[0]).unwrap();
    policy.values(of, &mut out[1]).unwrap();
    out
}

fn decisions(policy: &mut impl OnPolicyActor<Memory = ()>) -> Decisions {
    let mut out = Decisions::new(&spec(OBSERVATIONS));
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let mut noise = vec![0.0; out.actions.len()];
    noise.fill_with(|| rng.random_range(-2.0..2.0));
    policy.decide(&observations(), &mut (), &noise, &mut out).unwrap();
    out
}

fn sampled(policy: &mut impl Actor<Memory = ()>) -> Vec<f32> {
    let mut out = vec![0.0; OBSERVATIONS * spec(1).action_irreps.len()];
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    policy.act(&observations(), &mut (), &mut rng, &mut out).unwrap();
    out
}

/// Checks that decisions differ by rounding.
fn assert_alike(got: &Decisions, expected: &Decisions, tolerance: f32, what: &str) {
    let pairs = [
        ("actions", &got.actions, &expected.actions),
        ("log-probabilities", &got.log_probs, &expected.log_probs),
        ("values", &got.values, &expected.values),
    ];
    for (name, found, wanted) in pairs {
        let error = deviation(found, wanted);
        assert!(error < tolerance, "{what}: {name} are off by {error}");
    }
}

/// In two whole batches and one of a single observation.
#[test]
fn decisions_are_those_of_the_cpu() {
    for network in networks() {
        let here = decisions(&mut policy(&network));
        let there = decisions(&mut there(&network));
        assert_alike(&there, &here, TOLERANCE, &format!("{network:?}"));
    }
}

#[test]
fn means_values_and_samples_are_those_of_decisions() {
    for network in networks() {
        let mut here = policy(&network);
        let mut there = there(&network);
        let [mean, value] = outputs(&mut there, &observations());
        let [expected, values] = outputs(&mut here, &observations());
        assert!(deviation(&mean, &expected) < TOLERANCE, "{network:?}");
        assert!(deviation(&value, &values) < TOLERANCE, "{network:?}");
        let made = decisions(&mut there);
        assert_eq!(made.values, value);
        let drawn = sampled(&mut there);
        let error = deviation(&drawn, &sampled(&mut here));
        assert!(error < TOLERANCE, "{network:?}: samples are off by {error}");
        assert_ne!(drawn, mean);
    }
}

#[test]
fn mirrored_observations_get_mirrored_means_and_the_same_values() {
    let [network, plain] =
        [Group::D2, Group::C1].map(|group| NetworkSettings { group, ..networks().swap_remove(0) });
    let errors = |any: &NetworkSettings, g| {
        let mut policy = there(any);
        let [mean, value] = outputs(&mut policy, &observations());
        let [mean_g, value_g] = outputs(&mut policy, &transformed(&spec(1), &observations(), g, g));
        let mean = transform_vector(&mean, &spec(1).action_irreps, g);
        [deviation(&mean_g, &mean), deviation(&value_g, &value)]
    };
    for g in D2::ALL {
        let [mean, value] = errors(&network, g);
        assert!(mean < 1e-5 && value < 1e-5, "{g}: {mean} and {value}");
    }
    let [mean, value] = errors(&plain, D2::FlipX);
    assert!(mean > 0.01 && value > 0.01, "{mean} and {value}");
}

/// The rollouts differ by rounding, which every step adds to.
#[test]
fn a_rollout_is_collected_and_an_update_is_taken_over() {
    let network = NetworkSettings {
        encoder: EncoderSettings::Strided { fields: vec![3, 4] },
        action_gain: 1.0,
        ..NetworkSettings::default()
    };
    let env = PointReach::new(9, 1);
    let on_cpu = ActorCriticPolicy::new(&network, env.spec(), 2).unwrap();
    let on_gpu = GpuPolicy::new(on_cpu.clone(), device(), 4).unwrap();
    let mut run = OnPolicyRun::new(env.clone(), on_cpu, EPISODE + 3);
    let mut run_there = OnPolicyRun::new(env, on_gpu, EPISODE + 3);
    run.collect();
    run_there.collect();
    let (mut here, OnPolicyRun { policy: mut there, buffer, .. }) = (run.policy, run_there);
    let same = run.buffer.decisions();
    assert_alike(buffer.decisions(), same, 10.0 * TOLERANCE, "a rollout");

    let mut ppo = Ppo::new(PpoSettings::default(), there.policy()).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(4);
    ppo.update(there.policy_mut(), &buffer, &mut rng).unwrap();
    let mut updated = there.policy().clone();
    let first = first_of(&buffer);
    let [got, of_updated, before] =
        [values(&mut there, &first), values(&mut updated, &first), values(&mut here, &first)];
    let error = deviation(&got, &of_updated);
    assert!(error < TOLERANCE, "the values are off by {error}");
    assert!(deviation(&got, &before) > 100.0 * TOLERANCE);
}

/// The observations of the first step.
fn first_of(buffer: &RolloutBuffer) -> Observations {
    let (spec, all) = (buffer.spec(), buffer.observations());
    let mut first = Observations::new(spec);
    let (images, vectors) = (first.images.len(), first.vectors.len());
    first.images.copy_from_slice(&all.images[..images]);
    first.vectors.copy_from_slice(&all.vectors[..vectors]);
    first
}

fn values(policy: &mut impl ValueFunction, observations: &Observations) -> Vec<f32> {
    let mut values = vec![0.0; 9];
    policy.values(observations, &mut values).unwrap();
    values
}

#[test]
fn a_policy_with_a_network_of_its_own_is_refused() {
    let network = networks().swap_remove(0);
    let mut there = there(&network);
    let mut out = vec![0.0; OBSERVATIONS];
    there.values(&observations(), &mut out).unwrap();
    let clone = there.policy().clone();
    *there.policy_mut() = policy(&network);
    let error = there.values(&observations(), &mut out).unwrap_err();
    assert!(matches!(error, RlError::NetworkMismatch), "{error}");
    *there.policy_mut() = clone;
    let mut again = vec![0.0; OBSERVATIONS];
    there.values(&observations(), &mut again).unwrap();
    assert_eq!(again, out);
}

#[test]
fn the_same_bits_come_twice() {
    let network = networks().swap_remove(0);
    assert_eq!(decisions(&mut there(&network)), decisions(&mut there(&network)));
}

#[test]
fn what_does_not_fit_is_refused() {
    let network = networks().swap_remove(0);
    let error = GpuPolicy::new(policy(&network), device(), 0).unwrap_err();
    assert!(error.to_string().contains("samples"), "{error}");
    let most = device().adapter().max_binding_bytes as usize;
    let too_many = GpuPolicy::new(policy(&network), device(), most).unwrap_err();
    assert!(matches!(too_many, RlError::Gpu(GpuError::BufferTooLarge { .. })), "{too_many}");
    let mut short = observations();
    short.vectors.pop();
    let mut values = vec![0.0; OBSERVATIONS];
    let short_error = there(&network).values(&short, &mut values).unwrap_err();
    assert!(matches!(short_error, RlError::ShapeMismatch { .. }), "{short_error}");
}

#[test]
fn a_lost_device_is_an_error() {
    let own = GpuDevice::open(None).unwrap();
    let mut there = GpuPolicy::new(policy(&networks()[0]), &own, SAMPLES).unwrap();
    let mut values = vec![0.0; OBSERVATIONS];
    there.values(&observations(), &mut values).unwrap();
    own.close();
    let error = there.values(&observations(), &mut values).unwrap_err();
    assert!(matches!(error, RlError::Gpu(GpuError::DeviceLost { .. })), "{error}");
}
