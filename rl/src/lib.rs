//! Reinforcement learning for equivariant networks, independent of tasks, simulators and tensor
//! libraries.
//!
//! An environment implements [`VectorEnv`]: slices in, slices out. [`collect_experience`] lets an
//! [`Actor`] act in it and fills an [`ExperienceBuffer`]; an [`Algorithm`] improves the actor from
//! that experience. [`evaluate_policy`] runs whole episodes with mean actions. Two algorithms are
//! implemented: [`ActorCriticPolicy`], [`RolloutBuffer`] and [`Ppo`] form proximal policy
//! optimisation (on-policy); [`SacPolicy`], [`ReplayBuffer`] and [`Sac`] form soft actor-critic
//! (off-policy).
//!
//! | a new | implements | example |
//! |---|---|---|
//! | environment | [`VectorEnv`] | below |
//! | actor | [`Actor`], [`ActorMemory`]; [`OnPolicyActor`] for rollouts | `tests/memory.rs` |
//! | algorithm | [`Algorithm`]; [`ExperienceBuffer`] for a new buffer | `src/sac.rs` |
//!
//! - The policy is exactly equivariant under D2, the group of flips of x and y, or a subgroup of
//!   choice: if the observation is flipped, the policy's mean action is flipped, and its value and
//!   features stay the same.
//! - The end of an episode has two kinds, [`StepOutcome::Terminated`] and
//!   [`StepOutcome::Truncated`], all the way to [`gae()`]: a time-out bootstraps the value of the
//!   final observation.
//! - Every random number comes from a generator that the caller passes. The same inputs give the
//!   same bits on any number of threads of the current rayon pool.
//! - All parameters of a policy are one flat slice, and all state of an algorithm is saved by name
//!   ([`Algorithm::save`]).
//! - Rewards, observations, decisions, returns, losses and gradients that are infinite or not a
//!   number are errors that name the quantity. The parameters are then those before the offending
//!   gradient step; gradient steps that the update took earlier stay.
//!
//! `docs/ppo.md` lists every detail of PPO with its value, its source and the function that
//! implements it.
//!
#![doc = include_str!("../README.md")]

mod activity;
mod adam;
mod algorithm;
mod buffer;
#[cfg(feature = "wgpu")]
mod device;
mod distributions;
mod encoder;
mod env;
mod error;
mod export;
#[cfg(test)]
mod fixtures;
mod gae;
mod network;
mod network_policy;
mod network_settings;
mod normalisation;
mod policy;
mod ppo;
mod ranks;
mod replay;
mod rollout;
mod sac;
mod symmetry_check;
mod trunk;

#[cfg(feature = "wgpu")]
pub use equivariant::gpu;

pub use activity::{MeasureUnitActivity, UnitActivity};
pub use adam::{Adam, ParamGroup, clip_global_norm};
pub use algorithm::{Algorithm, AlgorithmState, Metrics};
pub use buffer::RolloutBuffer;
#[cfg(feature = "wgpu")]
pub use device::GpuPolicy;
pub use distributions::ActionNoise;
pub use encoder::EncoderSettings;
pub use env::{EnvSpec, MAX_ABS_OBSERVATION, Observations, StepOutcome, Transition, VectorEnv};
pub use error::{BoxedEnvError, InvalidNumberLocation, RlError, SymmetryViolation};
pub use export::{
    ExportPolicy, ExportedActionDistribution, ExportedLayer, ExportedPolicy, PolicyOutput,
};
pub use gae::{GaeInputs, gae};
pub use network::{ActorCritic, ActorCriticWorkspace};
pub use network_policy::{ActorCriticPolicy, NetworkPolicy};
pub use network_settings::{CriticSettings, NetworkSettings};
pub use normalisation::{NormalisationSettings, NormalisationState, NormalisedEnv};
pub use policy::{
    Actor, ActorMemory, Decisions, EvaluateActions, FeatureExtractor, OnPolicyActor, ValueFunction,
};
pub use ppo::Ppo;
pub use ppo::settings::{LearningRateSchedule, PpoSettings};
pub use ppo::stats::PpoStats;
pub use ppo::symmetry_loss::SymmetryLossSettings;
pub use ranks::{ProcessCommunicator, ProcessRanks};
pub use replay::state::{ReplayState, StoredEpisode};
pub use replay::{ReplayBuffer, ReplaySettings, ReplayStep};
pub use rollout::{
    EpisodeStats, ExperienceBuffer, MAX_RECOMMENDED_ABS_RETURN, MIN_RECOMMENDED_ABS_RETURN,
    RewardWarning, RolloutState, RolloutStats, collect_experience, evaluate_policy,
    evaluate_policy_with_callback,
};
pub use sac::Sac;
pub use sac::network::SacNetwork;
pub use sac::policy::{SacActorMemory, SacPolicy};
pub use sac::settings::{EntropyTemperatureSettings, RecurrentContextSettings, SacSettings};
pub use sac::stats::SacStats;
pub use symmetry_check::check_env_symmetry;
