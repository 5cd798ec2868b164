//! Runs ONNX models, slowly: the operators that exported policies take, by their definitions
//! (<https://onnx.ai/onnx/operators/>), in f64.

use std::collections::HashMap;

use ndarray::{Array4, ArrayD, ArrayView4, Axis, Ix2, Slice, concatenate};

use super::protobuf::Message;

/// Numbers `[shape]`.
pub type Tensor = ArrayD<f64>;

pub fn tensor(shape: &[usize], values: Vec<f64>) -> Tensor {
    Tensor::from_shape_vec(shape, values).unwrap()
}

/// A constant of a model.
fn constant(message: &Message<'_>) -> Tensor {
    let shape: Vec<usize> = message.ints(1).iter().map(|&side| side as usize).collect();
    let raw = message.blobs(9).next().unwrap();
    let values = match message.int(2) {
        1 => raw.as_chunks().0.iter().map(|b| f32::from_le_bytes(*b).into()).collect(),
        7 => raw.as_chunks().0.iter().map(|b| i64::from_le_bytes(*b) as f64).collect(),
        kind => panic!("element type {kind}"),
    };
    tensor(&shape, values)
}

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
            "Relu" => x.mapv(|x| x.max(0.0)),
            "Tanh" => x.mapv(f64::tanh),
            "Mul" => x * inputs[1],
            "Sub" => x - inputs[1],
            "Add" => x + inputs[1],
            "Shape" => tensor(&[x.ndim()], x.shape().iter().map(|&side| side as f64).collect()),
            "Expand" => {
                let shape: Vec<usize> = inputs[1].iter().map(|&side| side as usize).collect();
                x.broadcast(shape).unwrap().to_owned()
            }
            "Transpose" => x.clone().permuted_axes(self.ints("perm")),
            "Flatten" => {
                assert_eq!(self.int("axis"), Some(1));
                reshape(x, [0, -1])
            }
            "Reshape" => reshape(x, inputs[1].iter().map(|&side| side as i64)),
            "ReduceMax" => {
                assert_eq!((self.ints("axes"), self.int("keepdims")), (vec![1], Some(0)));
                x.fold_axis(Axis(1), f64::NEG_INFINITY, |most, value| most.max(*value))
            }
            "Concat" => {
                assert_eq!(self.int("axis"), Some(1));
                let parts: Vec<_> = inputs.iter().map(|part| part.view()).collect();
                concatenate(Axis(1), &parts).unwrap()
            }
            "Slice" => {
                let [from, to, axis] = [1, 2, 3].map(|input| inputs[input][0] as usize);
                x.slice_axis(Axis(axis), Slice::from(from..to)).to_owned()
            }
            "Gemm" => {
                assert_eq!(self.int("transB"), Some(1));
                let [rows, weight] =
                    [x, inputs[1]].map(|of| of.view().into_dimensionality::<Ix2>());
                rows.unwrap().dot(&weight.unwrap().t()).into_dyn() + inputs[2]
            }
            "Conv" => {
                let (weights, biases) = (inputs[1].outer_iter(), inputs[2]);
                let product = |window: ArrayView4<'_, f64>| -> Vec<f64> {
                    let outputs = weights.clone().zip(biases);
                    outputs.map(|(weight, bias)| bias + (&weight * &window).sum()).collect()
                };
                let outputs = self.over_windows(x, x.shape()[1], 0.0, product);
                outputs.index_axis_move(Axis(1), 0).permuted_axes(vec![0, 3, 1, 2])
            }
            "MaxPool" => {
                let most = |window: ArrayView4<'_, f64>| [window.fold(f64::MIN, |a, b| a.max(*b))];
                self.over_windows(x, 1, f64::MIN, most).index_axis_move(Axis(4), 0)
            }
            operator => panic!("operator {operator}"),
        }
    }

    /// The values of each window over so many planes of images `[B, C, H, W]` with `outside` around
    /// them: `[B, C / planes, rows, columns, values]`.
    fn over_windows<V: IntoIterator<Item = f64>>(
        &self,
        images: &Tensor,
        planes: usize,
        outside: f64,
        values: impl Fn(ArrayView4<'_, f64>) -> V,
    ) -> Tensor {
        // one number for all axes and ends
        let same = |name: &str, numbers: usize| {
            let attribute = self.ints(name);
            assert_eq!(attribute, vec![attribute[0]; numbers], "{name}");
            attribute[0]
        };
        let (size, stride, pad) = (same("kernel_shape", 2), same("strides", 2), same("pads", 4));
        let [samples, channels, height, width] = images.shape()[..] else { panic!() };
        let [high, wide] = [height, width].map(|side| side + 2 * pad);
        let mut framed = Array4::from_elem([samples, channels, high, wide], outside);
        let mut inside = framed.slice_each_axis_mut(|side| match side.axis.index() {
            0 | 1 => Slice::from(..),
            _ => Slice::from(pad..side.len - pad),
        });
        inside.assign(images);
        let step = [1, planes, stride, stride];
        let windows = framed.windows_with_stride([1, planes, size, size], step);
        let values: Vec<f64> = windows.into_iter().flat_map(values).collect();
        let [rows, columns] = [high, wide].map(|side| (side - size) / stride + 1);
        let count = samples * (channels / planes) * rows * columns;
        tensor(&[samples, channels / planes, rows, columns, values.len() / count], values)
    }
}

/// Gives a tensor another shape, in which 0 stands for the side it has and -1 for what is left.
fn reshape(x: &Tensor, shape: impl IntoIterator<Item = i64>) -> Tensor {
    let known = |(axis, side): (usize, i64)| match side {
        0 => Some(x.shape()[axis]),
        -1 => None,
        side => Some(side as usize),
    };
    let sides: Vec<Option<usize>> = shape.into_iter().enumerate().map(known).collect();
    let rest = x.len() / sides.iter().flatten().product::<usize>();
    let sides: Vec<usize> = sides.into_iter().map(|side| side.unwrap_or(rest)).collect();
    x.to_shape(sides).unwrap().into_owned()
}

/// Asserts that a tensor is what the model declares: its batch is free, other sides are numbers.
fn assert_declared(value: &Message<'_>, tensor: &Tensor, kind: i64) {
    let name = value.text(1);
    let declared = value.message(2).unwrap().message(1).unwrap();
    assert_eq!(declared.int(1), kind, "{name}");
    let sides: Vec<Message<'_>> = declared.message(2).unwrap().messages(1).collect();
    assert_eq!(sides[0].text(2), "B", "{name}");
    let sides: Vec<i64> = sides[1..].iter().map(|side| side.int(1)).collect();
    let shape: Vec<i64> = tensor.shape()[1..].iter().map(|&side| side as i64).collect();
    assert_eq!(sides, shape, "{name}");
}

/// The outputs of a model by name.
pub fn run(model: &[u8], inputs: &[(&str, Tensor)]) -> HashMap<String, Tensor> {
    let opset = Message::parse(model).message(8).unwrap();
    assert_eq!((opset.text(1), opset.int(2)), ("", 17));
    let graph = Message::parse(model).message(7).unwrap();
    let mut known = weights(model);
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

/// The weights of a model by name.
pub fn weights(model: &[u8]) -> HashMap<String, Tensor> {
    let graph = Message::parse(model).message(7).unwrap();
    let tensors = graph.messages(5);
    tensors.map(|tensor| (tensor.text(8).to_owned(), constant(&tensor))).collect()
}
