//! Encoding of films as mp4 files by `ffmpeg`.

use std::ffi::{OsStr, OsString};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::{RenderError, subprocess};
use experiments::RunError;
use learner::disk::PARTIAL_FILE_EXTENSION;

use super::gif::{DELAY_CENTISECONDS, Film, HOLD_DELAYS};

/// Path of the program `ffmpeg`.
pub(super) struct Ffmpeg(PathBuf);

impl Ffmpeg {
    /// Finds `ffmpeg` in `folders`, a list in the format of `PATH`.
    ///
    /// # Errors
    /// [`RenderError::NoFfmpeg`] with `film`, the path of the film that cannot be written.
    pub fn find(folders: &OsStr, film: &Path) -> Result<Self, RenderError> {
        let found = subprocess::find_program(folders, "ffmpeg");
        found.map(Self).ok_or_else(|| RenderError::NoFfmpeg { path: film.to_owned() })
    }

    /// Encodes a film as an mp4 (H.264) and returns the file's bytes. `ffmpeg` writes to a
    /// temporary file beside `path`, since the mp4 format needs an output that can seek.
    ///
    /// # Errors
    /// [`RunError::Write`] with the last line of `ffmpeg`'s standard error.
    pub fn encode(&self, film: &Film, path: &Path) -> Result<Vec<u8>, RunError> {
        let scratch =
            path.with_added_extension("ffmpeg").with_added_extension(PARTIAL_FILE_EXTENSION);
        let made = self.make(film, &scratch).and_then(|()| fs::read(&scratch));
        // fails if `ffmpeg` made no file
        let _ = fs::remove_file(&scratch);
        made.map_err(RunError::write_error_mapper(path))
    }

    fn make(&self, film: &Film, to: &Path) -> std::io::Result<()> {
        let size = format!("{}x{}", film.width, film.height);
        let rate = format!("100/{DELAY_CENTISECONDS}");
        // without the prefix, a name with a colon is a protocol and one with a dash is an option
        let mut file = OsString::from("file:");
        file.push(to);
        let mut ffmpeg = Command::new(&self.0);
        ffmpeg
            .args(["-loglevel", "error", "-y", "-f", "rawvideo", "-pix_fmt", "rgb24"])
            .args(["-s", &size, "-r", &rate, "-i", "-", "-an"])
            // yuv420p halves the resolution of colours, so width and height must be even
            .args(["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2:color=white"])
            .args(["-c:v", "libx264", "-pix_fmt", "yuv420p"])
            .args(["-movflags", "+faststart", "-f", "mp4"])
            .arg(file);
        let last = film.frames.last().into_iter().cycle();
        let held = last.take(usize::from(HOLD_DELAYS) - 1);
        subprocess::run_program(&mut ffmpeg, |pipe| {
            let mut frames = film.frames.iter().chain(held);
            frames.try_for_each(|frame| pipe.write_all(frame))
        })?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::subprocess::tests::Programs;

    fn encoded(programs: &Programs) -> Result<Vec<u8>, RenderError> {
        let film = Film { width: 2, height: 1, frames: vec![vec![1; 6], vec![2; 6]] };
        let folder = programs.path();
        let path = folder.join("film.mp4");
        let found = Ffmpeg::find(folder.as_os_str(), &path)?.encode(&film, &path);
        let left = fs::read_dir(folder).unwrap().count();
        assert_eq!(left, 1, "nothing stays but the program");
        Ok(found?)
    }

    /// Stand-in for `ffmpeg` that copies its input if it is asked for H.264 in a file.
    const SCRIPT: &str = "for last; do :; done
        case \"$*\" in *'-c:v libx264 '*' file:'*) cat > \"${last#file:}\";; *) exit 1;; esac";

    #[test]
    fn the_program_is_fed_all_pictures_and_the_last_one_for_longer() {
        let programs = Programs::new("ffmpeg", "ffmpeg", SCRIPT);
        let expected = [[1; 6].to_vec(), [2; 6 * HOLD_DELAYS as usize].to_vec()].concat();
        assert_eq!(encoded(&programs).unwrap(), expected);
    }

    #[test]
    fn a_film_that_fails_is_named() {
        let programs = Programs::new("ffmpeg-fails", "ffmpeg", "echo no such codec >&2; exit 3");
        let message = encoded(&programs).unwrap_err().to_string();
        assert!(message.contains("film.mp4"), "{message}");
        assert!(message.ends_with("no such codec"), "{message}");
    }

    #[test]
    fn a_machine_without_the_program_is_told_what_to_do() {
        let found = Ffmpeg::find(OsStr::new("/nowhere"), Path::new("a.mp4"));
        let message = found.err().map(|error| error.to_string());
        assert!(message.is_some_and(|message| message.contains("install it")));
    }
}
