//! `covers check`: checks that variants are solvable, are mirror images and behave like
//! Meta-World's tasks, and that a robot's mask hides its arm.
//!
//! Each check prints a table of measurements and compares them with bounds.

mod npz;
mod parity;
mod recording;

use std::io::Write;
use std::path::PathBuf;
use std::sync::Arc;

use clap::Subcommand;
use envs::conformance::{
    ExpertResult, SymmetryDeviation, VariantName, measure_expert, measure_symmetry,
};
use envs::{Camera, Embodiment, EnvError, Layout, Scene, TaskGroup, TaskRegistry};
use rayon::iter::{IntoParallelRefIterator, ParallelIterator};
use report::ReportTable;
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
                Ok(print(&rows, json, out, parity_table, MetaWorldComparison::passes)?)
            }
            Self::Experts { embodiment, ref tasks, seeds, json } => {
                let embodiments = embodiment.map_or(Embodiment::STANDARD.to_vec(), |one| vec![one]);
                let rows = measure_experts(&embodiments, &groups(tasks)?, seeds)?;
                Ok(print(&rows, json, out, expert_table, ExpertResult::passes)?)
            }
            Self::Symmetry { embodiment, ref tasks, seeds, json } => {
                let rows = measure_symmetries(embodiment, &groups(tasks)?, seeds)?;
                Ok(print(&rows, json, out, symmetry_table, SymmetryDeviation::passes)?)
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

/// Returns the table of experts' successes, with the seeds of episodes that failed.
fn expert_table(rows: &[ExpertResult]) -> ReportTable {
    let header =
        ["layout", "embodiment", "task", "variant", "success", "return", "seeds that failed"];
    let mut table = ReportTable::new("", &header);
    for row in rows {
        let VariantName { layout, embodiment, task, ref element } = row.variant;
        let seeds: Vec<String> = row.failed_seeds.iter().map(u64::to_string).collect();
        let success = format!("{} of {}", row.successes, row.episodes);
        let names = [layout, embodiment, task, element].map(str::to_owned);
        let figures = [success, format!("{:.1}", row.mean_return), seeds.join(", ")];
        table.rows.push(names.into_iter().chain(figures).collect());
    }
    table
}

/// Returns the table of differences between variants and their mirrored twins: largest distances
/// of positions without and with contact (metres), rewards, pictures, pixels of a picture, returns.
fn symmetry_table(rows: &[SymmetryDeviation]) -> ReportTable {
    let header =
        ["task", "variant", "free m", "contact m", "reward", "pictures", "pixels", "return ratio"];
    let mut table = ReportTable::new("", &header);
    table.rows.extend(rows.iter().map(|row| {
        vec![
            row.variant.task.to_string(),
            row.variant.element.to_string(),
            format!("{:.1e}", row.free_deviation),
            format!("{:.1e}", row.contact_deviation),
            format!("{:.1e}", row.reward_deviation),
            format!("{}/{}", row.frames_differing, row.frames),
            row.pixels_differing.to_string(),
            format!("{:.4}", row.return_ratio),
        ]
    }));
    table
}

/// Returns the table of differences from recordings: rewards, number of differing successes,
/// positions after single steps and along whole replays (metres).
fn parity_table(rows: &[MetaWorldComparison]) -> ReportTable {
    let header = ["recording", "reward", "successes", "median step", "largest step", "replay m"];
    let mut table = ReportTable::new("", &header);
    table.rows.extend(rows.iter().map(|row| {
        vec![
            row.file.trim_end_matches(".npz").to_owned(),
            format!("{:.1e}", row.max_reward_deviation),
            row.success_mismatches.to_string(),
            format!("{:.1e}", row.median_qpos_deviation),
            format!("{:.1e}", row.max_qpos_deviation),
            format!("{:.1e}", row.max_replay_deviation_m),
        ]
    }));
    table
}

/// Prints the rows of a check as a table or as one JSON array. Returns `true` if all rows pass.
fn print<R: Serialize>(
    rows: &[R],
    json: bool,
    out: &mut impl Write,
    table: fn(&[R]) -> ReportTable,
    passes: fn(&R) -> bool,
) -> Result<bool, RunError> {
    let text = if json { serde_json::json!(rows).to_string() } else { table(rows).text() };
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
