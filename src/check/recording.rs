//! Recorded episodes of Meta-World in an npz file.

use std::path::{Path, PathBuf};

use envs::{Placement, Scene, StepReward, TaskGroup};
use glam::DVec3;

use super::npz::{Array, Npz, unreadable};

/// Vector from Meta-World's origin, the robot's base, to the centre of the table, the origin of
/// this project (metres).
pub(crate) const TABLE_CENTRE: DVec3 = DVec3::new(0.0, 0.6, 0.0);
/// Height of the puck's centre on the table (metres); Meta-World's placements give its underside.
const PUCK_HEIGHT: f64 = 0.015;

/// Way of an open window's handle from that of a shut one (metres).
const OPEN_WINDOW: DVec3 = DVec3::new(0.2, 0.0, 0.0);

/// Differences between the recordings of the tasks.
struct Contents {
    group: TaskGroup,
    /// Number of random values of a placement: the object's position, and in some tasks the goal's.
    random_values: usize,
    /// Indices in `info` of our approach term, in-place term and distance; `None` for those that
    /// Meta-World does not report.
    reported: [Option<usize>; 3],
}

/// Indices of the terms and of the distance in most recordings.
const REPORTED: [Option<usize>; 3] = [Some(3), Some(4), Some(5)];

/// Contents of the recordings of every task.
static CONTENTS: [Contents; 14] = [
    // index 3 is a distance
    contents(TaskGroup::GOAL_REACH, 6, [None, Some(4), Some(5)]),
    contents(TaskGroup::BUTTON_PRESS, 3, REPORTED),
    contents(TaskGroup::DRAWER_CLOSE, 3, REPORTED),
    contents(TaskGroup::PLATE_SLIDE, 6, REPORTED),
    contents(TaskGroup::WINDOW_OPEN, 3, REPORTED),
    contents(TaskGroup::WINDOW_CLOSE, 3, REPORTED),
    // index 3 is the finger action's term, and index 5 is always zero
    contents(TaskGroup::DOOR_OPEN, 3, [Some(1), Some(4), None]),
    // the door's own term is missing
    contents(TaskGroup::DOOR_CLOSE, 3, [Some(4), None, Some(5)]),
    contents(TaskGroup::DRAWER_OPEN, 3, REPORTED),
    contents(TaskGroup::BUTTON_PRESS_TOPDOWN, 3, REPORTED),
    contents(TaskGroup::FAUCET_CLOSE, 3, REPORTED),
    contents(TaskGroup::PUSH, 6, REPORTED),
    contents(TaskGroup::PICK_PLACE, 6, REPORTED),
    contents(TaskGroup::PEG_INSERT_SIDE, 6, REPORTED),
];

const fn contents(
    group: TaskGroup,
    random_values: usize,
    reported: [Option<usize>; 3],
) -> Contents {
    Contents { group, random_values, reported }
}

impl Contents {
    /// Returns Meta-World's name of the task.
    fn name(&self) -> Option<&'static str> {
        self.group.identity_task().meta_world_settings().map(|spec| spec.name)
    }
}

/// Recording of E episodes of T control steps of one task, in metres and Meta-World's frame.
pub(crate) struct Recording {
    contents: &'static Contents,
    pub episodes: usize,
    pub steps: usize,
    /// Joint positions `[E, T + 1, nq]`, velocities `[E, T + 1, nv]` and targets of the hand
    /// `[E, T + 1, 3]` in E episodes of T steps, after the reset and each step; nq and nv are
    /// MuJoCo's.
    pub qpos: Array,
    pub qvel: Array,
    pub target: Array,
    /// Observations `[E, T + 1, 39]` in E episodes of T steps: hand, aperture, object and more.
    pub observation: Array,
    /// Actions `[E, T, 4]` in E episodes of T steps, not clipped.
    pub action: Array,
    /// Rewards `[E, T]` in E episodes of T steps.
    pub reward: Array,
    /// Further values `[E, T, 7]` in E episodes of T steps: success, near object, grasp success,
    /// grasp reward, in place, object to target, reward.
    pub info: Array,
    /// Flags `[E, T]` in E episodes of T steps: nonzero if a convex mesh, which boxes replace here,
    /// touched something.
    pub mesh_contact: Array,
    /// Random numbers of the placement in E episodes, `[E, 3]` or `[E, 6]`.
    placement: Array,
    goal: Array,
    hand_start: Array,
    start_tcp: Array,
}

