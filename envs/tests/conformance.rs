//! What an environment is, asked of every variant of every layout with both embodiments. A new task inherits all of it.

#![allow(clippy::unwrap_used, reason = "test code")]

use std::sync::{Arc, LazyLock};

use envs::{
    ACTION_DIM, Camera, Embodiment, EnvError, Layout, ObservationsMut, RGB, Scene, SceneRenderer,
    Step, TableTop, TaskGroup, VECTOR_DIM, VecEnv, VecEnvSettings,
};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use symmetry::D2;

/// Every scene: layouts x embodiments x groups.
static SCENES: LazyLock<Vec<Arc<Scene>>> = LazyLock::new(|| {
    let mut scenes = Vec::new();
    for layout in Layout::ALL {
        for embodiment in Embodiment::ALL {
            for group in TaskGroup::STANDARD {
                let scene = Scene::in_layout(layout, group, embodiment, Camera::default());
                scenes.push(Arc::new(scene.unwrap()));
            }
        }
    }
    scenes
});

/// One entry of the registry.
struct Case {
    scene: &'static Arc<Scene>,
    element: D2,
}

impl Case {
    fn table(&self) -> TableTop {
        TableTop::new(Arc::clone(self.scene), self.scene.layout.control()).unwrap()
    }

    /// A table at the start of the episode of `seed`.
    fn started(&self, seed: u64) -> TableTop {
        let mut table = self.table();
        self.reset(&mut table, seed);
        table
    }

    fn reset(&self, table: &mut TableTop, seed: u64) {
        let mut rng = ChaCha8Rng::seed_from_u64(seed);
        table.reset(self.element, &mut rng).unwrap();
    }
}

impl std::fmt::Display for Case {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let Scene {
            layout,
            embodiment,
            group,
            ..
        } = **self.scene;
        write!(f, "{layout}, {embodiment}, {group} {}", self.element)
    }
}

fn cases() -> impl Iterator<Item = Case> {
    SCENES.iter().flat_map(|scene| {
        let elements = scene.layout.elements().iter();
        elements.map(move |&element| Case { scene, element })
    })
}

/// Random actions, each held for an eighth of a second as the symmetric layout's decisions are; half of the components at their limits.
struct RandomActions {
    rng: ChaCha8Rng,
    action: [f32; ACTION_DIM],
    hold: usize,
    step: usize,
}

impl RandomActions {
    fn new(case: &Case, seed: u64) -> Self {
        Self {
            rng: ChaCha8Rng::seed_from_u64(seed),
            action: [0.0; ACTION_DIM],
            hold: 10 / case.scene.layout.control().action_repeat,
            step: 0,
        }
    }

    fn act(&mut self) -> [f32; ACTION_DIM] {
        if self.step.is_multiple_of(self.hold) {
            self.action =
                std::array::from_fn(|_| self.rng.random_range(-2.0_f32..2.0).clamp(-1.0, 1.0));
        }
        self.step += 1;
        self.action
    }
}

/// Everything a learner sees of one step, as bits.
type Bits = ([u32; VECTOR_DIM], u64, bool, bool);

fn bits(table: &TableTop, step: &Step) -> Bits {
    let vector = table.observe().unwrap().map(f32::to_bits);
    (vector, step.reward.to_bits(), step.success, step.truncated)
}

/// Takes `steps` decisions.
fn run(table: &mut TableTop, drunkard: &mut RandomActions, steps: usize) -> Vec<Bits> {
    (0..steps)
        .map(|_| {
            let step = table.step(&drunkard.act()).unwrap();
            bits(table, &step)
        })
        .collect()
}

#[test]
fn the_registry_holds_every_variant() {
    assert_eq!(cases().count(), 2 * (16 + 4));
}

#[test]
fn observations_and_rewards_are_finite_and_in_range_until_the_horizon_and_only_the_horizon_truncates()
 {
    for case in cases() {
        let mut table = case.started(1);
        let mut drunkard = RandomActions::new(&case, 2);
        let decisions = case.scene.layout.control().decisions();
        for decision in 1..=decisions {
            let step = table.step(&drunkard.act()).unwrap();
            let [x, y, z, aperture, goal @ ..] = table.observe().unwrap();
            assert!((0.0..=1.0).contains(&step.reward), "{case}: {step:?}");
            assert!(x.abs() < 0.7 && y.abs() < 0.7, "{case}: hand at {x}, {y}");
            assert!((-0.1..0.7).contains(&z), "{case}: hand at height {z}");
            assert!((0.0..=1.0).contains(&aperture), "{case}: {aperture}");
            assert!(goal.iter().all(|g| g.abs() < 0.5), "{case}: {goal:?}");
            assert_eq!(step.truncated, decision == decisions, "{case}, {decision}");
        }
        let after = table.step(&drunkard.act()).unwrap_err();
        assert!(matches!(after, EnvError::NotReset), "{case}: {after}");
    }
}

#[test]
fn a_seed_fixes_an_episode_whatever_came_before_and_another_seed_changes_it() {
    for case in cases() {
        let fresh = |seed| {
            run(
                &mut case.started(seed),
                &mut RandomActions::new(&case, 7),
                50,
            )
        };
        let first = fresh(1);
        assert_eq!(first, fresh(1), "{case}: not deterministic");
        let mut used = case.started(5);
        run(&mut used, &mut RandomActions::new(&case, 8), 37);
        case.reset(&mut used, 1);
        let again = run(&mut used, &mut RandomActions::new(&case, 7), 50);
        assert_eq!(first, again, "{case}: the episode before shows");
        assert_ne!(first, fresh(2), "{case}: the seed changes nothing");
    }
}

