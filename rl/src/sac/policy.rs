//! The tanh-Gaussian policy of soft actor-critic.

use std::collections::VecDeque;
use std::sync::Arc;

use equivariant::absolute_activation_sums;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::activity::{MeasureUnitActivity, UnitActivity};
use crate::distributions::{
    TANH_LOG_STD_BOUNDS, sample_tanh_gaussian, squash_log_std, standard_normals,
};
use crate::env::{EnvSpec, Observations};
use crate::error::{RlError, check_len};
use crate::export::{
    ChannelBasis, ExportPolicy, ExportedActionDistribution, ExportedPolicy, PolicyOutput,
    export_layers, export_trunk,
};
use crate::network_policy::{Chunk, NetworkPolicy, check_saved_params};
use crate::network_settings::NetworkSettings;
use crate::policy::{Actor, ActorMemory};
use crate::sac::context::{ContextSteps, ContextWorkspace, GruInputs};
use crate::sac::network::SacNetwork;
use crate::sac::settings::RecurrentContextSettings;
use crate::trunk::{HasTrunkWorkspace, LayerWorkspace, TrunkWorkspace};

/// A [`SacNetwork`] with its parameters: a policy with tanh-Gaussian actions in (-1, 1), exactly
/// equivariant under the group of its settings. With a context it remembers the last steps of each
/// episode.
pub type SacPolicy = NetworkPolicy<SacNetwork<f32>, SacForwardWorkspace>;

/// Buffers of a [`SacPolicy`]'s forward pass over one chunk, the observations that a thread
/// processes at a time.
pub struct SacForwardWorkspace {
    pub(super) trunk: TrunkWorkspace<f32>,
    pub(super) gru_inputs: GruInputs<f32>,
    pub(super) context_steps: ContextSteps,
    reader: ContextWorkspace<f32>,
    pub(super) actor: LayerWorkspace<f32>,
}

impl SacPolicy {
    /// Builds the network for `spec` and samples its initial parameters with a generator seeded by
    /// `seed`.
    ///
    /// # Errors
    /// Errors of [`SacNetwork::new`].
    pub fn new(
        settings: &NetworkSettings,
        context: Option<RecurrentContextSettings>,
        spec: &EnvSpec,
        seed: u64,
    ) -> Result<Self, RlError> {
        let network = SacNetwork::new(settings, context, spec)?;
        let params = network.init_params(&mut ChaCha8Rng::seed_from_u64(seed));
        Ok(Self::from_network(Arc::new(network), params, SacForwardWorkspace::new))
    }

    /// Builds the network for `spec` with the given flat parameters, as [`SacPolicy::params`]
    /// returned them.
    ///
    /// # Errors
    /// Errors of [`SacNetwork::new`], [`RlError::ParameterCountMismatch`] when the number of
    /// parameters differs and [`RlError::NotFinite`] when one is infinite or not a number.
    pub fn with_params(
        settings: &NetworkSettings,
        context: Option<RecurrentContextSettings>,
        spec: &EnvSpec,
        params: Vec<f32>,
    ) -> Result<Self, RlError> {
        let network = SacNetwork::new(settings, context, spec)?;
        check_saved_params(&params, network.num_params())?;
        Ok(Self::from_network(Arc::new(network), params, SacForwardWorkspace::new))
    }

    /// Writes the actions `[N, A]` that follow from the standard normal `noise` `[N, A]`. The noise
    /// is the only source of randomness. With independent noise, actions are distributed like those
    /// of [`Actor::act`].
    ///
    /// # Errors
    /// [`RlError::ShapeMismatch`] when an array does not fit.
    pub fn act_with_noise(
        &mut self,
        observations: &Observations,
        memory: &mut SacActorMemory,
        noise: &[f32],
        out: &mut [f32],
    ) -> Result<(), RlError> {
        check_len("noise", "[N, A]", noise.len(), out.len())?;
        let row = self.run(observations, memory, "actions", out.len())?;
        let width = self.action_dim();
        let mut action = vec![0.0; width];
        let samples = noise.chunks_exact(width).zip(out.chunks_exact_mut(width));
        for (output, (own_noise, target)) in self.outputs.chunks_exact(row).zip(samples) {
            sample_tanh_gaussian(&output[..2 * width], own_noise, &mut action);
            target.iter_mut().zip(&action).for_each(|(o, &a)| *o = a as f32);
        }
        Ok(())
    }

