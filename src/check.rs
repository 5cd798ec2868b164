//! `covers check`: checks that variants are solvable, are mirror images and behave like
//! Meta-World's tasks, and that a robot's mask hides its arm.
//!
//! Each check prints rows of measurements and compares them with bounds.

mod npz;
mod parity;
mod recording;

use std::io::Write;
use std::path::PathBuf;
use std::sync::Arc;

use clap::Subcommand;
use envs::conformance::{ExpertResult, SymmetryDeviation, measure_expert, measure_symmetry};
use envs::{Camera, Embodiment, EnvError, Layout, Scene, TaskGroup, TaskRegistry};
use rayon::iter::{IntoParallelRefIterator, ParallelIterator};
use serde::Serialize;
use symmetry::D2;

use crate::CoversError;
use deploy::CheckMaskOptions;
use experiments::RunError;
use experiments::cli::progress_bar;

pub use parity::{MetaWorldComparison, compare_meta_world_recordings};

/// Subcommands of `covers check`.
#[derive(Clone, Debug, Subcommand)]
pub enum CheckCommand {
    /// Checks that scripted experts solve all variants of the layouts that an embodiment has.
    #[command(after_help = "Examples:\n  covers check experts --embodiment hand --seeds 10\n  \
                            covers check experts --robot arm.urdf --tasks standard")]
    Experts {
        /// Embodiment: `sawyer`, `hand`, `kinova_gen3`, or an arm of yours as ARM.urdf (default:
        /// the first two).
        #[arg(long, visible_alias = "robot")]
        embodiment: Option<Embodiment>,
        /// Task group, or a set of groups: `standard`, `ten`, `mt10` or `all`.
        #[arg(long, default_value = "all")]
        tasks: String,
        /// Number of episodes of each variant.
        #[arg(long, default_value_t = 100)]
        seeds: u64,
        /// Print one JSON array instead of a table.
        #[arg(long)]
        json: bool,
    },
    /// Checks that the mask of a robot hides its arm where the camera shows it.
    Mask(CheckMaskOptions),
    /// Compares recordings of Meta-World with this simulation: rewards, single steps, replay.
    #[command(after_help = "Example: covers check parity tests/recordings")]
    Parity {
        /// Folder of recordings named ENGINE_TASK_POLICY.npz.
        folder: PathBuf,
        /// Print one JSON array instead of a table.
        #[arg(long)]
        json: bool,
    },
    /// Compares variants with their unflipped counterparts, open loop and closed loop.
    #[command(after_help = "Example: covers check symmetry --embodiment hand")]
    Symmetry {
        /// Embodiment: `sawyer`, `hand`, `kinova_gen3`, or an arm of yours as ARM.urdf.
        #[arg(long, visible_alias = "robot")]
        embodiment: Embodiment,
        /// Task group, or a set of groups: `standard`, `ten`, `mt10` or `all`.
        #[arg(long, default_value = "all")]
        tasks: String,
        /// Number of placements of each variant.
        #[arg(long, default_value_t = 10)]
        seeds: u64,
        /// Print one JSON array instead of a table.
        #[arg(long)]
        json: bool,
    },
}

impl CheckCommand {
    /// Runs the check, prints its rows to `out`, and returns `true` if all values are within their
    /// bounds.
    ///
    /// # Errors
    /// Errors of the environments, or an `out` that cannot be written to.
    pub fn run(&self, out: &mut impl Write) -> Result<bool, CoversError> {
        match *self {
            Self::Mask(ref options) => Ok(options.run(out)?),
            Self::Parity { ref folder, json } => {
                let rows = compare_meta_world_recordings(folder)?;
                Ok(print(&rows, json, out, parity_line, MetaWorldComparison::passes)?)
            }
            Self::Experts { embodiment, ref tasks, seeds, json } => {
                let embodiments = embodiment.map_or(Embodiment::STANDARD.to_vec(), |one| vec![one]);
                let rows = measure_experts(&embodiments, &groups(tasks)?, seeds)?;
                Ok(print(&rows, json, out, expert_line, ExpertResult::passes)?)
            }
            Self::Symmetry { embodiment, ref tasks, seeds, json } => {
                let rows = measure_symmetries(embodiment, &groups(tasks)?, seeds)?;
                Ok(print(&rows, json, out, symmetry_line, SymmetryDeviation::passes)?)
            }
        }
    }
}

/// Returns the groups of a set, or the one group of that name.
fn groups(tasks: &str) -> Result<Vec<TaskGroup>, RunError> {
    Ok(TaskRegistry::with_all().find_set(tasks)?)
}

fn measure_experts(
    embodiments: &[Embodiment],
    groups: &[TaskGroup],
    seeds: u64,
) -> Result<Vec<ExpertResult>, RunError> {
    let mut layouts = Vec::new();
    for &embodiment in embodiments {
        layouts.push((Layout::Symmetric, embodiment));
        // an arm of another reach may not do what is within that of Meta-World's
        if embodiment.spec().meta_world_mjcf().is_some() {
            layouts.push((Layout::MetaWorld, embodiment));
        }
    }
    Ok(of_variants(
        &scenes(&layouts, groups)?,
        |_| true,
        |scene, element| measure_expert(scene, element, scene.layout.control_settings(), seeds),
    )?)
}