#[test]
fn tables_of_one_scene_do_not_disturb_one_another() {
    for case in cases() {
        let (mut one, mut other) = (case.started(1), case.started(2));
        let (mut left, mut right) = (RandomActions::new(&case, 3), RandomActions::new(&case, 4));
        let mut interleaved = Vec::new();
        for _ in 0..20 {
            interleaved.extend(run(&mut one, &mut left, 1));
            run(&mut other, &mut right, 1);
        }
        let alone = run(&mut case.started(1), &mut RandomActions::new(&case, 3), 20);
        assert_eq!(interleaved, alone, "{case}");
    }
}

#[test]
fn no_observation_is_constant_but_a_goal_that_is_not_told() {
    for case in cases() {
        let mut low = [f32::INFINITY; VECTOR_DIM];
        let mut high = [f32::NEG_INFINITY; VECTOR_DIM];
        for seed in 0..2 {
            let mut table = case.started(seed);
            let mut drunkard = RandomActions::new(&case, seed);
            for _ in 0..case.scene.layout.control().decisions() / 2 {
                for (i, value) in table.observe().unwrap().into_iter().enumerate() {
                    low[i] = low[i].min(value);
                    high[i] = high[i].max(value);
                }
                table.step(&drunkard.act()).unwrap();
            }
        }
        let told = case.scene.group == TaskGroup::GOAL_REACH;
        for i in 0..VECTOR_DIM {
            let varies = high[i] - low[i] > 1e-3;
            assert_eq!(varies, i < 4 || told, "{case}: component {i} of the vector");
        }
    }
}

#[test]
fn pictures_change_with_what_happens() {
    for scene in SCENES.iter() {
        let case = Case {
            scene,
            element: D2::Identity,
        };
        let mut renderer = SceneRenderer::new(Arc::clone(scene)).unwrap();
        let mut table = case.started(1);
        let size = scene.camera.size;
        let mut pictures = [vec![0; size * size * RGB], vec![0; size * size * RGB]];
        renderer.render(&mut table, &mut pictures[0]).unwrap();
        let decisions = 200 / scene.layout.control().action_repeat;
        run(&mut table, &mut RandomActions::new(&case, 6), decisions);
        renderer.render(&mut table, &mut pictures[1]).unwrap();
        assert_ne!(pictures[0], pictures[1], "{case}");
    }
}

/// The solver's warm start is part of the state: contacts and welds are solved to the same bits only from the same start.
#[test]
fn a_saved_episode_continues_to_the_same_bits() {
    for case in cases() {
        let mut table = case.started(1);
        let mut drunkard = RandomActions::new(&case, 9);
        run(&mut table, &mut drunkard, 15);
        let snapshot = table.save().unwrap();
        let before = table.observe().unwrap();
        let straight = run(&mut table, &mut RandomActions::new(&case, 10), 25);
        let mut elsewhere = case.started(3);
        elsewhere.restore(&snapshot).unwrap();
        assert_eq!(elsewhere.observe().unwrap(), before, "{case}");
        let resumed = run(&mut elsewhere, &mut RandomActions::new(&case, 10), 25);
        assert_eq!(straight, resumed, "{case}");
    }
}

#[test]
fn a_snapshot_of_another_scene_is_refused() {
    let case = |group| {
        let all = &mut cases();
        all.find(|case| case.scene.group == group).unwrap()
    };
    let button = case(TaskGroup::BUTTON_PRESS).started(0);
    let mut drawer = case(TaskGroup::DRAWER_CLOSE).started(0);
    let message = drawer
        .restore(&button.save().unwrap())
        .unwrap_err()
        .to_string();
    assert!(
        message.contains("button-press") && message.contains("drawer-close"),
        "{message}"
    );
    let unstarted = case(TaskGroup::GOAL_REACH).table();
    assert!(matches!(unstarted.save(), Err(EnvError::NotReset)));
}

#[test]
fn doing_nothing_solves_nothing() {
    for case in cases() {
        let mut table = case.started(3);
        for _ in 0..case.scene.layout.control().decisions() {
            assert!(!table.step(&[0.0; ACTION_DIM]).unwrap().success, "{case}");
        }
    }
}

#[test]
fn the_stock_layout_has_no_mirrored_variants() {
    let scene = SCENES
        .iter()
        .find(|scene| scene.layout == Layout::MetaWorld)
        .unwrap();
    let case = Case {
        scene,
        element: D2::FlipX,
    };
    let rng = &mut ChaCha8Rng::seed_from_u64(0);
    let message = case.table().reset(D2::FlipX, rng).unwrap_err().to_string();
    assert!(
        message.contains("`metaworld` has no variant under flip x"),
        "{message}"
    );
}

#[test]
fn a_vector_environment_runs_the_stock_layout_and_refuses_mirrored_variants_of_it() {
    let settings = VecEnvSettings {
        num_envs: 2,
        layout: Layout::MetaWorld,
        control: Layout::MetaWorld.control(),
        ..VecEnvSettings::default()
    };
    let image = 2 * settings.image_len();
    let (mut images, mut vectors) = (vec![0; image], vec![0.0; 2 * VECTOR_DIM]);
    let mut env = VecEnv::new(settings, TaskGroup::BUTTON_PRESS, &[D2::Identity]).unwrap();
    let out = ObservationsMut {
        images: &mut images,
        vectors: &mut vectors,
    };
    env.reset(out).unwrap();
    // Meta-World starts the button's hand 0.2 m back
    assert!((vectors[1] + 0.2).abs() < 0.01, "{vectors:?}");
    let error = env
        .set_tasks(TaskGroup::BUTTON_PRESS, &D2::ALL)
        .unwrap_err();
    assert!(matches!(error, EnvError::NoSuchVariant { .. }), "{error}");
}
