//! One update: first-minibatch identities, reproducibility on any number of threads, and refusals.

use rl::{
    Actor, ActorCriticPolicy, Algorithm, Decisions, EncoderSettings, EnvSpec, Metrics,
    NetworkSettings, OnPolicyActor, Ppo, PpoSettings, PpoStats, RlError, RolloutBuffer,
    SymmetryLossSettings, VectorEnv, evaluate_policy,
};
use symmetry::Group;

use crate::common::steps::OnPolicyRun;
use crate::common::{EPISODE, PointReach};

const ENVS: usize = 9;

type Run = OnPolicyRun<PointReach, ActorCriticPolicy>;

fn settings() -> NetworkSettings {
    NetworkSettings {
        encoder: EncoderSettings::Strided { fields: vec![3, 4] },
        top_fields: 6,
        ..NetworkSettings::default()
    }
}

/// Returns a fresh policy that is equivariant under `group`, before its first rollout.
fn fresh(group: Group) -> Run {
    let env = PointReach::new(ENVS, 1);
    let network = NetworkSettings { group, ..settings() };
    let policy = ActorCriticPolicy::new(&network, env.spec(), 2).unwrap();
    OnPolicyRun::new(env, policy, EPISODE + 3)
}

/// Returns a fresh policy that is equivariant under `group`, with one rollout.
fn rollout_of(group: Group) -> Run {
    let mut run = fresh(group);
    run.collect();
    run
}

fn rollout() -> Run {
    rollout_of(Group::D2)
}

fn updated(group: Group, settings: PpoSettings) -> (Vec<f32>, PpoStats) {
    let mut run = rollout_of(group);
    let mut ppo = Ppo::new(settings, &run.policy).unwrap();
    let stats = ppo.update(&mut run.policy, &run.buffer, &mut run.rng).unwrap();
    (run.policy.params().to_vec(), stats)
}

/// Settings with a symmetry loss of this weight, whose updates no KL divergence ends.
fn symmetrised(weight: f32) -> PpoSettings {
    PpoSettings {
        symmetry: Some(SymmetryLossSettings { group: Group::D2, weight }),
        max_kl: 1e9,
        ..PpoSettings::default()
    }
}

/// The symmetry loss of a plain policy's rollout after an update with this weight of it, and the
/// number of gradient steps of that update.
fn asymmetry(weight: f32) -> (f64, usize) {
    let Run { mut policy, buffer, mut rng, .. } = rollout_of(Group::C1);
    let mut ppo = Ppo::new(symmetrised(weight), &policy).unwrap();
    let steps = ppo.update(&mut policy, &buffer, &mut rng).unwrap().steps;
    // what the next update finds before its first step
    let first = PpoSettings { epochs: 1, minibatch: buffer.num_samples(), ..symmetrised(0.0) };
    let mut single_step = Ppo::new(first, &policy).unwrap();
    let stats = single_step.update(&mut policy, &buffer, &mut rng).unwrap();
    (stats.symmetry_loss.unwrap(), steps)
}

#[test]
fn a_symmetry_loss_makes_a_plain_policy_more_symmetric() {
    let ((without, steps), (with, as_many)) = (asymmetry(0.0), asymmetry(1.0));
    assert!(with < without / 2.0, "{without} {with}");
    assert_eq!(steps, as_many);
}

#[test]
fn an_update_without_a_symmetry_loss_reports_none() {
    let (_, stats) = updated(Group::D2, PpoSettings::default());
    assert_eq!(stats.symmetry_loss, None);
    assert!(stats.metrics().iter().all(|(name, _)| name != "symmetry_loss"));
}

#[test]
fn a_rollout_reports_the_episodes_that_ended() {
    let stats = fresh(Group::D2).collect();
    assert_eq!((stats.decisions, stats.episodes.len()), (ENVS * (EPISODE + 3), ENVS));
    assert!(stats.episodes.iter().all(|e| e.length == EPISODE));
    let mean = stats.episodes.iter().map(|e| e.total_reward).sum::<f64>() / ENVS as f64;
    assert_eq!(stats.mean_return(), Some(mean));
    assert!(stats.success_at_end_rate() <= stats.success_rate());
}

