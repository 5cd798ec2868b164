//! What the crate does to its process, seen from outside: each case runs this program again.

#![allow(clippy::unwrap_used, reason = "test code")]

use std::env;
use std::os::unix::process::ExitStatusExt;
use std::process::{Command, Output, Stdio};

use mujoco::Model;

/// Set in the child: the name of the case.
const CASE: &str = "COVERS_TEST_CASE";
const THREADS: &str = "LP_NUM_THREADS";
const SIGABRT: i32 = 6;

fn is_case(name: &str) -> bool {
    env::var(CASE).is_ok_and(|case| case == name)
}

/// Runs the test `name` of this file in a process of its own.
fn run_case(name: &str) -> Output {
    Command::new(env::current_exe().unwrap())
        .args(["--exact", name, "--nocapture"])
        .env(CASE, name)
        .env_remove(THREADS)
        .stdin(Stdio::piped()) // open and silent: MuJoCo's own error handler waits for a key
        .output()
        .unwrap()
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
    assert!(
        message.contains("MuJoCo: fatal error: out of cheese"),
        "{message}"
    );
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
    assert!(run_case(name).status.success());
}
