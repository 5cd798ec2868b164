//! One update of proximal policy optimisation.

use equivariant::gpu::{GpuDevice, GpuError};
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use rl::{
    ActorCriticPolicy, Algorithm, CriticSettings, EncoderSettings, NetworkSettings, Ppo,
    PpoSettings, PpoStats, RlError, RolloutBuffer, VectorEnv,
};
use symmetry::Group;

use crate::common::steps::{OnPolicyRun, error as deviation};
use crate::common::{EPISODE, PointReach};
use crate::{TOLERANCE, device};

const ENVS: usize = 9;

fn network() -> NetworkSettings {
    NetworkSettings {
        encoder: EncoderSettings::Strided { fields: vec![3, 4] },
        top_fields: 6,
        vector_fields: 5,
        ..NetworkSettings::default()
    }
}

/// Ten minibatches a pass, of which the last is not full.
fn settings() -> PpoSettings {
    PpoSettings { minibatch: 12, epochs: 1, ..PpoSettings::default() }
}

fn rollout(network: &NetworkSettings) -> (ActorCriticPolicy, RolloutBuffer, ChaCha8Rng) {
    let env = PointReach::new(ENVS, 1);
    let policy = ActorCriticPolicy::new(network, env.spec(), 2).unwrap();
    let mut run = OnPolicyRun::new(env, policy, EPISODE + 3);
    run.collect();
    (run.policy, run.buffer, run.rng)
}

/// State after an update.
struct After {
    stats: PpoStats,
    /// Parameters, then both moments.
    arrays: [Vec<f32>; 3],
    steps: u64,
    /// Next number of the generator.
    next: u64,
}

fn after(mut ppo: Ppo, network: &NetworkSettings) -> After {
    let (mut policy, buffer, mut rng) = rollout(network);
    let stats = ppo.update(&mut policy, &buffer, &mut rng).unwrap();
    let state = ppo.save();
    After {
        stats,
        arrays: [policy.params(), state.tensors[0].1, state.tensors[1].1].map(<[f32]>::to_vec),
        steps: state.counters[0].1,
        next: rng.random(),
    }
}

fn on_both(settings: &PpoSettings, network: &NetworkSettings) -> [After; 2] {
    on_cpu_and(device(), settings, network)
}

fn on_cpu_and(device: &GpuDevice, settings: &PpoSettings, network: &NetworkSettings) -> [After; 2] {
    let policy = rollout(network).0;
    let here = Ppo::new(settings.clone(), &policy).unwrap();
    let there = Ppo::on_device(settings.clone(), &policy, device).unwrap();
    [here, there].map(|ppo| after(ppo, network))
}

fn assert_alike(here: &After, there: &After, what: &str) {
    for (name, i) in [("parameters", 0), ("first moments", 1), ("second moments", 2)] {
        let error = deviation(&there.arrays[i], &here.arrays[i]);
        assert!(error < TOLERANCE, "{what}: error {error} in the {name}");
    }
    assert_eq!((there.steps, there.next), (here.steps, here.next), "{what}");
    let (a, b) = (&here.stats, &there.stats);
    assert_eq!((a.steps, a.epochs), (b.steps, b.epochs), "{what}");
    let close = |x: f64, y: f64| (x - y).abs() < 1e-4 * x.abs().max(0.1);
    let pairs = [
        (a.policy_loss, b.policy_loss),
        (a.value_loss, b.value_loss),
        (a.entropy, b.entropy),
        (a.approx_kl, b.approx_kl),
        (a.clip_fraction, b.clip_fraction),
        (a.grad_norm, b.grad_norm),
    ];
    assert!(pairs.iter().all(|&(x, y)| close(x, y)), "{what}: {a:?} {b:?}");
}

#[test]
fn ten_steps_are_those_of_the_cpu() {
    let joint = CriticSettings::Joint { fields: 7 };
    for group in [Group::D2, Group::C1] {
        for critic in [joint, CriticSettings::Pooled { width: 5 }] {
            let network = NetworkSettings { group, critic, ..network() };
            let [here, there] = on_both(&settings(), &network);
            assert_eq!(here.stats.steps, 10);
            assert_alike(&here, &there, &format!("{group} {critic:?}"));
        }
    }
}

