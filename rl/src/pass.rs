//! Forward and backward passes of the actor-critic for a chunk of samples.

use equivariant::Scalar;

use crate::activity::Activity;
use crate::network::ActorCritic;
use crate::network_settings::Critic;
use crate::stage::Stage;
use crate::trunk::{OnTrunkPass, TrunkPass};

/// Every activation, gradient and scratch of a pass over up to `capacity` samples, allocated once.
///
/// What the loss reads and writes is in f64 and in natural order; the rest is the network's own.
/// Arrays have a row for each of the K samples of the capacity. After a pass over n of them, the
/// first n rows are theirs, and the others are what an earlier pass left.
#[derive(Clone, Debug)]
pub struct Workspace<T> {
    /// Mean actions `[K, A]` of the last forward pass.
    pub mean: Vec<f64>,
    /// Values `[K]` of the last forward pass.
    pub value: Vec<f64>,
    /// Logarithms of the standard deviations `[A]` of the last forward pass.
    pub log_std: Vec<f64>,
    /// Gradient of the loss with respect to `mean`, `[K, A]`: set it before the backward pass.
    pub d_mean: Vec<f64>,
    /// Gradient of the loss with respect to `value`, `[K]`: set it before the backward pass.
    pub d_value: Vec<f64>,
    /// Gradient of the loss with respect to `log_std`, `[A]`: set it before the backward pass.
    pub d_log_std: Vec<f64>,
    trunk: TrunkPass<T>,
    actor: Stage<T>,
    critic: Stage<T>,
    /// n * F of the last forward pass.
    features_len: usize,
}

impl<T: Scalar> Workspace<T> {
    /// The invariant features `[n, F]` of the n samples of the last forward pass.
    pub fn features(&self) -> &[T] {
        &self.trunk.features()[..self.features_len]
    }
}

impl<T: Scalar> ActorCritic<T> {
    /// A workspace for chunks of up to `capacity` samples.
    pub fn workspace(&self, capacity: usize) -> Workspace<T> {
        let action = self.action_order.len();
        Workspace {
            mean: vec![0.0; capacity * action],
            value: vec![0.0; capacity],
            log_std: vec![0.0; action],
            d_mean: vec![0.0; capacity * action],
            d_value: vec![0.0; capacity],
            d_log_std: vec![0.0; action],
            trunk: self.trunk.pass(capacity),
            actor: Stage::new(&self.actor, capacity),
            critic: Stage::new(&self.critic, capacity),
            features_len: 0,
        }
    }

    /// Writes sample `slot` of a chunk: pixels `[H, W, C]`, mapped to [-0.5, 0.5], and the vector
    /// `[D]`, put into irrep-major order as it is: scale it to order 1 beforehand.
    ///
    /// # Panics
    /// When the slices have other lengths than the spec says, or `slot` is beyond the capacity.
    pub fn load(&self, slot: usize, image: &[u8], vector: &[f32], workspace: &mut Workspace<T>) {
        self.trunk.load(slot, image, vector, &mut workspace.trunk);
    }

    /// Runs the samples in slots 0..n: fills `mean`, `value`, `log_std` and the features.
    ///
    /// # Panics
    /// When `params` is not [`ActorCritic::num_params`] long or n is beyond the capacity.
    pub fn forward(&self, params: &[T], n: usize, workspace: &mut Workspace<T>) {
        let (parts, w) = (self.parts(), workspace);
        self.forward_features(params, n, w);
        w.actor.forward(&self.actor, &params[parts.actor], n);
        w.critic.x.copy_from_slice(match self.settings().critic {
            Critic::Pooled { .. } => w.trunk.features(),
            Critic::Joint { .. } => w.trunk.fields(),
        });
        w.critic.forward(&self.critic, &params[parts.critic], n);
        let width = self.action_order.len();
        for (mean, y) in w
            .mean
            .chunks_exact_mut(width)
            .zip(w.actor.y.chunks_exact(width))
            .take(n)
        {
            for (&i, y) in self.action_order.iter().zip(y) {
                mean[i] = y.to_f64();
            }
        }
        to_f64(&w.critic.y[..n], &mut w.value);
        to_f64(&params[parts.log_std], &mut w.log_std);
    }

    /// What the units put out for the n samples of the last forward pass.
    pub(crate) fn activity(&self, params: &[T], n: usize, w: &Workspace<T>) -> Activity {
        let parts = self.parts();
        let own = &params[self.trunk.params()];
        let mut sums = self.trunk.unit_sums(own, n, &w.trunk);
        sums.extend(w.actor.unit_sums(&self.actor, &params[parts.actor], n));
        sums.extend(w.critic.unit_sums(&self.critic, &params[parts.critic], n));
        Activity::of(sums)
    }

    /// Runs the samples in slots 0..n up to the features.
    ///
    /// # Panics
    /// As [`ActorCritic::forward`].
    pub fn forward_features(&self, params: &[T], n: usize, workspace: &mut Workspace<T>) {
        let (own, w) = (&params[self.trunk.params()], workspace);
        self.trunk.forward(own, n, &mut w.trunk);
        w.actor.x.copy_from_slice(w.trunk.fields());
        self.trunk.pool(n, &mut w.trunk);
        w.features_len = n * self.feature_dim();
    }

