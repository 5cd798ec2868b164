//! No file of tests is forgotten: where cargo does not look for tests itself, each file is a module
//! of `tests/main.rs` or a program that the manifest names.

use std::path::{Path, PathBuf};
use std::{fs, io};

/// The files under `tests` that neither `main` nor `manifest` names.
fn forgotten(files: &[String], main: &str, manifest: &str) -> Vec<String> {
    let known = |file: &String| {
        let module = format!("\nmod {file};");
        let program = format!("[[test]]\nname = \"{file}\"");
        main.contains(&module) || manifest.contains(&program)
    };
    let files = files.iter().filter(|file| !known(file));
    files.cloned().collect()
}

fn stems(folder: &Path) -> io::Result<Vec<String>> {
    let paths = fs::read_dir(folder)?.map(|entry| Ok(entry?.path()));
    let paths: Vec<_> = paths.collect::<io::Result<_>>()?;
    let sources = paths.iter().filter(|path| {
        path.extension().is_some_and(|end| end == "rs") && !path.ends_with("main.rs")
    });
    let stem = |path: &PathBuf| path.file_stem().unwrap().to_str().unwrap().to_owned();
    Ok(sources.map(stem).collect())
}

/// The folders of the packages whose tests cargo does not find by itself.
fn packages(root: &Path) -> Vec<PathBuf> {
    let folders = fs::read_dir(root).unwrap().map(|entry| entry.unwrap().path());
    let takes_no_files = |folder: &PathBuf| {
        let manifest = fs::read_to_string(folder.join("Cargo.toml"));
        manifest.is_ok_and(|manifest| manifest.contains("autotests = false"))
    };
    let all = folders.chain([root.to_owned()]);
    all.filter(takes_no_files).collect()
}

#[test]
fn every_file_of_tests_is_compiled() {
    let packages = packages(Path::new(env!("CARGO_MANIFEST_DIR")));
    assert!(packages.len() > 5, "{packages:?}");
    for package in packages {
        let read = |file: &str| fs::read_to_string(package.join(file)).unwrap();
        let (main, manifest) = (read("tests/main.rs"), read("Cargo.toml"));
        let files = stems(&package.join("tests")).unwrap();
        assert!(files.len() > 2, "{}: {files:?}", package.display());
        let missing = forgotten(&files, &main, &manifest);
        assert!(missing.is_empty(), "{}: {missing:?}", package.display());
        assert!(manifest.contains("\npath = \"tests/main.rs\"\n"));
    }
}

#[test]
fn a_forgotten_file_is_named() {
    let files = ["known", "program", "forgotten"].map(str::to_owned);
    let manifest = "[[test]]\nname = \"program\"\n";
    assert_eq!(forgotten(&files, "\nmod known;\n", manifest), ["forgotten"]);
}
