//! Proximal policy optimisation: one update of a policy from one rollout.

use std::fmt;

use equivariant::Chunks;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::actor_critic_policy::ActorCriticPolicy;
use crate::adam::{Adam, ParamGroup, clip_global_norm};
use crate::buffer::RolloutBuffer;
use crate::error::{RlError, check_finite};
use crate::loss::{LossSums, LossWeights};
use crate::metrics::Metrics;
use crate::minibatch::{Minibatch, normalised_advantages};
use crate::pass::Workspace;
use crate::ppo_settings::PpoSettings;

/// Samples of one training chunk: 8 chunks a minibatch keep the cores busy; smaller ones cost a quarter more time.
const TRAINING_CHUNK: usize = 8;

/// What an update did. Losses and diagnostics are means over all decisions of all minibatches that were run.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct UpdateStats {
    /// The clipped surrogate, negated: what the actor minimises.
    pub policy_loss: f64,
    /// Squared error of the value function.
    pub value_loss: f64,
    /// Entropy of the action distribution in nats.
    pub entropy: f64,
    /// Estimated KL divergence of the new policy from the collecting one, in nats, at least 0.
    pub approx_kl: f64,
    /// Share in [0, 1] of decisions whose probability ratio left the clip interval.
    pub clip_fraction: f64,
    /// 1 - Var(return - value) / Var(return), before the update; 1 is a perfect critic, 0 a constant one.
    pub explained_variance: f64,
    /// Euclidean norm of the gradient before clipping, mean over gradient steps.
    pub grad_norm: f64,
    /// Gradient steps taken.
    pub steps: usize,
    /// Complete passes over the rollout; fewer than set when the KL divergence stopped the update.
    pub epochs: usize,
    /// Logarithm of every action component's standard deviation after the update, `[A]`.
    pub log_std: Vec<f32>,
}

impl Metrics for UpdateStats {
    /// The fields in their order; the components of `log_std` are `log_std_0`, `log_std_1`, ...
    fn metrics(&self) -> Vec<(String, f64)> {
        let scalars = [
            ("policy_loss", self.policy_loss),
            ("value_loss", self.value_loss),
            ("entropy", self.entropy),
            ("approx_kl", self.approx_kl),
            ("clip_fraction", self.clip_fraction),
            ("explained_variance", self.explained_variance),
            ("grad_norm", self.grad_norm),
            ("steps", self.steps as f64),
            ("epochs", self.epochs as f64),
        ];
        let scalars = scalars.map(|(name, value)| (name.to_owned(), value));
        let components = self.log_std.iter().enumerate();
        let components = components.map(|(i, &s)| (format!("log_std_{i}"), f64::from(s)));
        scalars.into_iter().chain(components).collect()
    }
}

