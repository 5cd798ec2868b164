//! ONNX model of a policy.

use rl::{ExportedActionDistribution, ExportedLayer, ExportedPolicy};

use super::graph::{ONNX_FLOAT_TYPE, ONNX_UINT8_TYPE, OnnxAttribute, OnnxGraph};

/// Serialises an ONNX model that maps `image` `[B, H, W, C]` (bytes) and `vector` `[B, D]` to
/// `action` `[B, A]`, `log_std` `[B, A]` and, if the policy has a critic, `value` `[B]`, for a
/// batch of B.
pub(super) fn onnx_model(policy: &ExportedPolicy, about: &str) -> Vec<u8> {
    let mut graph = OnnxGraph::default();
    let image = policy.image.as_ref().map(|layers| {
        let planes = planes(&mut graph);
        let top = chain(&mut graph, "image", layers, planes, Operators::Maps);
        graph.add_node("Flatten", &[&top], "image.fields", &[OnnxAttribute::Int("axis", 1)])
    });
    let vector = policy.vector.as_ref().map(|layers| {
        let input = "vector".to_owned();
        chain(&mut graph, "vector", layers, input, Operators::Vectors)
    });
    let parts: Vec<String> = image.into_iter().chain(vector).collect();
    let joined = joined(&mut graph, "joined", &parts);
    distribution(&mut graph, policy, joined.clone());
    if let Some((layers, pooled)) = &policy.critic {
        let input = if *pooled { features(&mut graph, &parts, policy.order) } else { joined };
        let value = chain(&mut graph, "critic", layers, input, Operators::Vectors);
        let flat = graph.add_int_constant("value.shape", &[-1]);
        graph.add_node("Reshape", &[&value, &flat], "value", &[]);
    }
    let actions = policy.spec.action_irreps.len();
    let mut inputs = Vec::new();
    if policy.image.is_some() {
        inputs.push(("image", ONNX_UINT8_TYPE, policy.spec.image_shape.to_vec()));
    }
    if policy.vector.is_some() {
        inputs.push(("vector", ONNX_FLOAT_TYPE, vec![policy.spec.vector_irreps.len()]));
    }
    let mut outputs = vec![
        ("action", ONNX_FLOAT_TYPE, vec![actions]),
        ("log_std", ONNX_FLOAT_TYPE, vec![actions]),
    ];
    outputs.extend(policy.critic.is_some().then(|| ("value", ONNX_FLOAT_TYPE, Vec::new())));
    graph.into_model_bytes(about, &inputs, &outputs)
}

/// ONNX operators of linear layers: convolutions of feature maps `[B, C, H, W]` (B samples, C
/// channels) or products of vectors `[B, C]`.
#[derive(Clone, Copy)]
enum Operators {
    Maps,
    Vectors,
}

/// Adds ONNX operators that turn image bytes `[B, H, W, C]` into floats `[B, C, H, W]` in
/// `[-0.5, 0.5]`.
fn planes(graph: &mut OnnxGraph) -> String {
    let scale = graph.add_float_constant("image.scale", &[], &[1.0 / 255.0]);
    let middle = graph.add_float_constant("image.middle", &[], &[0.5]);
    let cast = graph.add_node(
        "Cast",
        &["image"],
        "image.cast",
        &[OnnxAttribute::Int("to", ONNX_FLOAT_TYPE)],
    );
    let scaled = graph.add_node("Mul", &[&cast, &scale], "image.scaled", &[]);
    let centred = graph.add_node("Sub", &[&scaled, &middle], "image.centred", &[]);
    let order = OnnxAttribute::Ints("perm", vec![0, 3, 1, 2]);
    graph.add_node("Transpose", &[&centred], "image.planes", &[order])
}

fn chain(
    graph: &mut OnnxGraph,
    part: &str,
    layers: &[ExportedLayer],
    input: String,
    operators: Operators,
) -> String {
    let layers = layers.iter().enumerate();
    layers.fold(input, |input, (number, layer)| {
        let name = format!("{part}.{number}");
        add_layer(graph, &name, layer, &input, operators)
    })
}

