//! What the workspace depends on: licences, crates in several versions, and which crate imports
//! which. Every check is also shown made-up crates that it must refuse.

use std::collections::{BTreeMap, BTreeSet};
use std::process::Command;

use serde::Deserialize;
use spdx::{AdditionItem, Expression, LicenseReq, ParseMode};

/// Licences that let a program under "MIT OR Apache-2.0" include a crate.
const LICENCES: [&str; 13] = [
    "0BSD",
    "Apache-2.0",
    "BSD-2-Clause",
    "BSD-3-Clause",
    "BSL-1.0",
    "CC0-1.0",
    "ISC",
    "MIT",
    // of fonts alone
    "OFL-1.1",
    "Ubuntu-font-1.0",
    "Unicode-3.0",
    "Unlicense",
    "Zlib",
];

/// Exceptions that only add permissions to a licence.
const EXCEPTIONS: [&str; 1] = ["LLVM-exception"];

/// Crates that are compiled in several versions, how many, and who asks for the older ones.
const SEVERAL_VERSIONS: [(&str, usize); 8] = [
    // 0.2 by nano-gemm, which is faer's; 0.6 by faer itself
    ("equator", 2),
    // as equator
    ("equator-macro", 2),
    // 0.16 by safetensors; 0.17 by indexmap, which is zip's
    ("hashbrown", 2),
    // 0.8 by png; 0.9 by flate2, which is png's and zip's
    ("miniz_oxide", 2),
    // 0.3 by crossterm, which is ratatui's; 0.4 by this program
    ("signal-hook", 2),
    // 1 by interpol and 2 by equator-macro 0.2, both faer's; 3 by all others
    ("syn", 3),
    // 1 by serde-xml-rs, which is urdf-rs'; 2 by all others
    ("thiserror", 2),
    // as thiserror
    ("thiserror-impl", 2),
];

/// Additional crates that tests, examples and benches of a crate may import.
const FOR_TESTS: [(&str, &[&str]); 4] = [
    ("robots", &["mujoco"]),
    ("model-check", &["equivariant"]),
    ("evidence", &["rl", "worlds"]),
    ("covers", &["cluster", "equivariant"]),
];

/// The crates that each crate may import, by the table of ARCHITECTURE.md.
fn imports() -> BTreeMap<&'static str, Vec<&'static str>> {
    let names = |cell: &'static str| cell.split('`').skip(1).step_by(2).map(short);
    let rows = include_str!("../ARCHITECTURE.md").lines().filter_map(|line| {
        let cells: Vec<&str> = line.split('|').collect();
        let package = names(cells.get(2)?).next()?;
        cells[2].contains("`covers-").then(|| (package, names(cells[4]).collect()))
    });
    rows.collect()
}

/// The crates of the workspace, as their manifests state them.
#[derive(Deserialize)]
struct Workspace {
    packages: Vec<Package>,
}

#[derive(Deserialize)]
struct Package {
    name: String,
    dependencies: Vec<Dependency>,
}

/// A dependency as a manifest states it; those of this workspace have a path.
#[derive(Deserialize)]
struct Dependency {
    name: String,
    kind: Option<String>,
    path: Option<String>,
}

/// What cargo prints for these arguments at the root of the workspace.
fn cargo(arguments: &[&str]) -> String {
    let mut command = Command::new(env!("CARGO"));
    command.current_dir(env!("CARGO_MANIFEST_DIR"));
    let output = command.args(arguments).output().unwrap();
    let message = String::from_utf8_lossy(&output.stderr);
    assert!(output.status.success(), "cargo {arguments:?}: {message}");
    String::from_utf8(output.stdout).unwrap()
}

/// Lines of cargo's tree of packages, for this machine. Packages of other targets are left out,
/// because a build here does not download them.
fn tree(options: &[&str]) -> String {
    cargo(&[&["tree", "--prefix", "none", "--locked", "--offline"], options].concat())
}

/// Packages whose licence no choice among `LICENCES` satisfies, and the licence, which a tab
/// divides from the package in each line.
fn refused(tree: &str) -> BTreeSet<String> {
    let lines = tree.lines().map(|line| line.trim_end_matches(" (*)"));
    let stated = lines.filter_map(|line| line.split_once('\t'));
    let refused = stated.filter(|(_, licence)| !acceptable(licence));
    refused.map(|(package, licence)| format!("{package}: {licence}")).collect()
}

/// Whether allowed licences alone satisfy an SPDX expression, or the older form `MIT/Apache-2.0`.
fn acceptable(expression: &str) -> bool {
    let allowed = |required: &LicenseReq| {
        let licence = required.license.id();
        let exception = required.addition.as_ref().map(AdditionItem::id);
        licence.is_some_and(|id| LICENCES.contains(&id.name))
            && exception.is_none_or(|id| id.is_some_and(|id| EXCEPTIONS.contains(&id.name)))
    };
    let expression = Expression::parse_mode(expression, ParseMode::LAX);
    expression.is_ok_and(|expression| expression.evaluate(allowed))
}

