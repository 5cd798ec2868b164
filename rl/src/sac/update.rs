//! Soft actor-critic: updates of a policy from a replay.

use std::fmt;

use equivariant::Chunks;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use symmetry::D2;

use crate::adam::{Adam, ParamGroup, SECOND_MOMENT, clip_values, norm};
use crate::algorithm::{Algorithm, AlgorithmState, check_not_negative};
use crate::error::{RlError, check_all_finite, check_finite, check_params};
use crate::gaussian::standard_normals;
use crate::replay::ring::Replay;
use crate::sac::gradient::Losses;
use crate::sac::minibatch::Batch;
use crate::sac::policy::SacPolicy;
use crate::sac::settings::{SacSettings, Temperature};
use crate::sac::stats::{SacStats, SacSums, SacTotals};
use crate::sac::workspace::SacWorkspace;

/// Steps of one training chunk, as in PPO, or those of one window where they are more: observations
/// are shared within a chunk. A workspace holds a chunk, so there is a limit.
const TRAINING_CHUNK: [usize; 2] = [8, 32];

/// Names of the state in a checkpoint, beside that of the optimiser.
const TARGETS: &str = "targets";
const TEMPERATURE: &str = "temperature.log";
const TEMPERATURE_FIRST: &str = "temperature.first";
const TEMPERATURE_SECOND: &str = "temperature.second";

/// Soft actor-critic (Haarnoja et al., arXiv 1801.01290, and arXiv 1812.05905, algorithm 1) with
/// the state of one policy: optimiser, target critics and temperature.
///
/// ```text
/// y     = r + gamma (1 - terminated) (min_i Q'_i(s', a') - alpha ln pi(a'|s'))
/// J_Q   = sum_i (Q_i(s, a) - y)^2 / 2                  (1812.05905, equations 5 and 6)
/// J_pi  = alpha ln pi(b|s) - min_i Q_i(s, b)           (1812.05905, equation 9)
/// J_alpha = -alpha ln pi(b|s) - alpha H                (1812.05905, equation 18)
/// ```
///
/// where a' and b are drawn from the actor, and Q' are the target critics. A time-out is not a
/// termination. All gradients of a step are taken at the same parameters, and one Adam takes the
/// step of actor and critics.
pub struct Sac {
    settings: SacSettings,
    optimiser: Adam,
    /// Parameters of the target critics.
    targets: Vec<f32>,
    /// The logarithm of a learned temperature, and its optimiser.
    log_temperature: [f32; 1],
    temperature_optimiser: Adam,
    chunks: Chunks<f32, SacWorkspace<f32>>,
    gradient: Vec<f32>,
    draws: Draws,
}

/// What is drawn for a minibatch; kept for its memory.
#[derive(Default)]
struct Draws {
    /// The first step of each window.
    indices: Vec<usize>,
    steps: Vec<(usize, usize)>,
    elements: Vec<D2>,
    noise: [Vec<f32>; 2],
}

impl Sac {
    /// Fresh state for `policy` and its clones: target critics equal to its critics.
    ///
    /// # Errors
    /// [`RlError::Setting`] when a setting is out of range.
    pub fn new(settings: SacSettings, policy: &SacPolicy) -> Result<Self, RlError> {
        settings.check()?;
        let [least, most] = TRAINING_CHUNK;
        let chunk = settings.window.clamp(least, most);
        let network = policy.network().clone();
        let num_params = network.num_params();
        let initial = match settings.temperature {
            Temperature::Learned { initial, .. } => initial,
            Temperature::Fixed(_) => 1.0,
        };
        Ok(Self {
            optimiser: Adam::new(num_params, settings.adam_epsilon),
            targets: policy.params()[network.critics()].to_vec(),
            log_temperature: [initial.ln()],
            temperature_optimiser: Adam::new(1, settings.adam_epsilon),
            chunks: Chunks::new(num_params, chunk, move || network.workspace(chunk)),
            gradient: vec![0.0; num_params],
            draws: Draws::default(),
            settings,
        })
    }

    /// The settings.
    pub fn settings(&self) -> &SacSettings {
        &self.settings
    }

