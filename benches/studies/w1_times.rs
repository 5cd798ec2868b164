//! Answers requests for distances on standard input with their times: our side of
//! `benches/peers/ot.sh`.
//!
//! A request is a line `X N Y M DIM REPEATS`: two files of little-endian `f32` points and their
//! sizes. The answer is a line `SECONDS VALUE PEAK`: the mean time of one distance over the repeats
//! (in a workspace that is reused), its value, and the peak memory of this process in bytes (0 if
//! the system does not report it).

use std::error::Error;
use std::io::{BufRead, Write, stdin, stdout};
use std::time::Instant;

use cluster::{PointWeights, WassersteinSolver};

fn main() -> Result<(), Box<dyn Error>> {
    let mut workspace = WassersteinSolver::new();
    for line in stdin().lock().lines() {
        let line = line?;
        let words: Vec<&str> = line.split_whitespace().collect();
        let [x, n, y, m, dim, repeats] = words[..] else {
            return Err(format!("got `{line}`, expected `X N Y M DIM REPEATS`").into());
        };
        let dim: usize = dim.parse()?;
        let (n, m) = (n.parse()?, m.parse()?);
        let (x, y) = (points(x, n, dim)?, points(y, m, dim)?);
        let repeats: u32 = repeats.parse()?;
        let mut value = 0.0;
        let start = Instant::now();
        for _ in 0..repeats {
            // the larger cloud first, as the documentation recommends
            let (x, y) = ((&x[..], PointWeights::Uniform(n)), (&y[..], PointWeights::Uniform(m)));
            let plan =
                if n < m { workspace.solve(y, x, dim)? } else { workspace.solve(x, y, dim)? };
            value = plan.cost;
        }
        let seconds = start.elapsed().as_secs_f64() / f64::from(repeats);
        writeln!(stdout(), "{seconds:e} {value:e} {}", peak_bytes())?;
    }
    Ok(())
}

fn points(path: &str, count: usize, dim: usize) -> Result<Vec<f32>, Box<dyn Error>> {
    let bytes = std::fs::read(path)?;
    let (values, _) = bytes.as_chunks::<4>();
    let points: Vec<f32> = values.iter().map(|&b| f32::from_le_bytes(b)).collect();
    if points.len() == count * dim {
        Ok(points)
    } else {
        Err(format!("{path} holds {} values, expected {count} x {dim}", points.len()).into())
    }
}

/// Reads the high-water mark of resident memory from Linux.
fn peak_bytes() -> usize {
    let status = std::fs::read_to_string("/proc/self/status").unwrap_or_default();
    let line = status.lines().find(|line| line.starts_with("VmHWM:"));
    let kibibytes = line.and_then(|line| line.split_whitespace().nth(1)?.parse::<usize>().ok());
    1024 * kibibytes.unwrap_or(0)
}
