//! Environments whose observation vectors and rewards are scaled to order 1 by running statistics.

use serde::{Deserialize, Serialize};
use symmetry::Irrep;

use crate::env::{EnvSpec, MAX_ABS_OBSERVATION, Observations, Transition, VectorEnv};
use crate::error::{
    BoxedEnvError, RlError, check_len, require_positive, require_saved, require_share,
};

/// Share of the root mean square below which a standard deviation does not count, so that a
/// quantity that hardly varies is not divided by almost zero.
const MIN_RELATIVE_STD: f64 = 1e-3;

/// Settings of a [`NormalisedEnv`]: the numbers that it scales, the discount of returns, and the
/// clip. Save them with a policy, and the [`NormalisationState`], too.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct NormalisationSettings {
    /// `true` to normalise observation vectors; images stay as they are.
    pub observations: bool,
    /// `true` to divide rewards by the standard deviation of discounted returns.
    pub rewards: bool,
    /// Discount factor of these returns, in [0, 1]; that of the algorithm.
    pub gamma: f32,
    /// Largest magnitude after normalisation, above 0; larger numbers are clipped to it.
    pub clip: f32,
}

impl Default for NormalisationSettings {
    /// Returns the settings of Stable-Baselines3's `VecNormalize`.
    fn default() -> Self {
        Self { observations: true, rewards: true, gamma: 0.99, clip: 10.0 }
    }
}

/// Running statistics of a [`NormalisedEnv`], for a checkpoint.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct NormalisationState {
    observations: Moments,
    returns: Moments,
}

/// Running mean and variance of several quantities (Welford, Technometrics 4, 1962).
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
struct Moments {
    count: u64,
    means: Vec<f64>,
    /// Sums of squared deviations from the mean.
    squares: Vec<f64>,
}

impl Moments {
    fn new(width: usize) -> Self {
        Self { count: 0, means: vec![0.0; width], squares: vec![0.0; width] }
    }

    /// Rejects moments that no numbers have.
    fn check(&self) -> Result<(), RlError> {
        let are_zero = |moments: &[f64]| moments.iter().all(|&moment| moment == 0.0);
        let count = self.count as f64;
        let has_means = self.count > 0 || are_zero(&self.means);
        require_saved("count", count, "at least 1 with a mean that is not zero", has_means)?;
        let has_squares = self.count > 1 || are_zero(&self.squares);
        require_saved("count", count, "at least 2 with a sum of squares above zero", has_squares)?;
        for &mean in &self.means {
            require_saved("mean", mean, "a finite number", mean.is_finite())?;
        }
        for &square in &self.squares {
            let fits = square.is_finite() && square >= 0.0;
            require_saved("sum of squares", square, "a finite number from 0", fits)?;
        }
        Ok(())
    }

    /// Counts the rows of `values` `[N, width]`.
    fn add(&mut self, values: impl IntoIterator<Item = f64>) {
        let width = self.means.len();
        for (i, value) in values.into_iter().enumerate() {
            self.count += u64::from(i % width == 0);
            let off = value - self.means[i % width];
            self.means[i % width] += off / self.count as f64;
            self.squares[i % width] += off * (value - self.means[i % width]);
        }
    }

    /// Returns the standard deviation of quantity `i`, not far below its root mean square, and the
    /// latter; both are 1 while all values are zero.
    fn scales(&self, i: usize) -> (f64, f64) {
        let variance = self.squares[i] / self.count.max(1) as f64;
        let root_mean_square = (variance + self.means[i].powi(2)).sqrt();
        if root_mean_square == 0.0 {
            return (1.0, 1.0);
        }
        (variance.sqrt().max(MIN_RELATIVE_STD * root_mean_square), root_mean_square)
    }
}

/// Wrapper of the environments `E` that scales observation vectors and rewards to order 1, as
/// Stable-Baselines3's `VecNormalize` does: policies then train alike on rewards of 1e6 and of
/// 1e-6.
///
/// Trivial components are centred on their running mean and divided by their standard deviation;
/// others, whose mean is zero by symmetry, are divided by their root mean square, so the
/// environments stay symmetric. In training, rewards are divided by the standard deviation of the
/// discounted return, so [`RolloutStats`](crate::RolloutStats) counts scaled rewards. For an
/// evaluation, [`NormalisedEnv::set_training`] with `false` freezes the statistics and leaves
/// rewards as they are.
pub struct NormalisedEnv<E> {
    env: E,
    settings: NormalisationSettings,
    state: NormalisationState,
    is_training: bool,
    /// Discounted return of each running episode, `[N]`.
    returns: Vec<f64>,
}

