//! Policies as a network with its parameters, and the Gaussian actor-critic policy.

use std::fmt;
use std::ops::Range;
use std::sync::Arc;

use equivariant::ParallelChunks;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use symmetry::Group;

use crate::activity::{MeasureUnitActivity, UnitActivity};
use crate::distributions::{ActionDistribution, standard_normals};
use crate::env::{EnvSpec, Observations};
use crate::error::{RlError, check_all_finite, check_len, check_params_fit_network};
use crate::export::{
    ChannelBasis, ExportPolicy, ExportedActionDistribution, ExportedPolicy, PolicyOutput,
    export_layers, export_trunk,
};
use crate::network::{ActorCritic, ActorCriticWorkspace};
use crate::network_settings::{CriticSettings, NetworkSettings};
use crate::policy::{
    Actor, Decisions, EvaluateActions, FeatureExtractor, OnPolicyActor, ValueFunction,
};
use crate::trunk::{HasTrunk, HasTrunkWorkspace, Trunk};

/// Number of observations that a policy's thread processes at a time (a chunk), small enough that a
/// batch of 20 environments occupies several threads.
const CHUNK: usize = 4;

/// A network N with its parameters and the buffers W of its passes: the common part of
/// [`ActorCriticPolicy`] and [`SacPolicy`](crate::SacPolicy). A clone has its own parameters and
/// shares the immutable network.
///
/// Batches run in fixed chunks on the current rayon pool; actions, values and features have the
/// same bits for any number of threads.
pub struct NetworkPolicy<N, W> {
    network: Arc<N>,
    params: Vec<f32>,
    /// Outputs of the network's last forward pass, one row for each observation.
    pub(crate) outputs: Vec<f64>,
    buffers: fn(&N, usize) -> W,
    chunks: ParallelChunks<f32, W>,
}

/// Part of a batch that one thread processes: the observations at indices `range`, which are loaded
/// into the slots from 0 on.
pub(crate) struct Chunk<'a, N> {
    pub network: &'a N,
    pub params: &'a [f32],
    pub range: Range<usize>,
}

impl<N, W> NetworkPolicy<N, W> {
    /// Returns the policy's network, which holds no parameters.
    pub fn network(&self) -> &Arc<N> {
        &self.network
    }

    /// Returns all parameters of the policy, in the flat layout of its network.
    pub fn params(&self) -> &[f32] {
        &self.params
    }

    /// Returns all parameters of the policy for writing, by an optimiser or from a checkpoint.
    pub fn params_mut(&mut self) -> &mut [f32] {
        &mut self.params
    }
}

impl<N, W> NetworkPolicy<N, W>
where
    N: HasTrunk<f32> + Send + Sync + 'static,
    W: HasTrunkWorkspace<f32> + Send + 'static,
{
    /// Creates a policy from a network and its parameters; `buffers` allocates buffers for passes
    /// over up to a given number of samples.
    pub(crate) fn from_network(
        network: Arc<N>,
        params: Vec<f32>,
        buffers: fn(&N, usize) -> W,
    ) -> Self {
        let builder = Arc::clone(&network);
        Self {
            network,
            params,
            outputs: Vec::new(),
            buffers,
            chunks: ParallelChunks::new(0, CHUNK, move || buffers(&builder, CHUNK)),
        }
    }

    fn trunk(&self) -> &Trunk<f32> {
        self.network.trunk()
    }

    /// Returns A, the number of action components.
    pub(crate) fn action_dim(&self) -> usize {
        self.trunk().spec.action_irreps.len()
    }

    /// Runs the network by calling `forward` for chunks of the N observations in parallel, which
    /// writes a row of `outputs`, `row` numbers long, for each observation; returns N.
    pub(crate) fn infer(
        &mut self,
        observations: &Observations,
        row: usize,
        forward: impl Fn(Chunk<N>, &mut W, &mut [f64]) + Sync,
    ) -> Result<usize, RlError> {
        let (network, params) = (&*self.network, &self.params[..]);
        let trunk = network.trunk();
        let samples = observations.checked_num_samples(&trunk.spec)?;
        self.outputs.resize(samples * row, 0.0);
        self.chunks.map_rows(&mut self.outputs, row, |range, buffers, rows| {
            trunk.load_observations(observations, range.clone(), buffers.trunk());
            let chunk = Chunk { network, params, range };
            forward(chunk, buffers, rows);
        });
        Ok(samples)
    }
}

