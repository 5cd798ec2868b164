//! Settings by name, as in `--set covers.ppo.gamma=0.97`, and errors that propose the nearest name.

use std::io;
use std::path::Path;
use std::str::FromStr;

use serde::Serialize;
use serde::de::DeserializeOwned;
use serde_json::Value;

use crate::error::LearnerError;

/// Field of the experiment in which the path of a setting is looked up if the experiment itself
/// does not have it.
const LEARNER: &str = "learner";
/// Length in characters of the longest unknown name for which a similar setting is proposed; limits
/// the time of the search.
const LONGEST: usize = 100;

const LARGEST_FILE: u64 = 64 << 20;

/// Path of a setting and its new value, as given by `--set PATH=VALUE`.
///
/// The path follows the fields of `experiment.json`, separated by dots; the elements of a list are
/// numbered from 0, and a leading `learner.` may be left out. The value is JSON; a word needs no
/// quotes.
#[derive(Clone, Debug, PartialEq)]
pub struct SettingOverride {
    path: String,
    value: Value,
}

impl SettingOverride {
    /// Returns `true` if the override sets the learner's field at `path` or one that holds it.
    pub fn sets(&self, path: &str) -> bool {
        let rest = short_path(path).strip_prefix(short_path(&self.path));
        self.path == LEARNER || rest.is_some_and(|rest| rest.is_empty() || rest.starts_with('.'))
    }
}

impl FromStr for SettingOverride {
    type Err = LearnerError;

    fn from_str(text: &str) -> Result<Self, LearnerError> {
        let (path, value) = text
            .split_once('=')
            .ok_or_else(|| LearnerError::NotAnOverride { text: text.to_owned() })?;
        let word = || Value::String(value.to_owned());
        Ok(Self {
            path: path.trim().to_owned(),
            value: serde_json::from_str(value).unwrap_or_else(|_| word()),
        })
    }
}

/// Returns the settings with the overridden fields changed; of several values for one field the
/// last counts.
///
/// # Errors
/// [`LearnerError::UnknownSetting`] for an unknown path, [`LearnerError::WrongSetting`] for
/// a value of another type.
pub fn apply_overrides<T: Serialize + DeserializeOwned>(
    overrides: &[SettingOverride],
    settings: T,
) -> Result<T, LearnerError> {
    if overrides.is_empty() {
        return Ok(settings);
    }
    let mut tree = tree(&settings)?;
    for change in overrides {
        let path = find(&tree, &change.path)?;
        // `find` returned the path, so the pointer exists
        if let Some(place) = tree.pointer_mut(&pointer(&path)) {
            place.clone_from(&change.value);
        }
    }
    from_json_value(tree)
}

/// Returns the full path of a setting in the JSON tree of all settings.
fn find(tree: &Value, path: &str) -> Result<String, LearnerError> {
    let ways = [path.to_owned(), format!("{LEARNER}.{path}")];
    let found = ways.into_iter().find(|way| lookup(tree, way).is_some());
    found.ok_or_else(|| LearnerError::UnknownSetting {
        name: path.to_owned(),
        methods: methods_with(tree, path),
        nearest: nearest_path(tree, path),
    })
}

/// Returns a remark on the methods whose settings begin like `path`, if those of `tree` do not.
fn methods_with(tree: &Value, path: &str) -> Option<&'static str> {
    let part = short_path(path).split('.').next()?;
    let remark = match part {
        "covers" => " (methods that learn by PPO have `covers`, such as `--preset covers`)",
        "off_policy" => {
            " (methods that learn by SAC have `off_policy`, such as `--preset covers-sac`)"
        }
        _ => return None,
    };
    lookup(tree, &join(LEARNER, part)).is_none().then_some(remark)
}

