//! `docs/settings.md`, and the list of the program, are what the code says: fields of settings, first sentences of their
//! documentation, and values of presets.

use std::collections::HashMap;
use std::fmt::Write;
use std::fs;
use std::path::Path;

use covers::presets::{Budget, Method};
use serde_json::Value;

/// Files of the types of settings.
const SOURCES: [&str; 19] = [
    "envs/src/camera.rs",
    "envs/src/control.rs",
    "envs/src/layout.rs",
    "envs/src/randomisation.rs",
    "envs/src/settings.rs",
    "evidence/src/settings.rs",
    "experiments/src/experiment.rs",
    "experiments/src/schedule.rs",
    "learner/src/groupings/settings.rs",
    "learner/src/learners/collection/settings.rs",
    "learner/src/learners/covers.rs",
    "learner/src/learners/off_policy.rs",
    "learner/src/learners/settings.rs",
    "rl/src/encoder.rs",
    "rl/src/network_settings.rs",
    "rl/src/ppo/settings.rs",
    "rl/src/ppo/symmetry_loss.rs",
    "rl/src/sac/context.rs",
    "rl/src/sac/settings.rs",
];
const SYMMETRIES: [&str; 2] = ["symmetry/src/d2.rs", "symmetry/src/group.rs"];

const HEAD: &str = "# Settings

Paths and values of `--set PATH=VALUE`, which are also the names in a file of `--config`
([commands](commands.md#settings)). Values are those of the preset `covers`, and below `off_policy`
those of `covers-sac`, the default preset. A dash marks a part that the preset does not have. Such a
part is set as a whole, as JSON: `--set 'covers.grouping={\"threshold\":{\"threshold\":1}}'`, or
`--set 'envs.randomisation={}'` for the values of `covers-randomised`. The elements of a list have
the numbers 0, 1 and so on.

This page is made from the code: `COVERS_WRITE=1 cargo test --test suite settings` writes it.
";

/// Field of a struct, or variant of an enum.
struct Member {
    name: String,
    /// Type, as the source has it; empty for a variant without content.
    kind: String,
    /// First sentence of the documentation.
    doc: String,
}

#[derive(Default)]
struct Type {
    is_enum: bool,
    members: Vec<Member>,
}

/// Types by name. The fields of a variant are a type, called `Enum::Variant`.
struct Types(HashMap<String, Type>);

/// Returns the first sentence, without links, which lead to code, and with members of other types
/// as files name them.
fn sentence(doc: &str) -> String {
    let (sentence, _) = doc.split_once(". ").unwrap_or((doc, ""));
    let mut parts = sentence.trim().trim_end_matches('.').split("](");
    let first = parts.next().unwrap().to_owned();
    let text = parts.fold(first, |text, part| text + part.split_once(')').unwrap().1);
    let text = text.replace("[`", "`").replace("`]", "`").replace("`None`", "`null`");
    let escaped = text.replace('|', "\\|");
    let name = |(index, part): (usize, &str)| match part.rsplit_once("::") {
        Some((_, name)) if index % 2 == 1 => in_files(name, "snake_case"),
        _ => part.to_owned(),
    };
    escaped.split('`').enumerate().map(name).collect::<Vec<_>>().join("`") + "."
}

fn in_files(variant: &str, rule: &str) -> String {
    let word = |(i, c): (usize, char)| match c {
        'A'..='Z' if i > 0 && rule == "snake_case" => format!("_{}", c.to_ascii_lowercase()),
        'A'..='Z' if !rule.is_empty() => c.to_ascii_lowercase().to_string(),
        c => c.to_string(),
    };
    variant.char_indices().map(word).collect()
}

fn quoted<'a>(line: &'a str, after: &str) -> Option<&'a str> {
    line.split_once(after).and_then(|(_, rest)| rest.split('"').next())
}

