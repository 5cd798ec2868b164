//! A graph of ONNX operators (opset 17) as it grows.

use crate::proto::Message;

/// Element types.
pub const FLOAT: i64 = 1;
pub const UINT8: i64 = 2;
const INT64: i64 = 7;
/// Types of attributes.
const ONE_INT: i64 = 2;
const INTS: i64 = 7;

/// The version of the operators, and of the format that came with it.
const OPSET: i64 = 17;
const IR_VERSION: i64 = 8;

/// Operators and constants, in the order in which they run.
#[derive(Default)]
pub struct Graph {
    nodes: Vec<Message>,
    constants: Vec<Message>,
}

/// An attribute of an operator.
pub enum Attribute {
    /// A whole number.
    Int(&'static str, i64),
    /// Whole numbers.
    Ints(&'static str, Vec<i64>),
}

impl Graph {
    /// Adds an operator whose one output bears the name `output`, and returns that.
    pub fn node(
        &mut self,
        operator: &str,
        inputs: &[&str],
        output: &str,
        attributes: &[Attribute],
    ) -> String {
        let inputs = inputs
            .iter()
            .fold(Message::new(), |m, name| m.bytes(1, name));
        let node = inputs.bytes(2, output).bytes(3, output).bytes(4, operator);
        let node = node.messages(5, attributes.iter().map(attribute));
        self.nodes.push(node);
        output.to_owned()
    }

    /// Adds numbers of this shape, and returns their name.
    pub fn floats(&mut self, name: &str, shape: &[usize], values: &[f32]) -> String {
        let bytes = values.iter().flat_map(|value| value.to_le_bytes());
        self.constant(name, FLOAT, shape, bytes.collect())
    }

    /// Adds whole numbers, and returns their name.
    pub fn ints(&mut self, name: &str, values: &[i64]) -> String {
        let bytes = values.iter().flat_map(|value| value.to_le_bytes());
        self.constant(name, INT64, &[values.len()], bytes.collect())
    }

    fn constant(&mut self, name: &str, kind: i64, shape: &[usize], bytes: Vec<u8>) -> String {
        let shape: Vec<i64> = shape.iter().map(|&side| side as i64).collect();
        let tensor = Message::new().ints(1, &shape).int(2, kind);
        self.constants.push(tensor.bytes(8, name).bytes(9, bytes));
        name.to_owned()
    }

    /// The bytes of a model with these inputs and outputs: names, element types, and sides after
    /// the batch.
    pub fn model(
        self,
        about: &str,
        inputs: &[(&str, i64, Vec<usize>)],
        outputs: &[(&str, i64, Vec<usize>)],
    ) -> Vec<u8> {
        let graph = Message::new()
            .messages(1, self.nodes)
            .bytes(2, "policy")
            .messages(5, self.constants)
            .messages(11, inputs.iter().map(value))
            .messages(12, outputs.iter().map(value));
        let opset = Message::new().bytes(1, "").int(2, OPSET);
        Message::new()
            .int(1, IR_VERSION)
            .bytes(2, "covers")
            .bytes(3, env!("CARGO_PKG_VERSION"))
            .bytes(6, about)
            .message(7, graph)
            .message(8, opset)
            .into_bytes()
    }
}

fn attribute(attribute: &Attribute) -> Message {
    match attribute {
        Attribute::Int(name, value) => Message::new()
            .bytes(1, name)
            .int(3, *value)
            .int(20, ONE_INT),
        Attribute::Ints(name, values) => {
            Message::new().bytes(1, name).ints(8, values).int(20, INTS)
        }
    }
}

/// An input or output `[B, ..]`.
fn value((name, kind, sides): &(&str, i64, Vec<usize>)) -> Message {
    let batch = Message::new().bytes(2, "B");
    let sides = sides.iter().map(|&side| Message::new().int(1, side as i64));
    let shape = Message::new().messages(1, [batch].into_iter().chain(sides));
    let tensor = Message::new().int(1, *kind).message(2, shape);
    Message::new()
        .bytes(1, name)
        .message(2, Message::new().message(1, tensor))
}
