//! How active the units of an actor and of its critics are.

use equivariant::{Signature, unit_sums};

use crate::activity::{Activity, Units};
use crate::env::Observations;
use crate::error::RlError;
use crate::inference::Chunk;
use crate::sac::history::History;
use crate::sac::network::SacNetwork;
use crate::sac::policy::{Buffers, SacPolicy};

impl Units for SacPolicy {
    /// Those of the encoder, of the actor and of both critics.
    fn activity(
        &self,
        observations: &Observations,
        memory: &History,
    ) -> Result<Activity, RlError> {
        let (network, params) = (self.network(), self.params());
        let samples = observations.samples(network.spec())?;
        memory.check(network.remembered(), samples)?;
        let mut w = Buffers::new(network, samples);
        network.trunk.load_all(observations, 0..samples, &mut w.trunk);
        let chunk = Chunk {
            network: &**network,
            params,
            range: 0..samples,
        };
        w.decide(&chunk, memory);
        let own = &params[network.trunk.params()];
        let mut sums = network.trunk.unit_sums(own, samples, &w.trunk);
        let own = &params[network.parts().actor];
        sums.extend(w.actor.unit_sums(&network.actor, own, samples));
        sums.extend(critics(&chunk, &w));
        Ok(Activity::of(sums))
    }
}

/// Sums of what the units of both critics put out for the mean actions that were decided on.
fn critics(chunk: &Chunk<SacNetwork<f32>>, w: &Buffers) -> Vec<Vec<f64>> {
    let (network, params, n) = (chunk.network, chunk.params, chunk.range.len());
    let (parts, width) = (network.parts().critics, network.action_order.len());
    let mut reader = network.reader.pass(n);
    let fields = network.trunk.fields(n, &w.trunk);
    network
        .reader
        .forward(&params[parts.reader], fields, &w.before, &mut reader);
    let mut output = vec![0.0; n * 2 * width];
    network.natural_output(&w.actor.y, &mut output);
    let actions: Vec<f32> = output
        .chunks_exact(2 * width)
        .flat_map(|row| network.action_order.iter().map(|&i| row[i].tanh() as f32))
        .collect();
    let mut x = vec![0.0; n * network.joined.out_shape().len()];
    network.joined.forward(&reader.state, &actions, &mut x);
    let twins = parts.twins.into_iter();
    twins
        .flat_map(|own| unit_sums(&network.critic, &params[own], &x))
        .collect()
}