impl Types {
    /// Reads the public types of a file in rustfmt's layout, with one member a line.
    fn read(&mut self, source: &str) {
        let (mut owner, mut variant, mut rule) = (None::<String>, String::new(), "");
        let (mut doc, mut name, mut skipped) = (String::new(), None, false);
        for line in source.lines() {
            let text = line.trim();
            let item = ["pub struct ", "pub enum "].iter().find_map(|word| line.strip_prefix(word));
            if let Some(item) = item.and_then(|item| item.strip_suffix(" {")) {
                let is_enum = line.contains(" enum ");
                self.0.insert(item.to_owned(), Type { is_enum, ..Type::default() });
                (owner, doc) = (Some(item.to_owned()), String::new());
            } else if line == "}" {
                (owner, rule) = (None, "");
            } else if text.starts_with("#[") {
                rule = quoted(text, "rename_all = \"").unwrap_or(rule);
                name = quoted(text, "rename = \"").map(str::to_owned).or(name);
                skipped |= text.contains("serde(skip)");
            } else if let Some(words) = text.strip_prefix("///") {
                doc += if words.is_empty() { ". " } else { words };
            } else if let (Some(owner), Some(declared)) = (&owner, text.strip_suffix([',', '{'])) {
                let (field, of) = (declared.trim_start_matches("pub "), text.ends_with('{'));
                let inside = line.starts_with("        ");
                let (label, kind) = if let Some((field, kind)) = field.split_once(": ") {
                    (field.to_owned(), kind.to_owned())
                } else {
                    let (label, kind) = field.split_once(['(', ' ']).unwrap_or((field, ""));
                    variant = format!("{owner}::{label}");
                    let kind = if of { &variant } else { kind.trim_end_matches(')') };
                    (in_files(label, rule), kind.to_owned())
                };
                let owner = if inside { &variant } else { owner };
                let member =
                    Member { name: name.take().unwrap_or(label), kind, doc: sentence(&doc) };
                let is_removed = member.kind == "RemovedGroupingSettings";
                if !std::mem::take(&mut skipped) && !is_removed && member.name != "}" {
                    self.0.entry(owner.clone()).or_default().members.push(member);
                }
                doc.clear();
            }
        }
    }

    fn words(&self, kind: &str) -> String {
        let inside = |start: &str, end: char| kind.strip_prefix(start)?.strip_suffix(end);
        if let Some(inner) = inside("Option<", '>') {
            return format!("{} or `null`", self.words(inner));
        }
        if let Some(inner) = inside("Vec<", '>') {
            return format!("list of {}s", self.words(inner)).replace("`s", "`");
        }
        if let Some((inner, count)) = inside("[", ']').and_then(|inner| inner.split_once("; ")) {
            return format!("list of {count} {}s", self.words(inner));
        }
        match kind {
            "" => String::new(),
            "usize" | "u64" | "u8" => "integer".to_owned(),
            "f32" | "f64" => "number".to_owned(),
            "bool" => "`true` or `false`".to_owned(),
            "String" | "Embodiment" => "name".to_owned(),
            _ if self.0[kind].is_enum => {
                let names = self.0[kind].members.iter().map(|member| format!("`{}`", member.name));
                names.collect::<Vec<_>>().join(", ")
            }
            _ => "object".to_owned(),
        }
    }

    /// Returns the type that a field or variant holds, in an option or a list or as it is.
    fn content(&self, kind: &str) -> Option<&Type> {
        let inner = kind.split_once('<').map_or(kind, |(_, inner)| inner.trim_end_matches('>'));
        self.0.get(inner)
    }

