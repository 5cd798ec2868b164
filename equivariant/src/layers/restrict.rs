//! Restriction to a subgroup inside a chain.

use std::fmt;
use std::ops::Range;

use symmetry::{D2, FieldType, Group, Irrep};

use crate::error::LayerError;
use crate::layers::check::TestLayer;
use crate::layers::layer::{LayerSignature, Parameterless, Scalar};
use crate::shape::Shape;

/// Layer that turns feature maps of a group into feature maps of a subgroup, like escnn's
/// `RestrictionModule`.
///
/// Later layers need to commute with the subgroup only. A regular field becomes |G| / |H| regular
/// fields of the subgroup H, one for each of its cosets, with the same values in the regular basis:
/// a ReLU gives the same result before or after. Channels of other types keep their values and are
/// sorted by the irreps of the subgroup.
#[derive(Clone, Debug)]
pub struct Restrict {
    shape: Shape,
    group: Group,
    terms: Vec<RestrictionTerm>,
}

/// Summand of the restriction matrix: channels `from` of the input, times `scale`, are added to the
/// output from channel `to` on.
#[derive(Clone, Debug)]
struct RestrictionTerm {
    to: usize,
    from: Range<usize>,
    scale: f64,
}

impl Restrict {
    /// Creates the restriction of maps of this shape to the subgroup `group`.
    ///
    /// # Errors
    /// When the map is empty or the group is not a subgroup of that of its type.
    pub fn new(shape: Shape, group: Group) -> Result<Restrict, LayerError> {
        LayerError::check_feature_map_size("Restrict", shape, 0)?;
        if !group.is_subgroup_of(shape.fields.group()) {
            return Err(LayerError::InvalidSetting {
                layer: "Restrict",
                setting: "group",
                got: group.to_string(),
                expected: "a subgroup of that of the input",
            });
        }
        let terms = match shape.fields.num_regular_fields() {
            Some(fields) => of_regular_fields(shape.fields, fields, group),
            None => sorted(shape.fields, group),
        };
        Ok(Restrict { shape, group, terms })
    }
}

/// Iterates over the irreps of a field type that become irrep `b` of a subgroup, with their
/// channels.
fn sources_of(
    fields: FieldType,
    group: Group,
    b: Irrep,
) -> impl Iterator<Item = (Irrep, Range<usize>)> {
    let irreps = fields.group().irreps().iter().filter(move |&&a| group.restrict_d2_irrep(a) == b);
    irreps.map(move |&a| (a, fields.channel_range(a)))
}

/// Returns the summands of the restriction matrix that keeps values and sorts channels by the
/// irreps of the subgroup.
fn sorted(fields: FieldType, group: Group) -> Vec<RestrictionTerm> {
    let sources = group.irreps().iter().flat_map(|&b| sources_of(fields, group, b));
    let mut to = 0;
    let term = |(_, from): (Irrep, Range<usize>)| {
        let start = to;
        to += from.len();
        RestrictionTerm { to: start, from, scale: 1.0 }
    };
    sources.map(term).collect()
}

/// Returns the summands of the restriction matrix that preserves the values of regular fields in
/// the regular basis.
///
/// The field of coset H t has the value v(h t) at element h, where v(g) = |G|^-1/2 sum_a a(g) c_a
/// are the values of the field of G. Its coefficient of irrep b is hence (|H| / |G|)^1/2 sum_a a(t)
/// c_a over the irreps a of G that become b.
fn of_regular_fields(fields: FieldType, n: usize, group: Group) -> Vec<RestrictionTerm> {
    let cosets = cosets(fields.group(), group);
    let scale = (cosets.len() as f64).sqrt().recip();
    let mut terms = Vec::new();
    for &b in group.irreps() {
        let start = fields.restrict(group).channel_range(b).start;
        for (coset, &t) in cosets.iter().enumerate() {
            terms.extend(sources_of(fields, group, b).map(|(a, from)| RestrictionTerm {
                to: start + coset * n,
                from,
                scale: scale * f64::from(a.sign(t)),
            }));
        }
    }
    terms
}

/// Returns the first element of every coset of a subgroup.
fn cosets(group: Group, subgroup: Group) -> Vec<D2> {
    let (all, own) = (group.elements().iter(), subgroup.elements());
    // the smallest element represents its coset
    let first = |t: &D2| own.iter().all(|&h| t.bits() <= (h * *t).bits());
    all.copied().filter(first).collect()
}

impl LayerSignature for Restrict {
    fn in_shape(&self) -> Shape {
        self.shape
    }

    fn out_shape(&self) -> Shape {
        let fields = self.shape.fields.restrict(self.group);
        Shape { fields, ..self.shape }
    }
}

