//! What the workspace depends on: licences, crates in several versions, and which crate imports
//! which. Every check is also shown made-up metadata that it must refuse.

use std::collections::{BTreeMap, BTreeSet};
use std::process::Command;

use serde::Deserialize;
use spdx::{AdditionItem, Expression, LicenseReq, ParseMode};

/// Licences that let a program under "MIT OR Apache-2.0" include a crate.
const LICENCES: [&str; 11] = [
    "0BSD",
    "Apache-2.0",
    "BSD-2-Clause",
    "BSD-3-Clause",
    "BSL-1.0",
    "CC0-1.0",
    "ISC",
    "MIT",
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

/// What tests, examples and benches of a crate may import besides.
const FOR_TESTS: [(&str, &[&str]); 4] = [
    ("robots", &["mujoco"]),
    ("envs", &["inpainting"]),
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

#[derive(Deserialize)]
struct Metadata {
    packages: Vec<Package>,
    workspace_members: Vec<String>,
    resolve: Resolve,
}

#[derive(Deserialize)]
struct Package {
    id: String,
    name: String,
    version: String,
    license: Option<String>,
    dependencies: Vec<Dependency>,
}

/// A dependency as a manifest states it; those of this workspace have a path.
#[derive(Deserialize)]
struct Dependency {
    name: String,
    kind: Option<String>,
    path: Option<String>,
}

#[derive(Deserialize)]
struct Resolve {
    nodes: Vec<Node>,
}

#[derive(Deserialize)]
struct Node {
    id: String,
    deps: Vec<Edge>,
}

/// A dependency as cargo resolved it.
#[derive(Deserialize)]
struct Edge {
    pkg: String,
    dep_kinds: Vec<EdgeKind>,
}

#[derive(Deserialize)]
struct EdgeKind {
    kind: Option<String>,
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

/// The resolved graph for this machine. Packages of other targets are left out, because a build
/// here does not download them.
fn workspace() -> Metadata {
    let version = cargo(&["-vV"]);
    let host = version.lines().find_map(|line| line.strip_prefix("host: "));
    let arguments = [
        "metadata",
        "--format-version=1",
        "--locked",
        "--offline",
        "--filter-platform",
        host.unwrap(),
    ];
    let json = cargo(&arguments);
    serde_json::from_str(&json).unwrap()
}

/// Packages whose licence no choice among `LICENCES` satisfies, and the licence.
fn refused(metadata: &Metadata) -> Vec<String> {
    let packages = metadata.packages.iter();
    let stated = packages.map(|package| (package, package.license.as_deref().unwrap_or("none")));
    stated
        .filter(|(_, licence)| !acceptable(licence))
        .map(|(package, licence)| format!("{} {}: {licence}", package.name, package.version))
        .collect()
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

/// Packages that a build of the workspace's libraries and programs compiles, tests left out.
fn compiled(metadata: &Metadata) -> BTreeSet<&str> {
    let nodes: BTreeMap<&str, &Node> =
        metadata.resolve.nodes.iter().map(|n| (&n.id[..], n)).collect();
    let mut open: Vec<&str> = metadata.workspace_members.iter().map(|id| &id[..]).collect();
    let mut found = BTreeSet::new();
    while let Some(id) = open.pop() {
        if found.insert(id) {
            let edges = nodes[id].deps.iter();
            let built = edges.filter(|edge| edge.dep_kinds.iter().any(|k| !is_dev(&k.kind)));
            open.extend(built.map(|edge| &edge.pkg[..]));
        }
    }
    found
}

fn is_dev(kind: &Option<String>) -> bool {
    kind.as_deref() == Some("dev")
}

/// Names of compiled crates that occur in several versions, and in how many.
fn several_versions(metadata: &Metadata) -> Vec<(&str, usize)> {
    let compiled = compiled(metadata);
    let mut versions: BTreeMap<&str, usize> = BTreeMap::new();
    for package in &metadata.packages {
        if compiled.contains(&package.id[..]) {
            *versions.entry(&package.name).or_default() += 1;
        }
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
fn forbidden(metadata: &Metadata) -> Vec<String> {
    let members = metadata.packages.iter();
    let members = members.filter(|package| metadata.workspace_members.contains(&package.id));
    members.flat_map(forbidden_of).collect()
}

fn forbidden_of(package: &Package) -> Vec<String> {
    let name = short(&package.name);
    let table = imports();
    let Some(code) = table.get(name) else {
        return vec![format!("{name} is not in the table")];
    };
    let tests = FOR_TESTS.iter().find(|(listed, _)| *listed == name);
    let ours = package.dependencies.iter().filter(|d| d.path.is_some());
    let wrong = ours.filter(|d| {
        let imported = short(&d.name);
        let for_tests = is_dev(&d.kind) && tests.is_some_and(|(_, own)| own.contains(&imported));
        !code.contains(&imported) && !for_tests
    });
    wrong.map(|d| format!("{name} imports {}", short(&d.name))).collect()
}

#[test]
fn every_licence_is_allowed() {
    let metadata = workspace();
    assert!(metadata.packages.len() > 100, "the graph is incomplete");
    assert_eq!(refused(&metadata), [""; 0]);
}

#[test]
fn crates_in_several_versions_are_known() {
    let metadata = workspace();
    assert_eq!(several_versions(&metadata), SEVERAL_VERSIONS);
}

#[test]
fn crates_import_what_the_table_says() {
    assert!(imports().len() > 15, "{:?}", imports());
    assert_eq!(forbidden(&workspace()), [""; 0]);
}

/// Package `name` of version `version`, as cargo's metadata has it.
fn package(name: &str, version: &str, licence: &str, dependencies: &str) -> String {
    format!(
        r#"{{"id": "{name} {version}", "name": "{name}", "version": "{version}",
            "license": {licence}, "dependencies": [{dependencies}]}}"#
    )
}

/// A workspace with one member, which the packages and the nodes of the graph must include.
fn made_up(member: &str, packages: &[String], nodes: &str) -> Metadata {
    let packages = packages.join(", ");
    let json = format!(
        r#"{{"packages": [{packages}], "workspace_members": ["{member}"],
            "resolve": {{"nodes": [{nodes}]}}}}"#
    );
    serde_json::from_str(&json).unwrap()
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
    let packages = [
        package("good", "1.0.0", "\"MIT\"", ""),
        package("bad", "2.0.0", "\"GPL-3.0-only\"", ""),
        package("silent", "3.0.0", "null", ""),
    ];
    let metadata = made_up("good 1.0.0", &packages, "");
    let expected = ["bad 2.0.0: GPL-3.0-only", "silent 3.0.0: none"];
    assert_eq!(refused(&metadata), expected);
}

#[test]
fn a_second_version_is_found_unless_only_tests_need_it() {
    let packages = [("covers", "0.1.0"), ("a", "1.0.0"), ("a", "2.0.0")];
    let packages = packages.map(|(name, version)| package(name, version, "\"MIT\"", ""));
    let graph = |kind: &str| {
        format!(
            r#"{{"id": "a 1.0.0", "deps": []}}, {{"id": "a 2.0.0", "deps": []}},
               {{"id": "covers 0.1.0", "deps": [
                   {{"pkg": "a 1.0.0", "dep_kinds": [{{"kind": null}}]}},
                   {{"pkg": "a 2.0.0", "dep_kinds": [{{"kind": {kind}}}]}}]}}"#
        )
    };
    for (kind, expected) in [("null", 1), ("\"build\"", 1), ("\"dev\"", 0)] {
        let metadata = made_up("covers 0.1.0", &packages, &graph(kind));
        assert_eq!(several_versions(&metadata).len(), expected, "{kind}");
    }
}

#[test]
fn a_forbidden_import_is_found() {
    let import = |from: &str, to: &str, kind: &str| {
        let dependency = format!(r#"{{"name": "{to}", "kind": {kind}, "path": "/{to}"}}"#);
        let packages = [package(from, "0.1.0", "\"MIT\"", &dependency)];
        forbidden(&made_up(&format!("{from} 0.1.0"), &packages, "")).join("")
    };
    assert_eq!(import("covers-rl", "covers-envs", "null"), "rl imports envs");
    assert_eq!(import("covers-rs", "covers-mujoco", "null"), "covers imports mujoco");
    let wrong = import("covers-envs", "covers-inpainting", "null");
    assert_eq!(wrong, "envs imports inpainting");
    assert_eq!(import("covers-envs", "covers-inpainting", "\"dev\""), "");
    assert_eq!(import("covers-python", "covers-rl", "null"), "python is not in the table");
}
