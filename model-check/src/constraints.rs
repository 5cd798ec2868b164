//! Comparison of tendons and equality constraints, which connect bodies, joints and sites.

use glam::{DMat3, DQuat, DVec3};
use mujoco::{IntegerArray as Int, NumberArray as Num, raw};

use crate::compare::DifferenceMeasure::{Exact, Metres, Radians, Scale, Share};
use crate::compare::{Comparer, Comparison, Subject, mirrored_range, row_edit};
use crate::mirror::{Mirror, quat, quat_values};
use crate::pairs::MirrorPairs;
use crate::snapshot::{ModelObjectKind, PosedModel};

/// Point of a tendon's path: its type, its object and the site beside it.
type PathPoint = (raw::mjtWrap, Option<usize>, Option<usize>);

/// Returns the objects of a tendon's path. The order of joints does not matter; they are sorted.
fn path(snapshot: &PosedModel, tendon: usize) -> Vec<PathPoint> {
    let points = snapshot.tendon_path(tendon).map(|(at, shape, object)| match shape {
        raw::mjWRAP_PULLEY => (shape, None, None),
        raw::mjWRAP_SPHERE | raw::mjWRAP_CYLINDER => {
            // MuJoCo has -1 for none
            let side = snapshot.number(Num::WrapPrm, at);
            (shape, Some(object), (side >= 0.0).then_some(side as usize))
        }
        _ => (shape, Some(object), None),
    });
    sorted_joints(points.collect())
}

fn sorted_joints(mut path: Vec<PathPoint>) -> Vec<PathPoint> {
    if path.iter().all(|(shape, ..)| *shape == raw::mjWRAP_JOINT) {
        path.sort_unstable();
    }
    path
}

/// Returns the mirror image of a tendon's path; `None` if one of its objects has no counterpart.
fn path_image(snapshot: &PosedModel, pairs: &MirrorPairs, tendon: usize) -> Option<Vec<PathPoint>> {
    let site = |index| pairs.counterpart_of(ModelObjectKind::Site, index);
    let points = path(snapshot, tendon).into_iter().map(|(shape, object, side)| {
        let kind = match shape {
            raw::mjWRAP_JOINT => ModelObjectKind::Joint,
            raw::mjWRAP_SITE => ModelObjectKind::Site,
            _ => ModelObjectKind::Geom,
        };
        let image = match object {
            Some(object) => Some(pairs.counterpart_of(kind, object)?),
            None => None,
        };
        Some((shape, image, if let Some(side) = side { Some(site(side)?) } else { None }))
    });
    Some(sorted_joints(points.collect::<Option<_>>()?))
}

/// Returns `true` if the path of the second tendon is the mirror image of that of the first, from
/// either end.
pub(crate) fn paths_correspond(
    snapshot: &PosedModel,
    pairs: &MirrorPairs,
    [one, other]: [usize; 2],
) -> bool {
    let (image, found) = (path_image(snapshot, pairs, one), path(snapshot, other));
    let has_pulleys = found.iter().any(|(shape, ..)| *shape == raw::mjWRAP_PULLEY);
    image.is_some_and(|mut image| {
        image == found
            || (!has_pulleys && {
                image.reverse();
                image == found
            })
    })
}

/// Correspondence of the two objects of an equality constraint to those of its counterpart.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum HeldObjectOrder {
    Same,
    Swapped,
}

/// Returns the order in which the objects of two equality constraints are counterparts; `None` if
/// they are not.
pub(crate) fn held_object_order(
    snapshot: &PosedModel,
    pairs: &MirrorPairs,
    equalities: [usize; 2],
) -> Option<HeldObjectOrder> {
    let [one, other] = equalities.map(|equality| snapshot.held_objects(equality));
    let image = |object: Option<(ModelObjectKind, usize)>| match object {
        Some((kind, index)) => pairs.counterpart_of(kind, index).map(|index| Some((kind, index))),
        None => Some(None),
    };
    let [first, second] = [image(one[0])?, image(one[1])?];
    // coordinates of joints and tendons are functions of the second object
    let holds_points = one[0]
        .is_none_or(|(kind, _)| ![ModelObjectKind::Joint, ModelObjectKind::Tendon].contains(&kind));
    if [first, second] == other {
        Some(HeldObjectOrder::Same)
    } else if holds_points && [second, first] == other {
        Some(HeldObjectOrder::Swapped)
    } else {
        None
    }
}

