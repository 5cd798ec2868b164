//! External programs that read their input from a pipe.

use std::ffi::OsStr;
use std::io::{Error, ErrorKind, Write};
use std::path::PathBuf;
use std::process::{Command, Stdio};
use std::thread;

/// Returns the path of the first program `name` in `folders`, a list in the format of `PATH`.
pub fn find_program(folders: &OsStr, name: &str) -> Option<PathBuf> {
    let mut programs = std::env::split_paths(folders).map(|folder| folder.join(name));
    programs.find(|program| program.is_file())
}

/// Runs a program, lets `feed` write to its standard input, and returns its standard output.
///
/// # Errors
/// A program that does not start or does not read its input, and one that fails, with the last line
/// of its standard error.
pub fn run_program(
    command: &mut Command,
    feed: impl FnOnce(&mut dyn Write) -> std::io::Result<()> + Send,
) -> std::io::Result<Vec<u8>> {
    let piped = command.stdin(Stdio::piped()).stdout(Stdio::piped());
    let mut program = piped.stderr(Stdio::piped()).spawn()?;
    let pipe = program.stdin.take();
    // feed from a second thread: a program that fills its output pipes while it is still being fed
    // would otherwise block, and so would the feeder
    let (fed, output) = thread::scope(|scope| {
        let feeder = scope.spawn(|| {
            let mut pipe = pipe.ok_or(ErrorKind::BrokenPipe)?;
            feed(&mut pipe)
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
    fed.unwrap_or_else(|_| Err(ErrorKind::BrokenPipe.into()))?;
    Ok(output.stdout)
}

#[cfg(test)]
pub(crate) mod tests {
    use std::fs;
    use std::os::unix::fs::PermissionsExt;
    use std::path::Path;

    use super::*;

    /// Folder with one shell script; dropping it removes the folder.
    pub struct Programs(pub PathBuf);

    impl Programs {
        pub fn new(test: &str, program: &str, script: &str) -> Self {
            let folder = std::env::temp_dir().join(format!("covers-{test}-{}", std::process::id()));
            fs::create_dir_all(&folder).unwrap();
            let program = folder.join(program);
            fs::write(&program, format!("#!/bin/sh\n{script}\n")).unwrap();
            fs::set_permissions(&program, fs::Permissions::from_mode(0o755)).unwrap();
            Self(folder)
        }

        pub fn path(&self) -> &Path {
            &self.0
        }
    }

    impl Drop for Programs {
        fn drop(&mut self) {
            let _ = fs::remove_dir_all(&self.0);
        }
    }

    fn fed(programs: &Programs, input: &[u8]) -> std::io::Result<Vec<u8>> {
        let program = find_program(programs.path().as_os_str(), "helper").unwrap();
        run_program(&mut Command::new(program), |pipe| pipe.write_all(input))
    }

    #[test]
    fn a_program_gets_all_and_its_answer_comes_back() {
        let programs = Programs::new("helper", "helper", "cat");
        assert!(find_program(programs.path().as_os_str(), "another").is_none());
        // more than a pipe holds
        let input = [7; 1 << 20];
        assert_eq!(fed(&programs, &input).unwrap(), input);
    }

    #[test]
    fn what_a_program_says_last_is_told() {
        let script = "echo first >&2; echo no such codec >&2; exit 3";
        let programs = Programs::new("helper-fails", "helper", script);
        let message = fed(&programs, b"text").unwrap_err().to_string();
        assert!(message.contains("helper failed"), "{message}");
        assert!(message.ends_with("no such codec"), "{message}");
    }
}
