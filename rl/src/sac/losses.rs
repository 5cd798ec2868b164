//! Losses of soft actor-critic over a chunk of a minibatch: encoding of the observations, and
//! forward and backward passes.

use std::ops::Range;

use equivariant::Scalar;

use crate::distributions::{sample_tanh_gaussian, tanh_gaussian_gradient};
use crate::env::transform_vector;
use crate::replay::{ReplayBuffer, ReplayStep};
use crate::sac::minibatch::{Augmentation, SacWorkspace, SampledMinibatch};
use crate::sac::network::{CriticParamRanges, SacNetwork};
use crate::sac::stats::SacSums;
use crate::trunk::TrunkWorkspace;

/// Losses of a minibatch of B steps as functions of a network's parameters, with twin critics and
/// without a value network (Haarnoja et al., arXiv 1812.05905). The critics' loss trains the
/// critics and the shared part, the actor's loss the actor. Both are means over the minibatch at
/// the same parameters, so that the shared part runs once.
#[derive(Clone, Copy)]
pub(super) struct Losses<'a, T> {
    pub network: &'a SacNetwork<T>,
    pub params: &'a [T],
    /// Parameters of the target critics.
    pub target_params: &'a [T],
    pub replay: &'a ReplayBuffer,
    pub minibatch: &'a SampledMinibatch,
    /// Discount factor of the next state's value.
    pub gamma: f64,
    /// Temperature alpha, the weight of the entropy in the actor's objective.
    pub alpha: f64,
    /// Weight of the behavioural cloning loss in the actor's loss.
    pub cloning_weight: f64,
}

