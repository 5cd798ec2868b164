//! The chunked gradient engine gives the same bits for any number of threads.

use equivariant::{
    FieldType, Group, Layer, LayerSignature, MaxPool, ParallelChunks, Relu, Scalar, Scratch,
    Sequential, Shape, SlidingWindow,
};

use crate::common::{
    boxed, conv, forward, largest_deviation, largest_magnitude, network, normal, params, scratch,
};

const SAMPLES: usize = 150;
const CHUNK: usize = 2;

struct Workspace {
    y: Vec<f32>,
    scratch: Scratch<f32>,
}

fn engine(net: &Sequential<f32>) -> ParallelChunks<f32, Workspace> {
    let (out, scratch) = (CHUNK * net.out_shape().len(), net.allocate_scratch(CHUNK));
    ParallelChunks::new(net.num_params(), CHUNK, move || Workspace {
        y: vec![0.0; out],
        scratch: scratch.clone(),
    })
}

fn pool(threads: usize) -> rayon::ThreadPool {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(threads);
    pool.build().unwrap()
}

/// Returns the gradient and the losses of half the squared output, after `rounds` calls.
fn gradient(threads: usize, rounds: usize) -> (Vec<f32>, Vec<f32>) {
    let net = network::<f32>(Group::D2);
    let params = params(&net, 1);
    let (in_len, out_len) = (net.in_shape().len(), net.out_shape().len());
    let x = normal::<f32>(SAMPLES * in_len, 2);
    let mut chunks = engine(&net);
    let mut run = || {
        let mut gradient = vec![0.0; params.len()];
        let losses =
            chunks.accumulate_gradients(SAMPLES, &mut gradient, |range, workspace, grad| {
                let x = &x[range.start * in_len..range.end * in_len];
                let y = &mut workspace.y[..range.len() * out_len];
                net.forward(&params, x, y, &mut workspace.scratch);
                net.backward(&params, x, y, y, None, grad, &mut workspace.scratch);
                y.iter().map(|y| y * y / 2.0).sum::<f32>()
            });
        (gradient, losses)
    };
    let pool = pool(threads);
    pool.install(|| (1..rounds).for_each(|_| drop(run())));
    pool.install(run)
}

#[test]
fn the_bits_do_not_depend_on_threads_or_on_earlier_calls() {
    let expected = gradient(1, 1);
    assert_eq!(expected.1.len(), SAMPLES / CHUNK);
    for threads in [1, 2, 3] {
        for rounds in [1, 3] {
            assert_eq!(gradient(threads, rounds), expected, "{threads} threads, {rounds} rounds");
        }
    }
}

/// Returns layers with enough work for a second thread: fused, also with a pooling, and alone, with
/// odd numbers of lines and types that do not fill a block.
fn large_layers<T: Scalar>(group: Group) -> [Box<dyn Layer<T>>; 5] {
    let mixed = FieldType::new(group, [5, 4, 3, 2]);
    let [trivial, regular] = [group.trivial_type(6), group.regular_type(16)];
    let fused = Sequential::new(vec![
        conv(trivial, regular, [4, 2, 1], [54, 50]),
        boxed(Relu::new(Shape::image(27, 25, regular))),
        conv(regular, regular, [3, 1, 1], [27, 25]),
    ]);
    let map = Shape::image(26, 28, regular);
    let pooled = Sequential::new(vec![
        conv(trivial, regular, [3, 1, 1], [26, 28]),
        boxed(Relu::new(map)),
        boxed(MaxPool::new(map, SlidingWindow::new(2, 2, 0))),
        conv(regular, regular, [3, 1, 1], [13, 14]),
    ]);
    [
        boxed(fused),
        boxed(pooled),
        conv(trivial, regular, [5, 1, 2], [19, 17]),
        conv(mixed, mixed, [5, 1, 2], [31, 37]),
        conv(regular, mixed, [3, 2, 1], [65, 33]),
    ]
}

