//! Networks in half precision: an error where the processor lacks it, and rounding where it does
//! not.

use equivariant::Half;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rl::{
    ActorCriticPolicy, Algorithm, Encoder, NetworkSettings, Ppo, PpoSettings, RlError,
    RolloutBuffer, RolloutState, VectorEnv, collect,
};

use crate::common::PointReach;

fn settings(half: bool) -> NetworkSettings {
    NetworkSettings {
        encoder: Encoder::Strided { fields: vec![3, 4] },
        half,
        ..NetworkSettings::default()
    }
}

/// The parameters before an update and after it.
fn updated(half: bool) -> Result<[Vec<f32>; 2], RlError> {
    let mut env = PointReach::new(3, 1);
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut policy = ActorCriticPolicy::new(&settings(half), env.spec(), 2)?;
    let before = policy.params().to_vec();
    let mut buffer = RolloutBuffer::new(env.spec(), 20)?;
    let mut state = RolloutState::reset(&mut env, &policy)?;
    collect(&mut env, &mut policy, &mut buffer, &mut state, &mut rng)?;
    // one step, whose gradient is that of the first parameters
    let ppo = PpoSettings {
        epochs: 1,
        minibatch: 60,
        ..PpoSettings::default()
    };
    Ppo::new(ppo, &policy)?.update(&mut policy, &buffer, &mut rng)?;
    Ok([before, policy.params().to_vec()])
}

#[test]
fn half_precision_changes_an_update_by_its_rounding_or_is_refused() {
    if Half::available().is_none() {
        let error = updated(true).unwrap_err();
        assert!(matches!(error, RlError::NoHalf), "{error:?}");
        assert!(error.to_string().contains("set `half` to false"), "{error}");
        return;
    }
    let ([before, single], [same, half]) = (updated(false).unwrap(), updated(true).unwrap());
    assert_eq!(before, same);
    let moved = |after: &[f32]| {
        let moved = after.iter().zip(&before).map(|(a, b)| f64::from(a - b));
        moved.collect::<Vec<_>>()
    };
    let (single, half) = (moved(&single), moved(&half));
    let dot = |a: &[f64], b: &[f64]| a.iter().zip(b).map(|(a, b)| a * b).sum::<f64>();
    let cosine = dot(&single, &half) / (dot(&single, &single) * dot(&half, &half)).sqrt();
    assert!(cosine > 0.9, "{cosine}");
    assert_ne!(single, half);
}
