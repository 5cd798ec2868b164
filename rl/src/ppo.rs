//! Proximal policy optimisation: one update of a policy from one rollout.

#[cfg(feature = "wgpu")]
mod device;
#[cfg(feature = "wgpu")]
mod graph;
mod processor;
mod task;

use std::fmt;

use rand_chacha::ChaCha8Rng;

use crate::actor_critic_policy::ActorCriticPolicy;
use crate::adam::{Adam, SECOND_MOMENT};
use crate::algorithm::{Algorithm, AlgorithmState, check_not_negative};
use crate::buffer::RolloutBuffer;
use crate::error::{RlError, check_all_finite, check_params};
use crate::ppo::processor::Processor;
use crate::ppo::task::{Rollout, Task};
use crate::ppo_settings::PpoSettings;
use crate::ppo_stats::{Totals, UpdateStats};

/// Proximal policy optimisation (Schulman et al., arXiv 1707.06347, algorithm 1) with the optimiser
/// state of one policy.
pub struct Ppo {
    settings: PpoSettings,
    optimiser: Adam,
    engine: Engine,
    rollout: Rollout,
}

/// What computes gradients and takes steps.
enum Engine {
    Processor(Processor),
    #[cfg(feature = "wgpu")]
    Device(Box<device::Device>),
}

impl Engine {
    fn run(&mut self, task: Task) -> Result<Totals, RlError> {
        match self {
            Engine::Processor(processor) => processor.run(task),
            #[cfg(feature = "wgpu")]
            Engine::Device(device) => device.run(task),
        }
    }
}

impl Ppo {
    /// Fresh optimiser state for `policy` and its clones.
    ///
    /// # Errors
    /// [`RlError::Setting`] when a setting is out of range, [`RlError::BelowFloor`] when a standard
    /// deviation of `policy` is already below the floor.
    pub fn new(settings: PpoSettings, policy: &ActorCriticPolicy) -> Result<Self, RlError> {
        let processor = Processor::new(policy);
        Self::on(settings, policy, Engine::Processor(processor))
    }

    /// The same on a GPU: passes, losses and steps of an update run there, one command buffer for
    /// each minibatch, and results are read once. The processor draws the order of the minibatches
    /// and knows the optimiser's state after each update, so an update of either can follow one of
    /// the other.
    ///
    /// # Errors
    /// Those of [`Ppo::new`], and [`RlError::OnProcessorAlone`] for a
    /// [`SymmetryLoss`](crate::SymmetryLoss).
    #[cfg(feature = "wgpu")]
    pub fn on_device(
        settings: PpoSettings,
        policy: &ActorCriticPolicy,
        device: &equivariant::gpu::Device,
    ) -> Result<Self, RlError> {
        if settings.symmetry.is_some() {
            return Err(RlError::OnProcessorAlone);
        }
        let engine = Engine::Device(Box::new(device::Device::new(device)));
        Self::on(settings, policy, engine)
    }

    fn on(
        settings: PpoSettings,
        policy: &ActorCriticPolicy,
        engine: Engine,
    ) -> Result<Self, RlError> {
        settings.check()?;
        check_floor(policy.log_std(), settings.min_log_std)?;
        Ok(Self {
            optimiser: Adam::new(policy.network().num_params(), settings.adam_epsilon),
            settings,
            engine,
            rollout: Rollout::default(),
        })
    }

    /// The settings.
    pub fn settings(&self) -> &PpoSettings {
        &self.settings
    }
}

impl Algorithm for Ppo {
    type Policy = ActorCriticPolicy;
    type Experience = RolloutBuffer;
    type Stats = UpdateStats;

    /// Improves `policy` by several passes over the minibatches of a finished rollout; their order
    /// comes from `rng`, and before it the elements that move decisions for a
    /// [`SymmetryLoss`](crate::SymmetryLoss). The same inputs give the same bits on any number of
    /// threads.
    ///
    /// The update stops before a gradient step when the minibatch's KL divergence exceeds
    /// [`PpoSettings::kl_stop`] (Stable-Baselines3, `PPO.train`).
    ///
    /// # Errors
    /// [`RlError::BufferNotFinished`] for an unfinished rollout, and those of
    /// [`Algorithm::update`]; what may diverge are returns, the loss and the gradient.
    fn update(
        &mut self,
        policy: &mut ActorCriticPolicy,
        buffer: &RolloutBuffer,
        rng: &mut ChaCha8Rng,
    ) -> Result<UpdateStats, RlError> {
        let expected = self.optimiser.first_moment.len();
        check_params(expected, policy.params().len())?;
        policy.network().spec().check_same(buffer.spec())?;
        self.rollout.prepare(&self.settings, buffer, rng)?;
        let totals = self.engine.run(Task {
            settings: &self.settings,
            optimiser: &mut self.optimiser,
            rollout: &mut self.rollout,
            policy,
            buffer,
            rng,
        })?;
        check_all_finite("a parameter after the update", policy.params())?;
        let values = &buffer.decisions().values;
        let losses = totals.losses;
        let moved = self.rollout.moved.take();
        Ok(UpdateStats {
            symmetry_loss: moved.map(|_| losses.symmetry / losses.samples),
            ..totals.stats(values, &self.rollout.returns, policy.log_std())
        })
    }

    /// Both moments of Adam and its number of steps.
    fn save(&self) -> AlgorithmState<'_> {
        self.optimiser.save()
    }

    fn restore(&mut self, state: &AlgorithmState<'_>) -> Result<(), RlError> {
        state.check_like(&self.save())?;
        check_not_negative(state, &[SECOND_MOMENT])?;
        self.optimiser.restore(state);
        Ok(())
    }
}

/// The first step would raise what is below the floor, however small the gradient is.
fn check_floor(log_std: &[f32], min_log_std: f32) -> Result<(), RlError> {
    match log_std.iter().find(|&&log_std| log_std < min_log_std) {
        Some(&log_std) => Err(RlError::BelowFloor {
            log_std,
            min_log_std,
        }),
        None => Ok(()),
    }
}

impl fmt::Debug for Ppo {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Ppo")
            .field("settings", &self.settings)
            .field("steps", &self.optimiser.steps)
            .finish_non_exhaustive()
    }
}
