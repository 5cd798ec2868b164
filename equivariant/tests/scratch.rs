//! The contents of a scratch do not depend on its address.

use equivariant::{Layer, Relu, Scalar, Scratch, Shape};
use symmetry::Group;

use crate::common::{layers, normal, panic_of, params, scratch, unwritten};

const SAMPLES: usize = 3;

fn gradients<T: Scalar>(layer: &dyn Layer<T>, moved: impl Fn(Scratch<T>) -> Scratch<T>) -> Vec<T> {
    let params = params(layer, 1);
    let x = normal::<T>(SAMPLES * layer.in_shape().len(), 2);
    let dy = normal::<T>(SAMPLES * layer.out_shape().len(), 3);
    let mut y = unwritten(dy.len());
    let mut scratch = scratch(layer, SAMPLES);
    layer.forward(&params, &x, &mut y, &mut scratch);
    let mut scratch = moved(scratch);
    let (mut dx, mut dparams) = (unwritten(x.len()), vec![T::ZERO; params.len()]);
    let dx_too = Some(&mut dx[..]);
    layer.backward(&params, &x, &y, &dy, dx_too, &mut dparams, &mut scratch);
    [dx, dparams].concat()
}

/// Clones many times with blocks of odd sizes in between, so that clones have other offsets.
fn cloned<T: Scalar>(scratch: Scratch<T>) -> Scratch<T> {
    let mut held = Vec::new();
    let mut clone = scratch;
    for i in 0..9 {
        held.push(vec![0u8; 24 + 40 * i]);
        clone = clone.clone();
    }
    clone
}

fn assert_position_does_not_matter<T: Scalar>() {
    for (name, layer) in layers::<T>() {
        let layer = layer.as_ref();
        let stayed = gradients(layer, |scratch| scratch);
        assert!(gradients(layer, cloned) == stayed, "{name}");
        assert!(stayed.iter().all(|v| v.to_f64().is_finite()), "{name}");
    }
}

#[test]
fn clones_made_between_the_passes_give_the_same_gradients() {
    assert_position_does_not_matter::<f32>();
    assert_position_does_not_matter::<f64>();
}

/// Checks that a layer that keeps nothing cannot corrupt values that another layer saved.
#[test]
fn a_scratch_that_another_backward_pass_used_is_noticed() {
    let relu = Relu::new(Shape::vector(Group::D2.trivial_type(1))).unwrap();
    for (name, layer) in layers::<f32>().into_iter().filter(|(_, l)| l.backward_reads_scratch()) {
        let used = |mut scratch| {
            let dx = &mut [0.0];
            relu.backward(&[], &[1.0], &[1.0], &[1.0], Some(dx), &mut [], &mut scratch);
            scratch
        };
        let message = panic_of(|| drop(gradients(layer.as_ref(), used))).unwrap();
        assert!(message.contains("forward left for 0 samples"), "{name}: {message}");
    }
}
