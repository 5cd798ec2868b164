//! Settings of a run with their types and meanings, from the documentation of their types.

use std::ffi::OsStr;

use clap::builder::{PossibleValue, TypedValueParser};
use clap::{Arg, Command, Error};
use learner::overrides::SettingOverride;
use serde_json::{Value, json};

/// Rows of `docs/settings.md`: path, type and meaning, separated by tabs.
const TABLE: &str = include_str!("settings.tsv");

/// Setting, or a choice of one that has no settings of its own (`covers.grouping=single`).
#[derive(Clone, Copy)]
struct Setting {
    path: &'static str,
    kind: &'static str,
    meaning: &'static str,
}

fn settings() -> impl Iterator<Item = Setting> {
    TABLE.lines().filter_map(|line| {
        let mut cells = line.split('\t');
        Some(Setting { path: cells.next()?, kind: cells.next()?, meaning: cells.next()? })
    })
}

/// Returns the path of a setting in a file of settings, where a learner has a name of its own.
fn path_in_file(path: &str) -> impl Iterator<Item = &str> {
    let is_learners = path.starts_with("covers") || path.starts_with("off_policy");
    is_learners.then_some("learner").into_iter().chain(path.split('.'))
}

/// Returns the settings of an experiment, each with its value and, on the next line, its meaning.
pub fn explain_settings(experiment: &Value) -> String {
    let lines = settings().filter_map(|Setting { path, meaning, .. }| {
        let pointer: String = path_in_file(path).map(|name| format!("/{name}")).collect();
        let value = experiment.pointer(&pointer).filter(|value| !value.is_object())?;
        Some(format!("{path} = {value}\n    {meaning}"))
    });
    lines.collect::<Vec<_>>().join("\n")
}

/// Returns the JSON schema of a run's settings file.
pub fn settings_schema() -> Value {
    let mut schema = json!({
        "$schema": "https://json-schema.org/draft/2020-12/schema",
        "title": "Settings of a run",
        "type": "object",
    });
    for setting in settings().filter(|setting| !setting.path.contains('=')) {
        let place = path_in_file(setting.path).fold(&mut schema, |place, name| {
            if name.parse::<usize>().is_ok() {
                &mut place["items"]
            } else {
                &mut place["properties"][name]
            }
        });
        place["description"] = json!(setting.meaning);
        let (kind, is_optional) = match setting.kind.strip_suffix(" or `null`") {
            Some(kind) => (kind, true),
            None => (setting.kind, false),
        };
        let type_name = match kind {
            "integer" | "number" | "object" => kind,
            "name" => "string",
            list if list.starts_with("list") => "array",
            choices => {
                let names: Vec<&str> = choices.split('`').skip(1).step_by(2).collect();
                let is_word = |name: &&str| {
                    let own = format!("{}={name}", setting.path);
                    settings().any(|other| other.path == own)
                };
                if names.iter().all(is_word) && !is_optional {
                    place["enum"] = json!(names);
                }
                continue;
            }
        };
        place["type"] = if is_optional { json!([type_name, "null"]) } else { json!(type_name) };
    }
    schema
}

/// Parser of the option `--set`, which lists the paths of all settings for shell completion.
#[derive(Clone)]
pub(crate) struct OverrideParser;

impl TypedValueParser for OverrideParser {
    type Value = SettingOverride;

    fn parse_ref(
        &self,
        command: &Command,
        argument: Option<&Arg>,
        value: &OsStr,
    ) -> Result<SettingOverride, Error> {
        let parser = |text: &str| text.parse::<SettingOverride>();
        parser.parse_ref(command, argument, value)
    }

    fn possible_values(&self) -> Option<Box<dyn Iterator<Item = PossibleValue> + '_>> {
        Some(Box::new(settings().map(|setting| PossibleValue::new(setting.path))))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use experiments::presets::{Budget, Method};

    fn tree(method: Method) -> Value {
        let text = serde_json::to_string(&Budget::Full.preset_experiment(method)).unwrap();
        serde_json::from_str(&text).unwrap()
    }

    /// Returns the problems of a value by a schema of the kind that [`settings_schema`] writes.
    fn problems(schema: &Value, value: &Value, path: &str) -> Vec<String> {
        let types = match &schema["type"] {
            Value::Null => Vec::new(),
            Value::Array(types) => types.clone(),
            one => vec![one.clone()],
        };
        let is = |name: &Value| match name.as_str() {
            Some("integer") => value.is_u64(),
            Some("number") => value.is_number(),
            Some("string") => value.is_string(),
            Some("array") => value.is_array(),
            Some("object") => value.is_object(),
            _ => value.is_null(),
        };
        let mut found = Vec::new();
        if !types.is_empty() && !types.iter().any(is) {
            found.push(format!("{path}: {value} is none of {types:?}"));
        }
        if let Some(choices) = schema["enum"].as_array()
            && !choices.contains(value)
        {
            found.push(format!("{path}: {value} is none of {choices:?}"));
        }
        for (name, inner) in value.as_object().into_iter().flatten() {
            found.extend(problems(&schema["properties"][name], inner, &format!("{path}.{name}")));
        }
        for inner in value.as_array().into_iter().flatten() {
            found.extend(problems(&schema["items"], inner, path));
        }
        found
    }

    #[test]
    fn every_preset_fits_the_schema_and_a_wrong_one_does_not() {
        let schema = settings_schema();
        for method in Method::ALL {
            assert_eq!(problems(&schema, &tree(method), ""), <[String; 0]>::default());
        }
        let mut wrong = tree(Method::Covers);
        wrong["learner"]["covers"]["rollout_steps"] = json!("many");
        wrong["learner"]["covers"]["network"]["group"] = json!("D9");
        assert_eq!(problems(&schema, &wrong, "").len(), 2);
    }

    #[test]
    fn settings_are_explained_with_their_values() {
        let text = explain_settings(&tree(Method::Covers));
        assert!(text.contains("\ncovers.rollout_steps = 500\n    Number of decisions"), "{text}");
        assert!(!text.contains("off_policy"), "{text}");
    }
}
