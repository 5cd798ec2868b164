//! Comparison of actuators: their gears, which may be directions, gains, ranges and dynamics.

use glam::DVec3;
use mujoco::{IntegerArray as Int, NumberArray as Num, raw};

use crate::compare::DifferenceMeasure::{Scale, Share};
use crate::compare::{Comparer, Comparison, MirrorDifference, Subject, mirrored_range};
use crate::snapshot::ModelObjectKind;

impl Comparison {
    /// Compares two actuators and sets the sign by which their controls are mirrored.
    pub(crate) fn compare_actuators(&mut self, comparer: &Comparer, pair: [usize; 2]) {
        let subject = Subject { kind: ModelObjectKind::Actuator, pair };
        let row = |array, width| pair.map(|at| comparer.snapshot.row(array, at, width).to_vec());
        let [mut gear, other_gear] = row(Num::ActuatorGear, 6);
        let image = self.gear_image(comparer, pair[0], &gear);
        let is_directed = image.is_some();
        let sign = match &image {
            Some(image) => {
                let along = image.iter().zip(&other_gear).map(|(one, other)| one * other);
                1_f64.copysign(along.sum())
            }
            None => self.length_sign(comparer, pair[0], (gear[0] * other_gear[0]).signum()),
        };
        pair.iter().for_each(|&actuator| self.control_signs[actuator] = sign);
        match image {
            Some(image) => gear = image.iter().map(|one| sign * one).collect(),
            None => {
                let entries = gear.iter_mut().zip(&other_gear);
                entries.for_each(|(one, other)| *one = one.abs().copysign(*other));
            }
        }
        let [mut bias, other_bias] = row(Num::ActuatorBiasprm, 10);
        bias[0] *= sign;
        let range = |array| row(array, 2).map(|range| [range[0], range[1]]);
        let mirrored = |array| {
            let [one, other] = range(array);
            [mirrored_range(one, sign).to_vec(), other.to_vec()]
        };
        // the elements of directions have no scale of their own; force and torque have
        let by = if is_directed { Scale } else { Share };
        let gears = [gear, other_gear];
        let in_row = Some((Num::ActuatorGear, pair[1]));
        let found = comparer.compare(subject, "gear", by, &gears, in_row).or_else(|| {
            [0..3, 3..6].into_iter().find_map(|part| {
                let halves = gears.each_ref().map(|whole| whole[part.clone()].to_vec());
                comparer.compare(subject, "gear", by, &halves, None)
            })
        });
        self.differences.extend(found);
        self.differences.extend(self.reference_site_mismatch(comparer, subject));
        for (property, array, measure, values) in [
            ("gain", Num::ActuatorGainprm, Share, row(Num::ActuatorGainprm, 10)),
            ("bias", Num::ActuatorBiasprm, Share, [bias, other_bias]),
            ("control range", Num::ActuatorCtrlrange, Scale, mirrored(Num::ActuatorCtrlrange)),
            ("force range", Num::ActuatorForcerange, Scale, mirrored(Num::ActuatorForcerange)),
            ("dynamics", Num::ActuatorDynprm, Share, row(Num::ActuatorDynprm, 10)),
            ("crank length", Num::ActuatorCranklength, Share, row(Num::ActuatorCranklength, 1)),
        ] {
            let edit = Some((array, pair[1]));
            self.differences.extend(comparer.compare(subject, property, measure, &values, edit));
        }
        for (property, array) in [
            ("dynamics type", Int::ActuatorDyntype),
            ("bias type", Int::ActuatorBiastype),
            ("control limited", Int::ActuatorCtrllimited),
            ("force limited", Int::ActuatorForcelimited),
        ] {
            self.differences.extend(comparer.integers(subject, property, array));
        }
    }

    /// Returns the sign by which the control of an actuator is mirrored that changes a length or an
    /// angle, where its gear and that of its counterpart have equal (1) or opposite (-1) signs.
    fn length_sign(&self, comparer: &Comparer, actuator: usize, of_gears: f64) -> f64 {
        let snapshot = comparer.snapshot;
        match snapshot.target_object(ModelObjectKind::Actuator, actuator) {
            Some((ModelObjectKind::Joint, joint)) => self.joint_signs[joint] * of_gears,
            Some((ModelObjectKind::Tendon, tendon)) => self.tendon_signs[tendon] * of_gears,
            // the length of a slider-crank is the same on both sides
            _ if snapshot.integer(Int::ActuatorTrntype, actuator).cast_unsigned()
                == raw::mjTRN_SLIDERCRANK =>
            {
                of_gears
            }
            _ => 1.0,
        }
    }

    /// Returns a difference if the reference sites of two actuators on sites do not correspond.
    fn reference_site_mismatch(
        &self,
        comparer: &Comparer,
        subject: Subject,
    ) -> Option<MirrorDifference> {
        let snapshot = comparer.snapshot;
        let transmission = snapshot.integer(Int::ActuatorTrntype, subject.pair[0]).cast_unsigned();
        let [one, other] = subject.pair.map(|actuator| {
            usize::try_from(snapshot.integer(Int::ActuatorTrnid, 2 * actuator + 1)).ok()
        });
        let counterpart =
            one.and_then(|site| comparer.pairs.counterpart_of(ModelObjectKind::Site, site));
        let corresponds = other == counterpart && one.is_some() == other.is_some();
        (transmission == raw::mjTRN_SITE && !corresponds)
            .then(|| comparer.mismatch(subject, "reference site"))
    }

    /// Returns the mirror image of the gear of an actuator on a ball joint, a free joint or a site,
    /// which is the direction of a torque or of a force and a torque; `None` for other actuators.
    fn gear_image(&self, comparer: &Comparer, actuator: usize, gear: &[f64]) -> Option<Vec<f64>> {
        let snapshot = comparer.snapshot;
        let transmission = snapshot.integer(Int::ActuatorTrntype, actuator).cast_unsigned();
        let (kind, object) = snapshot.target_object(ModelObjectKind::Actuator, actuator)?;
        let [first, second] = [0, 3].map(|at| DVec3::from_slice(&gear[at..at + 3]));
        let image = match kind {
            ModelObjectKind::Joint if !snapshot.is_scalar_joint(object) => {
                let own = self.mirrors[snapshot.body_of_object(kind, object)?]?.turn;
                let world = self.mirrors[0]?.turn;
                // MuJoCo turns gears in the parent back by the joint alone, so those of a ball joint
                // are in the frame of its own body at rest, and those of a free joint in the world's
                let in_parent = transmission == raw::mjTRN_JOINTINPARENT;
                if snapshot.joint_type(object) == raw::mjJNT_BALL {
                    [-(own * first), second]
                } else {
                    [world * first, -(if in_parent { world } else { own } * second)]
                }
            }
            ModelObjectKind::Site if transmission == raw::mjTRN_SITE => {
                let reference = snapshot.integer(Int::ActuatorTrnid, 2 * actuator + 1);
                let site = usize::try_from(reference).unwrap_or(object);
                let turn = self.site_directions(snapshot, comparer.pairs, site)?;
                [turn * first, -(turn * second)]
            }
            _ => return None,
        };
        Some(image.into_iter().flat_map(|vector| vector.to_array()).collect())
    }
}
