//! What is drawn is what the kinds promise.

#![allow(clippy::unwrap_used)]

use rl::{Observations, Transition, VectorEnv};
use worlds::{StreamError, TaskStream, Visit, World, WorldKind};

const SEEDS: std::ops::Range<u64> = 1000..1020;

fn visits(groups: &[usize], rounds: usize) -> Vec<Visit> {
    groups.iter().map(|&group| Visit { group, rounds }).collect()
}

#[test]
fn equal_seeds_draw_equal_worlds_and_groups_differ_where_their_kind_says() {
    for kind in WorldKind::ALL {
        for seed in SEEDS {
            let world = World::random(kind, seed);
            assert_eq!(world, World::random(kind, seed));
            assert_ne!(world, World::random(kind, seed + 1));
            assert!((2..=16).contains(&world.groups.len()), "{}", kind.name());
            for (i, group) in world.groups.iter().enumerate() {
                let equal = world.groups[..i].contains(group);
                assert_eq!(equal, kind == WorldKind::Identical && i > 0, "{}", kind.name());
            }
        }
        for number in [2, 16] {
            let world = World::random_with_num_groups(kind, 1000, number);
            assert!((2..=number).contains(&world.groups.len()));
        }
    }
}

/// The mean pay of an expert for group `as_group` in group `of_group`.
fn pay(world: &World, of_group: usize, as_group: usize) -> f32 {
    let mut stream = TaskStream::new(world.clone(), visits(&[of_group], 9), 4).unwrap();
    let mut transition = Transition::new(stream.spec());
    stream.reset(&mut transition.observations).unwrap();
    let mut pay = 0.0;
    for _ in 0..100 {
        let actions: Vec<f32> =
            (0..4).flat_map(|env| stream.expert_action(env, as_group)).collect();
        stream.step(&actions, &mut transition).unwrap();
        pay += transition.rewards.iter().sum::<f32>() / 400.0;
    }
    pay
}

#[test]
fn experts_earn_at_home_and_not_elsewhere_where_pay_or_motion_differ() {
    for kind in WorldKind::ALL {
        for seed in SEEDS.take(3) {
            let world = World::random(kind, seed);
            let home = pay(&world, 0, 0);
            assert!(home > 0.4, "{} {seed} {home}", kind.name());
            if matches!(kind, WorldKind::Target | WorldKind::Reward) {
                let away = pay(&world, 0, 1);
                assert!(away < 0.6 * home, "{} {seed}: {away} {home}", kind.name());
            }
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
    assert!(matches!(refuse(vec![], 1), StreamError::NoVisitsOrEnvs { .. }));
    assert!(matches!(refuse(visits(&[0], 1), 0), StreamError::NoVisitsOrEnvs { .. }));
    let error = refuse(visits(&[0, 9], 1), 1);
    assert!(error.to_string().starts_with("visit 1 is of group 9"), "{error}");
    let mut stream = TaskStream::new(world, visits(&[0], 1), 2).unwrap();
    let mut transition = Transition::new(stream.spec());
    let step_error = stream.step(&[0.0; 3], &mut transition).unwrap_err();
    assert!(step_error.to_string().starts_with("got 3 actions, expected 4"), "{step_error}");
}
