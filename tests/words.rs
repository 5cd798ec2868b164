//! Documentation begins with a verb or a noun: it is read alone, in a list or a hover.

use std::fs;
use std::path::Path;

use crate::pages::files;

/// Words that open a question or a relative clause.
const QUESTIONS: [&str; 10] =
    ["What", "Whether", "How", "Where", "Which", "Who", "Whom", "Whose", "Why", "When"];
/// Words that point to what stands above.
const POINTERS: [&str; 10] =
    ["The same", "That", "Those", "These", "As", "It", "They", "This", "Its", "That of"];
/// Largest share of first lines that may begin with one of these words.
const MAX_SHARE: f64 = 0.01;

/// Returns the first lines of the documentation of a file, its test module left out.
fn first_lines(text: &str) -> Vec<&str> {
    let mut first = Vec::new();
    let mut inside = false;
    let code = text.split("#[cfg(test)]\nmod tests {").next().unwrap_or_default();
    for line in code.lines().map(str::trim) {
        let words = line.strip_prefix("///").or_else(|| line.strip_prefix("//!"));
        if let Some(words) = words.filter(|_| !inside) {
            first.push(words.trim());
        }
        inside = words.is_some();
    }
    first
}

/// Returns `true` if a line begins with one of these words.
fn begins(line: &str, words: &[&str]) -> bool {
    words.iter().any(|word| {
        let rest = line.strip_prefix(word);
        rest.is_some_and(|rest| !rest.starts_with(|next: char| next.is_alphanumeric()))
    })
}

#[test]
fn documentation_begins_with_verbs_and_nouns() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let mut all = 0;
    let mut odd = Vec::new();
    for path in files(".rs") {
        let text = fs::read_to_string(&path).unwrap();
        for line in first_lines(&text) {
            all += 1;
            if begins(line, &QUESTIONS) || begins(line, &POINTERS) {
                odd.push(format!("{}: {line}", path.strip_prefix(root).unwrap().display()));
            }
        }
    }
    assert!(all > 1000, "{all} lines are too few to be all");
    let share = odd.len() as f64 / all as f64;
    assert!(share <= MAX_SHARE, "{share:.3} of {all}:\n{}", odd.join("\n"));
}

#[test]
fn questions_and_pointers_are_found() {
    let text = "//! What it is.\n\n/// Whether it is.\n/// More.\nfn a() {}\n/// Returns 1.\nfn b() {}\n\
        /// As above.\nfn c() {}\n#[cfg(test)]\nmod tests {\n/// How it is.\n";
    let lines = first_lines(text);
    assert_eq!(lines, ["What it is.", "Whether it is.", "Returns 1.", "As above."]);
    assert_eq!(lines.iter().filter(|line| begins(line, &QUESTIONS)).count(), 2);
    assert_eq!(lines.iter().filter(|line| begins(line, &POINTERS)).count(), 1);
    assert!(!begins("Assembles a scene.", &POINTERS));
}
