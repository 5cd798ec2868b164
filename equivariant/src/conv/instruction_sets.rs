//! Every instruction set that this machine has gives what the portable code gives.

use rand_chacha::{ChaCha8Rng, rand_core::SeedableRng};
use symmetry::{FieldType, Group};

use crate::conv::geometry::Conv;
use crate::conv::maps::{Maps, MapsMut};
use crate::conv::pass::{Backward, Forward, Output};
use crate::conv::passes::scratch_len;
use crate::shape::Shape;
use crate::simd::lanes::{InstructionSet, Lanes, WithLanes, run_f32};
use crate::window::Kernel;

const SAMPLES: usize = 3;

/// Work that does nothing.
struct Nothing;

impl WithLanes<f32> for Nothing {
    fn run<L: Lanes<f32>>(self, _lanes: L) {}
}

/// The instruction sets of this machine; the portable one is the first.
fn available() -> Vec<InstructionSet> {
    let all = [
        InstructionSet::Portable,
        InstructionSet::Avx2,
        InstructionSet::Avx512,
    ];
    let has = |set: &InstructionSet| run_f32(Nothing, *set) == *set;
    all.into_iter().filter(has).collect()
}

/// Runs a pass on this instruction set and no other.
fn run_on(work: impl WithLanes<f32>, set: InstructionSet) {
    assert_eq!(run_f32(work, set), set, "ran on another instruction set");
}

/// Outputs and gradients of a convolution with a ReLU; without an input gradient first layers take
/// another path.
fn run(conv: &Conv, set: InstructionSet, with_dx: bool) -> Vec<f32> {
    let mut params = vec![0.0; conv.num_params()];
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    conv.blocks.init(&mut rng, 1.4, &mut params);
    let wave = |n: usize| (0..n).map(|i| (i as f32 * 0.37).sin()).collect::<Vec<_>>();
    let (x, mut y) = (
        wave(SAMPLES * conv.image().len()),
        vec![0.0; SAMPLES * conv.out.len()],
    );
    let mut masks = vec![0.0; SAMPLES * conv.out.pixels() * conv.weights.width()];
    let mut scratch = vec![f32::NAN; scratch_len(conv, SAMPLES, false)];
    let forward = Forward {
        conv,
        samples: SAMPLES,
        params: &params,
        x: Maps::Channels(&x),
        to: Output {
            lines: 0..conv.out.height,
            y: MapsMut::Channels(&mut y),
            masks: Some(&mut masks),
        },
        scratch: &mut scratch,
    };
    run_on(forward, set);
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
    run_on(backward, set);
    [y, dx, dparams].concat()
}

/// Outputs are wide enough for a full tile of every kernel and a rest.
fn convolutions() -> Vec<Conv> {
    let mut convolutions = Vec::new();
    for group in Group::ALL {
        let mixed = FieldType::new(group, [2, 1, 3, 0]);
        let types = [
            (group.trivial(6), group.regular(5)),
            (group.trivial(3), group.regular(9)),
            (group.trivial(2), group.regular(4)),
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
                let image = Shape::image(18, 22, from);
                convolutions.push(Conv::new("R2Conv", image, to, kernel).unwrap());
            }
        }
    }
    convolutions
}

/// The largest difference over the largest value; not a number if there is one.
fn deviation(got: &[f32], expected: &[f32]) -> f32 {
    let largest = |values: &mut dyn Iterator<Item = f32>| {
        values.fold(0.0, |m: f32, v| if v > m || v.is_nan() { v } else { m })
    };
    let mut differences = got.iter().zip(expected).map(|(a, b)| (a - b).abs());
    let scale = largest(&mut expected.iter().map(|v| v.abs()));
    assert!(scale > 0.1, "nothing to compare");
    largest(&mut differences) / scale
}

#[test]
fn all_instruction_sets_of_this_machine_agree() {
    let sets = available();
    // none on a machine without AVX2 and FMA, where the portable code is all that ever runs
    println!("compared with {:?}: {:?}", sets[0], &sets[1..]);
    assert_eq!(sets[0], InstructionSet::Portable);
    let convolutions = convolutions();
    assert_eq!(convolutions.len(), 70);
    for conv in &convolutions {
        for with_dx in [false, true] {
            let expected = run(conv, InstructionSet::Portable, with_dx);
            for &set in &sets[1..] {
                let error = deviation(&run(conv, set, with_dx), &expected);
                let shapes = (conv.image(), conv.out);
                assert!(error < 1e-5, "{set:?} {shapes:?}: {error}");
            }
        }
    }
}

#[test]
#[cfg(target_arch = "x86_64")]
fn no_instruction_set_that_the_processor_has_is_left_out() {
    let sets = available();
    let has =
        std::arch::is_x86_feature_detected!("avx2") && std::arch::is_x86_feature_detected!("fma");
    assert_eq!(sets.contains(&InstructionSet::Avx2), has);
    let has = has
        && std::arch::is_x86_feature_detected!("avx512f")
        && std::arch::is_x86_feature_detected!("avx512dq")
        && std::arch::is_x86_feature_detected!("avx512vl");
    assert_eq!(sets.contains(&InstructionSet::Avx512), has);
}

#[test]
fn the_comparison_sees_one_poisoned_value() {
    let right = [1.0, 2.0, 3.0];
    assert_eq!(deviation(&right, &right), 0.0);
    for wrong in [f32::NAN, f32::INFINITY, 2.1] {
        let passes = deviation(&[1.0, wrong, 3.0], &right) < 1e-5;
        assert!(!passes, "{wrong}");
    }
}
