//! Updates of soft actor-critic, what they save and refuse, and their settings.

use rl::{
    Actor, Algorithm, CriticSettings, EncoderSettings, EntropyTemperatureSettings, EnvSpec,
    Metrics, NetworkSettings, Observations, PpoSettings, RecurrentContextSettings, ReplayBuffer,
    RlError, Sac, SacPolicy, SacSettings, VectorEnv,
};
use symmetry::Group;

use crate::common::PointReach;
use crate::common::sac::{ENVS, Run, network, replay_settings, settings};
use crate::common::steps::joint;

const CONTEXT: RecurrentContextSettings = RecurrentContextSettings { size: 8, length: 3 };
const LEARNED: EntropyTemperatureSettings =
    EntropyTemperatureSettings::Learned { initial: 0.1, target: -1.0 };

fn strided() -> EncoderSettings {
    EncoderSettings::Strided { fields: vec![3, 4] }
}

/// Two collections and updates of a policy with a context, from moved steps, with everything on.
fn busy() -> Run {
    let settings = SacSettings {
        temperature: LEARNED,
        augmentation: Group::D2,
        cloning_weight: 0.1,
        ..settings()
    };
    Run::new(&network(strided()), Some(CONTEXT), settings, replay_settings())
}

fn learn(run: &mut Run, turns: usize) {
    for _ in 0..turns {
        run.replay.mark_newest_from_now();
        run.collect().unwrap();
        run.sac.update(&mut run.policy, &run.replay, &mut run.rng).unwrap();
    }
}

fn bits(params: &[f32]) -> Vec<u32> {
    params.iter().map(|p| p.to_bits()).collect()
}

#[test]
fn one_two_and_three_threads_give_the_same_bits() {
    let on = |threads| {
        let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
        pool.build().unwrap().install(|| {
            let mut run = busy();
            learn(&mut run, 2);
            (bits(run.policy.params()), bits(run.sac.save().tensors[2].1))
        })
    };
    let one = on(1);
    assert_eq!(one, on(2));
    assert_eq!(one, on(3));
    assert_ne!(one.0, bits(busy().policy.params()));
}

#[test]
fn a_saved_learner_goes_on_to_the_same_bits() {
    let mut run = busy();
    learn(&mut run, 2);
    let mut twin = restored(&run);
    for each in [&mut run, &mut twin] {
        each.replay.mark_newest_from_now();
        each.collect().unwrap();
    }
    assert_eq!(twin.replay.checkpoint_state(), run.replay.checkpoint_state());
    let [stats, twins] = [&mut run, &mut twin]
        .map(|run| run.sac.update(&mut run.policy, &run.replay, &mut run.rng).unwrap());
    assert_eq!(twins, stats);
    assert!(stats.steps > 0);
    assert_eq!(bits(twin.policy.params()), bits(run.policy.params()));
    assert_eq!(twin.sac.save(), run.sac.save());
}

/// Returns a run restored from the saved state of `run`, with its environments and memory.
fn restored(run: &Run) -> Run {
    let spec = run.env.spec();
    let params = run.policy.params().to_vec();
    let policy = SacPolicy::with_params(&network(strided()), Some(CONTEXT), spec, params).unwrap();
    let mut sac = Sac::new(run.sac.settings().clone(), &policy).unwrap();
    sac.restore(&run.sac.save()).unwrap();
    Run {
        env: run.env.clone(),
        policy,
        sac,
        replay: ReplayBuffer::restore(replay_settings(), spec, &run.replay.checkpoint_state())
            .unwrap(),
        state: run.state.clone(),
        rng: run.rng.clone(),
    }
}

#[test]
fn a_state_that_cannot_be_right_is_refused() {
    let run = busy();
    let plain = Run::new(&network(strided()), None, settings(), replay_settings());
    let mut sac = Sac::new(run.sac.settings().clone(), &run.policy).unwrap();
    let other = sac.restore(&plain.sac.save());
    assert!(matches!(other, Err(RlError::StateMismatch { .. })));
    for moment in [1, 5] {
        let mut state = run.sac.save();
        let negative = vec![-1.0; state.tensors[moment].1.len()];
        state.tensors[moment].1 = &negative;
        let damaged = sac.restore(&state);
        assert!(matches!(damaged, Err(RlError::InvalidStateNumber { .. })));
    }
}