impl<N, W> FeatureExtractor for NetworkPolicy<N, W>
where
    N: HasTrunk<f32> + Send + Sync + 'static,
    W: HasTrunkWorkspace<f32> + Send + 'static,
{
    fn feature_dim(&self) -> usize {
        self.trunk().feature_dim()
    }

    fn features(&mut self, observations: &Observations, out: &mut [f32]) -> Result<(), RlError> {
        let trunk = self.trunk();
        let (samples, width) = (observations.checked_num_samples(&trunk.spec)?, self.feature_dim());
        check_len("features", "[N, F]", out.len(), samples * width)?;
        let params = &self.params[trunk.param_range()];
        self.chunks.map_rows(out, width, |range, buffers, rows| {
            let (n, pass) = (range.len(), buffers.trunk());
            trunk.load_observations(observations, range, pass);
            // the trunk only: features need neither actor nor critic
            trunk.forward(params, n, pass);
            trunk.pool_features(n, pass);
            rows.copy_from_slice(&pass.features()[..n * width]);
        });
        Ok(())
    }
}

impl<N: HasTrunk<f32>, W> fmt::Debug for NetworkPolicy<N, W> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let trunk = self.network.trunk();
        f.debug_struct("NetworkPolicy")
            .field("settings", &trunk.settings)
            .field("num_params", &self.params.len())
            .finish_non_exhaustive()
    }
}

impl<N, W> Clone for NetworkPolicy<N, W>
where
    N: HasTrunk<f32> + Send + Sync + 'static,
    W: HasTrunkWorkspace<f32> + Send + 'static,
{
    fn clone(&self) -> Self {
        Self::from_network(Arc::clone(&self.network), self.params.clone(), self.buffers)
    }
}

/// Rejects a number of parameters other than `expected`, and parameters that are infinite or NaN,
/// which would only show up later as a loss that is not finite.
pub(crate) fn check_saved_params(params: &[f32], expected: usize) -> Result<(), RlError> {
    check_params_fit_network(params.len(), expected)?;
    check_all_finite("a parameter", params)
}

/// An [`ActorCritic`] with its parameters: a memoryless policy, Gaussian or of discrete choices,
/// that is exactly equivariant under the group of its settings.
pub type ActorCriticPolicy = NetworkPolicy<ActorCritic<f32>, ActorCriticWorkspace<f32>>;

impl ActorCriticPolicy {
    /// Builds the network for `spec` and samples its initial parameters with a generator seeded by
    /// `seed`.
    ///
    /// # Errors
    /// Errors of [`ActorCritic::new`].
    pub fn new(settings: &NetworkSettings, spec: &EnvSpec, seed: u64) -> Result<Self, RlError> {
        let network = ActorCritic::new(settings, spec)?;
        let params = network.init_params(&mut ChaCha8Rng::seed_from_u64(seed));
        Ok(Self::from_network(Arc::new(network), params, ActorCritic::new_workspace))
    }

    /// Builds the network for `spec` with the given flat parameters, as
    /// [`ActorCriticPolicy::params`] returned them.
    ///
    /// # Errors
    /// Errors of [`ActorCritic::new`], [`RlError::ParameterCountMismatch`] when the number of
    /// parameters differs and [`RlError::NotFinite`] when one is infinite or not a number.
    pub fn with_params(
        settings: &NetworkSettings,
        spec: &EnvSpec,
        params: Vec<f32>,
    ) -> Result<Self, RlError> {
        let network = ActorCritic::new(settings, spec)?;
        check_saved_params(&params, network.num_params())?;
        Ok(Self::from_network(Arc::new(network), params, ActorCritic::new_workspace))
    }

    /// Returns the logarithms of the action's standard deviations `[A]`, in the environment's
    /// order, the same for every state; empty for discrete actions.
    pub fn log_std(&self) -> &[f32] {
        &self.params()[self.log_std_start()..]
    }

    fn log_std_start(&self) -> usize {
        let is_discrete = !self.network().spec().choices.is_empty();
        self.params().len() - if is_discrete { 0 } else { self.action_dim() }
    }

    /// Raises every log_std of the policy that is below `floor` to `floor`. NaN stays, so that a
    /// check for it can fail.
    pub(crate) fn clamp_log_std(&mut self, floor: f32) {
        let start = self.log_std_start();
        for log_std in &mut self.params_mut()[start..] {
            if *log_std < floor {
                *log_std = floor;
            }
        }
    }

