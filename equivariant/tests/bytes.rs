//! Networks on byte images give the same bits as on the levels of the bytes.

use equivariant::{
    BranchSum, InstructionSet, Layer, LayerSignature, Linear, MaxPool, R2Conv, Relu, Scalar,
    Sequential, Shape, SlidingWindow, pixel_byte_to_float,
};
use symmetry::Group;

use crate::common::{normal, panic_of, params, scratch, unwritten};

const SAMPLES: usize = 3;
const SAME: SlidingWindow = SlidingWindow::new(3, 1, 1);

/// Returns convolutions whose rows have a remainder after whole registers, for every kind of window
/// that first layers treat differently.
fn convolutions() -> Vec<R2Conv> {
    let mut convolutions = Vec::new();
    for group in Group::ALL {
        for channels in [1, 3, 4, 6] {
            for [size, stride, padding] in [[4, 2, 1], [3, 1, 1], [5, 1, 0]] {
                let kernel = SlidingWindow::new(size, stride, padding);
                let (from, to) = (group.trivial_type(channels), group.regular_type(5));
                convolutions.push(R2Conv::new(from, to, kernel, [20, 24]).unwrap());
            }
        }
    }
    convolutions
}

/// Returns networks around a convolution: alone, with a ReLU, with a pooling, and inside longer
/// chains.
fn networks<T: Scalar>(conv: &R2Conv) -> Vec<Sequential<T>> {
    let out = conv.out_shape();
    let halved = SlidingWindow::new(2, 2, 0);
    let layers = || -> Vec<Box<dyn Layer<T>>> {
        vec![
            Box::new(conv.clone()),
            Box::new(Relu::new(out).unwrap()),
            Box::new(MaxPool::new(out, halved).unwrap()),
        ]
    };
    let first = |len| -> Vec<_> { layers().into_iter().take(len).collect() };
    let next = || R2Conv::new(out.fields, out.fields, SAME, [out.height, out.width]).unwrap();
    let mut deep = first(2);
    deep.push(Box::new(next()));
    deep.push(Box::new(BranchSum::residual(Box::new(Relu::new(out).unwrap())).unwrap()));
    deep.push(Box::new(next()));
    let networks = [first(1), first(2), first(3), deep].into_iter();
    networks.map(|stack| Sequential::new(stack).unwrap()).collect()
}

fn pictures(layer: &impl LayerSignature, samples: usize) -> Vec<u8> {
    let bytes = (0..samples * layer.in_shape().len()).map(|i| (i * 37 + i / 251) as u8);
    bytes.collect()
}

/// Returns the output and the gradient of the parameters.
fn of_bytes<T: Scalar>(network: &Sequential<T>, pictures: &[u8]) -> [Vec<T>; 2] {
    let samples = pictures.len() / network.in_shape().len();
    let (params, mut scratch) = (params(network, 1), scratch(network, samples));
    let mut y = unwritten(samples * network.out_shape().len());
    network.forward_from_bytes(&params, pictures, &mut y, &mut scratch);
    let dy = normal::<T>(y.len(), 3);
    let mut dparams = vec![T::ZERO; params.len()];
    network.backward_from_bytes(&params, pictures, [&y, &dy], &mut dparams, &mut scratch);
    [y, dparams]
}

fn of_levels<T: Scalar>(network: &Sequential<T>, pictures: &[u8]) -> [Vec<T>; 2] {
    let samples = pictures.len() / network.in_shape().len();
    let (params, mut scratch) = (params(network, 1), scratch(network, samples));
    let x: Vec<T> = pictures.iter().map(|&byte| pixel_byte_to_float(byte)).collect();
    let mut y = unwritten(samples * network.out_shape().len());
    network.forward(&params, &x, &mut y, &mut scratch);
    let dy = normal::<T>(y.len(), 3);
    let mut dparams = vec![T::ZERO; params.len()];
    network.backward(&params, &x, &y, &dy, None, &mut dparams, &mut scratch);
    [y, dparams]
}

/// Converts numbers to their bits in double precision, which distinguish all values of either
/// precision.
fn bits<T: Scalar>(values: &[Vec<T>; 2]) -> Vec<u64> {
    let values = values.iter().flatten();
    values.map(|v| v.to_f64().to_bits()).collect()
}