    /// Writes the row of a field or variant, and those of its variants.
    fn row(&self, page: &mut String, path: &str, member: &Member, presets: &[Value; 2]) {
        let choice = self.content(&member.kind).filter(|content| content.is_enum);
        let shown = match value(presets, path) {
            _ if member.kind.is_empty() => String::new(),
            Some(Value::Object(_)) if choice.is_none() => String::new(),
            Some(value) => shown(value),
            None => "-".to_owned(),
        };
        if !path.is_empty() {
            let (words, doc) = (self.words(&member.kind), &member.doc);
            writeln!(page, "| `{path}` | {words} | {shown} | {doc} |").unwrap();
        }
        let choice = choice.filter(|_| !member.kind.starts_with("Vec<"));
        for variant in choice.into_iter().flat_map(|choice| &choice.members) {
            let path = match variant.kind.as_str() {
                "" => format!("{path}={}", variant.name),
                _ => join(path, &variant.name),
            };
            self.row(page, &path, variant, presets);
        }
    }

    /// Writes the table of a struct's fields, and below it those of the structs in them.
    fn write(&self, page: &mut String, path: &str, item: &Type, presets: &[Value; 2]) {
        if !item.is_enum {
            for (key, _) in value(presets, path).and_then(Value::as_object).into_iter().flatten() {
                let is_read = item.members.iter().any(|member| member.name == *key);
                assert!(is_read, "{path}: no `{key}` in the sources");
            }
            let heading = if path.is_empty() { path } else { &format!("## `{path}`\n\n") };
            *page += &format!("\n{heading}| path | type | value | meaning |\n|---|---|---|---|\n");
            for field in &item.members {
                self.row(page, &join(path, &field.name), field, presets);
            }
        }
        for member in &item.members {
            let element = if member.kind.starts_with("Vec<") { ".0" } else { "" };
            if let Some(content) = self.content(&member.kind) {
                self.write(page, &(join(path, &member.name) + element), content, presets);
            }
        }
    }
}

fn join(path: &str, name: &str) -> String {
    match (path, name) {
        ("", "learner") => String::new(),
        ("", _) => name.to_owned(),
        _ => format!("{path}.{name}"),
    }
}

fn value<'a>(presets: &'a [Value; 2], path: &str) -> Option<&'a Value> {
    let path = path.replace('.', "/");
    let places = [format!("/{path}"), format!("/learner/{path}")];
    presets.iter().find_map(|preset| places.iter().find_map(|place| preset.pointer(place)))
}

/// Formats a value; of a variant with content its name, since the content has a table.
fn shown(value: &Value) -> String {
    match value {
        Value::String(word) => format!("`{word}`"),
        Value::Object(variant) => format!("`{}`", variant.keys().next().unwrap()),
        Value::Array(items) if items.iter().any(Value::is_object) => String::new(),
        value => format!("`{value}`"),
    }
}

/// The rows of the page for the program: path, type and meaning.
fn tab_separated(page: &str) -> String {
    let rows = page.lines().filter_map(|line| line.strip_prefix("| `")?.strip_suffix(" |"));
    rows.map(|row| {
        let cells: Vec<&str> = row.split(" | ").collect();
        format!("{}\t{}\t{}\n", cells[0].trim_end_matches('`'), cells[1], cells[3])
    })
    .collect()
}

#[test]
fn the_page_lists_every_setting() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut types = Types(HashMap::new());
    for source in SOURCES.iter().chain(&SYMMETRIES) {
        types.read(&fs::read_to_string(root.join(source)).unwrap());
    }
    // as text an f32 has the digits of its source
    let presets = [Method::Covers, Method::CoversSac].map(|method| {
        let text = serde_json::to_string(&Budget::Full.preset_experiment(method)).unwrap();
        serde_json::from_str(&text).unwrap()
    });
    let mut page = HEAD.to_owned();
    types.write(&mut page, "", &types.0["Experiment"], &presets);
    for (name, text) in [("docs/settings.md", &page), ("src/settings.tsv", &tab_separated(&page))] {
        let file = root.join(name);
        if std::env::var_os("COVERS_WRITE").is_some() {
            fs::write(&file, text).unwrap();
        }
        let is_same = fs::read_to_string(file).unwrap() == *text;
        assert!(is_same, "{name}: write it with COVERS_WRITE=1");
    }
}
