//! Comparison of objects with the mirror images of their counterparts.
//!
//! Read this before editing. Frames are conventions: a right leg may be described in frames that
//! are no mirror images of the left leg's. So the contents of a body (masses, joints, geoms) are
//! compared where they are in the world, and frames only count where the contents moved with them:
//! then the body itself was moved or turned. [`Comparison::body_mirror`] decides that.

use glam::{DMat3, DQuat, DVec3};
use mujoco::{IntegerArray as Int, NumberArray as Num, RowEdit, raw};
use serde::Serialize;

use crate::mirror::{Mirror, MirrorPlane, principal, quat_values};
use crate::pairs::MirrorPairs;
use crate::snapshot::{ModelObjectKind, PosedModel};

use DifferenceMeasure::{Exact, Metres, Radians, Scale, Share};

/// Length (metres) that counts as much as a relative difference of 1.
const LENGTH_SCALE: f64 = 0.1;
/// Values that count as zero where shares are compared.
const ROUNDING: f64 = 1e-9;

/// Measure of a difference between two rows of values, such as a share, a length or an angle.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize)]
#[serde(rename_all = "lowercase")]
pub enum DifferenceMeasure {
    /// Largest difference of two elements, as a share of the larger one.
    Share,
    /// Largest difference of two elements, as a share of the largest element.
    Scale,
    /// Distance (metres).
    Metres,
    /// Angle (radians), for large ones the chord of its arc.
    Radians,
    /// Values that are equal or not; the amount is 1.
    Exact,
}

/// Property in which an object differs from the mirror image of its counterpart.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct MirrorDifference {
    /// Kind of the objects.
    pub kind: ModelObjectKind,
    /// Name of the left object.
    pub left: String,
    /// Name of its counterpart; that of the left object again where it lies in the plane and is
    /// compared with its own mirror image, and a body's where it has no counterpart.
    pub right: String,
    /// Name of the property, such as `mass`; `counterpart` for an object that has none.
    pub property: String,
    /// Values that the right object would have as mirror image of the left one, in its own frame;
    /// empty, as `found`, for properties that are not numbers, such as the path of a tendon.
    pub expected: Vec<f64>,
    /// Values of the right object.
    pub found: Vec<f64>,
    /// Size of the difference.
    pub amount: f64,
    /// Measure of `amount`.
    pub measure: DifferenceMeasure,
    /// Root mean square by which the joints of both sides diverge after a second of mirrored
    /// torques, where this is the only difference (radians and metres); `None` if it is not
    /// simulated.
    pub effect: Option<f64>,
    /// Changes of the right object that remove the difference.
    #[serde(skip)]
    pub(crate) edits: Vec<RowEdit>,
}

impl MirrorDifference {
    /// Returns the difference of two objects in a property without values.
    fn mismatch(kind: ModelObjectKind, [left, right]: [String; 2], property: &str) -> Self {
        Self {
            kind,
            left,
            right,
            property: property.to_owned(),
            expected: Vec::new(),
            found: Vec::new(),
            amount: 1.0,
            measure: Exact,
            effect: None,
            edits: Vec::new(),
        }
    }

    /// Returns the size of the difference in a unit in which lengths, angles and shares are
    /// comparable.
    pub(crate) fn scaled_amount(&self) -> f64 {
        self.amount / if self.measure == Metres { LENGTH_SCALE } else { 1.0 }
    }
}

/// Differences between the sides of a whole model, and the maps between the sides.
pub(crate) struct Comparison {
    pub differences: Vec<MirrorDifference>,
    /// For each body with a counterpart, the map from its frame to the counterpart's.
    pub mirrors: Vec<Option<Mirror>>,
    /// Sign by which each joint's coordinate is mirrored.
    pub joint_signs: Vec<f64>,
    /// Sign by which the change of each tendon's length is mirrored.
    pub tendon_signs: Vec<f64>,
    /// Sign by which each control is mirrored.
    pub control_signs: Vec<f64>,
}

pub(crate) struct Comparer<'a> {
    pub snapshot: &'a PosedModel<'a>,
    pub pairs: &'a MirrorPairs,
    tolerance: f64,
}

/// Objects whose properties are compared, [left, right].
#[derive(Clone, Copy)]
pub(crate) struct Subject {
    pub kind: ModelObjectKind,
    pub pair: [usize; 2],
}