impl<T: Scalar> Losses<'_, T> {
    /// Adds the share that the steps at positions `range` of the minibatch have in the gradient of
    /// its mean losses to `gradient`, and returns the sums of their loss terms.
    pub fn accumulate_chunk_gradients(
        &self,
        range: Range<usize>,
        w: &mut SacWorkspace<T>,
        gradient: &mut [T],
    ) -> SacSums {
        let (trunk, n) = (&self.network.trunk, range.len());
        self.encode_observations(&range, w);
        self.run_next_observations(&range, w);
        self.write_td_targets(&range, w);
        // the next passes overwrite the critics' buffers: only `td_targets` remains of the above
        self.run_replay_actions(&range, w);
        let mut sums = self.critic_loss(n, w);
        self.critics_backward(n, w, gradient);
        self.run_policy_actions(&range, w);
        sums.add_sums(&self.actor_loss(n, w));
        sums.cloning_loss = self.actor_backward(&range, w, gradient);
        let (own, params) = (&mut gradient[trunk.param_range()], &self.params[trunk.param_range()]);
        trunk.backward(params, n, &mut w.current, own);
        sums
    }

    /// Runs the actor at the next observations, and the target critics on its actions.
    pub fn run_next_observations(&self, range: &Range<usize>, w: &mut SacWorkspace<T>) {
        let (network, n) = (self.network, range.len());
        let (reader, ranges) = (&network.reader, network.target_param_ranges());
        let fields = &w.next_fields[..n * network.trunk.out_type().dim()];
        let own = &self.params[network.param_ranges().actor_reader];
        reader.forward(own, fields, &w.gru_inputs, &w.context_steps[1], &mut w.actor_reader);
        let critic_params = &self.target_params[ranges.reader.clone()];
        reader.forward(
            critic_params,
            fields,
            &w.gru_inputs,
            &w.context_steps[1],
            &mut w.critic_reader,
        );
        self.run_actor(range, &self.minibatch.noise[1], w);
        self.run_critics(n, self.target_params, &ranges, w);
    }

    /// Runs the critics on the replay buffer's actions at the current observations.
    fn run_replay_actions(&self, range: &Range<usize>, w: &mut SacWorkspace<T>) {
        let (network, n) = (self.network, range.len());
        let (ranges, width) = (network.param_ranges().critics, network.action_order.len());
        let fields = network.trunk.feature_fields(n, &w.current);
        let (own, reader) = (&self.params[ranges.reader.clone()], &network.reader);
        reader.forward(own, fields, &w.gru_inputs, &w.context_steps[0], &mut w.critic_reader);
        for (slot, position) in range.clone().enumerate() {
            let (step, augmentation) = self.sampled_step(position);
            let action = self.action(step, augmentation);
            let row = &mut w.actions[slot * width..(slot + 1) * width];
            row.iter_mut().zip(action).for_each(|(to, a)| *to = a.into());
        }
        self.run_critics(n, self.params, &ranges, w);
    }

    /// Runs the actor at the current observations, and the critics on its actions. The critics'
    /// reader keeps its state from [`Losses::run_replay_actions`].
    fn run_policy_actions(&self, range: &Range<usize>, w: &mut SacWorkspace<T>) {
        let (network, n) = (self.network, range.len());
        let (ranges, reader) = (network.param_ranges(), &network.reader);
        let fields = network.trunk.feature_fields(n, &w.current);
        let own = &self.params[ranges.actor_reader];
        reader.forward(own, fields, &w.gru_inputs, &w.context_steps[0], &mut w.actor_reader);
        self.run_actor(range, &self.minibatch.noise[0], w);
        self.run_critics(n, self.params, &ranges.critics, w);
    }

    /// Adds the gradient of the critics' loss with respect to their parameters to `gradient`, and
    /// writes the gradient with respect to the trunk's fields for the trunk's backward pass.
    fn critics_backward(&self, n: usize, w: &mut SacWorkspace<T>, gradient: &mut [T]) {
        let (network, ranges) = (self.network, self.network.param_ranges().critics);
        for (qf, own) in w.critics.iter_mut().zip(&ranges.twins) {
            qf.backward(&network.critic, self.params, own.clone(), n, gradient, true);
        }
        self.split_gradient(n, w);
        w.critic_reader.d_state.copy_from_slice(&w.d_state);
        let (own, dparams) = (&self.params[ranges.reader.clone()], &mut gradient[ranges.reader]);
        let reader = &network.reader;
        let d_fields = reader.backward(own, &w.gru_inputs, n, dparams, &mut w.critic_reader);
        w.current.d_feature_fields()[..d_fields.len()].copy_from_slice(d_fields);
    }

    /// Adds the gradients of the actor's loss and of behavioural cloning with respect to the
    /// actor's parameters to `gradient`; returns the cloning loss.
    fn actor_backward(
        &self,
        range: &Range<usize>,
        w: &mut SacWorkspace<T>,
        gradient: &mut [T],
    ) -> f64 {
        let (network, n, ranges) = (self.network, range.len(), self.network.param_ranges());
        for (qf, own) in w.critics.iter_mut().zip(&ranges.critics.twins) {
            // only the gradient with respect to the action is needed, not that of the critics
            let (own, unused_gradient) = (own.clone(), &mut w.unused_gradient);
            qf.backward(&network.critic, self.params, own, n, unused_gradient, true);
        }
        self.split_gradient(n, w);
        let cloning = self.output_gradient(range, w);
        let actor = &mut w.actor;
        actor.backward(&network.actor, self.params, ranges.actor, n, gradient, true);
        w.actor_reader.d_state.copy_from_slice(&actor.dx);
        let own = &self.params[ranges.actor_reader.clone()];
        let (reader, dparams) = (&network.reader, &mut gradient[ranges.actor_reader]);
        // the returned gradient of the fields is dropped: the actor does not train the encoder
        reader.backward(own, &w.gru_inputs, n, dparams, &mut w.actor_reader);
        cloning
    }

    /// Runs the actor on its context reader's output; samples actions with their log-probabilities.
    fn run_actor(&self, range: &Range<usize>, noise: &[f32], w: &mut SacWorkspace<T>) {
        let (network, n) = (self.network, range.len());
        let width = network.action_order.len();
        let own = &self.params[network.param_ranges().actor];
        w.actor.x.copy_from_slice(&w.actor_reader.state);
        w.actor.forward(&network.actor, own, n);
        network.output_in_env_order(&w.actor.y, &mut w.output);
        let noise = noise[range.start * width..range.end * width].chunks_exact(width);
        let rows = w.output.chunks_exact(2 * width).zip(noise);
        let actions = w.actions.chunks_exact_mut(width).zip(&mut w.log_pi);
        for ((output, draws), (action, log_pi)) in rows.zip(actions) {
            *log_pi = sample_tanh_gaussian(output, draws, action);
        }
    }

    /// Runs both critics on their context reader's output and the n actions.
    fn run_critics(
        &self,
        n: usize,
        params: &[T],
        ranges: &CriticParamRanges,
        w: &mut SacWorkspace<T>,
    ) {
        let network = self.network;
        let width = network.action_order.len();
        let rows = w.irrep_actions.chunks_exact_mut(width);
        for (row, action) in rows.zip(w.actions.chunks_exact(width)).take(n) {
            for (to, &i) in row.iter_mut().zip(&network.action_order) {
                *to = T::from_f64(action[i]);
            }
        }
        let state = &w.critic_reader.state[..n * network.reader.out_type().dim()];
        let [first, second] = &mut w.critics;
        let x = &mut first.x[..n * network.critic_input.out_shape().len()];
        network.critic_input.forward(state, &w.irrep_actions[..n * width], x);
        second.x[..x.len()].copy_from_slice(x);
        for (twin, own) in w.critics.iter_mut().zip(&ranges.twins) {
            twin.forward(&network.critic, &params[own.clone()], n);
        }
    }

    /// Sums the gradients with respect to both critics' inputs, and splits the sum into the
    /// gradients with respect to the context reader's output and the actions.
    fn split_gradient(&self, n: usize, w: &mut SacWorkspace<T>) {
        let network = self.network;
        let width = network.action_order.len();
        let [first, second] = &mut w.critics;
        let sum = &mut first.dx[..n * network.critic_input.out_shape().len()];
        for (total, &d) in sum.iter_mut().zip(&second.dx) {
            *total += d;
        }
        let d_state = &mut w.d_state[..n * network.reader.out_type().dim()];
        let d_actions = &mut w.irrep_actions[..n * width];
        network.critic_input.backward(sum, d_state, d_actions);
        let rows = w.d_actions.chunks_exact_mut(width);
        for (row, irreps) in rows.zip(d_actions.chunks_exact(width)) {
            for (d, &i) in irreps.iter().zip(&network.action_order) {
                row[i] = d.to_f64();
            }
        }
    }

    /// Computes the gradient of the actor's loss with respect to the actor's output from that with
    /// respect to the actions, and adds the gradient of behavioural cloning; returns the cloning
    /// loss.
    fn output_gradient(&self, range: &Range<usize>, w: &mut SacWorkspace<T>) -> f64 {
        let network = self.network;
        let width = network.action_order.len();
        let mut cloning = 0.0;
        let d_log_pi = self.alpha * self.step_weight();
        for (slot, position) in range.clone().enumerate() {
            let own = slot * width..(slot + 1) * width;
            let both = 2 * own.start..2 * own.end;
            let noise = &self.minibatch.noise[0][position * width..(position + 1) * width];
            let d_output = &mut w.d_output[both.clone()];
            let (action, d_action) = (&w.actions[own.clone()], &w.d_actions[own]);
            let output = &w.output[both];
            tanh_gaussian_gradient(output, noise, action, d_action, d_log_pi, d_output);
            let (step, augmentation) = self.sampled_step(position);
            let done = self.action(step, augmentation);
            for ((d, &mean), taken) in d_output.iter_mut().zip(output).zip(done) {
                let (mean, taken) = (mean.tanh(), f64::from(taken));
                let error = mean - taken;
                cloning += error * error;
                // d (tanh(m) - a)^2 / dm
                let slope = 2.0 * error * (1.0 - mean * mean);
                *d += self.cloning_weight * self.step_weight() * slope;
            }
        }
        let rows = w.actor.dy.chunks_exact_mut(2 * width);
        for (row, d_output) in rows.zip(w.d_output.chunks_exact(2 * width)) {
            for (dy, &i) in row.iter_mut().zip(&network.output_order) {
                *dy = T::from_f64(d_output[i]);
            }
        }
        cloning
    }
}

