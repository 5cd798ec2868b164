//! Actor-critic networks as kernels on a GPU, and a policy that runs its network on a GPU.

use std::fmt;
use std::ops::Range;
use std::sync::Arc;

use equivariant::LayerSignature;
use equivariant::gpu::{
    BatchUniforms, BufferSlot, CompiledPlan, ComputePlan, GpuDevice, GpuError, KernelDispatch,
    PassesToRun, PlannedFeatureMap, WorkgroupCount,
};
use rand_chacha::ChaCha8Rng;

use crate::env::{EnvSpec, Observations};
use crate::error::{RlError, require};
use crate::network::ActorCritic;
use crate::network_policy::{ActorCriticPolicy, impl_gaussian_policy};
use crate::network_settings::CriticSettings;
use crate::policy::{Actor, Decisions, OnPolicyActor, ValueFunction};

/// WGSL source of the struct of an entry of [`ObservationBuffers::samples`]: a decision's index and
/// advantage.
pub(crate) const SAMPLE_STRUCT_WGSL: &str = include_str!("device/wgsl/sample.wgsl");

/// GPU buffers of observations, and of the samples of batches, which refer to observations by
/// index.
#[derive(Clone, Copy)]
pub(crate) struct ObservationBuffers {
    /// Buffer of the bytes of all images, four in a 32-bit word.
    images: BufferSlot,
    /// Buffer of all observation vectors, components in irrep-major order (sorted by irrep).
    vectors: BufferSlot,
    /// Buffer of the samples of batches: for each, the index of its observation and the advantage
    /// of its decision.
    pub samples: BufferSlot,
}

/// Output tensors of an actor-critic network on a GPU, and the start of two of its parameter
/// ranges.
pub(crate) struct NetworkOutputs {
    /// Mean actions of the policy, components in irrep-major order.
    pub mean: PlannedFeatureMap,
    pub value: PlannedFeatureMap,
    /// Index in the GPU's parameter buffer of the first parameter after those of the image encoder.
    pub head_params_start: usize,
    /// Index in the GPU's parameter buffer of the first log_std.
    pub log_std_start: usize,
}

impl ObservationBuffers {
    /// Reserves GPU buffers for `observations` observations and for batches of `samples` samples in
    /// all; without images if the network has no image encoder.
    pub fn new(
        plan: &mut ComputePlan,
        network: &ActorCritic<f32>,
        observations: usize,
        samples: usize,
    ) -> Self {
        let spec = network.spec();
        let encoder = network.trunk.encoder.as_ref();
        let picture = encoder.map_or(0, |encoder| encoder.in_shape().len());
        let bytes = observations.saturating_mul(picture);
        let components = observations.saturating_mul(spec.vector_irreps.len());
        Self {
            images: plan.add_buffer(bytes.div_ceil(4), 0),
            vectors: plan.add_buffer(components, 0),
            samples: plan.add_buffer(samples.saturating_mul(2), 0),
        }
    }

    /// Copies images `[N, H, W, C]`, padded to the encoder's input size, and vectors `[N, D]`,
    /// reordered to irrep-major order, to the GPU; no images without an image encoder.
    pub fn upload(
        self,
        program: &CompiledPlan,
        network: &ActorCritic<f32>,
        images: &[u8],
        vectors: &[f32],
    ) {
        // a blind network has no buffer for images, even if the environment has some
        if network.trunk.encoder.is_some() {
            program.write_bytes(self.images, &network.trunk.pad_to_input_size(images));
        }
        let order = &network.trunk.vector_order;
        let rows = vectors.chunks_exact(order.len().max(1));
        let components: Vec<f32> =
            rows.flat_map(|vector| order.iter().map(|&i| vector[i])).collect();
        program.write_floats(self.vectors, &components);
    }
}

