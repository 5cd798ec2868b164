//! The equivariant Gaussian policy: a network with its parameters.

use std::fmt;
use std::sync::Arc;

use equivariant::Chunks;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::env::{EnvSpec, Observations};
use crate::error::{RlError, check_all_finite, check_len, check_params};
use crate::gaussian::{log_prob, standard_normals};
use crate::network::ActorCritic;
use crate::network_settings::NetworkSettings;
use crate::pass::Workspace;
use crate::policy::{Actor, Assess, Decisions, Features, OnPolicy, Values};

/// Samples of one inference chunk: a batch of 20 environments then occupies several threads.
const INFERENCE_CHUNK: usize = 4;

/// An [`ActorCritic`] with its parameters: a diagonal Gaussian policy that is exactly equivariant
/// under the group of its settings. It decides from the observation alone.
///
/// A clone has parameters of its own and shares the (immutable) network. Batches run in fixed
/// chunks on the current rayon pool; actions, values and features have the same bits for any number
/// of threads.
pub struct ActorCriticPolicy {
    network: Arc<ActorCritic<f32>>,
    params: Vec<f32>,
    chunks: Chunks<f32, Workspace<f32>>,
    outputs: Vec<f64>,
    noise: Vec<f32>,
}

impl ActorCriticPolicy {
    /// Builds the network for `spec` and draws its parameters from the stream of `seed`.
    ///
    /// # Errors
    /// Those of [`ActorCritic::new`].
    pub fn new(settings: &NetworkSettings, spec: &EnvSpec, seed: u64) -> Result<Self, RlError> {
        let network = ActorCritic::new(settings, spec)?;
        let params = network.init(&mut ChaCha8Rng::seed_from_u64(seed));
        Ok(Self::assemble(Arc::new(network), params))
    }

    /// Builds the network for `spec` with the given flat parameters, as
    /// [`ActorCriticPolicy::params`] returned them.
    ///
    /// # Errors
    /// Those of [`ActorCritic::new`], [`RlError::Parameters`] when the number of parameters differs
    /// and [`RlError::NotFinite`] when one is infinite or not a number.
    pub fn with_params(
        settings: &NetworkSettings,
        spec: &EnvSpec,
        params: Vec<f32>,
    ) -> Result<Self, RlError> {
        let network = ActorCritic::new(settings, spec)?;
        check_params(params.len(), network.num_params())?;
        // later it would only show as a loss that is not finite
        check_all_finite("a parameter", &params)?;
        Ok(Self::assemble(Arc::new(network), params))
    }

    fn assemble(network: Arc<ActorCritic<f32>>, params: Vec<f32>) -> Self {
        let builder = Arc::clone(&network);
        let chunks = Chunks::new(0, INFERENCE_CHUNK, move || {
            builder.workspace(INFERENCE_CHUNK)
        });
        Self {
            network,
            params,
            chunks,
            outputs: Vec::new(),
            noise: Vec::new(),
        }
    }

    /// The network.
    pub fn network(&self) -> &Arc<ActorCritic<f32>> {
        &self.network
    }

    /// All parameters, in the network's layout.
    pub fn params(&self) -> &[f32] {
        &self.params
    }

    /// All parameters, for an optimiser or a checkpoint to write.
    pub fn params_mut(&mut self) -> &mut [f32] {
        &mut self.params
    }

    /// Logarithms of the action's standard deviations `[A]`, in natural order, the same for every
    /// state.
    pub fn log_std(&self) -> &[f32] {
        &self.params[self.params.len() - self.width()..]
    }

    /// Raises every logarithm of a standard deviation that is below `floor` to it. NaN stays.
    pub(crate) fn raise_log_std(&mut self, floor: f32) {
        let start = self.params.len() - self.width();
        for log_std in &mut self.params[start..] {
            if *log_std < floor {
                *log_std = floor;
            }
        }
    }

    /// A, the number of action components.
    fn width(&self) -> usize {
        self.network.spec().action.len()
    }

    /// Fills `outputs` `[N, A + 1]` with means and values; returns N.
    fn run(&mut self, observations: &Observations) -> Result<usize, RlError> {
        let samples = observations.samples(self.network.spec())?;
        let width = self.width();
        self.outputs.resize(samples * (width + 1), 0.0);
        let (network, params) = (&self.network, &self.params);
        self.chunks
            .map_rows(&mut self.outputs, width + 1, |range, workspace, rows| {
                let n = load(network, observations, range, workspace);
                network.forward(params, n, workspace);
                for (i, row) in rows.chunks_exact_mut(width + 1).enumerate() {
                    row[..width].copy_from_slice(&workspace.mean[i * width..(i + 1) * width]);
                    row[width] = workspace.value[i];
                }
            });
        Ok(samples)
    }
}

impl ActorCriticPolicy {
    fn log_std_f64(&self) -> Vec<f64> {
        self.log_std().iter().map(|&s| f64::from(s)).collect()
    }

