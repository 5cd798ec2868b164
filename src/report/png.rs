//! Curves as PNG files, which `rsvg-convert` makes of the SVG.

use std::ffi::OsStr;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::error::CoversError;
use crate::helper;

use super::document::Report;

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

    /// Writes the curves of a report to a folder that exists.
    ///
    /// # Errors
    /// [`CoversError::Write`] with what the program said last.
    pub fn draw(&self, report: &Report, folder: &Path) -> Result<(), CoversError> {
        let mut drawings = report.drawings().into_iter();
        drawings.try_for_each(|(name, svg)| {
            let path = folder.join(format!("{name}.png"));
            let png = helper::run(
                Command::new(&self.0).args(["--format", "png", "--zoom", ZOOM]),
                |pipe| pipe.write_all(svg.as_bytes()),
            );
            let written = png.and_then(|png| std::fs::write(&path, png));
            written.map_err(|error| CoversError::write(&path, error))
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::helper::tests::Programs;
    use crate::presets::{Budget, Method};
    use crate::report::RunData;

    /// A report on a run without rows.
    fn report() -> Report {
        let experiment = Budget::Smoke.experiment(Method::Covers);
        Report::new(vec![RunData::empty("covers-seed0", experiment)]).unwrap()
    }

    #[test]
    fn every_drawing_is_handed_to_the_program() {
        // prints its options and what it is fed
        let programs = Programs::new("rsvg", "rsvg-convert", "echo \"$*\"; cat");
        let converter = Converter::find(programs.path().as_os_str()).unwrap();
        let report = report();
        converter.draw(&report, programs.path()).unwrap();
        let drawings = report.drawings();
        assert!(drawings.iter().any(|(name, _)| name == "covers-seed0"));
        for (name, svg) in drawings {
            let path = programs.path().join(format!("{name}.png"));
            let told = std::fs::read_to_string(path).unwrap();
            assert_eq!(told, format!("--format png --zoom 2\n{svg}"));
        }
    }

    #[test]
    fn a_machine_without_the_program_is_told_what_to_do() {
        let found = Converter::find(OsStr::new("/nowhere"));
        let message = found.err().map(|error| error.to_string());
        assert!(message.is_some_and(|message| message.contains("librsvg2-bin")));
    }
}
