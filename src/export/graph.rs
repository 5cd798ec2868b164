//! Builder of a graph of ONNX operators (opset 17), and the messages of its file (onnx.proto).

use prost::Message;

/// Element type `float` of ONNX tensors, by its number in `TensorProto.DataType`.
pub const ONNX_FLOAT_TYPE: i64 = 1;
/// Element type `uint8` of ONNX tensors, by its number in `TensorProto.DataType`.
pub const ONNX_UINT8_TYPE: i64 = 2;
const INT64: i32 = 7;
/// Types of ONNX attributes, numbered as in `AttributeProto.AttributeType`.
const ONE_INT: i32 = 2;
const INTS: i32 = 7;

/// Version of the ONNX operators, and of the file format that was released with it.
const OPSET: i64 = 17;
const IR_VERSION: i64 = 8;

#[derive(Clone, PartialEq, Message)]
struct Model {
    #[prost(int64, tag = "1")]
    ir_version: i64,
    #[prost(string, tag = "2")]
    producer_name: String,
    #[prost(string, tag = "3")]
    producer_version: String,
    #[prost(string, tag = "6")]
    doc_string: String,
    #[prost(message, optional, tag = "7")]
    graph: Option<GraphMessage>,
    #[prost(message, repeated, tag = "8")]
    opset_import: Vec<Opset>,
}

#[derive(Clone, PartialEq, Message)]
struct Opset {
    /// Domain of the ONNX operators; empty for ONNX's own.
    #[prost(string, tag = "1")]
    domain: String,
    #[prost(int64, tag = "2")]
    version: i64,
}

#[derive(Clone, PartialEq, Message)]
struct GraphMessage {
    #[prost(message, repeated, tag = "1")]
    nodes: Vec<Node>,
    #[prost(string, tag = "2")]
    name: String,
    #[prost(message, repeated, tag = "5")]
    initializers: Vec<Tensor>,
    #[prost(message, repeated, tag = "11")]
    inputs: Vec<Value>,
    #[prost(message, repeated, tag = "12")]
    outputs: Vec<Value>,
}

#[derive(Clone, PartialEq, Message)]
struct Node {
    #[prost(string, repeated, tag = "1")]
    inputs: Vec<String>,
    #[prost(string, repeated, tag = "2")]
    outputs: Vec<String>,
    #[prost(string, tag = "3")]
    name: String,
    #[prost(string, tag = "4")]
    operator: String,
    #[prost(message, repeated, tag = "5")]
    attributes: Vec<AttributeMessage>,
}

#[derive(Clone, PartialEq, Message)]
struct AttributeMessage {
    #[prost(string, tag = "1")]
    name: String,
    #[prost(int64, optional, tag = "3")]
    int: Option<i64>,
    #[prost(int64, repeated, packed = "false", tag = "8")]
    ints: Vec<i64>,
    #[prost(int32, tag = "20")]
    kind: i32,
}

#[derive(Clone, PartialEq, Message)]
struct Tensor {
    #[prost(int64, repeated, packed = "false", tag = "1")]
    dims: Vec<i64>,
    #[prost(int32, tag = "2")]
    data_type: i32,
    #[prost(string, tag = "8")]
    name: String,
    /// Values of the tensor as little-endian bytes in row-major order.
    #[prost(bytes = "vec", tag = "9")]
    raw_data: Vec<u8>,
}

/// Input or output of an ONNX graph.
#[derive(Clone, PartialEq, Message)]
struct Value {
    #[prost(string, tag = "1")]
    name: String,
    #[prost(message, optional, tag = "2")]
    kind: Option<ValueKind>,
}

#[derive(Clone, PartialEq, Message)]
struct ValueKind {
    #[prost(message, optional, tag = "1")]
    tensor: Option<TensorKind>,
}

#[derive(Clone, PartialEq, Message)]
struct TensorKind {
    #[prost(int32, tag = "1")]
    element: i32,
    #[prost(message, optional, tag = "2")]
    shape: Option<Shape>,
}

#[derive(Clone, PartialEq, Message)]
struct Shape {
    #[prost(message, repeated, tag = "1")]
    sides: Vec<Side>,
}

