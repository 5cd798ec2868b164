//! `covers export`: files of a policy for other programs.

use std::fs::create_dir_all;
use std::io::Write;
use std::path::PathBuf;

use clap::Args;
use envs::{ACTION_DIM, TaskGroup, TaskRegistry, VecEnvSettings};
use experiments::cli::print_escaped;
use experiments::{Experiment, RunError, RunFolder, Stream};
use learner::Labels;
use learner::disk::{LocalDisk, write_atomically};
use rl::{Observations, Transition, VectorEnv};
use symmetry::D2;

use super::description::policy_description;
use super::onnx::onnx_model;
use super::weights::{reference_outputs, safetensors_weights};

/// Options of `covers export`.
#[derive(Clone, Debug, Args)]
#[command(after_help = "Example: covers export runs/covers-seed0 --policy 2 --out drawer\n\
    `covers eval` and `covers render` print the policy of each group.")]
pub struct ExportOptions {
    /// Folder of a run, or a folder that `covers pack` created.
    #[arg(value_name = "RUN")]
    pub run_folder: PathBuf,
    /// Index of the policy, from 0.
    #[arg(long)]
    pub policy: usize,
    /// Folder to create, for `policy.onnx`, `policy.safetensors`, `policy.json`, and
    /// `golden.safetensors` with some observations and the policy's outputs for them.
    #[arg(long)]
    pub out: PathBuf,
}

impl ExportOptions {
    /// Writes the files, and prints their names and sizes to `out`.
    ///
    /// # Errors
    /// A run without policies, or an output folder that exists; a policy that does not exist, or
    /// whose network has parts that cannot be written as ordinary layers.
    pub fn run(&self, out: &mut impl Write) -> Result<(), RunError> {
        if self.out.exists() {
            let path = self.out.clone();
            return Err(RunError::FileExists { path });
        }
        let folder = RunFolder::from_path(&self.run_folder);
        let run = folder.read_experiment()?;
        let spec = Stream::env_spec(&run.envs);
        let mut learner = folder.load_learner(&run.learner, &spec, &Labels::default())?;
        let observations = observations(&run)?;
        let (policy, answers) = learner.export_policy(self.policy, &observations)?;
        let about = policy_description(&policy, self.policy, &run);
        let path = |name: &str| self.out.join(name);
        let weights = safetensors_weights(&policy, &path("policy.safetensors"))?;
        let golden =
            reference_outputs(&policy, &observations, &answers, &path("golden.safetensors"))?;
        create_dir_all(&self.out).map_err(RunError::writing(&self.out))?;
        let files = [
            ("policy.onnx", onnx_model(&policy, &about.to_string())),
            ("policy.safetensors", weights),
            ("policy.json", format!("{about:#}\n").into_bytes()),
            ("golden.safetensors", golden),
        ];
        for (name, bytes) in &files {
            write_atomically(&LocalDisk, &path(name), bytes)?;
        }
        // printed after all files are written, so that a closed pipe cannot prevent any
        for (name, bytes) in &files {
            print_escaped(out, &format!("{}: {} bytes", path(name).display(), bytes.len()))?;
        }
        Ok(())
    }
}

/// Number of environments of each task group whose observations are exported.
const ENVS: usize = 2;
/// Number of decisions before an observation is exported, so that its image differs from the
/// episode's first.
const DECISIONS: usize = 8;

/// Returns [`ENVS`] observations of each group of a run, [`DECISIONS`] decisions after the reset.
///
/// # Errors
/// Errors of the environments.
fn observations(run: &Experiment) -> Result<Observations, RunError> {
    let groups = run.schedule.resolve_groups(&TaskRegistry::all())?;
    let settings =
        VecEnvSettings { num_envs: ENVS, threads: 1, ..run.envs.without_randomisation() };
    let mut stream = Stream::new(settings, &groups)?;
    let mut all = Observations { images: Vec::new(), vectors: Vec::new() };
    for group in groups {
        let seen = after_a_while(&mut stream, group)?;
        all.images.extend(seen.images);
        all.vectors.extend(seen.vectors);
    }
    Ok(all)
}

fn after_a_while(stream: &mut Stream, group: TaskGroup) -> Result<Observations, RunError> {
    let environment = |source| RunError::from(rl::RlError::Environment(source));
    stream.switch_to(group, &D2::ALL)?;
    let mut transition = Transition::new(stream.spec());
    stream.reset(&mut transition.observations).map_err(environment)?;
    // arbitrary actions in [-1, 1] that need no random generator
    let action = |index: usize| (index as f32).sin();
    let actions: Vec<f32> = (1..=ENVS * ACTION_DIM).map(action).collect();
    for _ in 0..DECISIONS {
        stream.step(&actions, &mut transition).map_err(environment)?;
    }
    Ok(transition.observations)
}