    /// Adds the gradient of the loss to `dparams`, for the n samples of the last forward pass, from
    /// `d_mean`, `d_value` and `d_log_std`.
    ///
    /// # Panics
    /// As [`ActorCritic::forward`].
    pub fn backward(
        &self,
        params: &[T],
        n: usize,
        workspace: &mut Workspace<T>,
        dparams: &mut [T],
    ) {
        let (parts, w) = (self.parts(), workspace);
        self.load_output_gradients(n, w);
        w.actor
            .backward(&self.actor, (params, parts.actor), n, dparams, true);
        w.critic
            .backward(&self.critic, (params, parts.critic), n, dparams, true);
        self.add_head_gradients(n, w);
        let own = self.trunk.params();
        let (own, trunk) = (&params[own.clone()], &mut dparams[own]);
        self.trunk.backward(own, n, &mut w.trunk, trunk);
        for (sum, d) in dparams[parts.log_std].iter_mut().zip(&w.d_log_std) {
            *sum += T::from_f64(*d);
        }
    }

    /// Brings the gradients in the inputs of both heads to the trunk's fields.
    fn add_head_gradients(&self, n: usize, w: &mut Workspace<T>) {
        match self.settings().critic {
            Critic::Pooled { .. } => self.trunk.pool_backward(&w.critic.dx, n, &mut w.trunk),
            Critic::Joint { .. } => w.trunk.d_fields().copy_from_slice(&w.critic.dx),
        }
        for (sum, d) in w.trunk.d_fields().iter_mut().zip(&w.actor.dx) {
            *sum += *d;
        }
    }

    fn load_output_gradients(&self, n: usize, w: &mut Workspace<T>) {
        let width = self.action_order.len();
        for (dy, d) in w
            .actor
            .dy
            .chunks_exact_mut(width)
            .zip(w.d_mean.chunks_exact(width))
            .take(n)
        {
            for (dy, &i) in dy.iter_mut().zip(&self.action_order) {
                *dy = T::from_f64(d[i]);
            }
        }
        for (dy, &d) in w.critic.dy.iter_mut().zip(&w.d_value[..n]) {
            *dy = T::from_f64(d);
        }
    }
}

impl<T> OnTrunkPass<T> for Workspace<T> {
    fn trunk(&mut self) -> &mut TrunkPass<T> {
        &mut self.trunk
    }
}

fn to_f64<T: Scalar>(from: &[T], to: &mut [f64]) {
    for (to, from) in to.iter_mut().zip(from) {
        *to = from.to_f64();
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use symmetry::Irrep;

    use super::*;
    use crate::env::EnvSpec;
    use crate::network_settings::NetworkSettings;

    fn network() -> ActorCritic<f32> {
        let vector = vec![Irrep::X, Irrep::Y, Irrep::Trivial];
        let spec = EnvSpec {
            num_envs: 1,
            image: [16, 16, 6],
            action: vector.clone(),
            vector,
        };
        ActorCritic::new(&NetworkSettings::default(), &spec).unwrap()
    }

    /// The gradient of three samples in a workspace for four, moved between the passes.
    fn gradient(moved: impl Fn(Workspace<f32>) -> Workspace<f32>) -> Vec<f32> {
        let network = network();
        let params = network.init(&mut ChaCha8Rng::seed_from_u64(0));
        let mut workspace = network.workspace(4);
        for slot in 0..3 {
            let image: Vec<u8> = (0..16 * 16 * 6).map(|i| (i * 37 + slot) as u8).collect();
            network.load(slot, &image, &[0.1, 0.2, slot as f32], &mut workspace);
        }
        network.forward(&params, 3, &mut workspace);
        let mut workspace = moved(workspace);
        workspace.d_mean.fill(1.0);
        workspace.d_value.fill(0.5);
        let mut gradient = vec![0.0; params.len()];
        network.backward(&params, 3, &mut workspace, &mut gradient);
        gradient
    }

    #[test]
    fn a_workspace_cloned_between_the_passes_gives_the_same_gradient() {
        let stayed = gradient(|workspace| workspace);
        assert!(stayed.iter().any(|&g| g != 0.0));
        let cloned = gradient(|workspace| {
            let mut held = Vec::new();
            (0..9).fold(workspace, |workspace, i| {
                held.push(vec![0u8; 24 + 40 * i]);
                workspace.clone()
            })
        });
        assert!(cloned == stayed);
    }

    /// Rows of an earlier pass over more samples must not show.
    #[test]
    fn features_are_those_of_the_samples_that_were_run() {
        let network = network();
        let params = network.init(&mut ChaCha8Rng::seed_from_u64(0));
        let mut workspace = network.workspace(4);
        for n in [0, 4, 2] {
            network.forward_features(&params, n, &mut workspace);
            assert_eq!(workspace.features().len(), n * network.feature_dim());
        }
    }

    fn load(image: &[u8], vector: &[f32]) {
        let network = network();
        network.load(0, image, vector, &mut network.workspace(2));
    }

    #[test]
    #[should_panic(expected = "image: got 1535 values, expected 1536")]
    fn short_images_are_refused() {
        load(&[0; 1535], &[0.0; 3]);
    }

    #[test]
    #[should_panic(expected = "vector: got 4 values, expected 3")]
    fn long_vectors_are_refused() {
        load(&[0; 1536], &[0.0; 4]);
    }
}