    /// Runs the network on N observations: fills `outputs` with rows `[2 A + h]` of mean, raw
    /// log_std and the h fields that a context remembers, which are also stored in `memory`;
    /// returns the length of a row. `what` and `got` are name and length of the caller's output
    /// array.
    fn run(
        &mut self,
        observations: &Observations,
        memory: &mut SacActorMemory,
        what: &'static str,
        got: usize,
    ) -> Result<usize, RlError> {
        let (network, width) = (self.network(), self.action_dim());
        let samples = observations.checked_num_samples(network.spec())?;
        check_len(what, "[N, A]", got, samples * width)?;
        memory.check(network.memory_sizes(), samples)?;
        let row = 2 * width + memory.fields;
        let remembered = &*memory;
        let forward =
            |chunk: Chunk<SacNetwork<f32>>, w: &mut SacForwardWorkspace, rows: &mut [f64]| {
                w.decide(&chunk, remembered);
                w.write(chunk.network, row, rows);
            };
        self.infer(observations, row, forward)?;
        let outputs = self.outputs.chunks_exact(row);
        for (episode, output) in memory.envs.iter_mut().zip(outputs) {
            episode.last_fields.clear();
            episode.last_fields.extend(output[2 * width..].iter().map(|&x| x as f32));
        }
        Ok(row)
    }
}

impl SacForwardWorkspace {
    pub fn new(network: &SacNetwork<f32>, capacity: usize) -> Self {
        Self {
            trunk: network.trunk.new_workspace(capacity),
            gru_inputs: GruInputs::default(),
            context_steps: ContextSteps::default(),
            reader: network.reader.new_workspace(capacity),
            actor: LayerWorkspace::new(&network.actor, capacity),
        }
    }

    /// Computes the actor's outputs for the loaded observations of a range of environments and the
    /// steps that `memory` holds of their episodes.
    pub(super) fn decide(&mut self, chunk: &Chunk<SacNetwork<f32>>, memory: &SacActorMemory) {
        let Chunk { network, range, .. } = chunk;
        let (ranges, n) = (network.param_ranges(), range.len());
        let of = |part| &chunk.params[part];
        network.trunk.forward(of(network.trunk.param_range()), n, &mut self.trunk);
        self.load_memory(chunk, memory);
        let fields = network.trunk.feature_fields(n, &self.trunk);
        let own = of(ranges.actor_reader);
        let (inputs, steps) = (&self.gru_inputs, &self.context_steps);
        network.reader.forward(own, fields, inputs, steps, &mut self.reader);
        self.actor.x.copy_from_slice(&self.reader.state);
        self.actor.forward(&network.actor, of(ranges.actor), n);
    }

    /// Passes the remembered steps of a range of environments to the GRU of the context.
    fn load_memory(&mut self, chunk: &Chunk<SacNetwork<f32>>, memory: &SacActorMemory) {
        let (reader, range) = (&chunk.network.reader, chunk.range.clone());
        let episodes = || memory.envs.iter().skip(range.start).take(range.len());
        let count = episodes().map(|episode| episode.past_steps.len()).sum();
        reader.reset_gru_inputs(count, &mut self.gru_inputs);
        self.context_steps.reset(reader.max_steps(), range.len());
        let mut index = 0;
        for (slot, episode) in episodes().enumerate() {
            for step in episode.past_steps.iter().rev() {
                let (action, reward) = (&step.action[..], step.reward);
                reader.write_gru_input(index, &step.fields, action, reward, &mut self.gru_inputs);
                self.context_steps.prepend(slot, index);
                index += 1;
            }
        }
    }

    /// Writes a row of `row` numbers for each observation: mean, raw log_std and, if `row` is
    /// longer, fields.
    fn write(&self, network: &SacNetwork<f32>, row: usize, rows: &mut [f64]) {
        let width = network.output_order.len();
        let fields = self.trunk.feature_fields();
        let samples = fields.chunks_exact(network.trunk.out_type().dim());
        let outputs = self.actor.y.chunks_exact(width);
        for ((to, output), sample) in rows.chunks_exact_mut(row).zip(outputs).zip(samples) {
            network.output_in_env_order(output, &mut to[..width]);
            for (entry, &from) in to[width..].iter_mut().zip(sample) {
                *entry = from.into();
            }
        }
    }
}

impl HasTrunkWorkspace<f32> for SacForwardWorkspace {
    fn trunk(&mut self) -> &mut TrunkWorkspace<f32> {
        &mut self.trunk
    }
}

impl Actor for SacPolicy {
    type Memory = SacActorMemory;

    fn new_memory(&self, envs: usize) -> SacActorMemory {
        SacActorMemory::new(self.network().memory_sizes(), envs)
    }

    fn act(
        &mut self,
        observations: &Observations,
        memory: &mut SacActorMemory,
        rng: &mut ChaCha8Rng,
        out: &mut [f32],
    ) -> Result<(), RlError> {
        let mut noise = vec![0.0; out.len()];
        standard_normals(rng, &mut noise);
        self.act_with_noise(observations, memory, &noise, out)
    }

