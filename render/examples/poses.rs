//! Writes the poses of everything on the table while the policies of a run play, for viewers in
//! three dimensions: one episode of each variant of each task group, as JSON.
//!
//! `cargo run --release -p covers-render --example poses -- assets/pretrained > poses.json`

use std::error::Error;
use std::path::Path;

use envs::mujoco::GeomShape;
use envs::{TableTop, TaskRegistry, TaskVariant};
use experiments::RunFolder;
use glam::DQuat;
use render::{FilmView, PolicyPlayer, SingleEpisodeFilmEnv};
use rl::{BoxedEnvError, EnvSpec, Observations, Transition, VectorEnv};
use serde::Serialize;

/// Seed of the placement, which the variants of a group share.
const SEED: u64 = 0;

/// Episode of one variant.
#[derive(Serialize)]
struct Episode {
    group: String,
    variant: String,
    policy: usize,
    success: bool,
    /// Seconds of simulated time between two poses.
    seconds: f64,
    /// Goal that no shape shows (metres), if the task has one.
    goal: Option<[f64; 3]>,
    solids: Vec<Solid>,
}

/// Shape with its poses.
#[derive(Serialize)]
struct Solid {
    /// `box`, `cylinder`, `capsule` or `sphere`.
    shape: &'static str,
    /// Half sides of a box, or radius and half the length (metres); capsules and cylinders lie
    /// along z.
    size: Vec<f64>,
    /// Red, green, blue and opacity, in `[0, 1]`.
    rgba: [f32; 4],
    is_arm: bool,
    /// Position (metres) and quaternion (x, y, z, w) at each time; one pose if it never moves.
    poses: Vec<[f64; 7]>,
}

/// Environment that keeps the poses of its only episode.
struct PoseRecorder {
    recorder: SingleEpisodeFilmEnv,
    solids: Vec<Solid>,
}

impl PoseRecorder {
    fn record(&mut self) {
        let table = self.recorder.environment();
        if self.solids.is_empty() {
            self.solids = table.visible_geoms().map(|solid| new_solid(&solid)).collect();
        }
        for (own, pose) in self.solids.iter_mut().zip(poses(table)) {
            own.poses.push(pose);
        }
    }

    /// Ends the recording; of what never moved one pose is left.
    fn finish(mut self) -> Vec<Solid> {
        for solid in &mut self.solids {
            if solid.poses.iter().all(|pose| *pose == solid.poses[0]) {
                solid.poses.truncate(1);
            }
        }
        self.solids
    }
}

/// Returns the poses of all solids, rounded to a tenth of a millimetre and a thousandth.
fn poses(table: &TableTop) -> impl Iterator<Item = [f64; 7]> {
    let round = |value: f64, digits: f64| (value * digits).round() / digits;
    table.visible_geoms().map(move |solid| {
        let [x, y, z] = solid.position.to_array().map(|value| round(value, 1e4));
        let turn = DQuat::from_mat3(&solid.axes).to_array().map(|value| round(value, 1e3));
        [x, y, z, turn[0], turn[1], turn[2], turn[3]]
    })
}

fn new_solid(solid: &envs::VisibleGeom<'_>) -> Solid {
    let (shape, size) = match solid.shape {
        GeomShape::Sphere { radius } => ("sphere", vec![radius]),
        GeomShape::Capsule { radius, half_length } => ("capsule", vec![radius, half_length]),
        GeomShape::Cylinder { radius, half_length } => ("cylinder", vec![radius, half_length]),
        GeomShape::Box { half } => ("box", half.to_vec()),
    };
    Solid { shape, size, rgba: solid.rgba, is_arm: solid.is_arm, poses: Vec::new() }
}

impl VectorEnv for PoseRecorder {
    fn spec(&self) -> &EnvSpec {
        self.recorder.spec()
    }

    fn reset(&mut self, out: &mut Observations) -> Result<(), BoxedEnvError> {
        self.recorder.reset(out)?;
        self.record();
        Ok(())
    }

    fn step(&mut self, actions: &[f32], out: &mut Transition) -> Result<(), BoxedEnvError> {
        self.recorder.step(actions, out)?;
        self.record();
        Ok(())
    }
}

fn play(player: &mut PolicyPlayer, variant: TaskVariant) -> Result<Episode, Box<dyn Error>> {
    let settings = player.experiment.envs;
    let recorder = SingleEpisodeFilmEnv::new(&settings, variant, &[FilmView::PolicyInput], SEED)?;
    let mut env = PoseRecorder { recorder, solids: Vec::new() };
    let (policy, success) = player.play_episode(variant, &mut env)?;
    Ok(Episode {
        group: variant.group.name().to_owned(),
        variant: variant.element.to_string(),
        policy,
        success,
        seconds: settings.control.decision_seconds(),
        goal: env.recorder.environment().observable_goal().map(|goal| goal.to_array()),
        solids: env.finish(),
    })
}

fn main() -> Result<(), Box<dyn Error>> {
    let folder = std::env::args_os().nth(1).ok_or("expected the folder of a run")?;
    let folder = RunFolder::from_path(Path::new(&folder));
    let mut player = PolicyPlayer::load(&folder, 1)?;
    let groups = player.experiment.schedule.resolve_groups(&TaskRegistry::with_all())?;
    let variants = groups.into_iter().flat_map(|group| group.variants());
    let episodes = variants.map(|variant| play(&mut player, variant));
    let episodes = episodes.collect::<Result<Vec<_>, _>>()?;
    serde_json::to_writer(std::io::stdout().lock(), &episodes)?;
    Ok(())
}