/// Adds the forward and backward pass of the network, on the observations of a batch, to the
/// kernels in `plan`; returns its output tensors.
pub(crate) fn add_network(
    plan: &mut ComputePlan,
    network: &ActorCritic<f32>,
    observation_buffers: ObservationBuffers,
) -> Result<NetworkOutputs, GpuError> {
    let trunk = &network.trunk;
    let image = trunk.encoder.as_ref().map(|layers| plan.add_input(layers.in_shape()));
    let vector = trunk.vector.as_ref().map(|layers| plan.add_input(layers.in_shape()));
    let gather = gather_kernel(plan, observation_buffers, image, vector);
    plan.add_kernels(vec![gather], Vec::new());
    let top = match (&trunk.encoder, image) {
        (Some(layers), Some(x)) => Some(plan.add_layer(layers, x)?),
        _ => None,
    };
    // parameters are laid out in the order in which layers are added: the encoder's come first
    let head_params_start = plan.num_device_params();
    let fields = match (&trunk.vector, vector) {
        (Some(layers), Some(x)) => Some(plan.add_layer(layers, x)?),
        _ => None,
    };
    let h = match (&trunk.concat, top, fields) {
        (Some(concat), Some(top), Some(fields)) => plan.add_concat(concat, [top, fields]),
        (_, Some(alone), None) | (_, None, Some(alone)) => alone,
        _ => unreachable!("a trunk has an input, and joins two"),
    };
    // h has two readers: the fork adds up their gradients
    let [of_actor, of_critic] = plan.add_fork(h);
    let mean = plan.add_layer(&network.actor, of_actor)?;
    let of_critic = match network.settings().critic {
        CriticSettings::Pooled { .. } => plan.add_layer(&trunk.pool, of_critic)?,
        CriticSettings::Joint { .. } => of_critic,
    };
    let value = plan.add_layer(&network.critic, of_critic)?;
    let action = network.action_order.len();
    Ok(NetworkOutputs {
        mean,
        value,
        head_params_start,
        log_std_start: plan.reserve_params(action, 0..action),
    })
}

/// Creates the GPU kernel that copies a batch's observations to the network's inputs; a network may
/// have no image or no vector.
fn gather_kernel(
    plan: &mut ComputePlan,
    observation_buffers: ObservationBuffers,
    image: Option<PlannedFeatureMap>,
    vector: Option<PlannedFeatureMap>,
) -> KernelDispatch {
    let [pixels, components] = [image, vector].map(|x| x.map_or(0, |x| x.shape.len()));
    let [x_image, x_vector] =
        [image, vector].map(|x| x.map_or_else(|| plan.add_buffer(0, 0), |x| x.values));
    KernelDispatch::new("gather", 1, WorkgroupCount::for_threads_per_sample(pixels + components))
        .add_u32_constants([("IMAGE", pixels), ("VECTOR", components)])
        .add_wgsl(SAMPLE_STRUCT_WGSL)
        .add_input_buffer("samples", "Sample", observation_buffers.samples)
        .add_input_buffer("images", "u32", observation_buffers.images)
        .add_input_buffer("vectors", "f32", observation_buffers.vectors)
        .add_output_buffer("x_image", "f32", x_image)
        .add_output_buffer("x_vector", "f32", x_vector)
        .add_wgsl(include_str!("device/wgsl/gather.wgsl"))
}

/// An [`ActorCriticPolicy`] whose mean actions and state values a GPU computes, for batches that
/// are large enough to keep the GPU busy. The policy itself computes actions and log-probabilities
/// from them, so its decisions equal the policy's up to rounding.
///
/// A call is one round trip to the GPU, or several if the batch exceeds the allocated samples. For
/// few images it may take longer than on the CPU.
pub struct GpuPolicy {
    policy: ActorCriticPolicy,
    /// Network whose passes were compiled for the GPU.
    network: Arc<ActorCritic<f32>>,
    plan: ComputePlan,
    program: CompiledPlan,
    observation_buffers: ObservationBuffers,
    /// GPU buffers of the mean actions `[N, A]`, components in irrep-major order, and of the state
    /// values `[N]`.
    outputs: [BufferSlot; 2],
    /// `true` if the GPU holds the policy's current parameters.
    params_are_uploaded: bool,
}

