//! Curves as PNG files, which `rsvg-convert` makes of the SVG.

use std::ffi::OsStr;
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::error::CoversError;
use crate::helper;

/// Pixels of a PNG for each unit of an SVG.
const ZOOM: &str = "2";

/// The program.
pub(super) struct Converter(PathBuf);

impl Converter {
    /// The first `rsvg-convert` in these folders, as `PATH` lists them.
    ///
    /// # Errors
    /// [`CoversError::NoRsvg`].
    pub fn find(folders: &OsStr) -> Result<Self, CoversError> {
        let found = helper::find(folders, "rsvg-convert");
        found.map(Self).ok_or(CoversError::NoRsvg)
    }

    /// Writes the PNG of an SVG file beside it.
    ///
    /// # Errors
    /// [`CoversError::Write`] with what the program said last.
    pub fn convert(&self, svg: &Path) -> Result<(), CoversError> {
        let path = svg.with_extension("png");
        // by its bytes: a name that begins with a dash is no option
        let png = fs::read(svg).and_then(|svg| {
            let mut program = Command::new(&self.0);
            program.args(["--format", "png", "--zoom", ZOOM]);
            helper::run(&mut program, |pipe| pipe.write_all(&svg))
        });
        let written = png.and_then(|png| fs::write(&path, png));
        written.map_err(|error| CoversError::write(&path, error))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::helper::tests::Programs;

    #[test]
    fn a_drawing_is_handed_to_the_program() {
        // prints its options and what it is fed
        let programs = Programs::new("rsvg", "rsvg-convert", "echo \"$*\"; cat");
        let converter = Converter::find(programs.path().as_os_str()).unwrap();
        let svg = programs.path().join("seed0.svg");
        fs::write(&svg, "<svg/>").unwrap();
        converter.convert(&svg).unwrap();
        let told = fs::read_to_string(programs.path().join("seed0.png")).unwrap();
        assert_eq!(told, "--format png --zoom 2\n<svg/>");
    }

    #[test]
    fn a_drawing_that_fails_is_named() {
        let programs = Programs::new("rsvg-fails", "rsvg-convert", "echo no font >&2; exit 1");
        let converter = Converter::find(programs.path().as_os_str()).unwrap();
        let svg = programs.path().join("seed0.svg");
        fs::write(&svg, "<svg/>").unwrap();
        let message = converter.convert(&svg).unwrap_err().to_string();
        assert!(message.contains("seed0.png"), "{message}");
        assert!(message.ends_with("no font"), "{message}");
        assert!(!programs.path().join("seed0.png").exists());
    }

    #[test]
    fn a_machine_without_the_program_is_told_what_to_do() {
        let found = Converter::find(OsStr::new("/nowhere"));
        let message = found.err().map(|error| error.to_string());
        assert!(message.is_some_and(|message| message.contains("librsvg2-bin")));
    }
}
