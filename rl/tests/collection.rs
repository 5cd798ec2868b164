//! Collection and evaluation in an environment whose every step is written down.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rl::{
    Actor, ActorCriticPolicy, BoxError, Encoder, EnvSpec, NetworkSettings, Observations, Outcome,
    RlError, RolloutBuffer, RolloutState, Transition, VectorEnv, collect, evaluate,
};
use symmetry::Irrep;

/// Two environments with episodes of three steps. Success holds within the last step of both, but
/// at its end in the second alone.
struct Scripted {
    spec: EnvSpec,
    time: usize,
    fails: bool,
}

impl Scripted {
    fn new() -> Self {
        let spec = EnvSpec {
            num_envs: 2,
            image: [4, 4, 1],
            vector: vec![Irrep::X],
            action: vec![Irrep::X],
        };
        Self {
            spec,
            time: 0,
            fails: false,
        }
    }
}

#[derive(Debug, thiserror::Error)]
#[error("the table fell over")]
struct FellOver;

impl VectorEnv for Scripted {
    fn spec(&self) -> &EnvSpec {
        &self.spec
    }

    fn reset(&mut self, _: &mut Observations) -> Result<(), BoxError> {
        self.time = 0;
        Ok(())
    }

    fn step(&mut self, _: &[f32], out: &mut Transition) -> Result<(), BoxError> {
        if self.fails {
            return Err(FellOver.into());
        }
        self.time = self.time % 3 + 1;
        out.success = vec![self.time == 3; 2];
        out.success_at_end = vec![false, self.time == 3];
        out.outcomes.fill(match self.time {
            3 => Outcome::Terminated,
            _ => Outcome::Running,
        });
        Ok(())
    }
}

fn policy() -> ActorCriticPolicy {
    let settings = NetworkSettings {
        encoder: Encoder::Strided { fields: vec![2] },
        ..NetworkSettings::default()
    };
    ActorCriticPolicy::new(&settings, &Scripted::new().spec, 1).unwrap()
}

fn boxed() -> Box<dyn VectorEnv> {
    Box::new(Scripted::new())
}

#[test]
fn success_at_the_end_is_that_of_the_last_state() {
    let mut env = boxed();
    let mut buffer = RolloutBuffer::new(env.spec(), 3).unwrap();
    let mut state = RolloutState::reset(&mut *env, &policy()).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let stats = collect(&mut *env, &mut policy(), &mut buffer, &mut state, &mut rng).unwrap();
    let evaluated = evaluate(&mut *env, &mut policy(), 2).unwrap();
    for stats in [stats, evaluated] {
        assert_eq!(stats.success_rate(), Some(1.0));
        assert_eq!(stats.success_at_end_rate(), Some(0.5));
        assert!(
            stats
                .episodes
                .iter()
                .all(|e| e.success_at_end == (e.env == 1))
        );
    }
}

#[test]
fn the_error_of_an_environment_is_handed_on() {
    let mut env = Scripted::new();
    env.fails = true;
    let error = evaluate(&mut env, &mut policy(), 1).unwrap_err();
    assert!(matches!(&error, RlError::Environment(inner) if inner.is::<FellOver>()));
    assert_eq!(
        error.to_string(),
        "the environment failed: the table fell over"
    );
}

/// What the actions of two rollouts of four steps were drawn with: `[T, N]` numbers, from actions,
/// means and standard deviations. The observations never change, so the means do not.
fn noise(correlation: f32) -> Vec<f64> {
    let (mut env, mut policy) = (boxed(), policy());
    let buffer = RolloutBuffer::new(env.spec(), 4).unwrap();
    let mut buffer = buffer.with_noise_correlation(correlation).unwrap();
    let mut state = RolloutState::reset(&mut *env, &policy).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let mut means = [0.0; 2];
    let (seen, memory) = (Observations::new(env.spec()), &mut ());
    policy.mean_actions(&seen, memory, &mut means).unwrap();
    let std = f64::from(policy.log_std()[0]).exp();
    let mut out = Vec::new();
    for _ in 0..2 {
        collect(&mut *env, &mut policy, &mut buffer, &mut state, &mut rng).unwrap();
        let actions = &buffer.decisions().actions;
        let noise = |(i, &a): (usize, &f32)| (f64::from(a) - f64::from(means[i % 2])) / std;
        out.extend(actions.iter().enumerate().map(noise));
    }
    out
}

/// Episodes end with the third step, and a rollout begins with the fifth of all.
#[test]
fn the_noise_of_an_episode_goes_on_and_that_of_the_next_begins_afresh() {
    let (fresh, kept) = (noise(0.0), noise(0.6));
    let mut expected = [0.0; 2];
    for t in 0..8 {
        for n in 0..2 {
            let (fresh, kept) = (fresh[2 * t + n], kept[2 * t + n]);
            expected[n] = match [0, 3, 4, 6].contains(&t) {
                true => fresh,
                false => 0.6 * expected[n] + 0.8 * fresh,
            };
            assert!((kept - expected[n]).abs() < 1e-5, "step {t}: {kept}");
        }
    }
}
