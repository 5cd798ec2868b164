//! What is drawn is what the kinds promise.

#![allow(clippy::unwrap_used)]

use std::collections::BTreeSet;

use rl::{Observations, Transition, VectorEnv};
use symmetry::D2;
use worlds::{
    GroupVisit, SceneSettings, StreamError, TaskGroup, TaskGroupProperty, TaskStream, World,
    WorldKind,
};

const SEEDS: std::ops::Range<u64> = 1000..1020;

fn visits(groups: &[usize], rounds: usize) -> Vec<GroupVisit> {
    groups.iter().map(|&group| GroupVisit::new(group, rounds)).collect()
}

/// Returns each property of a group as text; offset and radius are the target's and the reward's.
fn properties(group: &TaskGroup) -> [(TaskGroupProperty, String); 7] {
    let look = &group.appearance;
    [
        (TaskGroupProperty::Colour, format!("{:?}", look.colour)),
        (TaskGroupProperty::Shape, format!("{:?}", look.shape)),
        (TaskGroupProperty::Form, format!("{:?}", (look.half_size, look.texture, look.num_copies))),
        (TaskGroupProperty::Ground, format!("{:?}", group.ground_tint)),
        (TaskGroupProperty::Target, format!("{:?}", group.reward.offset)),
        (TaskGroupProperty::Reward, format!("{:?}", group.reward.radius)),
        (TaskGroupProperty::Dynamics, format!("{:?}", group.dynamics)),
    ]
}

#[test]
fn equal_seeds_draw_equal_worlds_and_groups_differ_where_their_kind_says() {
    for kind in WorldKind::ALL {
        let mut seen = BTreeSet::new();
        for seed in SEEDS {
            let world = World::random(kind, seed);
            assert_eq!(world, World::random(kind, seed));
            assert_ne!(world, World::random(kind, seed + 1));
            for (i, group) in world.groups.iter().enumerate() {
                for other in &world.groups[..i] {
                    let both = properties(group).into_iter().zip(properties(other));
                    let differ = both.filter(|(a, b)| a != b).map(|(one, _)| one.0);
                    let differ: Vec<TaskGroupProperty> = differ.collect();
                    // two groups may share some of a long list of properties, not all
                    let few = kind.varying_properties().len() <= 2;
                    assert!(
                        differ == kind.varying_properties() || !few && !differ.is_empty(),
                        "{kind:?}"
                    );
                    seen.extend(differ);
                }
            }
        }
        assert!(seen.iter().eq(kind.varying_properties()), "{kind:?} {seen:?}");
        for number in [2, 16] {
            let world = World::random_with_num_groups(kind, 1000, number);
            assert!((2..=number).contains(&world.groups.len()));
        }
    }
}

fn mean_reward(world: &World, of_group: usize, as_group: usize) -> f32 {
    let mut stream = TaskStream::new(world.clone(), visits(&[of_group], 9), 4).unwrap();
    let mut transition = Transition::new(stream.spec());
    stream.reset(&mut transition.observations).unwrap();
    let mut sum = 0.0;
    for _ in 0..100 {
        let actions: Vec<f32> =
            (0..4).flat_map(|env| stream.expert_action(env, as_group)).collect();
        stream.step(&actions, &mut transition).unwrap();
        sum += transition.rewards.iter().sum::<f32>() / 400.0;
    }
    sum / world.scene_in_round(0, 0).reward_scale
}

#[test]
fn experts_have_high_rewards_in_their_own_group_alone_where_rewards_differ() {
    for kind in WorldKind::ALL {
        for seed in SEEDS.take(3) {
            let world = World::random(kind, seed);
            let own = mean_reward(&world, 0, 0);
            assert!(own > 0.4, "{} {seed} {own}", kind.name());
            if matches!(kind, WorldKind::Target | WorldKind::Reward) {
                let other = mean_reward(&world, 0, 1);
                assert!(other < 0.6 * own, "{} {seed}: {other} {own}", kind.name());
            }
        }
    }
}