fn add_layer(
    graph: &mut OnnxGraph,
    name: &str,
    layer: &ExportedLayer,
    input: &str,
    operators: Operators,
) -> String {
    let window = |size: usize, stride: usize, padding: usize| {
        let both = |side: usize| vec![side as i64; 2];
        [
            OnnxAttribute::Ints("kernel_shape", both(size)),
            OnnxAttribute::Ints("strides", both(stride)),
            OnnxAttribute::Ints("pads", vec![padding as i64; 4]),
        ]
    };
    match layer {
        ExportedLayer::Relu => graph.add_node("Relu", &[input], name, &[]),
        ExportedLayer::MaxPool(kernel) => {
            let window = window(kernel.size, kernel.stride, kernel.padding);
            graph.add_node("MaxPool", &[input], name, &window)
        }
        ExportedLayer::Linear { weight, shape, bias, window: kernel } => {
            let sides = match operators {
                Operators::Maps => &shape[..],
                Operators::Vectors => &shape[..2],
            };
            let weight = graph.add_float_constant(&format!("{name}.weight"), sides, weight);
            let bias = graph.add_float_constant(&format!("{name}.bias"), &[bias.len()], bias);
            let inputs = [input, &weight, &bias];
            match operators {
                Operators::Vectors => {
                    graph.add_node("Gemm", &inputs, name, &[OnnxAttribute::Int("transB", 1)])
                }
                Operators::Maps => {
                    let window = window(kernel.size, kernel.stride, kernel.padding);
                    graph.add_node("Conv", &inputs, name, &window)
                }
            }
        }
    }
}

/// Adds an operator that concatenates vectors along their components.
fn joined(graph: &mut OnnxGraph, name: &str, parts: &[String]) -> String {
    match parts {
        [alone] => alone.clone(),
        _ => {
            let parts: Vec<&str> = parts.iter().map(String::as_str).collect();
            graph.add_node("Concat", &parts, name, &[OnnxAttribute::Int("axis", 1)])
        }
    }
}

/// Adds operators for the invariant features: the maximum of each regular field (one component per
/// group element) over the elements.
fn features(graph: &mut OnnxGraph, parts: &[String], order: usize) -> String {
    let mut pool = |part: &String| {
        // 0 keeps the batch dimension, -1 takes the remaining components
        let shape = graph.add_int_constant(&format!("{part}.by_element"), &[0, order as i64, -1]);
        let fields = graph.add_node("Reshape", &[part, &shape], &format!("{part}.elements"), &[]);
        let axes = [OnnxAttribute::Ints("axes", vec![1]), OnnxAttribute::Int("keepdims", 0)];
        graph.add_node("ReduceMax", &[&fields], &format!("{part}.maxima"), &axes)
    };
    let pooled: Vec<String> = parts.iter().map(&mut pool).collect();
    joined(graph, "features", &pooled)
}

/// Adds the outputs `action` and `log_std` of the policy to the graph.
fn distribution(graph: &mut OnnxGraph, policy: &ExportedPolicy, input: String) {
    let actor = chain(graph, "actor", &policy.actor, input, Operators::Vectors);
    let width = policy.spec.action_irreps.len();
    match &policy.distribution {
        ExportedActionDistribution::Gaussian { log_std } => {
            graph.add_node("Identity", &[&actor], "action", &[]);
            let log_std = graph.add_float_constant("actor.log_std", &[1, width], log_std);
            // the deviations do not depend on the observation: one row is repeated for the batch
            let shape = graph.add_node("Shape", &[&actor], "action.shape", &[]);
            graph.add_node("Expand", &[&log_std, &shape], "log_std", &[]);
        }
        ExportedActionDistribution::TanhGaussian { log_std: [low, high] } => {
            let squashed = graph.add_node("Tanh", &[&actor], "squashed", &[]);
            let mut columns = |name: &str, from: usize| {
                let bounds = [from, from + width].map(|bound| bound as i64);
                let start = graph.add_int_constant(&format!("{name}.start"), &bounds[..1]);
                let end = graph.add_int_constant(&format!("{name}.end"), &bounds[1..]);
                let axis = graph.add_int_constant(&format!("{name}.axis"), &[1]);
                graph.add_node("Slice", &[&squashed, &start, &end, &axis], name, &[])
            };
            columns("action", 0);
            let share = columns("log_std.share", width);
            // the network's log_std is in [-1, 1] after the tanh; this maps it to [low, high]
            let half = (high - low) / 2.0;
            let (half, middle) = (
                graph.add_float_constant("log_std.half", &[], &[half]),
                graph.add_float_constant("log_std.middle", &[], &[low + half]),
            );
            let scaled = graph.add_node("Mul", &[&share, &half], "log_std.scaled", &[]);
            graph.add_node("Add", &[&scaled, &middle], "log_std", &[]);
        }
    }
}