/// Rejects a checkpoint that was written with settings other than `asked`.
///
/// # Errors
/// [`LearnerError::CheckpointSettingsDiffer`] names the fields that differ.
pub fn check_same_settings<T: Serialize>(
    path: &Path,
    asked: &T,
    written: &T,
) -> Result<(), LearnerError> {
    let differences = setting_differences(asked, written)?;
    if differences.is_empty() {
        return Ok(());
    }
    Err(LearnerError::CheckpointSettingsDiffer { path: path.to_owned(), differences })
}

/// Returns the fields in which two sets of settings differ, with both values of each, as text.
pub fn setting_differences<T: Serialize>(one: &T, other: &T) -> Result<String, LearnerError> {
    let text = |own: &SettingDifference| format!("`{}` {} and {}", own.path, own.one, own.other);
    let differing: Vec<String> = differing_settings(one, other)?.iter().map(text).collect();
    Ok(differing.join("; "))
}

/// Setting that differs between two sets of settings.
#[derive(Clone, Debug, PartialEq)]
pub struct SettingDifference {
    /// Path of the setting.
    pub path: String,
    /// Value in the first set.
    pub one: Value,
    /// Value in the second set.
    pub other: Value,
}

/// Returns the fields in which two sets of settings differ; an object or list as a whole where its
/// fields have other names.
///
/// # Errors
/// [`LearnerError::WrongSetting`] for settings that cannot be written as JSON.
pub fn differing_settings<T: Serialize>(
    one: &T,
    other: &T,
) -> Result<Vec<SettingDifference>, LearnerError> {
    let mut differing = Vec::new();
    compare(&tree(one)?, &tree(other)?, "", &mut differing);
    Ok(differing)
}

fn compare(one: &Value, other: &Value, path: &str, differing: &mut Vec<SettingDifference>) {
    let (ours, theirs) = (children(one), children(other));
    let same_names = ours.iter().map(|(name, _)| name).eq(theirs.iter().map(|(name, _)| name));
    if !ours.is_empty() && same_names {
        for ((name, a), (_, b)) in ours.iter().zip(&theirs) {
            compare(a, b, &join(path, name), differing);
        }
    } else if one != other {
        let (path, one, other) = (path.to_owned(), one.clone(), other.clone());
        differing.push(SettingDifference { path, one, other });
    }
}

/// Reads settings from a file of JSON.
///
/// # Errors
/// [`LearnerError::Read`] names the file and what is wrong in it, see [`parse_json`].
pub fn read_json<T: DeserializeOwned>(path: &Path) -> Result<T, LearnerError> {
    let text = read_text(path).map_err(|error| LearnerError::cannot_read(path, error))?;
    parse_json(&text).map_err(|error| LearnerError::cannot_read(path, error))
}

/// Reads a file of text. Devices and pipes are refused, since they may never end.
fn read_text(path: &Path) -> io::Result<String> {
    let problem = match std::fs::metadata(path)? {
        file if !file.is_file() => "it is not a regular file".to_owned(),
        file if file.len() > LARGEST_FILE => {
            format!("it has {} bytes, expected at most {LARGEST_FILE}", file.len())
        }
        _ => return std::fs::read_to_string(path),
    };
    Err(io::Error::other(problem))
}

/// Reads settings from JSON, with or without a byte order mark, which editors of Windows write.
///
/// # Errors
/// [`LearnerError::NotJson`], [`LearnerError::UnknownSetting`], [`LearnerError::WrongSetting`].
pub fn parse_json<T: DeserializeOwned>(text: &str) -> Result<T, LearnerError> {
    let text = text.strip_prefix('\u{feff}').unwrap_or(text);
    let not_json = |source| LearnerError::NotJson { source };
    serde_json::from_str(text).or_else(|error| {
        // only errors of a tree name the path; a duplicate field, which a tree accepts, stays an
        // error of the text
        from_json_value::<T>(serde_json::from_str(text).map_err(not_json)?)?;
        Err(not_json(error))
    })
}