impl Comparison {
    pub fn new(
        snapshot: &PosedModel,
        pairs: &MirrorPairs,
        plane: &MirrorPlane,
        tolerance: f64,
    ) -> Self {
        let comparer = Comparer { snapshot, pairs, tolerance };
        let mut comparison = Self {
            differences: Vec::new(),
            mirrors: vec![None; snapshot.count(ModelObjectKind::Body)],
            joint_signs: vec![1.0; snapshot.count(ModelObjectKind::Joint)],
            tendon_signs: vec![1.0; snapshot.count(ModelObjectKind::Tendon)],
            control_signs: vec![1.0; snapshot.count(ModelObjectKind::Actuator)],
        };
        let list = |kind| pairs.left_right_pairs(kind, snapshot, plane);
        for pair in list(ModelObjectKind::Body) {
            comparison.compare_bodies(&comparer, pair, plane);
        }
        for pair in list(ModelObjectKind::Tendon) {
            comparison.compare_tendons(&comparer, pair);
        }
        for pair in list(ModelObjectKind::Equality) {
            comparison.compare_equalities(&comparer, pair);
        }
        for pair in list(ModelObjectKind::Actuator) {
            comparison.compare_actuators(&comparer, pair);
        }
        for pair in list(ModelObjectKind::Sensor) {
            let subject = Subject { kind: ModelObjectKind::Sensor, pair };
            for (property, array) in [("cutoff", Num::SensorCutoff), ("noise", Num::SensorNoise)] {
                comparison.differences.extend(comparer.same(subject, property, array, 1));
            }
        }
        for pair in list(ModelObjectKind::Keyframe) {
            comparison.compare_keyframes(&comparer, pair);
        }
        comparison.add_unpaired(snapshot, pairs);
        comparison
    }

    fn compare_bodies(&mut self, comparer: &Comparer, pair: [usize; 2], plane: &MirrorPlane) {
        let (mirror, found) = match pair {
            [0, 0] => (plane.mirror(), Vec::new()),
            _ => self.body_mirror(comparer, pair, plane),
        };
        self.differences.extend(found);
        self.differences.extend(comparer.contents(pair, &mirror));
        let [left, right] = pair;
        self.mirrors[right] = Some(mirror.inverse());
        self.mirrors[left] = Some(mirror);
        for (joint, other) in comparer.counterparts(ModelObjectKind::Joint, pair) {
            let sign = comparer.joint_sign([joint, other], &mirror);
            self.joint_signs[joint] = sign;
            self.joint_signs[other] = sign;
        }
    }

    /// Returns the map between the frames of two bodies, and the differences of the bodies' own
    /// poses: the choice that explains their contents with the fewest differences.
    fn body_mirror(
        &self,
        comparer: &Comparer,
        pair: [usize; 2],
        plane: &MirrorPlane,
    ) -> (Mirror, Vec<MirrorDifference>) {
        let snapshot = comparer.snapshot;
        let above = self.mirrors[snapshot.parent(pair[0])].unwrap_or(plane.mirror());
        let rotations = pair.map(|body| snapshot.rotation(Num::BodyQuat, body));
        let [one, other] = rotations.map(DMat3::from_quat);
        let positions = pair.map(|body| snapshot.vector(Num::BodyPos, body));
        let image = above.point(positions[0]);
        let by_frames = other.transpose() * above.turn * one;
        let gap = other.transpose() * (positions[1] - image);
        let options = [
            // the body is in its place, or moved with its contents
            Mirror { turn: by_frames, shift: DVec3::ZERO },
            // turned, too, if frames follow the convention of the parents' frames
            Mirror { turn: above.turn, shift: DVec3::ZERO },
            // its contents are in their places, and its frame is elsewhere by convention
            Mirror { turn: by_frames, shift: -gap },
        ];
        let counts = options.map(|mirror| comparer.contents(pair, &mirror).len());
        let best = (0..3).min_by_key(|&option| counts[option]).unwrap_or(0);
        let mirror = options[best];
        let subject = Subject { kind: ModelObjectKind::Body, pair };
        let mut found = Vec::new();
        if best < 2 {
            let edit = Some((Num::BodyPos, pair[1]));
            let values = [image, positions[1]].map(|position| position.to_array());
            found.extend(comparer.compare(subject, "position", Metres, &values, edit));
        }
        if best == 1 {
            let expected = DQuat::from_mat3(&(above.turn * one * mirror.turn.transpose()));
            let edit = Some((Num::BodyQuat, pair[1]));
            found.extend(comparer.rotation(subject, expected, rotations[1], edit));
        }
        (mirror, found)
    }

