//! Proximal policy optimisation: one update of a policy from one rollout.

use std::fmt;

use equivariant::Chunks;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::actor_critic_policy::ActorCriticPolicy;
use crate::adam::{Adam, ParamGroup, SECOND_MOMENT, clip_global_norm};
use crate::algorithm::{Algorithm, AlgorithmState, check_not_negative};
use crate::buffer::RolloutBuffer;
use crate::error::{RlError, check_all_finite, check_finite, check_params};
use crate::loss::{LossSums, LossWeights};
use crate::minibatch::{Minibatch, normalised_advantages};
use crate::pass::Workspace;
use crate::ppo_settings::PpoSettings;
use crate::ppo_stats::{Totals, UpdateStats};

/// Samples of one training chunk: 8 chunks a minibatch keep the cores busy; smaller ones cost a
/// quarter more time.
const TRAINING_CHUNK: usize = 8;

/// Proximal policy optimisation (Schulman et al., arXiv 1707.06347, algorithm 1) with the optimiser
/// state of one policy.
pub struct Ppo {
    settings: PpoSettings,
    optimiser: Adam,
    chunks: Chunks<f32, Workspace<f32>>,
    gradient: Vec<f32>,
    rollout: Rollout,
}

/// What an update derives from its rollout, `[T, N]` each; kept for its memory.
#[derive(Default)]
struct Rollout {
    advantages: Vec<f32>,
    returns: Vec<f32>,
    actions: Vec<f64>,
    order: Vec<usize>,
    normalised: Vec<f64>,
}

