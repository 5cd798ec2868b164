//! Comparison of scenes and rewards with recordings of Meta-World.
//!
//! The recordings are of Meta-World 3.1.1 on MuJoCo 2.2.2 (weld torquescale 1). Compared are
//! rewards in recorded states, single control steps from recorded states, and open-loop replay.
//! These scenes have boxes instead of convex meshes, so physics is compared only while neither
//! touches anything. It is simulated around Meta-World's origin: rounding errors decide which of
//! several contacts MuJoCo finds between parallel faces.

use std::path::Path;
use std::sync::Arc;

use envs::mujoco::{BodyId, Data, GeomId, MocapId, State};
use envs::{
    Camera, Embodiment, EnvError, EpisodeStart, Layout, PHYSICS_STEPS_PER_CONTROL_STEP, Placement,
    Scene, TableTop, TaskGroup, TaskState,
};
use glam::DVec3;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::iter::{IntoParallelRefIterator, ParallelIterator};
use serde::Serialize;
use symmetry::D2;

use super::recording::{Recording, TABLE_CENTRE, largest_deviation, npz_files, to_project_frame};
use experiments::RunError;

/// Names of the boxes that replace the convex meshes of Meta-World's gripper base and goal net.
const STAND_INS: [&str; 6] =
    ["gripper_base", "gripper_neck", "net_back", "net_left", "net_right", "net_top"];

/// Comparison of this simulation with one recording of Meta-World.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct MetaWorldComparison {
    /// Name of the recording's file.
    pub file: String,
    /// Name of the task group.
    pub task: &'static str,
    /// Number of control steps whose rewards were compared.
    pub reward_steps: usize,
    /// Largest difference of the reward, of scale 10, or of one of its terms.
    #[serde(rename = "reward_deviation")]
    pub max_reward_deviation: f64,
    /// Number of control steps in which the success flags differ.
    pub success_mismatches: usize,
    /// Number of single control steps compared, in which no mesh or replacing box touched anything.
    pub physics_steps: usize,
    /// Median over single steps of the largest difference in qpos (metres, radians).
    #[serde(rename = "physics_median")]
    pub median_qpos_deviation: f64,
    /// 99th percentile over single steps of the largest difference in qpos (metres, radians).
    #[serde(rename = "physics_p99")]
    pub p99_qpos_deviation: f64,
    /// Maximum over single steps of the largest difference in qpos (metres, radians).
    #[serde(rename = "physics_max")]
    pub max_qpos_deviation: f64,
    /// Number of control steps replayed open loop. Each episode ends before the first step in which
    /// a mesh or a replacing box touched anything.
    pub replay_steps: usize,
    /// Largest distance of the hand from its recorded position during replay (metres).
    #[serde(rename = "replay_deviation")]
    pub max_replay_deviation_m: f64,
}

/// Largest accepted difference of rewards, of scale 10, and of their terms.
const REWARD_DEVIATION: f64 = 1e-9;
/// Largest accepted 99th percentile of differences after a single step (metres, radians). The
/// solver's tolerance leaves up to this much in a jam, where it starts from another solution.
const STEP_DEVIATION: f64 = 5e-12;
/// Largest accepted distance of the hand from its recorded position during replay (metres).
const REPLAY_DEVIATION: f64 = 1e-4;

impl MetaWorldComparison {
    /// Returns `true` if rewards, single steps and replay were all compared, success agrees
    /// everywhere, and deviations are within their bounds; NaN is not.
    pub fn passes(&self) -> bool {
        let steps = [self.reward_steps, self.physics_steps, self.replay_steps];
        !steps.contains(&0)
            && self.success_mismatches == 0
            && self.max_reward_deviation <= REWARD_DEVIATION
            && self.p99_qpos_deviation <= STEP_DEVIATION
            && self.max_qpos_deviation.is_finite()
            && self.max_replay_deviation_m <= REPLAY_DEVIATION
    }
}

/// Compares this simulation with every recording of Meta-World (`ENGINE_TASK_POLICY.npz`) in
/// `folder`.
///
/// # Errors
/// [`RunError::Read`] with the file and the problem; errors of MuJoCo.
pub fn compare_meta_world_recordings(folder: &Path) -> Result<Vec<MetaWorldComparison>, RunError> {
    let paths = npz_files(folder).map_err(RunError::read_error_mapper(folder))?;
    if paths.is_empty() {
        let problem = "no recording in it: expected files named ENGINE_TASK_POLICY.npz";
        return Err(RunError::cannot_read(folder, problem));
    }
    paths.par_iter().map(|path| compare(path)).collect()
}

