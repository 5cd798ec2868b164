//! The caller's note in a learner's file.

use std::path::Path;

use serde::Deserialize;

use crate::error::CoversError;
use crate::learners::tensor_file::{Tensor, TensorFile};

/// The array of the note. The header of a safetensors file has at most 100 MB, and a note grows
/// with its run.
const NAME: &str = "note";

/// The part of a header that says whether the note stands there.
#[derive(Deserialize)]
struct Noted {
    note: Option<String>,
}

/// The array that holds a note.
pub(super) fn tensor(note: &str) -> Tensor {
    let bytes = note.as_bytes().to_vec();
    Tensor::bytes(NAME.to_owned(), vec![bytes.len()], bytes)
}

/// The note of a file: that of its header, where it has one, as files of format 3 do.
pub(super) fn of(header: Option<String>, file: &TensorFile<'_>) -> Result<String, CoversError> {
    header.map_or_else(|| file.text(NAME), Ok)
}

/// Reads the note of the file at `path`, whatever learner wrote it.
///
/// # Errors
/// [`CoversError::Read`], [`CoversError::NewerFormat`].
pub fn read_note(path: &Path) -> Result<String, CoversError> {
    let bytes = std::fs::read(path).map_err(|error| CoversError::read(path, error))?;
    let (header, file): (Noted, _) = TensorFile::open(path, &bytes)?;
    of(header.note, &file)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::learners::tensor_file::encode;

    /// What a file with this header and a note in an array says.
    fn read(name: &str, header: serde_json::Value, note: &str) -> String {
        let name = format!("covers-note-{name}-{}", std::process::id());
        let path = std::env::temp_dir().join(name);
        let bytes = encode(&path, &header, &[tensor(note)]).unwrap();
        std::fs::write(&path, bytes).unwrap();
        let read = read_note(&path).unwrap();
        std::fs::remove_file(path).unwrap();
        read
    }

    #[test]
    fn a_note_may_be_longer_than_any_header() {
        let note = "row\n".repeat(30_000_000);
        let again = read("long", serde_json::json!({ "settings": 1 }), &note);
        assert!(again == note, "{} of {} bytes", again.len(), note.len());
    }

    #[test]
    fn a_note_in_the_header_is_read() {
        let header = serde_json::json!({ "note": "in the header" });
        assert_eq!(read("header", header, "in an array"), "in the header");
    }
}
