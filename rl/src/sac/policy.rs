//! The tanh-Gaussian policy: a network with its parameters.

use std::fmt;
use std::ops::Range;
use std::sync::Arc;

use equivariant::Chunks;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::env::{EnvSpec, Observations};
use crate::error::{RlError, check_all_finite, check_len, check_params};
use crate::gaussian::standard_normals;
use crate::network_settings::NetworkSettings;
use crate::policy::{Actor, Features};
use crate::sac::history::History;
use crate::sac::network::SacNetwork;
use crate::sac::reader::{ReaderPass, Steps};
use crate::sac::settings::ContextSettings;
use crate::sac::squashed;
use crate::stage::Stage;
use crate::trunk::TrunkPass;

/// Samples of one inference chunk: a batch of 20 environments then occupies several threads.
const INFERENCE_CHUNK: usize = 4;

/// A [`SacNetwork`] with its parameters: actions in (-1, 1) that are the tanh of a Gaussian, exactly
/// equivariant under the group of its settings. With a context it remembers the last steps of each
/// episode.
///
/// A clone has parameters of its own and shares the (immutable) network. Batches run in fixed
/// chunks on the current rayon pool; actions and features have the same bits for any number of
/// threads.
pub struct SacPolicy {
    network: Arc<SacNetwork<f32>>,
    params: Vec<f32>,
    chunks: Chunks<f32, Inference>,
    /// For each sample mean and log_std `[2 A]`, then what a context remembers of it.
    outputs: Vec<f64>,
}

/// Buffers of one inference chunk.
struct Inference {
    trunk: TrunkPass<f32>,
    before: Steps<f32>,
    reader: ReaderPass<f32>,
    actor: Stage<f32>,
}

impl SacPolicy {
    /// Builds the network for `spec` and draws its parameters from the stream of `seed`.
    ///
    /// # Errors
    /// Those of [`SacNetwork::new`].
    pub fn new(
        settings: &NetworkSettings,
        context: Option<ContextSettings>,
        spec: &EnvSpec,
        seed: u64,
    ) -> Result<Self, RlError> {
        let network = SacNetwork::new(settings, context, spec)?;
        let params = network.init(&mut ChaCha8Rng::seed_from_u64(seed));
        Ok(Self::assemble(Arc::new(network), params))
    }

    /// Builds the network for `spec` with the given flat parameters, as [`SacPolicy::params`]
    /// returned them.
    ///
    /// # Errors
    /// Those of [`SacNetwork::new`], [`RlError::Parameters`] when the number of parameters differs
    /// and [`RlError::NotFinite`] when one is infinite or not a number.
    pub fn with_params(
        settings: &NetworkSettings,
        context: Option<ContextSettings>,
        spec: &EnvSpec,
        params: Vec<f32>,
    ) -> Result<Self, RlError> {
        let network = SacNetwork::new(settings, context, spec)?;
        check_params(params.len(), network.num_params())?;
        check_all_finite("a parameter", &params)?;
        Ok(Self::assemble(Arc::new(network), params))
    }

    fn assemble(network: Arc<SacNetwork<f32>>, params: Vec<f32>) -> Self {
        let builder = Arc::clone(&network);
        let chunks = Chunks::new(0, INFERENCE_CHUNK, move || Inference::new(&builder));
        Self {
            network,
            params,
            chunks,
            outputs: Vec::new(),
        }
    }

