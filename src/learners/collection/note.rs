//! The caller's note in a learner's file.

use std::path::Path;

use serde::de::IgnoredAny;

use crate::error::CoversError;
use crate::learners::tensor_file::{Tensor, TensorFile};

/// The array of the note. The header of a safetensors file has at most 100 MB, and a note grows
/// with its run.
const NAME: &str = "note";

/// The array that holds a note.
pub(super) fn tensor(note: &str) -> Tensor {
    let bytes = note.as_bytes().to_vec();
    Tensor::bytes(NAME.to_owned(), vec![bytes.len()], bytes)
}

/// The note of a file.
pub(super) fn of(file: &TensorFile<'_>) -> Result<String, CoversError> {
    file.text(NAME)
}

/// Reads the note of the file at `path`, whatever learner wrote it.
///
/// # Errors
/// [`CoversError::Read`], [`CoversError::NewerFormat`].
pub fn read_note(path: &Path) -> Result<String, CoversError> {
    let bytes = std::fs::read(path).map_err(|error| CoversError::read(path, error))?;
    let (_, file): (IgnoredAny, _) = TensorFile::open(path, &bytes)?;
    of(&file)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learners::tensor_file::encode;

    #[test]
    fn a_note_may_be_longer_than_any_header() {
        let path = std::env::temp_dir().join(format!("covers-note-{}", std::process::id()));
        let note = "row\n".repeat(30_000_000);
        let header = serde_json::json!({ "settings": 1 });
        let bytes = encode(&path, &header, &[tensor(&note)]).unwrap();
        std::fs::write(&path, bytes).unwrap();
        let again = read_note(&path).unwrap();
        std::fs::remove_file(path).unwrap();
        assert!(again == note, "{} of {} bytes", again.len(), note.len());
    }
}