    /// Adds the objects without counterparts whose bodies have one.
    fn add_unpaired(&mut self, snapshot: &PosedModel, pairs: &MirrorPairs) {
        for kind in ModelObjectKind::ALL {
            let unpaired =
                (0..snapshot.count(kind)).filter(|&at| pairs.counterpart_of(kind, at).is_none());
            for index in unpaired.filter(|&at| {
                kind != ModelObjectKind::Geom || snapshot.geom_collides_or_bends_tendon(at)
            }) {
                let owner = match kind {
                    ModelObjectKind::Body => Some(snapshot.parent(index)),
                    _ => snapshot.body_of_object(kind, index),
                };
                // a body without counterpart is reported, what it carries is not
                let Some(other) = pairs.counterpart_of(ModelObjectKind::Body, owner.unwrap_or(0))
                else {
                    continue;
                };
                let left = snapshot.object_label(kind, index);
                let right = snapshot.object_label(ModelObjectKind::Body, other);
                self.differences.push(MirrorDifference::mismatch(
                    kind,
                    [left, right],
                    "counterpart",
                ));
            }
        }
    }

    /// Returns the map of directions in the frame of a site to their mirror images in the frame of
    /// its counterpart.
    pub fn site_directions(
        &self,
        snapshot: &PosedModel,
        pairs: &MirrorPairs,
        site: usize,
    ) -> Option<DMat3> {
        let other = pairs.counterpart_of(ModelObjectKind::Site, site)?;
        let [one, image] =
            [site, other].map(|of| DMat3::from_quat(snapshot.rotation(Num::SiteQuat, of)));
        let body = snapshot.body_of_object(ModelObjectKind::Site, site)?;
        Some(image.transpose() * self.mirrors[body]?.turn * one)
    }

    fn compare_keyframes(&mut self, comparer: &Comparer, keys: [usize; 2]) {
        let snapshot = comparer.snapshot;
        let mut found = Vec::new();
        let mut add = |kind, property, pair: [usize; 2], values: [f64; 2]| {
            // in one keyframe, each pair counts once
            if keys[0] != keys[1] || pair[0] <= pair[1] {
                let subject = Subject { kind, pair };
                let values = values.map(|value| [value]);
                let difference = comparer.compare(subject, property, Radians, &values, None);
                found.extend(difference.map(|mut difference| {
                    let [left, right] =
                        keys.map(|key| snapshot.object_label(ModelObjectKind::Keyframe, key));
                    difference.kind = ModelObjectKind::Keyframe;
                    difference.left = format!("{left}, {}", difference.left);
                    difference.right = format!("{right}, {}", difference.right);
                    difference
                }));
            }
        };
        let [nq, nu] = [snapshot.model.nq(), snapshot.model.nu()];
        for joint in (0..self.joint_signs.len()).filter(|&joint| snapshot.is_scalar_joint(joint)) {
            let Some(other) = comparer.pairs.counterpart_of(ModelObjectKind::Joint, joint) else {
                continue;
            };
            let at = [joint, other].map(|joint| snapshot.index(Int::JntQposadr, joint));
            let rest = at.map(|at| snapshot.number(Num::Qpos0, at));
            let [one, own] =
                [0, 1].map(|side| snapshot.number(Num::KeyQpos, keys[side] * nq + at[side]));
            let image = self.joint_signs[joint] * (one - rest[0]) + rest[1];
            add(ModelObjectKind::Joint, "position", [joint, other], [image, own]);
        }
        for (actuator, sign) in self.control_signs.iter().enumerate() {
            let Some(other) = comparer.pairs.counterpart_of(ModelObjectKind::Actuator, actuator)
            else {
                continue;
            };
            let pair = [actuator, other];
            let [one, own] =
                [0, 1].map(|side| snapshot.number(Num::KeyCtrl, keys[side] * nu + pair[side]));
            add(ModelObjectKind::Actuator, "control", pair, [sign * one, own]);
        }
        self.differences.extend(found);
    }
}