    /// Runs the network on N observations and fills `outputs` with rows `[A + 1]` of mean action
    /// and state value; returns N.
    fn run(&mut self, observations: &Observations) -> Result<usize, RlError> {
        let width = self.action_dim();
        let forward = |chunk: Chunk<ActorCritic<f32>>,
                       w: &mut ActorCriticWorkspace<f32>,
                       rows: &mut [f64]| {
            chunk.network.forward(chunk.params, chunk.range.len(), w);
            let outputs = w.mean.chunks_exact(width).zip(&w.value);
            for (row, (mean, &value)) in rows.chunks_exact_mut(width + 1).zip(outputs) {
                row[..width].copy_from_slice(mean);
                row[width] = value;
            }
        };
        self.infer(observations, width + 1, forward)
    }

    fn policy(&self) -> &Self {
        self
    }

    fn log_std_f64(&self) -> Vec<f64> {
        self.log_std().iter().map(|&s| f64::from(s)).collect()
    }

    /// Returns the action distribution of each observation of the last forward pass, with its state
    /// value; `log_std` is that of the policy.
    fn distributions<'a>(
        &'a self,
        log_std: &'a [f64],
    ) -> impl Iterator<Item = (ActionDistribution<'a>, f64)> {
        let (width, choices) = (self.action_dim(), &self.network().spec().choices[..]);
        self.outputs.chunks_exact(width + 1).map(move |output| {
            (ActionDistribution { mean: &output[..width], log_std, choices }, output[width])
        })
    }

    /// Writes actions `[N, A]` that are sampled with `rng` from the action distributions of the
    /// last forward pass.
    pub(crate) fn write_actions(
        &self,
        samples: usize,
        rng: &mut ChaCha8Rng,
        out: &mut [f32],
    ) -> Result<(), RlError> {
        check_len("actions", "[N, A]", out.len(), samples * self.action_dim())?;
        standard_normals(rng, out);
        self.sample(out);
        Ok(())
    }

    /// Writes the actions that follow from the means in `outputs` and the standard normal `noise`
    /// `[N, A]`, with log-probabilities and state values.
    pub(crate) fn write_decisions(
        &self,
        samples: usize,
        noise: &[f32],
        out: &mut Decisions,
    ) -> Result<(), RlError> {
        out.check_lengths(self.network().spec(), samples)?;
        check_len("noise", "[N, A]", noise.len(), samples * self.action_dim())?;
        out.actions.copy_from_slice(noise);
        self.sample(&mut out.actions);
        self.write_log_probs(out);
        Ok(())
    }

    /// Writes the most likely actions `[N, A]` of the last forward pass to `out`.
    pub(crate) fn write_means(&self, samples: usize, out: &mut [f32]) -> Result<(), RlError> {
        let width = self.action_dim();
        check_len("mean actions", "[N, A]", out.len(), samples * width)?;
        let rows = out.chunks_exact_mut(width);
        rows.zip(self.distributions(&[]))
            .for_each(|(row, (each, _))| each.write_most_likely_action(row));
        Ok(())
    }

    /// Copies the state values `[N]` of the last forward pass from `outputs` to `out`.
    pub(crate) fn write_values(&self, samples: usize, out: &mut [f32]) -> Result<(), RlError> {
        check_len("values", "[N]", out.len(), samples)?;
        let width = self.action_dim();
        for (value, output) in out.iter_mut().zip(self.outputs.chunks_exact(width + 1)) {
            *value = output[width] as f32;
        }
        Ok(())
    }

    /// Turns standard normal `numbers` `[N, A]` into actions for the outputs of the last forward
    /// pass.
    fn sample(&self, numbers: &mut [f32]) {
        let log_std = self.log_std_f64();
        let rows = numbers.chunks_exact_mut(self.action_dim());
        rows.zip(self.distributions(&log_std)).for_each(|(row, (each, _))| each.sample(row));
    }

    /// Writes log-probabilities of the actions in `decisions`, and state values, from the outputs
    /// of the last forward pass.
    fn write_log_probs(&self, decisions: &mut Decisions) {
        let log_std = self.log_std_f64();
        let width = self.action_dim();
        let mut taken = vec![0.0; width];
        for (i, (distribution, value)) in self.distributions(&log_std).enumerate() {
            for (component, &action) in taken.iter_mut().zip(&decisions.actions[i * width..]) {
                // the executed action, rounded to f32: its density is the one that PPO compares
                *component = f64::from(action);
            }
            decisions.log_probs[i] = distribution.log_prob(&taken) as f32;
            decisions.values[i] = value as f32;
        }
    }
}

