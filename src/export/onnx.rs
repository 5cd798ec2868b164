//! ONNX model of a policy.

use rl::{Distribution, ExportedLayer, ExportedPolicy};

use super::graph::{Attribute, FLOAT, Graph, UINT8};

/// Serialises a model that maps `image` `[B, H, W, C]` (bytes) and `vector` `[B, D]` to `action`
/// `[B, A]`, `log_std` `[B, A]` and, if the policy has a critic, `value` `[B]`.
pub(super) fn model(policy: &ExportedPolicy, about: &str) -> Vec<u8> {
    let mut graph = Graph::default();
    let image = policy.image.as_ref().map(|layers| {
        let planes = planes(&mut graph);
        let top = chain(&mut graph, "image", layers, planes, Operators::Maps);
        graph.node("Flatten", &[&top], "image.fields", &[Attribute::Int("axis", 1)])
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
        let flat = graph.ints("value.shape", &[-1]);
        graph.node("Reshape", &[&value, &flat], "value", &[]);
    }
    let actions = policy.spec.action.len();
    let mut inputs = Vec::new();
    if policy.image.is_some() {
        inputs.push(("image", UINT8, policy.spec.image.to_vec()));
    }
    if policy.vector.is_some() {
        inputs.push(("vector", FLOAT, vec![policy.spec.vector.len()]));
    }
    let mut outputs = vec![("action", FLOAT, vec![actions]), ("log_std", FLOAT, vec![actions])];
    outputs.extend(policy.critic.is_some().then(|| ("value", FLOAT, Vec::new())));
    graph.model(about, &inputs, &outputs)
}

/// Operators of linear layers: convolutions of maps `[B, C, H, W]` or products of vectors `[B, C]`.
#[derive(Clone, Copy)]
enum Operators {
    Maps,
    Vectors,
}

/// Adds operators that turn bytes `[B, H, W, C]` into floats `[B, C, H, W]` in [-0.5, 0.5].
fn planes(graph: &mut Graph) -> String {
    let scale = graph.floats("image.scale", &[], &[1.0 / 255.0]);
    let middle = graph.floats("image.middle", &[], &[0.5]);
    let cast = graph.node("Cast", &["image"], "image.cast", &[Attribute::Int("to", FLOAT)]);
    let scaled = graph.node("Mul", &[&cast, &scale], "image.scaled", &[]);
    let centred = graph.node("Sub", &[&scaled, &middle], "image.centred", &[]);
    let order = Attribute::Ints("perm", vec![0, 3, 1, 2]);
    graph.node("Transpose", &[&centred], "image.planes", &[order])
}

fn chain(
    graph: &mut Graph,
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

/// Adds the operator of one layer, and returns the name of its output.
fn add_layer(
    graph: &mut Graph,
    name: &str,
    layer: &ExportedLayer,
    input: &str,
    operators: Operators,
) -> String {
    let window = |size: usize, stride: usize, padding: usize| {
        let both = |side: usize| vec![side as i64; 2];
        [
            Attribute::Ints("kernel_shape", both(size)),
            Attribute::Ints("strides", both(stride)),
            Attribute::Ints("pads", vec![padding as i64; 4]),
        ]
    };
    match layer {
        ExportedLayer::Relu => graph.node("Relu", &[input], name, &[]),
        ExportedLayer::MaxPool(kernel) => {
            let window = window(kernel.size, kernel.stride, kernel.padding);
            graph.node("MaxPool", &[input], name, &window)
        }
        ExportedLayer::Linear { weight, shape, bias, window: kernel } => {
            let sides = match operators {
                Operators::Maps => &shape[..],
                Operators::Vectors => &shape[..2],
            };
            let weight = graph.floats(&format!("{name}.weight"), sides, weight);
            let bias = graph.floats(&format!("{name}.bias"), &[bias.len()], bias);
            let inputs = [input, &weight, &bias];
            match operators {
                Operators::Vectors => {
                    graph.node("Gemm", &inputs, name, &[Attribute::Int("transB", 1)])
                }
                Operators::Maps => {
                    let window = window(kernel.size, kernel.stride, kernel.padding);
                    graph.node("Conv", &inputs, name, &window)
                }
            }
        }
    }
}

/// Concatenates vectors along their components.
fn joined(graph: &mut Graph, name: &str, parts: &[String]) -> String {
    match parts {
        [alone] => alone.clone(),
        _ => {
            let parts: Vec<&str> = parts.iter().map(String::as_str).collect();
            graph.node("Concat", &parts, name, &[Attribute::Int("axis", 1)])
        }
    }
}

/// Adds the invariant features: the maximum over the group elements of each regular field.
fn features(graph: &mut Graph, parts: &[String], order: usize) -> String {
    let mut pool = |part: &String| {
        // 0 keeps the batch dimension, -1 takes the remaining components
        let shape = graph.ints(&format!("{part}.by_element"), &[0, order as i64, -1]);
        let fields = graph.node("Reshape", &[part, &shape], &format!("{part}.elements"), &[]);
        let axes = [Attribute::Ints("axes", vec![1]), Attribute::Int("keepdims", 0)];
        graph.node("ReduceMax", &[&fields], &format!("{part}.maxima"), &axes)
    };
    let pooled: Vec<String> = parts.iter().map(&mut pool).collect();
    joined(graph, "features", &pooled)
}

/// Adds the outputs `action` and `log_std`.
fn distribution(graph: &mut Graph, policy: &ExportedPolicy, input: String) {
    let actor = chain(graph, "actor", &policy.actor, input, Operators::Vectors);
    let width = policy.spec.action.len();
    match &policy.distribution {
        Distribution::Gaussian { log_std } => {
            graph.node("Identity", &[&actor], "action", &[]);
            let log_std = graph.floats("actor.log_std", &[1, width], log_std);
            // the deviations do not depend on the observation: one row is repeated for the batch
            let shape = graph.node("Shape", &[&actor], "action.shape", &[]);
            graph.node("Expand", &[&log_std, &shape], "log_std", &[]);
        }
        Distribution::TanhGaussian { log_std: [low, high] } => {
            let squashed = graph.node("Tanh", &[&actor], "squashed", &[]);
            let mut columns = |name: &str, from: usize| {
                let bounds = [from, from + width].map(|bound| bound as i64);
                let start = graph.ints(&format!("{name}.start"), &bounds[..1]);
                let end = graph.ints(&format!("{name}.end"), &bounds[1..]);
                let axis = graph.ints(&format!("{name}.axis"), &[1]);
                graph.node("Slice", &[&squashed, &start, &end, &axis], name, &[])
            };
            columns("action", 0);
            let share = columns("log_std.share", width);
            // the network's log_std is in [-1, 1] after the tanh; this maps it to [low, high]
            let half = (high - low) / 2.0;
            let (half, middle) = (
                graph.floats("log_std.half", &[], &[half]),
                graph.floats("log_std.middle", &[], &[low + half]),
            );
            let scaled = graph.node("Mul", &[&share, &half], "log_std.scaled", &[]);
            graph.node("Add", &[&scaled, &middle], "log_std", &[]);
        }
    }
}
