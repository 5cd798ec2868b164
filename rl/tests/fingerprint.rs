#![allow(clippy::unwrap_used, missing_docs, unused)]
mod common;
use common::{EPISODE, PointReach};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rl::*;

fn fnv(words: impl Iterator<Item = u32>) -> u64 {
    words.fold(0xcbf29ce484222325, |h, w| {
        (h ^ u64::from(w)).wrapping_mul(0x100000001b3)
    })
}

#[test]
fn fingerprint() {
    for (encoder, critic) in [
        (
            Encoder::Strided { fields: vec![3, 4] },
            Critic::Joint { fields: 8 },
        ),
        (
            Encoder::Keypoints {
                fields: vec![4],
                maps: 4,
            },
            Critic::Pooled { width: 8 },
        ),
    ] {
        let mut env = PointReach::new(9, 1);
        let network = NetworkSettings {
            encoder,
            critic,
            top_fields: 6,
            ..NetworkSettings::default()
        };
        let mut policy = ActorCriticPolicy::new(&network, env.spec(), 2).unwrap();
        let mut ppo = Ppo::new(PpoSettings::default(), &policy).unwrap();
        let mut buffer = RolloutBuffer::new(env.spec(), EPISODE + 3).unwrap();
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut state = RolloutState::reset(&mut env).unwrap();
        for turn in 0..4 {
            let stats = collect(&mut env, &mut policy, &mut buffer, &mut state, &mut rng).unwrap();
            if turn == 2 {
                let mut other = ActorCriticPolicy::new(&network, env.spec(), 7).unwrap();
                buffer.revalue(&mut other).unwrap();
                ppo = Ppo::new(PpoSettings::default(), &other).unwrap();
                policy = other;
            }
            let update = ppo.update(&mut policy, &buffer, &mut rng).unwrap();
            println!(
                "FP {turn} {:016x} {} {:?} {} {}",
                fnv(policy.params().iter().map(|p| p.to_bits())),
                update.approx_kl,
                stats.mean_return(),
                update.grad_norm,
                update.explained_variance
            );
        }
        let eval = evaluate(&mut PointReach::new(9, 4), &mut policy, 2).unwrap();
        println!(
            "FP eval {:?} {:?} {}",
            eval.mean_return(),
            eval.success_rate(),
            rng.random::<u64>()
        );
    }
}
