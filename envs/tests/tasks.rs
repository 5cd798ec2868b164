//! Observed goals, success, and rejected actions, placements and settings.

use std::sync::{Arc, LazyLock};

use envs::{
    ACTION_DIM, Camera, ControlSettings, Embodiment, EnvError, EpisodeStart, Scene, TableTop,
    TaskGroup, VECTOR_OBSERVATION_DIM,
};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use symmetry::D2;

static SCENES: LazyLock<Vec<Arc<Scene>>> = LazyLock::new(|| {
    let scene = |group| Scene::new(group, Embodiment::SAWYER, Camera::default()).unwrap();
    TaskGroup::STANDARD.map(|group| Arc::new(scene(group))).to_vec()
});

fn table(group: TaskGroup) -> TableTop {
    let scene = SCENES.iter().find(|scene| scene.group == group).unwrap();
    TableTop::new(Arc::clone(scene), ControlSettings::default()).unwrap()
}

fn observe(table: &TableTop) -> [f32; VECTOR_OBSERVATION_DIM] {
    table.observe().unwrap()
}

#[test]
fn the_goal_is_told_in_goal_reach_and_nowhere_else() {
    let variants = TaskGroup::STANDARD.map(TaskGroup::variants);
    for variant in variants.concat() {
        let mut table = table(variant.group);
        table.reset(variant.element, &mut ChaCha8Rng::seed_from_u64(2)).unwrap();
        let goal = &observe(&table)[4..7];
        let told = variant.group == TaskGroup::GOAL_REACH;
        assert_eq!(goal.iter().any(|&value| value != 0.0), told, "{variant}");
        if told {
            assert_eq!(goal[0] < 0.0, variant.element.flips_x());
            assert_eq!(goal[1] < 0.0, variant.element.flips_y());
        }
    }
}

#[test]
fn the_lead_is_the_way_from_the_hand_to_its_target() {
    let mut table = table(TaskGroup::GOAL_REACH);
    table.reset(D2::FlipX, &mut ChaCha8Rng::seed_from_u64(0)).unwrap();
    let [.., x, y, z] = observe(&table);
    assert!([x, y, z].iter().all(|lead| lead.abs() < 5e-3), "at rest: {x}, {y}, {z}");
    let (before, length) = (table.hand_position(), table.control_settings().displacement);
    table.step(&[1.0, -0.5, 0.0, 0.0]).unwrap();
    let moved = table.hand_position() - before;
    let [.., x_after, y_after, _] = observe(&table);
    for (lead, expected) in
        [(x_after - x, length - moved.x), (y_after - y, -0.5 * length - moved.y)]
    {
        assert!(expected.abs() > 1e-4 && (f64::from(lead) - expected).abs() < 1e-6, "{lead}");
    }
}

#[test]
fn bad_actions_and_early_steps_are_errors() {
    let mut table = table(TaskGroup::GOAL_REACH);
    let early = table.step(&[0.0; ACTION_DIM]).unwrap_err();
    assert!(matches!(table.observe(), Err(EnvError::NotReset)));
    assert!(matches!(early, EnvError::NotReset));
    table.reset(D2::Identity, &mut ChaCha8Rng::seed_from_u64(0)).unwrap();
    let before = observe(&table);
    let message = table.step(&[0.0, f32::NAN, 0.0, 0.0]).unwrap_err().to_string();
    assert!(message.contains("component 1 of the action is NaN"), "{message}");
    assert_eq!(observe(&table), before, "a refused action must change nothing");
}

#[test]
fn a_step_after_the_end_of_an_episode_is_an_error_and_changes_nothing() {
    let mut table = table(TaskGroup::BUTTON_PRESS);
    table.reset(D2::FlipY, &mut ChaCha8Rng::seed_from_u64(0)).unwrap();
    while !table.step(&[0.3; ACTION_DIM]).unwrap().truncated {}
    let last = observe(&table);
    let error = table.step(&[0.3; ACTION_DIM]).unwrap_err();
    assert!(matches!(error, EnvError::NotReset), "{error}");
    assert_eq!(observe(&table), last);
}