/// Reads a typed value from JSON; errors name the path and the nearest valid name.
///
/// # Errors
/// [`LearnerError::UnknownSetting`], [`LearnerError::WrongSetting`].
pub fn from_json_value<T: DeserializeOwned>(tree: Value) -> Result<T, LearnerError> {
    serde_path_to_error::deserialize(tree).map_err(|error| {
        let path = error.path().to_string();
        let problem = error.inner().to_string();
        // serde lists what it expected between backquotes, the unknown name first
        let mut quoted = problem.split('`').skip(1).step_by(2);
        let is_unknown = |what: &str| problem.starts_with(&format!("unknown {what} `"));
        let (unknown_field, unknown_variant) = (is_unknown("field"), is_unknown("variant"));
        let name = quoted.next().unwrap_or_default();
        let nearest = nearest(quoted, name).map(str::to_owned);
        if unknown_field {
            return LearnerError::UnknownSetting { name: path, methods: None, nearest };
        }
        let nearest = nearest.filter(|_| unknown_variant);
        let path = short_path(&path).to_owned();
        LearnerError::WrongSetting { path, problem: in_plain_words(&problem), nearest }
    })
}

/// Returns a message of serde with words in place of Rust's names of types.
fn in_plain_words(problem: &str) -> String {
    let (start, expected) = problem.rsplit_once("expected ").unwrap_or((problem, ""));
    let words = match expected {
        "usize" | "u64" => "a whole number of at least 0",
        "f32" | "f64" => "a number",
        "a sequence" => "a list",
        "a map" => "an object",
        name if name.starts_with("struct ") => "an object",
        _ => return problem.to_owned(),
    };
    format!("{start}expected {words}")
}

fn tree(settings: &impl Serialize) -> Result<Value, LearnerError> {
    // as text an f32 has only the digits it needs, while a tree would widen it to an f64
    let text = serde_json::to_string(settings);
    let tree = text.and_then(|text| serde_json::from_str(&text));
    tree.map_err(|error| LearnerError::WrongSetting {
        path: "settings".to_owned(),
        problem: error.to_string(),
        nearest: None,
    })
}

fn lookup<'a>(tree: &'a Value, path: &str) -> Option<&'a Value> {
    tree.pointer(&pointer(path))
}

/// Returns the JSON pointer (RFC 6901) of a dotted path.
fn pointer(path: &str) -> String {
    let escaped = path.replace('~', "~0").replace('/', "~1");
    format!("/{}", escaped.replace('.', "/"))
}

/// Returns a setting's path as `--set` takes it, without a leading `learner.`.
pub fn short_path(path: &str) -> &str {
    path.strip_prefix("learner.").unwrap_or(path)
}

/// Returns the path of a setting that is most like `wanted`: one that ends with `wanted`, or else
/// the nearest by edit distance among those with as many dots, or else one of the same last name,
/// as other methods have it under another path.
fn nearest_path(tree: &Value, wanted: &str) -> Option<String> {
    let mut all = Vec::new();
    paths(tree, "", &mut all);
    all.sort_by_key(|path| path.starts_with(LEARNER));
    let all: Vec<&str> = all.iter().map(|path| short_path(path)).collect();
    let ending = format!(".{wanted}");
    // the learner's paths come last and are more likely, hence the search from the end
    let ends = all.iter().rfind(|path| path.ends_with(&ending)).copied();
    let depth = |path: &str| path.matches('.').count();
    let alike = all.iter().copied().filter(|path| depth(path) == depth(wanted));
    let namesake = || all.iter().rfind(|path| last_name(path) == last_name(wanted)).copied();
    ends.or_else(|| nearest(alike, wanted)).or_else(namesake).map(str::to_owned)
}

/// Returns the part of a path behind its last dot.
fn last_name(path: &str) -> &str {
    path.rsplit('.').next().unwrap_or(path)
}

