//! Objects of a model: their names, owners and poses.

use std::fmt;

use glam::{DQuat, DVec3};
use mujoco::{IntegerArray, Model, NumberArray, raw};
use serde::{Deserialize, Serialize};

use crate::mirror::quat;

/// Declares [`ModelObjectKind`] from a table: each kind's name, its `mjtObj`, and the field of
/// `mjModel` with the number of such objects.
macro_rules! object_kinds {
    ($($kind:ident: $name:literal, $object:ident, $count:ident;)+) => {
        /// Kind of a model's objects that the check compares.
        #[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
        #[serde(rename_all = "lowercase")]
        #[allow(missing_docs)]
        pub enum ModelObjectKind {
            $($kind,)+
        }

        impl ModelObjectKind {
            pub(crate) const ALL: [Self; 10] = [$(Self::$kind),+];

            /// Returns the kind's name and its `mjtObj`.
            fn facts(self) -> (&'static str, raw::mjtObj) {
                match self {
                    $(Self::$kind => ($name, raw::$object),)+
                }
            }

            /// Returns the number of objects of this kind in a model.
            fn count_in(self, model: &raw::mjModel) -> usize {
                let count = match self {
                    $(Self::$kind => model.$count,)+
                };
                count as usize
            }
        }
    };
}

object_kinds! {
    Body: "body", mjOBJ_BODY, nbody;
    Joint: "joint", mjOBJ_JOINT, njnt;
    Geom: "geom", mjOBJ_GEOM, ngeom;
    Site: "site", mjOBJ_SITE, nsite;
    Camera: "camera", mjOBJ_CAMERA, ncam;
    Tendon: "tendon", mjOBJ_TENDON, ntendon;
    Equality: "equality", mjOBJ_EQUALITY, neq;
    Actuator: "actuator", mjOBJ_ACTUATOR, nu;
    Sensor: "sensor", mjOBJ_SENSOR, nsensor;
    Keyframe: "keyframe", mjOBJ_KEY, nkey;
}

impl ModelObjectKind {
    fn from_object_type(object: raw::mjtObj) -> Option<Self> {
        Self::ALL.into_iter().find(|kind| kind.facts().1 == object)
    }
}

impl fmt::Display for ModelObjectKind {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(self.facts().0)
    }
}

/// Model with the poses of its bodies in the configuration `qpos0`.
pub(crate) struct PosedModel<'a> {
    pub model: &'a Model,
    /// Position and orientation of each body in the world.
    frames: Vec<(DVec3, DQuat)>,
    /// Largest distance of a body from the mean of all (metres).
    pub extent: f64,
}

impl<'a> PosedModel<'a> {
    pub fn new(model: &'a Model) -> Self {
        let mut snapshot =
            Self { model, frames: vec![(DVec3::ZERO, DQuat::IDENTITY)], extent: 0.0 };
        for body in 1..model.nbody() {
            // a body comes after its parent
            let (origin, turn) = snapshot.frames[snapshot.parent(body)];
            let position = snapshot.vector(NumberArray::BodyPos, body);
            let rotation = snapshot.rotation(NumberArray::BodyQuat, body);
            snapshot.frames.push((origin + turn * position, turn * rotation));
        }
        let points: Vec<DVec3> = (0..model.nbody())
            .map(|body| snapshot.object_position(ModelObjectKind::Body, body))
            .collect();
        let mean = points.iter().sum::<DVec3>() / points.len() as f64;
        let distances = points.iter().map(|point| point.distance(mean));
        snapshot.extent = distances.fold(0.01, f64::max);
        snapshot
    }

    pub fn count(&self, kind: ModelObjectKind) -> usize {
        kind.count_in(self.model.as_raw())
    }

