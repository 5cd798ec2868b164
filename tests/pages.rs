//! The pages of the repository: every relative link leads to a file, and prose is wrapped.

use std::fs;
use std::path::{Path, PathBuf};

/// Fewest bytes of a README: less says nothing.
const LEAST: usize = 500;
/// Longest line of prose, in characters. Tables, code, links and pictures may be longer.
const COLUMNS: usize = 100;

/// All Markdown files of the repository.
pub fn pages() -> Vec<PathBuf> {
    files(".md")
}

/// All files of the repository with this ending, which are the same in a package but for the
/// folders that it leaves out.
pub fn files(ending: &str) -> Vec<PathBuf> {
    let mut found = Vec::new();
    let mut open = vec![PathBuf::from(env!("CARGO_MANIFEST_DIR"))];
    while let Some(folder) = open.pop() {
        for entry in fs::read_dir(folder).unwrap() {
            let entry = entry.unwrap();
            let (path, name) = (entry.path(), entry.file_name());
            let name = name.to_string_lossy();
            if entry.file_type().unwrap().is_dir() {
                let others = ["node_modules", "runs", "shared", "target"];
                let is_ours = !name.starts_with('.') && !others.contains(&&name[..]);
                open.extend(is_ours.then_some(path));
            } else if name.ends_with(ending) {
                found.push(path);
            }
        }
    }
    assert!(found.len() > 10, "{found:?}");
    found
}

/// Lines outside of fenced code.
fn prose(text: &str) -> impl Iterator<Item = &str> {
    let mut code = false;
    text.lines().filter(move |line| {
        let fence = line.trim_start().starts_with("```");
        code ^= fence;
        !code && !fence
    })
}

/// Targets of relative links, without the section.
fn links(text: &str) -> Vec<&str> {
    let targets = prose(text).flat_map(|line| line.split("](").skip(1));
    let targets = targets.filter_map(|rest| rest.split([')', '#']).next());
    targets.filter(|target| !target.is_empty() && !target.contains("://")).collect()
}

/// Links of a page in `folder` that lead nowhere.
fn dangling(folder: &Path, text: &str) -> Vec<String> {
    let links = links(text).into_iter();
    links.filter(|target| !folder.join(target).exists()).map(str::to_owned).collect()
}

/// Lines of prose that are longer than they may be.
fn too_long(text: &str) -> Vec<String> {
    let free = |line: &str| line.trim_start().starts_with('|') || line.contains("](");
    prose(text)
        .filter(|line| line.chars().count() > COLUMNS && !free(line))
        .map(str::to_owned)
        .collect()
}

/// What is wrong with the length of a README; other pages may be short.
fn too_short(page: &Path, text: &str) -> Option<String> {
    let short = page.ends_with("README.md") && text.len() < LEAST;
    short.then(|| format!("{} bytes, expected at least {LEAST}", text.len()))
}

/// What `wrong` finds on any page, each with the page's name.
pub fn on_any_page(wrong: impl Fn(&Path, &str) -> Vec<String>) -> Vec<String> {
    let findings = pages().into_iter().map(|page| {
        let text = fs::read_to_string(&page).unwrap();
        let found = wrong(&page, &text);
        found.iter().map(|what| format!("{}: {what}", page.display())).collect::<Vec<_>>()
    });
    findings.flatten().collect()
}

#[test]
fn links_lead_to_files() {
    let wrong = on_any_page(|page, text| dangling(page.parent().unwrap(), text));
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn prose_is_wrapped() {
    let wrong = on_any_page(|_, text| too_long(text));
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
}

#[test]
fn no_readme_is_all_but_empty() {
    let wrong = on_any_page(|page, text| too_short(page, text).into_iter().collect());
    assert!(wrong.is_empty(), "{}", wrong.join("\n"));
    let stub = too_short(Path::new("envs/README.md"), "# covers-envs\n");
    assert_eq!(stub.as_deref(), Some("14 bytes, expected at least 500"));
    assert_eq!(too_short(Path::new("docs/ppo.md"), ""), None);
}

#[test]
fn a_dangling_link_and_a_long_line_are_found() {
    let root = Path::new(env!("CARGO_MANIFEST_DIR"));
    let text = "[a](Cargo.toml#b) [c](no.md), [d](#e)\n```\n[f](no.rs)\n```\n![g](src/no.png) [h](https://i.k)";
    assert_eq!(dangling(root, text), ["no.md", "src/no.png"]);
    let long = "x".repeat(COLUMNS + 1);
    let lines = format!("short\n| {long} |\n```\n{long}\n```\n[a](b) {long}\n{long}");
    assert_eq!(too_long(&lines), [long]);
}

/// The pages that a summary of the book links to.
fn listed(summary: &str) -> Vec<PathBuf> {
    let docs = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs");
    let pages = links(summary).into_iter().map(|link| docs.join(link));
    pages.map(|page| page.canonicalize().unwrap()).collect()
}

#[test]
fn every_page_is_in_the_book() {
    let summary = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/SUMMARY.md");
    let listed = listed(&fs::read_to_string(&summary).unwrap());
    let missing = pages().into_iter().map(|page| page.canonicalize().unwrap());
    let missing: Vec<_> = missing
        .filter(|page| *page != summary.canonicalize().unwrap() && !listed.contains(page))
        .collect();
    assert!(missing.is_empty(), "docs/SUMMARY.md has no {missing:?}");
    let one = self::listed("- [PPO](ppo.md)\n- [one](../README.md)\n");
    assert!(one.len() == 2 && one.iter().all(|page| listed.contains(page)));
}
