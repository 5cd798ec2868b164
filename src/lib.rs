//! Continual vision-based reinforcement learning with group symmetries: COVERS (Liu et al., CoRL
//! 2023) in Rust.
//!
//! A learner observes a table through a top-down camera while tasks arrive in an unlabelled stream.
//! It trains one D2-equivariant policy for each group of symmetric tasks, detects a task switch by
//! the 1-Wasserstein distance of invariant features, recalls old policies, and solves symmetric
//! variants that it never trained on.
//!
//! - [`Learner`]: algorithm that a run trains. [`CoversLearner`] is Algorithm 1 of the paper;
//!   [`OffPolicyLearner`] does the same with replay buffers; CLEAR and 3RL are settings of it. Both
//!   train on any [`rl::VectorEnv`].
//! - [`Grouping`]: rule that assigns rollouts to policies.
//! - [`SwitchableVecEnv`]: task groups on MuJoCo as a [`rl::VectorEnv`].
//! - [`Run`]: a whole run with its files, as `examples/continual_stream.rs` shows. It can be
//!   stopped at any rollout and resumed later.

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;

#[cfg(doctest)]
#[doc = include_str!("../docs/embedding.md")]
#[doc = include_str!("../docs/layers.md")]
#[doc = include_str!("../docs/tasks.md")]
struct Book;

pub mod check;
pub mod cli;
pub mod commands;
mod completions;
pub mod doctor;
mod error;
pub mod export;
pub mod list;
mod manual;
pub mod model;
pub mod preset_list;
pub mod program;
mod ranks;
pub mod robot;
pub mod setting_list;
pub mod sweep;
pub mod sweep_command;

pub use error::CoversError;
pub use experiments::{
    CheckpointPlan, EvaluationPlan, EvaluationReport, Experiment, LatestFrame, Provenance,
    RolloutReport, Run, RunData, RunError, RunEvent, RunFolder, RunStats, RunSummary, StopSignal,
    SwitchableVecEnv, evaluation, presets, schedule,
};
pub use learner::disk::{Disk, LocalDisk};
pub use learner::overrides::{SettingOverride, apply_overrides};
pub use learner::{
    AssignmentData, AssignmentPurpose, CheckpointExtent, CommonSettings, CoversLearner,
    CoversSettings, DeviceChoice, EpisodeRequirements, EvidenceGrouping, Grouping,
    GroupingDecision, GroupingSettings, GroupingUpdateInput, GroupingUpdateResult, IterationReport,
    IterationSeconds, Learner, LearnerError, LearnerSettings, LearningDevice, MetricValue, Metrics,
    NewPolicyInit, OffPolicyLearner, OffPolicySettings, PolicyCollection, PolicyCollectionSettings,
    PolicyEvaluationResult, PreviousParameters, ReassignedRolloutHandling, RecognisedPolicy,
    RequiredTrial, RolloutEpisodes, SinglePolicyGrouping, TaskLabel, ThresholdGrouping,
};
pub use {deploy, experiments, render, report, watch};
