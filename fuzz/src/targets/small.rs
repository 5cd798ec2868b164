//! Limits on networks and settings that keep fuzzing fast: large sizes are a choice of the user,
//! not a failure.

use covers::{Experiment, LearnerSettings};
use rl::{CriticSettings, EncoderSettings, NetworkSettings, RecurrentContextSettings};

/// Returns the smallest network for images of 16 x 16 pixels or multiples.
pub fn small_network() -> NetworkSettings {
    NetworkSettings {
        encoder: EncoderSettings::Strided { fields: vec![1; 4] },
        top_fields: 1,
        vector_fields: 1,
        actor_fields: 1,
        critic: CriticSettings::Joint { fields: 1 },
        ..NetworkSettings::default()
    }
}

/// Returns `true` if the check of an experiment builds small networks and rollouts alone.
pub fn is_small(experiment: &Experiment) -> bool {
    is_small_learner(&experiment.learner)
        && experiment.envs.camera.size <= 48
        && experiment.schedule.total_decisions() <= 100_000
}

/// Returns `true` if a learner is built quickly.
pub fn is_small_learner(learner: &LearnerSettings) -> bool {
    let network = match learner {
        LearnerSettings::Covers(settings) => &settings.network,
        LearnerSettings::OffPolicy(settings) => &settings.network,
    };
    is_small_network(network) && has_small_context(learner) && learner.rollout_steps() <= 400
}

/// Returns `true` if a learner has no context or a small one.
fn has_small_context(learner: &LearnerSettings) -> bool {
    let LearnerSettings::OffPolicy(settings) = learner else {
        return true;
    };
    let is_small = |context: RecurrentContextSettings| context.size <= 32 && context.length <= 8;
    settings.context.is_none_or(is_small)
}

fn is_small_network(network: &NetworkSettings) -> bool {
    let (CriticSettings::Pooled { width: critic } | CriticSettings::Joint { fields: critic }) =
        network.critic;
    let inputs = [network.top_fields, network.vector_fields];
    let heads = [network.actor_fields, critic];
    let widths = widths(&network.encoder).into_iter();
    let mut widths = widths.chain(inputs).chain(heads);
    widths.all(|width| width <= 8)
}

fn widths(encoder: &EncoderSettings) -> Vec<usize> {
    match encoder {
        EncoderSettings::Strided { fields } => fields.clone(),
        EncoderSettings::Pooled { fields, inner, .. } => [&fields[..], &inner[..]].concat(),
        EncoderSettings::Blind => Vec::new(),
    }
}
