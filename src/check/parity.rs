//! Do our scenes and rewards do what Meta-World's did?
//!
//! Three comparisons with recordings of Meta-World 3.1.1 on MuJoCo 2.2.2 (weld torquescale 1):
//! rewards from recorded states, single control steps from recorded states, and open-loop replay.
//! Our scenes put boxes in the place of convex meshes: physics is compared where neither touched.

use std::path::Path;
use std::sync::Arc;

use envs::mujoco::{Data, GeomId, MocapId, State};
use envs::{
    Camera, Embodiment, EnvError, EpisodeStart, Layout, Measurement, PHYSICS_STEPS, Scene,
    TableTop, TaskGroup,
};
use glam::DVec3;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::iter::{IntoParallelRefIterator, ParallelIterator};
use serde::Serialize;
use symmetry::D2;

use super::recording::largest;
use super::recording::{CENTRE, Recording, centred, files};
use super::recording_error::RecordingError;
use experiments::RunError;

/// Boxes in the place of the convex meshes of Meta-World's gripper base and goal net.
const STAND_INS: [&str; 6] =
    ["gripper_base", "gripper_neck", "net_back", "net_left", "net_right", "net_top"];

/// How one recording compares.
#[derive(Clone, Debug, Default, PartialEq, Serialize)]
pub struct ParityRow {
    /// The file's name.
    pub file: String,
    /// The task group.
    pub task: &'static str,
    /// Control steps whose rewards were compared.
    pub reward_steps: usize,
    /// Largest difference of the reward, of scale 10, or of one of its terms.
    pub reward_deviation: f64,
    /// Steps where success differed.
    pub success_mismatches: usize,
    /// Single control steps compared: those in which no mesh, and no box in its place, touched
    /// anything.
    pub physics_steps: usize,
    /// Largest difference in qpos (metres, radians) after a single step: median over the steps.
    pub physics_median: f64,
    /// The same: of the best 99 in 100 steps.
    pub physics_p99: f64,
    /// The same: of all.
    pub physics_max: f64,
    /// Control steps replayed open loop: each episode up to the first in which a mesh, or a box in
    /// its place, touched anything.
    pub replay_steps: usize,
    /// Largest distance of the hand from the recorded one (metres).
    pub replay_deviation: f64,
}

/// Rewards and their terms may differ from Meta-World's by this much.
const REWARD_DEVIATION: f64 = 1e-9;
/// The best 99 of 100 single control steps may end this far from Meta-World's (metres, radians):
/// what the solver's tolerance leaves of a jammed button.
const STEP_DEVIATION: f64 = 5e-12;
/// Of a replayed episode the hand may end this far from Meta-World's (metres).
const REPLAY_DEVIATION: f64 = 1e-4;

impl ParityRow {
    /// Whether every figure is a number and within its bound, and something was compared.
    pub fn passes(&self) -> bool {
        let steps = [self.reward_steps, self.physics_steps, self.replay_steps];
        !steps.contains(&0)
            && self.success_mismatches == 0
            && self.reward_deviation <= REWARD_DEVIATION
            && self.physics_p99 <= STEP_DEVIATION
            && self.physics_max.is_finite()
            && self.replay_deviation <= REPLAY_DEVIATION
    }
}

/// Compares every recording (`ENGINE_TASK_POLICY.npz`) of `folder`.
///
/// # Errors
/// [`RunError::Read`] names the file and what is wrong with it; or what MuJoCo says.
pub fn parity(folder: &Path) -> Result<Vec<ParityRow>, RunError> {
    let paths = files(folder).map_err(|source| RunError::read(folder, source))?;
    if paths.is_empty() {
        return Err(RunError::read(folder, RecordingError::NoFiles));
    }
    paths.par_iter().map(|path| compare(path)).collect()
}

