//! Effects of the crate on its process: each case runs this program again and observes it from
//! outside.

#![allow(clippy::unwrap_used, reason = "test code")]

use std::env;
use std::fs;
use std::os::unix::process::ExitStatusExt;
use std::path::Path;
use std::process::{Command, Output, Stdio};

use mujoco::Model;

/// Environment variable of the child with the name of the case.
const CASE: &str = "COVERS_TEST_CASE";
const THREADS: &str = "LP_NUM_THREADS";
const SIGABRT: i32 = 6;

fn is_case(name: &str) -> bool {
    env::var(CASE).is_ok_and(|case| case == name)
}

fn run_case_in(name: &str, folder: &Path) -> Output {
    Command::new(env::current_exe().unwrap())
        .args(["--exact", name, "--nocapture"])
        .env(CASE, name)
        .env_remove(THREADS)
        .current_dir(folder)
        .stdin(Stdio::piped()) // open and silent: MuJoCo's own error handler waits for a key
        .output()
        .unwrap()
}

fn run_case(name: &str) -> Output {
    run_case_in(name, Path::new("."))
}

/// Asserts that the child ran exactly one case, and that it passed. With an unknown name the
/// harness runs none and succeeds.
fn assert_passed(child: &Output) {
    let report = String::from_utf8_lossy(&child.stdout);
    assert!(report.contains("test result: ok. 1 passed;"), "{child:?}");
    assert!(child.status.success(), "{child:?}");
}

#[test]
#[should_panic(expected = "0 passed")]
fn a_case_that_does_not_exist_is_noticed() {
    assert_passed(&run_case("no_test_has_this_name"));
}

#[test]
fn a_fatal_error_prints_and_aborts() {
    let name = "a_fatal_error_prints_and_aborts";
    if is_case(name) {
        Model::from_xml("<mujoco/>").unwrap();
        // SAFETY: the text is NUL-terminated; the handler never returns.
        unsafe { mujoco_sys::mju_error(c"out of cheese".as_ptr()) };
        unreachable!("mju_error returned");
    }
    let child = run_case(name);
    let message = String::from_utf8_lossy(&child.stderr);
    assert!(message.contains("MuJoCo: fatal error: out of cheese"), "{message}");
    assert_eq!(child.status.signal(), Some(SIGABRT));
}

#[test]
fn the_environment_is_left_alone_beside_other_threads() {
    let name = "the_environment_is_left_alone_beside_other_threads";
    if is_case(name) {
        // tests run on a thread beside the main one
        Model::from_xml("<mujoco/>").unwrap();
        assert!(env::var_os(THREADS).is_none());
        return;
    }
    assert_passed(&run_case(name));
}

const PART: &str = r#"<mujoco><worldbody><body name="of_the_disk"/></worldbody></mujoco>"#;
const CUBE: &str = "v 0 0 0\nv 1 0 0\nv 0 1 0\nv 0 0 1\nf 1 3 2\nf 1 2 4\nf 1 4 3\nf 2 3 4\n";

/// Returns a model that names `file`, as an include or as a mesh.
fn naming(file: &str) -> String {
    if file.ends_with("xml") {
        format!(r#"<mujoco><include file="{file}"/></mujoco>"#)
    } else {
        format!(
            r#"<mujoco><asset><mesh name="m" file="{file}"/></asset>
               <worldbody><geom type="mesh" mesh="m"/></worldbody></mujoco>"#
        )
    }
}

#[test]
fn files_on_the_disk_are_never_read() {
    let name = "files_on_the_disk_are_never_read";
    let folder = Path::new(env!("CARGO_TARGET_TMPDIR")).join(name);
    if is_case(name) {
        for file in ["part.xml", "cube.obj"] {
            assert!(Path::new(file).exists(), "the working folder holds {file}");
            let absolute = folder.join(file).to_str().unwrap().to_owned();
            for path in [file, &format!("../{name}/{file}"), &absolute] {
                let error = Model::from_xml(&naming(path)).unwrap_err();
                assert!(error.to_string().contains(file), "{path}: {error}");
            }
        }
        // comment marks inside a value do not begin a comment
        let mesh = naming(folder.join("cube.obj").to_str().unwrap());
        let text = mesh.replace("<mujoco>", r#"<mujoco model="<!--">"#);
        let text = text.replace("<geom ", r#"<geom name="-->" "#);
        assert!(Model::from_xml(&text).is_err(), "{text}");
        return;
    }
    fs::create_dir_all(&folder).unwrap();
    fs::write(folder.join("part.xml"), PART).unwrap();
    fs::write(folder.join("cube.obj"), CUBE).unwrap();
    assert_passed(&run_case_in(name, &folder));
}
