//! Typed indices of a model's objects: a name is looked up once, when a model is loaded.

use std::fmt;
use std::marker::PhantomData;
use std::sync::atomic::{AtomicU64, Ordering};

use crate::raw;

/// Index of an object of kind `K` in the [`Model`](crate::Model) that gave it.
///
/// An id used with another model refers to another object, or panics if that model has fewer.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Id<K> {
    index: usize,
    kind: PhantomData<K>,
}

/// Index of a body in its model.
pub type BodyId = Id<BodyIdMarker>;
/// Index of a joint in its model.
pub type JointId = Id<JointIdMarker>;
/// Index of a geom in its model.
pub type GeomId = Id<GeomIdMarker>;
/// Index of a site in its model.
pub type SiteId = Id<SiteIdMarker>;
/// Index of a camera in its model.
pub type CameraId = Id<CameraIdMarker>;
/// Index of an actuator, and of its control, in its model.
pub type ActuatorId = Id<ActuatorIdMarker>;
/// Index of a mocap body among the mocap bodies of its model.
pub type MocapId = Id<MocapIdMarker>;

impl<K> Id<K> {
    pub(crate) fn new(index: usize) -> Self {
        Self { index, kind: PhantomData }
    }

    /// Returns the index of the object in MuJoCo's arrays, from 0.
    pub fn index(self) -> usize {
        self.index
    }
}

impl<K: ObjectKind> fmt::Debug for Id<K> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}", K::MJCF_NAME, self.index)
    }
}

/// Kind of MuJoCo object that has ids. Only the marker types of this module implement it.
pub trait ObjectKind: sealed::Sealed {
    /// Name of the kind of object in MJCF, such as `body`.
    const MJCF_NAME: &'static str;
}

/// Kind of MuJoCo object with names of its own: all but mocap bodies, which have those of bodies.
pub trait NamedObjectKind: ObjectKind + sealed::Lookup {}

mod sealed {
    use crate::raw;

    pub trait Sealed {}

    pub trait Lookup {
        const OBJECT: raw::mjtObj;
        fn count(model: &raw::mjModel) -> usize;
    }
}

pub(crate) use sealed::Lookup;

/// Marker type of the ids of bodies.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum BodyIdMarker {}
/// Marker type of the ids of joints.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum JointIdMarker {}
/// Marker type of the ids of geoms.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum GeomIdMarker {}
/// Marker type of the ids of sites.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum SiteIdMarker {}
/// Marker type of the ids of cameras.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum CameraIdMarker {}
/// Marker type of the ids of actuators.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum ActuatorIdMarker {}
/// Marker type of the ids of mocap bodies.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum MocapIdMarker {}

macro_rules! named_kind {
    ($kind:ty, $noun:literal, $object:ident, $count:ident) => {
        impl sealed::Sealed for $kind {}
        impl ObjectKind for $kind {
            const MJCF_NAME: &'static str = $noun;
        }
        impl sealed::Lookup for $kind {
            const OBJECT: raw::mjtObj = raw::$object;
            fn count(model: &raw::mjModel) -> usize {
                model.$count as usize
            }
        }
        impl NamedObjectKind for $kind {}
    };
}

named_kind!(BodyIdMarker, "body", mjOBJ_BODY, nbody);
named_kind!(JointIdMarker, "joint", mjOBJ_JOINT, njnt);
named_kind!(GeomIdMarker, "geom", mjOBJ_GEOM, ngeom);
named_kind!(SiteIdMarker, "site", mjOBJ_SITE, nsite);
named_kind!(CameraIdMarker, "camera", mjOBJ_CAMERA, ncam);
named_kind!(ActuatorIdMarker, "actuator", mjOBJ_ACTUATOR, nu);

impl sealed::Sealed for MocapIdMarker {}
impl ObjectKind for MocapIdMarker {
    const MJCF_NAME: &'static str = "mocap";
}

/// Unique id of a renderer in this process, printed as `renderer 3 (64 x 48)` with the width first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct RendererId {
    number: u64,
    width: usize,
    height: usize,
}

impl RendererId {
    /// Creates an id that no other renderer has, for images of this size in pixels.
    pub(crate) fn new_unique(width: usize, height: usize) -> Self {
        static NEXT: AtomicU64 = AtomicU64::new(0);
        Self { number: NEXT.fetch_add(1, Ordering::Relaxed), width, height }
    }
}

impl fmt::Display for RendererId {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (width, height) = (self.width, self.height);
        write!(f, "renderer {} ({width} x {height})", self.number)
    }
}