impl Parameterless for Restrict {
    fn apply<T: Scalar>(&self, x: &[T], y: &mut [T], _scratch: &mut [T]) {
        let dim = self.shape.fields.dim();
        y.fill(T::ZERO);
        for (pixel, out) in x.chunks_exact(dim).zip(y.chunks_exact_mut(dim)) {
            for RestrictionTerm { to, from, scale } in &self.terms {
                add(*scale, &pixel[from.clone()], &mut out[*to..]);
            }
        }
    }

    /// Multiplies `dy` by the transpose of the restriction matrix, which is orthogonal, so the
    /// transpose is its inverse.
    fn backprop<T: Scalar>(&self, _x: &[T], _y: &[T], dy: &[T], dx: &mut [T], _scratch: &mut [T]) {
        let dim = self.shape.fields.dim();
        dx.fill(T::ZERO);
        for (upstream, gradient) in dy.chunks_exact(dim).zip(dx.chunks_exact_mut(dim)) {
            for RestrictionTerm { to, from, scale } in &self.terms {
                add(*scale, &upstream[*to..], &mut gradient[from.clone()]);
            }
        }
    }
}

/// Adds `scale` times the values of `from` to those of `to`, as many as the shorter slice has.
fn add<T: Scalar>(scale: f64, from: &[T], to: &mut [T]) {
    let scale = T::from_f64(scale);
    for (sum, &value) in to.iter_mut().zip(from) {
        *sum += scale * value;
    }
}

impl fmt::Display for Restrict {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Restrict({} -> {})", self.shape, self.group)
    }
}

/// Returns restrictions to smaller groups for the tests that run on every kind of layer.
pub(super) fn test_layers<T: Scalar>(group: Group) -> Result<Vec<TestLayer<T>>, LayerError> {
    let mixed = Shape::image(3, 2, FieldType::new(group, [2, 1, 3, 0]));
    let regular = Shape::image(2, 4, group.regular_type(3));
    let sub = match group {
        Group::D2 => Group::D1y,
        _ => Group::C1,
    };
    Ok(vec![
        TestLayer::exact("restriction", Restrict::new(regular, sub)?),
        TestLayer::exact("restriction to C1", Restrict::new(regular, Group::C1)?),
        TestLayer::exact("restriction of mixed", Restrict::new(mixed, sub)?),
    ])
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::layers::layer::Layer;
    use crate::layers::relu::Relu;
    use crate::steerable::hadamard::hadamard_transform;

    fn run(layer: &dyn Layer<f64>, x: &[f64]) -> Vec<f64> {
        let mut y = vec![f64::NAN; layer.out_shape().len()];
        layer.forward(&[], x, &mut y, &mut layer.allocate_scratch(1));
        y
    }

    #[test]
    fn regular_fields_keep_their_values() {
        let values = [0.3, -1.0, 2.0, 0.7];
        for group in Group::ALL {
            for sub in Group::ALL.into_iter().filter(|h| h.is_subgroup_of(group)) {
                let restrict = Restrict::new(Shape::vector(group.regular_type(1)), sub).unwrap();
                let mut x = values[..group.order()].to_vec();
                hadamard_transform(group, &mut x);
                let mut y = run(&restrict, &x);
                hadamard_transform(sub, &mut y);
                let at = |g: D2| group.elements().iter().position(|&e| e == g).unwrap();
                let cosets = cosets(group, sub);
                let elements = sub.elements().iter();
                let elements = elements.flat_map(|&h| cosets.iter().map(move |&t| h * t));
                for (got, g) in y.into_iter().zip(elements) {
                    assert!((got - values[at(g)]).abs() < 1e-15, "{group} to {sub}");
                }
            }
        }
    }

    #[test]
    fn a_relu_may_come_before_or_behind() {
        let shape = Shape::image(2, 2, Group::D2.regular_type(3));
        let x: Vec<f64> = (0..shape.len()).map(|i| (i as f64).cos()).collect();
        let restrict = Restrict::new(shape, Group::C2).unwrap();
        let before = run(&restrict, &run(&Relu::new(shape).unwrap(), &x));
        let behind = run(&Relu::new(restrict.out_shape()).unwrap(), &run(&restrict, &x));
        let pairs = before.iter().zip(&behind);
        assert!(pairs.clone().all(|(a, b)| (a - b).abs() < 1e-15));
        assert!(before != run(&restrict, &x));
    }

    #[test]
    fn only_subgroups_are_taken() {
        let shape = Shape::vector(Group::D1x.regular_type(1));
        for group in [Group::D1y, Group::C2, Group::D2] {
            let message = Restrict::new(shape, group).unwrap_err().to_string();
            let expected = format!("Restrict: got the group {group}, expected a subgroup");
            assert!(message.starts_with(&expected), "{message}");
        }
    }
}
