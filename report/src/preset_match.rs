//! Method of a run, found by comparing its settings with the presets. The folder's name decides
//! nothing.

use clap::ValueEnum;

use experiments::presets::{Budget, Method};
use experiments::{Experiment, NearestPreset, RunError};

/// Method whose preset a run's settings are, if any, with a warning if there is none or the
/// folder's name stands for another one.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct PresetMatch {
    /// Method whose preset the run has; `None` if the settings are no preset's.
    pub method: Option<Method>,
    /// Warning about a folder's name that promises another preset, or about settings that are no
    /// preset's; `None` if name and settings agree.
    pub warning: Option<String>,
}

impl PresetMatch {
    /// Finds the preset that the settings of a run are equal to; `name` is that of its folder, up
    /// to the seed.
    ///
    /// # Errors
    /// [`RunError`] for settings that cannot be compared.
    pub fn compare(name: &str, run: &Experiment) -> Result<Self, RunError> {
        let (method, named) = (Method::from_experiment(run), named(name));
        let warning = match (method, named) {
            (None, _) => Some(difference_warning(named, run)?),
            (Some(own), Some(named)) if own != named => {
                let (own, named) = (own.name(), named.name());
                Some(format!("the settings are those of the preset `{own}`, not of `{named}`"))
            }
            _ => None,
        };
        Ok(Self { method, warning })
    }

    /// Returns the method in words, such as "COVERS with soft actor-critic": the beginning of its
    /// help on the command line. `None` if the settings are no preset's.
    pub(crate) fn method_in_words(&self) -> Option<String> {
        let help = self.method?.to_possible_value()?.get_help()?.to_string();
        help.split([':', ';', ',']).next().map(str::to_owned)
    }
}

/// Returns the method that a folder's name stands for, alone or followed by a budget.
fn named(name: &str) -> Option<Method> {
    Method::ALL.into_iter().find(|method| {
        let rest = name.strip_prefix(method.name());
        let mut budgets = Budget::value_variants().iter().map(|budget| budget.name());
        rest.is_some_and(|rest| {
            rest.is_empty() || budgets.any(|budget| rest.strip_prefix('-') == Some(budget))
        })
    })
}

/// Describes the differences of a run from the preset that it is named after, or from the nearest
/// one.
fn difference_warning(named: Option<Method>, run: &Experiment) -> Result<String, RunError> {
    let preset = |budget: Budget, method| budget.preset_with_run_settings(method, run);
    let NearestPreset { method, differences, .. } = NearestPreset::by(named, run, preset)?;
    let method = method.name();
    Ok(format!(
        "the settings are not those of the preset `{method}`, which differs in {differences}"
    ))
}

/// Describes the settings of a run by the nearest preset, the seed, and the settings that differ
/// from these.
pub fn describe_settings(nearest: &NearestPreset, run: &Experiment) -> String {
    let seed = run.learner.seed();
    let differing = match nearest.differences.as_str() {
        "" => String::new(),
        found => format!(". Different from these, the run's value last: {found}"),
    };
    format!("`{} --seed {seed}`{differing}", nearest.options())
}

#[cfg(test)]
mod tests {
    use super::*;
    use learner::LearnerSettings;

    fn preset_match(name: &str, run: &Experiment) -> PresetMatch {
        PresetMatch::compare(name, run).unwrap()
    }

    #[test]
    fn settings_count_and_not_the_name() {
        let run = Budget::TableProtocol.preset_experiment(Method::CoversCnn).with_seed(21);
        for name in ["covers-cnn", "covers-cnn-table", "my-own"] {
            let expected = PresetMatch { method: Some(Method::CoversCnn), warning: None };
            assert_eq!(preset_match(name, &run), expected);
        }
        let wrong = preset_match("covers", &run);
        assert_eq!(wrong.method, Some(Method::CoversCnn));
        let expected = "the settings are those of the preset `covers-cnn`, not of `covers`";
        assert_eq!(wrong.warning.as_deref(), Some(expected));
    }

    #[test]
    fn settings_of_ones_own_are_no_method_and_say_what_differs() {
        let mut run = Budget::Smoke.preset_experiment(Method::Equi);
        let LearnerSettings::Covers(settings) = &mut run.learner else { panic!() };
        settings.ppo.gamma = 0.5;
        for name in ["equi", "my-own"] {
            let own = preset_match(name, &run);
            assert_eq!(own.method, None);
            let warning = own.warning.unwrap();
            let expected = "not those of the preset `equi`, which differs in \
                `learner.covers.ppo.gamma` 0.9";
            assert!(warning.contains(expected), "{warning}");
            assert!(warning.ends_with("and 0.5"), "{warning}");
        }
        let described = describe_settings(&NearestPreset::of_run(None, &run).unwrap(), &run);
        let start = "`--preset equi --budget smoke --seed 0`. Different from these, the run's value \
            last: `learner.covers.ppo.gamma` 0.9";
        assert!(described.starts_with(start), "{described}");
        let other = preset_match("cnn", &run).warning.unwrap();
        assert!(other.contains("`cnn`") && other.contains("network.group"), "{other}");
    }
}
