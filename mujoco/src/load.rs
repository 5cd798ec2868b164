//! Compilation of a model from files in memory.

use std::ffi::{CStr, CString, c_char};
use std::ptr::NonNull;
use std::sync::{Mutex, PoisonError};

use crate::error::ModelError;
use crate::init;
use crate::raw;
use crate::references::reject_outside_references;
use crate::vfs::{NONEXISTENT_FOLDER, VirtualFileSystem, path_in_memory};

/// Checks that `main` is in `files` and that no path inside the XML leads to a file on the disk;
/// returns the path of `main` in memory.
pub(crate) fn check_file_references(
    main: &str,
    files: &[(&str, &[u8])],
) -> Result<CString, ModelError> {
    let c_main = path_in_memory(main)?;
    if !files.iter().any(|(name, _)| *name == main) {
        let files = files.iter().map(|(name, _)| (*name).into()).collect();
        return Err(ModelError::NoMainFile { main: main.into(), files });
    }
    reject_outside_references(main, files)?;
    Ok(c_main)
}

/// Compiles the model file `main`, one of `files`; also returns MuJoCo's warning, if any.
pub(crate) fn load(
    main: &str,
    files: &[(&str, &[u8])],
) -> Result<(NonNull<raw::mjModel>, Option<String>), ModelError> {
    init::initialise()?;
    let c_main = check_file_references(main, files)?;
    let mut vfs = VirtualFileSystem::new();
    for (name, content) in files {
        vfs.add_file(name, content)?;
    }
    parse(&c_main, &vfs).map_err(|message| ModelError::LoadFailed {
        file: main.into(),
        // the pretended folder must not show in messages
        message: message.replace(NONEXISTENT_FOLDER, ""),
    })
}

fn parse(
    main: &CStr,
    vfs: &VirtualFileSystem,
) -> Result<(NonNull<raw::mjModel>, Option<String>), String> {
    // the parser keeps the last XML in a global variable
    static PARSER: Mutex<()> = Mutex::new(());
    let _one_at_a_time = PARSER.lock().unwrap_or_else(PoisonError::into_inner);
    let mut message: [c_char; 1024] = [0; 1024];
    let size = message.len() as i32;
    // SAFETY: NUL-terminated name, live file system, and a message buffer of the size given.
    let model = unsafe { raw::mj_loadXML(main.as_ptr(), vfs.as_ptr(), message.as_mut_ptr(), size) };
    // SAFETY: MuJoCo leaves a NUL-terminated text in the buffer, which began as all NUL.
    let text = unsafe { CStr::from_ptr(message.as_ptr()) }.to_string_lossy().trim().to_string();
    match NonNull::new(model) {
        Some(raw) => Ok((raw, Some(text).filter(|text| !text.is_empty()))),
        None => Err(text),
    }
}