/// Returns the output for one image, then the gradients from the values that the pass saved.
fn one_image<T: Scalar>(layer: &dyn Layer<T>, threads: usize) -> [Vec<T>; 3] {
    let params = params(layer, 1);
    let x = normal::<T>(layer.in_shape().len(), 2);
    let mut y = vec![T::ZERO; layer.out_shape().len()];
    let (mut dx, mut dparams) = (vec![T::ZERO; x.len()], vec![T::ZERO; params.len()]);
    let mut scratch = scratch(layer, 1);
    pool(threads).install(|| {
        layer.forward(&params, &x, &mut y, &mut scratch);
        let dx = Some(&mut dx[..]);
        layer.backward(&params, &x, &y, &y, dx, &mut dparams, &mut scratch);
    });
    [y, dx, dparams]
}

#[test]
fn one_image_has_the_same_bits_on_one_thread_and_on_several() {
    for group in Group::ALL {
        for (i, layer) in large_layers::<f32>(group).iter().enumerate() {
            let expected = one_image(layer.as_ref(), 1);
            assert!(expected.iter().flatten().all(|v| v.is_finite()));
            for threads in [2, 3] {
                assert!(one_image(layer.as_ref(), threads) == expected, "layer {i} of {group}");
            }
        }
    }
    let layer = &large_layers::<f64>(Group::D2)[0];
    assert!(one_image(layer.as_ref(), 2) == one_image(layer.as_ref(), 1));
}

#[test]
fn the_sum_over_chunks_is_the_gradient_of_the_batch() {
    let net = network::<f32>(Group::D2);
    let params = params(&net, 1);
    let x = normal::<f32>(SAMPLES * net.in_shape().len(), 2);
    let mut scratch = scratch(&net, SAMPLES);
    let mut y = vec![0.0; SAMPLES * net.out_shape().len()];
    net.forward(&params, &x, &mut y, &mut scratch);
    let mut whole = vec![0.0; params.len()];
    net.backward(&params, &x, &y, &y, None, &mut whole, &mut scratch);
    let (summed, _) = gradient(2, 1);
    let error = largest_deviation(&whole, &summed);
    assert!(error < 1e-5 * largest_magnitude(&whole), "{error}");
}

#[test]
fn accumulate_adds_to_what_is_there() {
    let mut chunks: ParallelChunks<f64, ()> = ParallelChunks::new(2, 3, || ());
    let mut gradient = [10.0, 20.0];
    let sizes = chunks.accumulate_gradients(7, &mut gradient, |range, (), grad| {
        grad[0] += range.len() as f64;
        range.len()
    });
    assert_eq!(sizes, [3, 3, 1]);
    assert_eq!(gradient, [17.0, 20.0]);
    assert!(chunks.accumulate_gradients(0, &mut gradient, |_, (), _| ()).is_empty());
}

#[test]
fn rows_of_inference_arrive_in_order() {
    let net = network::<f32>(Group::D2);
    let params = params(&net, 1);
    let (in_len, out_len) = (net.in_shape().len(), net.out_shape().len());
    let x = normal::<f32>(7 * in_len, 2);
    let mut y = vec![0.0; 7 * out_len];
    let chunks = engine(&net);
    let starts = chunks.map_rows(&mut y, out_len, |range, workspace, y| {
        let x = &x[range.start * in_len..range.end * in_len];
        net.forward(&params, x, y, &mut workspace.scratch);
        range.start
    });
    assert_eq!(starts, [0, 2, 4, 6]);
    for (sample, chunked) in x.chunks(in_len).zip(y.chunks(out_len)) {
        let alone = forward(&net, &params, sample);
        assert!(largest_deviation(&alone, chunked) < 1e-5);
    }
}

#[test]
#[should_panic(expected = "got a chunk size of 0")]
fn empty_chunks_are_refused() {
    ParallelChunks::<f32, ()>::new(1, 0, || ());
}