impl<'a, T: Scalar> Losses<'a, T> {
    /// Returns the step at a position of the minibatch, and its augmentation.
    pub fn sampled_step(&self, position: usize) -> (ReplayStep<'a>, Augmentation) {
        let (index, offset) = self.minibatch.steps[position];
        let step = self.replay.get(index).wrapping_later(offset);
        (step, self.minibatch.augmentations[position])
    }

    /// Returns the action `[A]` of a step, transformed by the augmentation's group element.
    fn action(&self, step: ReplayStep, augmentation: Augmentation) -> Vec<f32> {
        transform_vector(augmentation.element, step.action(), &self.network.spec().action_irreps)
    }

    /// Returns the weight of one step in a mean over the B steps of the minibatch, 1 / B.
    pub fn step_weight(&self) -> f64 {
        1.0 / self.minibatch.steps.len() as f64
    }

    /// Computes the trunk's fields of all observations that the steps at positions `range` need,
    /// each once, and passes the steps before them to the recurrent contexts.
    pub fn encode_observations(&self, range: &Range<usize>, w: &mut SacWorkspace<T>) {
        let (network, n) = (self.network, range.len());
        w.observation_keys.clear();
        w.observation_positions.clear();
        for (slot, position) in range.clone().enumerate() {
            let (step, augmentation) = self.sampled_step(position);
            step.write_image(&mut w.image);
            load_transformed(
                network,
                slot,
                augmentation,
                step.observation_vector(),
                &mut w.image,
                &mut w.current,
            );
            w.observation_keys.push((step.index(), augmentation));
        }
        for position in range.clone() {
            let (step, augmentation) = self.sampled_step(position);
            if let Some(slot) = w.assign_observation_slot((step.next_index(), augmentation), n) {
                step.write_next_image(&mut w.image);
                let vector = step.next_observation_vector();
                load_transformed(network, slot, augmentation, vector, &mut w.image, &mut w.others);
            }
            for earlier in earlier_steps(network, step) {
                if let Some(slot) = w.assign_observation_slot((earlier.index(), augmentation), n) {
                    earlier.write_image(&mut w.image);
                    let vector = earlier.observation_vector();
                    load_transformed(
                        network,
                        slot,
                        augmentation,
                        vector,
                        &mut w.image,
                        &mut w.others,
                    );
                }
            }
        }
        let params = &self.params[network.trunk.param_range()];
        let others = w.observation_keys.len() - n;
        network.trunk.forward(params, n, &mut w.current);
        network.trunk.forward(params, others, &mut w.others);
        self.write_context_inputs(range, w);
    }