/// Names and versions of the crates that a build of these packages compiles, tests left out.
pub fn compiled(packages: &[&str]) -> BTreeSet<(String, String)> {
    let tree = tree(&[&["--edges", "normal,build"], packages].concat());
    let lines = tree.lines().map(|line| line.split(' ').map(str::to_owned));
    lines.filter_map(|mut words| Some((words.next()?, words.next()?))).collect()
}

/// Names of crates that occur in several versions, and in how many.
fn several_versions(crates: &BTreeSet<(String, String)>) -> Vec<(&str, usize)> {
    let mut versions: BTreeMap<&str, usize> = BTreeMap::new();
    for (name, _) in crates {
        *versions.entry(name).or_default() += 1;
    }
    versions.into_iter().filter(|&(_, n)| n > 1).collect()
}

/// The name of a workspace crate without the prefix that its package carries.
fn short(name: &str) -> &str {
    match name {
        "covers-rs" => "covers",
        _ => name.strip_prefix("covers-").unwrap_or(name),
    }
}

/// Imports between workspace crates that the table does not have, and crates that it does not list.
fn forbidden(package: &Package) -> Vec<String> {
    let name = short(&package.name);
    let table = imports();
    let Some(code) = table.get(name) else {
        return vec![format!("{name} is not in the table")];
    };
    let tests = FOR_TESTS.iter().find(|(listed, _)| *listed == name);
    let ours = package.dependencies.iter().filter(|d| d.path.is_some());
    let wrong = ours.filter(|d| {
        let imported = short(&d.name);
        let is_dev = d.kind.as_deref() == Some("dev");
        let for_tests = is_dev && tests.is_some_and(|(_, own)| own.contains(&imported));
        !code.contains(&imported) && !for_tests
    });
    wrong.map(|d| format!("{name} imports {}", short(&d.name))).collect()
}

#[test]
fn every_licence_is_allowed() {
    let tree = tree(&["--workspace", "--format", "{p}\t{l}"]);
    assert!(tree.lines().count() > 100, "the graph is incomplete");
    assert_eq!(refused(&tree), BTreeSet::new());
}

#[test]
fn crates_in_several_versions_are_known() {
    assert_eq!(several_versions(&compiled(&["--workspace"])), SEVERAL_VERSIONS);
}

#[test]
fn crates_import_what_the_table_says() {
    assert!(imports().len() > 15, "{:?}", imports());
    let json = cargo(&["metadata", "--format-version=1", "--no-deps", "--locked", "--offline"]);
    let workspace: Workspace = serde_json::from_str(&json).unwrap();
    let wrong: Vec<String> = workspace.packages.iter().flat_map(forbidden).collect();
    assert_eq!(wrong, [""; 0]);
}

#[test]
fn expressions_of_licences_are_read() {
    for (expression, expected) in [
        ("MIT", true),
        ("MIT/Apache-2.0", true),
        ("(GPL-3.0-only OR ISC) AND Zlib", true),
        ("Apache-2.0 WITH LLVM-exception", true),
        ("", false),
        ("none", false),
        ("GPL-3.0-only", false),
        ("(MIT OR Apache-2.0) AND LGPL-3.0-only", false),
        ("MIT WITH Classpath-exception-2.0", false),
        ("MIT OR", false),
    ] {
        assert_eq!(acceptable(expression), expected, "{expression}");
    }
}

#[test]
fn a_forbidden_or_missing_licence_is_found() {
    let tree = "good v1.0.0\tMIT\nbad v2.0.0\tGPL-3.0-only (*)\n\nsilent v3.0.0\t\n";
    let expected = ["bad v2.0.0: GPL-3.0-only", "silent v3.0.0: "];
    assert_eq!(refused(tree), expected.map(str::to_owned).into());
}

#[test]
fn a_second_version_is_found() {
    let crates = [("a", "v1.0.0"), ("a", "v2.0.0"), ("b", "v1.0.0")];
    let crates = crates.map(|(name, version)| (name.to_owned(), version.to_owned()));
    assert_eq!(several_versions(&BTreeSet::from(crates)), [("a", 2)]);
}

#[test]
fn a_forbidden_import_is_found() {
    let import = |from: &str, to: &str, kind: Option<&str>| {
        let (kind, path) = (kind.map(str::to_owned), Some(format!("/{to}")));
        let dependencies = vec![Dependency { name: to.to_owned(), kind, path }];
        forbidden(&Package { name: from.to_owned(), dependencies }).join("")
    };
    assert_eq!(import("covers-rl", "covers-envs", None), "rl imports envs");
    assert_eq!(import("covers-rs", "covers-mujoco", None), "covers imports mujoco");
    assert_eq!(import("covers-robots", "covers-mujoco", None), "robots imports mujoco");
    assert_eq!(import("covers-robots", "covers-mujoco", Some("dev")), "");
    assert_eq!(import("covers-python", "covers-rl", None), "python is not in the table");
}
