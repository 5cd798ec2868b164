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

/// Recording of E episodes of T control steps of one task, in metres and Meta-World's frame.
pub(crate) struct Recording {
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
    /// Parses the task from a file's name.
    pub(crate) fn task_of_file(path: &Path) -> Result<TaskGroup, String> {
        let stem = path.file_stem().unwrap_or_default().to_string_lossy();
        let task = stem.split('_').nth(1).unwrap_or_default();
        let name = |group: &TaskGroup| group.task().meta_world_spec().map(|spec| spec.name);
        TaskGroup::ALL.into_iter().find(|group| name(group) == Some(task)).ok_or_else(|| {
            let known = TaskGroup::ALL.iter().filter_map(name).collect::<Vec<_>>().join(", ");
            format!(
                "its name says no task: expected ENGINE_TASK_POLICY.npz, where TASK is one of \
                 Meta-World's: {known}"
            )
        })
    }

    /// Reads a recording of `scene`'s task.
    pub(crate) fn read(path: &Path, scene: &Scene) -> Result<Self, String> {
        let mut npz = Npz::open(path)?;
        let reward = npz.array("reward", &[0, 0])?;
        let (e, t) = (reward.shape()[0], reward.shape()[1]);
        let (nq, nv) = (scene.model.nq(), scene.model.nv());
        Ok(Self {
            episodes: e,
            steps: t,
            qpos: npz.array("qpos", &[e, t + 1, nq])?,
            qvel: npz.array("qvel", &[e, t + 1, nv])?,
            target: npz.array("mocap_pos", &[e, t + 1, 3])?,
            observation: npz.array("obs", &[e, t + 1, 39])?,
            action: npz.array("action", &[e, t, 4])?,
            info: npz.array("info", &[e, t, 7])?,
            mesh_contact: npz.array("mesh_contact", &[e, t])?,
            placement: npz.array("rand_vec", &[e, placement_len(scene.group)])?,
            goal: npz.array("target_pos", &[e, 3])?,
            hand_start: npz.array("hand_init_pos", &[e, 3])?,
            start_tcp: npz.array("init_tcp", &[e, 3])?,
            reward,
        })
    }

    /// Returns the placement of an episode relative to `origin` (metres, Meta-World's frame).
    pub(crate) fn placement(&self, group: TaskGroup, episode: usize, origin: DVec3) -> Placement {
        let random = self.placement.row(&[episode]);
        let relative = |point: &[f64]| DVec3::from_slice(point) - origin;
        let mut object = relative(&random[..3]);
        let mut goal = relative(self.goal.row(&[episode]));
        match group.name() {
            "plate-slide" => object.z = PUCK_HEIGHT,
            // both are at the height of the block when it has come to rest
            "push" => object.z = goal.z,
            // ours is the position of the box, from which the target is a constant way
            "peg-insert-side" => goal = relative(&random[3..]),
            _ => {}
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
    pub(crate) fn start_object(&self, group: TaskGroup, episode: usize) -> DVec3 {
        let [_, object] = self.hand_and_object(episode, 0);
        // Meta-World measures its window before it opens it
        let opened = if group == TaskGroup::WINDOW_CLOSE { OPEN_WINDOW } else { DVec3::ZERO };
        object + opened
    }

    /// Returns the finger component of an action, not clipped.
    pub(crate) fn finger_action(&self, episode: usize, step: usize) -> f64 {
        self.action.row(&[episode, step])[3]
    }

    /// Returns `true` if the success condition held after a step.
    pub(crate) fn success(&self, episode: usize, step: usize) -> bool {
        self.info.row(&[episode, step])[0] != 0.0
    }

    /// Returns the largest difference of a step's reward, or of one of its terms, from `ours`.
    pub(crate) fn reward_deviation(
        &self,
        group: TaskGroup,
        episode: usize,
        step: usize,
        ours: &StepReward,
    ) -> f64 {
        let info = self.info.row(&[episode, step]);
        let reward = ours.reward - self.reward.row(&[episode, step])[0];
        let terms = reported_terms(group, ours).into_iter().map(|(at, term)| term - info[at]);
        largest_deviation(terms.chain([reward]).map(f64::abs))
    }

    /// Returns `true` if a mesh touched anything during a step.
    pub(crate) fn meshes_touch(&self, episode: usize, step: usize) -> bool {
        self.mesh_contact.row(&[episode, step])[0] != 0.0
    }
}

/// Returns the terms of a reward that Meta-World reports too, with their indices in `info`.
fn reported_terms(group: TaskGroup, ours: &StepReward) -> Vec<(usize, f64)> {
    let (approach, in_place) = (ours.approach_reward, (4, ours.in_place_reward));
    let distance = (5, ours.goal_distance);
    match group.name() {
        // index 3 is a distance
        "goal-reach" => vec![in_place, distance],
        // index 3 is the finger action's term, index 5 is always zero
        "door-open" => vec![(1, approach), in_place],
        // the door's own term is missing
        "door-close" => vec![(4, approach), distance],
        _ => vec![(3, approach), in_place, distance],
    }
}

/// Returns the number of random values of a placement: the object's position, and in some tasks the
/// goal's.
fn placement_len(group: TaskGroup) -> usize {
    match group.name() {
        "goal-reach" | "plate-slide" | "push" | "pick-place" | "peg-insert-side" => 6,
        _ => 3,
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

/// Returns the largest deviation of a list; zero without any, and NaN if one of them is NaN.
pub(crate) fn largest_deviation(deviations: impl IntoIterator<Item = f64>) -> f64 {
    // `f64::max` ignores NaN, which would hide broken values
    let larger = |most: f64, one: f64| if most.is_nan() || most >= one { most } else { one };
    deviations.into_iter().fold(0.0, larger)
}

#[cfg(test)]
mod tests {
    use super::*;
    use envs::{Camera, Embodiment, Layout};

    /// Returns the deviation of a recorded step from itself with `change` applied.
    fn deviation(change: impl Fn(&mut StepReward)) -> f64 {
        let group = TaskGroup::PLATE_SLIDE;
        let (layout, arm) = (Layout::MetaWorld, Embodiment::SAWYER);
        let scene = Scene::new_in_layout(layout, group, arm, Camera::default()).unwrap();
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("tests/recordings");
        let path = folder.join("mj222_plate-slide_expert.npz");
        let recording = Recording::read(&path, &scene).unwrap();
        let info = recording.info.row(&[1, 7]);
        let mut ours = StepReward {
            approach_reward: info[3],
            in_place_reward: info[4],
            goal_distance: info[5],
            reward: recording.reward.row(&[1, 7])[0],
            success: false,
        };
        change(&mut ours);
        recording.reward_deviation(group, 1, 7, &ours)
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
