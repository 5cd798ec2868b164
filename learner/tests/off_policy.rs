//! Off-policy learners without MuJoCo: they solve toy tasks, separate groups, and continue to the
//! same bits.

use learner::{
    CheckpointExtent, GroupingSettings, IterationReport, Learner, OffPolicyLearner,
    OffPolicySettings,
};
use rl::{
    CriticSettings, EncoderSettings, NetworkSettings, RecurrentContextSettings, SacSettings,
    VectorEnv,
};
use symmetry::Group;

use crate::bars::{Bars, assert_continues_alike, assert_refused, network, number, scratch};
use crate::guess::{EPISODE, Guess};

const ENVS: usize = 16;

/// A method with a network and an update for toys: rollouts of an episode in every environment.
fn toy(method: OffPolicySettings) -> OffPolicySettings {
    OffPolicySettings {
        network: NetworkSettings {
            encoder: EncoderSettings::Blind,
            top_fields: 8,
            vector_fields: 8,
            actor_fields: 8,
            critic: CriticSettings::Joint { fields: 8 },
            ..method.network
        },
        sac: SacSettings {
            gamma: 0.8,
            batch: 64,
            window: 4,
            updates_per_step: 0.2,
            burn_in: 200,
            learning_rate: 3e-3,
            tau: 0.02,
            ..method.sac
        },
        capacity: 4000,
        warm_up: 200,
        still_channels: 0,
        newest_steps: 1000,
        rollout_steps: ENVS * EPISODE,
        ..method
    }
}

/// Mean return of the mean actions after this many iterations.
fn learned(settings: OffPolicySettings, shown: bool, turns: usize) -> f64 {
    let mut env = Guess::new(ENVS, shown, 1);
    let mut learner = OffPolicyLearner::new(settings, env.spec()).unwrap();
    for _ in 0..turns {
        learner.learn(&mut env).unwrap();
    }
    let stats = learner.evaluate_policy(0, &mut env, 4).unwrap().stats;
    stats.mean_return().unwrap()
}

/// Of 8 at most. A policy that stands still gets 8 * (1 - 0.45).
#[test]
fn a_goal_that_is_shown_is_learnt() {
    for method in
        [OffPolicySettings::clear_baseline(), OffPolicySettings::clear_baseline_with_cloning()]
    {
        let run = |turns| learned(toy(method.clone()), true, turns);
        let (frozen, learned) = (run(0), run(30));
        assert!(learned > 7.0, "learned {learned}");
        assert!(frozen < 5.5, "frozen {frozen}");
    }
}

/// Of 8 at most; the first decision of an episode is a guess. Without a context every one is.
#[test]
fn a_goal_that_only_rewards_tell_is_learnt_with_a_context() {
    let context = Some(RecurrentContextSettings { size: 8, length: 2 });
    let remembering = OffPolicySettings { context, ..toy(OffPolicySettings::three_rl_baseline()) };
    let remembering = learned(remembering, false, 40);
    let forgetful = learned(toy(OffPolicySettings::clear_baseline()), false, 40);
    assert!(remembering > 5.0, "remembering {remembering}");
    assert!(forgetful < 2.0, "forgetful {forgetful}");
}

/// Policies of small networks on pictures of bars, sorted by distances; replays that overflow.
fn sorting() -> OffPolicySettings {
    let method = OffPolicySettings::equi_sac();
    OffPolicySettings {
        network: network(CriticSettings::Joint { fields: 4 }),
        sac: SacSettings {
            batch: 16,
            updates_per_step: 0.025,
            burn_in: 100,
            newest_share: 0.5,
            ..method.sac
        },
        capacity: 150,
        warm_up: 50,
        still_channels: 0,
        newest_steps: 60,
        first_frames: 2,
        rollout_steps: 100,
        ..method
    }
}

#[test]
fn every_group_has_a_policy_and_a_replay() {
    let mut env = Bars::new();
    let settings = OffPolicySettings { capacity: 1000, ..sorting() };
    let mut learner = OffPolicyLearner::new(settings, env.spec()).unwrap();
    let turns = env.train(&mut learner, &[0, 0, 1, 1, 0]);
    let each = |figure: fn(&IterationReport) -> usize| turns.iter().map(figure).collect::<Vec<_>>();
    assert_eq!(each(|turn| turn.policy), [0, 0, 1, 1, 0]);
    // a policy is created after a second rollout; the first one is in no replay
    assert_eq!(each(|turn| turn.decisions), [100, 100, 200, 100, 100]);
    let held = each(|turn| number(turn, "replay") as usize);
    assert_eq!(held, [100, 200, 100, 200, 300]);
    // the first hundred decisions of each policy are its burn-in
    let steps = each(|turn| number(turn, "steps") as usize);
    assert_eq!(steps, [0, 2, 0, 2, 3]);
}

#[test]
fn a_saved_learner_continues_alike() {
    let single = OffPolicySettings { grouping: GroupingSettings::Single, ..sorting() };
    let context = Some(RecurrentContextSettings { size: 8, length: 3 });
    assert_continues_alike(sorting(), Bars::new(), "off-policy");
    let mut with_context = OffPolicySettings { context, ..single.clone() };
    with_context.sac.average_rate = Some(0.1);
    assert_continues_alike(with_context, Bars::new(), "off-policy-context");
    for env in Bars::half_blind() {
        assert_continues_alike(single.clone(), env, "off-policy-half-blind");
    }
}

#[test]
fn packed_policies_recognise_and_hold_no_replay() {
    let path = scratch("packed-sac");
    let mut env = Bars::new();
    let mut learner = OffPolicyLearner::new(sorting(), env.spec()).unwrap();
    env.train(&mut learner, &[0, 1]);
    let size = |extent| {
        learner.save(&path, extent, "").unwrap();
        std::fs::metadata(&path).unwrap().len()
    };
    let whole = size(CheckpointExtent::Everything);
    let packed = size(CheckpointExtent::Policies { episodes_per_policy: 20 });
    // both hold the summaries of episodes
    assert!(3 * packed < 2 * whole, "{packed} of {whole}");
    let (mut copy, _) = OffPolicyLearner::load(&path, env.spec()).unwrap();
    std::fs::remove_file(&path).unwrap();
    let recognised = [0, 1].map(|group| env.recognised(&mut copy, group, None));
    assert_eq!(recognised, [Some(0), Some(1)]);
}

/// Way to spoil settings, and a part of the error's message.
type Case = (fn(&mut OffPolicySettings), &'static str);

#[test]
fn settings_out_of_range_are_named() {
    let cases: [Case; 7] = [
        (|s| s.capacity = 0, "capacity"),
        (|s| s.still_channels = 2, "still_channels"),
        (|s| s.sac.window = 3, "window"),
        (|s| s.noise_correlation = 1.0, "noise_correlation"),
        (|s| s.rollout_steps = 7, "`rollout_steps` is 7"),
        (|s| s.rollout_steps = 1000 << 40, "the rollouts"),
        // D2 needs a multiple of four
        (|s| s.context = Some(RecurrentContextSettings { size: 6, length: 2 }), "context.size"),
    ];
    for (spoil, part) in cases {
        let mut settings = sorting();
        settings.network.group = Group::D2;
        spoil(&mut settings);
        assert_refused(OffPolicyLearner::new(settings, Bars::new().spec()), part);
    }
}
