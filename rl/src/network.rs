//! The paper's policy network: an equivariant actor and an invariant critic on shared features.

use std::ops::Range;

use equivariant::{FieldType, Layer, LayerSignature, Scalar, Sequential};
use rand::Rng;
use symmetry::irrep_major_permutation;

use crate::activity::UnitActivity;
use crate::env::EnvSpec;
use crate::error::{RlError, require_network_memory};
use crate::network_settings::{CriticSettings, NetworkSettings};
use crate::trunk::{
    HasTrunk, HasTrunkWorkspace, LayerWorkspace, ParamAllocator, Trunk, TrunkWorkspace, head,
};

/// The policy network of COVERS, an equivariant actor and an invariant critic on shared features
/// (Liu et al., CoRL 2023, section 4.1, "Policy network architecture").
///
/// ```text
/// image  [H, W, C] -> Encoder -----------------------------------------------+
/// vector [D]       -> Linear, ReLU ------------------------------------------+-> h, regular fields
/// h -> Linear, ReLU, Linear -> mean action [A], of the action's type
/// h -> GroupMaxPool -> features [F], invariant
/// h, or the features in the paper -> Linear, ReLU, Linear -> value
/// log_std [A]: separate parameters, the same for every state
/// ```
///
/// For discrete actions, the mean's place is taken by the logits of the choices, and log_std has no
/// effect.
///
/// Pooling acts on the image's and on the vector's fields separately, as in the paper, so the
/// features are invariant under transformations of either input alone: the position of the vector
/// relative to the image reaches only the actor and a [`CriticSettings::Joint`].
///
/// Every part is equivariant under [`NetworkSettings::group`]: D2 gives the paper's network, and C1
/// an ordinary one of the same width, whose pooling does nothing.
///
/// The network owns no weights. Parameters are one flat slice: the image encoder's
/// ([`ActorCritic::encoder_param_range`]), then all others
/// ([`ActorCritic::non_encoder_param_range`]), the last A of which are log_std.
pub struct ActorCritic<T> {
    pub(crate) trunk: Trunk<T>,
    pub(crate) actor: Sequential<T>,
    pub(crate) critic: Sequential<T>,
    /// Indices of the components of the action in the environment's order, sorted by irrep
    /// (irrep-major order).
    pub(crate) action_order: Vec<usize>,
}

/// Ranges of the parameters of actor, critic and log_std in the network's flat parameter slice.
pub(crate) struct ParamRanges {
    pub actor: Range<usize>,
    pub critic: Range<usize>,
    pub log_std: Range<usize>,
}

impl<T: Scalar> ActorCritic<T> {
    /// Builds the network for the images, vectors and actions of `spec`, whose number of
    /// environments is ignored.
    ///
    /// # Errors
    /// [`RlError::UnsupportedImageSize`] for images on which the convolutions would not be exactly
    /// equivariant, [`RlError::InvalidSetting`] and [`RlError::EmptySpec`] for sizes of zero,
    /// [`RlError::NoObservationInput`] for a network with neither images nor vectors as input.
    pub fn new(settings: &NetworkSettings, spec: &EnvSpec) -> Result<Self, RlError> {
        let trunk = Trunk::new(settings, spec)?;
        let action = FieldType::from_irreps(settings.group, &spec.action_irreps);
        let hidden = settings.regular_field_type(settings.actor_fields);
        let network = Self {
            actor: head(trunk.out_type(), hidden, action)?,
            critic: critic(settings, &trunk)?,
            action_order: irrep_major_permutation(settings.group, &spec.action_irreps),
            trunk,
        };
        require_network_memory(network.num_params())?;
        Ok(network)
    }

    /// Returns the number of parameters of the network, which is the length of its flat parameter
    /// slice.
    pub fn num_params(&self) -> usize {
        self.param_ranges().log_std.end
    }

    /// Returns the range of the image encoder's parameters in the flat parameter slice.
    pub fn encoder_param_range(&self) -> Range<usize> {
        self.trunk.encoder_param_range()
    }

    /// Returns the range of all parameters but those of the image encoder in the flat parameter
    /// slice: the vector's layer, actor, critic and log_std.
    pub fn non_encoder_param_range(&self) -> Range<usize> {
        self.encoder_param_range().end..self.num_params()
    }

    /// Returns F, the length of the invariant features: one per regular field of the group.
    pub fn feature_dim(&self) -> usize {
        self.trunk.feature_dim()
    }

    /// Returns the settings that the network was built with.
    pub fn settings(&self) -> &NetworkSettings {
        &self.trunk.settings
    }

    /// Returns the sizes and irreps of observations and actions that the network was built for.
    pub fn spec(&self) -> &EnvSpec {
        &self.trunk.spec
    }

