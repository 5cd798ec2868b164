//! Measurement of the success rate of the scripted experts.

use std::sync::Arc;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use serde::Serialize;
use symmetry::D2;

use crate::control::ControlSettings;
use crate::error::{EnvError, require};
use crate::scene::Scene;
use crate::tabletop::TableTop;

/// Smallest share of episodes that a scripted expert must solve.
const SUCCESS_RATE: f64 = 0.98;

/// Names of the variant that measurements belong to: layout, embodiment, task group and element of
/// D2.
#[derive(Clone, Debug, PartialEq, Eq, Serialize)]
pub struct VariantName {
    /// Name of the layout.
    pub layout: &'static str,
    /// Name of the embodiment.
    pub embodiment: &'static str,
    /// Name of the task group.
    pub task: &'static str,
    /// Element of D2 that maps the canonical variant to this one.
    pub element: String,
}

impl VariantName {
    pub(super) fn new(scene: &Scene, element: D2) -> Self {
        Self {
            layout: scene.layout.name(),
            embodiment: scene.embodiment.name(),
            task: scene.group.name(),
            element: element.to_string(),
        }
    }
}

/// Results of the scripted expert on one variant.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct ExpertResult {
    /// Variant on which the expert was tested.
    #[serde(flatten)]
    pub variant: VariantName,
    /// Number of episodes that the expert played, one for each seed.
    pub episodes: u64,
    /// Number of episodes in which the success condition held at any control step.
    pub successes: u64,
    /// Seeds of the episodes that failed.
    pub failed_seeds: Vec<u64>,
    /// Mean return: sum over control steps of the dense reward / 10, in `[0, horizon]`.
    pub mean_return: f64,
}

impl ExpertResult {
    /// Returns the share of successful episodes, in `[0, 1]`.
    pub fn success_rate(&self) -> f64 {
        self.successes as f64 / self.episodes as f64
    }

    /// Returns `true` if at least 98 % of the expert's episodes succeeded.
    pub fn passes(&self) -> bool {
        self.success_rate() >= SUCCESS_RATE
    }
}

/// Runs the scripted expert of the variant `element` for one episode on the placement of each seed
/// in `0..seeds`.
///
/// # Errors
/// [`EnvError::InvalidSetting`] for zero seeds or action settings out of range,
/// [`EnvError::NoSuchVariant`], or MuJoCo's error.
pub fn measure_expert(
    scene: &Arc<Scene>,
    element: D2,
    control: ControlSettings,
    seeds: u64,
) -> Result<ExpertResult, EnvError> {
    check_seeds(seeds)?;
    let mut table = TableTop::new(Arc::clone(scene), control)?;
    // one environment for all episodes, which do not depend on those before
    let (mut failed_seeds, mut total) = (Vec::new(), 0.0);
    for seed in 0..seeds {
        table.reset(element, &mut ChaCha8Rng::seed_from_u64(seed))?;
        let (reward, success) = episode(&mut table)?;
        if !success {
            failed_seeds.push(seed);
        }
        total += reward;
    }
    Ok(ExpertResult {
        variant: VariantName::new(scene, element),
        episodes: seeds,
        successes: seeds - failed_seeds.len() as u64,
        failed_seeds,
        // a decision's reward is the mean over its control steps, and returns count control steps
        mean_return: total * control.action_repeat as f64 / seeds as f64,
    })
}

/// Runs the scripted expert to the end of the episode. Returns the sum of the rewards, and `true`
/// if any decision succeeded.
pub(super) fn episode(table: &mut TableTop) -> Result<(f64, bool), EnvError> {
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

pub(super) fn check_seeds(seeds: u64) -> Result<(), EnvError> {
    require(seeds > 0, "seeds", &seeds, "at least 1")
}