/// Implements the traits that act on the outputs of a Gaussian policy's network, which `run` leaves
/// in the [`ActorCriticPolicy`] that `policy` returns.
macro_rules! impl_gaussian_policy {
    ($Policy:ty) => {
        impl Actor for $Policy {
            type Memory = ();

            fn new_memory(&self, _: usize) {}

            fn act(
                &mut self,
                observations: &Observations,
                (): &mut (),
                rng: &mut ChaCha8Rng,
                out: &mut [f32],
            ) -> Result<(), RlError> {
                let samples = self.run(observations)?;
                self.policy().write_actions(samples, rng, out)
            }

            fn mean_actions(
                &mut self,
                observations: &Observations,
                (): &mut (),
                out: &mut [f32],
            ) -> Result<(), RlError> {
                let samples = self.run(observations)?;
                self.policy().write_means(samples, out)
            }
        }

        impl OnPolicyActor for $Policy {
            fn decide(
                &mut self,
                observations: &Observations,
                (): &mut (),
                noise: &[f32],
                out: &mut Decisions,
            ) -> Result<(), RlError> {
                let samples = self.run(observations)?;
                self.policy().write_decisions(samples, noise, out)
            }
        }

        impl ValueFunction for $Policy {
            fn values(
                &mut self,
                observations: &Observations,
                out: &mut [f32],
            ) -> Result<(), RlError> {
                let samples = self.run(observations)?;
                self.policy().write_values(samples, out)
            }
        }
    };
}
#[cfg(feature = "wgpu")]
pub(crate) use impl_gaussian_policy;

impl_gaussian_policy!(ActorCriticPolicy);

impl EvaluateActions for ActorCriticPolicy {
    fn evaluate_actions(
        &mut self,
        observations: &Observations,
        decisions: &mut Decisions,
    ) -> Result<(), RlError> {
        let samples = self.run(observations)?;
        decisions.check_lengths(self.network().spec(), samples)?;
        self.write_log_probs(decisions);
        Ok(())
    }
}

impl ExportPolicy for ActorCriticPolicy {
    fn export(&self) -> Result<ExportedPolicy, RlError> {
        let (network, params) = (self.network(), self.params());
        if !network.spec().choices.is_empty() {
            return Err(RlError::NotExportable { part: "a discrete action" });
        }
        let (ranges, trunk) = (network.param_ranges(), export_trunk(&network.trunk, params)?);
        let settings = network.settings();
        let (group, critic) = (settings.group, &params[ranges.critic]);
        let to = |order| [trunk.joined, ChannelBasis::Environment(order)];
        let pooled = matches!(settings.critic, CriticSettings::Pooled { .. });
        let critic = if pooled {
            // pooled features are invariant: no change of basis
            export_layers(Group::C1, &network.critic, critic, [ChannelBasis::Regular; 2])?
        } else {
            export_layers(group, &network.critic, critic, to(&[0]))?
        };
        let actor = &params[ranges.actor];
        Ok(ExportedPolicy {
            spec: network.spec().clone(),
            order: group.order(),
            actor: export_layers(group, &network.actor, actor, to(&network.action_order))?,
            image: trunk.image,
            vector: trunk.vector,
            distribution: ExportedActionDistribution::Gaussian { log_std: self.log_std().to_vec() },
            critic: Some((critic, pooled)),
        })
    }

    fn reference_output(&mut self, observations: &Observations) -> Result<PolicyOutput, RlError> {
        let samples = observations.checked_num_samples(self.network().spec())?;
        let mut actions = vec![0.0; samples * self.action_dim()];
        let mut values = vec![0.0; samples];
        self.mean_actions(observations, &mut (), &mut actions)?;
        self.values(observations, &mut values)?;
        Ok(PolicyOutput { actions, log_std: self.log_std().repeat(samples), values: Some(values) })
    }
}

impl MeasureUnitActivity for ActorCriticPolicy {
    fn unit_activity(&self, observations: &Observations, (): &()) -> Result<UnitActivity, RlError> {
        let (network, params) = (self.network(), self.params());
        let samples = observations.checked_num_samples(network.spec())?;
        let mut w = network.new_workspace(samples);
        network.trunk.load_observations(observations, 0..samples, w.trunk());
        network.forward(params, samples, &mut w);
        Ok(network.unit_activity(params, samples, &w))
    }
}
