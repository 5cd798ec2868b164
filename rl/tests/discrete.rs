//! Discrete actions: choices that flips exchange, training in few and many environments, refusals.

use Irrep::{Trivial, X, XY, Y};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rl::{
    ActorCriticPolicy, Algorithm, Decisions, EncoderSettings, EnvSpec, EvaluateActions,
    ExportPolicy, NetworkSettings, Observations, Ppo, PpoSettings, ReplayBuffer, ReplaySettings,
    RlError, SacPolicy, SymmetryLossSettings, VectorEnv, check_env_symmetry, evaluate_policy,
};
use symmetry::{D2, Group, Irrep};

use crate::common::steps::{OnPolicyRun, joint, transform_vector};
use crate::common::toy::{Toy, Toys};

/// Two decisions: left, right or neither, and one of the four quadrants.
fn spec(num_envs: usize) -> EnvSpec {
    EnvSpec {
        num_envs,
        image_shape: EnvSpec::NO_IMAGE,
        vector_irreps: vec![X, Y],
        action_irreps: vec![Trivial, X, Trivial, Trivial, X, Y, XY],
        choices: vec![3, 4],
    }
}

/// Points whose side and quadrant are the right choices. An episode is one decision.
struct Sides {
    points: Vec<[f32; 2]>,
    rng: ChaCha8Rng,
}

impl Sides {
    fn envs(num_envs: usize) -> Toys<Self> {
        let rng = ChaCha8Rng::seed_from_u64(1);
        Toys::of(Self { points: vec![[0.0; 2]; num_envs], rng }, spec(num_envs))
    }
}

impl Toy for Sides {
    const EPISODE: usize = 1;

    fn restart(&mut self, n: usize) {
        self.points[n] = std::array::from_fn(|_| self.rng.random_range(-1.0..1.0));
    }

    fn observe(&self, n: usize, out: &mut Observations) {
        out.vectors[2 * n..2 * n + 2].copy_from_slice(&self.points[n]);
    }

    fn act(&mut self, n: usize, action: &[f32]) -> (f32, bool) {
        let [x, y] = self.points[n].map(|coordinate| usize::from(coordinate < 0.0));
        let chosen = spec(1).choice_indices(action);
        let right = usize::from(chosen[0] == x) + usize::from(chosen[1] == x + 2 * y);
        (right as f32, right == 2)
    }
}

#[test]
#[should_panic(expected = "expected the one-hot vector of a choice")]
fn probabilities_are_no_choice() {
    let mut action = vec![0.0; spec(1).action_irreps.len()];
    action[..2].copy_from_slice(&[0.3, 0.7]);
    spec(1).choice_indices(&action);
}

/// Transforms a one-hot action: flips exchange left and right, and move the quadrants.
fn moved(g: D2, action: &[f32]) -> Vec<f32> {
    let flips = |irrep: Irrep| usize::from(irrep.sign(g) < 0);
    let mut out = vec![0.0; 7];
    for (i, &a) in action.iter().enumerate() {
        let to = match i {
            0 | 1 => i ^ flips(X),
            2 => 2,
            _ => 3 + ((i - 3) ^ (flips(X) + 2 * flips(Y))),
        };
        out[to] = a;
    }
    out
}

#[test]
fn mirrored_choices_are_as_likely_in_mirrored_states() {
    let (spec, action) = (spec(1), [0.0, 1.0, 0.0, 0.0, 1.0, 0.0, 0.0]);
    for group in Group::ALL {
        let network =
            NetworkSettings { group, action_gain: 1.0, ..joint(EncoderSettings::Blind, 3) };
        let mut policy = ActorCriticPolicy::new(&network, &spec, 2).unwrap();
        let mut log_prob = |g: D2| {
            let mut observations = Observations::new(&spec);
            observations.vectors = transform_vector(&[0.7, -0.4], &[X, Y], g);
            let mut decisions = Decisions { actions: moved(g, &action), ..Decisions::new(&spec) };
            policy.evaluate_actions(&observations, &mut decisions).unwrap();
            decisions.log_probs[0]
        };
        let own = log_prob(D2::Identity);
        for g in D2::ALL {
            let is_equal = (log_prob(g) - own).abs() < 1e-5;
            assert_eq!(is_equal, group.elements().contains(&g), "{group} {g}");
        }
    }
}