fn assert_same<T: Scalar>(conv: &R2Conv) {
    for network in networks::<T>(conv) {
        let pictures = pictures(&network, SAMPLES);
        let found = of_bytes(&network, &pictures);
        let levels = of_levels(&network, &pictures);
        assert!(bits(&found) == bits(&levels), "{network}");
        let largest = |values: &[T]| values.iter().fold(0.0, |m: f64, v| m.max(v.to_f64().abs()));
        assert!(found.iter().all(|values| largest(values) > 0.1), "{network}");
        let mut others = pictures;
        let middle = others.len() / 2;
        others[middle] ^= 128;
        assert!(found != of_bytes(&network, &others), "{network}: blind");
    }
}

#[test]
fn bytes_give_the_bits_of_their_levels() {
    for conv in convolutions() {
        assert_same::<f64>(&conv);
        let sets = InstructionSet::ALL.into_iter();
        for set in sets.filter(|set| set.is_available()) {
            assert_same::<f32>(&conv.clone().limit_instruction_set(set));
        }
    }
}

/// Checks an image so large that it is computed in two halves if a thread is free.
#[test]
fn two_threads_give_the_bits_of_one() {
    let halving = SlidingWindow::new(4, 2, 1);
    let (from, to) = (Group::D2.trivial_type(6), Group::D2.regular_type(8));
    let conv = R2Conv::new(from, to, halving, [64, 64]).unwrap();
    let pool = rayon::ThreadPoolBuilder::new().num_threads(2).build();
    for network in networks::<f32>(&conv) {
        let picture = pictures(&network, 1);
        let found = pool.as_ref().unwrap().install(|| of_bytes(&network, &picture));
        assert!(bits(&found) == bits(&of_levels(&network, &picture)), "{network}");
    }
}

#[test]
fn levels_are_centred_and_reach_half() {
    assert_eq!((pixel_byte_to_float::<f64>(0), pixel_byte_to_float::<f64>(255)), (-0.5, 0.5));
    assert_eq!((pixel_byte_to_float::<f32>(0), pixel_byte_to_float::<f32>(255)), (-0.5, 0.5));
    assert!((0..255).all(|byte| pixel_byte_to_float::<f32>(byte) < pixel_byte_to_float(byte + 1)));
}

#[test]
fn bytes_that_no_convolution_reads_are_refused() {
    let (shape, to) = (Shape::vector(Group::D2.trivial_type(4)), Group::D2.regular_type(2));
    let layers: Vec<Box<dyn Layer<f32>>> = vec![Box::new(Linear::new(shape.fields, to).unwrap())];
    let linear = Sequential::new(layers).unwrap();
    let regular = R2Conv::new(to, to, SlidingWindow::new(3, 1, 1), [4, 4]).unwrap();
    let regular = networks::<f32>(&regular).remove(1);
    for network in [linear, regular] {
        let bytes = pictures(&network, 1);
        let mut y = vec![0.0; network.out_shape().len()];
        let (params, mut scratch) = (params(&network, 1), scratch(&network, 1));
        let forward =
            panic_of(|| network.forward_from_bytes(&params, &bytes, &mut y, &mut scratch)).unwrap();
        assert!(forward.contains("got bytes"), "{forward}");
        let [y, dy] = [y.clone(), y];
        let mut dparams = params.clone();
        let backward = panic_of(|| {
            network.backward_from_bytes(&params, &bytes, [&y, &dy], &mut dparams, &mut scratch);
        });
        let backward = backward.unwrap();
        assert!(backward.contains("got bytes"), "{backward}");
    }
}

#[test]
fn wrong_lengths_are_refused() {
    let conv = &convolutions()[0];
    let network = networks::<f32>(conv).remove(1);
    let bytes = pictures(&network, 2);
    let (params, mut scratch) = (params(&network, 1), scratch(&network, 2));
    let mut y = vec![0.0; 2 * network.out_shape().len()];
    let short = &bytes[1..];
    let message = panic_of(|| network.forward_from_bytes(&params, short, &mut y, &mut scratch));
    let message = message.unwrap();
    assert!(message.contains("got pictures of"), "{message}");
    let one = &bytes[bytes.len() / 2..];
    let of_output = panic_of(|| network.forward_from_bytes(&params, one, &mut y, &mut scratch));
    let output_message = of_output.unwrap();
    assert!(output_message.contains("got y of"), "{output_message}");
    network.forward_from_bytes(&params, &bytes, &mut y, &mut scratch);
    let half = y.len() / 2;
    let mut dparams = params.clone();
    let of_backward = panic_of(|| {
        let outputs = [&y[..half], &y[..half]];
        network.backward_from_bytes(&params, one, outputs, &mut dparams, &mut scratch);
    });
    let backward_message = of_backward.unwrap();
    assert!(backward_message.contains("left for 2 samples"), "{backward_message}");
}