/// 50 recorded steps a turn, of which 40 are the burn-in: floor(0.25 * recorded after it).
#[test]
fn gradient_steps_follow_the_recorded_steps() {
    let settings = SacSettings { updates_per_step: 0.25, ..settings() };
    let mut run = Run::new(&network(EncoderSettings::Blind), None, settings, replay_settings());
    let mut turn = || {
        run.collect().unwrap();
        let stats = run.sac.update(&mut run.policy, &run.replay, &mut run.rng);
        stats.unwrap().steps
    };
    assert_eq!([turn(), turn(), turn()], [2, 13, 12]);
    // nothing new was recorded, so nothing is due
    assert_eq!(run.sac.gradient_steps_due(run.replay.total_recorded_steps()), 0);
}

#[test]
fn during_the_burn_in_nothing_is_learnt() {
    let mut run = busy();
    let before = run.policy.params().to_vec();
    run.replay = ReplayBuffer::new(replay_settings(), run.env.spec()).unwrap();
    let settings = SacSettings { burn_in: 50, ..settings() };
    run.sac = Sac::new(settings, &run.policy).unwrap();
    run.collect().unwrap();
    let stats = run.sac.update(&mut run.policy, &run.replay, &mut run.rng).unwrap();
    assert_eq!((stats.steps, stats.replay), (0, 50));
    assert_eq!(run.policy.params(), before);
    assert!(stats.metrics().iter().all(|(_, value)| value.is_finite()));
}

#[test]
fn actions_are_uniform_during_the_warm_up_and_the_policys_afterwards() {
    let still = NetworkSettings { log_std: -4.5, ..network(EncoderSettings::Blind) };
    let mut run = Run::new(&still, None, settings(), replay_settings());
    run.collect().unwrap();
    let actions: Vec<f32> = (0..50).flat_map(|i| run.replay.get(i).action().to_vec()).collect();
    let (warm, own) = actions.split_at(2 * 20);
    let spread = |some: &[f32]| some.iter().map(|a| a * a).sum::<f32>() / some.len() as f32;
    assert!(actions.iter().all(|a| a.abs() <= 1.0));
    assert!((0.2..0.5).contains(&spread(warm)), "a third: {}", spread(warm));
    assert!(spread(own) < 0.01, "{}", spread(own));
}

/// An update that is spoilt before it, and what its error names.
fn diverged(spoil: impl Fn(&mut Run)) -> (RlError, bool) {
    let mut run = busy();
    run.collect().unwrap();
    spoil(&mut run);
    let before = bits(run.policy.params());
    let error = run.sac.update(&mut run.policy, &run.replay, &mut run.rng).unwrap_err();
    (error, before == bits(run.policy.params()))
}

#[test]
fn a_network_that_diverged_is_reported_and_left_alone() {
    let (error, untouched) = diverged(|run| {
        let last = run.policy.params().len() - 1;
        run.policy.params_mut()[last] = f32::NAN;
    });
    let what = "the loss of a minibatch";
    assert!(matches!(error, RlError::NotFinite { what: w, .. } if w == what), "{error}");
    assert!(untouched);
    // a finite loss whose gradient is beyond f32
    let (gradient_error, gradient_untouched) = diverged(|run| {
        let critics = run.policy.network().critic_param_range();
        for param in &mut run.policy.params_mut()[critics] {
            *param *= 1e13;
        }
    });
    let norm = "the norm of the gradient";
    assert!(
        matches!(gradient_error, RlError::NotFinite { what: w, .. } if w == norm),
        "{gradient_error}"
    );
    assert!(gradient_untouched);
}

#[test]
fn what_does_not_fit_is_refused() {
    let mut run = busy();
    run.collect().unwrap();
    let other = EnvSpec { image_shape: [16, 16, 2], ..run.env.spec().clone() };
    let foreign = ReplayBuffer::new(replay_settings(), &other).unwrap();
    let result = run.sac.update(&mut run.policy, &foreign, &mut run.rng);
    assert!(matches!(result, Err(RlError::SpecMismatch { field: "image_shape", .. })));
    let mut stranger = SacPolicy::new(&network(strided()), None, run.env.spec(), 0).unwrap();
    let of_stranger = run.sac.update(&mut stranger, &run.replay, &mut run.rng);
    assert!(matches!(of_stranger, Err(RlError::ParameterCountMismatch { .. })));
    let short = SacPolicy::with_params(&network(strided()), None, &other, vec![0.0; 3]);
    assert!(matches!(short, Err(RlError::ParameterCountMismatch { got: 3, .. })));
}