/// Dimension of an ONNX tensor: of fixed length, or of any length with a name.
#[derive(Clone, PartialEq, Message)]
struct Side {
    #[prost(int64, optional, tag = "1")]
    length: Option<i64>,
    #[prost(string, optional, tag = "2")]
    name: Option<String>,
}

/// Operators and constants of an ONNX graph, in the order in which they run.
#[derive(Default)]
pub struct OnnxGraph {
    nodes: Vec<Node>,
    constants: Vec<Tensor>,
}

/// Attribute of an ONNX operator.
pub enum OnnxAttribute {
    /// Name and value of an integer attribute.
    Int(&'static str, i64),
    /// Name and values of an attribute that is a list of integers.
    Ints(&'static str, Vec<i64>),
}

impl OnnxGraph {
    /// Adds an operator to the graph whose single output has the name `output`, and returns that
    /// name.
    pub fn add_node(
        &mut self,
        operator: &str,
        inputs: &[&str],
        output: &str,
        attributes: &[OnnxAttribute],
    ) -> String {
        self.nodes.push(Node {
            inputs: inputs.iter().map(|&name| name.to_owned()).collect(),
            outputs: vec![output.to_owned()],
            name: output.to_owned(),
            operator: operator.to_owned(),
            attributes: attributes.iter().map(attribute).collect(),
        });
        output.to_owned()
    }

    /// Adds a constant tensor of this shape to the graph, and returns its name.
    pub fn add_float_constant(&mut self, name: &str, shape: &[usize], values: &[f32]) -> String {
        let bytes = values.iter().flat_map(|value| value.to_le_bytes());
        self.constant(name, ONNX_FLOAT_TYPE as i32, shape, bytes.collect())
    }

    /// Adds a constant vector of integers to the graph, and returns its name.
    pub fn add_int_constant(&mut self, name: &str, values: &[i64]) -> String {
        let bytes = values.iter().flat_map(|value| value.to_le_bytes());
        self.constant(name, INT64, &[values.len()], bytes.collect())
    }

    fn constant(&mut self, name: &str, data_type: i32, shape: &[usize], raw: Vec<u8>) -> String {
        self.constants.push(Tensor {
            dims: shape.iter().map(|&side| side as i64).collect(),
            data_type,
            name: name.to_owned(),
            raw_data: raw,
        });
        name.to_owned()
    }

    /// Serialises the graph as an ONNX model with these inputs and outputs, given by name, element
    /// type, and the dimensions after the batch.
    pub fn into_model_bytes(
        self,
        about: &str,
        inputs: &[(&str, i64, Vec<usize>)],
        outputs: &[(&str, i64, Vec<usize>)],
    ) -> Vec<u8> {
        let graph = GraphMessage {
            nodes: self.nodes,
            name: "policy".to_owned(),
            initializers: self.constants,
            inputs: inputs.iter().map(value).collect(),
            outputs: outputs.iter().map(value).collect(),
        };
        let opset = Opset { domain: String::new(), version: OPSET };
        let model = Model {
            ir_version: IR_VERSION,
            producer_name: "covers".to_owned(),
            producer_version: env!("CARGO_PKG_VERSION").to_owned(),
            doc_string: about.to_owned(),
            graph: Some(graph),
            opset_import: vec![opset],
        };
        model.encode_to_vec()
    }
}

fn attribute(attribute: &OnnxAttribute) -> AttributeMessage {
    let (name, int, ints, kind) = match attribute {
        OnnxAttribute::Int(name, value) => (name, Some(*value), Vec::new(), ONE_INT),
        OnnxAttribute::Ints(name, values) => (name, None, values.clone(), INTS),
    };
    AttributeMessage { name: (*name).to_owned(), int, ints, kind }
}

/// Returns the ONNX message of an input or output of the graph, whose first dimension is the batch.
fn value((name, element, sides): &(&str, i64, Vec<usize>)) -> Value {
    let batch = Side { length: None, name: Some("B".to_owned()) };
    let sides = sides.iter().map(|&side| Side { length: Some(side as i64), name: None });
    let shape = Shape { sides: [batch].into_iter().chain(sides).collect() };
    let tensor = TensorKind { element: *element as i32, shape: Some(shape) };
    Value { name: (*name).to_owned(), kind: Some(ValueKind { tensor: Some(tensor) }) }
}
