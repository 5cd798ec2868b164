//! Normalised fields: their moments, and the source of the statistics.

use equivariant::{
    FieldNorm, FieldType, Group, Layer, LayerSignature, NormStatistics, Shape, hadamard_transform,
};

use crate::common;

fn waves(len: usize) -> Vec<f64> {
    (0..len).map(|i| 0.5 + (i as f64 * 1.7).sin() + i as f64 * 0.01).collect()
}

fn normalised(layer: &FieldNorm, x: &[f64]) -> Vec<f64> {
    let mut params = vec![f64::NAN; layer.num_params()];
    layer.init_with_gain(&mut common::rng(1), 1.0, &mut params);
    let mut y = vec![f64::NAN; x.len()];
    layer.forward(&params, x, &mut y, &mut layer.allocate_scratch(0));
    y
}

/// Returns mean and variance of field `f` of `fields` in the regular basis.
fn regular_moments(group: Group, fields: usize, f: usize, y: &[f64]) -> [f64; 2] {
    let mut values = Vec::new();
    for pixel in y.chunks(group.order() * fields) {
        let mut pixel = pixel.to_vec();
        hadamard_transform(group, &mut pixel);
        values.extend(pixel.into_iter().skip(f).step_by(fields));
    }
    let mean = values.iter().sum::<f64>() / values.len() as f64;
    let variance = values.iter().map(|v| (v - mean).powi(2)).sum::<f64>();
    [mean, variance / values.len() as f64]
}

#[test]
fn fields_have_mean_zero_and_variance_one_over_group_space_and_samples() {
    for group in Group::ALL {
        let shape = Shape::image(3, 4, group.regular_type(9));
        let x = waves(5 * shape.len());
        let batch = FieldNorm::new(shape, NormStatistics::Batch).unwrap();
        let y = normalised(&batch, &x);
        let sample = FieldNorm::new(shape, NormStatistics::PerSample).unwrap();
        let alone = normalised(&sample, &x);
        for f in 0..9 {
            for values in alone.chunks(shape.len()).chain([&y[..]]) {
                let [mean, variance] = regular_moments(group, 9, f, values);
                assert!(mean.abs() < 1e-12 && (variance - 1.0).abs() < 1e-3, "{group}");
            }
        }
    }
}

#[test]
fn fixed_moments_of_the_batch_do_what_the_batch_does() {
    let shape = Shape::image(2, 3, FieldType::new(Group::D2, [2, 1, 0, 3]));
    let x = waves(4 * shape.len());
    let batch = FieldNorm::new(shape, NormStatistics::Batch).unwrap();
    let moments = batch.means_and_variances(&x);
    assert!(moments[..2].iter().all(|m| m[0] != 0.0));
    assert!(moments[2..].iter().all(|m| m[0] == 0.0), "odd channels are not centred");
    let fixed = FieldNorm::new(shape, NormStatistics::Fixed(moments)).unwrap();
    assert_eq!(normalised(&batch, &x), normalised(&fixed, &x));
}

#[test]
fn statistics_that_do_not_fit_are_refused() {
    let shape = Shape::vector(Group::D2.regular_type(2));
    for wrong in [
        vec![[0.0, 1.0]],
        vec![[0.0, -1.0]; 2],
        vec![[f64::NAN, 1.0]; 2],
        // infinite, and an inverse deviation of zero, in single precision
        vec![[1e39, 1.0]; 2],
        vec![[0.0, 1e100]; 2],
        vec![[0.0, f64::INFINITY]; 2],
    ] {
        let error = FieldNorm::new(shape, NormStatistics::Fixed(wrong)).unwrap_err();
        assert!(error.to_string().starts_with("FieldNorm: got the fixed statistics [["));
    }
    // channels of odd irreps must have a mean of zero
    let odd = Shape::vector(FieldType::new(Group::D2, [1, 1, 0, 1]));
    for (means, fits) in
        [([0.5, 0.0, 0.0], true), ([0.0, 0.5, 0.0], false), ([0.5, 0.0, -0.5], false)]
    {
        let moments = means.map(|mean| [mean, 1.0]).to_vec();
        let norm = FieldNorm::new(odd, NormStatistics::Fixed(moments));
        assert_eq!(norm.is_ok(), fits, "{means:?}");
    }
}

#[test]
#[should_panic(expected = "got x of 0 values, expected a multiple of 4 above 0")]
fn moments_of_no_samples_are_refused() {
    let shape = Shape::vector(Group::D2.regular_type(1));
    let norm = FieldNorm::new(shape, NormStatistics::Batch).unwrap();
    norm.means_and_variances::<f32>(&[]);
}

#[test]
fn a_batch_may_transform_each_sample_by_another_element() {
    for group in Group::ALL {
        let shape = Shape::image(3, 2, group.regular_type(2));
        let norm = FieldNorm::new(shape, NormStatistics::Batch).unwrap();
        let x = waves(8 * shape.len());
        let act = |values: &[f64]| -> Vec<f64> {
            let elements = group.elements().iter().cycle();
            let samples = values.chunks(shape.len()).zip(elements);
            samples.flat_map(|(sample, &g)| shape.transform_sample(g, sample)).collect()
        };
        let of_moved = normalised(&norm, &act(&x));
        for (a, b) in of_moved.iter().zip(act(&normalised(&norm, &x))) {
            assert!((a - b).abs() < 1e-12, "{group}");
        }
    }
}
