//! Networks and settings that take no time: sizes are part of what a person asks for.

use covers::{Experiment, LearnerSettings};
use rl::{Critic, Encoder, NetworkSettings};

/// The smallest network that takes pictures of 16 x 16 pixels or multiples.
pub fn small_network() -> NetworkSettings {
    NetworkSettings {
        encoder: Encoder::Strided { fields: vec![1; 4] },
        top_fields: 1,
        vector_fields: 1,
        actor_fields: 1,
        critic: Critic::Joint { fields: 1 },
        ..NetworkSettings::default()
    }
}

/// Whether checking builds networks and rollouts that take no time.
pub fn is_small(experiment: &Experiment) -> bool {
    is_small_learner(&experiment.learner)
        && experiment.envs.camera.size <= 48
        && experiment.schedule.total_decisions() <= 100_000
}

/// Whether building the learner takes no time.
pub fn is_small_learner(learner: &LearnerSettings) -> bool {
    let (network, context) = match learner {
        LearnerSettings::Covers(settings) => (&settings.network, None),
        LearnerSettings::OffPolicy(settings) => (&settings.network, settings.context),
    };
    is_small_network(network)
        && context.is_none_or(|context| context.size <= 32 && context.length <= 8)
        && learner.rollout_steps() <= 400
}

fn is_small_network(network: &NetworkSettings) -> bool {
    let fields = match &network.encoder {
        Encoder::Strided { fields }
        | Encoder::Pooled { fields, .. }
        | Encoder::Keypoints { fields, .. } => &fields[..],
        Encoder::Blind => &[],
    };
    let (Critic::Pooled { width: critic } | Critic::Joint { fields: critic }) = network.critic;
    let inner = match &network.encoder {
        Encoder::Pooled { inner, .. } => inner.to_vec(),
        Encoder::Keypoints { maps, .. } => vec![*maps],
        Encoder::Strided { .. } | Encoder::Blind => vec![],
    };
    let heads = [
        network.top_fields,
        network.vector_fields,
        network.actor_fields,
        critic,
    ];
    let mut widths = fields.iter().chain(&inner).chain(&heads);
    widths.all(|&width| width <= 8)
}
