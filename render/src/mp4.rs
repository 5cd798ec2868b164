//! Films as mp4 files, which `ffmpeg` makes.

use std::ffi::{OsStr, OsString};
use std::fs;
use std::path::{Path, PathBuf};
use std::process::Command;

use crate::{RenderError, helper};
use experiments::RunError;
use learner::disk::PARTIAL;

use super::gif::{DELAY, Film, HOLD};

/// The program.
pub(super) struct Ffmpeg(PathBuf);

impl Ffmpeg {
    /// The first `ffmpeg` in these folders, as `PATH` lists them, for a film that goes to `film`.
    ///
    /// # Errors
    /// [`RenderError::NoFfmpeg`].
    pub fn find(folders: &OsStr, film: &Path) -> Result<Self, RenderError> {
        let found = helper::find(folders, "ffmpeg");
        found.map(Self).ok_or_else(|| RenderError::NoFfmpeg { path: film.to_owned() })
    }

    /// The bytes of an mp4 (H.264) of the film. What `ffmpeg` writes lies beside `path` meanwhile.
    ///
    /// # Errors
    /// [`RunError::Write`] with what `ffmpeg` said last.
    pub fn encode(&self, film: &Film, path: &Path) -> Result<Vec<u8>, RunError> {
        let scratch = path.with_added_extension("ffmpeg").with_added_extension(PARTIAL);
        let made = self.make(film, &scratch).and_then(|()| fs::read(&scratch));
        // where nothing was made, there is nothing to remove
        let _ = fs::remove_file(&scratch);
        made.map_err(|error| RunError::write(path, error))
    }

    fn make(&self, film: &Film, to: &Path) -> std::io::Result<()> {
        let size = format!("{}x{}", film.width, film.height);
        let rate = format!("100/{DELAY}");
        // a name with a colon or a dash is no protocol and no option
        let mut file = OsString::from("file:");
        file.push(to);
        let mut ffmpeg = Command::new(&self.0);
        ffmpeg
            .args(["-loglevel", "error", "-y", "-f", "rawvideo", "-pix_fmt", "rgb24"])
            .args(["-s", &size, "-r", &rate, "-i", "-", "-an"])
            // H.264 takes even sides
            .args(["-vf", "pad=ceil(iw/2)*2:ceil(ih/2)*2:color=white"])
            .args([
                "-c:v",
                "libx264",
                "-pix_fmt",
                "yuv420p",
                "-movflags",
                "+faststart",
                "-f",
                "mp4",
            ])
            .arg(file);
        let last = film.frames.last().into_iter().cycle();
        let held = last.take(usize::from(HOLD) - 1);
        helper::run(&mut ffmpeg, |pipe| {
            let mut frames = film.frames.iter().chain(held);
            frames.try_for_each(|frame| pipe.write_all(frame))
        })?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::helper::tests::Programs;

    fn encoded(programs: &Programs) -> Result<Vec<u8>, RenderError> {
        let film = Film { width: 2, height: 1, frames: vec![vec![1; 6], vec![2; 6]] };
        let folder = programs.path();
        let path = folder.join("film.mp4");
        let found = Ffmpeg::find(folder.as_os_str(), &path)?.encode(&film, &path);
        let left = fs::read_dir(folder).unwrap().count();
        assert_eq!(left, 1, "nothing stays but the program");
        Ok(found?)
    }

    /// Copies what it is fed, where it is asked for H.264 in a file.
    const SCRIPT: &str = "for last; do :; done
        case \"$*\" in *'-c:v libx264 '*' file:'*) cat > \"${last#file:}\";; *) exit 1;; esac";

    #[test]
    fn the_program_is_fed_all_pictures_and_the_last_one_for_longer() {
        let programs = Programs::new("ffmpeg", "ffmpeg", SCRIPT);
        let expected = [[1; 6].to_vec(), [2; 6 * HOLD as usize].to_vec()].concat();
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