impl Comparer<'_> {
    /// Returns the objects of a kind on the first body that have counterparts, each pair once.
    fn counterparts(
        &self,
        kind: ModelObjectKind,
        [left, right]: [usize; 2],
    ) -> Vec<(usize, usize)> {
        let all =
            (0..self.snapshot.count(kind)).map(|one| (one, self.pairs.counterpart_of(kind, one)));
        let pairs = all.filter_map(|(one, other)| Some((one, other?)));
        pairs
            .filter(|&(one, other)| {
                self.snapshot.body_of_object(kind, one) == Some(left)
                    && (left != right || one <= other)
            })
            .collect()
    }

    /// Returns the differences between the masses, joints, geoms, sites and cameras of two bodies.
    fn contents(&self, pair: [usize; 2], mirror: &Mirror) -> Vec<MirrorDifference> {
        let mut found = Vec::new();
        if pair[0] != 0 {
            self.compare_masses(pair, mirror, &mut found);
        }
        for kind in [
            ModelObjectKind::Joint,
            ModelObjectKind::Geom,
            ModelObjectKind::Site,
            ModelObjectKind::Camera,
        ] {
            for (one, other) in self.counterparts(kind, pair) {
                let subject = Subject { kind, pair: [one, other] };
                match kind {
                    ModelObjectKind::Joint if self.snapshot.is_scalar_joint(one) => {
                        self.compare_joints(subject, mirror, &mut found);
                    }
                    ModelObjectKind::Joint => {}
                    ModelObjectKind::Geom => self.compare_geoms(subject, mirror, &mut found),
                    _ => self.compare_views(subject, mirror, &mut found),
                }
            }
        }
        found
    }

    fn compare_masses(&self, pair: [usize; 2], mirror: &Mirror, found: &mut Vec<MirrorDifference>) {
        let subject = Subject { kind: ModelObjectKind::Body, pair };
        found.extend(self.same(subject, "mass", Num::BodyMass, 1));
        if pair.iter().all(|&body| self.snapshot.number(Num::BodyMass, body) == 0.0) {
            return;
        }
        found.extend(self.point(subject, "centre of mass", Num::BodyIpos, mirror));
        let [one, other] = pair.map(|body| {
            let axes = self.snapshot.rotation(Num::BodyIquat, body);
            tensor(self.snapshot.vector(Num::BodyInertia, body), axes)
        });
        let image = mirror.tensor(one);
        let values = [image, other].map(tensor_values);
        let difference = self.compare(subject, "inertia", Scale, &values, None);
        found.extend(difference.map(|difference| {
            let expected = if pair[0] == pair[1] { (image + other) * 0.5 } else { image };
            let (moments, axes) = principal(expected);
            let edits = vec![
                row_edit(Num::BodyInertia, pair[1], &moments.to_array()),
                row_edit(Num::BodyIquat, pair[1], &quat_values(axes)),
            ];
            MirrorDifference { edits, ..difference }
        }));
    }

    /// Returns the mirror image of a joint's axis, for a positive sign.
    fn axis_image(&self, joint: usize, mirror: &Mirror) -> DVec3 {
        let axis = self.snapshot.vector(Num::JntAxis, joint);
        match self.snapshot.joint_type(joint) {
            raw::mjJNT_HINGE => mirror.axial(axis),
            _ => mirror.direction(axis),
        }
    }

    fn axis_sign(&self, [one, other]: [usize; 2], mirror: &Mirror) -> f64 {
        self.axis_image(one, mirror).dot(self.snapshot.vector(Num::JntAxis, other)).signum()
    }

    /// Returns the sign by which a joint's coordinate is mirrored. Where the limits fit the
    /// opposite of what the axis says, it is theirs: the axis points the wrong way then.
    fn joint_sign(&self, pair: [usize; 2], mirror: &Mirror) -> f64 {
        if !self.snapshot.is_scalar_joint(pair[0]) {
            return 1.0;
        }
        let sign = self.axis_sign(pair, mirror);
        let subject = Subject { kind: ModelObjectKind::Joint, pair };
        let fits = |tried| {
            let limits = self.limits(pair, tried);
            self.compare(subject, "range", Scale, &limits, None).is_none()
        };
        let limited = pair.map(|joint| self.snapshot.integer(Int::JntLimited, joint) != 0);
        let is_wrong = pair[0] != pair[1] && limited == [true; 2] && !fits(sign) && fits(-sign);
        if is_wrong { -sign } else { sign }
    }

    /// Returns the mirror image of a joint's range, and the range of its counterpart.
    fn limits(&self, pair: [usize; 2], sign: f64) -> [[f64; 2]; 2] {
        let rest = pair.map(|joint| {
            self.snapshot.number(Num::Qpos0, self.snapshot.index(Int::JntQposadr, joint))
        });
        let [one, other] = pair.map(|joint| self.snapshot.row(Num::JntRange, joint, 2));
        let image = mirrored_range([one[0] - rest[0], one[1] - rest[0]], sign);
        [image.map(|limit| limit + rest[1]), [other[0], other[1]]]
    }

    fn compare_joints(&self, subject: Subject, mirror: &Mirror, found: &mut Vec<MirrorDifference>) {
        let (snapshot, pair) = (self.snapshot, subject.pair);
        let address = |array| pair.map(|joint| snapshot.index(array, joint));
        let dofs = address(Int::JntDofadr);
        for (property, array, rows) in [
            ("armature", Num::DofArmature, dofs),
            ("damping", Num::DofDamping, dofs),
            ("friction loss", Num::DofFrictionloss, dofs),
            ("stiffness", Num::JntStiffness, pair),
        ] {
            let (values, edit) = (rows.map(|row| [snapshot.number(array, row)]), (array, rows[1]));
            found.extend(self.compare(subject, property, Share, &values, Some(edit)));
        }
        let sign = self.joint_sign(pair, mirror);
        let axis = snapshot.vector(Num::JntAxis, pair[1]);
        let (property, measure, image) = if sign == self.axis_sign(pair, mirror) {
            ("axis", Radians, self.axis_image(pair[0], mirror) * sign)
        } else {
            ("sign", Exact, -axis)
        };
        let axes = [image, axis].map(|axis| axis.to_array());
        let edit = |array| Some((array, pair[1]));
        found.extend(self.compare(subject, property, measure, &axes, edit(Num::JntAxis)));
        if snapshot.joint_type(pair[0]) == raw::mjJNT_HINGE {
            let [one, other] = pair.map(|joint| snapshot.vector(Num::JntPos, joint));
            let anchor = mirror.point(one);
            // a hinge is the same anywhere on its axis
            let anchor = anchor + (other - anchor).project_onto(axis);
            let anchors = [anchor, other].map(|point| point.to_array());
            let edit = edit(Num::JntPos);
            found.extend(self.compare(subject, "anchor", Metres, &anchors, edit));
        }
        found.extend(self.integers(subject, "limited", Int::JntLimited));
        if snapshot.integer(Int::JntLimited, pair[1]) != 0 {
            let limits = self.limits(pair, sign);
            let edit = edit(Num::JntRange);
            found.extend(self.compare(subject, "range", Scale, &limits, edit));
            found.extend(self.same(subject, "limit margin", Num::JntMargin, 1));
            found.extend(self.same(subject, "limit solref", Num::JntSolref, 2));
            found.extend(self.same(subject, "limit solimp", Num::JntSolimp, 5));
        }
        let at = address(Int::JntQposadr);
        let rest = at.map(|at| snapshot.number(Num::Qpos0, at));
        let spring = at.map(|at| snapshot.number(Num::QposSpring, at));
        let rests = [[sign * rest[0]], [rest[1]]];
        found.extend(self.compare(subject, "reference", Radians, &rests, None));
        let springs = [[sign * (spring[0] - rest[0]) + rest[1]], [spring[1]]];
        let spring_edit = Some((Num::QposSpring, at[1]));
        let name = "spring reference";
        found.extend(self.compare(subject, name, Radians, &springs, spring_edit));
    }

    /// Compares geoms, whose shapes are symmetric about the axes of their frames; of meshes and
    /// height fields, only the position of their centre.
    fn compare_geoms(&self, subject: Subject, mirror: &Mirror, found: &mut Vec<MirrorDifference>) {
        let (snapshot, pair) = (self.snapshot, subject.pair);
        let shape = snapshot.integer(Int::GeomType, pair[0]).cast_unsigned();
        let radii = pair.map(|geom| {
            let size = snapshot.vector(Num::GeomSize, geom);
            match shape {
                raw::mjGEOM_SPHERE => DVec3::splat(size.x),
                raw::mjGEOM_CAPSULE => DVec3::new(size.x, size.x, size.x + size.y),
                raw::mjGEOM_CYLINDER => DVec3::new(size.x, size.x, size.y),
                raw::mjGEOM_BOX | raw::mjGEOM_ELLIPSOID => size,
                raw::mjGEOM_PLANE => DVec3::Z,
                _ => DVec3::ONE,
            }
        });
        let sizes = pair.map(|geom| snapshot.vector(Num::GeomSize, geom).to_array());
        let sorted = radii.map(|radii| {
            let mut radii = radii.to_array();
            radii.sort_by(f64::total_cmp);
            radii
        });
        let rotations = pair.map(|geom| snapshot.rotation(Num::GeomQuat, geom));
        let size = self.compare(subject, "size", Share, &sorted, None);
        if let Some(size) = size {
            let edits = vec![row_edit(Num::GeomSize, pair[1], &sizes[0])];
            found.push(MirrorDifference { edits, ..size });
        } else {
            let [one, other] = [0, 1].map(|side| tensor(radii[side], rotations[side]));
            let values = [mirror.tensor(one), other].map(tensor_values);
            found.extend(self.compare(subject, "orientation", Scale, &values, None));
        }
        match shape {
            raw::mjGEOM_PLANE => {
                let points = pair.map(|geom| snapshot.vector(Num::GeomPos, geom));
                // a plane is the same anywhere in itself
                let height = (mirror.point(points[0]) - points[1]).dot(rotations[1] * DVec3::Z);
                let values = [[height], [0.0]];
                found.extend(self.compare(subject, "position", Metres, &values, None));
            }
            _ => found.extend(self.point(subject, "position", Num::GeomPos, mirror)),
        }
        for (property, array, width) in [
            ("friction", Num::GeomFriction, 3),
            ("solref", Num::GeomSolref, 2),
            ("solimp", Num::GeomSolimp, 5),
            ("margin", Num::GeomMargin, 1),
            ("gap", Num::GeomGap, 1),
            ("solmix", Num::GeomSolmix, 1),
        ] {
            found.extend(self.same(subject, property, array, width));
        }
        for (property, array) in [
            ("contype", Int::GeomContype),
            ("conaffinity", Int::GeomConaffinity),
            ("condim", Int::GeomCondim),
            ("priority", Int::GeomPriority),
        ] {
            found.extend(self.integers(subject, property, array));
        }
    }

    /// Compares sites and cameras. Axes of a site may be permuted and their signs changed; the
    /// image of a mirrored camera is flipped from left to right.
    fn compare_views(&self, subject: Subject, mirror: &Mirror, found: &mut Vec<MirrorDifference>) {
        let (position, orientation) = match subject.kind {
            ModelObjectKind::Site => (Num::SitePos, Num::SiteQuat),
            _ => (Num::CamPos, Num::CamQuat),
        };
        found.extend(self.point(subject, "position", position, mirror));
        let rotations = subject.pair.map(|index| self.snapshot.rotation(orientation, index));
        let [one, other] = rotations.map(DMat3::from_quat);
        let flip = match subject.kind {
            ModelObjectKind::Site => {
                (other.transpose() * mirror.turn * one).to_cols_array().map(f64::round)
            }
            _ => DMat3::from_diagonal(DVec3::new(-1.0, 1.0, 1.0)).to_cols_array(),
        };
        let flip = DMat3::from_cols_array(&flip);
        // a site that is nearly diagonal to its counterpart permits no comparison
        if flip.determinant() == -1.0 {
            let expected = DQuat::from_mat3(&(mirror.turn * one * flip.transpose()));
            found.extend(self.rotation(subject, expected, rotations[1], None));
        }
        if subject.kind == ModelObjectKind::Camera {
            found.extend(self.same(subject, "field of view", Num::CamFovy, 1));
        }
    }

    pub(crate) fn integers(
        &self,
        subject: Subject,
        property: &str,
        array: Int,
    ) -> Option<MirrorDifference> {
        let values = subject.pair.map(|row| [f64::from(self.snapshot.integer(array, row))]);
        self.compare(subject, property, Exact, &values, None)
    }

    /// Compares rows that mirroring does not change.
    pub(crate) fn same(
        &self,
        subject: Subject,
        property: &str,
        array: Num,
        width: usize,
    ) -> Option<MirrorDifference> {
        let values = subject.pair.map(|row| self.snapshot.row(array, row, width));
        self.compare(subject, property, Share, &values, Some((array, subject.pair[1])))
    }

    fn point(
        &self,
        subject: Subject,
        property: &str,
        array: Num,
        mirror: &Mirror,
    ) -> Option<MirrorDifference> {
        let [one, other] = subject.pair.map(|row| self.snapshot.vector(array, row));
        let values = [mirror.point(one), other].map(|point| point.to_array());
        self.compare(subject, property, Metres, &values, Some((array, subject.pair[1])))
    }

    fn rotation(
        &self,
        subject: Subject,
        image: DQuat,
        found: DQuat,
        edit: Option<(Num, usize)>,
    ) -> Option<MirrorDifference> {
        // a quaternion and its negative are one rotation
        let image = if image.dot(found) < 0.0 { -image } else { image };
        let values = [image, found].map(quat_values);
        self.compare(subject, "orientation", Radians, &values, edit)
    }

    /// Returns the difference between the mirror image of left values and right ones if it is above
    /// the tolerance.
    pub(crate) fn compare(
        &self,
        subject: Subject,
        property: &str,
        measure: DifferenceMeasure,
        [image, found]: &[impl AsRef<[f64]>; 2],
        edit: Option<(Num, usize)>,
    ) -> Option<MirrorDifference> {
        let (image, found) = (image.as_ref(), found.as_ref());
        let (amount, limit) = match measure {
            Exact => (f64::from(u8::from(image != found)), 0.5),
            Metres => (distance(image, found), self.tolerance * LENGTH_SCALE),
            // the elements of a quaternion are those of half the angle
            Radians if image.len() == 4 => (2.0 * distance(image, found), self.tolerance),
            Radians => (distance(image, found), self.tolerance),
            Share | Scale => (share(measure, image, found), self.tolerance),
        };
        let is_in_plane = subject.pair[0] == subject.pair[1];
        let expected: Vec<f64> = if is_in_plane && measure != Exact {
            image.iter().zip(found).map(|(a, b)| 0.5 * (a + b)).collect()
        } else {
            image.to_vec()
        };
        let edits = edit.map(|(array, row)| row_edit(array, row, &expected)).into_iter().collect();
        let found = found.to_vec();
        let difference = self.mismatch(subject, property);
        (amount > limit).then_some(MirrorDifference {
            expected,
            found,
            amount,
            measure,
            edits,
            ..difference
        })
    }

    /// Returns the difference of objects of which a property has no values that could be compared.
    pub(crate) fn mismatch(&self, subject: Subject, property: &str) -> MirrorDifference {
        let labels = subject.pair.map(|index| self.snapshot.object_label(subject.kind, index));
        MirrorDifference::mismatch(subject.kind, labels, property)
    }
}

