//! The recurrent unit: PyTorch's numbers (`benches/peers/golden_gru.py`), finite differences,
//! symmetry and sequences of different lengths.

use equivariant::{FieldType, Group, Gru, Scalar, Shape, equivariance_error_of_fn};

use crate::common::{self, largest_deviation, normal, panic_of, rng};

const GOLDEN: &[u8] = include_bytes!("golden/gru.safetensors");
const STEPS: usize = 5;
const LENGTHS: [usize; 4] = [5, 2, 4, 1];

fn golden(name: &str) -> Vec<f64> {
    common::golden(GOLDEN, name)
}

/// Creates a unit on a type with all irreps of the group, some more often than others.
fn unit(group: Group) -> Gru {
    let mut irreps = group.irreps().to_vec();
    irreps.extend([group.irreps()[0]; 2]);
    Gru::new(FieldType::from_irreps(group, &irreps), 3).unwrap()
}

fn drawn<T: Scalar>(gru: &Gru) -> Vec<T> {
    let mut params = vec![T::ZERO; gru.num_params()];
    gru.init(&mut rng(3), &mut params);
    // draws the biases, too
    let shift = normal::<T>(params.len(), 4);
    let tenth = T::from_f64(0.1);
    params.iter_mut().zip(shift).for_each(|(p, s)| *p += tenth * s);
    params
}

/// Returns last states, gradient of the input and gradient of the parameters of `d_out . out`.
fn run(gru: &Gru, params: &[f64], x: &[f64], d_out: &[f64]) -> [Vec<f64>; 3] {
    // a larger workspace than needed, with values of an earlier run
    let mut workspace = gru.new_workspace(STEPS + 1, LENGTHS.len() + 2);
    let other = normal(2 * 6 * gru.in_type().dim(), 9);
    gru.forward(params, &other, &[2; 6], &mut workspace);
    gru.forward(params, x, &LENGTHS, &mut workspace);
    let out = workspace.last_states().to_vec();
    // starts at one, not zero, since gradients must be added
    let (mut dx, mut dparams) = (vec![f64::NAN; x.len()], vec![1.0; params.len()]);
    gru.backward(params, x, d_out, Some(&mut dx), &mut dparams, &mut workspace);
    dparams.iter_mut().for_each(|d| *d -= 1.0);
    [out, dx, dparams]
}

#[test]
fn the_unit_of_c1_is_that_of_pytorch() {
    let gru = Gru::new(Group::C1.trivial_type(7), 6).unwrap();
    let [out, dx, dparams] = run(&gru, &golden("params"), &golden("x"), &golden("dy"));
    for (name, got) in [("y", out), ("dx", dx), ("dparams", dparams)] {
        let error = largest_deviation(&got, &golden(name));
        assert!(error < 1e-12, "{name}: {error}");
    }
}

#[test]
fn backward_is_the_derivative_of_forward_for_every_group() {
    for group in Group::ALL {
        let gru = unit(group);
        let width = gru.out_type().dim();
        let d_out: Vec<f64> = normal(LENGTHS.len() * width, 5);
        let at = [drawn(&gru), normal(STEPS * LENGTHS.len() * gru.in_type().dim(), 6)];
        let value = |params: &[f64], x: &[f64]| {
            let [out, ..] = run(&gru, params, x, &d_out);
            out.iter().zip(&d_out).map(|(a, b)| a * b).sum::<f64>()
        };
        let [_, dx, dparams] = run(&gru, &at[0], &at[1], &d_out);
        for (which, gradient) in [dparams, dx].into_iter().enumerate() {
            assert!(gradient.iter().any(|&d| d != 0.0));
            for i in (0..gradient.len()).step_by(3) {
                let [low, high] = [-1e-5, 1e-5].map(|h| {
                    let mut moved = at.clone();
                    moved[which][i] += h;
                    value(&moved[0], &moved[1])
                });
                let slope = (high - low) / 2e-5;
                let error = (slope - gradient[i]).abs();
                assert!(error < 1e-8, "{group}, {which}, {i}: {slope} {}", gradient[i]);
            }
        }
    }
}

/// Checks sequences of three steps, each a multiple of one vector.
#[test]
fn the_unit_commutes_with_every_group() {
    for group in Group::ALL {
        let gru = unit(group);
        let params = drawn::<f32>(&gru);
        let mut workspace = gru.new_workspace(3, 1);
        let steps = Shape::image(1, 1, gru.in_type());
        let error = equivariance_error_of_fn(
            steps,
            Shape::vector(gru.out_type()),
            |x, y| {
                let scaled = [1.0, -0.5, 2.0].map(|by| x.iter().map(move |v| v * by));
                let sequence: Vec<f32> = scaled.into_iter().flatten().collect();
                gru.forward(&params, &sequence, &[3], &mut workspace);
                y.copy_from_slice(workspace.last_states());
            },
            8,
            &mut rng(7),
        );
        assert!(error < 1e-5, "{group}: {error}");
    }
}

