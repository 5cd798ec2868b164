//! Preset that the settings of a run are most like.

use clap::ValueEnum;

use crate::error::RunError;
use crate::experiment::Experiment;
use crate::presets::{Budget, Method};
use learner::overrides::setting_differences;

/// Preset that differs least from the settings of a run.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct NearestPreset {
    /// Method of the preset.
    pub method: Method,
    /// Budget of the preset.
    pub budget: Budget,
    /// Settings that differ, as [`setting_differences`] formats them, the run's value last.
    pub differences: String,
}

impl NearestPreset {
    /// Finds the nearest preset to the settings of a run with the run's seed and threads; of one
    /// method if it is given.
    ///
    /// # Errors
    /// [`RunError`] for settings that cannot be compared.
    pub fn of_run(method: Option<Method>, run: &Experiment) -> Result<Self, RunError> {
        Self::by(method, run, |budget, method| preset_for_run(budget, method, run))
    }

    /// Finds the nearest preset to the settings of a run, as `preset` gives it for a budget and a
    /// method; of one method if it is given.
    ///
    /// # Errors
    /// [`RunError`] for settings that cannot be compared.
    pub fn by(
        method: Option<Method>,
        run: &Experiment,
        preset: impl Fn(Budget, Method) -> Experiment,
    ) -> Result<Self, RunError> {
        let mut nearest =
            Self { method: Method::default(), budget: Budget::Full, differences: String::new() };
        let mut least = usize::MAX;
        for candidate in Method::ALL.into_iter().filter(|&one| method.is_none_or(|own| own == one))
        {
            for &budget in Budget::value_variants() {
                let differences = setting_differences(&preset(budget, candidate), run)?;
                // the nearest preset is the one whose list of differences is the shortest text
                if differences.len() < least {
                    least = differences.len();
                    nearest = Self { method: candidate, budget, differences };
                }
            }
        }
        Ok(nearest)
    }

    /// Returns the options of `covers train` that select the preset.
    pub fn options(&self) -> String {
        format!("--preset {} --budget {}", self.method.name(), self.budget.name())
    }
}

/// Returns a preset with the seed and the threads of a run.
pub(crate) fn preset_for_run(budget: Budget, method: Method, run: &Experiment) -> Experiment {
    let preset = budget.preset_experiment(method).with_seed(run.learner.seed());
    preset.with_threads(run.envs.threads)
}
