//! Runs ONNX models, slowly: the operators that exported policies take, by their definitions
//! (<https://onnx.ai/onnx/operators/>), in f64.

use std::collections::HashMap;

use super::protobuf::Message;

/// Numbers `[shape]`.
#[derive(Clone, Debug, PartialEq)]
pub struct Tensor {
    pub shape: Vec<usize>,
    pub values: Vec<f64>,
}

impl Tensor {
    pub fn new(shape: &[usize], values: impl IntoIterator<Item = f64>) -> Self {
        let values: Vec<f64> = values.into_iter().collect();
        assert_eq!(shape.iter().product::<usize>(), values.len());
        Self { shape: shape.to_vec(), values }
    }

    fn constant(tensor: &Message<'_>) -> Self {
        let shape: Vec<usize> = tensor.ints(1).iter().map(|&side| side as usize).collect();
        let raw = tensor.blobs(9).next().unwrap();
        let values: Vec<f64> = match tensor.int(2) {
            1 => raw.as_chunks().0.iter().map(|b| f32::from_le_bytes(*b).into()).collect(),
            7 => raw.as_chunks().0.iter().map(|b| i64::from_le_bytes(*b) as f64).collect(),
            kind => panic!("element type {kind}"),
        };
        Self::new(&shape, values)
    }

    fn map(&self, f: impl Fn(f64) -> f64) -> Self {
        Self::new(&self.shape, self.values.iter().map(|&value| f(value)))
    }

    /// Combines with one that has a single value.
    fn with(&self, other: &Self, f: impl Fn(f64, f64) -> f64) -> Self {
        let [value] = other.values[..] else { panic!("{:?} is no scalar", other.shape) };
        self.map(|own| f(own, value))
    }

    fn indices(&self) -> impl Iterator<Item = i64> {
        self.values.iter().map(|&value| value as i64)
    }
}

/// Pixels under a window, row-major; none in the padding.
type Pixels = Vec<Option<[usize; 2]>>;

/// A node of a graph.
struct Node<'a>(Message<'a>);