#[test]
fn an_evaluation_runs_whole_episodes_with_the_mean_action() {
    let mut policy = rollout().policy;
    let mut run = || evaluate_policy(&mut PointReach::new(ENVS, 4), &mut policy, 2).unwrap();
    let stats = run();
    assert_eq!((stats.decisions, stats.episodes.len()), (2 * ENVS * EPISODE, 2 * ENVS));
    assert!(stats.episodes.iter().all(|e| e.length == EPISODE));
    assert_eq!(stats, run(), "no noise, hence the same episodes");
}

/// Steps of size almost zero leave the ratio at 1 in every minibatch.
#[test]
fn the_ratio_starts_at_one() {
    let still = PpoSettings {
        head_learning_rate: 1e-30,
        encoder_learning_rate: 1e-30,
        ..PpoSettings::default()
    };
    let (params, stats) = updated(Group::D2, still);
    let start = rollout().policy;
    assert!(params.iter().zip(start.params()).all(|(a, b)| (a - b).abs() < 1e-20));
    assert!(stats.approx_kl.abs() < 1e-9 && stats.clip_fraction == 0.0, "{stats:?}");
    assert!(stats.policy_loss.abs() < 1e-4, "{stats:?}");
    assert_eq!(stats.epochs, PpoSettings::default().epochs);
}

#[test]
fn the_divergence_limit_stops_the_update() {
    let fast = PpoSettings { head_learning_rate: 0.1, ..PpoSettings::default() };
    let (_, stats) = updated(Group::D2, fast);
    assert!(stats.epochs < PpoSettings::default().epochs, "{stats:?}");
    let (_, patient) = updated(
        Group::D2,
        PpoSettings { max_kl: 1e9, head_learning_rate: 0.1, ..PpoSettings::default() },
    );
    assert_eq!(patient.epochs, PpoSettings::default().epochs);
    assert!(patient.approx_kl > 0.075 && patient.clip_fraction > 0.0, "{patient:?}");
}

/// The floor is where the standard deviations start, and without it they fall.
#[test]
fn exploration_stays_above_its_floor() {
    let narrowing = |min_log_std| {
        let settings = PpoSettings {
            head_learning_rate: 0.05,
            entropy_weight: 0.0,
            max_kl: 1e9,
            min_log_std,
            ..PpoSettings::default()
        };
        updated(Group::D2, settings).1.log_std
    };
    let free = narrowing(-10.0);
    let lowest = free.iter().copied().fold(0.0, f32::min);
    assert!(lowest < -0.55, "{free:?}");
    let held = narrowing(-0.5);
    assert!(held.iter().all(|&s| s >= -0.5), "{held:?}");
    // a floor that is never met changes nothing
    assert_eq!(free, narrowing(-9.0));
}

/// Such a policy would collect below the floor and jump to it at the first step.
#[test]
fn a_policy_that_starts_below_the_floor_is_refused_with_both_numbers() {
    let policy = rollout().policy;
    let with_floor = |min_log_std| {
        let settings = PpoSettings { min_log_std, ..PpoSettings::default() };
        Ppo::new(settings, &policy)
    };
    assert!(with_floor(-0.5).is_ok());
    let message = with_floor(-0.25).unwrap_err().to_string();
    for part in ["log_std = -0.5", "min_log_std = -0.25"] {
        assert!(message.contains(part), "{message}");
    }
}

#[test]
fn the_figures_of_an_update_have_names() {
    let (params, stats) = updated(Group::D2, PpoSettings::default());
    let metrics = stats.metrics();
    let names: Vec<&str> = metrics.iter().map(|(name, _)| name.as_str()).collect();
    let expected = "policy_loss value_loss entropy approx_kl clip_fraction explained_variance \
                    grad_norm steps epochs log_std_0 log_std_1";
    assert_eq!(names, expected.split(' ').collect::<Vec<_>>());
    assert_eq!(metrics[3].1, stats.approx_kl);
    let last = f64::from(params[params.len() - 1]);
    assert!(metrics[10].1 == last && last != -0.5, "{last}");
}