impl GpuPolicy {
    /// Compiles the policy's network for a GPU, with buffers for `samples` observations at a time.
    ///
    /// # Errors
    /// [`RlError::InvalidSetting`] for 0 samples; [`RlError::Gpu`] if a buffer would exceed the
    /// adapter's limits (before anything is allocated), or if the device fails.
    pub fn new(
        policy: ActorCriticPolicy,
        device: &GpuDevice,
        samples: usize,
    ) -> Result<Self, RlError> {
        require("samples", samples as f32, "at least 1", samples > 0)?;
        let mut plan = ComputePlan::new();
        let network = Arc::clone(policy.network());
        let observation_buffers = ObservationBuffers::new(&mut plan, &network, samples, samples);
        let outputs = add_network(&mut plan, &network, observation_buffers)?;
        let plan = plan.forward_only();
        let program = CompiledPlan::new(device, &plan, samples)?;
        // sample i is observation i, with an advantage of 0 that nothing reads
        let identity: Vec<u32> = (0..samples as u32).flat_map(|i| [i, 0]).collect();
        program.write_words(observation_buffers.samples, &identity);
        Ok(Self {
            policy,
            network,
            plan,
            program,
            observation_buffers,
            outputs: [outputs.mean.values, outputs.value.values],
            params_are_uploaded: false,
        })
    }

    /// Returns the policy whose mean actions and state values the GPU computes.
    pub fn policy(&self) -> &ActorCriticPolicy {
        &self.policy
    }

    /// Returns the policy for a change of its parameters, such as an update. Its parameters are
    /// copied to the device at the next decision, which fails with [`RlError::NetworkMismatch`] if
    /// the policy was replaced by one with another network.
    pub fn policy_mut(&mut self) -> &mut ActorCriticPolicy {
        self.params_are_uploaded = false;
        &mut self.policy
    }

    /// Computes the network's outputs for N observations on the GPU and copies them to the policy;
    /// returns N.
    fn run(&mut self, observations: &Observations) -> Result<usize, RlError> {
        if !Arc::ptr_eq(&self.network, self.policy.network()) {
            return Err(RlError::NetworkMismatch);
        }
        let spec = self.network.spec();
        let (samples, width) = (observations.checked_num_samples(spec)?, spec.action_irreps.len());
        if !self.params_are_uploaded {
            let params = self.plan.params_to_device_order(self.policy.params());
            self.program.write_floats(self.plan.params_buffer(), &params);
        }
        // an error below may mean that the parameters did not reach the device: write them again
        self.params_are_uploaded = false;
        self.policy.outputs.resize(samples * (width + 1), 0.0);
        let most = self.program.max_samples();
        for start in (0..samples).step_by(most) {
            self.run_batch(observations, start..samples.min(start + most))?;
        }
        self.params_are_uploaded = samples > 0;
        Ok(samples)
    }

    fn run_batch(
        &mut self,
        observations: &Observations,
        range: Range<usize>,
    ) -> Result<(), GpuError> {
        let network = &self.network;
        let EnvSpec { vector_irreps: vector, action_irreps: action, .. } = network.spec();
        let (pixels, width) = (network.spec().image_len(), action.len());
        let images = &observations.images[range.start * pixels..range.end * pixels];
        let vectors = &observations.vectors[range.start * vector.len()..range.end * vector.len()];
        self.observation_buffers.upload(&self.program, network, images, vectors);
        let samples = range.len();
        let batch = BatchUniforms { samples, ..BatchUniforms::default() };
        self.program.submit_passes(PassesToRun::Forward, batch);
        let [mean, value] = self.outputs;
        let requests = [(mean, samples * width), (value, samples)];
        let [means, values] = self.program.read_floats(requests)?;
        let rows = self.policy.outputs[range.start * (width + 1)..].chunks_exact_mut(width + 1);
        for ((row, mean_row), &state_value) in rows.zip(means.chunks_exact(width)).zip(&values) {
            for (&i, &component) in network.action_order.iter().zip(mean_row) {
                row[i] = component.into();
            }
            network.spec().change_action_basis(&mut row[..width]);
            row[width] = state_value.into();
        }
        Ok(())
    }
}

impl_gaussian_policy!(GpuPolicy);

impl fmt::Debug for GpuPolicy {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.debug_struct("GpuPolicy")
            .field("policy", &self.policy)
            .field("adapter", &self.program.device().adapter().name)
            .field("samples", &self.program.max_samples())
            .finish()
    }
}