impl Comparison {
    /// Adds the differences of two tendons, and sets the sign by which their lengths are mirrored.
    pub(crate) fn compare_tendons(&mut self, comparer: &Comparer, pair: [usize; 2]) {
        let Comparer { snapshot, pairs, .. } = *comparer;
        let subject = Subject { kind: ModelObjectKind::Tendon, pair };
        if !paths_correspond(snapshot, pairs, pair) {
            let image = path_image(snapshot, pairs, pair[0]).unwrap_or_default();
            let values = [image, path(snapshot, pair[1])].map(|points| {
                let objects = points.iter().flat_map(|(_, object, side)| [*object, *side]);
                objects.flatten().map(|object| object as f64).collect::<Vec<_>>()
            });
            self.differences.extend(comparer.compare(subject, "path", Exact, &values, None));
            return;
        }
        let sign = self.compare_coefficients(comparer, subject);
        pair.iter().for_each(|&tendon| self.tendon_signs[tendon] = sign);
        for (property, array) in [
            ("stiffness", Num::TendonStiffness),
            ("damping", Num::TendonDamping),
            ("friction loss", Num::TendonFrictionloss),
            ("margin", Num::TendonMargin),
        ] {
            self.differences.extend(comparer.same(subject, property, array, 1));
        }
        self.differences.extend(comparer.integers(subject, "limited", Int::TendonLimited));
        // lengths of joints count from those in `qpos0`, lengths of space from 0
        let is_fixed =
            snapshot.tendon_path(pair[0]).any(|(_, shape, _)| shape == raw::mjWRAP_JOINT);
        let rest = pair
            .map(|tendon| if is_fixed { snapshot.number(Num::TendonLength0, tendon) } else { 0.0 });
        for (property, array) in
            [("range", Num::TendonRange), ("spring length", Num::TendonLengthspring)]
        {
            let width = snapshot.model.numbers(array).len() / snapshot.count(subject.kind);
            let [one, other] = pair.map(|tendon| snapshot.row(array, tendon, width));
            let moved = [one[0] - rest[0], one[width - 1] - rest[0]];
            let image = mirrored_range(moved, sign).map(|length| length + rest[1]);
            let values = [&image[..width], other];
            let is_used =
                array != Num::TendonRange || snapshot.integer(Int::TendonLimited, pair[1]) != 0;
            let edit = Some((array, pair[1]));
            let difference = comparer.compare(subject, property, Scale, &values, edit);
            self.differences.extend(difference.filter(|_| is_used));
        }
    }

    /// Adds the difference of the coefficients of joints, or of the divisors of pulleys, of two
    /// tendons with corresponding paths. Returns the sign by which the length is mirrored.
    fn compare_coefficients(&mut self, comparer: &Comparer, subject: Subject) -> f64 {
        let Comparer { snapshot, pairs, .. } = *comparer;
        let joint_image = |joint| pairs.counterpart_of(ModelObjectKind::Joint, joint);
        let mut rows = Vec::new();
        let [mut images, mut found] = [const { Vec::new() }; 2];
        let [left, right] = subject.pair.map(|tendon| snapshot.tendon_path(tendon));
        let mut left: Vec<_> = left.collect();
        for (at, shape, object) in right {
            let own = match shape {
                raw::mjWRAP_JOINT => {
                    left.iter().position(|(_, _, joint)| joint_image(*joint) == Some(object))
                }
                raw::mjWRAP_PULLEY => left.iter().position(|(_, other, _)| *other == shape),
                _ => None,
            };
            let Some((from, _, joint)) = own.map(|own| left.remove(own)) else { continue };
            let sign = if shape == raw::mjWRAP_JOINT { self.joint_signs[joint] } else { 1.0 };
            rows.push(at);
            images.push(sign * snapshot.number(Num::WrapPrm, from));
            found.push(snapshot.number(Num::WrapPrm, at));
        }
        let product: f64 = images.iter().zip(&found).map(|(image, found)| image * found).sum();
        let sign = if product < 0.0 { -1.0 } else { 1.0 };
        images.iter_mut().for_each(|image| *image *= sign);
        let difference = comparer.compare(subject, "coefficients", Share, &[images, found], None);
        self.differences.extend(difference.map(|mut difference| {
            let edits = rows.iter().zip(&difference.expected);
            let edits = edits.map(|(&row, value)| row_edit(Num::WrapPrm, row, &[*value]));
            difference.edits = edits.collect();
            difference
        }));
        sign
    }