fn compare(path: &Path) -> Result<MetaWorldComparison, RunError> {
    let problem = |problem: String| RunError::cannot_read(path, problem);
    let group = Recording::task_of_file(path).map_err(problem)?;
    let mut replica = Replica::new(group)?;
    let recording = Recording::read(path, replica.table.scene()).map_err(problem)?;
    let file = path.file_name().unwrap_or_default();
    let mut row = MetaWorldComparison {
        file: file.to_string_lossy().into(),
        task: group.name(),
        ..MetaWorldComparison::default()
    };
    let mut physics = Vec::new();
    for episode in 0..recording.episodes {
        replica.begin(&recording, episode)?;
        replica.rewards(&recording, episode, &mut row)?;
        replica.single_steps(&recording, episode, &mut physics)?;
        replica.replay(&recording, episode, &mut row)?;
    }
    // a NaN comes last
    physics.sort_by(f64::total_cmp);
    row.physics_steps = physics.len();
    [row.median_qpos_deviation, row.p99_qpos_deviation, row.max_qpos_deviation] =
        [0.5, 0.99, 1.0].map(|share| quantile(&physics, share));
    Ok(row)
}

/// Returns the smallest value that a `share` of the sorted `values` does not exceed; zero for an
/// empty slice.
fn quantile(values: &[f64], share: f64) -> f64 {
    let rank = (share * values.len() as f64).ceil() as usize;
    values.get(rank.saturating_sub(1)).copied().unwrap_or(0.0)
}

/// Simulated scene that is put into the states of a recording.
struct Replica {
    /// Scene in this project's frame, for rewards.
    table: TableTop,
    start: EpisodeStart,
    /// State of the table after placement.
    placed: State,
    /// Simulation of the same scene in Meta-World's frame.
    physics: Data,
    hand: BodyId,
    hand_target: MocapId,
    /// Mocap body that carries the task's object; `None` in scenes without it.
    object: Option<MocapId>,
    goal: Option<MocapId>,
    /// Address in `qpos` of a loose object's position, in scenes with one.
    loose: Option<usize>,
    stand_ins: Vec<GeomId>,
}

impl Replica {
    fn new(group: TaskGroup) -> Result<Self, EnvError> {
        let (layout, arm) = (Layout::MetaWorld, Embodiment::SAWYER);
        let scene = Arc::new(Scene::new_in_layout(layout, group, arm, Camera::default())?);
        let mut table = TableTop::new(Arc::clone(&scene), layout.control_settings())?;
        let placement = scene.sample_placement(&mut ChaCha8Rng::seed_from_u64(0));
        table.reset_to(D2::Identity, placement)?;
        let model = &scene.model;
        let stand_ins = STAND_INS.iter().filter_map(|name| model.geom(name).ok());
        let loose = model.joint("decoy").or_else(|_| model.joint("loose")).ok();
        Ok(Self {
            start: EpisodeStart {
                placement,
                hand_target: DVec3::ZERO,
                task_state: table.task_state()?,
            },
            placed: scene.start_state(D2::Identity).clone(),
            physics: Data::new(Arc::new(model.translated(TABLE_CENTRE.to_array())?)),
            hand: model.body("hand")?,
            hand_target: model.mocap_body("hand_target")?,
            object: model.mocap_body("object").ok(),
            goal: model.mocap_body("goal").ok(),
            loose: loose.map(|joint| model.joint_qpos_address(joint)),
            stand_ins: stand_ins.collect(),
            table,
        })
    }

    /// Places the scene's objects as in a recorded episode.
    fn begin(&mut self, recording: &Recording, episode: usize) -> Result<(), EnvError> {
        let placement = recording.placement(episode, TABLE_CENTRE);
        let [hand, _] = recording.hand_and_object(episode, 0);
        let task_state = TaskState {
            hand,
            object: recording.start_object(episode),
            tcp: recording.start_tcp(episode),
            ..self.start.task_state
        };
        self.start =
            EpisodeStart { placement, hand_target: recording.hand_start(episode), task_state };
        self.table.reset_to(D2::Identity, placement)?;
        let data = self.table.simulation_mut();
        data.reset();
        place([self.object, self.goal], data, placement)?;
        self.placed = data.save_state();
        self.physics.reset();
        let there = recording.placement(episode, DVec3::ZERO);
        place([self.object, self.goal], &mut self.physics, there)
    }

    /// Puts the physics into the recorded state after a reset, with the solution that Meta-World's
    /// first step starts from.
    fn put_start(&mut self, recording: &Recording, episode: usize) -> Result<(), EnvError> {
        self.put(recording, episode, 0);
        Ok(self.physics.forward()?)
    }

    /// Puts the physics into the recorded state before step `step`.
    fn put(&mut self, recording: &Recording, episode: usize, step: usize) {
        let qpos = recording.qpos.row(&[episode, step]);
        self.physics.qpos_mut().copy_from_slice(qpos);
        self.physics.qvel_mut().copy_from_slice(recording.qvel.row(&[episode, step]));
    }