/// Returns each part of a scene as text, with the kind in which it changes.
fn parts(scene: &SceneSettings) -> [(WorldKind, String); 5] {
    [
        (WorldKind::ChangingGround, format!("{:?}", scene.ground)),
        (WorldKind::ChangingLight, format!("{:?}", scene.brightness)),
        (WorldKind::RisingNoise, format!("{:?}", scene.noise_amplitude)),
        (WorldKind::MovingObject, format!("{:?}", scene.object_range)),
        (WorldKind::RescaledReward, format!("{:?}", scene.reward_scale)),
    ]
}

#[test]
fn nothing_but_the_nuisance_changes_with_time() {
    for kind in WorldKind::ALL {
        let world = World::random(kind, 1000);
        let first = world.scene_in_round(0, 0);
        for (round, visit) in [(100, 3), (300, 9)] {
            let later = world.scene_in_round(round, visit);
            let is_constant = parts(&first).iter().all(|(changing, _)| *changing != kind);
            assert_eq!(later == first, is_constant, "{kind:?}");
            for ((changing, before), (_, after)) in parts(&first).iter().zip(parts(&later)) {
                assert_eq!(*before != after, *changing == kind, "{kind:?} {changing:?}");
            }
        }
        assert_eq!(world.groups[0].colour_drift != [0.0; 3], kind == WorldKind::Drift, "{kind:?}");
    }
}

/// Returns the pictures after this number of decisions in `group`, in which the hand stays, and the
/// last rewards. Every round is a visit.
fn shown(world: &World, group: usize, decisions: usize, horizon: usize) -> (Vec<u8>, Vec<f32>) {
    let visits = visits(&vec![group; 1 + decisions], 1);
    let mut stream = TaskStream::new(world.clone(), visits, 1).unwrap().with_horizon(horizon);
    let mut transition = Transition::new(stream.spec());
    stream.reset(&mut transition.observations).unwrap();
    for _ in 0..decisions {
        stream.step(&[0.0; 2], &mut transition).unwrap();
    }
    (transition.observations.images, transition.rewards)
}

#[test]
fn nuisances_change_pictures_or_rewards_and_slowly() {
    for kind in WorldKind::ALL.into_iter().skip_while(|&kind| kind != WorldKind::Drift) {
        let world = World::random(kind, 1000);
        let changed_scene = world.scene;
        let mut constant = World { changed_scene, ..world.clone() };
        constant.groups.iter_mut().for_each(|group| group.colour_drift = [0.0; 3]);
        assert_eq!(shown(&world, 0, 0, 1).0, shown(&constant, 0, 0, 1).0, "{kind:?}");
        for late in [100, 200] {
            let [(seen, paid), (expected, plain)] =
                [&world, &constant].map(|world| shown(world, 0, late, 1));
            assert_eq!(seen == expected, kind == WorldKind::RescaledReward, "{kind:?}");
            let scaled = world.scene_in_round(late - 1, late - 1).reward_scale * plain[0];
            assert_eq!(paid[0] != scaled, kind == WorldKind::MovingObject, "{kind:?}");
        }
        let noise = |round| world.scene_in_round(round, 0).noise_amplitude;
        assert!((0..249).all(|r| (0.0..0.1).contains(&(noise(r + 1) - noise(r)))));
    }
}

#[test]
fn a_late_object_is_not_in_the_first_pictures() {
    for kind in [WorldKind::LateObject, WorldKind::Appearance] {
        let world = World::random(kind, 1000);
        for decisions in 0..6 {
            let [one, other] = [0, 1].map(|group| shown(&world, group, decisions, 9).0);
            let is_hidden = kind == WorldKind::LateObject && decisions < 5;
            assert_eq!(one == other, is_hidden, "{kind:?} {decisions}");
        }
    }
}

#[test]
fn groups_change_between_rounds_whatever_resets() {
    let world = World::random(WorldKind::Appearance, 1000);
    let mut stream = TaskStream::new(world, visits(&[2, 0, 1], 2), 1).unwrap().with_horizon(3);
    let mut transition = Transition::new(stream.spec());
    assert_eq!(
        stream.step(&[0.0; 2], &mut transition).unwrap_err().to_string(),
        StreamError::NotReset.to_string()
    );
    let mut first = Observations::new(stream.spec());
    stream.reset(&mut first).unwrap();
    let mut again = first.clone();
    stream.reset(&mut again).unwrap();
    assert!(first == again, "no step was lost");
    let groups: Vec<usize> = (0..18)
        .map(|_| {
            let group = stream.group_in_round(stream.num_rounds_ended());
            stream.step(&[0.0; 2], &mut transition).unwrap();
            group
        })
        .collect();
    let expected = [[2; 6], [0; 6], [1; 6]].concat();
    assert_eq!(groups, expected);
    assert_eq!(stream.group_in_round(99), 1, "the last group stays");
}