    /// The network.
    pub fn network(&self) -> &Arc<SacNetwork<f32>> {
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

    /// A, the number of action components.
    fn width(&self) -> usize {
        self.network.spec().action.len()
    }

    /// Fills `outputs` and lets the memory keep what was seen; returns the length of a row.
    fn run(
        &mut self,
        observations: &Observations,
        memory: &mut History,
        (what, got): (&'static str, usize),
    ) -> Result<usize, RlError> {
        let samples = observations.samples(self.network.spec())?;
        check_len(what, "[N, A]", got, samples * self.width())?;
        let (network, params) = (&self.network, &self.params);
        let mut row = 2 * self.width();
        if network.reader.length() > 0 {
            check_len("memory", "[N]", memory.envs.len(), samples)?;
            row += network.trunk.out_type().dim();
        }
        self.outputs.resize(samples * row, 0.0);
        let remembered = &*memory;
        self.chunks
            .map_rows(&mut self.outputs, row, |range, w, rows| {
                w.see((network, params), observations, range.clone());
                w.decide((network, params), remembered, range);
                w.write(network, row, rows);
            });
        for (episode, output) in memory.envs.iter_mut().zip(self.outputs.chunks_exact(row)) {
            let seen = output[2 * self.network.spec().action.len()..].iter();
            episode.seen.clear();
            episode.seen.extend(seen.map(|&x| x as f32));
        }
        Ok(row)
    }
}

impl Inference {
    fn new(network: &SacNetwork<f32>) -> Self {
        Self {
            trunk: network.trunk.pass(INFERENCE_CHUNK),
            before: Steps::default(),
            reader: network.reader.pass(INFERENCE_CHUNK),
            actor: Stage::new(&network.actor, INFERENCE_CHUNK),
        }
    }

    /// Computes the fields of a range of observations.
    fn see(
        &mut self,
        (network, params): (&SacNetwork<f32>, &[f32]),
        observations: &Observations,
        range: Range<usize>,
    ) {
        let n = range.len();
        for (slot, i) in range.enumerate() {
            let (image, vector) = observations.sample(network.spec(), i);
            network.trunk.load(slot, image, vector, &mut self.trunk);
        }
        let own = &params[network.parts().trunk];
        network.trunk.forward(own, n, &mut self.trunk);
    }

    /// Runs the actor on what was seen and on what is remembered of a range of environments.
    fn decide(
        &mut self,
        (network, params): (&SacNetwork<f32>, &[f32]),
        memory: &History,
        range: Range<usize>,
    ) {
        let (parts, n) = (network.parts(), range.len());
        network.reader.clear(n, &mut self.before);
        for (slot, episode) in memory.envs.iter().skip(range.start).take(n).enumerate() {
            for step in episode.past.iter().rev() {
                let read = (&step.action[..], step.reward);
                let reader = &network.reader;
                reader.prepend(slot, &step.fields, read, &mut self.before);
            }
        }
        let fields = &self.trunk.fields()[..n * network.trunk.out_type().dim()];
        let own = &params[parts.actor_reader];
        network
            .reader
            .forward(own, fields, &self.before, &mut self.reader);
        self.actor.x.copy_from_slice(&self.reader.state);
        self.actor.forward(&network.actor, &params[parts.actor], n);
    }

    /// Writes rows of means, log_std and, where rows are longer, fields.
    fn write(&self, network: &SacNetwork<f32>, row: usize, rows: &mut [f64]) {
        let width = network.output_order.len();
        let fields = self.trunk.fields();
        let samples = fields.chunks_exact(network.trunk.out_type().dim());
        let outputs = self.actor.y.chunks_exact(width);
        for ((to, output), fields) in rows.chunks_exact_mut(row).zip(outputs).zip(samples) {
            network.natural_output(output, &mut to[..width]);
            for (to, &from) in to[width..].iter_mut().zip(fields) {
                *to = from.into();
            }
        }
    }
}

impl Actor for SacPolicy {
    type Memory = History;

    fn memory(&self, envs: usize) -> History {
        History::new(self.network.reader.length(), envs)
    }

    fn act(
        &mut self,
        observations: &Observations,
        memory: &mut History,
        rng: &mut ChaCha8Rng,
        out: &mut [f32],
    ) -> Result<(), RlError> {
        let row = self.run(observations, memory, ("actions", out.len()))?;
        let mut noise = vec![0.0; out.len()];
        standard_normals(rng, &mut noise);
        let width = self.width();
        let mut action = vec![0.0; width];
        let rows = self.outputs.chunks_exact(row);
        let out = out.chunks_exact_mut(width).zip(noise.chunks_exact(width));
        for (output, (out, noise)) in rows.zip(out) {
            squashed::sample(&output[..2 * width], noise, &mut action);
            out.iter_mut()
                .zip(&action)
                .for_each(|(o, &a)| *o = a as f32);
        }
        Ok(())
    }

    /// The tanh of the Gaussian's means.
    fn mean_actions(
        &mut self,
        observations: &Observations,
        memory: &mut History,
        out: &mut [f32],
    ) -> Result<(), RlError> {
        let row = self.run(observations, memory, ("mean actions", out.len()))?;
        let width = self.width();
        for (out, output) in out.chunks_exact_mut(width).zip(self.outputs.chunks(row)) {
            out.iter_mut()
                .zip(output)
                .for_each(|(o, mean)| *o = mean.tanh() as f32);
        }
        Ok(())
    }
}

impl Features for SacPolicy {
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
        self.chunks.map_rows(out, width, |range, w, rows| {
            let n = range.len();
            w.see((network, params), observations, range);
            network.trunk.pool(n, &mut w.trunk);
            rows.copy_from_slice(&w.trunk.features()[..n * width]);
        });
        Ok(())
    }
}

impl Clone for SacPolicy {
    fn clone(&self) -> Self {
        Self::assemble(Arc::clone(&self.network), self.params.clone())
    }
}

impl fmt::Debug for SacPolicy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("SacPolicy")
            .field("settings", self.network.settings())
            .field("context", &self.network.context())
            .field("num_params", &self.params.len())
            .finish_non_exhaustive()
    }
}
