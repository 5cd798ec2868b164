//! `covers presets`: the list of methods and budgets, and the settings of a preset.

use std::io::Write;
use std::path::Path;

use clap::{Args, ValueEnum};

use crate::setting_list;
use experiments::RunError;
use experiments::presets::{Budget, Method};

/// Options of `covers presets`.
#[derive(Clone, Copy, Debug, Args)]
#[command(after_help = "Examples:\n  covers presets\n  \
    covers presets covers --explain\n  \
    covers presets covers --budget short > experiment.json")]
pub struct PresetsOptions {
    /// Print the settings of this preset as JSON instead, as a file for `covers train --config`.
    #[arg(value_enum)]
    pub preset: Option<Method>,
    /// Length of the run.
    #[arg(long, value_enum, default_value = "full")]
    pub budget: Budget,
    /// Print the meaning of each setting below its value.
    #[arg(long, requires = "preset")]
    pub explain: bool,
    /// Print a JSON schema of files of settings.
    #[arg(long, conflicts_with_all = ["preset", "explain"])]
    pub schema: bool,
}

impl PresetsOptions {
    /// Prints the list of presets and budgets, the settings of one preset, or a JSON schema of
    /// settings.
    ///
    /// # Errors
    /// An `out` that cannot be written to.
    pub fn run(&self, out: &mut impl Write) -> Result<(), RunError> {
        let stdout = Path::new("standard output");
        let text = match self.preset {
            None if self.schema => format!("{:#}", setting_list::settings_schema()),
            // not through a `Value`, which would print 0.95 of an f32 as 0.949999988079071
            Some(preset) => {
                let text = serde_json::to_string_pretty(&self.budget.preset_experiment(preset))
                    .map_err(RunError::write_error_mapper(stdout))?;
                match serde_json::from_str(&text) {
                    Ok(settings) if self.explain => setting_list::explain_settings(&settings),
                    _ => text,
                }
            }
            None => format!("presets:\n{}\n\nbudgets:\n{}", lines::<Method>(), lines::<Budget>()),
        };
        writeln!(out, "{text}").map_err(RunError::write_error_mapper(stdout))
    }
}

/// Formats one line for each value, with its name and its help text.
fn lines<V: ValueEnum>() -> String {
    let values = V::value_variants().iter();
    let line = |value: &V| {
        let value = value.to_possible_value()?;
        let help = value.get_help().map(ToString::to_string);
        Some(format!("  {:<17} {}", value.get_name(), help?))
    };
    values.filter_map(line).collect::<Vec<_>>().join("\n")
}

#[cfg(test)]
mod tests {
    use super::*;
    use experiments::Experiment;

    fn printed(preset: Option<Method>, budget: Budget) -> String {
        let mut out = Vec::new();
        PresetsOptions { preset, budget, explain: false, schema: false }.run(&mut out).unwrap();
        String::from_utf8(out).unwrap()
    }

    #[test]
    fn every_preset_and_budget_is_told_in_a_line() {
        let list = printed(None, Budget::Full);
        for name in Method::ALL.map(Method::name) {
            assert!(list.contains(&format!("\n  {name} ")), "{name}: {list}");
        }
        assert!(list.contains("\n  zero-shot "), "{list}");
        let lines = Method::ALL.len() + Budget::value_variants().len() + 3;
        assert_eq!(list.lines().count(), lines);
    }

    #[test]
    fn what_is_printed_of_a_preset_is_its_settings() {
        for method in Method::ALL {
            let text = printed(Some(method), Budget::Smoke);
            assert_eq!(
                serde_json::from_str::<Experiment>(&text).unwrap(),
                Budget::Smoke.preset_experiment(method)
            );
            let digits = |number: &str| number.trim_start_matches(['-', '0', '.']).len();
            let numbers = text.split(|c: char| !c.is_ascii_digit() && !"-.e".contains(c));
            assert!(numbers.map(digits).all(|digits| digits < 10), "{text}");
        }
    }
}
