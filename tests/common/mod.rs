//! What several files of tests share.

use clap::Parser;
use covers::CoversError;
use covers::program::CoversCli;

pub mod faulty;
pub mod packed;
pub mod runs;
pub mod scratch;

/// Runs `covers` with these arguments; returns what it printed.
pub fn covers(arguments: &[&str]) -> Result<String, CoversError> {
    let mut out = Vec::new();
    let program = CoversCli::try_parse_from([&["covers"], arguments].concat()).unwrap();
    assert_eq!(program.run(&mut out)?, 0);
    Ok(String::from_utf8(out).unwrap())
}
