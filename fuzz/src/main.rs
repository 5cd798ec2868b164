//! One libFuzzer program for all targets; the variable `FUZZ` names the one to run.

#![no_main]

use std::fs::{create_dir_all, write};
use std::path::Path;
use std::sync::LazyLock;
use std::sync::atomic::{AtomicU64, Ordering};

use libfuzzer_sys::fuzz_target;

#[expect(dead_code, reason = "the test alone counts verdicts and mutations")]
mod targets;

static TARGET: LazyLock<&targets::Target> = LazyLock::new(|| {
    let name = std::env::var("FUZZ").unwrap_or_default();
    let target = targets::TARGETS.iter().find(|target| target.name == name);
    target.unwrap_or_else(|| {
        let names = targets::TARGETS.map(|known| known.name);
        panic!("FUZZ is `{name}`, expected one of {names:?}")
    })
});

fuzz_target!(
    init: {
        if let Err(error) = write_seeds() {
            panic!("the folders `found` and `corpus`: {error}");
        }
    },
    |input: &[u8]| {
        if let Some(reading) = TARGET.run(input) {
            tell_worst(reading.multiple);
        }
    }
);

/// Prints the multiple of an input's length that was allocated, if it is the largest so far.
fn tell_worst(multiple: f64) {
    static WORST: AtomicU64 = AtomicU64::new(0);
    let hundredths = (100.0 * multiple).ceil() as u64;
    if hundredths > WORST.fetch_max(hundredths, Ordering::Relaxed) {
        eprintln!("allocated {multiple:.2} bytes a byte, beyond the constant");
    }
}

/// Writes the target's seeds to the folder `found/NAME`, where libFuzzer finds them.
fn write_seeds() -> std::io::Result<()> {
    let folder = Path::new("found").join(TARGET.name);
    create_dir_all(&folder)?;
    create_dir_all(Path::new("corpus").join(TARGET.name))?;
    let mut seeds = TARGET.seeds().into_iter().enumerate();
    seeds.try_for_each(|(number, seed)| write(folder.join(number.to_string()), seed))
}
