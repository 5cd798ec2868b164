//! `covers export`: a policy for other programs.

use std::fs::create_dir_all;
use std::io::Write;
use std::path::PathBuf;

use clap::Args;

use experiments::cli::say;
use experiments::{RunError, RunFolder, Stream};
use learner::Labels;
use learner::disk::{LocalDisk, replace};

use super::description::description;
use super::examples::observations;
use super::onnx::model;
use super::weights::{golden, weights};

/// What to export.
#[derive(Clone, Debug, Args)]
#[command(after_help = "Example: covers export runs/covers-seed0 --policy 2 --out drawer\n\
    `covers eval` and `covers render` say which policy a group has.")]
pub struct ExportOptions {
    /// The folder of a run, or one that `covers pack` made.
    pub run: PathBuf,
    /// The policy's number, from 0.
    #[arg(long)]
    pub policy: usize,
    /// The folder to create: `policy.onnx`, `policy.safetensors`, `policy.json`, and
    /// `golden.safetensors` with some observations and what the policy says of them.
    #[arg(long)]
    pub out: PathBuf,
}

impl ExportOptions {
    /// Writes the files and prints to `out`.
    ///
    /// # Errors
    /// A folder without policies, or one that exists; a policy that does not exist, or whose
    /// network has parts that are no ordinary layers.
    pub fn run(&self, out: &mut impl Write) -> Result<(), RunError> {
        if self.out.exists() {
            let path = self.out.clone();
            return Err(RunError::FileExists { path });
        }
        let folder = RunFolder::open(&self.run);
        let run = folder.experiment()?;
        let spec = Stream::spec_of(&run.envs);
        let mut learner = folder.load_learner(&run.learner, &spec, &Labels::default())?;
        let observations = observations(&run)?;
        let (policy, answers) = learner.export(self.policy, &observations)?;
        let about = description(&policy, self.policy, &run);
        let path = |name: &str| self.out.join(name);
        let weights = weights(&policy, &path("policy.safetensors"))?;
        let golden = golden(&policy, &observations, &answers, &path("golden.safetensors"))?;
        create_dir_all(&self.out).map_err(|error| RunError::write(&self.out, error))?;
        let files = [
            ("policy.onnx", model(&policy, &about.to_string())),
            ("policy.safetensors", weights),
            ("policy.json", format!("{about:#}\n").into_bytes()),
            ("golden.safetensors", golden),
        ];
        for (name, bytes) in &files {
            replace(&LocalDisk, &path(name), bytes)?;
        }
        // once all are there, so that a closed pipe loses none
        for (name, bytes) in &files {
            say(out, &format!("{}: {} bytes", path(name).display(), bytes.len()))?;
        }
        Ok(())
    }
}