    /// Writes the tanh of the Gaussian's means, `[N, A]`, to `out`.
    fn mean_actions(
        &mut self,
        observations: &Observations,
        memory: &mut SacActorMemory,
        out: &mut [f32],
    ) -> Result<(), RlError> {
        let row = self.run(observations, memory, "mean actions", out.len())?;
        let width = self.action_dim();
        for (target, output) in out.chunks_exact_mut(width).zip(self.outputs.chunks(row)) {
            target.iter_mut().zip(output).for_each(|(o, mean)| *o = mean.tanh() as f32);
        }
        Ok(())
    }
}

impl ExportPolicy for SacPolicy {
    fn export(&self) -> Result<ExportedPolicy, RlError> {
        let (network, params) = (self.network(), self.params());
        if network.context_settings().is_some() {
            let part = "a context, which remembers an episode,";
            return Err(RlError::NotExportable { part });
        }
        let trunk = export_trunk(&network.trunk, params)?;
        let group = network.settings().group;
        let bases = [trunk.joined, ChannelBasis::Environment(&network.output_order)];
        let actor = &params[network.param_ranges().actor];
        Ok(ExportedPolicy {
            spec: network.spec().clone(),
            order: group.order(),
            actor: export_layers(group, &network.actor, actor, bases)?,
            image: trunk.image,
            vector: trunk.vector,
            distribution: ExportedActionDistribution::TanhGaussian {
                log_std: TANH_LOG_STD_BOUNDS.map(|bound| bound as f32),
            },
            critic: None,
        })
    }

    fn reference_output(&mut self, observations: &Observations) -> Result<PolicyOutput, RlError> {
        if self.network().context_settings().is_some() {
            return Err(RlError::NeedsEpisode);
        }
        let samples = observations.checked_num_samples(self.network().spec())?;
        let width = self.action_dim();
        let mut actions = vec![0.0; samples * width];
        let mut memory = self.new_memory(samples);
        self.mean_actions(observations, &mut memory, &mut actions)?;
        let rows = self.outputs.chunks_exact((self.outputs.len() / samples.max(1)).max(1));
        let raws = rows.flat_map(|row| &row[width..2 * width]);
        Ok(PolicyOutput {
            actions,
            log_std: raws.map(|&raw| squash_log_std(raw).0 as f32).collect(),
            values: None,
        })
    }
}

/// Memory of a [`SacPolicy`]: the last steps of the running episodes of N environments; empty
/// without a context.
///
/// Checkpoints do not contain it: a learner restored from a file starts new episodes, with
/// [`RolloutState::from_env_reset`](crate::RolloutState::from_env_reset).
#[derive(Clone, Debug, Default, PartialEq)]
pub struct SacActorMemory {
    /// Maximum number of steps that are remembered of each episode.
    length: usize,
    /// Number of components of the fields h of one observation; 0 without a context.
    pub(super) fields: usize,
    pub(super) envs: Vec<EpisodeMemory>,
}

/// Memory of one running episode of a [`SacPolicy`] with a context.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct EpisodeMemory {
    /// Last steps of the episode that the policy remembers, the oldest first.
    pub past_steps: VecDeque<PastStep>,
    /// Fields h of the last observation that the policy decided on, until the step is complete.
    pub last_fields: Vec<f32>,
}

/// A remembered step of an episode: its observation's fields h, its action and its reward.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct PastStep {
    pub fields: Vec<f32>,
    pub action: Vec<f32>,
    pub reward: f32,
}

impl SacActorMemory {
    /// Creates a memory of up to `length` steps, with `fields` components each, for each of `envs`
    /// environments.
    pub(super) fn new([length, fields]: [usize; 2], envs: usize) -> Self {
        let envs = if length == 0 { 0 } else { envs };
        Self { length, fields, envs: vec![EpisodeMemory::default(); envs] }
    }

    /// Rejects a memory made for a network of other sizes or another number of environments.
    pub(super) fn check(&self, [length, fields]: [usize; 2], envs: usize) -> Result<(), RlError> {
        check_len("steps of memory", "[L]", self.length, length)?;
        check_len("fields of memory", "[h]", self.fields, fields)?;
        let envs = if length == 0 { 0 } else { envs };
        check_len("memory", "[N]", self.envs.len(), envs)
    }
}

impl ActorMemory for SacActorMemory {
    fn forget_episode(&mut self, env: usize) {
        if let Some(episode) = self.envs.get_mut(env) {
            *episode = EpisodeMemory::default();
        }
    }

    fn remember_step(&mut self, env: usize, action: &[f32], reward: f32) {
        let Some(episode) = self.envs.get_mut(env) else {
            return;
        };
        // nothing was decided since the last step
        if episode.last_fields.is_empty() {
            return;
        }
        if episode.past_steps.len() == self.length {
            episode.past_steps.pop_front();
        }
        episode.past_steps.push_back(PastStep {
            fields: std::mem::take(&mut episode.last_fields),
            action: action.to_vec(),
            reward,
        });
    }
}

