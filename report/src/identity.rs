//! Which method a run is of: its settings say so, and not the name of its folder.

use clap::ValueEnum;

use experiments::presets::{Budget, Method};
use experiments::{Experiment, RunError};
use learner::overrides::differences;

/// What the settings of a run say of it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Identity {
    /// The method whose preset the run has; none for settings of one's own.
    pub method: Option<Method>,
    /// What must be known of a run whose folder is called `name`: that its settings are no
    /// preset's, or another one's.
    pub remark: Option<String>,
}

impl Identity {
    /// The identity of a run in a folder whose name, up to the seed, is `name`.
    ///
    /// # Errors
    /// Settings that cannot be compared.
    pub fn of(name: &str, run: &Experiment) -> Result<Self, RunError> {
        let (method, named) = (Method::of(run), named(name));
        let remark = match (method, named) {
            (None, _) => Some(remark(named, run)?),
            (Some(own), Some(named)) if own != named => {
                let (own, named) = (own.name(), named.name());
                Some(format!("the settings are those of the preset `{own}`, not of `{named}`"))
            }
            _ => None,
        };
        Ok(Self { method, remark })
    }
}

/// The method whose runs are named so: by the method alone, or by the method and a budget.
fn named(name: &str) -> Option<Method> {
    Method::ALL.into_iter().find(|method| {
        let rest = name.strip_prefix(method.name());
        let mut budgets = Budget::value_variants().iter().map(|budget| budget.name());
        rest.is_some_and(|rest| {
            rest.is_empty() || budgets.any(|budget| rest.strip_prefix('-') == Some(budget))
        })
    })
}

/// In what a run differs from the preset that it is named after, or from the nearest one.
fn remark(named: Option<Method>, run: &Experiment) -> Result<String, RunError> {
    let methods = Method::ALL.into_iter();
    let mut nearest: Option<(Method, String)> = None;
    for method in methods.filter(|&method| named.is_none_or(|named| named == method)) {
        for budget in Budget::value_variants() {
            let found = differences(&budget.preset_like(method, run), run)?;
            if nearest.as_ref().is_none_or(|(_, least)| found.len() < least.len()) {
                nearest = Some((method, found));
            }
        }
    }
    let (method, found) = nearest.unwrap_or((Method::Covers, String::new()));
    let method = method.name();
    Ok(format!("the settings are not those of the preset `{method}`, which differs in {found}"))
}

#[cfg(test)]
mod tests {
    use super::*;
    use learner::LearnerSettings;

    fn identity(name: &str, run: &Experiment) -> Identity {
        Identity::of(name, run).unwrap()
    }

    #[test]
    fn settings_count_and_not_the_name() {
        let run = Budget::Table.experiment(Method::CoversCnn).with_seed(21);
        for name in ["covers-cnn", "covers-cnn-table", "my-own"] {
            let expected = Identity { method: Some(Method::CoversCnn), remark: None };
            assert_eq!(identity(name, &run), expected);
        }
        let wrong = identity("covers", &run);
        assert_eq!(wrong.method, Some(Method::CoversCnn));
        let expected = "the settings are those of the preset `covers-cnn`, not of `covers`";
        assert_eq!(wrong.remark.as_deref(), Some(expected));
    }

    #[test]
    fn settings_of_ones_own_are_no_method_and_say_what_differs() {
        let mut run = Budget::Smoke.experiment(Method::Equi);
        let LearnerSettings::Covers(settings) = &mut run.learner else { panic!() };
        settings.ppo.gamma = 0.5;
        for name in ["equi", "my-own"] {
            let own = identity(name, &run);
            assert_eq!(own.method, None);
            let remark = own.remark.unwrap();
            let expected = "not those of the preset `equi`, which differs in \
                `learner.covers.ppo.gamma` 0.9";
            assert!(remark.contains(expected), "{remark}");
            assert!(remark.ends_with("and 0.5"), "{remark}");
        }
        let other = identity("cnn", &run).remark.unwrap();
        assert!(other.contains("`cnn`") && other.contains("network.group"), "{other}");
    }
}
