//! Code on the pages of the repository: commands are commands of the program or of the Makefile,
//! JSON is JSON, and Rust is compiled with the documentation of a crate.

use std::fs;
use std::path::Path;

use clap::Parser;
use covers::cli::ContinualStreamExampleOptions;
use covers::program::CoversCli;

use crate::pages::{on_any_page, pages};

/// Fenced blocks, each with the word behind its fence.
fn blocks(text: &str) -> Vec<(&str, String)> {
    let mut found: Vec<(&str, String)> = Vec::new();
    let mut open = false;
    for line in text.lines() {
        match (open, line.trim_start().strip_prefix("```")) {
            (_, Some(language)) => {
                open = !open;
                found.extend(open.then(|| (language, String::new())));
            }
            (true, None) => {
                if let Some((_, block)) = found.last_mut() {
                    *block += line;
                    block.push('\n');
                }
            }
            (false, None) => {}
        }
    }
    found
}

fn blocks_of(text: &str, language: &str) -> Vec<String> {
    let blocks = blocks(text).into_iter();
    let of = blocks.filter(|(name, _)| name.split(',').next() == Some(language));
    of.map(|(_, block)| block).collect()
}

/// The words of each command of a block; one goes on behind a backslash and within quotes.
fn commands(block: &str) -> Vec<Vec<String>> {
    let (mut found, mut text) = (Vec::new(), String::new());
    for line in block.lines() {
        text.push_str(line);
        if text.ends_with('\\') {
            text.pop();
        } else if let Some(words) = shlex::split(&text) {
            found.extend((!words.is_empty()).then_some(words));
            text.clear();
        } else {
            text.push('\n');
        }
    }
    assert!(text.is_empty(), "a quote is not closed: {text}");
    found
}

/// What is wrong with a line of commands; those of other programs are taken as they are.
fn wrong(words: &[String]) -> Option<String> {
    let words: Vec<&str> = words.iter().map(String::as_str).collect();
    let mut commands = words.split(|word| ["|", "&&", ";"].contains(word));
    commands.find_map(wrong_command)
}

fn wrong_command(words: &[&str]) -> Option<String> {
    // the file of a redirection is no argument
    let own = words.split(|word| *word == ">").next()?;
    let first = own.iter().position(|word| !word.contains('='))?;
    let own = &own[first..];
    match own {
        ["make", target, ..] => {
            let makefile = fs::read_to_string("Makefile").unwrap();
            let known = makefile.contains(&format!("\n{target}:"));
            (!known).then(|| format!("make knows no `{target}`"))
        }
        ["covers", arguments @ ..] => refused::<CoversCli>(arguments),
        ["cargo", "run", rest @ ..] => {
            let mut parts = rest.splitn(2, |word| *word == "--");
            let (cargo, arguments) = (parts.next()?, parts.next().unwrap_or_default());
            if let Some(at) = cargo.iter().position(|word| *word == "--manifest-path") {
                // a program of another workspace
                let manifest = cargo[at + 1];
                let known = ["rerun", "fuzz", "web"].map(|folder| format!("{folder}/Cargo.toml"));
                let known = known.iter().any(|path| path == manifest);
                return (!known).then(|| format!("there is no workspace `{manifest}`"));
            }
            let example = cargo.iter().position(|word| *word == "--example");
            match example.map(|at| cargo[at + 1]) {
                None => refused::<CoversCli>(arguments),
                Some("continual_stream") => refused::<ContinualStreamExampleOptions>(arguments),
                Some(name) => {
                    let folders = [
                        "examples",
                        "evidence/examples",
                        "model-check/examples",
                        "benches/studies",
                        "benches/peers",
                    ];
                    let known = folders.iter().any(|folder| {
                        let examples = Path::new(folder);
                        examples.join(format!("{name}.rs")).exists() || examples.join(name).exists()
                    });
                    (!known).then(|| format!("there is no example `{name}`"))
                }
            }
        }
        _ => None,
    }
}

/// Why a program does not take these arguments.
fn refused<P: Parser>(arguments: &[&str]) -> Option<String> {
    let line = [&["covers"], arguments].concat();
    P::try_parse_from(line).err().map(|error| error.to_string())
}

#[test]
fn commands_are_those_of_the_program() {
    let wrong = on_any_page(|page, text| {
        // its `cargo run` is that of a workspace of its own
        if page.ends_with("fuzz/README.md") {
            return Vec::new();
        }
        let commands = blocks_of(text, "sh").into_iter().flat_map(|block| commands(&block));
        commands
            .filter_map(|words| Some(format!("{}: {}", words.join(" "), wrong(&words)?)))
            .collect()
    });
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn a_command_that_nothing_takes_is_found() {
    let of = |line: &str| wrong(&commands(line)[0]);
    for line in [
        "covers trian",
        "covers train --set",
        "cargo run --release -- eval",
        "X=1 cargo run --example continual_stream -- --budget tiny",
        "cargo run --example nothing",
        "make nothing",
        "pip install numpy && covers trian",
    ] {
        assert!(of(line).is_some(), "{line}");
    }
    for line in [
        "covers train --budget short  # some minutes",
        "covers watch runs/a --json | jq -c '[.reward]'",
        "cargo run --release -p covers-evidence --example own_frames -- FOLDER",
        "covers train --set 'schedule.groups=[\n  {}]' \\\n --seed 3",
        "pip install numpy",
    ] {
        assert_eq!(of(line), None, "{line}");
    }
}

/// Blocks of JSON that are none.
fn malformed(text: &str) -> Vec<String> {
    let parsed = blocks_of(text, "json").into_iter().map(|block| {
        let value: Result<serde_json::Value, _> = serde_json::from_str(&block);
        value.err().map(|error| format!("{error} in {block}"))
    });
    parsed.flatten().collect()
}

#[test]
fn json_is_json() {
    let wrong = on_any_page(|_, text| malformed(text));
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    assert_eq!(malformed("a\n```json\n{\"a\": 1,}\n```\n").len(), 1);
}

/// Whether a page has Rust that is to be compiled.
fn has_rust(text: &str) -> bool {
    let blocks = blocks(text).into_iter();
    let mut names = blocks.map(|(name, _)| name);
    names.any(|name| name.starts_with("rust") && !name.contains("ignore"))
}

/// Documentation tests run what `#[doc = include_str!(...)]` brings in.
#[test]
fn rust_is_compiled_with_the_documentation_of_a_crate() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let crates = fs::read_dir(root).unwrap().map(|entry| entry.unwrap().path());
    let crates = crates.chain([root.to_owned()]);
    let included = crates.flat_map(|folder| {
        let source = fs::read_to_string(folder.join("src/lib.rs")).unwrap_or_default();
        let names = source.split("include_str!(\"../").skip(1);
        let names = names.filter_map(|rest| rest.split('"').next());
        names.map(|name| folder.join(name)).collect::<Vec<_>>()
    });
    let included: Vec<_> = included.collect();
    let pages = pages().into_iter();
    let left_out: Vec<_> = pages
        .filter(|page| has_rust(&fs::read_to_string(page).unwrap()) && !included.contains(page))
        .collect();
    assert!(left_out.is_empty(), "{left_out:?}");
    assert!(has_rust("```rust,no_run\nfn main() {}\n```\n") && !has_rust("```rust,ignore\n```\n"));
}