#[test]
fn impossible_control_settings_are_refused() {
    let scene = Arc::clone(&SCENES[0]);
    let control = ControlSettings { action_repeat: 7, ..ControlSettings::default() };
    let message = TableTop::new(scene, control).err().unwrap().to_string();
    assert!(message.contains("500 with action repeat 7"), "{message}");
}

/// The expert reaches the goal, then the hand leaves it in the middle of a decision.
#[test]
fn success_at_the_end_is_that_of_the_last_control_step() {
    let mut table = table(TaskGroup::GOAL_REACH);
    let mut left_within_a_decision = 0;
    for seed in 0..4 {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        table.reset(D2::FlipX, &mut rng).unwrap();
        let task = table.scene().group.identity_task();
        let begun = EpisodeStart {
            placement: table.scene().sample_placement(&mut ChaCha8Rng::seed_from_u64(seed)),
            hand_target: envs::HAND_TARGET_START,
            task_state: table.task_state().unwrap(),
        };
        for decision in 0..table.control_settings().decisions_per_episode() {
            let action = match decision {
                0..30 => table.expert_action().unwrap(),
                _ => [0.6, -0.6, 0.6, 0.0],
            };
            let step = table.step(&action).unwrap();
            let now = task.reward(&begun, &table.task_state().unwrap(), action[3].into());
            assert_eq!(step.success_at_end, now.success, "{seed}, {decision}");
            assert!(step.success || !step.success_at_end);
            left_within_a_decision += usize::from(step.success && !step.success_at_end);
        }
    }
    assert_eq!(left_within_a_decision, 4);
}

/// A NaN goal would end up in the observation and the reward.
#[test]
fn placements_that_are_not_numbers_are_refused_and_change_nothing() {
    for group in TaskGroup::STANDARD {
        let mut table = table(group);
        let mut rng = ChaCha8Rng::seed_from_u64(0);
        let sound = table.scene().sample_placement(&mut rng);
        table.reset_to(D2::Identity, sound).unwrap();
        let before = table.save().unwrap();
        for bad in [f64::NAN, f64::INFINITY] {
            let (mut goal, mut object) = (sound, sound);
            goal.goal.z = bad;
            object.object.x = bad;
            for (what, placement) in [("goal", goal), ("object", object)] {
                let refused = table.reset_to(D2::Identity, placement);
                let message = refused.unwrap_err().to_string();
                assert!(message.contains(&format!("placement's {what} is")), "{message}");
                assert!(table.save().unwrap() == before, "{group}: {what}");
            }
        }
    }
}

/// The reward of Door Close draws the hand to the handle's target, so the way there from the start
/// must lead through the door.
#[test]
fn a_hand_that_follows_the_reward_of_door_close_shuts_the_door() {
    let scene = Scene::new(TaskGroup::DOOR_CLOSE, Embodiment::SAWYER, Camera::default()).unwrap();
    let mut table = TableTop::new(Arc::new(scene), ControlSettings::default()).unwrap();
    for (seed, element) in (0..).zip(D2::ALL) {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        let placement = table.scene().sample_placement(&mut rng);
        table.reset_to(element, placement).unwrap();
        let [x, y] = element.apply_xy([placement.goal.x, placement.goal.y]);
        let mut total = 0;
        for _ in 0..table.control_settings().decisions_per_episode() {
            let way = glam::DVec3::new(x, y, placement.goal.z) - table.hand_position();
            let pull = (way / 0.05).clamp(glam::DVec3::NEG_ONE, glam::DVec3::ONE).as_vec3();
            let step = table.step(&[pull.x, pull.y, pull.z, 0.0]).unwrap();
            total += usize::from(step.success);
        }
        assert!(total > 0, "{element:?}: {placement:?}, hand at {}", table.hand_position());
    }
}
