//! Losses and gradient of one minibatch of soft actor-critic, computed chunk by chunk.

use std::ops::Range;

use equivariant::Scalar;
use symmetry::{D2, Irrep};

use crate::env::Outcome;
use crate::replay::recorded::Recorded;
use crate::replay::ring::Replay;
use crate::sac::network::{CriticParts, SacNetwork};
use crate::sac::squashed;
use crate::sac::stats::SacSums;
use crate::sac::workspace::SacWorkspace;
use crate::trunk::TrunkPass;

/// A minibatch of B steps of a replay, with all that was drawn for it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Batch<'a> {
    pub replay: &'a Replay,
    /// Which steps belong to it, `[B]`.
    pub indices: &'a [usize],
    /// By what each is moved, `[B]`.
    pub elements: &'a [D2],
    /// Standard normal numbers `[B, A]` for the actor at the observations acted on, and at those
    /// after the steps.
    pub noise: [&'a [f32]; 2],
    pub gamma: f64,
    /// What a nat of entropy is worth.
    pub temperature: f64,
    pub cloning: f64,
}

/// The losses of a minibatch as functions of a network's parameters: Haarnoja et al., "Soft
/// actor-critic" (arXiv 1801.01290), with twin critics and without a value network, as in "Soft
/// actor-critic algorithms and applications" (arXiv 1812.05905).
///
/// ```text
/// y   = r + gamma (1 - terminated) (min_i Q'_i(s', a') - alpha ln pi(a'|s'))
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
        let trunk = self.network.parts().trunk;
        self.load(&range, w);
        self.evaluate_next(&range, w);
        let mut sums = SacSums::default();
        self.critics(&range, w, gradient, &mut sums);
        self.actor(&range, w, gradient, &mut sums);
        let (own, params) = (&mut gradient[trunk.clone()], &self.params[trunk]);
        let shared = &self.network.trunk;
        shared.backward(params, range.len(), &mut w.here, own);
        sums
    }

    /// The step at a position of the minibatch, and by what it is moved.
    fn step(&self, position: usize) -> (Recorded<'_>, D2) {
        let index = self.batch.indices[position];
        (self.batch.replay.get(index), self.batch.elements[position])
    }

    /// Computes the fields of all observations and collects the steps before.
    fn load(&self, range: &Range<usize>, w: &mut SacWorkspace<T>) {
        let (network, n) = (self.network, range.len());
        let mut slots = n;
        for (slot, position) in range.clone().enumerate() {
            let (step, g) = self.step(position);
            step.image(&mut w.image);
            self.show(slot, (g, step.vector()), &mut w.image, &mut w.here);
            step.next_image(&mut w.image);
            self.show(slot, (g, step.next_vector()), &mut w.image, &mut w.there);
            for earlier in self.before(step) {
                earlier.image(&mut w.image);
                self.show(slots, (g, earlier.vector()), &mut w.image, &mut w.there);
                slots += 1;
            }
        }
        let params = &self.params[network.parts().trunk];
        network.trunk.forward(params, n, &mut w.here);
        network.trunk.forward(params, slots, &mut w.there);
        self.collect_steps(range, w);
    }

    /// The steps before a step that a context may read, the last one first.
    fn before<'r>(&self, step: Recorded<'r>) -> impl Iterator<Item = Recorded<'r>> {
        let length = self.network.reader.length();
        (1..=length).map_while(move |count| step.earlier(count))
    }

    /// Puts an observation into a slot, moved by g.
    fn show(
        &self,
        slot: usize,
        (g, vector): (D2, &[f32]),
        image: &mut Vec<u8>,
        pass: &mut TrunkPass<T>,
    ) {
        let spec = self.network.spec();
        let [height, width, channels] = spec.image;
        if g != D2::Identity {
            *image = g.transform_image(image, height, width, channels);
        }
        let vector = moved(g, vector, &spec.vector);
        self.network.trunk.load(slot, image, &vector, pass);
    }

    /// Hands the steps before each observation, with their fields, to the contexts.
    fn collect_steps(&self, range: &Range<usize>, w: &mut SacWorkspace<T>) {
        let (reader, n) = (&self.network.reader, range.len());
        let [now, next] = &mut w.before;
        reader.clear(n, now);
        reader.clear(n, next);
        if reader.length() == 0 {
            return;
        }
        let width = self.network.trunk.out_type().dim();
        let action = &self.network.spec().action;
        let mut earlier = w.there.fields()[n * width..].chunks_exact(width);
        let here = w.here.fields().chunks_exact(width);
        for ((slot, position), here) in range.clone().enumerate().zip(here) {
            let (step, g) = self.step(position);
            let read = |step: Recorded| (moved(g, step.action(), action), step.reward());
            let (done, reward) = read(step);
            reader.prepend(slot, here, (&done, reward), next);
            for (count, (step, fields)) in self.before(step).zip(&mut earlier).enumerate() {
                let (done, reward) = read(step);
                reader.prepend(slot, fields, (&done, reward), now);
                if count + 1 < reader.length() {
                    reader.prepend(slot, fields, (&done, reward), next);
                }
            }
        }
    }

    /// Writes the targets of the critics.
    fn evaluate_next(&self, range: &Range<usize>, w: &mut SacWorkspace<T>) {
        let (network, n) = (self.network, range.len());
        let parts = network.target_parts();
        let fields = &w.there.fields()[..n * network.trunk.out_type().dim()];
        let own = &self.params[network.parts().actor_reader];
        let reader = &network.reader;
        reader.forward(own, fields, &w.before[1], &mut w.actor_reader);
        let own = &self.targets[parts.reader.clone()];
        reader.forward(own, fields, &w.before[1], &mut w.critic_reader);
        self.run_actor(range, self.batch.noise[1], w);
        self.run_critics(n, (self.targets, &parts), w);
        for (slot, position) in range.clone().enumerate() {
            let (step, _) = self.step(position);
            let worth = least(w, slot).1 - self.batch.temperature * w.log_probs[slot];
            let goes_on = f64::from(u8::from(step.outcome() != Outcome::Terminated));
            w.targets[slot] = f64::from(step.reward()) + self.batch.gamma * goes_on * worth;
        }
    }

    /// Adds the critics' loss and its gradient, but for that in the shared part, which is left as
    /// the gradient in its fields.
    fn critics(
        &self,
        range: &Range<usize>,
        w: &mut SacWorkspace<T>,
        gradient: &mut [T],
        sums: &mut SacSums,
    ) {
        let (network, n) = (self.network, range.len());
        let (parts, width) = (network.parts().critics, network.action_order.len());
        let fields = &w.here.fields()[..n * network.trunk.out_type().dim()];
        let own = &self.params[parts.reader.clone()];
        let reader = &network.reader;
        reader.forward(own, fields, &w.before[0], &mut w.critic_reader);
        for (slot, position) in range.clone().enumerate() {
            let (step, g) = self.step(position);
            let action = moved(g, step.action(), &network.spec().action);
            let row = &mut w.actions[slot * width..(slot + 1) * width];
            row.iter_mut()
                .zip(action)
                .for_each(|(to, a)| *to = a.into());
        }
        self.run_critics(n, (self.params, &parts), w);
        for slot in 0..n {
            for twin in &mut w.critics {
                let error = twin.y[slot].to_f64() - w.targets[slot];
                sums.critic += 0.5 * error * error;
                sums.value += 0.5 * twin.y[slot].to_f64();
                twin.dy[slot] = T::from_f64(error * self.scale());
            }
        }
        for (twin, own) in w.critics.iter_mut().zip(&parts.twins) {
            let own = (self.params, own.clone());
            twin.backward(&network.critic, own, n, gradient, true);
        }
        self.split_gradient(n, w);
        let d_state = &mut w.critic_reader.d_state;
        d_state.copy_from_slice(&w.d_state);
        let (own, dparams) = (
            &self.params[parts.reader.clone()],
            &mut gradient[parts.reader],
        );
        let d_fields = reader.backward(own, &w.before[0], n, dparams, &mut w.critic_reader);
        w.here.d_fields()[..d_fields.len()].copy_from_slice(d_fields);
    }

    /// Adds the actor's loss and its gradient. The critics have read the same observations.
    fn actor(
        &self,
        range: &Range<usize>,
        w: &mut SacWorkspace<T>,
        gradient: &mut [T],
        sums: &mut SacSums,
    ) {
        let (network, n) = (self.network, range.len());
        let (parts, reader) = (network.parts(), &network.reader);
        let fields = &w.here.fields()[..n * network.trunk.out_type().dim()];
        let own = &self.params[parts.actor_reader.clone()];
        reader.forward(own, fields, &w.before[0], &mut w.actor_reader);
        self.run_actor(range, self.batch.noise[0], w);
        self.run_critics(n, (self.params, &parts.critics), w);
        for slot in 0..n {
            let (twin, value) = least(w, slot);
            sums.samples += 1.0;
            sums.actor += self.batch.temperature * w.log_probs[slot] - value;
            sums.log_prob += w.log_probs[slot];
            w.critics[1 - twin].dy[slot] = T::ZERO;
            w.critics[twin].dy[slot] = T::from_f64(-self.scale());
        }
        for (twin, own) in w.critics.iter_mut().zip(&parts.critics.twins) {
            let own = (self.params, own.clone());
            twin.backward(&network.critic, own, n, &mut w.discarded, true);
        }
        self.split_gradient(n, w);
        self.output_gradient(range, w, sums);
        w.actor.backward(
            &network.actor,
            (self.params, parts.actor),
            n,
            gradient,
            true,
        );
        w.actor_reader.d_state.copy_from_slice(&w.actor.dx);
        let own = &self.params[parts.actor_reader.clone()];
        let dparams = &mut gradient[parts.actor_reader];
        reader.backward(own, &w.before[0], n, dparams, &mut w.actor_reader);
    }

    /// The weight of one step in a mean over the minibatch.
    fn scale(&self) -> f64 {
        1.0 / self.batch.indices.len() as f64
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

    /// Brings the gradient in the actions to the actor's output, and adds that of cloning.
    fn output_gradient(&self, range: &Range<usize>, w: &mut SacWorkspace<T>, sums: &mut SacSums) {
        let network = self.network;
        let width = network.action_order.len();
        let d_log_prob = self.batch.temperature * self.scale();
        for (slot, position) in range.clone().enumerate() {
            let own = slot * width..(slot + 1) * width;
            let both = 2 * own.start..2 * own.end;
            let noise = &self.batch.noise[0][position * width..(position + 1) * width];
            let d_output = &mut w.d_output[both.clone()];
            let action = (&w.actions[own.clone()], &w.d_actions[own]);
            let output = &w.output[both];
            squashed::gradient(output, noise, action, d_log_prob, d_output);
            let (step, g) = self.step(position);
            let done = moved(g, step.action(), &network.spec().action);
            for ((d, &mean), done) in d_output.iter_mut().zip(output).zip(done) {
                let (mean, done) = (mean.tanh(), f64::from(done));
                let error = mean - done;
                sums.cloning += error * error;
                let slope = 2.0 * error * (1.0 - mean * mean);
                *d += self.batch.cloning * self.scale() * slope;
            }
        }
        let rows = w.actor.dy.chunks_exact_mut(2 * width);
        for (row, d_output) in rows.zip(w.d_output.chunks_exact(2 * width)) {
            for (dy, &i) in row.iter_mut().zip(&network.output_order) {
                *dy = T::from_f64(d_output[i]);
            }
        }
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

/// Components in natural order, each multiplied by its irrep's sign.
fn moved(g: D2, components: &[f32], irreps: &[Irrep]) -> Vec<f32> {
    let signs = irreps.iter().map(|irrep| f32::from(irrep.sign(g)));
    components.iter().zip(signs).map(|(c, s)| c * s).collect()
}

#[cfg(test)]
mod tests;