    pub fn row(&self, array: NumberArray, row: usize, width: usize) -> &'a [f64] {
        &self.model.numbers(array)[row * width..][..width]
    }

    pub fn number(&self, array: NumberArray, row: usize) -> f64 {
        self.model.numbers(array)[row]
    }

    pub fn vector(&self, array: NumberArray, row: usize) -> DVec3 {
        DVec3::from_slice(self.row(array, row, 3))
    }

    pub fn rotation(&self, array: NumberArray, row: usize) -> DQuat {
        quat(self.row(array, row, 4)).normalize()
    }

    pub fn integer(&self, array: IntegerArray, index: usize) -> i32 {
        self.model.integer(array, index)
    }

    pub fn index(&self, array: IntegerArray, index: usize) -> usize {
        usize::try_from(self.integer(array, index)).unwrap_or(usize::MAX)
    }

    pub fn parent(&self, body: usize) -> usize {
        self.index(IntegerArray::BodyParentid, body)
    }

    pub fn name(&self, kind: ModelObjectKind, index: usize) -> Option<&'a str> {
        self.model.object_name(kind.facts().1, index)
    }

    /// Returns the name of an object in reports: without one in the model, its number and body.
    pub fn object_label(&self, kind: ModelObjectKind, index: usize) -> String {
        match (self.name(kind, index), self.body_of_object(kind, index)) {
            (Some(name), _) => name.to_owned(),
            (None, Some(body)) if kind != ModelObjectKind::Body => {
                format!("{index} of {}", self.object_label(ModelObjectKind::Body, body))
            }
            (None, _) => index.to_string(),
        }
    }

    /// Returns the body that an object belongs to, or that the first object belongs to that it
    /// connects, moves or observes; `None` for keyframes, and for actuators and sensors of the whole
    /// model.
    pub fn body_of_object(&self, kind: ModelObjectKind, index: usize) -> Option<usize> {
        let array = match kind {
            ModelObjectKind::Body => return Some(index),
            ModelObjectKind::Joint => IntegerArray::JntBodyid,
            ModelObjectKind::Geom => IntegerArray::GeomBodyid,
            ModelObjectKind::Site => IntegerArray::SiteBodyid,
            ModelObjectKind::Camera => IntegerArray::CamBodyid,
            ModelObjectKind::Actuator | ModelObjectKind::Sensor => {
                let (kind, target) = self.target_object(kind, index)?;
                return self.body_of_object(kind, target);
            }
            ModelObjectKind::Tendon => {
                let (of, target) = self.tendon_points(index).next()?;
                return self.body_of_object(of, target);
            }
            ModelObjectKind::Equality => {
                let (of, target) = self.connected_objects(index)[0]?;
                return self.body_of_object(of, target);
            }
            ModelObjectKind::Keyframe => return None,
        };
        Some(self.index(array, index))
    }

    /// Returns the object that an actuator acts on or a sensor observes; `None` for a target that
    /// is not compared, such as a flex.
    pub fn target_object(
        &self,
        kind: ModelObjectKind,
        index: usize,
    ) -> Option<(ModelObjectKind, usize)> {
        if kind == ModelObjectKind::Sensor {
            let object = self.integer(IntegerArray::SensorObjtype, index).cast_unsigned();
            let object = if object == raw::mjOBJ_XBODY { raw::mjOBJ_BODY } else { object };
            let target = ModelObjectKind::from_object_type(object)?;
            return Some((target, self.index(IntegerArray::SensorObjid, index)));
        }
        let target = match self.integer(IntegerArray::ActuatorTrntype, index).cast_unsigned() {
            raw::mjTRN_JOINT | raw::mjTRN_JOINTINPARENT => ModelObjectKind::Joint,
            raw::mjTRN_SITE | raw::mjTRN_SLIDERCRANK => ModelObjectKind::Site,
            raw::mjTRN_BODY => ModelObjectKind::Body,
            raw::mjTRN_TENDON => ModelObjectKind::Tendon,
            _ => return None,
        };
        Some((target, self.index(IntegerArray::ActuatorTrnid, 2 * index)))
    }

    /// Returns the objects that an equality constraint connects; `None` for the second where there
    /// is one alone, and for both if they are of a kind that is not compared.
    pub fn connected_objects(&self, equality: usize) -> [Option<(ModelObjectKind, usize)>; 2] {
        let kind = ModelObjectKind::from_object_type(self.model.equality_object_type(equality));
        [IntegerArray::EqObj1id, IntegerArray::EqObj2id].map(|array| {
            let object = usize::try_from(self.integer(array, equality)).ok()?;
            Some((kind?, object))
        })
    }

    /// Returns the data of an equality constraint, a row of `eq_data`.
    pub fn equality_data(&self, equality: usize) -> &'a [f64] {
        self.row(NumberArray::EqData, equality, raw::mjNEQDATA as usize)
    }

    /// Returns the point at which an equality constraint holds its first body, in that body's frame.
    fn anchor(&self, equality: usize) -> DVec3 {
        let is_weld =
            self.integer(IntegerArray::EqType, equality).cast_unsigned() == raw::mjEQ_WELD;
        // a weld has the anchor in the second body's frame first
        DVec3::from_slice(&self.equality_data(equality)[if is_weld { 3 } else { 0 }..])
    }

    /// Returns the path of a tendon: the index in `wrap_prm`, the type and the object of each of
    /// its points.
    pub fn tendon_path(
        &self,
        tendon: usize,
    ) -> impl DoubleEndedIterator<Item = (usize, raw::mjtWrap, usize)> {
        let start = self.index(IntegerArray::TendonAdr, tendon);
        (start..start + self.index(IntegerArray::TendonNum, tendon)).map(|at| {
            let shape = self.integer(IntegerArray::WrapType, at).cast_unsigned();
            (at, shape, self.index(IntegerArray::WrapObjid, at))
        })
    }

    /// Returns the joints or sites of a tendon.
    fn tendon_points(&self, tendon: usize) -> impl Iterator<Item = (ModelObjectKind, usize)> {
        self.tendon_path(tendon).filter_map(|(_, shape, object)| match shape {
            raw::mjWRAP_JOINT => Some((ModelObjectKind::Joint, object)),
            raw::mjWRAP_SITE => Some((ModelObjectKind::Site, object)),
            _ => None,
        })
    }

    /// Returns the position of an object in the world: for bodies, of their centre of mass, for
    /// tendons, the mean of their points, for equality constraints, their anchor or first object,
    /// for actuators and sensors, their target, and for keyframes the origin.
    pub fn object_position(&self, kind: ModelObjectKind, index: usize) -> DVec3 {
        let array = match kind {
            ModelObjectKind::Body => NumberArray::BodyIpos,
            ModelObjectKind::Joint => NumberArray::JntPos,
            ModelObjectKind::Geom => NumberArray::GeomPos,
            ModelObjectKind::Site => NumberArray::SitePos,
            ModelObjectKind::Camera => NumberArray::CamPos,
            ModelObjectKind::Tendon => {
                let points = self.tendon_points(index).map(|(of, at)| self.object_position(of, at));
                let points: Vec<DVec3> = points.collect();
                return points.iter().sum::<DVec3>() / points.len().max(1) as f64;
            }
            ModelObjectKind::Equality => {
                return match self.connected_objects(index)[0] {
                    Some((ModelObjectKind::Body, body)) => {
                        let (origin, turn) = self.frames[body];
                        origin + turn * self.anchor(index)
                    }
                    Some((of, at)) => self.object_position(of, at),
                    None => DVec3::ZERO,
                };
            }
            ModelObjectKind::Actuator | ModelObjectKind::Sensor => {
                let target = self.target_object(kind, index);
                return target.map_or(DVec3::ZERO, |(of, at)| self.object_position(of, at));
            }
            ModelObjectKind::Keyframe => return DVec3::ZERO,
        };
        let (origin, turn) = self.frames[self.body_of_object(kind, index).unwrap_or(0)];
        origin + turn * self.vector(array, index)
    }

    /// Returns position and orientation of a body's frame in the world.
    pub fn body_frame(&self, body: usize) -> (DVec3, DQuat) {
        self.frames[body]
    }

    /// Returns the axis of a joint in the world.
    pub fn joint_axis(&self, joint: usize) -> DVec3 {
        let (_, turn) = self.frames[self.index(IntegerArray::JntBodyid, joint)];
        turn * self.vector(NumberArray::JntAxis, joint)
    }

    pub fn joint_type(&self, joint: usize) -> raw::mjtJoint {
        self.integer(IntegerArray::JntType, joint).cast_unsigned()
    }

    /// Returns `true` for joints with one position: hinges and slides.
    pub fn is_scalar_joint(&self, joint: usize) -> bool {
        matches!(self.joint_type(joint), raw::mjJNT_HINGE | raw::mjJNT_SLIDE)
    }

    /// Returns `true` if a geom can collide with others or bends a tendon, `false` if it is only
    /// drawn.
    pub fn geom_collides_or_bends_tendon(&self, geom: usize) -> bool {
        let mask = |array| self.integer(array, geom) != 0;
        let pairs = 0..self.model.as_raw().npair as usize;
        let bends = |(_, shape, object)| {
            [raw::mjWRAP_SPHERE, raw::mjWRAP_CYLINDER].contains(&shape) && object == geom
        };
        mask(IntegerArray::GeomContype)
            || mask(IntegerArray::GeomConaffinity)
            || pairs.into_iter().any(|pair| {
                [IntegerArray::PairGeom1, IntegerArray::PairGeom2]
                    .into_iter()
                    .any(|array| self.index(array, pair) == geom)
            })
            || (0..self.count(ModelObjectKind::Tendon))
                .any(|tendon| self.tendon_path(tendon).any(bends))
    }
}
