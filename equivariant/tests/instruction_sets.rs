//! Every instruction set of this machine agrees with the portable code.

use equivariant::{
    FieldType, Group, InstructionSet, Layer, LayerSignature, MaxPool, R2Conv, Relu, Sequential,
    SlidingWindow,
};

use crate::common::{params, relative_deviation, scratch, unwritten};

const SAMPLES: usize = 3;

/// Returns outputs and gradients of a convolution with a ReLU, and of one with a pooling if windows
/// fit. Without an input gradient first layers take another path.
fn run(conv: &R2Conv, set: InstructionSet, with_dx: bool) -> Vec<f32> {
    let pooled = run_pooled(conv, set, with_dx, true);
    [run_pooled(conv, set, with_dx, false), pooled].concat()
}

fn run_pooled(conv: &R2Conv, set: InstructionSet, with_dx: bool, pooled: bool) -> Vec<f32> {
    let relu = Relu::new(conv.out_shape());
    let conv = Box::new(conv.clone().limit_instruction_set(set));
    let layer: Box<dyn Layer<f32>> = match relu {
        Ok(relu) => {
            let pool = MaxPool::new(relu.out_shape(), SlidingWindow::new(2, 2, 0));
            let mut layers: Vec<Box<dyn Layer<f32>>> = vec![conv, Box::new(relu)];
            let pool = pool.ok().filter(|_| pooled);
            layers.extend(pool.map(|pool| Box::new(pool) as Box<dyn Layer<f32>>));
            Box::new(Sequential::new(layers).unwrap())
        }
        // types without a basis that the group permutes
        Err(_) => conv,
    };
    let wave = |n: usize| (0..n).map(|i| (i as f32 * 0.37).sin()).collect::<Vec<_>>();
    let (params, x) = (params(layer.as_ref(), 1), wave(SAMPLES * layer.in_shape().len()));
    let mut y = unwritten(SAMPLES * layer.out_shape().len());
    let mut scratch = scratch(layer.as_ref(), SAMPLES);
    layer.forward(&params, &x, &mut y, &mut scratch);
    let dy = wave(y.len());
    let (mut dx, mut dparams) = (vec![0.0; x.len()], vec![0.0; params.len()]);
    let input = with_dx.then_some(&mut dx[..]);
    layer.backward(&params, &x, &y, &dy, input, &mut dparams, &mut scratch);
    [y, dx, dparams].concat()
}

/// Returns convolutions wide enough for a full tile of every kernel and a remainder.
fn convolutions() -> Vec<R2Conv> {
    let mut convolutions = Vec::new();
    for group in Group::ALL {
        let mixed = FieldType::new(group, [2, 1, 3, 0]);
        let types = [
            (group.trivial_type(6), group.regular_type(5)),
            (group.trivial_type(3), group.regular_type(9)),
            (group.trivial_type(2), group.regular_type(4)),
            (group.regular_type(3), group.regular_type(9)),
            (group.regular_type(16), group.regular_type(8)),
            (mixed, group.regular_type(2)),
            (group.regular_type(2), mixed),
        ];
        for (from, to) in types {
            for (size, stride) in [(4, 2), (3, 1)] {
                let kernel = SlidingWindow::new(size, stride, 1);
                convolutions.push(R2Conv::new(from, to, kernel, [18, 22]).unwrap());
            }
        }
    }
    convolutions
}

/// Compares instruction sets. Wider sets round once where the portable code rounds twice; among
/// themselves they add the same numbers in the same order.
#[test]
fn all_instruction_sets_of_this_machine_agree() {
    let wider = &InstructionSet::ALL[1..];
    let wider: Vec<_> = wider.iter().filter(|set| set.is_available()).collect();
    // none on a machine without AVX2 and FMA, where only the portable code runs
    println!("compared with {:?}: {wider:?}", InstructionSet::ALL[0]);
    let convolutions = convolutions();
    assert_eq!(convolutions.len(), 70);
    let mut differ = wider.is_empty();
    for conv in &convolutions {
        for with_dx in [false, true] {
            let expected = run(conv, InstructionSet::Portable, with_dx);
            let found: Vec<_> = wider.iter().map(|&&set| run(conv, set, with_dx)).collect();
            let shapes = (conv.in_shape(), conv.out_shape());
            for (set, output) in wider.iter().zip(&found) {
                let error = relative_deviation(output, &expected);
                assert!(error < 1e-5, "{set:?} {shapes:?}: {error}");
                differ |= *output != expected;
            }
            for (sets, outputs) in wider.windows(2).zip(found.windows(2)) {
                let bits = |values: &[f32]| values.iter().map(|v| v.to_bits()).collect::<Vec<_>>();
                assert!(bits(&outputs[0]) == bits(&outputs[1]), "{sets:?} {shapes:?}");
            }
        }
    }
    assert!(differ, "{wider:?}: none ran");
}

#[test]
#[cfg(target_arch = "x86_64")]
fn no_instruction_set_that_the_cpu_has_is_left_out() {
    use std::arch::is_x86_feature_detected as has;
    assert!(InstructionSet::Portable.is_available());
    let avx2 = has!("avx2") && has!("fma");
    assert_eq!(InstructionSet::Avx2.is_available(), avx2);
    let avx512 = avx2 && has!("avx512f") && has!("avx512dq") && has!("avx512vl");
    assert_eq!(InstructionSet::Avx512.is_available(), avx512);
}
