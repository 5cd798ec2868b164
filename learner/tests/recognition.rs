//! From how few episodes a learner recognises a group, on a toy environment.

use learner::{Covers, CoversSettings, Learner};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rl::{CriticSettings, PpoSettings, VectorEnv};

use crate::bars::{Bars, network};

/// A learner that met these groups.
fn after(groups: &[usize]) -> Covers {
    let mut env = Bars::new();
    let settings = CoversSettings {
        network: network(CriticSettings::Pooled { width: 8 }),
        ppo: PpoSettings { epochs: 1, minibatch: 20, ..PpoSettings::default() },
        rollout_steps: 100,
        ..CoversSettings::default()
    };
    let mut covers = Covers::new(settings, env.spec()).unwrap();
    env.teach(&mut covers, groups);
    covers
}

/// Answer for a group, which must be the same a second time.
fn named(covers: &mut Covers, group: usize, episodes: usize) -> Option<usize> {
    let mut ask = || {
        let mut env = Bars::new();
        env.group = group;
        let mut rng = ChaCha8Rng::seed_from_u64(9);
        let answer = covers.recognise_policy(&mut env, Some(episodes), &mut rng);
        answer.unwrap().named()
    };
    let first = ask();
    assert_eq!(ask(), first);
    first
}

#[test]
fn known_groups_are_recognised_from_one_episode() {
    let mut covers = after(&[0, 1, 0, 1]);
    assert_eq!(covers.policy_count(), 2);
    for group in [0, 1] {
        let named = [1, 4, 20].map(|episodes| named(&mut covers, group, episodes));
        assert_eq!(named, [Some(group); 3]);
    }
}

#[test]
fn many_episodes_can_say_that_no_policy_fits() {
    let mut covers = after(&[0, 0, 0]);
    assert_eq!(named(&mut covers, 0, 20), Some(0));
    assert_eq!(named(&mut covers, 1, 20), None);
}
