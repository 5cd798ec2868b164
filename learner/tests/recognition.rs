//! From how few episodes a learner recognises a group, on a toy environment.

use learner::{Covers, CoversSettings, GroupingSettings, Learner};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rl::{EncoderSettings, NetworkSettings, PpoSettings, VectorEnv};

use crate::bars::Bars;

fn settings(grouping: GroupingSettings) -> CoversSettings {
    CoversSettings {
        network: NetworkSettings {
            encoder: EncoderSettings::Strided { fields: vec![4, 8] },
            top_fields: 8,
            vector_fields: 4,
            actor_fields: 4,
            ..NetworkSettings::default()
        },
        ppo: PpoSettings { epochs: 1, minibatch: 20, ..PpoSettings::default() },
        grouping,
        rollout_steps: 100,
        ..CoversSettings::default()
    }
}

/// A learner that met these groups.
fn after(grouping: GroupingSettings, groups: &[usize]) -> Covers {
    let mut env = Bars::new();
    let mut covers = Covers::new(settings(grouping), env.spec()).unwrap();
    for &group in groups {
        env.group = group;
        covers.learn(&mut env).unwrap();
    }
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

fn groupings() -> [GroupingSettings; 2] {
    let evidence = GroupingSettings::Evidence(evidence::RecogniserSettings::default());
    [GroupingSettings::default(), evidence]
}

#[test]
fn known_groups_are_recognised_from_one_episode() {
    for grouping in groupings() {
        let mut covers = after(grouping, &[0, 1, 0, 1]);
        assert_eq!(covers.policy_count(), 2);
        for group in [0, 1] {
            let named = [1, 4, 20].map(|episodes| named(&mut covers, group, episodes));
            assert_eq!(named, [Some(group); 3], "{grouping:?}");
        }
    }
}

#[test]
fn many_episodes_can_say_that_no_policy_fits() {
    for grouping in groupings() {
        let mut covers = after(grouping, &[0, 0, 0]);
        assert_eq!(named(&mut covers, 0, 20), Some(0), "{grouping:?}");
        assert_eq!(named(&mut covers, 1, 20), None, "{grouping:?}");
    }
}
