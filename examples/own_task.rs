//! Trains COVERS on a stream with a custom task group: pushing a block along a rail. All of its
//! code is in this file and `block_push.xml`.
//!
//! `cargo run --release --example own_task -- --budget short`

use std::io::Write;
use std::process::ExitCode;

use clap::{Parser, ValueEnum};
use covers::experiments::text::{format_run_event, run_summary_table};
use covers::presets::{Budget, Method};
use covers::schedule::TaskSchedule;
use covers::{CoversError, Experiment, Run, RunFolder, SettingOverride, apply_overrides};
use envs::reward::{hamacher_product, long_tail_reward};
use envs::{
    EpisodeStart, ExpertCommand, Placement, StepReward, Task, TaskGroup, TaskRegistry,
    TaskSceneParts, TaskState, conformance,
};
use glam::DVec3;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

/// Distance of the block from its start to the end of the rail (metres).
const TRAVEL: f64 = 0.12;
/// Remaining distances at success and at full reward (metres).
const SUCCESS: f64 = 0.02;
const DONE: f64 = 0.01;
/// Vector from the block's centre to the point where the fingertips push it (metres).
const PUSH: DVec3 = DVec3::new(0.0, -0.04, 0.0);
/// Distance to the pushing point at which the approach has full reward (metres).
const NEAR: f64 = 0.02;

struct BlockPush;

impl Task for BlockPush {
    fn name(&self) -> &str {
        "block-push"
    }

    fn parts(&self) -> TaskSceneParts<'_> {
        TaskSceneParts {
            mjcf: Some(include_str!("block_push.xml")),
            object_body: Some("block"),
            ..TaskSceneParts::default()
        }
    }

    /// Places the block right of the centre and away from the robot, so that the four variants are
    /// in four quadrants.
    fn sample_placement(&self, rng: &mut ChaCha8Rng) -> Placement {
        let (x, y) = (rng.random_range(0.08..0.2), rng.random_range(0.08..0.14));
        let object = DVec3::new(x, y, 0.07);
        Placement { object, goal: object + DVec3::new(0.0, TRAVEL, 0.0) }
    }

    fn reward(&self, start: &EpisodeStart, now: &TaskState, _: f64) -> StepReward {
        let goal_distance = (start.placement.goal.y - now.object.y).abs();
        let way = |state: &TaskState| state.tcp.distance(state.object + PUSH);
        let approach_reward = long_tail_reward(way(now), NEAR, way(&start.task_state));
        let in_place_reward = long_tail_reward(goal_distance, DONE, TRAVEL);
        let success = goal_distance <= SUCCESS;
        StepReward {
            approach_reward,
            in_place_reward,
            goal_distance,
            reward: if success {
                10.0
            } else {
                4.0 * approach_reward + 6.0 * hamacher_product(approach_reward, in_place_reward)
            },
            success,
        }
    }

    /// Moves above the near side of the block, goes down, then pushes.
    fn expert(&self, _: &Placement, now: &TaskState) -> ExpertCommand {
        let behind = now.object + PUSH + DVec3::new(0.0, -0.04, 0.0);
        let aside = (now.tcp.x - behind.x).abs() > 0.02;
        let beyond = now.tcp.y > now.object.y + PUSH.y;
        let aim = if aside || beyond {
            behind + DVec3::new(0.0, 0.0, 0.09)
        } else if now.tcp.z > behind.z + 0.03 {
            behind
        } else {
            now.object + DVec3::new(0.0, 0.1, 0.0)
        };
        ExpertCommand { hand: aim + (now.hand - now.tcp), finger: 0.0 }
    }
}

/// Trains COVERS on a stream of block-push and the paper's four groups.
#[derive(Debug, Parser)]
struct Options {
    /// Length of the run: `smoke` takes seconds and trains nothing, `short` takes minutes.
    #[arg(long, value_enum, default_value = "short")]
    budget: Length,
    /// Seed of all random numbers.
    #[arg(long, default_value_t = 0)]
    seed: u64,
    /// Set a field of the settings, such as `--set 'covers.grouping={"evidence":{}}'`.
    #[arg(long, value_name = "PATH=VALUE")]
    set: Vec<SettingOverride>,
}

#[derive(Clone, Copy, Debug, ValueEnum)]
enum Length {
    Smoke,
    Short,
}

fn main() -> ExitCode {
    match learn(&Options::parse()) {
        Ok(()) => ExitCode::SUCCESS,
        Err(error) => {
            eprintln!("error: {error}");
            ExitCode::FAILURE
        }
    }
}

fn learn(options: &Options) -> Result<(), Box<dyn std::error::Error>> {
    let group = TaskGroup::from_task(&BlockPush);
    let experiment = experiment(options.budget, group).with_seed(options.seed);
    let experiment = apply_overrides(&options.set, experiment)?;
    conformance::check_task_conformance(group)?;
    println!("{group} conforms: its expert solves it, and its variants are mirror images");
    let mut tasks = TaskRegistry::with_standard();
    tasks.register(group)?;
    let name = format!("own-task-seed{}", options.seed);
    let folder = RunFolder::create("runs".as_ref(), &name)?;
    let mut run = Run::start_with_tasks(experiment, tasks, folder)?;
    finish(&mut run)?;
    Ok(())
}

/// Returns a run with two cycles (one for `smoke`) of five groups, with longer visits of the fifth.
fn experiment(length: Length, group: TaskGroup) -> Experiment {
    let (budget, cycles, others, own) = match length {
        Length::Smoke => (Budget::Smoke, 1, 1, 1),
        Length::Short => (Budget::Short, 2, 6, 24),
    };
    let experiment = budget.preset_experiment(Method::Covers);
    let rollout = experiment.learner.rollout_steps();
    let others = TaskGroup::STANDARD.map(|other| (other, others * rollout));
    let visits = [others.as_slice(), &[(group, own * rollout)]].concat();
    Experiment { schedule: TaskSchedule::shuffled(cycles, &visits), ..experiment }
}

fn finish(run: &mut Run) -> Result<(), CoversError> {
    while let Some(event) = run.advance()? {
        // a closed output must not end the run
        let _ = writeln!(std::io::stdout(), "{}", format_run_event(&event));
    }
    if let Some(summary) = run.summary()? {
        println!("\n{}", run_summary_table(&summary));
    }
    println!("files: {}", run.folder().path().display());
    Ok(())
}
