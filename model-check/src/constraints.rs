//! Comparison of tendons and equality constraints, which connect bodies, joints and sites.

use glam::{DMat3, DQuat, DVec3};
use mujoco::{IntegerArray as Int, NumberArray as Num, raw};

use crate::compare::DifferenceMeasure::{Metres, Radians, Scale, Share};
use crate::compare::{Comparer, Comparison, Subject, mirrored_range, row_edit};
use crate::connections::{Branch, ObjectOrder, branches, object_order, paths_correspond};
use crate::mirror::{Mirror, quat, quat_values};
use crate::snapshot::ModelObjectKind;

impl Comparison {
    /// Adds the differences of two tendons, and sets the sign by which their lengths are mirrored.
    pub(crate) fn compare_tendons(&mut self, comparer: &Comparer, pair: [usize; 2]) {
        let Comparer { snapshot, pairs, .. } = *comparer;
        let subject = Subject { kind: ModelObjectKind::Tendon, pair };
        if !paths_correspond(snapshot, |kind, at| pairs.counterpart_of(kind, at), pair) {
            self.differences.push(comparer.mismatch(subject, "path"));
            return;
        }
        let sign = self.compare_coefficients(comparer, subject);
        pair.iter().for_each(|&tendon| self.tendon_signs[tendon] = sign);
        for (property, array, width) in [
            ("stiffness", Num::TendonStiffness, 1),
            ("damping", Num::TendonDamping, 1),
            ("friction loss", Num::TendonFrictionloss, 1),
            ("margin", Num::TendonMargin, 1),
            ("limit solref", Num::TendonSolrefLim, 2),
            ("limit solimp", Num::TendonSolimpLim, 5),
        ] {
            self.differences.extend(comparer.same(subject, property, array, width));
        }
        self.differences.extend(comparer.integers(subject, "limited", Int::TendonLimited));
        let is_limited = snapshot.integer(Int::TendonLimited, pair[1]) != 0;
        let is_stiff = pair.iter().any(|&at| snapshot.number(Num::TendonStiffness, at) != 0.0);
        for (property, array) in
            [("range", Num::TendonRange), ("spring length", Num::TendonLengthspring)]
        {
            let width = snapshot.model.numbers(array).len() / snapshot.count(subject.kind);
            let [one, other] = pair.map(|tendon| snapshot.row(array, tendon, width));
            let image = mirrored_range([one[0], one[width - 1]], sign);
            let values = [&image[..width], other];
            let difference =
                comparer.compare(subject, property, Scale, &values, Some((array, pair[1])));
            let is_used = if array == Num::TendonRange { is_limited } else { is_stiff };
            self.differences.extend(difference.filter(|_| is_used));
        }
    }

    /// Adds the difference of the coefficients of joints, or of the divisors of pulleys, of two
    /// tendons with corresponding paths. Returns the sign by which the length is mirrored.
    fn compare_coefficients(&mut self, comparer: &Comparer, subject: Subject) -> f64 {
        let Comparer { snapshot, pairs, .. } = *comparer;
        let left = branches(snapshot, subject.pair[0], |kind, at| pairs.counterpart_of(kind, at));
        let right = branches(snapshot, subject.pair[1], |_, index| Some(index));
        let rows = left.iter().flat_map(Branch::rows).zip(right.iter().flat_map(Branch::rows));
        let shape = |row| snapshot.integer(Int::WrapType, row).cast_unsigned();
        let has_coefficient =
            |row: &(usize, usize)| [raw::mjWRAP_JOINT, raw::mjWRAP_PULLEY].contains(&shape(row.0));
        let rows: Vec<(usize, usize)> = rows.filter(has_coefficient).collect();
        let value = |row| snapshot.number(Num::WrapPrm, row);
        let images = rows.iter().map(|&(row, _)| match shape(row) {
            raw::mjWRAP_JOINT => self.joint_signs[snapshot.index(Int::WrapObjid, row)] * value(row),
            _ => value(row),
        });
        let mut images: Vec<f64> = images.collect();
        let found: Vec<f64> = rows.iter().map(|&(_, row)| value(row)).collect();
        let product: f64 = images.iter().zip(&found).map(|(one, other)| one * other).sum();
        let sign = if product < 0.0 { -1.0 } else { 1.0 };
        images.iter_mut().for_each(|coefficient| *coefficient *= sign);
        let difference = comparer.compare(subject, "coefficients", Share, &[images, found], None);
        self.differences.extend(difference.map(|mut difference| {
            let edits = rows.iter().zip(&difference.expected);
            let edits = edits.map(|((_, row), image)| row_edit(Num::WrapPrm, *row, &[*image]));
            difference.edits = edits.collect();
            difference
        }));
        sign
    }

