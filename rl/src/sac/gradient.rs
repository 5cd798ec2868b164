//! Losses and gradient of one minibatch of soft actor-critic, computed chunk by chunk.

use std::ops::Range;

use equivariant::Scalar;

use crate::env::Outcome;
use crate::sac::minibatch::Batch;
use crate::sac::network::{CriticParts, SacNetwork};
use crate::sac::squashed;
use crate::sac::stats::SacSums;
use crate::sac::workspace::SacWorkspace;

/// The losses of a minibatch as functions of a network's parameters: Haarnoja et al., "Soft
/// actor-critic" (arXiv 1801.01290), with twin critics and without a value network, as in "Soft
/// actor-critic algorithms and applications" (arXiv 1812.05905).
///
/// ```text
/// y    = r + gamma (1 - terminated) (min_i Q'_i(s', a') - alpha ln pi(a'|s'))
/// J_Q = sum_i (Q_i(s, a) - y)^2 / 2                  (1812.05905, equations 5 and 6)
/// J_pi = alpha ln pi(b|s) - min_i Q_i(s, b)          (1812.05905, equation 9)
/// ```
///
/// where a' and b are drawn from the actor, and Q' are the target critics. J_Q is a function of the
/// critics and of the shared part, J_pi of the actor. Both are means over the minibatch and are
/// taken at the same parameters, so that the shared part runs once.
#[derive(Clone, Copy)]
pub(super) struct Losses<'a, T> {
    pub network: &'a SacNetwork<T>,
    pub params: &'a [T],
    /// Parameters of the target critics.
    pub targets: &'a [T],
    pub batch: Batch<'a>,
}

