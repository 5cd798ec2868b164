//! Initialisation before the first call into MuJoCo.

use std::env;
use std::ffi::{CStr, c_char};
use std::fs;
use std::io::Write;
use std::process;
use std::sync::OnceLock;

use crate::error::ModelError;
use crate::raw;

/// Returns the version of the MuJoCo library in this process, for instance `2.2.2`.
pub fn library_version() -> String {
    // SAFETY: `mj_version` takes nothing and reads a constant.
    let version = unsafe { raw::mj_version() };
    raw::release_name(version)
}

/// Release with which published figures are made.
pub const REFERENCE_RELEASE: &str = "2.2.2";

/// Returns `true` with [`REFERENCE_RELEASE`]. Others differ in contacts and equality constraints.
pub fn is_reference_release() -> bool {
    library_version() == REFERENCE_RELEASE
}

/// Disables the threads of Mesa's software renderer, installs MuJoCo's error handlers and compares
/// library and header versions, once per process.
pub(crate) fn initialise() -> Result<(), ModelError> {
    static READY: OnceLock<Result<(), ModelError>> = OnceLock::new();
    READY
        .get_or_init(|| {
            disable_mesa_threads();
            install_handlers();
            // SAFETY: `mj_version` takes nothing and reads a constant.
            let library = unsafe { raw::mj_version() };
            check_version(raw::mjVERSION_HEADER.cast_signed(), library)
        })
        .clone()
}

/// Disables the thread pool of Mesa's software renderer, unless the user has configured it or the
/// process has other threads.
///
/// Mesa spreads an image over one thread per core, which for images of a few thousand pixels costs
/// more than it saves, and competes with the simulations. It reads the variable when the first
/// context is made. Setting a variable is sound only while no other thread may read one.
fn disable_mesa_threads() {
    if env::var_os("LP_NUM_THREADS").is_none() && is_only_thread() {
        // SAFETY: this is the only thread of the process.
        unsafe { env::set_var("LP_NUM_THREADS", "0") };
    }
}

fn is_only_thread() -> bool {
    fs::read_dir("/proc/self/task").is_ok_and(|threads| threads.count() == 1)
}

fn install_handlers() {
    // SAFETY: runs once, under `READY`, before any other call of this crate into MuJoCo, which
    // is the only reader of the two variables; both handlers have the signature it expects.
    unsafe {
        raw::mju_user_error = Some(on_error);
        raw::mju_user_warning = Some(on_warning);
    }
}

/// Prints a fatal error of MuJoCo and aborts. MuJoCo relies on the handler not returning, and
/// unwinding through C is undefined; its own handler would wait for a key press and exit.
extern "C" fn on_error(message: *const c_char) {
    // SAFETY: MuJoCo passes a NUL-terminated buffer that lives for the call.
    let text = unsafe { CStr::from_ptr(message) };
    // a closed stderr must not turn into a panic inside a C callback
    let _ = writeln!(std::io::stderr(), "MuJoCo: fatal error: {}", text.to_string_lossy());
    process::abort();
}

/// Ignores a warning of MuJoCo, which would append it to MUJOCO_LOG.TXT in the working folder.
/// Warnings about a simulation also count in `mjData.warning`, and `Data` turns those counters into
/// errors.
extern "C" fn on_warning(_message: *const c_char) {}

fn check_version(header: i32, library: i32) -> Result<(), ModelError> {
    if header == library { Ok(()) } else { Err(ModelError::VersionMismatch { header, library }) }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn equal_versions_pass() {
        assert_eq!(check_version(222, 222), Ok(()));
        assert_eq!(initialise(), Ok(()));
    }

    #[test]
    fn tests_run_beside_other_threads() {
        std::thread::spawn(|| assert!(!is_only_thread())).join().unwrap();
    }

    #[test]
    fn another_library_is_an_error_naming_both() {
        let error = check_version(222, 237).unwrap_err();
        assert_eq!(error, ModelError::VersionMismatch { header: 222, library: 237 });
        assert!(error.to_string().contains("222") && error.to_string().contains("237"));
    }
}