    /// Adds the differences of two equality constraints.
    pub(crate) fn compare_equalities(&mut self, comparer: &Comparer, pair: [usize; 2]) {
        let Comparer { snapshot, pairs, .. } = *comparer;
        let subject = Subject { kind: ModelObjectKind::Equality, pair };
        self.differences.extend(comparer.integers(subject, "active", Int::EqActive));
        for (property, array, width) in [("solref", Num::EqSolref, 2), ("solimp", Num::EqSolimp, 5)]
        {
            self.differences.extend(comparer.same(subject, property, array, width));
        }
        let Some(order) = held_object_order(snapshot, pairs, pair) else {
            let objects = |held: [Option<(ModelObjectKind, usize)>; 2]| -> Vec<f64> {
                held.iter().flatten().map(|&(_, index)| index as f64).collect()
            };
            let image = snapshot.held_objects(pair[0]).map(|object| {
                let (kind, index) = object?;
                Some((kind, pairs.counterpart_of(kind, index)?))
            });
            let values = [objects(image), objects(snapshot.held_objects(pair[1]))];
            self.differences.extend(comparer.compare(subject, "objects", Exact, &values, None));
            return;
        };
        let width = raw::mjNEQDATA as usize;
        let [one, found] = pair.map(|equality| snapshot.row(Num::EqData, equality, width));
        let shape = snapshot.integer(Int::EqType, pair[0]).cast_unsigned();
        let mut image = one.to_vec();
        match snapshot.held_objects(pair[0])[0] {
            Some((ModelObjectKind::Joint | ModelObjectKind::Tendon, _)) => {
                self.mirror_polynomial(snapshot, pair[0], &mut image);
            }
            Some((ModelObjectKind::Body, _)) => {
                if self.mirror_anchors(snapshot, pair[0], order, &mut image).is_none() {
                    return;
                }
            }
            // the poses of sites say where they are held together
            _ => image[..10].copy_from_slice(&found[..10]),
        }
        if image[6..10].iter().zip(&found[6..10]).map(|(a, b)| a * b).sum::<f64>() < 0.0 {
            // a quaternion and its negative are one rotation
            image[6..10].iter_mut().for_each(|part| *part = -*part);
        }
        let parts: &[_] = match shape {
            raw::mjEQ_CONNECT => &[("anchor", Metres, 0..6)],
            raw::mjEQ_WELD => &[
                ("anchor", Metres, 0..6),
                ("orientation", Radians, 6..10),
                ("torque scale", Share, 10..11),
            ],
            raw::mjEQ_JOINT | raw::mjEQ_TENDON => &[("coefficients", Scale, 0..5)],
            _ => &[],
        };
        let differences = parts.iter().filter_map(|(property, measure, part)| {
            let values = [&image[part.clone()], &found[part.clone()]];
            comparer.compare(subject, property, *measure, &values, None)
        });
        // one change of the whole row removes all of them
        let mut differences: Vec<_> = differences.collect();
        if let Some(difference) = differences.first_mut() {
            if pair[0] == pair[1] {
                image.iter_mut().zip(found).for_each(|(image, own)| *image = 0.5 * (*image + own));
            }
            difference.edits = vec![row_edit(Num::EqData, pair[1], &image)];
        }
        self.differences.extend(differences);
    }

    /// Mirrors the polynomial by which the deviation of one joint or tendon from `qpos0` follows
    /// that of another.
    fn mirror_polynomial(&self, snapshot: &PosedModel, equality: usize, data: &mut [f64]) {
        let [follower, leader] = snapshot.held_objects(equality).map(|object| match object {
            Some((ModelObjectKind::Joint, joint)) => self.joint_signs[joint],
            Some((ModelObjectKind::Tendon, tendon)) => self.tendon_signs[tendon],
            _ => 1.0,
        });
        let mut sign = follower;
        for coefficient in &mut data[..5] {
            *coefficient *= sign;
            sign *= leader;
        }
    }

    /// Mirrors the anchors of a connection of two bodies and, of a weld, their relative
    /// orientation; `None` if a body has no counterpart.
    fn mirror_anchors(
        &self,
        snapshot: &PosedModel,
        equality: usize,
        order: HeldObjectOrder,
        data: &mut [f64],
    ) -> Option<()> {
        let [first, second] = snapshot.held_objects(equality);
        let [first, second]: [Mirror; 2] = [self.mirrors[first?.1]?, self.mirrors[second?.1]?];
        let is_weld = snapshot.integer(Int::EqType, equality).cast_unsigned() == raw::mjEQ_WELD;
        // a weld has the anchor in the second body's frame first
        let owners = if is_weld { [second, first] } else { [first, second] };
        let mut anchors = [0, 1].map(|at| owners[at].point(DVec3::from_slice(&data[3 * at..])));
        let rotation = DMat3::from_quat(quat(&data[6..10]));
        let mut rotation = first.turn * rotation * second.turn.transpose();
        if order == HeldObjectOrder::Swapped {
            anchors.reverse();
            rotation = rotation.transpose();
        }
        for (at, anchor) in anchors.iter().enumerate() {
            data[3 * at..][..3].copy_from_slice(&anchor.to_array());
        }
        if is_weld {
            data[6..10].copy_from_slice(&quat_values(DQuat::from_mat3(&rotation)));
        }
        Some(())
    }
}