impl<T: Scalar> Losses<'_, T> {
    /// Runs the steps at positions `range` of the minibatch forward and backward. Adds their share
    /// of the gradient to `gradient` and returns the sums of their loss terms.
    pub fn chunk(
        &self,
        range: Range<usize>,
        w: &mut SacWorkspace<T>,
        gradient: &mut [T],
    ) -> SacSums {
        let trunk = self.network.trunk.params();
        self.batch.load((self.network, self.params), &range, w);
        self.evaluate_next(&range, w);
        let mut sums = self.critics(&range, w, gradient);
        sums.add(&self.actor(&range, w, gradient));
        let (own, params) = (&mut gradient[trunk.clone()], &self.params[trunk]);
        let shared = &self.network.trunk;
        shared.backward(params, range.len(), &mut w.here, own);
        sums
    }

    /// Writes the targets of the critics.
    fn evaluate_next(&self, range: &Range<usize>, w: &mut SacWorkspace<T>) {
        let (network, n) = (self.network, range.len());
        let parts = network.target_parts();
        let fields = &w.next_fields[..n * network.trunk.out_type().dim()];
        let own = &self.params[network.parts().actor_reader];
        let reader = &network.reader;
        let read = (&w.items, &w.before[1]);
        reader.forward(own, fields, read, &mut w.actor_reader);
        let own = &self.targets[parts.reader.clone()];
        reader.forward(own, fields, read, &mut w.critic_reader);
        self.run_actor(range, self.batch.noise[1], w);
        self.run_critics(n, (self.targets, &parts), w);
        for (slot, position) in range.clone().enumerate() {
            let (step, _) = self.batch.step(position);
            let worth = least(w, slot).1 - self.batch.temperature * w.log_probs[slot];
            let goes_on = f64::from(u8::from(step.outcome() != Outcome::Terminated));
            w.targets[slot] = f64::from(step.reward()) + self.batch.gamma * goes_on * worth;
        }
    }

    /// Returns the critics' loss and adds its gradient, but for that in the shared part, which is
    /// left as the gradient in its fields.
    fn critics(&self, range: &Range<usize>, w: &mut SacWorkspace<T>, grad: &mut [T]) -> SacSums {
        let (network, n) = (self.network, range.len());
        let (parts, width) = (network.parts().critics, network.action_order.len());
        let fields = network.trunk.fields(n, &w.here);
        let own = &self.params[parts.reader.clone()];
        let reader = &network.reader;
        reader.forward(own, fields, (&w.items, &w.before[0]), &mut w.critic_reader);
        for (slot, position) in range.clone().enumerate() {
            let (step, g) = self.batch.step(position);
            let action = self.batch.done(network, step, g).0;
            let row = &mut w.actions[slot * width..(slot + 1) * width];
            row.iter_mut()
                .zip(action)
                .for_each(|(to, a)| *to = a.into());
        }
        self.run_critics(n, (self.params, &parts), w);
        let mut sums = SacSums::default();
        for slot in 0..n {
            for twin in &mut w.critics {
                let error = twin.y[slot].to_f64() - w.targets[slot];
                sums.critic += 0.5 * error * error;
                sums.value += 0.5 * twin.y[slot].to_f64();
                twin.dy[slot] = T::from_f64(error * self.batch.scale());
            }
        }
        for (twin, own) in w.critics.iter_mut().zip(&parts.twins) {
            let own = (self.params, own.clone());
            twin.backward(&network.critic, own, n, grad, true);
        }
        self.split_gradient(n, w);
        let d_state = &mut w.critic_reader.d_state;
        d_state.copy_from_slice(&w.d_state);
        let (own, dparams) = (&self.params[parts.reader.clone()], &mut grad[parts.reader]);
        let d_fields = reader.backward(own, &w.items, n, dparams, &mut w.critic_reader);
        w.here.d_fields()[..d_fields.len()].copy_from_slice(d_fields);
        sums
    }

    /// Returns the actor's loss and adds its gradient. The critics have read the same observations.
    fn actor(&self, range: &Range<usize>, w: &mut SacWorkspace<T>, grad: &mut [T]) -> SacSums {
        let (network, n) = (self.network, range.len());
        let (parts, reader) = (network.parts(), &network.reader);
        let fields = network.trunk.fields(n, &w.here);
        let own = &self.params[parts.actor_reader.clone()];
        reader.forward(own, fields, (&w.items, &w.before[0]), &mut w.actor_reader);
        self.run_actor(range, self.batch.noise[0], w);
        self.run_critics(n, (self.params, &parts.critics), w);
        let mut sums = SacSums::default();
        for slot in 0..n {
            let (twin, value) = least(w, slot);
            sums.samples += 1.0;
            sums.actor += self.batch.temperature * w.log_probs[slot] - value;
            sums.log_prob += w.log_probs[slot];
            w.critics[1 - twin].dy[slot] = T::ZERO;
            w.critics[twin].dy[slot] = T::from_f64(-self.batch.scale());
        }
        for (twin, own) in w.critics.iter_mut().zip(&parts.critics.twins) {
            let own = (self.params, own.clone());
            twin.backward(&network.critic, own, n, &mut w.discarded, true);
        }
        self.split_gradient(n, w);
        sums.cloning = self.output_gradient(range, w);
        let own = (self.params, parts.actor);
        w.actor.backward(&network.actor, own, n, grad, true);
        w.actor_reader.d_state.copy_from_slice(&w.actor.dx);
        let own = &self.params[parts.actor_reader.clone()];
        let dparams = &mut grad[parts.actor_reader];
        reader.backward(own, &w.items, n, dparams, &mut w.actor_reader);
        sums
    }

    /// Draws actions with their log-probabilities from the actor that has been read for.
    fn run_actor(&self, range: &Range<usize>, noise: &[f32], w: &mut SacWorkspace<T>) {
        let (network, n) = (self.network, range.len());
        let width = network.action_order.len();
        let own = &self.params[network.parts().actor];
        w.actor.x.copy_from_slice(&w.actor_reader.state);
        w.actor.forward(&network.actor, own, n);
        network.natural_output(&w.actor.y, &mut w.output);
        let noise = noise[range.start * width..range.end * width].chunks_exact(width);
        let rows = w.output.chunks_exact(2 * width).zip(noise);
        let actions = w.actions.chunks_exact_mut(width).zip(&mut w.log_probs);
        for ((output, noise), (action, log_prob)) in rows.zip(actions) {
            *log_prob = squashed::sample(output, noise, action);
        }
    }

    /// Runs both critics on the n actions, for what has been read for them.
    fn run_critics(
        &self,
        n: usize,
        (params, parts): (&[T], &CriticParts),
        w: &mut SacWorkspace<T>,
    ) {
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

    /// Adds up the gradients in what both critics have read, and splits the sum into that in the
    /// reader's state and that in the actions.
    fn split_gradient(&self, n: usize, w: &mut SacWorkspace<T>) {
        let network = self.network;
        let width = network.action_order.len();
        let [first, second] = &mut w.critics;
        let sum = &mut first.dx[..n * network.joined.out_shape().len()];
        for (sum, &d) in sum.iter_mut().zip(&second.dx) {
            *sum += d;
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

    /// Brings the gradient in the actions to the actor's output, and adds that of cloning, whose
    /// loss it returns.
    fn output_gradient(&self, range: &Range<usize>, w: &mut SacWorkspace<T>) -> f64 {
        let network = self.network;
        let width = network.action_order.len();
        let mut cloning = 0.0;
        let d_log_prob = self.batch.temperature * self.batch.scale();
        for (slot, position) in range.clone().enumerate() {
            let own = slot * width..(slot + 1) * width;
            let both = 2 * own.start..2 * own.end;
            let noise = &self.batch.noise[0][position * width..(position + 1) * width];
            let d_output = &mut w.d_output[both.clone()];
            let action = (&w.actions[own.clone()], &w.d_actions[own]);
            let output = &w.output[both];
            squashed::gradient(output, noise, action, d_log_prob, d_output);
            let (step, g) = self.batch.step(position);
            let done = self.batch.done(network, step, g).0;
            for ((d, &mean), done) in d_output.iter_mut().zip(output).zip(done) {
                let (mean, done) = (mean.tanh(), f64::from(done));
                let error = mean - done;
                cloning += error * error;
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

/// The critic that values the action of a slot least, and its value.
fn least<T: Scalar>(w: &SacWorkspace<T>, slot: usize) -> (usize, f64) {
    let values = [0, 1].map(|twin: usize| w.critics[twin].y[slot].to_f64());
    if values[1] < values[0] {
        (1, values[1])
    } else {
        (0, values[0])
    }
}

#[cfg(test)]
mod tests;
