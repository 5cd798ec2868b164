//! Forward and backward passes of soft actor-critic over a chunk of a minibatch.

use std::ops::Range;

use equivariant::Scalar;

use crate::distributions::{sample_tanh_gaussian, tanh_gaussian_gradient};
use crate::sac::minibatch::{Batch, SacWorkspace};
use crate::sac::network::{CriticParts, SacNetwork};
use crate::sac::stats::SacSums;

/// Losses of a minibatch as functions of a network's parameters, with twin critics and without a
/// value network (Haarnoja et al., arXiv 1812.05905). The critics' loss trains the critics and the
/// shared part, the actor's loss the actor. Both are means over the minibatch at the same
/// parameters, so that the shared part runs once.
#[derive(Clone, Copy)]
pub(super) struct Losses<'a, T> {
    pub network: &'a SacNetwork<T>,
    pub params: &'a [T],
    /// Parameters of the target critics.
    pub targets: &'a [T],
    pub batch: Batch<'a>,
}

impl<T: Scalar> Losses<'_, T> {
    /// Runs the network forward and backward on the steps at positions `range` of the minibatch.
    /// Adds their share of the gradient to `gradient` and returns the sums of their loss terms.
    pub fn chunk(
        &self,
        range: Range<usize>,
        w: &mut SacWorkspace<T>,
        gradient: &mut [T],
    ) -> SacSums {
        let (trunk, n) = (&self.network.trunk, range.len());
        self.batch.load(self.network, self.params, &range, w);
        self.run_next(&range, w);
        self.next_q_values(&range, w);
        // the next passes overwrite the critics' buffers: only `next_q_values` remains of the above
        self.run_stored(&range, w);
        let mut sums = self.critic_loss(n, w);
        self.critics_backward(n, w, gradient);
        self.run_current(&range, w);
        sums.add(&self.actor_loss(n, w));
        sums.cloning_loss = self.actor_backward(&range, w, gradient);
        let (own, params) = (&mut gradient[trunk.params()], &self.params[trunk.params()]);
        trunk.backward(params, n, &mut w.current, own);
        sums
    }

    /// Runs the actor at the next observations, and the target critics on its actions.
    pub fn run_next(&self, range: &Range<usize>, w: &mut SacWorkspace<T>) {
        let (network, n) = (self.network, range.len());
        let (reader, parts) = (&network.reader, network.target_parts());
        let fields = &w.next_fields[..n * network.trunk.out_type().dim()];
        let own = &self.params[network.parts().actor_reader];
        reader.forward(own, fields, &w.items, &w.before[1], &mut w.actor_reader);
        let critic_params = &self.targets[parts.reader.clone()];
        reader.forward(critic_params, fields, &w.items, &w.before[1], &mut w.critic_reader);
        self.run_actor(range, self.batch.noise[1], w);
        self.run_critics(n, self.targets, &parts, w);
    }

    /// Runs the critics on the replay buffer's actions at the current observations.
    fn run_stored(&self, range: &Range<usize>, w: &mut SacWorkspace<T>) {
        let (network, n) = (self.network, range.len());
        let (parts, width) = (network.parts().critics, network.action_order.len());
        let fields = network.trunk.fields(n, &w.current);
        let (own, reader) = (&self.params[parts.reader.clone()], &network.reader);
        reader.forward(own, fields, &w.items, &w.before[0], &mut w.critic_reader);
        for (slot, position) in range.clone().enumerate() {
            let (step, g) = self.batch.step(position);
            let action = self.batch.action(network, step, g);
            let row = &mut w.actions[slot * width..(slot + 1) * width];
            row.iter_mut().zip(action).for_each(|(to, a)| *to = a.into());
        }
        self.run_critics(n, self.params, &parts, w);
    }

    /// Runs the actor at the current observations, and the critics on its actions. The critics'
    /// reader keeps its state from [`Losses::run_stored`].
    fn run_current(&self, range: &Range<usize>, w: &mut SacWorkspace<T>) {
        let (network, n) = (self.network, range.len());
        let (parts, reader) = (network.parts(), &network.reader);
        let fields = network.trunk.fields(n, &w.current);
        let own = &self.params[parts.actor_reader];
        reader.forward(own, fields, &w.items, &w.before[0], &mut w.actor_reader);
        self.run_actor(range, self.batch.noise[0], w);
        self.run_critics(n, self.params, &parts.critics, w);
    }

    /// Adds the gradient of the critics' loss with respect to their parameters to `gradient`, and
    /// writes the gradient with respect to the trunk's fields for the trunk's backward pass.
    fn critics_backward(&self, n: usize, w: &mut SacWorkspace<T>, gradient: &mut [T]) {
        let (network, parts) = (self.network, self.network.parts().critics);
        for (qf, own) in w.critics.iter_mut().zip(&parts.twins) {
            qf.backward(&network.critic, self.params, own.clone(), n, gradient, true);
        }
        self.split_gradient(n, w);
        w.critic_reader.d_state.copy_from_slice(&w.d_state);
        let (own, dparams) = (&self.params[parts.reader.clone()], &mut gradient[parts.reader]);
        let reader = &network.reader;
        let d_fields = reader.backward(own, &w.items, n, dparams, &mut w.critic_reader);
        w.current.d_fields()[..d_fields.len()].copy_from_slice(d_fields);
    }

    /// Adds the gradients of the actor's loss and of behavioural cloning with respect to the
    /// actor's parameters to `gradient`; returns the cloning loss.
    fn actor_backward(
        &self,
        range: &Range<usize>,
        w: &mut SacWorkspace<T>,
        gradient: &mut [T],
    ) -> f64 {
        let (network, n, parts) = (self.network, range.len(), self.network.parts());
        for (qf, own) in w.critics.iter_mut().zip(&parts.critics.twins) {
            // only the gradient with respect to the action is needed, not that of the critics
            let (own, discarded) = (own.clone(), &mut w.discarded);
            qf.backward(&network.critic, self.params, own, n, discarded, true);
        }
        self.split_gradient(n, w);
        let cloning = self.output_gradient(range, w);
        let actor = &mut w.actor;
        actor.backward(&network.actor, self.params, parts.actor, n, gradient, true);
        w.actor_reader.d_state.copy_from_slice(&actor.dx);
        let own = &self.params[parts.actor_reader.clone()];
        let (reader, dparams) = (&network.reader, &mut gradient[parts.actor_reader]);
        // the returned gradient of the fields is dropped: the actor does not train the encoder
        reader.backward(own, &w.items, n, dparams, &mut w.actor_reader);
        cloning
    }

    /// Runs the actor on its context reader's output; samples actions with their log-probabilities.
    fn run_actor(&self, range: &Range<usize>, noise: &[f32], w: &mut SacWorkspace<T>) {
        let (network, n) = (self.network, range.len());
        let width = network.action_order.len();
        let own = &self.params[network.parts().actor];
        w.actor.x.copy_from_slice(&w.actor_reader.state);
        w.actor.forward(&network.actor, own, n);
        network.natural_output(&w.actor.y, &mut w.output);
        let noise = noise[range.start * width..range.end * width].chunks_exact(width);
        let rows = w.output.chunks_exact(2 * width).zip(noise);
        let actions = w.actions.chunks_exact_mut(width).zip(&mut w.log_pi);
        for ((output, draws), (action, log_pi)) in rows.zip(actions) {
            *log_pi = sample_tanh_gaussian(output, draws, action);
        }
    }

    /// Runs both critics on their context reader's output and the n actions.
    fn run_critics(&self, n: usize, params: &[T], parts: &CriticParts, w: &mut SacWorkspace<T>) {
        let network = self.network;
        let width = network.action_order.len();
        let rows = w.irreps.chunks_exact_mut(width);
        for (row, action) in rows.zip(w.actions.chunks_exact(width)).take(n) {
            for (to, &i) in row.iter_mut().zip(&network.action_order) {
                *to = T::from_f64(action[i]);
            }
        }
        let state = &w.critic_reader.state[..n * network.reader.out_type().dim()];
        let [first, second] = &mut w.critics;
        let x = &mut first.x[..n * network.joined.out_shape().len()];
        network.joined.forward(state, &w.irreps[..n * width], x);
        second.x[..x.len()].copy_from_slice(x);
        for (twin, own) in w.critics.iter_mut().zip(&parts.twins) {
            twin.forward(&network.critic, &params[own.clone()], n);
        }
    }

    /// Sums the gradients with respect to both critics' inputs, and splits the sum into the
    /// gradients with respect to the context reader's output and the actions.
    fn split_gradient(&self, n: usize, w: &mut SacWorkspace<T>) {
        let network = self.network;
        let width = network.action_order.len();
        let [first, second] = &mut w.critics;
        let sum = &mut first.dx[..n * network.joined.out_shape().len()];
        for (total, &d) in sum.iter_mut().zip(&second.dx) {
            *total += d;
        }
        let d_state = &mut w.d_state[..n * network.reader.out_type().dim()];
        let d_actions = &mut w.irreps[..n * width];
        network.joined.backward(sum, d_state, d_actions);
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
        let d_log_pi = self.batch.alpha * self.batch.scale();
        for (slot, position) in range.clone().enumerate() {
            let own = slot * width..(slot + 1) * width;
            let both = 2 * own.start..2 * own.end;
            let noise = &self.batch.noise[0][position * width..(position + 1) * width];
            let d_output = &mut w.d_output[both.clone()];
            let (action, d_action) = (&w.actions[own.clone()], &w.d_actions[own]);
            let output = &w.output[both];
            tanh_gaussian_gradient(output, noise, action, d_action, d_log_pi, d_output);
            let (step, g) = self.batch.step(position);
            let done = self.batch.action(network, step, g);
            for ((d, &mean), taken) in d_output.iter_mut().zip(output).zip(done) {
                let (mean, taken) = (mean.tanh(), f64::from(taken));
                let error = mean - taken;
                cloning += error * error;
                // d (tanh(m) - a)^2 / dm
                let slope = 2.0 * error * (1.0 - mean * mean);
                *d += self.batch.cloning * self.batch.scale() * slope;
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
