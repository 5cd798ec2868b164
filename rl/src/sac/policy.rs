//! The tanh-Gaussian policy: a network with its parameters.

use std::sync::Arc;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::env::{EnvSpec, Observations};
use crate::error::{RlError, check_len};
use crate::gaussian::standard_normals;
use crate::network_policy::{Chunk, NetworkPolicy, check_saved};
use crate::network_settings::NetworkSettings;
use crate::plain::{self, Answers, Distribution, End, Plain, PlainPolicy, chain};
use crate::policy::Actor;
use crate::sac::history::History;
use crate::sac::network::SacNetwork;
use crate::sac::reader::{Items, ReaderPass, Steps};
use crate::sac::settings::ContextSettings;
use crate::sac::squashed;
use crate::stage::Stage;
use crate::trunk::{OnTrunkPass, TrunkPass};

/// A [`SacNetwork`] with its parameters: actions in (-1, 1) that are the tanh of a Gaussian,
/// exactly equivariant under the group of its settings. With a context it remembers the last steps
/// of each episode.
pub type SacPolicy = NetworkPolicy<SacNetwork<f32>, Buffers>;

/// Buffers of one chunk.
pub struct Buffers {
    pub(super) trunk: TrunkPass<f32>,
    pub(super) items: Items<f32>,
    pub(super) before: Steps,
    reader: ReaderPass<f32>,
    pub(super) actor: Stage<f32>,
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
        Ok(Self::of(Arc::new(network), params, Buffers::new))
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
        check_saved(&params, network.num_params())?;
        Ok(Self::of(Arc::new(network), params, Buffers::new))
    }

    /// Fills the outputs with rows of mean and log_std `[2 A]`, then what a context remembers of a
    /// sample, and lets the memory keep what was seen; returns the length of a row.
    fn run(
        &mut self,
        observations: &Observations,
        memory: &mut History,
        (what, got): (&'static str, usize),
    ) -> Result<usize, RlError> {
        let (network, width) = (self.network(), self.width());
        let samples = observations.samples(network.spec())?;
        check_len(what, "[N, A]", got, samples * width)?;
        memory.check(network.remembered(), samples)?;
        let row = 2 * width + memory.fields;
        let remembered = &*memory;
        let forward = |chunk: Chunk<SacNetwork<f32>>, w: &mut Buffers, rows: &mut [f64]| {
            w.decide(&chunk, remembered);
            w.write(chunk.network, row, rows);
        };
        self.infer(observations, row, forward)?;
        let outputs = self.outputs.chunks_exact(row);
        for (episode, output) in memory.envs.iter_mut().zip(outputs) {
            let seen = output[2 * width..].iter();
            episode.seen.clear();
            episode.seen.extend(seen.map(|&x| x as f32));
        }
        Ok(row)
    }
}

impl Buffers {
    pub fn new(network: &SacNetwork<f32>, capacity: usize) -> Self {
        Self {
            trunk: network.trunk.pass(capacity),
            items: Items::default(),
            before: Steps::default(),
            reader: network.reader.pass(capacity),
            actor: Stage::new(&network.actor, capacity),
        }
    }

    /// Runs the actor on what is shown to a range of environments and on what is remembered of
    /// them.
    pub(super) fn decide(&mut self, chunk: &Chunk<SacNetwork<f32>>, memory: &History) {
        let Chunk { network, range, .. } = chunk;
        let (parts, n) = (network.parts(), range.len());
        let of = |part| &chunk.params[part];
        network
            .trunk
            .forward(of(network.trunk.params()), n, &mut self.trunk);
        self.recall(chunk, memory);
        let fields = network.trunk.fields(n, &self.trunk);
        let own = of(parts.actor_reader);
        let read = (&self.items, &self.before);
        network.reader.forward(own, fields, read, &mut self.reader);
        self.actor.x.copy_from_slice(&self.reader.state);
        self.actor.forward(&network.actor, of(parts.actor), n);
    }

    /// Hands what is remembered of a range of environments to the contexts.
    fn recall(&mut self, chunk: &Chunk<SacNetwork<f32>>, memory: &History) {
        let (reader, range) = (&chunk.network.reader, chunk.range.clone());
        let episodes = || memory.envs.iter().skip(range.start).take(range.len());
        let count = episodes().map(|episode| episode.past.len()).sum();
        reader.clear(count, &mut self.items);
        self.before.clear(reader.length(), range.len());
        let mut index = 0;
        for (slot, episode) in episodes().enumerate() {
            for step in episode.past.iter().rev() {
                let read = (&step.action[..], step.reward);
                reader.write(index, &step.fields, read, &mut self.items);
                self.before.prepend(slot, index);
                index += 1;
            }
        }
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

impl OnTrunkPass<f32> for Buffers {
    fn trunk(&mut self) -> &mut TrunkPass<f32> {
        &mut self.trunk
    }
}

impl Actor for SacPolicy {
    type Memory = History;

    fn memory(&self, envs: usize) -> History {
        History::new(self.network().remembered(), envs)
    }

    fn act(
        &mut self,
        observations: &Observations,
        memory: &mut History,
        rng: &mut ChaCha8Rng,
        out: &mut [f32],
    ) -> Result<(), RlError> {
        let row = self.run(observations, memory, ("actions", out.len()))?;
        standard_normals(rng, out);
        let width = self.width();
        let mut action = vec![0.0; width];
        let rows = self.outputs.chunks_exact(row);
        for (output, out) in rows.zip(out.chunks_exact_mut(width)) {
            squashed::sample(&output[..2 * width], out, &mut action);
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

impl Plain for SacPolicy {
    fn plain(&self) -> Result<PlainPolicy, RlError> {
        let (network, params) = (self.network(), self.params());
        if network.context().is_some() {
            let part = "a context, which remembers an episode,";
            return Err(RlError::NotPlain { part });
        }
        let trunk = plain::trunk(&network.trunk, params)?;
        let group = network.settings().group;
        let ends = [trunk.joined, End::Natural(&network.output_order)];
        let actor = &params[network.parts().actor];
        Ok(PlainPolicy {
            spec: network.spec().clone(),
            order: group.order(),
            actor: chain(group, &network.actor, actor, ends)?,
            image: trunk.image,
            vector: trunk.vector,
            distribution: Distribution::TanhGaussian {
                log_std: squashed::LOG_STD.map(|bound| bound as f32),
            },
            critic: None,
        })
    }

    fn answers(&mut self, observations: &Observations) -> Result<Answers, RlError> {
        let samples = observations.samples(self.network().spec())?;
        let width = self.width();
        let mut actions = vec![0.0; samples * width];
        let mut memory = self.memory(samples);
        self.mean_actions(observations, &mut memory, &mut actions)?;
        let rows = self
            .outputs
            .chunks_exact(self.outputs.len() / samples.max(1));
        let raws = rows.flat_map(|row| &row[width..2 * width]);
        Ok(Answers {
            actions,
            log_std: raws.map(|&raw| squashed::log_std(raw).0 as f32).collect(),
            values: None,
        })
    }
}
