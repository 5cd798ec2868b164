//! MuJoCo's virtual file system: files held in memory while a model is parsed.

use std::ffi::CString;

use crate::error::ModelError;
use crate::raw;
use crate::releases::{self, MAX_NAME_LEN};

/// Path of a folder that does not exist, under which MuJoCo gets all model files in memory. MuJoCo
/// strips it from names that it looks for in memory, and no such file can exist on the disk,
/// because `/dev/null` is not a folder.
pub(crate) const NONEXISTENT_FOLDER: &str = "/dev/null/";

/// Owner of MuJoCo's `mjVFS`, a set of files in memory.
pub(crate) struct VirtualFileSystem {
    // two megabytes in 2.2.2, therefore on the heap
    raw: Box<raw::mjVFS>,
}

impl VirtualFileSystem {
    pub(crate) fn new() -> Self {
        // SAFETY: an mjVFS is integers, characters and pointers; all-zero bytes are a valid value.
        let mut raw = unsafe { Box::<raw::mjVFS>::new_zeroed().assume_init() };
        // SAFETY: the pointer is to a live mjVFS.
        unsafe { raw::mj_defaultVFS(&raw mut *raw) };
        Self { raw }
    }

    /// Adds a file with a copy of `content` under `name`.
    pub(crate) fn add_file(&mut self, name: &str, content: &[u8]) -> Result<(), ModelError> {
        check_name(name)?;
        let c_name = c_string(name, name.into())?;
        let size = file_size(name, content)?;
        check_status(name, releases::add_buffer(&mut self.raw, &c_name, content, size))
    }

    pub(crate) fn as_ptr(&self) -> *const raw::mjVFS {
        &raw const *self.raw
    }
}

impl Drop for VirtualFileSystem {
    fn drop(&mut self) {
        // SAFETY: live mjVFS, whose files MuJoCo allocated; nothing uses them afterwards.
        unsafe { raw::mj_deleteVFS(&raw mut *self.raw) };
    }
}

/// Returns the path of the file `name` in the folder [`NONEXISTENT_FOLDER`].
pub(crate) fn path_in_memory(name: &str) -> Result<CString, ModelError> {
    check_name(name)?;
    c_string(name, format!("{NONEXISTENT_FOLDER}{name}"))
}

fn c_string(name: &str, text: String) -> Result<CString, ModelError> {
    CString::new(text).map_err(|_| refused(name, "it holds a NUL character"))
}

/// Rejects names that MuJoCo cannot find again, for instance with a folder, which it would strip.
fn check_name(name: &str) -> Result<(), ModelError> {
    if name.is_empty() {
        return Err(refused(name, "it is empty"));
    }
    if name.len() >= MAX_NAME_LEN {
        return Err(refused(name, "it has 1000 bytes or more"));
    }
    if name.contains(['/', '\\']) {
        return Err(refused(name, "it holds a folder; files are found by their plain name"));
    }
    Ok(())
}

fn refused(name: &str, reason: &'static str) -> ModelError {
    ModelError::InvalidFileName { name: name.into(), reason }
}

fn file_size(name: &str, content: &[u8]) -> Result<i32, ModelError> {
    match i32::try_from(content.len()) {
        Ok(size) if size > 0 => Ok(size),
        _ => Err(ModelError::InvalidFileSize { name: name.into(), size: content.len() }),
    }
}

fn check_status(name: &str, status: i32) -> Result<(), ModelError> {
    match status {
        0 => Ok(()),
        1 => Err(refused(name, "the virtual file system is full (2000 files)")),
        2 => Err(refused(name, "another file of this name was given")),
        _ => Err(refused(name, "MuJoCo could not store it in memory")),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn bad_files_are_refused() {
        let mut vfs = VirtualFileSystem::new();
        vfs.add_file("a.xml", b"one").unwrap();
        vfs.add_file("b.xml", b"one").unwrap();
        let repeated = vfs.add_file("a.xml", b"other").unwrap_err();
        assert_eq!(repeated, refused("a.xml", "another file of this name was given"));
        for (name, content) in [("", "x"), ("f/a.xml", "x"), ("a\0b", "x")] {
            let error = vfs.add_file(name, content.as_bytes()).unwrap_err();
            assert!(matches!(error, ModelError::InvalidFileName { .. }), "{name:?}: {error}");
        }
        let error = vfs.add_file("empty.xml", b"").unwrap_err();
        assert_eq!(error, ModelError::InvalidFileSize { name: "empty.xml".into(), size: 0 });
        let long_name = vfs.add_file(&"x".repeat(1000), b"x").unwrap_err();
        assert!(matches!(long_name, ModelError::InvalidFileName { .. }));
    }
}