impl MeasureUnitActivity for SacPolicy {
    /// Returns the activations of the encoder, the actor and both critics.
    fn unit_activity(
        &self,
        observations: &Observations,
        memory: &SacActorMemory,
    ) -> Result<UnitActivity, RlError> {
        let (network, params) = (self.network(), self.params());
        let samples = observations.checked_num_samples(network.spec())?;
        memory.check(network.memory_sizes(), samples)?;
        let mut w = SacForwardWorkspace::new(network, samples);
        network.trunk.load_observations(observations, 0..samples, &mut w.trunk);
        let chunk = Chunk { network: &**network, params, range: 0..samples };
        w.decide(&chunk, memory);
        let own = &params[network.trunk.param_range()];
        let mut sums = network.trunk.unit_activation_sums(own, samples, &w.trunk);
        let actor = &params[network.param_ranges().actor];
        sums.extend(w.actor.unit_activation_sums(&network.actor, actor, samples));
        sums.extend(critic_activation_sums(&chunk, &w));
        Ok(UnitActivity::from_layer_sums(sums))
    }
}

/// Returns the sum of the outputs of each ReLU unit of both critics at the mean actions.
fn critic_activation_sums(
    chunk: &Chunk<SacNetwork<f32>>,
    w: &SacForwardWorkspace,
) -> Vec<Vec<f64>> {
    let (network, params, n) = (chunk.network, chunk.params, chunk.range.len());
    let (ranges, width) = (network.param_ranges().critics, network.action_order.len());
    let mut reader = network.reader.new_workspace(n);
    let fields = network.trunk.feature_fields(n, &w.trunk);
    let own = &params[ranges.reader];
    network.reader.forward(own, fields, &w.gru_inputs, &w.context_steps, &mut reader);
    let mut output = vec![0.0; n * 2 * width];
    network.output_in_env_order(&w.actor.y, &mut output);
    let actions: Vec<f32> = output
        .chunks_exact(2 * width)
        .flat_map(|row| network.action_order.iter().map(|&i| row[i].tanh() as f32))
        .collect();
    let mut x = vec![0.0; n * network.critic_input.out_shape().len()];
    network.critic_input.forward(&reader.state, &actions, &mut x);
    let critic = |range| absolute_activation_sums(&network.critic, &params[range], &x);
    ranges.twins.into_iter().flat_map(critic).collect()
}

#[cfg(test)]
mod tests {
    use symmetry::Group;

    use super::*;
    use crate::fixtures::{
        activate_units, check_killed_units, observations, settings, spec, strided,
    };
    use crate::policy::{Actor, ActorMemory};
    use crate::sac::settings::RecurrentContextSettings;

    const SAMPLES: usize = 12;

    #[test]
    fn units_of_actors_with_a_context_and_of_their_critics_count() {
        let observations = observations(SAMPLES);
        let short_context = RecurrentContextSettings { size: 4, length: 3 };
        for (group, context) in [(Group::D2, None), (Group::C1, Some(short_context))] {
            let settings = settings(group, strided());
            let policy = SacPolicy::new(&settings, context, &spec(), 1).unwrap();
            let (network, params) = (policy.network(), policy.params());
            let mut memory = policy.new_memory(SAMPLES);
            let mut actions = vec![0.0; SAMPLES * spec().action_irreps.len()];
            let mut acting = policy.clone();
            acting.mean_actions(&observations, &mut memory, &mut actions).unwrap();
            (0..SAMPLES).for_each(|env| memory.remember_step(env, &[0.5; 3], 1.0));
            let activity = |given: &[f32]| {
                let mut policy = policy.clone();
                policy.params_mut().copy_from_slice(given);
                policy.unit_activity(&observations, &memory).unwrap()
            };
            assert_eq!(activity(params).num_units(), 4 * (2 + 3 + 2 + 2 + 2 * 3));
            let ranges = network.param_ranges();
            // actions of a changed actor must not make units of the critics dormant
            let mut awake = params.to_vec();
            for twin in &ranges.critics.twins {
                activate_units(&network.critic, &mut awake[twin.clone()]);
            }
            check_killed_units(&network.actor, awake.clone(), ranges.actor, activity);
            for twin in ranges.critics.twins {
                check_killed_units(&network.critic, awake.clone(), twin, activity);
            }
            // a context reads the memory
            let forgotten = policy.unit_activity(&observations, &policy.new_memory(SAMPLES));
            assert_eq!(forgotten.unwrap() == activity(params), context.is_none());
        }
    }
}
