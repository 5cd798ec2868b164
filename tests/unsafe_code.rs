//! The project is `unsafe` in the bindings of MuJoCo alone.

use std::fs;
use std::path::Path;

use crate::pages::files;

/// Folders of the bindings.
const BINDINGS: [&str; 2] = ["mujoco", "mujoco-sys"];

/// Keyword that the test looks for, split so that this file does not contain it.
const WORD: &str = concat!("un", "safe");

/// Returns `true` if the keyword is outside of comments.
fn says_unsafe(text: &str) -> bool {
    let code = text.lines().filter_map(|line| line.split("//").next());
    let is_part = |c: char| c.is_alphanumeric() || c == '_';
    let mut words = code.flat_map(|line| line.split(|c| !is_part(c)));
    words.any(|word| word == WORD)
}

#[test]
fn only_bindings_are_unsafe() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let sources = files(".rs").into_iter();
    let found = sources.filter(|path| says_unsafe(&fs::read_to_string(path).unwrap()));
    let found: Vec<_> = found.map(|path| path.strip_prefix(root).unwrap().to_owned()).collect();
    let of_bindings = |path: &Path| BINDINGS.iter().any(|folder| path.starts_with(folder));
    assert!(found.iter().any(|path| of_bindings(path)), "none is seen");
    let others: Vec<_> = found.iter().filter(|path| !of_bindings(path)).collect();
    assert!(others.is_empty(), "{others:?}");
}

#[test]
fn comments_and_lints_are_not_code() {
    for code in ["let x = {} { f() };", "{} extern {}", "x({})"] {
        assert!(says_unsafe(&code.replacen("{}", WORD, 1)), "{code}");
    }
    for other in ["// {}", "#![forbid({}_code)]", "let x = 0; // {} otherwise"] {
        assert!(!says_unsafe(&other.replacen("{}", WORD, 1)), "{other}");
    }
}