impl Node<'_> {
    fn attribute(&self, name: &str) -> Option<Message<'_>> {
        self.0.messages(5).find(|attribute| attribute.text(1) == name)
    }

    fn int(&self, name: &str) -> Option<i64> {
        self.attribute(name).map(|attribute| attribute.int(3))
    }

    fn ints(&self, name: &str) -> Vec<usize> {
        let ints = self.attribute(name).unwrap().ints(8);
        ints.into_iter().map(|value| value as usize).collect()
    }

    fn run(&self, inputs: &[&Tensor]) -> Tensor {
        let x = inputs[0];
        match self.0.text(4) {
            "Identity" => x.clone(),
            "Cast" => {
                assert_eq!(self.int("to"), Some(1), "f32");
                x.clone()
            }
            "Relu" => x.map(|x| x.max(0.0)),
            "Tanh" => x.map(f64::tanh),
            "Mul" => x.with(inputs[1], |a, b| a * b),
            "Sub" => x.with(inputs[1], |a, b| a - b),
            "Add" => x.with(inputs[1], |a, b| a + b),
            "Shape" => Tensor::new(&[x.shape.len()], x.shape.iter().map(|&side| side as f64)),
            "Expand" => expand(x, inputs[1]),
            "Transpose" => {
                assert_eq!(self.ints("perm"), [0, 3, 1, 2]);
                planes(x)
            }
            "Flatten" => reshape(x, &[x.shape[0] as i64, -1]),
            "Reshape" => reshape(x, &inputs[1].indices().collect::<Vec<_>>()),
            "ReduceMax" => {
                assert_eq!((self.ints("axes"), self.int("keepdims")), (vec![1], Some(0)));
                maxima(x)
            }
            "Concat" => concat(inputs),
            "Slice" => {
                assert_eq!(inputs[3].values, [1.0]);
                columns(x, inputs[1].values[0] as usize..inputs[2].values[0] as usize)
            }
            "Gemm" => {
                assert_eq!(self.int("transB"), Some(1));
                gemm(x, inputs[1], inputs[2])
            }
            "Conv" => self.conv(x, inputs[1], inputs[2]),
            "MaxPool" => self.max_pool(x),
            operator => panic!("operator {operator}"),
        }
    }

    /// Pixels under the window at each place of the output: `[row, column]`s of the input, or
    /// nothing in the padding.
    fn windows(&self, image: &Tensor) -> ([usize; 2], impl Fn(usize, usize) -> Pixels) {
        // one number for all axes and ends
        let same = |name: &str, numbers: usize| {
            let values = self.ints(name);
            assert_eq!(values, vec![values[0]; numbers], "{name}");
            values[0]
        };
        let (size, stride, pad) = (same("kernel_shape", 2), same("strides", 2), same("pads", 4));
        let sides = [image.shape[2], image.shape[3]];
        let out = sides.map(|side| (side + 2 * pad - size) / stride + 1);
        let at = move |row: usize, column: usize| {
            let taps = (0..size).flat_map(|i| (0..size).map(move |j| [i, j]));
            let pixel = move |[i, j]: [usize; 2]| {
                let row = (row * stride + i).checked_sub(pad).filter(|&y| y < sides[0])?;
                let column = (column * stride + j).checked_sub(pad).filter(|&x| x < sides[1])?;
                Some([row, column])
            };
            taps.map(pixel).collect()
        };
        (out, at)
    }

    fn conv(&self, x: &Tensor, weight: &Tensor, bias: &Tensor) -> Tensor {
        let ([height, width], window) = self.windows(x);
        let (inputs, outputs) = (x.shape[1], weight.shape[0]);
        let taps = weight.shape[2] * weight.shape[3];
        let mut values = Vec::new();
        for sample in 0..x.shape[0] {
            for output in 0..outputs {
                for place in 0..height * width {
                    let pixels = window(place / width, place % width);
                    let mut sum = bias.values[output];
                    for input in 0..inputs {
                        for (tap, pixel) in pixels.iter().enumerate() {
                            if let Some([row, column]) = pixel {
                                let plane = (sample * inputs + input) * x.shape[2] + row;
                                sum += x.values[plane * x.shape[3] + column]
                                    * weight.values[(output * inputs + input) * taps + tap];
                            }
                        }
                    }
                    values.push(sum);
                }
            }
        }
        Tensor::new(&[x.shape[0], outputs, height, width], values)
    }

    fn max_pool(&self, x: &Tensor) -> Tensor {
        let ([height, width], window) = self.windows(x);
        let planes = x.shape[0] * x.shape[1];
        let largest = |plane: usize, place: usize| {
            let pixels = window(place / width, place % width).into_iter().flatten();
            let values = pixels
                .map(|[row, column]| x.values[(plane * x.shape[2] + row) * x.shape[3] + column]);
            values.fold(f64::NEG_INFINITY, f64::max)
        };
        let values = (0..planes).flat_map(|plane| {
            let largest = &largest;
            (0..height * width).map(move |place| largest(plane, place))
        });
        Tensor::new(&[x.shape[0], x.shape[1], height, width], values)
    }
}

fn expand(x: &Tensor, shape: &Tensor) -> Tensor {
    let shape: Vec<usize> = shape.indices().map(|side| side as usize).collect();
    assert_eq!(x.shape, [1, shape[1]]);
    Tensor::new(&shape, x.values.repeat(shape[0]))
}

fn planes(x: &Tensor) -> Tensor {
    let [samples, height, width, channels] = x.shape[..] else { panic!("{:?}", x.shape) };
    let pixels = height * width;
    let from = |i: usize| {
        let (sample, channel, pixel) = (i / pixels / channels, i / pixels % channels, i % pixels);
        x.values[(sample * pixels + pixel) * channels + channel]
    };
    Tensor::new(&[samples, channels, height, width], (0..x.values.len()).map(from))
}

fn reshape(x: &Tensor, shape: &[i64]) -> Tensor {
    let known = |(axis, &side): (usize, &i64)| match side {
        0 => Some(x.shape[axis]),
        -1 => None,
        side => Some(side as usize),
    };
    let sides: Vec<Option<usize>> = shape.iter().enumerate().map(known).collect();
    let rest = x.values.len() / sides.iter().flatten().product::<usize>();
    let sides: Vec<usize> = sides.into_iter().map(|side| side.unwrap_or(rest)).collect();
    Tensor::new(&sides, x.values.clone())
}

