//! Safetensors of a policy's weights, with the names that PyTorch's `Sequential` uses.

use std::path::Path;

use rl::{ExportedActionDistribution, ExportedLayer, ExportedPolicy, Observations, PolicyOutput};
use safetensors::tensor::{Dtype, TensorView};

use experiments::RunError;

/// Name, element type, shape and bytes of an exported array.
type Array = (String, Dtype, Vec<usize>, Vec<u8>);

/// Serialises a policy's weights and biases as safetensors, named `image.0.weight` and so on:
/// convolutions `[C_out, C_in, size, size]`, matrices `[C_out, C_in]`. Errors name `path`, the file
/// that will be written.
pub(super) fn safetensors_weights(
    policy: &ExportedPolicy,
    path: &Path,
) -> Result<Vec<u8>, RunError> {
    let mut arrays = Vec::new();
    for (part, layers, maps) in network_parts(policy) {
        for (number, layer) in layers.iter().enumerate() {
            if let ExportedLayer::Linear { weight, shape, bias, .. } = layer {
                let shape = if maps { &shape[..] } else { &shape[..2] };
                arrays.push(floats(&format!("{part}.{number}.weight"), shape, weight));
                arrays.push(floats(&format!("{part}.{number}.bias"), &[bias.len()], bias));
            }
        }
    }
    if let ExportedActionDistribution::Gaussian { log_std } = &policy.distribution {
        arrays.push(floats("log_std", &[log_std.len()], log_std));
    }
    serialize(arrays, path)
}

/// Returns the name and layers of each part of a policy's network, and `true` for a part that runs
/// on feature maps.
pub(super) fn network_parts(
    policy: &ExportedPolicy,
) -> Vec<(&'static str, &[ExportedLayer], bool)> {
    let image = policy.image.iter().map(|layers| ("image", &layers[..], true));
    let critic = policy.critic.iter().map(|(layers, _)| ("critic", &layers[..], false));
    let vector = policy.vector.iter().map(|layers| ("vector", &layers[..], false));
    let actor = [("actor", &policy.actor[..], false)];
    image.chain(vector).chain(actor).chain(critic).collect()
}

/// Serialises observations and the policy's outputs for them as safetensors, as a reference for
/// other programs.
pub(super) fn reference_outputs(
    policy: &ExportedPolicy,
    observations: &Observations,
    answers: &PolicyOutput,
    path: &Path,
) -> Result<Vec<u8>, RunError> {
    let [height, width, channels] = policy.spec.image_shape;
    let (vector, action) = (policy.spec.vector_irreps.len(), policy.spec.action_irreps.len());
    let samples = answers.actions.len() / action;
    let image = vec![samples, height, width, channels];
    let mut arrays = vec![
        ("image".to_owned(), Dtype::U8, image, observations.images.clone()),
        floats("vector", &[samples, vector], &observations.vectors),
        floats("action", &[samples, action], &answers.actions),
        floats("log_std", &[samples, action], &answers.log_std),
    ];
    let values = answers.values.iter();
    arrays.extend(values.map(|values| floats("value", &[samples], values)));
    serialize(arrays, path)
}

fn floats(name: &str, shape: &[usize], values: &[f32]) -> Array {
    let bytes = values.iter().flat_map(|value| value.to_le_bytes());
    (name.to_owned(), Dtype::F32, shape.to_vec(), bytes.collect())
}

fn serialize(arrays: Vec<Array>, path: &Path) -> Result<Vec<u8>, RunError> {
    let views = arrays.iter().map(|(name, dtype, shape, bytes)| {
        TensorView::new(*dtype, shape.clone(), bytes).map(|view| (name, view))
    });
    let views = views.collect::<Result<Vec<_>, _>>();
    views
        .and_then(|views| safetensors::serialize(views, None))
        .map_err(RunError::write_error_mapper(path))
}