    /// Samples the initial values of all parameters of the network. Weights before a ReLU have gain
    /// sqrt(2) (He et al., ICCV 2015, equation 10), the last layers the gains of the settings;
    /// biases are zero, and log_std has the value in the settings.
    pub fn init_params(&self, rng: &mut dyn Rng) -> Vec<T> {
        let (ranges, settings) = (self.param_ranges(), self.settings());
        let mut params = self.trunk.init_params(self.num_params(), rng);
        self.actor.init_with_gain(rng, settings.action_gain.into(), &mut params[ranges.actor]);
        self.critic.init_with_gain(rng, settings.value_gain.into(), &mut params[ranges.critic]);
        params[ranges.log_std].fill(T::from_f64(settings.log_std.into()));
        params
    }

    pub(crate) fn param_ranges(&self) -> ParamRanges {
        let mut layout = ParamAllocator::starting_after_trunk(&self.trunk);
        ParamRanges {
            actor: layout.allocate(self.actor.num_params()),
            critic: layout.allocate(self.critic.num_params()),
            log_std: layout.allocate(self.action_order.len()),
        }
    }
}

impl<T> HasTrunk<T> for ActorCritic<T> {
    fn trunk(&self) -> &Trunk<T> {
        &self.trunk
    }
}

/// Builds the critic's layers, which read the trunk's fields before or after pooling over the
/// group.
fn critic<T: Scalar>(
    settings: &NetworkSettings,
    trunk: &Trunk<T>,
) -> Result<Sequential<T>, RlError> {
    let (group, value) = (settings.group, settings.group.trivial_type(1));
    match settings.critic {
        CriticSettings::Pooled { width } => {
            let features = group.trivial_type(trunk.feature_dim());
            head(features, group.trivial_type(width), value)
        }
        CriticSettings::Joint { fields } => {
            head(trunk.out_type(), settings.regular_field_type(fields), value)
        }
    }
}

/// Activations, gradients and scratch memory of an [`ActorCritic`]'s passes over up to K samples,
/// allocated once.
///
/// The public arrays, between network and loss, are in f64 and in the environment's order. They
/// have K rows; after a pass over n samples, the first n rows are valid and the others left from
/// earlier passes.
#[derive(Clone, Debug)]
pub struct ActorCriticWorkspace<T> {
    /// Mean actions, or logits of the choices, `[K, A]` of the last forward pass.
    pub mean: Vec<f64>,
    /// State values V(s) `[K]` of the last forward pass.
    pub value: Vec<f64>,
    /// Logarithms of the action's standard deviations `[A]` of the last forward pass.
    pub log_std: Vec<f64>,
    /// Gradient of the loss with respect to `mean`, `[K, A]`; set before the backward pass, which
    /// may overwrite it.
    pub d_mean: Vec<f64>,
    /// Gradient of the loss with respect to `value`, `[K]`; set before the backward pass.
    pub d_value: Vec<f64>,
    /// Gradient of the loss with respect to `log_std`, `[A]`; set before the backward pass.
    pub d_log_std: Vec<f64>,
    trunk: TrunkWorkspace<T>,
    actor: LayerWorkspace<T>,
    critic: LayerWorkspace<T>,
}

impl<T: Scalar> ActorCritic<T> {
    /// Allocates a workspace for passes over up to `capacity` samples (K).
    pub fn new_workspace(&self, capacity: usize) -> ActorCriticWorkspace<T> {
        let action = self.action_order.len();
        ActorCriticWorkspace {
            mean: vec![0.0; capacity * action],
            value: vec![0.0; capacity],
            log_std: vec![0.0; action],
            d_mean: vec![0.0; capacity * action],
            d_value: vec![0.0; capacity],
            d_log_std: vec![0.0; action],
            trunk: self.trunk.new_workspace(capacity),
            actor: LayerWorkspace::new(&self.actor, capacity),
            critic: LayerWorkspace::new(&self.critic, capacity),
        }
    }

    /// Loads an observation into position `slot` of the workspace: pixels `[H, W, C]`, mapped to
    /// [-0.5, 0.5], and the vector `[D]`, reordered but not scaled: it should be of order 1
    /// already.
    ///
    /// # Panics
    /// If the slices' lengths differ from the spec, or `slot` is beyond the capacity.
    pub fn load_observation(
        &self,
        slot: usize,
        image: &[u8],
        vector: &[f32],
        workspace: &mut ActorCriticWorkspace<T>,
    ) {
        self.trunk.load_observation(slot, image, vector, &mut workspace.trunk);
    }

