//! The folder of one run: metrics as CSV, pictures as PNG. Files hold no clock time, so equal runs give equal bytes.

use std::fs::{File, create_dir, create_dir_all};
use std::io::{BufWriter, ErrorKind, Write};
use std::path::{Path, PathBuf};

use cluster::{Evidence, PermutationTest};
use serde::Serialize;

use crate::CoversError;
use crate::evaluation::Score;
use crate::progress::Progress;
use crate::sheet::Picture;

/// A folder that this run alone writes to.
#[derive(Clone, Debug)]
pub struct RunFolder {
    path: PathBuf,
}

impl RunFolder {
    /// Creates `parent/name`, or `parent/name-2`, `-3`, ... where that exists: no run overwrites another.
    ///
    /// # Errors
    /// [`CoversError::Write`].
    pub fn create(parent: &Path, name: &str) -> Result<Self, CoversError> {
        create_dir_all(parent).map_err(|error| CoversError::write(parent, error))?;
        let mut attempt = 1;
        loop {
            let suffix = if attempt == 1 {
                String::new()
            } else {
                format!("-{attempt}")
            };
            let path = parent.join(format!("{name}{suffix}"));
            match create_dir(&path) {
                Ok(()) => return Ok(Self { path }),
                Err(error) if error.kind() == ErrorKind::AlreadyExists => attempt += 1,
                Err(error) => return Err(CoversError::write(&path, error)),
            }
        }
    }

    /// Where the folder is.
    pub fn path(&self) -> &Path {
        &self.path
    }

    /// Opens `metrics.csv`, one row a rollout.
    pub(crate) fn metrics(&self) -> Result<Metrics, CoversError> {
        let path = self.path.join("metrics.csv");
        let writer = csv::Writer::from_path(&path).map_err(|e| CoversError::write(&path, e))?;
        Ok(Metrics { path, writer })
    }

    /// Writes `evaluation.csv`, one row a group.
    pub(crate) fn write_scores(&self, scores: &[Score]) -> Result<(), CoversError> {
        let path = self.path.join("evaluation.csv");
        let failed = |error| CoversError::write(&path, error);
        let mut writer = csv::Writer::from_path(&path).map_err(failed)?;
        for score in scores {
            writer.serialize(score).map_err(failed)?;
        }
        writer.flush().map_err(|e| CoversError::write(&path, e))
    }

    /// Writes a picture.
    pub(crate) fn write_png(&self, name: &str, picture: &Picture) -> Result<(), CoversError> {
        let path = self.path.join(name);
        encode_png(&path, picture).map_err(|error| CoversError::write(&path, error))
    }
}

fn encode_png(path: &Path, picture: &Picture) -> Result<(), png::EncodingError> {
    let mut file = BufWriter::new(File::create(path)?);
    let (width, height) = (picture.width as u32, picture.height as u32);
    let mut encoder = png::Encoder::new(&mut file, width, height);
    encoder.set_color(png::ColorType::Rgb);
    encoder.set_depth(png::BitDepth::Eight);
    let mut writer = encoder.write_header()?;
    writer.write_image_data(&picture.rgb)?;
    writer.finish()?;
    Ok(file.flush()?)
}

/// The open `metrics.csv`; every row reaches the disk before the next rollout.
pub(crate) struct Metrics {
    path: PathBuf,
    writer: csv::Writer<File>,
}

#[derive(Serialize)]
struct Row<'a> {
    rollout: usize,
    decisions: usize,
    group: &'a str,
    policy: usize,
    created: bool,
    /// Rollouts that the assignment looked at: 2 where the first left it undecided.
    looks: u8,
    /// W1 to each policy that existed before, and what the permutation test made of it; joined by semicolons.
    distances: String,
    null_means: String,
    null_maxima: String,
    scores: String,
    p_values: String,
    tail_p_values: String,
    reward: Option<f64>,
    success: Option<f64>,
    success_at_end: Option<f64>,
    policy_loss: f64,
    value_loss: f64,
    entropy: f64,
    approx_kl: f64,
    clip_fraction: f64,
    explained_variance: f64,
    grad_norm: f64,
    epochs: usize,
}

impl Metrics {
    pub(crate) fn write(&mut self, progress: &Progress) -> Result<(), CoversError> {
        let row = Row::new(progress);
        let path = &self.path;
        self.writer
            .serialize(row)
            .map_err(|error| CoversError::write(path, error))?;
        self.writer
            .flush()
            .map_err(|error| CoversError::write(path, error))
    }
}

impl<'a> Row<'a> {
    fn new(progress: &'a Progress) -> Self {
        let (report, update) = (&progress.report, &progress.report.update);
        let tests = |figure: fn(&PermutationTest) -> f64| {
            let tests = report.evidence.iter().map(Evidence::test);
            join(tests.map(|test| test.map(figure)))
        };
        Self {
            rollout: progress.rollout,
            decisions: progress.decisions,
            group: progress.group.name(),
            policy: report.policy,
            created: report.created,
            looks: 1 + u8::from(report.first_look.is_some()),
            distances: join(report.evidence.iter().map(|e| Some(e.distance))),
            null_means: tests(|test| test.null.mean),
            null_maxima: tests(|test| test.null.max),
            scores: tests(|test| test.score),
            p_values: tests(|test| test.p_value),
            tail_p_values: tests(|test| test.tail_p_value),
            reward: progress.reward,
            success: progress.success,
            success_at_end: report.rollout.success_at_end_rate(),
            policy_loss: update.policy_loss,
            value_loss: update.value_loss,
            entropy: update.entropy,
            approx_kl: update.approx_kl,
            clip_fraction: update.clip_fraction,
            explained_variance: update.explained_variance,
            grad_norm: update.grad_norm,
            epochs: update.epochs,
        }
    }
}

fn join(values: impl Iterator<Item = Option<f64>>) -> String {
    let texts: Vec<String> = values
        .map(|value| value.map_or_else(String::new, |value| value.to_string()))
        .collect();
    texts.join(";")
}
