//! Every task under every element: solvable, finite, deterministic, symmetric. New tasks inherit all of it from the registry.

#![allow(clippy::unwrap_used)]

use std::sync::{Arc, LazyLock};

use envs::{
    ACTION_DIM, Camera, Dynamics, Embodiment, EnvError, Scene, Step, TableTop, TaskGroup,
    TaskVariant, VECTOR_DIM,
};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use symmetry::D2;

static SCENES: LazyLock<Vec<Arc<Scene>>> = LazyLock::new(|| {
    let scene = |group| Scene::new(group, Embodiment::Sawyer, Camera::default()).unwrap();
    TaskGroup::ALL.map(|group| Arc::new(scene(group))).to_vec()
});

fn table(group: TaskGroup) -> TableTop {
    let scene = SCENES.iter().find(|scene| scene.group == group).unwrap();
    TableTop::new(Arc::clone(scene), Dynamics::default()).unwrap()
}

fn observe(table: &TableTop) -> [f32; VECTOR_DIM] {
    table.observe().unwrap()
}

/// One episode; `act` may look at the table. Returns every step.
fn episode(
    variant: TaskVariant,
    seed: u64,
    mut act: impl FnMut(&TableTop) -> [f32; ACTION_DIM],
) -> Vec<Step> {
    let mut table = table(variant.group);
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    table.reset(variant.element, &mut rng).unwrap();
    (0..Dynamics::default().decisions())
        .map(|_| {
            let action = act(&table);
            table.step(&action).unwrap()
        })
        .collect()
}

fn expert(table: &TableTop) -> [f32; ACTION_DIM] {
    table.expert_action().unwrap()
}

#[test]
fn doing_nothing_solves_nothing() {
    for variant in TaskVariant::all() {
        let steps = episode(variant, 3, |_| [0.0; ACTION_DIM]);
        assert!(steps.iter().all(|step| !step.success), "{variant}");
    }
}

#[test]
fn rewards_are_in_range_and_only_the_horizon_truncates() {
    for variant in TaskVariant::all() {
        let steps = episode(variant, 1, expert);
        for (index, step) in steps.iter().enumerate() {
            assert!((0.0..=1.0).contains(&step.reward), "{variant}: {step:?}");
            assert_eq!(
                step.truncated,
                index + 1 == steps.len(),
                "{variant}, step {index}"
            );
        }
    }
}

#[test]
fn a_seed_fixes_an_episode_and_another_seed_changes_it() {
    for variant in TaskVariant::all() {
        let rewards = |seed| -> Vec<u64> {
            let steps = episode(variant, seed, expert);
            steps.iter().map(|step| step.reward.to_bits()).collect()
        };
        assert_eq!(rewards(1), rewards(1), "{variant}");
        assert_ne!(rewards(1), rewards(2), "{variant}");
    }
}

#[test]
fn an_episode_does_not_depend_on_the_one_before() {
    for group in TaskGroup::ALL {
        let run = |warm_up: bool| {
            let mut table = table(group);
            if warm_up {
                let mut rng = ChaCha8Rng::seed_from_u64(99);
                table.reset(D2::HalfTurn, &mut rng).unwrap();
                for _ in 0..30 {
                    table.step(&[0.7, 0.9, -1.0, 1.0]).unwrap();
                }
            }
            table
                .reset(D2::FlipX, &mut ChaCha8Rng::seed_from_u64(5))
                .unwrap();
            let action = |table: &TableTop| table.expert_action().unwrap();
            for _ in 0..20 {
                let action = action(&table);
                table.step(&action).unwrap();
            }
            observe(&table).map(f32::to_bits)
        };
        assert_eq!(run(true), run(false), "{group}");
    }
}

#[test]
fn the_goal_is_told_in_goal_reach_and_nowhere_else() {
    for variant in TaskVariant::all() {
        let mut table = table(variant.group);
        table
            .reset(variant.element, &mut ChaCha8Rng::seed_from_u64(2))
            .unwrap();
        let goal = &observe(&table)[4..];
        let told = variant.group == TaskGroup::GoalReach;
        assert_eq!(goal.iter().any(|&value| value != 0.0), told, "{variant}");
        if told {
            assert_eq!(goal[0] < 0.0, variant.element.flips_x());
            assert_eq!(goal[1] < 0.0, variant.element.flips_y());
        }
    }
}

#[test]
fn bad_actions_and_early_steps_are_errors() {
    let mut table = table(TaskGroup::GoalReach);
    let early = table.step(&[0.0; ACTION_DIM]).unwrap_err();
    assert!(matches!(table.observe(), Err(EnvError::NotReset)));
    assert!(matches!(early, EnvError::NotReset));
    table
        .reset(D2::Identity, &mut ChaCha8Rng::seed_from_u64(0))
        .unwrap();
    let before = observe(&table);
    let message = table
        .step(&[0.0, f32::NAN, 0.0, 0.0])
        .unwrap_err()
        .to_string();
    assert!(
        message.contains("component 1 of the action is NaN"),
        "{message}"
    );
    assert_eq!(
        observe(&table),
        before,
        "a refused action must change nothing"
    );
}

#[test]
fn a_step_after_the_end_of_an_episode_is_an_error_and_changes_nothing() {
    let mut table = table(TaskGroup::ButtonPress);
    table
        .reset(D2::FlipY, &mut ChaCha8Rng::seed_from_u64(0))
        .unwrap();
    while !table.step(&[0.3; ACTION_DIM]).unwrap().truncated {}
    let last = observe(&table);
    let error = table.step(&[0.3; ACTION_DIM]).unwrap_err();
    assert!(matches!(error, EnvError::NotReset), "{error}");
    assert_eq!(observe(&table), last);
}

#[test]
fn impossible_dynamics_are_refused() {
    let scene = Arc::clone(&SCENES[0]);
    let dynamics = Dynamics {
        action_repeat: 7,
        ..Dynamics::default()
    };
    let message = TableTop::new(scene, dynamics).err().unwrap().to_string();
    assert!(message.contains("500 with action repeat 7"), "{message}");
}
