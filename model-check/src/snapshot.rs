//! Objects of a model: their names, owners and poses.

use std::fmt;

use glam::{DQuat, DVec3};
use mujoco::{IntegerArray, Model, NumberArray, raw};
use serde::{Deserialize, Serialize};

use crate::mirror::quat;

/// Kind of a model's objects that the check compares.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
#[allow(missing_docs)]
pub enum Kind {
    Body,
    Joint,
    Geom,
    Site,
    Camera,
    Actuator,
    Sensor,
    Keyframe,
}

impl Kind {
    pub(crate) const ALL: [Self; 8] = [
        Self::Body,
        Self::Joint,
        Self::Geom,
        Self::Site,
        Self::Camera,
        Self::Actuator,
        Self::Sensor,
        Self::Keyframe,
    ];

    /// Returns the kind's name and its `mjtObj`.
    fn facts(self) -> (&'static str, raw::mjtObj) {
        match self {
            Self::Body => ("body", raw::mjOBJ_BODY),
            Self::Joint => ("joint", raw::mjOBJ_JOINT),
            Self::Geom => ("geom", raw::mjOBJ_GEOM),
            Self::Site => ("site", raw::mjOBJ_SITE),
            Self::Camera => ("camera", raw::mjOBJ_CAMERA),
            Self::Actuator => ("actuator", raw::mjOBJ_ACTUATOR),
            Self::Sensor => ("sensor", raw::mjOBJ_SENSOR),
            Self::Keyframe => ("keyframe", raw::mjOBJ_KEY),
        }
    }
}

impl fmt::Display for Kind {
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
        let points: Vec<DVec3> =
            (0..model.nbody()).map(|body| snapshot.position(Kind::Body, body)).collect();
        let mean = points.iter().sum::<DVec3>() / points.len() as f64;
        let distances = points.iter().map(|point| point.distance(mean));
        snapshot.extent = distances.fold(0.01, f64::max);
        snapshot
    }

    pub fn count(&self, kind: Kind) -> usize {
        let raw = self.model.as_raw();
        let count = match kind {
            Kind::Body => raw.nbody,
            Kind::Joint => raw.njnt,
            Kind::Geom => raw.ngeom,
            Kind::Site => raw.nsite,
            Kind::Camera => raw.ncam,
            Kind::Actuator => raw.nu,
            Kind::Sensor => raw.nsensor,
            Kind::Keyframe => raw.nkey,
        };
        count as usize
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

    pub fn name(&self, kind: Kind, index: usize) -> Option<&'a str> {
        self.model.object_name(kind.facts().1, index)
    }

    /// Returns the name of an object in reports: without one in the model, its number and body.
    pub fn label(&self, kind: Kind, index: usize) -> String {
        match (self.name(kind, index), self.body(kind, index)) {
            (Some(name), _) => name.to_owned(),
            (None, Some(body)) if kind != Kind::Body => {
                format!("{index} of {}", self.label(Kind::Body, body))
            }
            (None, _) => index.to_string(),
        }
    }

    /// Returns the body that an object belongs to; `None` for keyframes, and for actuators and
    /// sensors of the whole model.
    pub fn body(&self, kind: Kind, index: usize) -> Option<usize> {
        let array = match kind {
            Kind::Body => return Some(index),
            Kind::Joint => IntegerArray::JntBodyid,
            Kind::Geom => IntegerArray::GeomBodyid,
            Kind::Site => IntegerArray::SiteBodyid,
            Kind::Camera => IntegerArray::CamBodyid,
            Kind::Actuator | Kind::Sensor => {
                let (kind, target) = self.target(kind, index)?;
                return self.body(kind, target);
            }
            Kind::Keyframe => return None,
        };
        Some(self.index(array, index))
    }

    /// Returns the object that an actuator acts on or a sensor observes; `None` for a target that
    /// is not compared, such as a tendon.
    pub fn target(&self, kind: Kind, index: usize) -> Option<(Kind, usize)> {
        if kind == Kind::Sensor {
            let object = self.integer(IntegerArray::SensorObjtype, index).cast_unsigned();
            let object = if object == raw::mjOBJ_XBODY { raw::mjOBJ_BODY } else { object };
            let target = Kind::ALL.into_iter().find(|target| target.facts().1 == object)?;
            return Some((target, self.index(IntegerArray::SensorObjid, index)));
        }
        let target = match self.integer(IntegerArray::ActuatorTrntype, index).cast_unsigned() {
            raw::mjTRN_JOINT | raw::mjTRN_JOINTINPARENT => Kind::Joint,
            raw::mjTRN_SITE => Kind::Site,
            raw::mjTRN_BODY => Kind::Body,
            _ => return None,
        };
        Some((target, self.index(IntegerArray::ActuatorTrnid, 2 * index)))
    }

    /// Returns the position of an object in the world; for bodies, of their centre of mass, and for
    /// objects without position, of their body's.
    pub fn position(&self, kind: Kind, index: usize) -> DVec3 {
        let array = match kind {
            Kind::Body => NumberArray::BodyIpos,
            Kind::Joint => NumberArray::JntPos,
            Kind::Geom => NumberArray::GeomPos,
            Kind::Site => NumberArray::SitePos,
            Kind::Camera => NumberArray::CamPos,
            Kind::Actuator | Kind::Sensor | Kind::Keyframe => {
                let body = self.body(kind, index).unwrap_or(0);
                return self.frames[body].0;
            }
        };
        let (origin, turn) = self.frames[self.body(kind, index).unwrap_or(0)];
        origin + turn * self.vector(array, index)
    }

    /// Returns position and orientation of a body's frame in the world.
    pub fn frame(&self, body: usize) -> (DVec3, DQuat) {
        self.frames[body]
    }

    /// Returns the axis of a joint in the world.
    pub fn axis(&self, joint: usize) -> DVec3 {
        let (_, turn) = self.frames[self.index(IntegerArray::JntBodyid, joint)];
        turn * self.vector(NumberArray::JntAxis, joint)
    }

    pub fn joint_type(&self, joint: usize) -> raw::mjtJoint {
        self.integer(IntegerArray::JntType, joint).cast_unsigned()
    }

    /// Returns `true` for joints with one position: hinges and slides.
    pub fn is_scalar(&self, joint: usize) -> bool {
        matches!(self.joint_type(joint), raw::mjJNT_HINGE | raw::mjJNT_SLIDE)
    }

    /// Returns `true` if a geom can collide with others, `false` if it is only drawn.
    pub fn collides(&self, geom: usize) -> bool {
        let mask = |array| self.integer(array, geom) != 0;
        let pairs = 0..self.model.as_raw().npair as usize;
        mask(IntegerArray::GeomContype)
            || mask(IntegerArray::GeomConaffinity)
            || pairs.into_iter().any(|pair| {
                [IntegerArray::PairGeom1, IntegerArray::PairGeom2]
                    .into_iter()
                    .any(|array| self.index(array, pair) == geom)
            })
    }
}