/// Checks that rows before a sequence are ignored and that an empty sequence leaves zeros.
#[test]
fn only_the_steps_of_a_sequence_count() {
    let gru = unit(Group::D2);
    let (width, inputs) = (gru.out_type().dim(), gru.in_type().dim());
    let params = drawn::<f64>(&gru);
    let mut workspace = gru.new_workspace(STEPS, LENGTHS.len());
    let mut last = |x: &[f64], lengths: [usize; 4]| {
        gru.forward(&params, x, &lengths, &mut workspace);
        workspace.last_states().to_vec()
    };
    let x: Vec<f64> = normal(STEPS * LENGTHS.len() * inputs, 6);
    let mut other = x.clone();
    for step in 0..STEPS {
        for (i, length) in LENGTHS.into_iter().enumerate() {
            if step < STEPS - length {
                other[(step * LENGTHS.len() + i) * inputs..][..inputs].fill(7.0);
            }
        }
    }
    assert_eq!(last(&x, LENGTHS), last(&other, LENGTHS));
    assert_ne!(last(&x, [5; 4]), last(&other, [5; 4]));
    assert!(last(&x, [0, 1, 1, 1])[..width].iter().all(|&h| h == 0.0));
}

/// Checks that sequences give the same results with shared rows as with rows of their own, and that
/// the gradient of a row is the sum over all steps that read it.
#[test]
fn shared_rows_are_rows_of_their_own_added_up() {
    let rows = 7;
    for group in Group::ALL {
        let gru = unit(group);
        let (params, inputs) = (drawn::<f64>(&gru), gru.in_type().dim());
        let shared: Vec<f64> = normal(rows * inputs, 6);
        let read = |at: usize| (at * 5 + at / 3) % rows;
        let count = STEPS * LENGTHS.len();
        let reads: Vec<usize> = (0..count).map(read).collect();
        let row = |at: &usize| &shared[at * inputs..(at + 1) * inputs];
        let own: Vec<f64> = reads.iter().flat_map(row).copied().collect();
        let d_out = normal(LENGTHS.len() * gru.out_type().dim(), 5);
        let [out, dx, dparams] = run(&gru, &params, &own, &d_out);
        let mut workspace = gru.new_workspace(STEPS, LENGTHS.len());
        gru.forward_shared_inputs(&params, &shared, &reads, &LENGTHS, &mut workspace);
        assert!(largest_deviation(workspace.last_states(), &out) < 1e-14);
        let (mut dshared, mut dshared_params) =
            (vec![f64::NAN; shared.len()], vec![0.0; params.len()]);
        let to = Some(&mut dshared[..]);
        gru.backward(&params, &shared, &d_out, to, &mut dshared_params, &mut workspace);
        let mut sums = vec![0.0; shared.len()];
        for (&index, gradient) in reads.iter().zip(dx.chunks_exact(inputs)) {
            let sum = &mut sums[index * inputs..(index + 1) * inputs];
            sum.iter_mut().zip(gradient).for_each(|(sum, d)| *sum += d);
        }
        assert!(largest_deviation(&dshared, &sums) < 1e-13, "{group}");
        assert!(largest_deviation(&dshared_params, &dparams) < 1e-12, "{group}");
    }
}

#[test]
fn wrong_calls_are_refused() {
    let gru = unit(Group::C1);
    let (params, inputs) = (drawn::<f32>(&gru), gru.in_type().dim());
    let (x, d_out) = (vec![0.5; 2 * inputs], vec![0.0; gru.out_type().dim()]);
    let own = || gru.new_workspace(4, 1);
    // rows before the sequence are ignored
    gru.forward_shared_inputs(&params, &x, &[9, 1], &[1], &mut own());
    let backward = |from: &Gru, dparams: &mut [f32], times| {
        let mut workspace = from.new_workspace(2, 1);
        gru.forward(&params, &x, &[1], &mut workspace);
        for _ in 0..times {
            gru.backward(&params, &x, &d_out, None, dparams, &mut workspace);
        }
    };
    let mut dparams = vec![0.0; params.len()];
    backward(&gru, &mut dparams, 1);
    let other = Gru::new(gru.in_type(), 1).unwrap();
    let refused = [
        (
            "got row 2 to read, expected one of 2",
            panic_of(|| gru.forward_shared_inputs(&params, &x, &[1, 2], &[1], &mut own())),
        ),
        (
            "got 1 sequences of 3 steps in 2, expected at most 1 of 4",
            panic_of(|| gru.forward(&params, &x, &[3], &mut own())),
        ),
        (
            "got a workspace that holds no values",
            panic_of(|| backward(&gru, &mut dparams.clone(), 2)),
        ),
        ("got a workspace of a unit with", panic_of(|| backward(&other, &mut dparams.clone(), 1))),
        ("got dparams of 1 values", panic_of(|| backward(&gru, &mut [0.0], 1))),
    ];
    for (expected, message) in refused {
        let message = message.unwrap();
        assert!(message.contains(expected), "{message}");
    }
}
