//! Check of an experiment's settings, whose errors name the full path and the default of a setting.
//! The code that checks a setting knows its own name of it, but not where an experiment holds it.

use envs::{EnvError, TaskRegistry};
use evidence::EvidenceError;
use learner::overrides::{SettingDifference, differing_settings, short_path};
use rl::RlError;
use serde_json::Value;

use crate::error::RunError;
use crate::experiment::Experiment;
use crate::nearest_preset::{NearestPreset, preset_for_run};

impl Experiment {
    /// Rejects settings with which a run over groups of `tasks` could not finish.
    ///
    /// # Errors
    /// The first setting that is out of range or contradicts another one.
    pub fn check(&self, tasks: &TaskRegistry) -> Result<(), RunError> {
        self.check_parts(tasks).map_err(|error| with_setting_path(error, self))
    }

    /// Rejects settings of the environments in which no policy could be evaluated.
    ///
    /// # Errors
    /// The first setting that is out of range.
    pub fn check_environments(&self) -> Result<(), RunError> {
        self.check_environment_parts().map_err(|error| with_setting_path(error, self))
    }
}

/// Adds the path and the default of the setting to an error about a value out of range; other
/// errors, and values that the run shares with its preset, stay as they are.
fn with_setting_path(error: RunError, run: &Experiment) -> RunError {
    let Some((name, value, expected)) = rejected(&error) else {
        return error;
    };
    let Ok(nearest) = NearestPreset::of_run(None, run) else {
        return error;
    };
    let preset = preset_for_run(nearest.budget, nearest.method, run);
    let changed = differing_settings(run, &preset).unwrap_or_default();
    let Some(SettingDifference { path, other, .. }) = find(&changed, name, &value) else {
        return error;
    };
    RunError::SettingOutOfRange {
        path: short_path(path).to_owned(),
        value,
        expected,
        preset: nearest.options(),
        default: other.to_string(),
    }
}

/// Returns name, value and range of the setting that an error rejects.
fn rejected(error: &RunError) -> Option<(&'static str, String, &'static str)> {
    match error {
        RunError::InvalidSetting { name, value, expected }
        | RunError::Env(EnvError::InvalidSetting { name, value, expected }) => {
            Some((*name, value.clone(), *expected))
        }
        RunError::Rl(RlError::InvalidSetting { name, value, expected })
        | RunError::Evidence(EvidenceError::InvalidSetting { name, value, expected }) => {
            Some((*name, value.to_string(), *expected))
        }
        _ => None,
    }
}

/// Returns the changed setting with the rejected value: the one of that name, or the only one, but
/// for a name that is a path itself.
fn find<'a>(
    changed: &'a [SettingDifference],
    name: &str,
    value: &str,
) -> Option<&'a SettingDifference> {
    let mut same_value = changed.iter().filter(|setting| is_value(&setting.one, value));
    let named = same_value.clone().find(|setting| is_named(short_path(&setting.path), name));
    named.or_else(|| {
        let only = same_value.next().filter(|_| same_value.next().is_none());
        only.filter(|_| !name.contains('.'))
    })
}

/// Returns `true` for the number that a text begins with, or for the word that it is.
fn is_value(own: &Value, text: &str) -> bool {
    let number = text.split_whitespace().next().and_then(|word| word.parse::<f64>().ok());
    match (own.as_f64(), number) {
        // some checks round to single precision first
        (Some(own), Some(number)) => own as f32 == number as f32,
        _ => own.as_str() == Some(text),
    }
}

/// Returns `true` if a setting's name in a check, as `camera height`, stands for a path.
fn is_named(path: &str, name: &str) -> bool {
    let name = name.replace(' ', "_");
    // an element of a list has the list's name
    let element = path.rsplit_once('.').filter(|(_, last)| last.parse::<usize>().is_ok());
    let path = element.map_or(path, |(list, _)| list);
    let last = path.rsplit('.').next().unwrap_or(path);
    name.ends_with(last) || path.starts_with(&format!("{name}."))
}

#[cfg(test)]
mod tests {
    use crate::presets::{Budget, Method};
    use envs::TaskRegistry;
    use learner::overrides::{SettingOverride, apply_overrides};

    fn message(texts: &[&str]) -> String {
        let overrides: Vec<SettingOverride> =
            texts.iter().map(|text| text.parse().unwrap()).collect();
        let preset = Budget::Smoke.preset_experiment(Method::CoversSac);
        let run = apply_overrides(&overrides, preset).unwrap();
        run.check(&TaskRegistry::with_all()).unwrap_err().to_string()
    }

    #[test]
    fn a_value_out_of_range_is_named_by_its_path_with_range_and_default() {
        let preset = "--preset covers-sac --budget smoke";
        assert_eq!(
            message(&["off_policy.sac.gamma=1.5"]),
            format!(
                "setting `off_policy.sac.gamma` is 1.5, expected a number in [0, 1] (0.95 with \
                 `{preset}`)"
            )
        );
        for (text, expected) in [
            ("envs.num_envs=0", "`envs.num_envs` is 0, expected at least 1 (8 with"),
            ("envs.camera.size=3", "`envs.camera.size` is 3, expected an even number"),
            ("envs.camera.mark.hole=9", "`envs.camera.mark.hole` is 9, expected a length"),
            ("envs.camera.misalignment.shift_mm=[300,300]", "shift_mm.0` is 300, expected at most"),
            ("evaluation.looks=20000", "`evaluation.looks` is 20000, expected 0 to 10000 (1 with"),
            ("schedule.groups.0.decisions=0", "`schedule.groups.0.decisions` is 0 of goal-reach"),
            ("off_policy.grouping.evidence.level=3", "`off_policy.grouping.evidence.level` is 3"),
            ("off_policy.sac.learning_rate=0", "`off_policy.sac.learning_rate` is 0"),
        ] {
            let message = message(&[text]);
            assert!(message.contains(expected) && message.contains(preset), "{message}");
        }
        // both have this value
        let twins = message(&["off_policy.sac.gamma=1.5", "off_policy.sac.newest_share=1.5"]);
        assert!(twins.contains("`off_policy.sac.gamma` is 1.5"), "{twins}");
    }

    #[test]
    fn a_contradiction_with_a_value_of_the_preset_stays_as_it_is() {
        // another changed setting may have the same value
        for texts in [&["evaluation.every=3"][..], &["evaluation.every=3", "evaluation.looks=0"]] {
            let message = message(texts);
            let expected = "setting `evaluation.visit_rounds` is 0, expected";
            assert!(message.starts_with(expected) && !message.contains("preset"), "{message}");
        }
    }
}
