//! JSON description of an exported policy's inputs, outputs and layers.

use envs::ExtraViews;
use rl::{ExportedActionDistribution, ExportedLayer, ExportedPolicy};
use serde_json::{Map, Value, json};

use experiments::{Experiment, VECTOR_INPUT_SCALING};

use super::weights::network_parts;

/// Name and version of the format of an exported policy's description.
const FORMAT: &str = "covers-policy 1";

/// Describes policy `index` of a run: inputs, outputs, layers, and the environments of training.
pub(super) fn policy_description(policy: &ExportedPolicy, index: usize, run: &Experiment) -> Value {
    let layers = network_parts(policy).into_iter().map(|(part, layers, _)| {
        let layers: Vec<Value> = layers.iter().map(layer).collect();
        (part.to_owned(), Value::from(layers))
    });
    json!({
        "format": FORMAT,
        "policy": index,
        "inputs": inputs(policy, run),
        "outputs": outputs(policy, run),
        "environment": {
            "layout": run.envs.layout,
            "embodiment": run.envs.embodiment,
            "horizon": run.envs.control.horizon,
        },
        "group_order": policy.order,
        "critic_reads_maxima": policy.critic.as_ref().is_some_and(|(_, pooled)| *pooled),
        "layers": layers.collect::<Map<_, _>>(),
    })
}

/// Returns a line for each input and output of a [`policy_description`], with its shape and type.
pub(super) fn tensor_lines(about: &Value) -> Vec<String> {
    let lines = |kind: &'static str, tensors: &Value| {
        let tensors = tensors.as_object().cloned().unwrap_or_default();
        let line = move |(name, tensor): (String, Value)| {
            let sides = tensor["shape"].as_array()?.iter();
            let sides: Vec<String> = sides.map(|side| side.to_string().replace('"', "")).collect();
            Some(format!("{kind} {name} [{}] {}", sides.join(", "), tensor["type"].as_str()?))
        };
        tensors.into_iter().filter_map(line)
    };
    lines("input", &about["inputs"]).chain(lines("output", &about["outputs"])).collect()
}

fn inputs(policy: &ExportedPolicy, run: &Experiment) -> Value {
    let camera = &run.envs.camera;
    let beside: &[&str] = match camera.extra_views {
        ExtraViews::First => &["the episode's first"],
        ExtraViews::CloseUp => &["the close-up"],
        ExtraViews::FirstAndCloseUp => &["the episode's first", "the close-up"],
    };
    let pictures = [&["the picture"], beside].concat();
    let pictures = pictures.iter().map(|own| format!("red, green, blue of {own}"));
    let [height, width, channels] = policy.spec.image_shape;
    let components = VECTOR_INPUT_SCALING.map(|input| {
        json!({
            "name": input.name, "unit": input.unit,
            "offset": input.offset, "factor": input.factor,
        })
    });
    // a policy without one of them has no such input in its ONNX model
    let mut inputs = json!({});
    if policy.image.is_some() {
        inputs["image"] = json!({
            "shape": ["B", height, width, channels], "type": "uint8",
            "channels": pictures.collect::<Vec<_>>().join("; "),
            "camera": camera,
            "axes": "row 0 is the largest y, column 0 the smallest x",
            "scaling": "byte / 255 - 0.5, which the ONNX model does itself",
        });
    }
    if policy.vector.is_some() {
        inputs["vector"] = json!({
            "shape": ["B", policy.spec.vector_irreps.len()], "type": "float32",
            "scaling": "(value - offset) * factor, before the model; goals that are hidden are 0",
            "components": components,
        });
    }
    inputs
}

fn outputs(policy: &ExportedPolicy, run: &Experiment) -> Value {
    let width = policy.spec.action_irreps.len();
    let control = &run.envs.control;
    let (distribution, deviations) = match policy.distribution {
        ExportedActionDistribution::Gaussian { .. } => (json!({"kind": "gaussian"}), "actions"),
        ExportedActionDistribution::TanhGaussian { log_std } => {
            let kind = json!({"kind": "tanh_gaussian", "log_std_range": log_std});
            (kind, "the Gaussian before a tanh")
        }
    };
    let mut outputs = json!({
        "action": {
            "shape": ["B", width], "type": "float32",
            "components": ["x", "y", "z", "fingers"],
            "meaning": "what the policy does by its mean; clip it to [-1, 1]. x, y and z move the \
                        hand's target by so many times `displacement` in one decision; fingers \
                        close above 0",
            "displacement": control.displacement,
            "control_steps_per_decision": control.action_repeat,
        },
        "log_std": {
            "shape": ["B", width], "type": "float32",
            "meaning": format!("logarithms of the standard deviations of {deviations}"),
        },
        "distribution": distribution,
    });
    if policy.critic.is_some() {
        let meaning = "discounted sum of the rewards to come";
        outputs["value"] = json!({"shape": ["B"], "type": "float32", "meaning": meaning});
    }
    outputs
}

fn layer(layer: &ExportedLayer) -> Value {
    match layer {
        ExportedLayer::Relu => json!({"kind": "relu"}),
        ExportedLayer::MaxPool(window) => json!({
            "kind": "max_pool", "size": window.size, "stride": window.stride,
            "padding": window.padding,
        }),
        ExportedLayer::Linear { shape, window, .. } => json!({
            "kind": "linear", "out": shape[0], "in": shape[1], "size": shape[2],
            "stride": window.stride, "padding": window.padding,
        }),
    }
}