#[test]
fn one_and_two_threads_give_the_same_bits() {
    for (group, settings) in [(Group::D2, PpoSettings::default()), (Group::C1, symmetrised(0.1))] {
        let on = |threads| {
            let pool = rayon::ThreadPoolBuilder::new().num_threads(threads).build().unwrap();
            pool.install(|| updated(group, settings.clone()))
        };
        let ((one, one_stats), (two, two_stats)) = (on(1), on(2));
        assert_eq!(one_stats, two_stats);
        assert!(one.iter().zip(&two).all(|(a, b)| a.to_bits() == b.to_bits()));
        assert_ne!(one, rollout_of(group).policy.params());
    }
}

#[test]
fn a_saved_optimiser_continues_to_the_same_bits() {
    let Run { mut policy, buffer, rng, .. } = rollout();
    let mut ppo = Ppo::new(PpoSettings::default(), &policy).unwrap();
    ppo.update(&mut policy, &buffer, &mut rng.clone()).unwrap();
    let mut restored =
        ActorCriticPolicy::with_params(&settings(), buffer.spec(), policy.params().to_vec())
            .unwrap();
    let mut resumed = Ppo::new(PpoSettings::default(), &restored).unwrap();
    resumed.restore(&ppo.save()).unwrap();
    ppo.update(&mut policy, &buffer, &mut rng.clone()).unwrap();
    resumed.update(&mut restored, &buffer, &mut rng.clone()).unwrap();
    assert_eq!(policy.params(), restored.params());
}

#[test]
fn log_probabilities_are_those_of_the_actions_taken() {
    let Run { mut policy, buffer, .. } = rollout();
    let mut means = vec![0.0; 2 * buffer.num_samples()];
    policy.mean_actions(buffer.observations(), &mut (), &mut means).unwrap();
    let decisions = buffer.decisions();
    for i in 0..buffer.num_samples() {
        let density: f32 = (2 * i..2 * i + 2)
            .map(|j| {
                let z = (decisions.actions[j] - means[j]) / (-0.5f32).exp();
                -0.5 * z * z + 0.5 - 0.5 * std::f32::consts::TAU.ln()
            })
            .sum();
        assert!((density - decisions.log_probs[i]).abs() < 1e-4, "{i}");
    }
}

#[test]
fn what_does_not_fit_is_refused() {
    let Run { mut policy, mut buffer, mut rng, .. } = rollout();
    let mut ppo = Ppo::new(PpoSettings::default(), &policy).unwrap();
    let mut short = Decisions { actions: vec![0.0; 3], ..Decisions::new(buffer.spec()) };
    let observations = rl::Observations::new(buffer.spec());
    let result = policy.decide(&observations, &mut (), &[0.0; 18], &mut short);
    assert!(matches!(
        result,
        Err(RlError::ShapeMismatch { what: "actions", got: 3, expected: 18, .. })
    ));
    buffer.clear();
    let cleared = ppo.update(&mut policy, &buffer, &mut rng);
    assert!(matches!(cleared, Err(RlError::BufferNotFinished { got: 0, .. })));
    let other = EnvSpec { image_shape: [16, 16, 2], ..buffer.spec().clone() };
    let mut stranger = ActorCriticPolicy::new(&settings(), &other, 0).unwrap();
    assert!(matches!(
        ppo.update(&mut stranger, &buffer, &mut rng),
        Err(RlError::ParameterCountMismatch { .. })
    ));
    let foreign = RolloutBuffer::new(&other, 1).unwrap();
    let of_foreign = ppo.update(&mut policy, &foreign, &mut rng);
    assert!(matches!(of_foreign, Err(RlError::SpecMismatch { field: "image_shape", .. })));
}

#[test]
fn a_network_that_diverged_is_reported() {
    let Run { mut policy, buffer, mut rng, .. } = rollout();
    let mut ppo = Ppo::new(PpoSettings::default(), &policy).unwrap();
    let value_bias = policy.params().len() - 3;
    policy.params_mut()[value_bias] = f32::NAN;
    assert!(matches!(ppo.update(&mut policy, &buffer, &mut rng), Err(RlError::NotFinite { .. })));
    let saved = policy.params().to_vec();
    let loaded = ActorCriticPolicy::with_params(&settings(), buffer.spec(), saved);
    assert!(matches!(loaded, Err(RlError::NotFinite { what: "a parameter", .. })));
}