#[test]
fn every_encoder_trains_as_on_the_cpu_also_without_operations_on_subgroups() {
    let plain = device().clone().without_subgroup_operations();
    for (device, encoder) in [
        (&plain, network().encoder),
        (device(), EncoderSettings::Pooled { fields: vec![], inner: [3, 4] }),
        (device(), EncoderSettings::Blind),
    ] {
        let network = NetworkSettings { encoder: encoder.clone(), ..network() };
        let [here, there] = on_cpu_and(device, &settings(), &network);
        assert_alike(&here, &there, &format!("{encoder:?}"));
    }
}

/// In the middle of a pass, after a whole one.
#[test]
fn the_divergence_limit_stops_the_update_at_the_same_step() {
    let strict = PpoSettings { max_kl: 0.005, epochs: 12, ..settings() };
    let [here, there] = on_both(&strict, &network());
    let steps = here.stats.steps;
    assert!(steps > 10 && steps < 120 && steps % 10 > 0, "{:?}", here.stats);
    assert_alike(&here, &there, "stopped");
}

#[test]
fn the_floor_holds_on_the_device() {
    let floor = PpoSettings { min_log_std: -0.5, entropy_weight: 0.0, epochs: 3, ..settings() };
    let [here, there] = on_both(&floor, &network());
    assert!(there.stats.log_std.contains(&-0.5), "{:?}", there.stats);
    assert_alike(&here, &there, "floor");
}

#[test]
fn the_same_bits_come_twice() {
    let once = || on_both(&settings(), &network()).map(|after| after.arrays)[1].clone();
    assert!(once() == once());
}

#[test]
fn an_update_of_the_cpu_follows_one_of_the_device() {
    let (mut policy, buffer, mut rng) = rollout(&network());
    let mut here = Ppo::new(settings(), &policy).unwrap();
    let mut there = Ppo::on_device(settings(), &policy, device()).unwrap();
    there.update(&mut policy, &buffer, &mut rng).unwrap();
    here.restore(&there.save()).unwrap();
    let mut other = policy.clone();
    let mut other_rng = rng.clone();
    here.update(&mut policy, &buffer, &mut rng).unwrap();
    there.update(&mut other, &buffer, &mut other_rng).unwrap();
    let error = deviation(other.params(), policy.params());
    assert!(error < TOLERANCE, "error {error}");
    assert_eq!(here.save().counters, there.save().counters);
}

#[test]
fn a_loss_that_is_not_finite_leaves_the_parameters_before_it() {
    let wild = PpoSettings { head_learning_rate: 1e30, max_kl: 1e30, ..settings() };
    let (start, buffer, rng) = rollout(&network());
    for mut ppo in [
        Ppo::new(wild.clone(), &start).unwrap(),
        Ppo::on_device(wild.clone(), &start, device()).unwrap(),
    ] {
        let mut policy = start.clone();
        let error = ppo.update(&mut policy, &buffer, &mut rng.clone()).unwrap_err();
        assert!(matches!(error, RlError::NotFinite { .. }), "{error}");
        assert!(policy.params().iter().all(|p| p.is_finite()));
        assert_eq!(ppo.save().counters[0].1, 1, "one step was taken");
    }
}

#[test]
fn a_lost_device_is_an_error_and_the_cpu_goes_on() {
    let (mut policy, buffer, mut rng) = rollout(&network());
    let own = GpuDevice::open(None).unwrap();
    let mut there = Ppo::on_device(settings(), &policy, &own).unwrap();
    there.update(&mut policy, &buffer, &mut rng).unwrap();
    let before = policy.params().to_vec();
    own.close();
    let error = there.update(&mut policy, &buffer, &mut rng).unwrap_err();
    assert!(matches!(error, RlError::Gpu(GpuError::DeviceLost { .. })), "{error}");
    assert_eq!(policy.params(), before);
    let mut here = Ppo::new(settings(), &policy).unwrap();
    here.restore(&there.save()).unwrap();
    here.update(&mut policy, &buffer, &mut rng).unwrap();
    assert_eq!(here.save().counters[0].1, 20);
}

/// The tolerance of the tests above detects a missing gradient clipping.
#[test]
fn an_update_without_clipping_is_seen() {
    let unclipped = PpoSettings { max_grad_norm: 1e9, ..settings() };
    let [here, _] = on_both(&settings(), &network());
    let [_, there] = on_both(&unclipped, &network());
    assert!(deviation(&there.arrays[1], &here.arrays[1]) > 100.0 * TOLERANCE);
}