/// Acts with the memory of a policy of these settings on this many environments.
fn act_with(
    fields: usize,
    context: Option<RecurrentContextSettings>,
    envs: usize,
) -> Result<(), RlError> {
    let spec = PointReach::new(ENVS, 1).spec().clone();
    let policy = |width, memory| {
        let network = joint(strided(), width);
        SacPolicy::new(&network, memory, &spec, 2).unwrap()
    };
    let mut memory = policy(fields, context).new_memory(envs);
    let mut out = vec![0.0; 2 * ENVS];
    policy(4, Some(CONTEXT)).mean_actions(&Observations::new(&spec), &mut memory, &mut out)
}

#[test]
fn a_memory_of_another_policy_or_other_environments_is_refused() {
    act_with(4, Some(CONTEXT), ENVS).unwrap();
    let longer = RecurrentContextSettings { length: 4, ..CONTEXT };
    for (result, expected) in [
        (act_with(4, Some(CONTEXT), ENVS - 1), "memory: got 4"),
        (act_with(4, Some(longer), ENVS), "steps of memory: got 4"),
        (act_with(4, None, ENVS), "steps of memory: got 0"),
        (act_with(5, Some(CONTEXT), ENVS), "fields of memory: got"),
    ] {
        let message = result.unwrap_err().to_string();
        assert!(message.starts_with(expected), "{message}");
    }
}

#[test]
fn a_learned_temperature_approaches_the_entropy_that_is_asked_for() {
    let after = |target| {
        let settings = SacSettings {
            temperature: EntropyTemperatureSettings::Learned { initial: 0.1, target },
            learning_rate: 1e-3,
            ..settings()
        };
        let mut run = Run::new(&network(EncoderSettings::Blind), None, settings, replay_settings());
        learn(&mut run, 4);
        run.sac.temperature()
    };
    // a component has less than ln 2 nats in (-1, 1)
    assert!(after(1.0) > 0.1 && after(-5.0) < 0.1);
    let fixed = Run::new(&network(EncoderSettings::Blind), None, settings(), replay_settings());
    assert_eq!(fixed.sac.temperature(), f64::from(0.005f32));
}

fn small_spec() -> EnvSpec {
    PointReach::new(1, 0).spec().clone()
}

fn small_network() -> NetworkSettings {
    NetworkSettings {
        encoder: EncoderSettings::Strided { fields: vec![3, 4] },
        ..NetworkSettings::default()
    }
}

/// A recorded step is part of as many gradients as a decision is in an update of PPO.
#[test]
fn the_default_passes_a_step_as_often_as_ppo_does() {
    let (sac, ppo) = (SacSettings::default(), PpoSettings::default());
    let passes = sac.updates_per_step * sac.batch as f32;
    assert!((passes - ppo.epochs as f32).abs() < 1e-4);
    let smaller = SacSettings { batch: 64, ..sac }.with_update_ratio_of_ppo(&PpoSettings::paper());
    assert_eq!(smaller.updates_per_step, 8.0 / 64.0);
}

#[test]
fn networks_and_contexts_that_do_not_fit_are_refused_by_name() {
    let refused = |settings: &NetworkSettings, context, name: &str| {
        let error = SacPolicy::new(settings, context, &small_spec(), 0).unwrap_err();
        assert!(error.to_string().starts_with(&format!("{name} ")), "{error}");
    };
    let pooled = NetworkSettings { critic: CriticSettings::Pooled { width: 8 }, ..small_network() };
    refused(&pooled, None, "critic.pooled.width");
    let narrow = NetworkSettings { log_std: -5.0, ..small_network() };
    refused(&narrow, None, "log_std");
    let context = |size, length| Some(RecurrentContextSettings { size, length });
    refused(&small_network(), context(30, 5), "context.size");
    refused(&small_network(), context(0, 5), "context.size");
    refused(&small_network(), context(1 << 20, 5), "context.size");
    refused(&small_network(), context(8, 65), "context.length");
}