    /// Runs the network forward on the samples in slots 0..n: fills `mean`, `value` and `log_std` of
    /// the workspace.
    ///
    /// # Panics
    /// If `params` is not [`ActorCritic::num_params`] long or n is beyond the capacity.
    pub fn forward(&self, params: &[T], n: usize, workspace: &mut ActorCriticWorkspace<T>) {
        let (ranges, w) = (self.param_ranges(), workspace);
        self.trunk.forward(&params[self.trunk.param_range()], n, &mut w.trunk);
        w.actor.x.copy_from_slice(w.trunk.feature_fields());
        w.actor.forward(&self.actor, &params[ranges.actor], n);
        w.critic.x.copy_from_slice(match self.settings().critic {
            CriticSettings::Pooled { .. } => {
                self.trunk.pool_features(n, &mut w.trunk);
                w.trunk.features()
            }
            CriticSettings::Joint { .. } => w.trunk.feature_fields(),
        });
        w.critic.forward(&self.critic, &params[ranges.critic], n);
        // layers use irrep-major order, the loss the environment's order
        let width = self.action_order.len();
        for (mean, y) in w.mean.chunks_exact_mut(width).zip(w.actor.y.chunks_exact(width)).take(n) {
            for (&i, component) in self.action_order.iter().zip(y) {
                mean[i] = component.to_f64();
            }
            self.spec().change_action_basis(mean);
        }
        to_f64(&w.critic.y[..n], &mut w.value);
        to_f64(&params[ranges.log_std], &mut w.log_std);
    }

    /// Returns the summed activations of the network's ReLU units for the n samples of the last
    /// forward pass.
    pub(crate) fn unit_activity(
        &self,
        params: &[T],
        n: usize,
        w: &ActorCriticWorkspace<T>,
    ) -> UnitActivity {
        let ranges = self.param_ranges();
        let own = &params[self.trunk.param_range()];
        let mut sums = self.trunk.unit_activation_sums(own, n, &w.trunk);
        sums.extend(w.actor.unit_activation_sums(&self.actor, &params[ranges.actor], n));
        sums.extend(w.critic.unit_activation_sums(&self.critic, &params[ranges.critic], n));
        UnitActivity::from_layer_sums(sums)
    }

    /// Adds the gradient of the loss with respect to all parameters to `dparams`, for the n samples
    /// of the last forward pass, from `d_mean`, `d_value` and `d_log_std` of the workspace.
    ///
    /// # Panics
    /// Like [`ActorCritic::forward`].
    pub fn backward(
        &self,
        params: &[T],
        n: usize,
        workspace: &mut ActorCriticWorkspace<T>,
        dparams: &mut [T],
    ) {
        let (ranges, w) = (self.param_ranges(), workspace);
        self.load_output_gradients(n, w);
        w.actor.backward(&self.actor, params, ranges.actor, n, dparams, true);
        w.critic.backward(&self.critic, params, ranges.critic, n, dparams, true);
        self.add_head_gradients(n, w);
        let own = self.trunk.param_range();
        let (own, trunk) = (&params[own.clone()], &mut dparams[own]);
        self.trunk.backward(own, n, &mut w.trunk, trunk);
        for (sum, d) in dparams[ranges.log_std].iter_mut().zip(&w.d_log_std) {
            *sum += T::from_f64(*d);
        }
    }

    /// Sums the gradients with respect to the inputs of actor and critic to the gradient with
    /// respect to the trunk's fields.
    fn add_head_gradients(&self, n: usize, w: &mut ActorCriticWorkspace<T>) {
        // written by the critic, then added to by the actor
        match self.settings().critic {
            CriticSettings::Pooled { .. } => {
                self.trunk.pool_features_backward(&w.critic.dx, n, &mut w.trunk)
            }
            CriticSettings::Joint { .. } => {
                w.trunk.d_feature_fields().copy_from_slice(&w.critic.dx)
            }
        }
        for (sum, d) in w.trunk.d_feature_fields().iter_mut().zip(&w.actor.dx) {
            *sum += *d;
        }
    }

    fn load_output_gradients(&self, n: usize, w: &mut ActorCriticWorkspace<T>) {
        let width = self.action_order.len();
        let gradients = w.d_mean.chunks_exact_mut(width);
        for (dy, d) in w.actor.dy.chunks_exact_mut(width).zip(gradients).take(n) {
            // the transform is symmetric, so its transpose is the transform itself
            self.spec().change_action_basis(d);
            for (component, &i) in dy.iter_mut().zip(&self.action_order) {
                *component = T::from_f64(d[i]);
            }
        }
        for (dy, &d) in w.critic.dy.iter_mut().zip(&w.d_value[..n]) {
            *dy = T::from_f64(d);
        }
    }
}

impl<T> HasTrunkWorkspace<T> for ActorCriticWorkspace<T> {
    fn trunk(&mut self) -> &mut TrunkWorkspace<T> {
        &mut self.trunk
    }
}