impl Recording {
    /// Parses the task from the name of a recording's file.
    pub(crate) fn task_of_file(path: &Path) -> Result<TaskGroup, String> {
        let stem = path.file_stem().unwrap_or_default().to_string_lossy();
        let task = stem.split('_').nth(1).unwrap_or_default();
        let found = CONTENTS.iter().find(|contents| contents.name() == Some(task));
        found.map(|contents| contents.group).ok_or_else(|| {
            let known: Vec<_> = CONTENTS.iter().filter_map(Contents::name).collect();
            format!(
                "its name says no task: expected ENGINE_TASK_POLICY.npz, where TASK is one of \
                 Meta-World's: {}",
                known.join(", ")
            )
        })
    }

    /// Reads a recording of `scene`'s task.
    pub(crate) fn read(path: &Path, scene: &Scene) -> Result<Self, String> {
        let group = scene.group;
        let contents = CONTENTS.iter().find(|contents| contents.group == group);
        let contents = contents.ok_or_else(|| format!("{group} is not a task of Meta-World"))?;
        let mut npz = Npz::open(path)?;
        let reward = npz.array("reward", &[0, 0])?;
        let (e, t) = (reward.shape()[0], reward.shape()[1]);
        let (nq, nv) = (scene.model.nq(), scene.model.nv());
        Ok(Self {
            contents,
            episodes: e,
            steps: t,
            qpos: npz.array("qpos", &[e, t + 1, nq])?,
            qvel: npz.array("qvel", &[e, t + 1, nv])?,
            target: npz.array("mocap_pos", &[e, t + 1, 3])?,
            observation: npz.array("obs", &[e, t + 1, 39])?,
            action: npz.array("action", &[e, t, 4])?,
            info: npz.array("info", &[e, t, 7])?,
            mesh_contact: npz.array("mesh_contact", &[e, t])?,
            placement: npz.array("rand_vec", &[e, contents.random_values])?,
            goal: npz.array("target_pos", &[e, 3])?,
            hand_start: npz.array("hand_init_pos", &[e, 3])?,
            start_tcp: npz.array("init_tcp", &[e, 3])?,
            reward,
        })
    }

    /// Returns the placement of an episode relative to `origin` (metres, Meta-World's frame).
    pub(crate) fn placement(&self, episode: usize, origin: DVec3) -> Placement {
        let group = self.contents.group;
        let random = self.placement.row(&[episode]);
        let relative = |point: &[f64]| DVec3::from_slice(point) - origin;
        let mut object = relative(&random[..3]);
        let mut goal = relative(self.goal.row(&[episode]));
        if group == TaskGroup::PLATE_SLIDE {
            object.z = PUCK_HEIGHT;
        } else if group == TaskGroup::PUSH {
            // both are at the height of the block when it has come to rest
            object.z = goal.z;
        } else if group == TaskGroup::PEG_INSERT_SIDE {
            // ours is the position of the box, from which the target is a constant way
            goal = relative(&random[3..]);
        }
        Placement { object, goal }
    }

    /// Returns the hand's target at the start of an episode, in this project's frame.
    pub(crate) fn hand_start(&self, episode: usize) -> DVec3 {
        to_project_frame(self.hand_start.row(&[episode]))
    }

    /// Returns the point between the fingertips at an episode's start, in this project's frame.
    pub(crate) fn start_tcp(&self, episode: usize) -> DVec3 {
        to_project_frame(self.start_tcp.row(&[episode]))
    }

    /// Returns the positions of hand and object in an observation, in this project's frame.
    pub(crate) fn hand_and_object(&self, episode: usize, step: usize) -> [DVec3; 2] {
        let observation = self.observation.row(&[episode, step]);
        [to_project_frame(&observation[..3]), to_project_frame(&observation[4..7])]
    }

    /// Returns the position of the object at an episode's start, in this project's frame.
    pub(crate) fn start_object(&self, episode: usize) -> DVec3 {
        let [_, object] = self.hand_and_object(episode, 0);
        // Meta-World measures its window before it opens it
        let is_opened = self.contents.group == TaskGroup::WINDOW_CLOSE;
        let opened = if is_opened { OPEN_WINDOW } else { DVec3::ZERO };
        object + opened
    }