#[test]
fn choices_are_learnt_in_one_environment_and_in_64() {
    for envs in [1, 64] {
        let env = Sides::envs(envs);
        let policy = ActorCriticPolicy::new(&joint(EncoderSettings::Blind, 4), env.spec(), 2);
        let mut run = OnPolicyRun::new(env, policy.unwrap(), 512 / envs);
        let mut ppo = Ppo::new(PpoSettings::default(), &run.policy).unwrap();
        let first = run.collect().success_rate().unwrap();
        for _ in 0..20 {
            run.collect();
            let stats = ppo.update(&mut run.policy, &run.buffer, &mut run.rng).unwrap();
            assert!(stats.log_std.is_empty() && stats.entropy > 0.0);
        }
        let last = evaluate_policy(&mut run.env, &mut run.policy, 512 / envs).unwrap();
        let success = last.success_rate().unwrap();
        assert!(first < 0.2 && success > 0.9, "{envs} environments: {first} {success}");
    }
}

#[test]
fn a_diverged_policy_is_found_in_an_evaluation() {
    let network = joint(EncoderSettings::Blind, 2);
    let mut policy = ActorCriticPolicy::new(&network, &spec(2), 0).unwrap();
    policy.params_mut().fill(f32::NAN);
    let error = evaluate_policy(&mut Sides::envs(2), &mut policy, 1).unwrap_err();
    assert!(matches!(error, RlError::NotFinite { .. }), "{error}");
}

#[test]
fn the_check_of_irreps_knows_choices() {
    let check = |irreps: &[Irrep]| {
        let mut env = Sides::envs(100).declaring(&[X, Y], irreps);
        check_env_symmetry(&mut env, Group::D2, 10, &mut ChaCha8Rng::seed_from_u64(0))
    };
    check(&spec(1).action_irreps).unwrap();
    let wrong = check(&[Trivial, Y, Trivial, Trivial, X, Y, XY]).unwrap_err();
    assert!(wrong.to_string().contains("action component"), "{wrong}");
}

#[test]
fn what_takes_continuous_actions_alone_and_choices_that_do_not_fit_are_refused() {
    let network = joint(EncoderSettings::Blind, 2);
    let message = SacPolicy::new(&network, None, &spec(1), 0).unwrap_err().to_string();
    assert!(message.starts_with("soft actor-critic supports only continuous actions"), "{message}");
    let policy = ActorCriticPolicy::new(&network, &spec(1), 0).unwrap();
    let symmetry = Some(SymmetryLossSettings::default());
    let refused = Ppo::new(PpoSettings { symmetry, ..PpoSettings::default() }, &policy);
    assert!(matches!(refused, Err(RlError::DiscreteActions { .. })));
    assert!(matches!(policy.export(), Err(RlError::NotExportable { .. })));
    // a warm-up would draw numbers that are no choices
    let random = ReplayBuffer::new(ReplaySettings::default(), &spec(1));
    assert!(matches!(random, Err(RlError::DiscreteActions { .. })));
    let replay = ReplayBuffer::new(ReplaySettings { warm_up: 0, ..Default::default() }, &spec(1));
    assert!(replay.is_ok());
    for choices in [vec![7], vec![3, 3], vec![0, 3, 4], vec![1, 6]] {
        let wrong = EnvSpec { choices, ..spec(1) };
        // one choice of seven is well-formed
        assert_eq!(wrong.check().is_err(), wrong.choices.len() > 1, "{:?}", wrong.choices);
    }
    let unordered = EnvSpec { action_irreps: vec![Trivial, X, Y], choices: vec![3], ..spec(1) };
    assert!(unordered.check().is_err());
}