#[test]
fn what_cannot_be_shown_is_refused() {
    let world = World::random(WorldKind::Reward, 1000);
    let refuse = |visits, envs| TaskStream::new(world.clone(), visits, envs).unwrap_err();
    assert!(matches!(refuse(vec![], 1), StreamError::ZeroCount { .. }));
    assert!(matches!(refuse(visits(&[0], 1), 0), StreamError::ZeroCount { .. }));
    assert!(matches!(refuse(visits(&[0], 0), 1), StreamError::ZeroCount { .. }));
    let error = refuse(visits(&[0, 9], 1), 1);
    assert!(error.to_string().starts_with("visit 1 is of group 9"), "{error}");
    let mut stream = TaskStream::new(world, visits(&[0], 1), 2).unwrap();
    let mut transition = Transition::new(stream.spec());
    let step_error = stream.step(&[0.0; 3], &mut transition).unwrap_err();
    assert!(step_error.to_string().starts_with("got 3 actions, expected 4"), "{step_error}");
    stream.reset(&mut transition.observations).unwrap();
    let refused = stream.step(&[0.0, f32::NAN, 0.0, 0.0], &mut transition).unwrap_err();
    assert!(refused.to_string().starts_with("action 1 is NaN"), "{refused}");
    // a horizon that has passed already ends the episode
    (0..3).for_each(|_| stream.step(&[0.0; 4], &mut transition).unwrap());
    let mut shorter = stream.with_horizon(2);
    shorter.step(&[0.0; 4], &mut transition).unwrap();
    assert!(transition.outcomes.iter().all(|outcome| outcome.is_ended()));
}

/// An inserted visit begins after the round that runs, mirrored as it says, and the list goes on.
#[test]
fn a_visit_is_inserted_after_the_round_that_runs() {
    let world = World::random_with_num_groups(WorldKind::Appearance, 1000, 3);
    let mut stream = TaskStream::new(world, visits(&[0, 1], 4), 1).unwrap().with_horizon(2);
    let groups =
        |of: &TaskStream| -> Vec<usize> { (0..8).map(|round| of.group_in_round(round)).collect() };
    let inserted = GroupVisit { variant: Some(D2::FlipX), ..GroupVisit::new(2, 2) };
    let mut transition = Transition::new(stream.spec());
    let mut observations = Observations::new(stream.spec());
    stream.reset(&mut observations).unwrap();
    stream.step(&[0.0; 2], &mut transition).unwrap();
    stream.insert_visit(inserted).unwrap();
    assert_eq!(groups(&stream), [0, 2, 2, 1, 1, 1, 1, 1]);
    assert_eq!(stream.group_visit_in_round(1), inserted);
    // an episode whose first observation was returned belongs to the visit before
    stream.step(&[0.0; 2], &mut transition).unwrap();
    stream.insert_visit(GroupVisit::new(0, 1)).unwrap();
    assert_eq!(groups(&stream), [0, 2, 0, 1, 1, 1, 1, 1]);
    let refused = stream.insert_visit(GroupVisit::new(3, 1)).unwrap_err();
    assert_eq!(refused, StreamError::UnknownGroup { visit: 2, group: 3, groups: 3 });
    let no_rounds = stream.insert_visit(GroupVisit::new(2, 0)).unwrap_err();
    assert!(no_rounds.to_string().contains("rounds of a visit is 0"), "{no_rounds}");
    assert_eq!(groups(&stream), [0, 2, 0, 1, 1, 1, 1, 1], "a refused visit changes nothing");
    // a visit that has not begun is not interrupted
    stream.insert_visit(GroupVisit::new(2, 2)).unwrap();
    assert_eq!(groups(&stream), [0, 2, 2, 2, 0, 1, 1, 1]);
}
