//! Fuzz targets, one for each kind of input. The libFuzzer program and the test `tests/fuzz.rs` run
//! the same list.

use std::fmt::Display;
use std::path::{Path, PathBuf};

use allocation_counter::measure;

mod calibration;
mod checkpoint;
mod learners;
mod mjcf;
mod note;
mod npz;
mod plan;
mod small;
mod tables;
mod tensors;
mod text;

/// Reader of untrusted input, which must not panic for any input.
pub struct Target {
    /// Name on the command line, and of the target's folder in `corpus`.
    pub name: &'static str,
    /// Reads an input through [`measured`].
    read: fn(&[u8]) -> Option<Reading>,
    /// Valid inputs to start from.
    seeds: fn() -> Vec<Vec<u8>>,
    /// Bytes that reading may hold at a time for each byte of the input.
    multiple: u64,
    /// Bytes that reading may hold at a time for any input: tables, buffers, and values that a
    /// valid input builds.
    constant: u64,
    /// Number of mutations that the test tries.
    pub trials: u32,
}

/// All targets.
pub const TARGETS: [Target; 12] = [
    text::NOTATION,
    text::SETTINGS,
    text::OVERRIDES,
    text::COMMAND_LINE,
    plan::PLAN,
    calibration::CALIBRATION,
    checkpoint::CHECKPOINT,
    note::NOTE,
    tables::TABLES,
    npz::NPZ,
    mjcf::MJCF,
    mjcf::COMPILER,
];

/// Measurement of reading one input.
pub struct Reading {
    /// Largest number of bytes that this thread held at a time.
    peak: u64,
    /// `true` if the input was valid.
    pub accepted: bool,
    /// Bytes beyond the target's constant, for each byte of the input.
    pub multiple: f64,
}

impl Reading {
    /// Creates a measurement that is not yet compared with the target's limits.
    fn new(peak: u64, accepted: bool) -> Self {
        Self { peak, accepted, multiple: 0.0 }
    }
}

impl Target {
    /// Creates a target that may hold no memory yet, and that the test does not mutate.
    const fn new(
        name: &'static str,
        read: fn(&[u8]) -> Option<Reading>,
        seeds: fn() -> Vec<Vec<u8>>,
    ) -> Self {
        Self { name, read, seeds, multiple: 0, constant: 0, trials: 0 }
    }

    /// Sets the bytes that reading may hold at a time: for each byte of the input, and for any
    /// input.
    const fn holding(self, multiple: u64, constant: u64) -> Self {
        Self { multiple, constant, ..self }
    }

    /// Sets the number of mutations that the test tries.
    const fn tried(self, trials: u32) -> Self {
        Self { trials, ..self }
    }

    /// Reads one input; `None` if it is rejected before it reaches the reader.
    ///
    /// # Panics
    /// If reading panics or allocates more than it may.
    pub fn run(&self, input: &[u8]) -> Option<Reading> {
        let (mut reading, length) = ((self.read)(input)?, input.len() as u64);
        let (peak, most) = (reading.peak, self.multiple * length + self.constant);
        let name = self.name;
        assert!(
            peak <= most,
            "{name}: {peak} bytes were allocated for {length}, expected at most {most}"
        );
        let beyond = peak.saturating_sub(self.constant);
        reading.multiple = beyond as f64 / length.max(1) as f64;
        Some(reading)
    }

    /// Returns valid inputs to start from.
    pub fn seeds(&self) -> Vec<Vec<u8>> {
        (self.seeds)()
    }
}

/// Measures `read`, which returns `true` if the input was valid.
fn measured(read: impl FnOnce() -> bool) -> Option<Reading> {
    let mut accepted = false;
    let peak = measure(|| accepted = read()).bytes_max;
    Some(Reading::new(peak, accepted))
}

/// Converts texts to inputs.
fn texts<const N: usize>(texts: [&str; N]) -> Vec<Vec<u8>> {
    texts.map(|text| text.as_bytes().to_vec()).to_vec()
}

/// Returns `true` if reading succeeded. Asserts that an error has a message.
fn accepted<T, E: Display>(result: Result<T, E>) -> bool {
    if let Err(error) = &result {
        assert!(!error.to_string().is_empty());
    }
    result.is_ok()
}

/// Returns a temporary path for this process and target.
fn own_path(target: &str) -> PathBuf {
    let name = format!("covers-fuzz-{}-{target}", std::process::id());
    std::env::temp_dir().join(name)
}

/// Writes `bytes` to a temporary file for this process and target, and passes its path to `with`.
fn in_file<R>(target: &str, bytes: &[u8], with: impl FnOnce(&Path) -> R) -> R {
    let path = own_path(target);
    std::fs::write(&path, bytes).unwrap_or_else(|error| panic!("{}: {error}", path.display()));
    let result = with(&path);
    // if this fails, the next input overwrites the file
    let _ = std::fs::remove_file(&path);
    result
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Target whose reader holds as many bytes as the input says.
    const GREEDY: Target = Target::new("greedy", greedy, Vec::new).holding(10, 100);

    fn greedy(input: &[u8]) -> Option<Reading> {
        measured(|| vec![1_u8; 100 * usize::from(input[0])].len() > 100)
    }

    #[test]
    fn what_is_allocated_is_measured() {
        let reading = GREEDY.run(&[2; 20]).unwrap();
        assert!(reading.accepted && reading.multiple == 5.0);
        assert!(!GREEDY.run(&[1; 20]).unwrap().accepted);
    }

    #[test]
    #[should_panic(expected = "greedy: 1000 bytes were allocated for 2, expected at most 120")]
    fn more_than_the_stated_multiple_is_noticed() {
        GREEDY.run(&[10; 2]);
    }

    #[test]
    #[should_panic(expected = "index out of bounds")]
    fn a_panic_is_noticed() {
        GREEDY.run(&[]);
    }
}