    /// Adds the differences of two equality constraints.
    pub(crate) fn compare_equalities(&mut self, comparer: &Comparer, pair: [usize; 2]) {
        let Comparer { snapshot, pairs, .. } = *comparer;
        let subject = Subject { kind: ModelObjectKind::Equality, pair };
        let agree =
            snapshot.integer(Int::EqType, pair[0]) == snapshot.integer(Int::EqType, pair[1]);
        let order = object_order(snapshot, |kind, at| pairs.counterpart_of(kind, at), pair);
        let Some(order) = order.filter(|_| agree) else {
            let property = if agree { "objects" } else { "type" };
            self.differences.push(comparer.mismatch(subject, property));
            return;
        };
        self.differences.extend(comparer.integers(subject, "active", Int::EqActive));
        for (property, array, width) in [("solref", Num::EqSolref, 2), ("solimp", Num::EqSolimp, 5)]
        {
            self.differences.extend(comparer.same(subject, property, array, width));
        }
        self.compare_equality_data(comparer, subject, order);
    }

    /// Adds the differences of the anchors, poses and coefficients of two equality constraints with
    /// corresponding objects.
    fn compare_equality_data(&mut self, comparer: &Comparer, subject: Subject, order: ObjectOrder) {
        let Comparer { snapshot, .. } = *comparer;
        let Subject { pair, .. } = subject;
        let found = snapshot.equality_data(pair[1]);
        let objects = snapshot.connected_objects(pair[0]);
        let mut image = snapshot.equality_data(pair[0]).to_vec();
        let shape = snapshot.integer(Int::EqType, pair[0]).cast_unsigned();
        let kind = objects[0].map(|(kind, _)| kind);
        let is_polynomial = matches!(kind, Some(ModelObjectKind::Joint | ModelObjectKind::Tendon));
        let parts: &[_] = match (kind, shape) {
            _ if is_polynomial => {
                self.mirror_polynomial(objects, order, &mut image);
                // of a joint alone, the other coefficients have no effect
                let len = if objects[1].is_none() { 1 } else { 5 };
                &[("coefficients", Scale, 0..len)]
            }
            (Some(ModelObjectKind::Body), raw::mjEQ_CONNECT) => {
                self.mirror_anchors(objects, order, false, &mut image);
                // MuJoCo computes the point in the other frame from this one
                &[("anchor", Metres, 0..3)]
            }
            (Some(ModelObjectKind::Body), raw::mjEQ_WELD) => {
                self.mirror_anchors(objects, order, true, &mut image);
                // a quaternion and its negative are one rotation
                if image[6..10].iter().zip(&found[6..10]).map(|(a, b)| a * b).sum::<f64>() < 0.0 {
                    image[6..10].iter_mut().for_each(|part| *part = -*part);
                }
                &[
                    ("anchor", Metres, 0..6),
                    ("orientation", Radians, 6..10),
                    ("torque scale", Share, 10..11),
                ]
            }
            (Some(ModelObjectKind::Site), raw::mjEQ_WELD) => {
                let values = [DQuat::IDENTITY, self.site_turn(comparer, objects)].map(quat_values);
                let difference = comparer.compare(subject, "orientation", Radians, &values, None);
                self.differences.extend(difference);
                &[("torque scale", Share, 10..11)]
            }
            _ => &[],
        };
        let differences = parts.iter().filter_map(|(property, measure, part)| {
            let values = [&image[part.clone()], &found[part.clone()]];
            comparer.compare(subject, property, *measure, &values, None)
        });
        // one change of the whole row removes all of them
        let mut differences: Vec<_> = differences.collect();
        if let Some(difference) = differences.first_mut() {
            if pair[0] == pair[1] && order == ObjectOrder::Swapped && is_polynomial {
                // two joints that follow each other do so one to one
                image[..2].copy_from_slice(&[0.0, found[1].signum()]);
                difference.expected = image[..5].to_vec();
            } else if pair[0] == pair[1] {
                image.iter_mut().zip(found).for_each(|(value, own)| *value = 0.5 * (*value + own));
            }
            difference.edits = vec![row_edit(Num::EqData, pair[1], &image)];
        }
        self.differences.extend(differences);
    }