fn compare(path: &Path) -> Result<ParityRow, RunError> {
    let group = Recording::task(path).map_err(|source| RunError::read(path, source))?;
    let mut replica = Replica::new(group)?;
    let recording = Recording::read(path, replica.table.scene());
    let recording = recording.map_err(|source| RunError::read(path, source))?;
    let file = path.file_name().unwrap_or_default();
    let mut row = ParityRow {
        file: file.to_string_lossy().into(),
        task: group.name(),
        ..ParityRow::default()
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
    [row.physics_median, row.physics_p99, row.physics_max] =
        [0.5, 0.99, 1.0].map(|share| quantile(&physics, share));
    Ok(row)
}

/// The smallest value that `share` of the sorted `values` do not exceed; zero where there are none.
fn quantile(values: &[f64], share: f64) -> f64 {
    let rank = (share * values.len() as f64).ceil() as usize;
    values.get(rank.saturating_sub(1)).copied().unwrap_or(0.0)
}

/// Our scene, put into recorded states.
struct Replica {
    table: TableTop,
    start: EpisodeStart,
    /// The placement of an episode with a cold solver.
    cold: State,
    hand_target: MocapId,
    /// What a placement moves, in the scenes that have it.
    object: Option<MocapId>,
    goal: Option<MocapId>,
    /// Address in `qpos` of the loose cylinder's position, in the scene that has it.
    decoy: Option<usize>,
    stand_ins: Vec<GeomId>,
}

impl Replica {
    fn new(group: TaskGroup) -> Result<Self, EnvError> {
        let (layout, arm) = (Layout::MetaWorld, Embodiment::SAWYER);
        let scene = Arc::new(Scene::in_layout(layout, group, arm, Camera::default())?);
        let mut table = TableTop::new(Arc::clone(&scene), layout.control())?;
        let placement = scene.place(&mut ChaCha8Rng::seed_from_u64(0));
        table.reset_to(D2::Identity, placement)?;
        let model = &scene.model;
        let stand_ins = STAND_INS.iter().filter_map(|name| model.geom(name).ok());
        let decoy = model.joint("decoy").ok();
        Ok(Self {
            start: EpisodeStart {
                placement,
                hand_target: DVec3::ZERO,
                measured: table.measurement()?,
            },
            cold: scene.settled().clone(),
            hand_target: model.mocap("hand_target")?,
            object: model.mocap("object").ok(),
            goal: model.mocap("goal").ok(),
            decoy: decoy.map(|joint| model.joint_qpos_address(joint)),
            stand_ins: stand_ins.collect(),
            table,
        })
    }

    /// Puts things where they were in a recorded episode.
    fn begin(&mut self, recording: &Recording, episode: usize) -> Result<(), EnvError> {
        let placement = recording.placement(self.table.scene().group, episode);
        let [hand, object] = recording.hand_and_object(episode, 0);
        let measured =
            Measurement { hand, object, tcp: recording.start_tcp(episode), aperture: 1.0 };
        self.start =
            EpisodeStart { placement, hand_target: recording.hand_start(episode), measured };
        self.table.reset_to(D2::Identity, placement)?;
        let bodies = [(self.object, placement.object), (self.goal, placement.goal)];
        let data = self.table.simulation_mut();
        data.reset();
        for (body, position) in bodies {
            if let Some(body) = body {
                data.set_mocap_position(body, position.to_array())?;
            }
        }
        self.cold = data.save();
        Ok(())
    }

    /// Puts the scene into the recorded state before step `step`.
    fn put(&mut self, recording: &Recording, episode: usize, step: usize) -> Result<(), EnvError> {
        let qpos = self.in_our_frame(recording.qpos.row(&[episode, step]));
        let data = self.table.simulation_mut();
        data.restore(&self.cold)?;
        data.qpos_mut().copy_from_slice(&qpos);
        data.qvel_mut().copy_from_slice(recording.qvel.row(&[episode, step]));
        Ok(())
    }

    /// Only the loose cylinder's position is counted from the world's origin.
    fn in_our_frame(&self, qpos: &[f64]) -> Vec<f64> {
        let mut qpos = qpos.to_vec();
        if let Some(address) = self.decoy {
            qpos[address + 1] -= CENTRE.y;
        }
        qpos
    }

    /// Lets recorded step `step` happen from the present state, and says whether no mesh there and
    /// no box in its place here touched anything.
    fn step(
        &mut self,
        recording: &Recording,
        episode: usize,
        step: usize,
    ) -> Result<bool, EnvError> {
        let target = centred(recording.target.row(&[episode, step + 1]));
        let finger = recording.finger(episode, step);
        let data = self.table.simulation_mut();
        data.set_mocap_position(self.hand_target, target.to_array())?;
        data.set_ctrl(&[finger, -finger])?;
        let mut comparable = !recording.meshes_touch(episode, step);
        for _ in 0..PHYSICS_STEPS {
            data.step(1)?;
            comparable &= !touches(data, &self.stand_ins);
        }
        data.forward_kinematics()?;
        Ok(comparable)
    }

    /// Rewards, successes and terms of the recorded states.
    fn rewards(
        &mut self,
        recording: &Recording,
        episode: usize,
        row: &mut ParityRow,
    ) -> Result<(), EnvError> {
        let group = self.table.scene().group;
        for step in 0..recording.steps {
            self.put(recording, episode, step + 1)?;
            self.table.simulation_mut().forward_kinematics()?;
            let now = self.table.measurement()?;
            let finger = recording.finger(episode, step);
            let ours = group.task().reward(&self.start, &now, finger);
            let deviation = recording.reward_deviation(group, episode, step, &ours);
            row.reward_deviation = largest([row.reward_deviation, deviation]);
            row.success_mismatches += usize::from(ours.success != recording.success(episode, step));
            row.reward_steps += 1;
        }
        Ok(())
    }

    /// Single control steps from the recorded states, with a cold solver.
    fn single_steps(
        &mut self,
        recording: &Recording,
        episode: usize,
        differences: &mut Vec<f64>,
    ) -> Result<(), EnvError> {
        for step in 0..recording.steps {
            self.put(recording, episode, step)?;
            if !self.step(recording, episode, step)? {
                continue;
            }
            let expected = self.in_our_frame(recording.qpos.row(&[episode, step + 1]));
            let pairs = self.table.simulation().qpos().iter().zip(&expected);
            differences.push(largest(pairs.map(|(a, b)| (a - b).abs())));
        }
        Ok(())
    }

    /// The recorded actions one after the other, up to the first step that cannot be compared.
    fn replay(
        &mut self,
        recording: &Recording,
        episode: usize,
        row: &mut ParityRow,
    ) -> Result<(), EnvError> {
        self.put(recording, episode, 0)?;
        for step in 0..recording.steps {
            if !self.step(recording, episode, step)? {
                break;
            }
            let [recorded, _] = recording.hand_and_object(episode, step + 1);
            let deviation = self.table.hand().distance(recorded);
            row.replay_deviation = largest([row.replay_deviation, deviation]);
            row.replay_steps += 1;
        }
        Ok(())
    }
}

/// Whether any of `geoms` touches anything.
fn touches(data: &Data, geoms: &[GeomId]) -> bool {
    let one_of = |geom| geoms.contains(&geom);
    data.contacts().any(|contact| contact.geoms.into_iter().any(one_of))
}

#[cfg(test)]
mod tests {
    use super::*;

    fn good() -> ParityRow {
        ParityRow {
            reward_steps: 200,
            physics_steps: 100,
            replay_steps: 1,
            physics_max: 1e-3,
            ..ParityRow::default()
        }
    }

    #[test]
    fn a_row_passes_where_all_was_compared_and_nothing_differs() {
        assert!(good().passes());
        type Change = fn(&mut ParityRow);
        let changes: [Change; 11] = [
            |row| row.reward_steps = 0,
            |row| row.physics_steps = 0,
            |row| row.replay_steps = 0,
            |row| row.success_mismatches = 1,
            |row| row.reward_deviation = 2e-9,
            |row| row.physics_p99 = 1e-11,
            |row| row.replay_deviation = 2e-4,
            |row| row.reward_deviation = f64::NAN,
            |row| row.physics_p99 = f64::NAN,
            |row| row.physics_max = f64::NAN,
            |row| row.replay_deviation = f64::NAN,
        ];
        for change in changes {
            let mut row = good();
            change(&mut row);
            assert!(!row.passes(), "{row:?}");
        }
        assert!(!ParityRow::default().passes(), "nothing was compared");
    }
}