fn maxima(x: &Tensor) -> Tensor {
    let [samples, elements, fields] = x.shape[..] else { panic!("{:?}", x.shape) };
    let largest = |i: usize| {
        let (sample, field) = (i / fields, i % fields);
        let values = (0..elements).map(|g| x.values[(sample * elements + g) * fields + field]);
        values.fold(f64::NEG_INFINITY, f64::max)
    };
    Tensor::new(&[samples, fields], (0..samples * fields).map(largest))
}

fn concat(parts: &[&Tensor]) -> Tensor {
    let samples = parts[0].shape[0];
    let row = |part: &Tensor, sample: usize| {
        let width = part.shape[1];
        part.values[sample * width..][..width].to_vec()
    };
    let values = (0..samples).flat_map(|sample| parts.iter().flat_map(move |p| row(p, sample)));
    let width = parts.iter().map(|part| part.shape[1]).sum();
    Tensor::new(&[samples, width], values)
}

fn columns(x: &Tensor, range: std::ops::Range<usize>) -> Tensor {
    let rows = x.values.chunks_exact(x.shape[1]);
    let values = rows.flat_map(|row| row[range.clone()].to_vec());
    Tensor::new(&[x.shape[0], range.len()], values)
}

fn gemm(x: &Tensor, weight: &Tensor, bias: &Tensor) -> Tensor {
    let (inputs, outputs) = (weight.shape[1], weight.shape[0]);
    assert_eq!(x.shape[1], inputs);
    let values = x.values.chunks_exact(inputs).flat_map(|row| {
        let rows = weight.values.chunks_exact(inputs).zip(&bias.values);
        rows.map(move |(w, b)| b + w.iter().zip(row).map(|(w, value)| w * value).sum::<f64>())
    });
    Tensor::new(&[x.shape[0], outputs], values)
}

/// Asserts that a tensor is what the model declares: its batch is free, other sides are numbers.
fn assert_declared(value: &Message<'_>, tensor: &Tensor, kind: i64) {
    let name = value.text(1);
    let declared = value.message(2).unwrap().message(1).unwrap();
    assert_eq!(declared.int(1), kind, "{name}");
    let sides: Vec<Message<'_>> = declared.message(2).unwrap().messages(1).collect();
    assert_eq!(sides[0].text(2), "B", "{name}");
    let sides: Vec<i64> = sides[1..].iter().map(|side| side.int(1)).collect();
    let shape: Vec<i64> = tensor.shape[1..].iter().map(|&side| side as i64).collect();
    assert_eq!(sides, shape, "{name}");
}

/// The outputs of a model by name.
pub fn run(model: &[u8], inputs: &[(&str, Tensor)]) -> HashMap<String, Tensor> {
    let model = Message::parse(model);
    let opset = model.message(8).unwrap();
    assert_eq!((opset.text(1), opset.int(2)), ("", 17));
    let graph = model.message(7).unwrap();
    let constants = graph.messages(5);
    let constants = constants.map(|tensor| (tensor.text(8).to_owned(), Tensor::constant(&tensor)));
    let mut known: HashMap<String, Tensor> = constants.collect();
    for input in graph.messages(11) {
        let given = inputs.iter().find(|(name, _)| *name == input.text(1));
        let (name, tensor) = given.unwrap();
        let bytes = *name == "image";
        assert_declared(&input, tensor, if bytes { 2 } else { 1 });
        known.insert((*name).to_owned(), tensor.clone());
    }
    for node in graph.messages(1).map(Node) {
        let values = node.0.blobs(1).map(|name| &known[std::str::from_utf8(name).unwrap()]);
        let output = node.run(&values.collect::<Vec<_>>());
        known.insert(node.0.text(2).to_owned(), output);
    }
    let outputs = graph.messages(12).map(|output| {
        let tensor = &known[output.text(1)];
        assert_declared(&output, tensor, 1);
        (output.text(1).to_owned(), tensor.clone())
    });
    outputs.collect()
}

/// The names and shapes of a model's weights.
pub fn weights(model: &[u8]) -> HashMap<String, Tensor> {
    let graph = Message::parse(model).message(7).unwrap();
    let tensors = graph.messages(5);
    let tensors = tensors.map(|tensor| (tensor.text(8).to_owned(), Tensor::constant(&tensor)));
    tensors.collect()
}