/// Returns the limits of a mirrored coordinate.
pub(crate) fn mirrored_range([low, high]: [f64; 2], sign: f64) -> [f64; 2] {
    if sign < 0.0 { [-high, -low] } else { [low, high] }
}

pub(crate) fn row_edit(array: Num, row: usize, values: &[f64]) -> RowEdit {
    RowEdit { array, row, values: values.to_vec() }
}

fn tensor(moments: DVec3, axes: DQuat) -> DMat3 {
    let axes = DMat3::from_quat(axes);
    axes * DMat3::from_diagonal(moments) * axes.transpose()
}

/// Returns the elements xx, yy, zz, xy, xz, yz of a symmetric matrix, in MJCF's order.
fn tensor_values(tensor: DMat3) -> [f64; 6] {
    let [x, y, z] = tensor.to_cols_array_2d();
    [x[0], y[1], z[2], x[1], x[2], y[2]]
}

fn distance(one: &[f64], other: &[f64]) -> f64 {
    one.iter().zip(other).map(|(a, b)| (a - b).powi(2)).sum::<f64>().sqrt()
}

/// Returns the largest difference as a share of the larger element, or of the largest of all.
fn share(measure: DifferenceMeasure, one: &[f64], other: &[f64]) -> f64 {
    let elements = one.iter().zip(other);
    let largest =
        elements.clone().fold(ROUNDING, |most: f64, (a, b)| most.max(a.abs()).max(b.abs()));
    let shares = elements.map(|(a, b)| match measure {
        Share => (a - b).abs() / a.abs().max(b.abs()).max(ROUNDING),
        _ => (a - b).abs() / largest,
    });
    shares.fold(0.0, f64::max)
}