    /// What a nat of entropy is worth.
    pub fn temperature(&self) -> f64 {
        match self.settings.temperature {
            Temperature::Fixed(alpha) => alpha.into(),
            Temperature::Learned { .. } => f64::from(self.log_temperature[0]).exp(),
        }
    }

    /// Gradient steps that are still to be taken when `recorded` steps have been recorded, counted
    /// from the first one ever: for all of them after the burn-in, less the gradient steps that
    /// were taken. So a fresh `Sac` on a replay of old steps catches up on all of them at its first
    /// update. One that goes on where both were saved does not ([`Algorithm::restore`] brings its
    /// count back).
    pub fn due(&self, recorded: u64) -> u64 {
        let after = recorded.saturating_sub(self.settings.burn_in);
        let total = after as f64 * f64::from(self.settings.updates_per_step);
        (total as u64).saturating_sub(self.optimiser.steps)
    }
}

impl Algorithm for Sac {
    type Policy = SacPolicy;
    type Experience = Replay;
    type Stats = SacStats;

    /// Takes the gradient steps that are due ([`SacSettings::updates_per_step`]), none during the
    /// burn-in. The same inputs give the same bits on any number of threads.
    ///
    /// # Errors
    /// Those of [`Algorithm::update`]; what may diverge are the loss and the gradient.
    fn update(
        &mut self,
        policy: &mut SacPolicy,
        replay: &Replay,
        rng: &mut ChaCha8Rng,
    ) -> Result<SacStats, RlError> {
        check_params(self.gradient.len(), policy.params().len())?;
        policy.network().spec().check_same(replay.spec())?;
        let mut totals = SacTotals::default();
        if !replay.is_empty() {
            for _ in 0..self.due(replay.recorded()) {
                self.step(policy, replay, rng, &mut totals)?;
            }
        }
        check_all_finite("a parameter after the update", policy.params())?;
        Ok(totals.stats(self.temperature(), replay.len()))
    }

    /// Both moments of Adam and its number of steps, the target critics and the temperature.
    fn save(&self) -> AlgorithmState<'_> {
        let temperature = &self.temperature_optimiser;
        let mut state = self.optimiser.save();
        state.tensors.push((TARGETS, &self.targets));
        // a fixed temperature has no state, and takes none from a learned one
        if matches!(self.settings.temperature, Temperature::Learned { .. }) {
            state.tensors.extend([
                (TEMPERATURE, &self.log_temperature[..]),
                (TEMPERATURE_FIRST, &temperature.first_moment),
                (TEMPERATURE_SECOND, &temperature.second_moment),
            ]);
        }
        state
    }

    fn restore(&mut self, state: &AlgorithmState<'_>) -> Result<(), RlError> {
        state.check_like(&self.save())?;
        check_not_negative(state, &[SECOND_MOMENT, TEMPERATURE_SECOND])?;
        let temperature = &mut self.temperature_optimiser;
        let own: [&mut [f32]; 4] = [
            &mut self.targets,
            &mut self.log_temperature,
            &mut temperature.first_moment,
            &mut temperature.second_moment,
        ];
        // the layout is that of `save`, in which the last three are there for a learned one
        for (own, (_, saved)) in own.into_iter().zip(&state.tensors[2..]) {
            own.copy_from_slice(saved);
        }
        self.optimiser.restore(state);
        temperature.steps = self.optimiser.steps;
        Ok(())
    }
}

impl Sac {
    /// One gradient step on everything.
    fn step(
        &mut self,
        policy: &mut SacPolicy,
        replay: &Replay,
        rng: &mut ChaCha8Rng,
        totals: &mut SacTotals,
    ) -> Result<(), RlError> {
        self.draws.draw(&self.settings, replay, rng);
        let sums = self.minibatch_gradient(policy, replay)?;
        totals.grad_norms += self.descend(policy, totals)?;
        totals.steps += 1;
        totals.sums.add(&sums);
        self.adjust_temperature(policy, &sums);
        self.follow(policy);
        Ok(())
    }

