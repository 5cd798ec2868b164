//! A policy: a network with its parameters, run on batches of observations.

use std::fmt;
use std::ops::Range;
use std::sync::Arc;

use equivariant::Chunks;

use crate::env::Observations;
use crate::error::{RlError, check_all_finite, check_len, check_params};
use crate::policy::Features;
use crate::trunk::{OnTrunk, OnTrunkPass, Trunk};

/// Samples of one chunk: a batch of 20 environments then occupies several threads.
const CHUNK: usize = 4;

/// A network N with its parameters, and buffers W of its passes: what
/// [`ActorCriticPolicy`](crate::ActorCriticPolicy) and [`SacPolicy`](crate::SacPolicy) have in
/// common. A clone has parameters of its own and shares the (immutable) network.
///
/// Batches run in fixed chunks on the current rayon pool; actions, values and features have the
/// same bits for any number of threads.
pub struct NetworkPolicy<N, W> {
    network: Arc<N>,
    params: Vec<f32>,
    /// Rows of numbers of the last run, one for each sample.
    pub(crate) outputs: Vec<f64>,
    buffers: fn(&N, usize) -> W,
    chunks: Chunks<f32, W>,
}

/// The samples in `range` of a batch, which lie in the slots from 0 on.
pub(crate) struct Chunk<'a, N> {
    pub network: &'a N,
    pub params: &'a [f32],
    pub range: Range<usize>,
}

impl<N, W> NetworkPolicy<N, W> {
    /// The network.
    pub fn network(&self) -> &Arc<N> {
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
}

impl<N, W> NetworkPolicy<N, W>
where
    N: OnTrunk<f32> + Send + Sync + 'static,
    W: OnTrunkPass<f32> + Send + 'static,
{
    /// `buffers` makes those for chunks of up to a number of samples.
    pub(crate) fn of(network: Arc<N>, params: Vec<f32>, buffers: fn(&N, usize) -> W) -> Self {
        let builder = Arc::clone(&network);
        Self {
            network,
            params,
            outputs: Vec::new(),
            buffers,
            chunks: Chunks::new(0, CHUNK, move || buffers(&builder, CHUNK)),
        }
    }

    fn trunk(&self) -> &Trunk<f32> {
        self.network.trunk()
    }

    /// A, the number of action components.
    pub(crate) fn width(&self) -> usize {
        self.trunk().spec.action.len()
    }

    /// Lets `forward` fill a row of `outputs`, of this length, for each of N observations; returns
    /// N.
    pub(crate) fn infer(
        &mut self,
        observations: &Observations,
        row: usize,
        forward: impl Fn(Chunk<N>, &mut W, &mut [f64]) + Sync,
    ) -> Result<usize, RlError> {
        let (network, params) = (&*self.network, &self.params[..]);
        let trunk = network.trunk();
        let samples = observations.samples(&trunk.spec)?;
        self.outputs.resize(samples * row, 0.0);
        self.chunks
            .map_rows(&mut self.outputs, row, |range, buffers, rows| {
                trunk.load_all(observations, range.clone(), buffers.trunk());
                let chunk = Chunk {
                    network,
                    params,
                    range,
                };
                forward(chunk, buffers, rows);
            });
        Ok(samples)
    }
}

impl<N, W> Features for NetworkPolicy<N, W>
where
    N: OnTrunk<f32> + Send + Sync + 'static,
    W: OnTrunkPass<f32> + Send + 'static,
{
    fn feature_dim(&self) -> usize {
        self.trunk().feature_dim()
    }

    fn features(&mut self, observations: &Observations, out: &mut [f32]) -> Result<(), RlError> {
        let trunk = self.trunk();
        let (samples, width) = (observations.samples(&trunk.spec)?, self.feature_dim());
        check_len("features", "[N, F]", out.len(), samples * width)?;
        let params = &self.params[trunk.params()];
        self.chunks.map_rows(out, width, |range, buffers, rows| {
            let (n, pass) = (range.len(), buffers.trunk());
            trunk.load_all(observations, range, pass);
            trunk.forward(params, n, pass);
            trunk.pool(n, pass);
            rows.copy_from_slice(&pass.features()[..n * width]);
        });
        Ok(())
    }
}

impl<N: OnTrunk<f32>, W> fmt::Debug for NetworkPolicy<N, W> {
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
    N: OnTrunk<f32> + Send + Sync + 'static,
    W: OnTrunkPass<f32> + Send + 'static,
{
    fn clone(&self) -> Self {
        Self::of(Arc::clone(&self.network), self.params.clone(), self.buffers)
    }
}

/// Refuses parameters of another network, and such that are no numbers: later those would only show
/// as a loss that is not finite.
pub(crate) fn check_saved(params: &[f32], expected: usize) -> Result<(), RlError> {
    check_params(params.len(), expected)?;
    check_all_finite("a parameter", params)
}