    /// Returns the finger component of an action, not clipped.
    pub(crate) fn finger_action(&self, episode: usize, step: usize) -> f64 {
        self.action.row(&[episode, step])[3]
    }

    /// Returns `true` if the success condition held after a recorded step.
    pub(crate) fn success(&self, episode: usize, step: usize) -> bool {
        self.info.row(&[episode, step])[0] != 0.0
    }

    /// Returns the largest difference between the simulated reward `ours` of a step, or one of its
    /// terms, and the recorded one.
    pub(crate) fn reward_deviation(&self, episode: usize, step: usize, ours: &StepReward) -> f64 {
        let info = self.info.row(&[episode, step]);
        let reward = ours.reward - self.reward.row(&[episode, step])[0];
        let terms = [ours.approach_reward, ours.in_place_reward, ours.goal_distance];
        let reported = self.contents.reported.into_iter().zip(terms);
        let deviations = reported.filter_map(|(at, term)| Some(term - info[at?]));
        largest_deviation(deviations.chain([reward]).map(f64::abs))
    }

    /// Returns `true` if a convex mesh touched anything during a recorded step.
    pub(crate) fn meshes_touch(&self, episode: usize, step: usize) -> bool {
        self.mesh_contact.row(&[episode, step])[0] != 0.0
    }
}

/// Converts a point of Meta-World's frame to this project's frame.
pub(crate) fn to_project_frame(point: &[f64]) -> DVec3 {
    DVec3::from_slice(point) - TABLE_CENTRE
}

/// Lists the npz files of a folder, sorted by name.
pub(crate) fn npz_files(folder: &Path) -> Result<Vec<PathBuf>, String> {
    let mut files = Vec::new();
    for entry in std::fs::read_dir(folder).map_err(unreadable)? {
        let path = entry.map_err(unreadable)?.path();
        if path.extension().is_some_and(|extension| extension == "npz") {
            files.push(path);
        }
    }
    files.sort();
    Ok(files)
}

/// Returns the largest of these deviations; zero for none, and NaN if one of them is NaN.
pub(crate) fn largest_deviation(deviations: impl IntoIterator<Item = f64>) -> f64 {
    // `f64::max` ignores NaN, which would hide broken values
    let larger = |most: f64, one: f64| if most.is_nan() || most >= one { most } else { one };
    deviations.into_iter().fold(0.0, larger)
}

#[cfg(test)]
mod tests {
    use std::sync::Arc;

    use super::*;
    use envs::{Camera, Embodiment, Layout, TableTop};
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use symmetry::D2;

    fn scene(group: TaskGroup) -> Scene {
        let (layout, arm) = (Layout::MetaWorld, Embodiment::SAWYER);
        Scene::new_in_layout(layout, group, arm, Camera::default()).unwrap()
    }

    /// Returns the repository's two recordings of a scene's task: of the expert and of random
    /// actions.
    fn recordings(scene: &Scene) -> [Recording; 2] {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/recordings");
        let task = scene.group.identity_task().meta_world_settings().unwrap().name;
        ["expert", "random"].map(|policy| {
            let path = folder.join(format!("mj222_{task}_{policy}.npz"));
            Recording::read(&path, scene).unwrap()
        })
    }

    fn deviation(change: impl Fn(&mut StepReward)) -> f64 {
        let [recording, _] = recordings(&scene(TaskGroup::PLATE_SLIDE));
        let info = recording.info.row(&[1, 7]);
        let mut ours = StepReward {
            approach_reward: info[3],
            in_place_reward: info[4],
            goal_distance: info[5],
            reward: recording.reward.row(&[1, 7])[0],
            success: false,
        };
        change(&mut ours);
        recording.reward_deviation(1, 7, &ours)
    }

    /// Largest distance of a hand's recorded start from ours (metres): in some tasks it is a number
    /// of 32 bits.
    const HAND_START: f64 = 3e-8;
    /// Largest difference of joints after a reset (metres, radians, and their rates), from that of
    /// the hand's start.
    const JOINT_START: f64 = 2e-7;