fn to_f64<T: Scalar>(from: &[T], to: &mut [f64]) {
    for (target, value) in to.iter_mut().zip(from) {
        *target = value.to_f64();
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;
    use symmetry::{Group, Irrep};

    use super::*;
    use crate::encoder::EncoderSettings;
    use crate::env::EnvSpec;
    use crate::network_settings::NetworkSettings;

    fn spec(image: [usize; 3]) -> EnvSpec {
        let vector = vec![Irrep::X, Irrep::Y, Irrep::Trivial, Irrep::Trivial];
        EnvSpec {
            num_envs: 1,
            image_shape: image,
            action_irreps: vector.clone(),
            choices: vec![],
            vector_irreps: vector,
        }
    }

    #[test]
    fn parts_cover_the_parameters_and_start_as_set() {
        let network =
            ActorCritic::<f32>::new(&NetworkSettings::default(), &spec([48, 48, 6])).unwrap();
        let params = network.init_params(&mut ChaCha8Rng::seed_from_u64(0));
        assert_eq!(params.len(), network.num_params());
        assert_eq!(
            (network.encoder_param_range().start, network.encoder_param_range().end),
            (0, network.non_encoder_param_range().start)
        );
        assert_eq!(
            (network.non_encoder_param_range().end, network.feature_dim()),
            (params.len(), 64)
        );
        assert_eq!(params[params.len() - 4..], [-0.5; 4]);
        let actor_out =
            &params[network.param_ranges().actor.end - 4 * 32..network.param_ranges().actor.end];
        assert!(actor_out.iter().all(|w| w.abs() < 0.02) && actor_out.iter().any(|&w| w != 0.0));
    }

    /// Settings of an encoder, image sizes that fit it and that do not, and the expected part of
    /// the error.
    fn sides() -> [(NetworkSettings, usize, [usize; 2], &'static str); 2] {
        [
            (NetworkSettings::default(), 48, [50, 8], "multiples of 16"),
            (NetworkSettings::so2_paper_128px(), 128, [64, 256], "exactly 128 x 128"),
        ]
    }

    #[test]
    fn image_sizes_that_break_exactness_are_refused_with_the_sizes_that_work() {
        for group in Group::ALL {
            for (settings, right, wrong, expected) in sides() {
                let settings = NetworkSettings { group, ..settings };
                let new = |image| ActorCritic::<f32>::new(&settings, &spec(image)).err();
                assert!(new([right, right, 6]).is_none());
                for side in wrong {
                    let message = new([side, side, 6]).unwrap().to_string();
                    assert!(message.contains(expected), "{message}");
                    assert!(message.contains(&format!("{side} x {side}")), "{message}");
                }
                let rectangle = new([right, 2 * right, 6]);
                match settings.encoder {
                    EncoderSettings::Pooled { .. } => {
                        let message = rectangle.unwrap().to_string();
                        assert!(message.contains("256 x 256"), "{message}");
                    }
                    _ => assert!(rectangle.is_none()),
                }
            }
        }
    }

    #[test]
    fn images_that_no_square_can_centre_are_refused_with_both_sides() {
        let error = ActorCritic::<f32>::new(&NetworkSettings::default(), &spec([48, 63, 6])).err();
        let named =
            matches!(error, Some(RlError::UnsupportedImageSize { height: 48, width: 63, .. }));
        assert!(named, "{error:?}");
    }

    #[test]
    fn networks_of_all_groups_are_equally_wide() {
        for group in Group::ALL {
            let settings = NetworkSettings { group, ..NetworkSettings::default() };
            let network = ActorCritic::<f32>::new(&settings, &spec([48, 48, 6])).unwrap();
            assert_eq!(network.trunk.out_type().dim(), 4 * 64);
            assert_eq!(network.feature_dim(), 4 * 64 / group.order());
        }
    }

    fn network() -> ActorCritic<f32> {
        let vector = vec![Irrep::X, Irrep::Y, Irrep::Trivial];
        let spec = EnvSpec {
            num_envs: 1,
            image_shape: [16, 16, 6],
            action_irreps: vector.clone(),
            choices: vec![],
            vector_irreps: vector,
        };
        ActorCritic::new(&NetworkSettings::default(), &spec).unwrap()
    }

    fn gradient(
        moved: impl Fn(ActorCriticWorkspace<f32>) -> ActorCriticWorkspace<f32>,
    ) -> Vec<f32> {
        let network = network();
        let params = network.init_params(&mut ChaCha8Rng::seed_from_u64(0));
        let mut workspace = network.new_workspace(4);
        for slot in 0..3 {
            let image: Vec<u8> = (0..16 * 16 * 6).map(|i| (i * 37 + slot) as u8).collect();
            network.load_observation(slot, &image, &[0.1, 0.2, slot as f32], &mut workspace);
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

    fn load(image: &[u8], vector: &[f32]) {
        let network = network();
        network.load_observation(0, image, vector, &mut network.new_workspace(2));
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
