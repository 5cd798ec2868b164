//! Everything that is read, given the seeds, the corpus and random mutations of both. The folder
//! `fuzz` runs the same targets under libFuzzer.

use std::path::Path;

use rand::seq::IndexedRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::targets::{TARGETS, Target};

/// Lengths and counts that arithmetic trips over.
const EXTREMES: [u64; 6] = [0, 1, 0x7fff_ffff, 0xffff_ffff, 1 << 63, u64::MAX];
/// Bytes of the longest mutation.
const LONGEST: usize = 1 << 14;

/// The inputs of a target: its seeds, and the files of its folder in the corpus.
fn inputs(target: &Target) -> Vec<Vec<u8>> {
    let mut inputs = target.seeds();
    assert!(!inputs.is_empty(), "{}: no seeds", target.name);
    let corpus = Path::new(env!("CARGO_MANIFEST_DIR")).join("fuzz/corpus");
    let files = std::fs::read_dir(corpus.join(target.name));
    let mut files: Vec<_> = files.into_iter().flatten().map(|f| f.unwrap().path()).collect();
    files.sort();
    inputs.extend(files.iter().map(|file| std::fs::read(file).unwrap()));
    inputs
}

/// One input with a few random changes.
fn mutated(inputs: &[Vec<u8>], rng: &mut ChaCha8Rng) -> Vec<u8> {
    let mut input = inputs.choose(rng).unwrap().clone();
    for _ in 0..1 << rng.random_range(0..3) {
        let longest = 1 << rng.random_range(0..7);
        let from = rng.random_range(0..=input.len());
        let to = rng.random_range(from..=input.len().min(from + longest));
        let other = inputs.choose(rng).unwrap();
        let start = rng.random_range(0..=other.len());
        let other = &other[start..other.len().min(start + longest)];
        let extreme = *EXTREMES.choose(rng).unwrap();
        let replacement = match rng.random_range(0..6) {
            0 => Vec::new(),
            1 => vec![rng.random(); to - from],
            2 => extreme.to_le_bytes().to_vec(),
            3 => extreme.to_string().into_bytes(),
            4 => other.to_vec(),
            _ => input[from..to].repeat(2),
        };
        input.splice(from..to, replacement);
    }
    input.truncate(LONGEST);
    input
}

/// Reads all inputs of a target, and some mutations.
fn run(target: &Target) {
    let inputs = inputs(target);
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let mutations = (0..target.trials).map(|_| mutated(&inputs, &mut rng));
    let (mut accepted, mut refused) = (0, 0);
    for input in inputs.iter().cloned().chain(mutations) {
        let read = std::panic::catch_unwind(|| target.run(&input));
        let read = read.unwrap_or_else(|_| panic!("{}: {}", target.name, input.escape_ascii()));
        if read.is_some_and(|reading| reading.accepted) {
            accepted += 1;
        } else {
            refused += 1;
        }
    }
    let counts = format!("{}: {accepted} accepted, {refused} refused", target.name);
    println!("{counts}");
    assert!(accepted >= 5 && refused > 100, "{counts}");
}

macro_rules! targets {
    ($($test:ident: $name:literal,)*) => {
        $(#[test]
        fn $test() {
            run(TARGETS.iter().find(|target| target.name == $name).unwrap());
        })*

        #[test]
        fn every_target_is_run() {
            assert_eq!([$($name),*], TARGETS.map(|target| target.name));
        }
    };
}

targets! {
    notation_is_read_or_refused: "notation",
    settings_are_read_or_refused: "settings",
    overrides_are_read_or_refused: "overrides",
    command_lines_are_read_or_refused: "command-line",
    plans_are_read_or_refused: "plan",
    calibrations_are_read_or_refused: "calibration",
    checkpoints_are_read_or_refused: "checkpoint",
    notes_of_runs_are_read_or_refused: "note",
    tables_are_read_or_refused: "tables",
    recordings_are_read_or_refused: "npz",
    scenes_are_read_or_refused: "mjcf",
    scenes_are_compiled_or_refused: "compiler",
}

/// The targets that `make fuzz` runs, of a Makefile's text: those of its list, then those that it
/// names alone.
fn made(makefile: &str) -> Vec<&str> {
    let list = makefile.lines().filter_map(|line| line.strip_prefix("FUZZ_TARGETS := "));
    let alone = makefile.split("FUZZ=").skip(1);
    let alone = alone.filter_map(|rest| rest.split(' ').next());
    let named = list.flat_map(|list| list.split(' ')).chain(alone);
    named.filter(|name| !name.starts_with('$')).collect()
}

#[test]
fn make_fuzz_runs_every_target() {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("Makefile");
    let makefile = std::fs::read_to_string(path).unwrap();
    assert_eq!(made(&makefile), TARGETS.map(|target| target.name));
    let other = "FUZZ_TARGETS := a b\n\tFUZZ=$$name run $$name\n\tFUZZ=c run c\n";
    assert_eq!(made(other), ["a", "b", "c"]);
}