impl Ppo {
    /// Fresh optimiser state for `policy` and its clones.
    ///
    /// # Errors
    /// [`RlError::Setting`] when a setting is out of range, [`RlError::BelowFloor`] when a standard
    /// deviation of `policy` is already below the floor.
    pub fn new(settings: PpoSettings, policy: &ActorCriticPolicy) -> Result<Self, RlError> {
        settings.check()?;
        check_floor(policy.log_std(), settings.min_log_std)?;
        let network = policy.network().clone();
        let num_params = network.num_params();
        let chunks = Chunks::new(num_params, TRAINING_CHUNK, move || {
            network.workspace(TRAINING_CHUNK)
        });
        Ok(Self {
            optimiser: Adam::new(num_params, settings.adam_epsilon),
            settings,
            chunks,
            gradient: vec![0.0; num_params],
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
    /// comes from `rng`. The same inputs give the same bits on any number of threads.
    ///
    /// The update stops before a gradient step when the minibatch's KL divergence exceeds
    /// [`PpoSettings::kl_stop`] (Stable-Baselines3, `PPO.train`).
    ///
    /// # Errors
    /// [`RlError::BufferNotFinished`] for an unfinished rollout, [`RlError::SpecMismatch`] or
    /// [`RlError::Parameters`] for one of another environment or policy, [`RlError::NotFinite`]
    /// when returns, the loss or the gradient diverge; the parameters are then those before the
    /// offending step. It also reports parameters that a step itself made infinite, which takes
    /// learning rates close to the end of f32: the policy is then lost.
    fn update(
        &mut self,
        policy: &mut ActorCriticPolicy,
        buffer: &RolloutBuffer,
        rng: &mut ChaCha8Rng,
    ) -> Result<UpdateStats, RlError> {
        check_params(self.gradient.len(), policy.params().len())?;
        policy.network().spec().check_same(buffer.spec())?;
        self.rollout.prepare(&self.settings, buffer)?;
        let mut totals = Totals::default();
        while totals.epochs < self.settings.epochs && self.pass(policy, buffer, rng, &mut totals)? {
            totals.epochs += 1;
        }
        check_all_finite("a parameter after the update", policy.params())?;
        let values = &buffer.decisions().values;
        Ok(totals.stats(values, &self.rollout.returns, policy.log_std()))
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

impl Ppo {
    /// One pass over the rollout in a new order; false when the KL divergence ended it early.
    fn pass(
        &mut self,
        policy: &mut ActorCriticPolicy,
        buffer: &RolloutBuffer,
        rng: &mut ChaCha8Rng,
        totals: &mut Totals,
    ) -> Result<bool, RlError> {
        shuffle(&mut self.rollout.order, rng);
        for start in (0..buffer.samples()).step_by(self.settings.minibatch) {
            let sums = self.minibatch_gradient(policy, buffer, start)?;
            totals.losses.add(&sums);
            if sums.kl / sums.samples > self.settings.kl_stop() {
                return Ok(false);
            }
            totals.grad_norms += self.descend(policy)?;
            totals.steps += 1;
        }
        Ok(true)
    }

    /// The encoder is trained at a rate of its own: its drift under the critic's loss moves the
    /// actor, too.
    fn groups(&self, policy: &ActorCriticPolicy) -> [ParamGroup; 2] {
        let group = |range, learning_rate| ParamGroup {
            range,
            learning_rate,
        };
        [
            group(
                policy.network().encoder(),
                self.settings.encoder_learning_rate,
            ),
            group(policy.network().heads(), self.settings.head_learning_rate),
        ]
    }

    /// Leaves the gradient of the minibatch that starts at position `start` of the order in
    /// `self.gradient`.
    fn minibatch_gradient(
        &mut self,
        policy: &ActorCriticPolicy,
        buffer: &RolloutBuffer,
        start: usize,
    ) -> Result<LossSums, RlError> {
        let rollout = &mut self.rollout;
        let end = buffer.samples().min(start + self.settings.minibatch);
        let indices = &rollout.order[start..end];
        normalised_advantages(&rollout.advantages, indices, &mut rollout.normalised);
        let minibatch = Minibatch {
            buffer,
            actions: &rollout.actions,
            returns: &rollout.returns,
            indices,
            advantages: &rollout.normalised,
            weights: loss_weights(&self.settings),
        };
        self.gradient.fill(0.0);
        let (network, params) = (policy.network(), policy.params());
        let mut sums = LossSums::default();
        let parts = self.chunks.accumulate(
            indices.len(),
            &mut self.gradient,
            |range, workspace, gradient| {
                minibatch.chunk(network, params, range, workspace, gradient)
            },
        );
        parts.iter().for_each(|part| sums.add(part));
        check_finite(
            "the loss of a minibatch",
            sums.policy + sums.value + sums.kl,
        )?;
        Ok(sums)
    }

    /// Clips the gradient, takes a step and keeps exploration above its floor; returns the norm
    /// before clipping.
    fn descend(&mut self, policy: &mut ActorCriticPolicy) -> Result<f64, RlError> {
        let norm = clip_global_norm(&mut self.gradient, self.settings.max_grad_norm);
        check_finite("the norm of the gradient", norm)?;
        let groups = self.groups(policy);
        self.optimiser
            .step(&groups, policy.params_mut(), &self.gradient);
        policy.raise_log_std(self.settings.min_log_std);
        Ok(norm)
    }
}

impl Rollout {
    /// Computes advantages and returns and starts from the order of time.
    fn prepare(&mut self, settings: &PpoSettings, buffer: &RolloutBuffer) -> Result<(), RlError> {
        self.advantages.resize(buffer.samples(), 0.0);
        self.returns.resize(buffer.samples(), 0.0);
        buffer.advantages(
            settings.gamma,
            settings.lambda,
            &mut self.advantages,
            &mut self.returns,
        )?;
        check_all_finite("a return", &self.returns)?;
        self.actions.clear();
        self.actions
            .extend(buffer.decisions().actions.iter().map(|&a| f64::from(a)));
        self.order.clear();
        self.order.extend(0..buffer.samples());
        Ok(())
    }
}

fn loss_weights(settings: &PpoSettings) -> LossWeights {
    LossWeights {
        clip: settings.clip.into(),
        value: settings.value_weight.into(),
        entropy: settings.entropy_weight.into(),
    }
}

/// Fisher and Yates' shuffle, in Durstenfeld's form (Comm. ACM 7, 1964, algorithm 235).
fn shuffle(order: &mut [usize], rng: &mut ChaCha8Rng) {
    for i in (1..order.len()).rev() {
        order.swap(i, rng.random_range(0..=i));
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
