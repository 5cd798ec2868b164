//! Kernels of single precision, on the instruction set of this machine, against those of double
//! precision, which are plain arrays and are checked by the oracle and by finite differences.

use equivariant::{Group, Layer, Scalar};

use crate::common::{self, conv, network, normal, params, relative_deviation};

const SAMPLES: usize = 3;
const TOLERANCE: f64 = 1e-5;

/// Returns outputs, input gradients and parameter gradients, given operands of single precision.
fn run<T: Scalar>(layer: &dyn Layer<T>, operands: [&[f32]; 3]) -> [Vec<f64>; 3] {
    let exact = |values: &[f32]| -> Vec<T> {
        let values = values.iter();
        values.map(|&v| T::from_f64(f64::from(v))).collect()
    };
    let [params, x, dy] = operands.map(exact);
    let results = common::run(layer, &params, &x, &dy);
    results.map(|values| values.into_iter().map(T::to_f64).collect())
}

/// Returns the largest difference over the largest value, for each result.
fn errors(single: &dyn Layer<f32>, double: &dyn Layer<f64>) -> [f64; 3] {
    let params = params(single, 1);
    let x = normal::<f32>(SAMPLES * single.in_shape().len(), 2);
    let dy = normal::<f32>(SAMPLES * single.out_shape().len(), 3);
    let operands = [&params[..], &x, &dy];
    let (single, double) = (run(single, operands), run(double, operands));
    std::array::from_fn(|i| relative_deviation(&single[i], &double[i]))
}

#[test]
fn convolutions_of_every_width_agree_in_both_precisions() {
    for group in Group::ALL {
        // numbers of fields for every way to divide outputs into tiles; images of 6 x 22 for lines
        // of a full tile and a remainder
        for fields in [1, 4, 5, 8, 12, 16, 20, 33] {
            for input in [group.trivial_type(6), group.regular_type(8), group.regular_type(3)] {
                for window in [[4, 2, 1], [3, 1, 1]] {
                    let out = group.regular_type(fields);
                    let single = conv::<f32>(input, out, window, [6, 22]);
                    let double = conv::<f64>(input, out, window, [6, 22]);
                    let errors = errors(single.as_ref(), double.as_ref());
                    assert!(errors.iter().all(|&e| e < TOLERANCE), "{single} {errors:?}");
                }
            }
        }
    }
}

#[test]
fn fused_chains_agree_in_both_precisions() {
    for group in Group::ALL {
        let errors = errors(&network(group), &network(group));
        assert!(errors.iter().all(|&e| e < TOLERANCE), "{group} {errors:?}");
    }
}
