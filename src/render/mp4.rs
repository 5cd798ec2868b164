//! Films as mp4 files, which `ffmpeg` makes.

use std::ffi::{OsStr, OsString};
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};
use std::process::{Command, Stdio};
use std::thread;

use crate::disk::PARTIAL;
use crate::error::CoversError;

use super::film::{DELAY, Film, HOLD};

/// The program.
pub(super) struct Ffmpeg(PathBuf);

impl Ffmpeg {
    /// The first `ffmpeg` in these folders, as `PATH` lists them, for a film that goes to `film`.
    ///
    /// # Errors
    /// [`CoversError::NoFfmpeg`].
    pub fn find(folders: &OsStr, film: &Path) -> Result<Self, CoversError> {
        let mut programs = std::env::split_paths(folders).map(|folder| folder.join("ffmpeg"));
        let found = programs.find(|program| program.is_file());
        found.map(Self).ok_or_else(|| CoversError::NoFfmpeg {
            path: film.to_owned(),
        })
    }

    /// The bytes of an mp4 (H.264) of the film. What `ffmpeg` writes lies beside `path` meanwhile.
    ///
    /// # Errors
    /// [`CoversError::Write`] with what `ffmpeg` said last.
    pub fn encode(&self, film: &Film, path: &Path) -> Result<Vec<u8>, CoversError> {
        let scratch = path
            .with_added_extension("ffmpeg")
            .with_added_extension(PARTIAL);
        let made = self.make(film, &scratch).and_then(|()| fs::read(&scratch));
        // where nothing was made, there is nothing to remove
        let _ = fs::remove_file(&scratch);
        made.map_err(|error| CoversError::write(path, error))
    }

    fn make(&self, film: &Film, to: &Path) -> std::io::Result<()> {
        let size = format!("{}x{}", film.width, film.height);
        let rate = format!("100/{DELAY}");
        // a name with a colon or a dash is no protocol and no option
        let mut file = OsString::from("file:");
        file.push(to);
        let mut ffmpeg = Command::new(&self.0)
            .args([
                "-loglevel",
                "error",
                "-y",
                "-f",
                "rawvideo",
                "-pix_fmt",
                "rgb24",
            ])
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
            .arg(file)
            .stdin(Stdio::piped())
            .stdout(Stdio::null())
            .stderr(Stdio::piped())
            .spawn()?;
        let pipe = ffmpeg.stdin.take();
        let held = film
            .frames
            .last()
            .into_iter()
            .cycle()
            .take(usize::from(HOLD) - 1);
        // ffmpeg may complain while it is being fed: neither waits for the other
        let (fed, output) = thread::scope(|scope| {
            let feed = scope.spawn(|| {
                let mut pipe = pipe.ok_or(std::io::ErrorKind::BrokenPipe)?;
                let mut frames = film.frames.iter().chain(held);
                frames.try_for_each(|frame| pipe.write_all(frame))
            });
            let output = ffmpeg.wait_with_output();
            (feed.join(), output)
        });
        let output = output?;
        if !output.status.success() {
            let said = String::from_utf8_lossy(&output.stderr);
            let last = said.trim().lines().last().unwrap_or("nothing");
            let message = format!("ffmpeg failed ({}): {last}", output.status);
            return Err(std::io::Error::other(message));
        }
        fed.unwrap_or_else(|_| Err(std::io::ErrorKind::BrokenPipe.into()))
    }
}

#[cfg(test)]
mod tests {
    use std::os::unix::fs::PermissionsExt;

    use super::*;

    /// A folder with a program `ffmpeg` that a shell runs.
    fn folder(name: &str, script: &str) -> PathBuf {
        let folder = std::env::temp_dir().join(format!("covers-{name}-{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        let program = folder.join("ffmpeg");
        fs::write(&program, format!("#!/bin/sh\n{script}\n")).unwrap();
        fs::set_permissions(&program, fs::Permissions::from_mode(0o755)).unwrap();
        folder
    }

    fn encoded(folder: &Path) -> Result<Vec<u8>, CoversError> {
        let film = Film {
            width: 2,
            height: 1,
            frames: vec![vec![1; 6], vec![2; 6]],
        };
        let path = folder.join("film.mp4");
        let found = Ffmpeg::find(folder.as_os_str(), &path)?.encode(&film, &path);
        let left = fs::read_dir(folder).unwrap().count();
        fs::remove_dir_all(folder).unwrap();
        assert_eq!(left, 1, "nothing stays but the program");
        found
    }

    /// Copies what it is fed, where it is asked for H.264 in a file.
    const SCRIPT: &str = "for last; do :; done
        case \"$*\" in *'-c:v libx264 '*' file:'*) cat > \"${last#file:}\";; *) exit 1;; esac";

    #[test]
    fn the_program_is_fed_all_pictures_and_the_last_one_for_longer() {
        let folder = folder("ffmpeg", SCRIPT);
        let expected = [[1; 6].to_vec(), [2; 6 * HOLD as usize].to_vec()].concat();
        assert_eq!(encoded(&folder).unwrap(), expected);
    }

    #[test]
    fn what_the_program_says_last_is_told() {
        let folder = folder(
            "ffmpeg-fails",
            "echo first >&2; echo no such codec >&2; exit 3",
        );
        let message = encoded(&folder).unwrap_err().to_string();
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
