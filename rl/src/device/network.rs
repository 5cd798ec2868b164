//! An actor-critic as part of a plan for a GPU: what it observes, and its layers.

use equivariant::Signature;
use equivariant::gpu::{GpuError, Plan, Program, Slot, Step, Tensor, Work};

use crate::network::ActorCritic;
use crate::network_settings::Critic;

/// WGSL: a row of [`Observed::draws`].
pub(crate) const DRAW: &str = include_str!("wgsl/draw.wgsl");

/// Observations on the device, and the draws from them that make up batches.
#[derive(Clone, Copy)]
pub(crate) struct Observed {
    /// Bytes of all pictures, four to a word.
    images: Slot,
    /// All vectors, irrep-major.
    vectors: Slot,
    /// Observation and advantage of each draw.
    pub draws: Slot,
}

/// What the network puts out, and where two kinds of parameters start.
pub(crate) struct Outputs {
    /// Mean actions, irrep-major.
    pub mean: Tensor,
    pub value: Tensor,
    /// The first parameter that is not the encoder's.
    pub heads: usize,
    /// The first logarithm of a standard deviation.
    pub log_std: usize,
}

impl Observed {
    /// Room for so many observations and draws; for no pictures where the network is blind.
    pub fn new(
        plan: &mut Plan,
        network: &ActorCritic<f32>,
        observations: usize,
        draws: usize,
    ) -> Self {
        let spec = network.spec();
        let picture = network.trunk.parts().sight.map_or(0, |_| spec.image_len());
        let bytes = observations.saturating_mul(picture);
        let components = observations.saturating_mul(spec.vector.len());
        Self {
            images: plan.buffer(bytes.div_ceil(4), 0),
            vectors: plan.buffer(components, 0),
            draws: plan.buffer(draws.saturating_mul(2), 0),
        }
    }

    /// Brings pictures `[N, H, W, C]` and vectors `[N, D]` to the device.
    pub fn write(
        self,
        program: &Program,
        network: &ActorCritic<f32>,
        images: &[u8],
        vectors: &[f32],
    ) {
        let parts = network.trunk.parts();
        // a blind network reads no picture
        if parts.sight.is_some() {
            program.write_bytes(self.images, images);
        }
        let order = parts.vector_order;
        let rows = vectors.chunks_exact(order.len());
        let components: Vec<f32> = rows
            .flat_map(|vector| order.iter().map(|&i| vector[i]))
            .collect();
        program.write(self.vectors, &components);
    }
}

/// Adds the passes of the network, from a batch's observations on.
pub(crate) fn add_network(
    plan: &mut Plan,
    network: &ActorCritic<f32>,
    observed: Observed,
) -> Result<Outputs, GpuError> {
    let parts = network.trunk.parts();
    let x_vector = plan.input(parts.vector.in_shape());
    let sight = parts.sight.map(|(encoder, concat)| {
        let x = plan.input(encoder.in_shape());
        (encoder, concat, x)
    });
    let gather = gather(plan, observed, sight.map(|(.., x)| x), x_vector);
    plan.push(vec![gather], Vec::new());
    let top = match sight {
        Some((encoder, _, x)) => Some(plan.layer(encoder, x)?),
        None => None,
    };
    let heads = plan.device_params();
    let fields = plan.layer(parts.vector, x_vector)?;
    let h = match (sight, top) {
        (Some((_, concat, _)), Some(top)) => plan.concat(concat, [top, fields]),
        _ => fields,
    };
    let [of_actor, of_critic] = plan.fork(h);
    let mean = plan.layer(&network.actor, of_actor)?;
    let of_critic = match network.settings().critic {
        Critic::Pooled { .. } => plan.layer(parts.pool, of_critic)?,
        Critic::Joint { .. } => of_critic,
    };
    let value = plan.layer(&network.critic, of_critic)?;
    let action = network.action_order.len();
    Ok(Outputs {
        mean,
        value,
        heads,
        log_std: plan.reserve(action, 0..action),
    })
}

/// Reads the observations of a batch; a blind network has no picture.
fn gather(plan: &mut Plan, observed: Observed, image: Option<Tensor>, vector: Tensor) -> Step {
    let pixels = image.map_or(0, |x| x.shape.len());
    let nothing = || plan.buffer(0, 0);
    let x_image = image.map_or_else(nothing, |x| x.values);
    let components = vector.shape.len();
    Step::new("gather", 1, Work::threads(pixels + components))
        .constants([("IMAGE", pixels), ("VECTOR", components)])
        .text(DRAW)
        .read("draws", "Draw", observed.draws)
        .read("images", "u32", observed.images)
        .read("vectors", "f32", observed.vectors)
        .write("x_image", "f32", x_image)
        .write("x_vector", "f32", vector.values)
        .text(include_str!("wgsl/gather.wgsl"))
}
