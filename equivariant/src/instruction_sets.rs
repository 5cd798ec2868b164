//! The narrower instruction sets give what the widest gives.

use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use symmetry::{FieldType, Group};

use crate::conv_backward::Backward;
use crate::conv_forward::{Forward, Output};
use crate::lanes::{InstructionSet, run_f32};
use crate::maps::{Maps, MapsMut};
use crate::{Kernel, Layer, R2Conv};

const SAMPLES: usize = 3;

/// Outputs and gradients of a convolution with a ReLU; without an input gradient first layers take another path.
fn run(conv: &R2Conv, widest: InstructionSet, with_dx: bool) -> Vec<f32> {
    let mut params = vec![0.0; Layer::<f32>::num_params(conv)];
    Layer::init(conv, &mut ChaCha8Rng::seed_from_u64(0), &mut params);
    let wave = |n: usize| (0..n).map(|i| (i as f32 * 0.37).sin()).collect::<Vec<_>>();
    let (x, mut y) = (
        wave(SAMPLES * conv.shape_in().len()),
        vec![0.0; SAMPLES * conv.shape_out().len()],
    );
    let mut masks = vec![0.0; SAMPLES * conv.shape_out().pixels() * conv.weights().width()];
    let mut scratch = vec![f32::NAN; Layer::<f32>::scratch_len(conv, SAMPLES)];
    let forward = Forward {
        conv,
        samples: SAMPLES,
        params: &params,
        x: Maps::Channels(&x),
        to: Output {
            lines: 0..conv.shape_out().height,
            y: MapsMut::Channels(&mut y),
            masks: Some(&mut masks),
        },
        scratch: &mut scratch,
    };
    run_f32(forward, widest);
    let (mut dx, mut dparams) = (vec![0.0; x.len()], vec![0.0; params.len()]);
    let backward = Backward {
        conv,
        samples: SAMPLES,
        params: &params,
        x: Maps::Channels(&x),
        dy: Maps::Channels(&wave(y.len())),
        masks: Some(&masks),
        dx: with_dx.then_some(MapsMut::Channels(&mut dx)),
        dparams: &mut dparams,
        scratch: &mut scratch,
    };
    run_f32(backward, widest);
    [y, dx, dparams].concat()
}

/// Outputs are wide enough for a full tile of every kernel and a rest.
fn convolutions() -> Vec<R2Conv> {
    let mut convolutions = Vec::new();
    for group in Group::ALL {
        let mixed = FieldType::new(group, [2, 1, 3, 0]);
        let types = [
            (group.trivial(6), group.regular(5)),
            (group.regular(3), group.regular(9)),
            (group.regular(16), group.regular(8)),
            (mixed, group.regular(2)),
            (group.regular(2), mixed),
        ];
        for (from, to) in types {
            for (size, stride) in [(4, 2), (3, 1)] {
                let kernel = Kernel {
                    size,
                    stride,
                    padding: 1,
                };
                convolutions.extend(R2Conv::new(from, to, kernel, [18, 22]));
            }
        }
    }
    convolutions
}

#[test]
fn all_instruction_sets_agree() {
    let convolutions = convolutions();
    assert_eq!(convolutions.len(), 50);
    for conv in &convolutions {
        for with_dx in [false, true] {
            let expected = run(conv, InstructionSet::Avx512, with_dx);
            let largest = expected.iter().fold(0.0f32, |m, v| m.max(v.abs()));
            assert!(largest > 0.1, "{conv}");
            for set in [InstructionSet::Avx2, InstructionSet::Portable] {
                for (got, expected) in run(conv, set, with_dx).iter().zip(&expected) {
                    let error = (got - expected).abs();
                    assert!(error < 1e-5 * largest, "{set:?} {conv}: {got} {expected}");
                }
            }
        }
    }
}
