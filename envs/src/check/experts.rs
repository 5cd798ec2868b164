//! Does a script solve every variant?

use std::sync::Arc;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use serde::Serialize;
use symmetry::D2;

use super::parallel;
use crate::{Camera, Dynamics, Embodiment, EnvError, Scene, TableTop, TaskGroup};

/// How the scripted expert fared on one variant.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ExpertRow {
    /// What carried the gripper.
    pub embodiment: &'static str,
    /// The task group.
    pub task: &'static str,
    /// The variant's element of D2.
    pub element: String,
    /// Episodes, one a seed.
    pub episodes: u64,
    /// Episodes in which the success condition held at any control step.
    pub successes: u64,
    /// Mean over the episodes of the sum over control steps of Meta-World's reward / 10: in `[0, horizon]`.
    pub mean_return: f64,
}

impl ExpertRow {
    /// Share of the episodes that succeeded, in `[0, 1]`.
    pub fn success_rate(&self) -> f64 {
        self.successes as f64 / self.episodes as f64
    }
}

/// Runs the scripted experts of all 16 variants on the placements of the seeds `0..seeds`.
///
/// # Errors
/// [`EnvError::Setting`] for no seeds or impossible dynamics, or what MuJoCo says.
pub fn experts(
    embodiment: Embodiment,
    dynamics: Dynamics,
    seeds: u64,
) -> Result<Vec<ExpertRow>, EnvError> {
    super::check_seeds(seeds)?;
    let scenes = TaskGroup::ALL.map(|group| Scene::new(group, embodiment, Camera::default()));
    let mut jobs = Vec::new();
    for scene in scenes {
        let scene = Arc::new(scene?);
        jobs.extend(D2::ALL.map(|element| (Arc::clone(&scene), element)));
    }
    parallel::map(&jobs, |(scene, element)| {
        variant(scene, *element, dynamics, seeds)
    })
}

fn variant(
    scene: &Arc<Scene>,
    element: D2,
    dynamics: Dynamics,
    seeds: u64,
) -> Result<ExpertRow, EnvError> {
    let mut table = TableTop::new(Arc::clone(scene), dynamics)?;
    let (mut successes, mut total) = (0, 0.0);
    for seed in 0..seeds {
        table.reset(element, &mut ChaCha8Rng::seed_from_u64(seed))?;
        let (reward, success) = episode(&mut table)?;
        successes += u64::from(success);
        total += reward;
    }
    Ok(ExpertRow {
        embodiment: scene.embodiment.name(),
        task: scene.group.name(),
        element: element.to_string(),
        episodes: seeds,
        successes,
        mean_return: total * dynamics.action_repeat as f64 / seeds as f64,
    })
}

/// Lets the expert act to the episode's end: the sum of the decisions' rewards, and whether any succeeded.
pub(crate) fn episode(table: &mut TableTop) -> Result<(f64, bool), EnvError> {
    let (mut reward, mut success) = (0.0, false);
    loop {
        let action = table.expert_action()?;
        let step = table.step(&action)?;
        reward += step.reward;
        success |= step.success;
        if step.truncated {
            return Ok((reward, success));
        }
    }
}