    /// Copies the trunk's fields of the next observations, and writes the GRU inputs of the steps
    /// before each observation.
    fn write_context_inputs(&self, range: &Range<usize>, w: &mut SacWorkspace<T>) {
        let (network, n) = (self.network, range.len());
        let reader = &network.reader;
        let width = network.trunk.out_type().dim();
        let [now, next] = &mut w.context_steps;
        now.reset(reader.max_steps(), n);
        next.reset(reader.max_steps(), n);
        reader.reset_gru_inputs(w.observation_keys.len(), &mut w.gru_inputs);
        let (current, others) = (w.current.feature_fields(), w.others.feature_fields());
        let fields_of = |source: usize| match source.checked_sub(n) {
            Some(slot) => &others[slot * width..(slot + 1) * width],
            None => &current[source * width..(source + 1) * width],
        };
        let mut sources = w.observation_positions.iter().copied();
        for (slot, position) in range.clone().enumerate() {
            let own = slot * width..(slot + 1) * width;
            let (step, augmentation) = self.sampled_step(position);
            let copied = w.next_fields[own].iter_mut();
            copied.zip(fields_of(sources.next().unwrap_or_default())).for_each(|(to, &x)| *to = x);
            if reader.max_steps() == 0 {
                continue;
            }
            let (action, reward) = (self.action(step, augmentation), step.reward());
            reader.write_gru_input(slot, fields_of(slot), &action, reward, &mut w.gru_inputs);
            next.prepend(slot, slot);
            for earlier in earlier_steps(network, step) {
                let source = sources.next().unwrap_or_default();
                // steps of this chunk have written their own GRU input already, or will
                if source >= n {
                    let (earlier_action, earlier_reward) =
                        (self.action(earlier, augmentation), earlier.reward());
                    reader.write_gru_input(
                        source,
                        fields_of(source),
                        &earlier_action,
                        earlier_reward,
                        &mut w.gru_inputs,
                    );
                }
                now.prepend(slot, source);
                next.prepend(slot, source);
            }
        }
    }
}

/// Returns the steps before `step` that a recurrent context may read, the last one first.
fn earlier_steps<'r, T: Scalar>(
    network: &SacNetwork<T>,
    step: ReplayStep<'r>,
) -> impl Iterator<Item = ReplayStep<'r>> + use<'r, T> {
    (1..=network.reader.max_steps()).map_while(move |count| step.nth_step_before(count))
}

/// Loads an observation, transformed by `augmentation`, into a slot of `pass`; `image` holds its
/// pixels.
fn load_transformed<T: Scalar>(
    network: &SacNetwork<T>,
    slot: usize,
    augmentation: Augmentation,
    vector: &[f32],
    image: &mut Vec<u8>,
    pass: &mut TrunkWorkspace<T>,
) {
    let spec = network.spec();
    augmentation.transform_image(image, spec);
    let vector = transform_vector(augmentation.element, vector, &spec.vector_irreps);
    network.trunk.load_observation(slot, image, &vector, pass);
}