    #[test]
    fn episodes_start_where_meta_worlds_do() {
        for group in TaskGroup::ALL {
            let scene = Arc::new(scene(group));
            let mut table =
                TableTop::new(Arc::clone(&scene), scene.layout.control_settings()).unwrap();
            let target = scene.model.body("hand_target").unwrap();
            let loose = ["decoy", "loose"].iter().find_map(|name| scene.model.joint(name).ok());
            for recording in recordings(&scene) {
                for episode in 0..recording.episodes {
                    let placement = recording.placement(episode, TABLE_CENTRE);
                    table.reset_to(D2::Identity, placement).unwrap();
                    let data = table.simulation();
                    let mut joints = recording.qpos.row(&[episode, 0]).to_vec();
                    if let Some(joint) = loose {
                        joints[scene.model.joint_qpos_address(joint) + 1] -= TABLE_CENTRE.y;
                    }
                    let rates = recording.qvel.row(&[episode, 0]);
                    let ours = data.qpos().iter().chain(data.qvel());
                    for (at, (got, expected)) in ours.zip(joints.iter().chain(rates)).enumerate() {
                        let off = (got - expected).abs();
                        // with other releases the arm comes to rest in another posture
                        assert!(
                            off < JOINT_START || !envs::mujoco::is_reference_release(),
                            "{group}, {at}: {got}, {expected}"
                        );
                    }
                    let hand = DVec3::from_array(data.body_position(target));
                    let off = hand.distance(recording.hand_start(episode));
                    assert!(off < HAND_START, "{group}: {hand}, {off}");
                }
            }
        }
    }

    /// Returns the lowest and the highest coordinates of object and goal, and of the way between.
    fn bounds(placements: impl Iterator<Item = Placement>) -> [[DVec3; 2]; 3] {
        let none = [DVec3::INFINITY, DVec3::NEG_INFINITY];
        placements.fold([none; 3], |bounds, Placement { object, goal }| {
            let mut points = [object, goal, goal - object].into_iter();
            bounds.map(|[low, high]| {
                let point = points.next().unwrap();
                [low.min(point), high.max(point)]
            })
        })
    }

    #[test]
    fn recorded_placements_are_within_the_ranges_that_ours_are_drawn_from() {
        for group in TaskGroup::ALL {
            let scene = scene(group);
            let mut rng = ChaCha8Rng::seed_from_u64(0);
            let drawn = bounds((0..1000).map(|_| scene.sample_placement(&mut rng)));
            let both = recordings(&scene);
            let recorded = bounds(both.iter().flat_map(|recording| {
                let placed = |episode| recording.placement(episode, TABLE_CENTRE);
                (0..recording.episodes).map(placed)
            }));
            for ([low, high], [lowest, highest]) in drawn.into_iter().zip(recorded) {
                // a thousand numbers leave a little of their range out, at either end
                let rest = 0.01 * (high - low) + 1e-9;
                let within = lowest.cmpge(low - rest).all() && highest.cmple(high + rest).all();
                assert!(within, "{group}: {lowest}, {highest} in {low}, {high}");
            }
        }
    }

    #[test]
    fn a_reward_of_ours_that_is_no_number_is_noticed() {
        assert_eq!(deviation(|_| ()), 0.0);
        assert!((deviation(|ours| ours.in_place_reward += 0.5) - 0.5).abs() < 1e-12);
        type Change = fn(&mut StepReward);
        let broken: [Change; 4] = [
            |ours| ours.reward = f64::NAN,
            |ours| ours.approach_reward = f64::NAN,
            |ours| ours.in_place_reward = f64::NAN,
            |ours| ours.goal_distance = f64::NAN,
        ];
        for change in broken {
            assert!(deviation(change).is_nan());
        }
    }

    #[test]
    fn nan_is_the_largest_wherever_it_stands() {
        assert_eq!(largest_deviation([]), 0.0);
        assert_eq!(largest_deviation([1.0, 3.0, 2.0]), 3.0);
        let (nan, infinite) = (f64::NAN, f64::INFINITY);
        for values in [[nan, 1.0, 2.0], [1.0, nan, 2.0], [1.0, infinite, nan]] {
            assert!(largest_deviation(values).is_nan(), "{values:?}");
        }
        assert_eq!(largest_deviation([1.0, infinite]), infinite);
    }
}
