//! Sums of the outputs of units.

use equivariant::{FieldType, Group, LayerKind, LayerSignature, absolute_activation_sums};

use crate::common::{forward, largest_deviation, network, normal, params};

/// Compares with the layers run one by one, with the regular basis written out.
#[test]
fn sums_are_those_of_the_layers_run_by_hand() {
    for group in Group::ALL {
        let chain = network::<f64>(group);
        let params = params(&chain, 3);
        let mut x = normal(2 * chain.in_shape().len(), 4);
        let mut found = absolute_activation_sums(&chain, &params, &x).into_iter();
        for (i, layer) in chain.layers().iter().enumerate() {
            if matches!(layer.kind(), LayerKind::Relu) {
                let expected = rectify(group, layer.in_shape().fields, &x);
                assert!(largest_deviation(&found.next().unwrap(), &expected) < 1e-12, "{group}");
            }
            x = forward(layer.as_ref(), &params[chain.param_range(i)], &x);
        }
        assert_eq!(found.next(), None);
    }
}

/// Returns the sums over rows of max(0, regular value), by the characters of the group.
fn rectify(group: Group, fields: FieldType, rows: &[f64]) -> Vec<f64> {
    let (order, dim) = (group.order(), fields.dim());
    let n = dim / order;
    let mut sums = vec![0.0; dim];
    for row in rows.chunks_exact(dim) {
        for (g, &element) in group.elements().iter().enumerate() {
            for f in 0..n {
                let terms = group.irreps().iter().enumerate();
                let value: f64 =
                    terms.map(|(a, irrep)| f64::from(irrep.sign(element)) * row[a * n + f]).sum();
                sums[g * n + f] += (value / (order as f64).sqrt()).max(0.0);
            }
        }
    }
    sums
}