    /// Simulates recorded step `step` from the current state. Returns `true` if neither a mesh in
    /// the recording nor a replacing box touched anything, so that the results are comparable.
    fn step(
        &mut self,
        recording: &Recording,
        episode: usize,
        step: usize,
    ) -> Result<bool, EnvError> {
        let target = DVec3::from_slice(recording.target.row(&[episode, step + 1]));
        let finger = recording.finger_action(episode, step);
        let data = &mut self.physics;
        data.set_mocap_position(self.hand_target, target.to_array())?;
        data.set_all_ctrl(&[finger, -finger])?;
        let mut comparable = !recording.meshes_touch(episode, step);
        for _ in 0..PHYSICS_STEPS_PER_CONTROL_STEP {
            data.step(1)?;
            comparable &= !touches(data, &self.stand_ins);
        }
        // as in Meta-World, whose next step starts its solver from this solution
        data.forward()?;
        Ok(comparable)
    }

    /// Compares rewards, their terms and success in the recorded states.
    fn rewards(
        &mut self,
        recording: &Recording,
        episode: usize,
        row: &mut MetaWorldComparison,
    ) -> Result<(), EnvError> {
        let group = self.table.scene().group;
        for step in 0..recording.steps {
            let mut qpos = recording.qpos.row(&[episode, step + 1]).to_vec();
            // only the free joint of a loose object is relative to the world's origin
            if let Some(address) = self.loose {
                qpos[address + 1] -= TABLE_CENTRE.y;
            }
            let data = self.table.simulation_mut();
            data.restore_state(&self.placed)?;
            data.qpos_mut().copy_from_slice(&qpos);
            data.forward_kinematics()?;
            let now = self.table.task_state()?;
            let finger = recording.finger_action(episode, step);
            let ours = group.identity_task().reward(&self.start, &now, finger);
            let deviation = recording.reward_deviation(episode, step, &ours);
            row.max_reward_deviation = largest_deviation([row.max_reward_deviation, deviation]);
            row.success_mismatches += usize::from(ours.success != recording.success(episode, step));
            row.reward_steps += 1;
        }
        Ok(())
    }

    /// Simulates single control steps from the recorded states, and appends the largest difference
    /// of each comparable step. The solver starts from its last solution, as in Meta-World.
    fn single_steps(
        &mut self,
        recording: &Recording,
        episode: usize,
        differences: &mut Vec<f64>,
    ) -> Result<(), EnvError> {
        self.put_start(recording, episode)?;
        for step in 0..recording.steps {
            self.put(recording, episode, step);
            if !self.step(recording, episode, step)? {
                continue;
            }
            let expected = recording.qpos.row(&[episode, step + 1]);
            let pairs = self.physics.qpos().iter().zip(expected);
            differences.push(largest_deviation(pairs.map(|(a, b)| (a - b).abs())));
        }
        Ok(())
    }

    /// Replays the recorded actions of an episode up to the first step that cannot be compared.
    fn replay(
        &mut self,
        recording: &Recording,
        episode: usize,
        row: &mut MetaWorldComparison,
    ) -> Result<(), EnvError> {
        self.put_start(recording, episode)?;
        for step in 0..recording.steps {
            if !self.step(recording, episode, step)? {
                break;
            }
            let [recorded, _] = recording.hand_and_object(episode, step + 1);
            let hand = to_project_frame(&self.physics.body_position(self.hand));
            row.max_replay_deviation_m =
                largest_deviation([row.max_replay_deviation_m, hand.distance(recorded)]);
            row.replay_steps += 1;
        }
        Ok(())
    }
}

/// Moves the bodies of object and goal.
fn place(
    bodies: [Option<MocapId>; 2],
    data: &mut Data,
    placement: Placement,
) -> Result<(), EnvError> {
    for (body, position) in bodies.into_iter().zip([placement.object, placement.goal]) {
        if let Some(body) = body {
            data.set_mocap_position(body, position.to_array())?;
        }
    }
    Ok(())
}

/// Returns `true` if any of `geoms` touches anything.
fn touches(data: &Data, geoms: &[GeomId]) -> bool {
    let one_of = |geom| geoms.contains(&geom);
    data.contacts().any(|contact| contact.geoms.into_iter().any(one_of))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn good() -> MetaWorldComparison {
        MetaWorldComparison {
            reward_steps: 200,
            physics_steps: 100,
            replay_steps: 1,
            max_qpos_deviation: 1e-3,
            ..MetaWorldComparison::default()
        }
    }

    #[test]
    fn a_row_passes_where_all_was_compared_and_nothing_differs() {
        assert!(good().passes());
        type Change = fn(&mut MetaWorldComparison);
        let changes: [Change; 11] = [
            |row| row.reward_steps = 0,
            |row| row.physics_steps = 0,
            |row| row.replay_steps = 0,
            |row| row.success_mismatches = 1,
            |row| row.max_reward_deviation = 2e-9,
            |row| row.p99_qpos_deviation = 1e-11,
            |row| row.max_replay_deviation_m = 2e-4,
            |row| row.max_reward_deviation = f64::NAN,
            |row| row.p99_qpos_deviation = f64::NAN,
            |row| row.max_qpos_deviation = f64::NAN,
            |row| row.max_replay_deviation_m = f64::NAN,
        ];
        for change in changes {
            let mut row = good();
            change(&mut row);
            assert!(!row.passes(), "{row:?}");
        }
        assert!(!MetaWorldComparison::default().passes(), "nothing was compared");
    }
}