fn measure_symmetries(
    embodiment: Embodiment,
    groups: &[TaskGroup],
    seeds: u64,
) -> Result<Vec<SymmetryDeviation>, RunError> {
    let scenes = scenes(&[(Layout::Symmetric, embodiment)], groups)?;
    let is_flipped = |element| element != D2::Identity;
    Ok(of_variants(&scenes, is_flipped, |scene, element| measure_symmetry(scene, element, seeds))?)
}

fn scenes(
    layouts: &[(Layout, Embodiment)],
    groups: &[TaskGroup],
) -> Result<Vec<Arc<Scene>>, EnvError> {
    let of_layout = |&(layout, embodiment)| groups.iter().map(move |&g| (layout, embodiment, g));
    let all: Vec<_> = layouts.iter().flat_map(of_layout).collect();
    let scenes = all.par_iter().map(|&(layout, embodiment, group)| {
        Ok(Arc::new(Scene::new_in_layout(layout, group, embodiment, Camera::default())?))
    });
    scenes.collect()
}

/// Applies `check` to the variants of the scenes whose elements of D2 are `chosen`, on all CPUs,
/// and returns the results in the order of scenes and elements.
fn of_variants<R: Send>(
    scenes: &[Arc<Scene>],
    chosen: fn(D2) -> bool,
    check: impl Fn(&Arc<Scene>, D2) -> Result<R, EnvError> + Sync,
) -> Result<Vec<R>, EnvError> {
    let mut jobs = Vec::new();
    for scene in scenes {
        let elements = scene.layout.group_elements().iter().filter(|element| chosen(**element));
        jobs.extend(elements.map(|&element| (scene, element)));
    }
    let bar = progress_bar(jobs.len());
    let job = jobs.par_iter().map(|(scene, element)| check(scene, *element));
    job.inspect(|_| bar.inc(1)).collect()
}

fn expert_line(row: &ExpertResult) -> String {
    let failed = if row.failed_seeds.is_empty() {
        String::new()
    } else {
        format!("  failed with the seeds {:?}", row.failed_seeds)
    };
    format!(
        "{} success {:>4} of {:<4} return {:>6.1}{failed}",
        row.variant, row.successes, row.episodes, row.mean_return
    )
}

fn symmetry_line(row: &SymmetryDeviation) -> String {
    format!(
        "{} free {:>8.1e} m  contact {:>8.1e} m  reward {:>8.1e}  \
         pictures {:>4} of {:<4} differ, by {:>3} pixels  return {:.4} of the twin's",
        row.variant,
        row.free_deviation,
        row.contact_deviation,
        row.reward_deviation,
        row.frames_differing,
        row.frames,
        row.pixels_differing,
        row.return_ratio
    )
}

fn parity_line(row: &MetaWorldComparison) -> String {
    format!(
        "{:<34} rewards {:>8.1e}, {} successes differ ({} steps)  \
         single steps median {:>8.1e}, p99 {:>8.1e}, max {:>8.1e} ({})  replay {:>8.1e} m ({})",
        row.file,
        row.max_reward_deviation,
        row.success_mismatches,
        row.reward_steps,
        row.median_qpos_deviation,
        row.p99_qpos_deviation,
        row.max_qpos_deviation,
        row.physics_steps,
        row.max_replay_deviation_m,
        row.replay_steps
    )
}

/// Prints a line for each row of a check, or one JSON array. Returns `true` if all rows pass.
fn print<R: Serialize>(
    rows: &[R],
    json: bool,
    out: &mut impl Write,
    line: fn(&R) -> String,
    passes: fn(&R) -> bool,
) -> Result<bool, RunError> {
    let text = if json {
        serde_json::json!(rows).to_string()
    } else {
        rows.iter().map(line).collect::<Vec<_>>().join("\n")
    };
    writeln!(out, "{text}").map_err(RunError::write_error_mapper("standard output".as_ref()))?;
    Ok(rows.iter().all(passes))
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn json_holds_every_row() {
        for (embodiment, tasks, expected) in
            [(Embodiment::FLOATING_HAND, "standard", 16), (Embodiment::SAWYER, "goal-reach", 5)]
        {
            let tasks = tasks.to_owned();
            let check =
                CheckCommand::Experts { embodiment: Some(embodiment), tasks, seeds: 1, json: true };
            let mut out = Vec::new();
            assert!(check.run(&mut out).unwrap());
            let rows: serde_json::Value = serde_json::from_slice(&out).unwrap();
            assert_eq!(rows.as_array().unwrap().len(), expected);
            assert_eq!(rows[0]["layout"], "symmetric");
            assert_eq!(rows[0]["embodiment"], embodiment.name());
            assert_eq!(rows[expected - 1]["successes"], 1);
        }
    }
}