    /// Leaves the gradient of the minibatch that was drawn in `self.gradient`.
    fn minibatch_gradient(
        &mut self,
        policy: &SacPolicy,
        replay: &Replay,
    ) -> Result<SacSums, RlError> {
        let losses = Losses {
            network: policy.network(),
            params: policy.params(),
            targets: &self.targets,
            batch: Batch {
                replay,
                steps: &self.draws.steps,
                elements: &self.draws.elements,
                noise: [&self.draws.noise[0], &self.draws.noise[1]],
                gamma: self.settings.gamma.into(),
                temperature: self.temperature(),
                cloning: self.settings.cloning_weight.into(),
            },
        };
        self.gradient.fill(0.0);
        let mut sums = SacSums::default();
        let parts = self.chunks.accumulate(
            self.settings.batch,
            &mut self.gradient,
            |range, workspace, gradient| losses.chunk(range, workspace, gradient),
        );
        parts.iter().for_each(|part| sums.add(part));
        let loss = sums.critic + sums.actor + sums.cloning;
        check_finite("the loss of a minibatch", loss)?;
        Ok(sums)
    }

    /// Clips the gradient and takes a step; returns the norm before clipping.
    fn descend(&mut self, policy: &mut SacPolicy, totals: &mut SacTotals) -> Result<f64, RlError> {
        let norm = norm(&self.gradient);
        check_finite("the norm of the gradient", norm)?;
        let clipped = clip_values(&mut self.gradient, self.settings.max_gradient);
        totals.clipped += clipped as f64 / self.gradient.len() as f64;
        let group = ParamGroup {
            range: 0..self.gradient.len(),
            learning_rate: self.settings.learning_rate,
        };
        self.optimiser
            .step(&[group], policy.params_mut(), &self.gradient);
        Ok(norm)
    }

    /// Takes a step on J(alpha) = E[-alpha ln pi - alpha H], where H is the entropy to be kept
    /// (1812.05905, equation 18), in the logarithm of alpha, so that alpha stays positive.
    fn adjust_temperature(&mut self, policy: &SacPolicy, sums: &SacSums) {
        let Temperature::Learned { target, .. } = self.settings.temperature else {
            return;
        };
        let target = f64::from(target) * policy.network().spec().action.len() as f64;
        let surplus = -sums.log_prob / sums.samples - target;
        let gradient = [(self.temperature() * surplus) as f32];
        let group = ParamGroup {
            range: 0..1,
            learning_rate: self.settings.learning_rate,
        };
        self.temperature_optimiser
            .step(&[group], &mut self.log_temperature, &gradient);
    }

    /// Moves the target critics a part of the way to the critics (algorithm 1, last line).
    fn follow(&mut self, policy: &SacPolicy) {
        let tau = self.settings.tau;
        let critics = &policy.params()[policy.network().critics()];
        for (target, critic) in self.targets.iter_mut().zip(critics) {
            *target += tau * (critic - *target);
        }
    }
}

impl Draws {
    /// Draws a minibatch: first the windows, then their elements, then both noises.
    fn draw(&mut self, settings: &SacSettings, replay: &Replay, rng: &mut ChaCha8Rng) {
        let (batch, window) = (settings.batch, settings.window);
        let windows = batch.div_ceil(window);
        replay.sample(windows, settings.newest_share, rng, &mut self.indices);
        let steps = self.indices.iter();
        let steps = steps.flat_map(|&index| (0..window).map(move |further| (index, further)));
        self.steps.clear();
        self.steps.extend(steps.take(batch));
        let group = settings.augmentation.elements();
        self.elements.clear();
        for _ in 0..windows {
            let element = group[rng.random_range(0..group.len())];
            self.elements.extend([element].repeat(window));
        }
        self.elements.truncate(batch);
        for noise in &mut self.noise {
            noise.resize(batch * replay.spec().action.len(), 0.0);
            standard_normals(rng, noise);
        }
    }
}

impl fmt::Debug for Sac {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("Sac")
            .field("settings", &self.settings)
            .field("steps", &self.optimiser.steps)
            .finish_non_exhaustive()
    }
}

#[cfg(test)]
mod draws;
#[cfg(test)]
mod golden;