    /// Mirrors the polynomial by which the deviation of one joint or tendon from `qpos0` follows
    /// that of another.
    fn mirror_polynomial(
        &self,
        objects: [Option<(ModelObjectKind, usize)>; 2],
        order: ObjectOrder,
        data: &mut [f64],
    ) {
        let mut signs = objects.map(|object| match object {
            Some((ModelObjectKind::Joint, joint)) => self.joint_signs[joint],
            Some((ModelObjectKind::Tendon, tendon)) => self.tendon_signs[tendon],
            _ => 1.0,
        });
        if order == ObjectOrder::Swapped {
            // y = a + b x is x = -a / b + y / b
            signs.reverse();
            data[1] = data[1].recip();
            data[0] *= -data[1];
        }
        let [mut sign, leader] = signs;
        for coefficient in &mut data[..5] {
            *coefficient *= sign;
            sign *= leader;
        }
    }

    /// Mirrors the anchors of a connection of two bodies and, of a weld, their relative
    /// orientation.
    fn mirror_anchors(
        &self,
        objects: [Option<(ModelObjectKind, usize)>; 2],
        order: ObjectOrder,
        is_weld: bool,
        data: &mut [f64],
    ) {
        let mirror = |object: Option<(_, usize)>| object.and_then(|(_, body)| self.mirrors[body]);
        let [Some(first), Some(second)]: [Option<Mirror>; 2] = objects.map(mirror) else {
            return;
        };
        // a weld has the anchor in the second body's frame first
        let owners = if is_weld { [second, first] } else { [first, second] };
        let mut anchors = [0, 1].map(|at| owners[at].point(DVec3::from_slice(&data[3 * at..])));
        let rotation = DMat3::from_quat(quat(&data[6..10]));
        let mut rotation = first.turn * rotation * second.turn.transpose();
        if order == ObjectOrder::Swapped {
            anchors.reverse();
            rotation = rotation.transpose();
        }
        for (at, anchor) in anchors.iter().enumerate() {
            data[3 * at..][..3].copy_from_slice(&anchor.to_array());
        }
        if is_weld {
            data[6..10].copy_from_slice(&quat_values(DQuat::from_mat3(&rotation)));
        }
    }

    /// Returns the rotation by which the counterparts of two welded sites, whose frames may be
    /// turned by convention, are held apart from the mirror images of the two.
    fn site_turn(
        &self,
        comparer: &Comparer,
        sites: [Option<(ModelObjectKind, usize)>; 2],
    ) -> DQuat {
        let Comparer { snapshot, pairs, .. } = *comparer;
        let flips = sites.map(|object| self.site_directions(snapshot, pairs, object?.1));
        match flips {
            [Some(first), Some(second)] => {
                let turn = DQuat::from_mat3(&(first * second.transpose()));
                if turn.w < 0.0 { -turn } else { turn }
            }
            _ => DQuat::IDENTITY,
        }
    }
}
