//! Encoding of films as mp4 files by `ffmpeg`.

use std::ffi::{OsStr, OsString};
use std::fs;
use std::io::{Error, ErrorKind, Write};
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::thread;

use crate::RenderError;
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
        let mut programs = std::env::split_paths(folders).map(|folder| folder.join("ffmpeg"));
        let found = programs.find(|program| program.is_file());
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
        feed(&mut ffmpeg, film.frames.iter().chain(held))
    }
}

/// Runs a program that reads `frames` from its standard input.
///
/// # Errors
/// A program that does not start or does not read its input, and one that fails, with the last line
/// of its standard error.
fn feed<'a>(
    command: &mut Command,
    mut frames: impl Iterator<Item = &'a Vec<u8>> + Send,
) -> std::io::Result<()> {
    let piped = command.stdin(Stdio::piped()).stdout(Stdio::null());
    let mut program = piped.stderr(Stdio::piped()).spawn()?;
    let pipe = program.stdin.take();
    // feed from a second thread: a program that fills the pipe of its standard error while it is
    // still being fed would otherwise block, and so would the feeder
    let (fed, output) = thread::scope(|scope| {
        let feeder = scope.spawn(|| {
            let mut pipe = pipe.ok_or(ErrorKind::BrokenPipe)?;
            frames.try_for_each(|frame| pipe.write_all(frame))
        });
        let output = program.wait_with_output();
        (feeder.join(), output)
    });
    let output = output?;
    if !output.status.success() {
        let stderr = String::from_utf8_lossy(&output.stderr);
        let last = stderr.trim().lines().last().unwrap_or("nothing");
        let name = command.get_program().display();
        let message = format!("{name} failed ({}): {last}", output.status);
        return Err(Error::other(message));
    }
    fed.unwrap_or_else(|_| Err(ErrorKind::BrokenPipe.into()))
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    const WIDTH: usize = 1 << 10;
    const HEIGHT: usize = 1 << 5;
    /// Bytes of a picture. All pictures of a film together are more than a pipe holds.
    const BYTES: usize = 3 * WIDTH * HEIGHT;

    /// Folder with one shell script, `ffmpeg`; dropping it removes the folder.
    struct Programs(PathBuf);

    impl Programs {
        fn new(test: &str, script: &str) -> Self {
            let folder = std::env::temp_dir().join(format!("covers-{test}-{}", std::process::id()));
            fs::create_dir_all(&folder).unwrap();
            let program = folder.join("ffmpeg");
            fs::write(&program, format!("#!/bin/sh\n{script}\n")).unwrap();
            fs::set_permissions(&program, fs::Permissions::from_mode(0o755)).unwrap();
            Self(folder)
        }
    }

    impl Drop for Programs {
        fn drop(&mut self) {
            let _ = fs::remove_dir_all(&self.0);
        }
    }

    fn encoded(programs: &Programs) -> Result<Vec<u8>, RenderError> {
        let frames = [1, 2].map(|level| vec![level; BYTES]).to_vec();
        let film = Film { width: WIDTH, height: HEIGHT, frames };
        let folder = &programs.0;
        let path = folder.join("film.mp4");
        let found = Ffmpeg::find(folder.as_os_str(), &path)?.encode(&film, &path);
        let left = fs::read_dir(folder).unwrap().count();
        assert_eq!(left, 1, "nothing stays but the program");
        Ok(found?)
    }

    /// Stand-in for `ffmpeg` that copies its input if it is asked for H.264 in a file, and says all
    /// of it.
    const SCRIPT: &str = "for last; do :; done
        case \"$*\" in *'-c:v libx264 '*' file:'*) tee \"${last#file:}\" >&2;; *) exit 1;; esac";

    #[test]
    fn the_program_is_fed_all_pictures_and_the_last_one_for_longer() {
        let programs = Programs::new("ffmpeg", SCRIPT);
        let expected: Vec<u8> =
            [vec![1; BYTES], vec![2; BYTES * usize::from(HOLD_DELAYS)]].concat();
        assert!(expected.len() > 1 << 20);
        assert!(encoded(&programs).unwrap() == expected);
    }

    #[test]
    fn a_film_that_fails_is_named_with_what_the_program_says_last() {
        let script = "echo first >&2; echo no such codec >&2; exit 3";
        let message = encoded(&Programs::new("ffmpeg-fails", script)).unwrap_err().to_string();
        assert!(message.contains("film.mp4"), "{message}");
        assert!(message.contains("ffmpeg failed"), "{message}");
        assert!(message.ends_with("no such codec"), "{message}");
    }

    #[test]
    fn a_machine_without_the_program_is_told_what_to_do() {
        let found = Ffmpeg::find(OsStr::new("/nowhere"), Path::new("a.mp4"));
        let message = found.err().map(|error| error.to_string());
        assert!(message.is_some_and(|message| message.contains("install it")));
    }
}