    /// Draws actions `[N, A]` around the means in `outputs`.
    fn sample(&mut self, rng: &mut ChaCha8Rng, actions: &mut [f32]) {
        let width = self.width();
        self.noise.resize(actions.len(), 0.0);
        standard_normals(rng, &mut self.noise);
        let std: Vec<f64> = self.log_std_f64().iter().map(|s| s.exp()).collect();
        let rows = actions
            .chunks_exact_mut(width)
            .zip(self.noise.chunks_exact(width));
        for ((actions, noise), output) in rows.zip(self.outputs.chunks_exact(width + 1)) {
            for j in 0..width {
                actions[j] = (output[j] + std[j] * f64::from(noise[j])) as f32;
            }
        }
    }

    /// Writes log-probabilities and values from `outputs`. The density belongs to the numbers that
    /// are executed, so actions are rounded before.
    fn weigh(&self, decisions: &mut Decisions) {
        let log_std = self.log_std_f64();
        let width = log_std.len();
        let mut taken = vec![0.0; width];
        for (i, output) in self.outputs.chunks_exact(width + 1).enumerate() {
            for (taken, &action) in taken.iter_mut().zip(&decisions.actions[i * width..]) {
                *taken = f64::from(action);
            }
            decisions.log_probs[i] = log_prob(&output[..width], &log_std, &taken) as f32;
            decisions.values[i] = output[width] as f32;
        }
    }
}

/// Copies a range of observations into the slots 0..n of a workspace; returns n.
fn load(
    network: &ActorCritic<f32>,
    observations: &Observations,
    range: std::ops::Range<usize>,
    workspace: &mut Workspace<f32>,
) -> usize {
    let n = range.len();
    for (slot, i) in range.enumerate() {
        let (image, vector) = observations.sample(network.spec(), i);
        network.load(slot, image, vector, workspace);
    }
    n
}

impl Actor for ActorCriticPolicy {
    type Memory = ();

    fn memory(&self, _: usize) {}

    fn act(
        &mut self,
        observations: &Observations,
        (): &mut (),
        rng: &mut ChaCha8Rng,
        out: &mut [f32],
    ) -> Result<(), RlError> {
        let samples = self.run(observations)?;
        check_len("actions", "[N, A]", out.len(), samples * self.width())?;
        self.sample(rng, out);
        Ok(())
    }

    fn mean_actions(
        &mut self,
        observations: &Observations,
        (): &mut (),
        out: &mut [f32],
    ) -> Result<(), RlError> {
        let width = self.width();
        let samples = self.run(observations)?;
        check_len("mean actions", "[N, A]", out.len(), samples * width)?;
        for (mean, output) in out
            .chunks_exact_mut(width)
            .zip(self.outputs.chunks_exact(width + 1))
        {
            mean.iter_mut()
                .zip(output)
                .for_each(|(m, &o)| *m = o as f32);
        }
        Ok(())
    }
}

impl OnPolicy for ActorCriticPolicy {
    fn decide(
        &mut self,
        observations: &Observations,
        (): &mut (),
        rng: &mut ChaCha8Rng,
        out: &mut Decisions,
    ) -> Result<(), RlError> {
        let samples = self.run(observations)?;
        out.check(self.network.spec(), samples)?;
        self.sample(rng, &mut out.actions);
        self.weigh(out);
        Ok(())
    }
}

impl Assess for ActorCriticPolicy {
    fn assess(
        &mut self,
        observations: &Observations,
        decisions: &mut Decisions,
    ) -> Result<(), RlError> {
        let samples = self.run(observations)?;
        decisions.check(self.network.spec(), samples)?;
        self.weigh(decisions);
        Ok(())
    }
}

impl Values for ActorCriticPolicy {
    fn values(&mut self, observations: &Observations, out: &mut [f32]) -> Result<(), RlError> {
        let width = self.width();
        let samples = self.run(observations)?;
        check_len("values", "[N]", out.len(), samples)?;
        for (value, output) in out.iter_mut().zip(self.outputs.chunks_exact(width + 1)) {
            *value = output[width] as f32;
        }
        Ok(())
    }
}

impl Features for ActorCriticPolicy {
    fn feature_dim(&self) -> usize {
        self.network.feature_dim()
    }

    fn features(&mut self, observations: &Observations, out: &mut [f32]) -> Result<(), RlError> {
        let (samples, width) = (
            observations.samples(self.network.spec())?,
            self.feature_dim(),
        );
        check_len("features", "[N, F]", out.len(), samples * width)?;
        let (network, params) = (&self.network, &self.params);
        self.chunks.map_rows(out, width, |range, workspace, rows| {
            let n = load(network, observations, range, workspace);
            network.forward_features(params, n, workspace);
            rows.copy_from_slice(workspace.features());
        });
        Ok(())
    }
}

impl Clone for ActorCriticPolicy {
    fn clone(&self) -> Self {
        Self::assemble(Arc::clone(&self.network), self.params.clone())
    }
}

impl fmt::Debug for ActorCriticPolicy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("ActorCriticPolicy")
            .field("settings", self.network.settings())
            .field("num_params", &self.params.len())
            .finish_non_exhaustive()
    }
}
