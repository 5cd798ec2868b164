//! How active the units of an actor and of its critics are.

use equivariant::unit_sums;

use crate::activity::{Activity, Units};
use crate::env::Observations;
use crate::error::RlError;
use crate::network_policy::Chunk;
use crate::sac::history::History;
use crate::sac::network::SacNetwork;
use crate::sac::policy::{Buffers, SacPolicy};

impl Units for SacPolicy {
    /// Those of the encoder, of the actor and of both critics.
    fn activity(&self, observations: &Observations, memory: &History) -> Result<Activity, RlError> {
        let (network, params) = (self.network(), self.params());
        let samples = observations.samples(network.spec())?;
        memory.check(network.remembered(), samples)?;
        let mut w = Buffers::new(network, samples);
        network
            .trunk
            .load_all(observations, 0..samples, &mut w.trunk);
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
    network.reader.forward(
        &params[parts.reader],
        fields,
        (&w.items, &w.before),
        &mut reader,
    );
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

#[cfg(test)]
mod tests {
    use symmetry::Group;

    use super::*;
    use crate::fixtures::{kills, observations, settings, spec, strided, wake};
    use crate::policy::{Actor, Memory};
    use crate::sac::settings::ContextSettings;

    const SAMPLES: usize = 12;

    #[test]
    fn units_of_actors_with_a_context_and_of_their_critics_count() {
        let observations = observations(SAMPLES);
        let context = ContextSettings { size: 4, length: 3 };
        for (group, context) in [(Group::D2, None), (Group::C1, Some(context))] {
            let settings = settings(group, strided());
            let policy = SacPolicy::new(&settings, context, &spec(), 1).unwrap();
            let (network, params) = (policy.network(), policy.params());
            let mut memory = policy.memory(SAMPLES);
            let mut actions = vec![0.0; SAMPLES * spec().action.len()];
            let mut acting = policy.clone();
            acting
                .mean_actions(&observations, &mut memory, &mut actions)
                .unwrap();
            (0..SAMPLES).for_each(|env| memory.remember(env, &[0.5; 3], 1.0));
            let activity = |params: &[f32]| {
                let mut policy = policy.clone();
                policy.params_mut().copy_from_slice(params);
                policy.activity(&observations, &memory).unwrap()
            };
            assert_eq!(activity(params).units(), 4 * (2 + 3 + 2 + 2 + 2 * 3));
            let parts = network.parts();
            // what the actor does must not put its critics to sleep
            let mut awake = params.to_vec();
            for twin in &parts.critics.twins {
                wake(&network.critic, &mut awake[twin.clone()]);
            }
            kills(&network.actor, awake.clone(), parts.actor, activity);
            for twin in parts.critics.twins {
                kills(&network.critic, awake.clone(), twin, activity);
            }
            // what is remembered is read
            let forgotten = policy.activity(&observations, &policy.memory(SAMPLES));
            assert_eq!(forgotten.unwrap() == activity(params), context.is_none());
        }
    }
}