impl<E: VectorEnv> NormalisedEnv<E> {
    /// Wraps the environments `env`; the running statistics begin empty, with the first reset, and
    /// training is on ([`NormalisedEnv::set_training`]).
    ///
    /// # Errors
    /// [`RlError::InvalidSetting`] for a setting out of range.
    pub fn new(env: E, settings: NormalisationSettings) -> Result<Self, RlError> {
        require_share("gamma", settings.gamma)?;
        require_positive("clip", settings.clip)?;
        let spec = env.spec();
        let state = NormalisationState {
            observations: Moments::new(spec.vector_irreps.len()),
            returns: Moments::new(1),
        };
        let returns = vec![0.0; spec.num_envs];
        Ok(Self { env, settings, state, is_training: true, returns })
    }

    /// Chooses between training, which updates the statistics and scales rewards, and evaluation,
    /// which does neither; observation vectors are normalised in both.
    pub fn set_training(&mut self, is_training: bool) {
        self.is_training = is_training;
    }

    /// Returns the wrapped environments, whose observations and rewards are not normalised.
    pub fn inner_mut(&mut self) -> &mut E {
        &mut self.env
    }

    /// Returns the running statistics of observation vectors and discounted returns.
    pub fn normalisation_state(&self) -> &NormalisationState {
        &self.state
    }

    /// Replaces the running statistics of the normalisation by saved ones.
    ///
    /// # Errors
    /// [`RlError::ShapeMismatch`] for statistics of vectors of another length;
    /// [`RlError::InvalidStateNumber`] for means that are not finite, for sums of squares that are not
    /// finite or are negative, and for either from too few numbers.
    pub fn restore_normalisation_state(
        &mut self,
        state: NormalisationState,
    ) -> Result<(), RlError> {
        let (saved, own) = (&state.observations, &self.state.observations);
        check_len("saved means", "[D]", saved.means.len(), own.means.len())?;
        check_len("saved squares", "[D]", saved.squares.len(), own.means.len())?;
        check_len("saved returns", "[1]", state.returns.means.len(), 1)?;
        check_len("saved squares of returns", "[1]", state.returns.squares.len(), 1)?;
        state.observations.check()?;
        state.returns.check()?;
        self.state = state;
        Ok(())
    }

    fn normalise(&self, observations: &mut Observations) {
        let irreps = &self.env.spec().vector_irreps;
        let (moments, clip) = (&self.state.observations, f64::from(self.settings.clip));
        let components = observations.vectors.iter_mut().enumerate();
        // the caller rejects other numbers, which the clip would hide
        for (i, component) in components.filter(|(_, component)| is_allowed(component)) {
            let k = i % irreps.len();
            let (std, root_mean_square) = moments.scales(k);
            let scaled = match irreps[k] {
                Irrep::Trivial => (f64::from(*component) - moments.means[k]) / std,
                _ => f64::from(*component) / root_mean_square,
            };
            *component = scaled.clamp(-clip, clip) as f32;
        }
    }

    /// Counts and normalises the vectors of new observations.
    fn observe(&mut self, observations: &mut Observations) {
        if !self.settings.observations {
            return;
        }
        // other numbers would spoil the statistics for good
        if self.is_training && observations.vectors.iter().all(is_allowed) {
            self.state.observations.add(observations.vectors.iter().map(|&v| f64::from(v)));
        }
        self.normalise(observations);
    }

    fn scale_rewards(&mut self, out: &mut Transition) {
        let finite = out.rewards.iter().all(|reward| reward.is_finite());
        if !(self.settings.rewards && self.is_training && finite) {
            return;
        }
        let gamma = f64::from(self.settings.gamma);
        for (sum, &reward) in self.returns.iter_mut().zip(&out.rewards) {
            *sum = gamma * *sum + f64::from(reward);
        }
        self.state.returns.add(self.returns.iter().copied());
        let (scale, clip) = (self.state.returns.scales(0).0, f64::from(self.settings.clip));
        for reward in &mut out.rewards {
            *reward = (f64::from(*reward) / scale).clamp(-clip, clip) as f32;
        }
        let ended = self.returns.iter_mut().zip(&out.outcomes);
        ended.filter(|(_, outcome)| outcome.is_ended()).for_each(|(sum, _)| *sum = 0.0);
    }
}

impl<E: VectorEnv> VectorEnv for NormalisedEnv<E> {
    fn spec(&self) -> &EnvSpec {
        self.env.spec()
    }

    fn horizon(&self) -> Option<usize> {
        self.env.horizon()
    }

    fn reset(&mut self, out: &mut Observations) -> Result<(), BoxedEnvError> {
        self.env.reset(out)?;
        self.returns.fill(0.0);
        self.observe(out);
        Ok(())
    }

    fn step(&mut self, actions: &[f32], out: &mut Transition) -> Result<(), BoxedEnvError> {
        self.env.step(actions, out)?;
        self.scale_rewards(out);
        self.observe(&mut out.observations);
        if self.settings.observations {
            self.normalise(&mut out.final_observations);
        }
        Ok(())
    }
}

/// Returns `true` for a number that environments may return.
fn is_allowed(component: &f32) -> bool {
    component.abs() <= MAX_ABS_OBSERVATION
}