/// Proximal policy optimisation (Schulman et al., arXiv 1707.06347, algorithm 1) with the optimiser state of one
/// policy.
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
    /// [`RlError::Setting`] when a setting is out of range.
    pub fn new(settings: PpoSettings, policy: &ActorCriticPolicy) -> Result<Self, RlError> {
        let optimiser = Adam::new(policy.params().len(), settings.adam_epsilon);
        Self::resume(settings, policy, optimiser)
    }

    /// Continues with a saved optimiser state.
    ///
    /// # Errors
    /// [`RlError::Setting`] when a setting is out of range, [`RlError::Parameters`] when the state belongs to another
    /// network.
    pub fn resume(
        settings: PpoSettings,
        policy: &ActorCriticPolicy,
        optimiser: Adam,
    ) -> Result<Self, RlError> {
        settings.check()?;
        check_params(optimiser.first_moment.len(), policy.params().len())?;
        check_params(optimiser.second_moment.len(), policy.params().len())?;
        let network = policy.network().clone();
        let num_params = network.num_params();
        let chunks = Chunks::new(num_params, TRAINING_CHUNK, move || {
            network.workspace(TRAINING_CHUNK)
        });
        Ok(Self {
            settings,
            optimiser,
            chunks,
            gradient: vec![0.0; num_params],
            rollout: Rollout::default(),
        })
    }

    /// The settings.
    pub fn settings(&self) -> &PpoSettings {
        &self.settings
    }

    /// The optimiser state, for a checkpoint.
    pub fn optimiser(&self) -> &Adam {
        &self.optimiser
    }

    /// Improves `policy` by several passes over the minibatches of a finished rollout; their order comes from `rng`.
    /// The same inputs give the same bits on any number of threads.
    ///
    /// The update stops before a gradient step when the minibatch's KL divergence exceeds [`PpoSettings::kl_stop`]
    /// (Stable-Baselines3, `PPO.train`).
    ///
    /// # Errors
    /// [`RlError::BufferNotFinished`] for an unfinished rollout, [`RlError::SpecMismatch`] or [`RlError::Parameters`]
    /// for one of another environment or policy, [`RlError::NotFinite`] when the loss diverges; the parameters are then
    /// those before the offending step.
    pub fn update(
        &mut self,
        policy: &mut ActorCriticPolicy,
        buffer: &RolloutBuffer,
        rng: &mut ChaCha8Rng,
    ) -> Result<UpdateStats, RlError> {
        check_params(self.gradient.len(), policy.params().len())?;
        check_spec(policy, buffer)?;
        self.rollout.prepare(&self.settings, buffer)?;
        let groups = self.groups(policy);
        let mut totals = Totals::default();
        for _ in 0..self.settings.epochs {
            shuffle(&mut self.rollout.order, rng);
            for start in (0..buffer.samples()).step_by(self.settings.minibatch) {
                let sums = self.minibatch_gradient(policy, buffer, start)?;
                totals.losses.add(&sums);
                if sums.kl / sums.samples > self.settings.kl_stop() {
                    return Ok(totals.stats(&self.rollout, buffer, policy));
                }
                totals.grad_norms += self.descend(policy, &groups)?;
                totals.steps += 1;
            }
            totals.epochs += 1;
        }
        Ok(totals.stats(&self.rollout, buffer, policy))
    }

    /// The encoder is trained at a rate of its own: its drift under the critic's loss moves the actor, too.
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

    /// Leaves the gradient of the minibatch that starts at position `start` of the order in `self.gradient`.
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

    /// Clips the gradient and takes a step; returns the norm before clipping.
    fn descend(
        &mut self,
        policy: &mut ActorCriticPolicy,
        groups: &[ParamGroup],
    ) -> Result<f64, RlError> {
        let norm = clip_global_norm(&mut self.gradient, self.settings.max_grad_norm);
        check_finite("the norm of the gradient", norm)?;
        self.optimiser
            .step(groups, policy.params_mut(), &self.gradient);
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
        self.actions.clear();
        self.actions
            .extend(buffer.decisions().actions.iter().map(|&a| f64::from(a)));
        self.order.clear();
        self.order.extend(0..buffer.samples());
        Ok(())
    }
}

/// Running sums of an update.
#[derive(Default)]
struct Totals {
    losses: LossSums,
    grad_norms: f64,
    steps: usize,
    epochs: usize,
}

impl Totals {
    fn stats(
        &self,
        rollout: &Rollout,
        buffer: &RolloutBuffer,
        policy: &ActorCriticPolicy,
    ) -> UpdateStats {
        let mean = |sum: f64| sum / self.losses.samples;
        UpdateStats {
            policy_loss: mean(self.losses.policy),
            value_loss: mean(self.losses.value),
            entropy: mean(self.losses.entropy),
            approx_kl: mean(self.losses.kl),
            clip_fraction: mean(self.losses.clipped),
            explained_variance: explained_variance(&buffer.decisions().values, &rollout.returns),
            grad_norm: self.grad_norms / self.steps.max(1) as f64,
            steps: self.steps,
            epochs: self.epochs,
            log_std: policy.log_std().to_vec(),
        }
    }
}

/// 1 - Var(return - value) / Var(return); 0 when the returns do not vary.
fn explained_variance(values: &[f32], returns: &[f32]) -> f64 {
    let total = variance(returns.iter().map(|&r| f64::from(r)));
    let residual = variance(
        returns
            .iter()
            .zip(values)
            .map(|(&r, &v)| f64::from(r) - f64::from(v)),
    );
    if total > 0.0 {
        1.0 - residual / total
    } else {
        0.0
    }
}

fn variance(numbers: impl ExactSizeIterator<Item = f64> + Clone) -> f64 {
    let count = numbers.len() as f64;
    let mean = numbers.clone().sum::<f64>() / count;
    numbers.map(|x| (x - mean).powi(2)).sum::<f64>() / count
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

fn check_params(got: usize, expected: usize) -> Result<(), RlError> {
    if got == expected {
        Ok(())
    } else {
        Err(RlError::Parameters { got, expected })
    }
}

fn check_spec(policy: &ActorCriticPolicy, buffer: &RolloutBuffer) -> Result<(), RlError> {
    let (ours, theirs) = (policy.network().spec(), buffer.spec());
    let equal = [
        ("image", ours.image == theirs.image),
        ("vector", ours.vector == theirs.vector),
        ("action", ours.action == theirs.action),
    ];
    match equal.iter().find(|(_, equal)| !equal) {
        Some(&(field, _)) => Err(RlError::SpecMismatch { field }),
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
