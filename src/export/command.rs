//! `covers export`: files of a policy for other programs.

use std::fs::create_dir_all;
use std::io::Write;
use std::path::PathBuf;

use clap::Args;
use envs::{ACTION_DIM, TaskGroup, TaskRegistry, VecEnvSettings};
use experiments::cli::print_escaped;
use experiments::evaluation::policy_of_group;
use experiments::{Experiment, RunError, RunFolder, SwitchableVecEnv};
use learner::disk::{LocalDisk, write_atomically};
use learner::{RecognisedPolicy, TaskLabel};
use rl::{Observations, Transition, VectorEnv};
use symmetry::D2;

use super::description::{policy_description, tensor_lines};
use super::onnx::onnx_model;
use super::weights::{reference_outputs, safetensors_weights};

/// Options of `covers export`.
#[derive(Clone, Debug, Args)]
#[command(after_help = "Examples:\n  \
    covers export runs/covers-sac-seed0 --policy drawer-close --out drawer\n  \
    covers export runs/covers-sac-seed0 --policy 2 --out drawer")]
pub struct ExportOptions {
    /// Folder of a run, or a folder that `covers pack` created.
    #[arg(value_name = "RUN")]
    pub run_folder: PathBuf,
    /// Name of a group, for the policy that serves it, or the index of a policy, from 0.
    #[arg(long, value_name = "GROUP|N")]
    pub policy: String,
    /// Folder to create, for `policy.onnx`, `policy.safetensors`, `policy.json`, and
    /// `golden.safetensors` with some observations and the policy's outputs for them.
    #[arg(long)]
    pub out: PathBuf,
}

impl ExportOptions {
    /// Writes the files of the exported policy, and prints their names and sizes to `out`.
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
        let spec = SwitchableVecEnv::env_spec(&run.envs);
        let labels = TaskLabel::default();
        let (mut learner, own) =
            folder.load_learner_with_own_policies(&run.learner, &spec, &labels)?;
        let RecognisedPolicy { policy: index, fits } = match self.policy.parse() {
            Ok(index) => RecognisedPolicy { policy: index, fits: true },
            Err(_) => policy_of_group(&self.policy, &run, &mut *learner, &own, labels)?,
        };
        let observations = observations(&run)?;
        let policy = learner.export_policy(index)?;
        let answers = learner.policy_output(index, &observations)?;
        let about = policy_description(&policy, index, &run);
        let path = |name: &str| self.out.join(name);
        let weights = safetensors_weights(&policy, &path("policy.safetensors"))?;
        let golden =
            reference_outputs(&policy, &observations, &answers, &path("golden.safetensors"))?;
        create_dir_all(&self.out).map_err(RunError::write_error_mapper(&self.out))?;
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
        let doubt = if fits { "" } else { ", the nearest: images of the group fit none well" };
        let last = learner.policy_count() - 1;
        print_escaped(out, &format!("policy {index} of policies 0 to {last}{doubt}"))?;
        tensor_lines(&about).iter().try_for_each(|line| print_escaped(out, line))?;
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
    let groups = run.schedule.resolve_groups(&TaskRegistry::with_all())?;
    let settings = VecEnvSettings { num_envs: ENVS, threads: 1, ..run.envs.for_evaluation() };
    let mut stream = SwitchableVecEnv::new(settings, &groups)?;
    let mut all = Observations { images: Vec::new(), vectors: Vec::new() };
    for group in groups {
        let seen = after_a_while(&mut stream, group)?;
        all.images.extend(seen.images);
        all.vectors.extend(seen.vectors);
    }
    Ok(all)
}

fn after_a_while(
    stream: &mut SwitchableVecEnv,
    group: TaskGroup,
) -> Result<Observations, RunError> {
    let environment = |source| RunError::from(rl::RlError::Environment(source));
    stream.switch_task_group(group, &D2::ALL)?;
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