/// Returns the nearest name by edit distance, up to three or a third of the length of `wanted`,
/// whichever is more: a name further away would not help.
pub fn nearest<'a>(names: impl Iterator<Item = &'a str>, wanted: &str) -> Option<&'a str> {
    let length = wanted.chars().count();
    if length > LONGEST {
        return None;
    }
    let mut best = None;
    let mut most = (length / 3).max(3);
    for name in names {
        // lower bound of the distance, which saves the slow comparison for most names
        let least = name.chars().count().abs_diff(length);
        if least <= most {
            let edits = strsim::osa_distance(name, wanted);
            if edits < most || edits == most && best.is_none() {
                (most, best) = (edits, Some(name));
            }
        }
    }
    best
}

fn paths(tree: &Value, path: &str, all: &mut Vec<String>) {
    for (name, child) in children(tree) {
        let path = join(path, &name);
        paths(child, &path, all);
        all.push(path);
    }
}

fn children(tree: &Value) -> Vec<(String, &Value)> {
    match tree {
        Value::Object(fields) => fields.iter().map(|(name, v)| (name.clone(), v)).collect(),
        Value::Array(items) => {
            let numbered = items.iter().enumerate();
            numbered.map(|(index, v)| (index.to_string(), v)).collect()
        }
        _ => Vec::new(),
    }
}

fn join(path: &str, name: &str) -> String {
    if path.is_empty() { name.to_owned() } else { format!("{path}.{name}") }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[derive(Debug, serde::Deserialize)]
    #[serde(rename_all = "kebab-case")]
    enum Method {
        Covers,
        CoversGt,
    }

    #[test]
    fn an_unknown_choice_is_answered_with_the_list_and_the_nearest() {
        let message = |text| parse_json::<Vec<Method>>(text).unwrap_err().to_string();
        let near = message(r#"["covers", "covers-gtt"]"#);
        let expected = "setting `[1]`: unknown variant `covers-gtt`, expected `covers` or \
            `covers-gt`; did you mean `covers-gt`?";
        assert_eq!(near, expected);
        let far = message(r#"["something else"]"#);
        assert!(far.ends_with("expected `covers` or `covers-gt`"), "{far}");
    }

    #[test]
    fn types_are_named_in_words_and_the_whole_without_a_path() {
        #[derive(Debug, serde::Deserialize)]
        struct Settings {
            #[serde(rename = "seed")]
            _seed: usize,
        }
        let message = |text| parse_json::<Settings>(text).unwrap_err().to_string();
        let negative = message(r#"{"seed": -1}"#);
        assert!(negative.ends_with("expected a whole number of at least 0"), "{negative}");
        assert_eq!(message("{}"), "missing field `seed`");
        // a byte order mark first
        assert!(parse_json::<Settings>("\u{feff}{\"seed\": 1}").is_ok());
    }

    #[test]
    fn a_setting_of_another_method_is_found_by_its_last_name() {
        let settings = serde_json::json!({"learner": {"off_policy": {"sac": {"gamma": 0.97}}}});
        let nearest = nearest_path(&settings, "covers.ppo.gamma");
        assert_eq!(nearest.as_deref(), Some("off_policy.sac.gamma"));
        assert_eq!(nearest_path(&settings, "covers.ppo.epochs"), None);
    }

    #[test]
    fn the_nearest_name_is_that_of_the_fewest_edits_and_the_first_of_equals() {
        let names = ["seed", "speed", "gamma", "gala", "längen"];
        for wanted in ["sed", "seeds", "gam", "gamme", "laengen", "länge", "speeed", "g"] {
            let slow = names.iter().min_by_key(|name| strsim::osa_distance(name, wanted));
            assert_eq!(nearest(names.into_iter(), wanted), slow.copied(), "{wanted}");
        }
        for wanted in ["nothing of that", &"seed".repeat(100)] {
            assert_eq!(nearest(names.into_iter(), wanted), None, "{wanted}");
        }
    }
}
