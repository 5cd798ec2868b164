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
        if ["integer", "number"].contains(&kind) {
            add_bounds(place, setting.meaning);
        }
        place["type"] = if is_optional { json!([type_name, "null"]) } else { json!(type_name) };
    }
    close_objects(&mut schema);
    schema
}

/// Returns the number that a text begins with, and the rest of the text.
fn leading_number(text: &str) -> Option<(f64, &str)> {
    let end = text.find(|c: char| !c.is_ascii_digit() && !"-.".contains(c)).unwrap_or(text.len());
    // a full stop belongs to the sentence
    let end = text[..end].trim_end_matches('.').len();
    Some((text[..end].parse().ok()?, &text[end..]))
}

/// Returns the number that a text begins with, unless it is part of an expression or has a unit.
fn leading_bound(text: &str) -> Option<f64> {
    let (number, rest) = leading_number(text)?;
    let ends =
        rest.is_empty() || rest.starts_with(" (") || rest.starts_with([',', ';', ':', '.', ')']);
    ends.then_some(number)
}

/// Adds the bounds of a number that its meaning states: `at least 1`, `above 0`, `1 to 8`,
/// `in [0, 1)`.
fn add_bounds(place: &mut Value, meaning: &str) {
    let meaning = meaning.replace('`', "");
    let words = [("at least ", "minimum"), ("above ", "exclusiveMinimum"), ("at most ", "maximum")];
    for (word, keyword) in words {
        let number = meaning.split(word).skip(1).find_map(leading_bound);
        if let Some(number) = number {
            place[keyword] = json!(number);
        }
    }
    let range = |(at, _): (usize, &str)| {
        let (low, rest) = leading_number(meaning[at..].trim_start_matches([' ', '(']))?;
        Some((low, leading_bound(rest.strip_prefix(" to ")?)?))
    };
    let starts = meaning.match_indices([' ', '(']);
    if let Some((low, high)) = starts.filter_map(range).next() {
        (place["minimum"], place["maximum"]) = (json!(low), json!(high));
    }
    for (start, low_keyword) in [("in [", "minimum"), ("in (", "exclusiveMinimum")] {
        let interval = meaning.split_once(start).and_then(|(_, rest)| rest.split_once(", "));
        if let Some((low, rest)) = interval
            && let (Some((low, _)), Some((high, end))) = (leading_number(low), leading_number(rest))
        {
            place[low_keyword] = json!(low);
            let is_closed = end.starts_with(']');
            place[if is_closed { "maximum" } else { "exclusiveMaximum" }] = json!(high);
        }
    }
}

/// Allows no other properties in objects than those that the schema knows.
fn close_objects(schema: &mut Value) {
    if schema["properties"].is_object() {
        schema["additionalProperties"] = json!(false);
    }
    let inside = schema.as_object_mut().into_iter().flat_map(|of| of.values_mut());
    inside.filter(|value| value.is_object()).for_each(close_objects);
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
        let bound = |keyword: &str| schema[keyword].as_f64().filter(|_| value.is_number());
        let number = value.as_f64().unwrap_or(0.0);
        if bound("minimum").is_some_and(|end| number < end)
            || bound("exclusiveMinimum").is_some_and(|end| number <= end)
            || bound("maximum").is_some_and(|end| number > end)
            || bound("exclusiveMaximum").is_some_and(|end| number >= end)
        {
            found.push(format!("{path}: {value} is out of range"));
        }
        for (name, inner) in value.as_object().into_iter().flatten() {
            if schema["additionalProperties"] == json!(false)
                && schema["properties"][name].is_null()
            {
                found.push(format!("{path}.{name} is unknown"));
            }
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
        wrong["learner"]["covers"]["noise_correlation"] = json!(1);
        wrong["learner"]["covers"]["ppo"]["epochs"] = json!(0);
        wrong["learner"]["covers"]["ppo"]["epoch"] = json!(4);
        assert_eq!(problems(&schema, &wrong, "").len(), 5, "{:?}", problems(&schema, &wrong, ""));
    }

    #[test]
    fn bounds_are_those_of_the_meanings() {
        let bounds = |meaning: &str| {
            let mut place = json!({});
            add_bounds(&mut place, meaning);
            place
        };
        for (meaning, expected) in [
            ("Number of steps, 1 to 65536.", json!({"minimum": 1.0, "maximum": 65536.0})),
            ("Radius (mm, 0 to 200): uniform.", json!({"minimum": 0.0, "maximum": 200.0})),
            ("Share, in `(0, 1]`.", json!({"exclusiveMinimum": 0.0, "maximum": 1.0})),
            ("Minibatch, at least 2 (one has no advantage).", json!({"minimum": 2.0})),
            ("Weight, at least 0: of the distance.", json!({"minimum": 0.0})),
            ("Level, in `(0, doubt]`, at least `1 / (1 + splits)`.", json!({})),
            ("Blur (mm, 0 to 4 pixels), above the table.", json!({})),
        ] {
            assert_eq!(bounds(meaning), expected, "{meaning}");
        }
        let text = settings_schema().to_string();
        assert!(text.matches("imum\":").count() > 100, "{text}");
    }

    #[test]
    fn settings_are_explained_with_their_values() {
        let text = explain_settings(&tree(Method::Covers));
        assert!(text.contains("\ncovers.rollout_steps = 500\n    Number of decisions"), "{text}");
        assert!(!text.contains("off_policy"), "{text}");
    }
}
