//! Typed indices: a name is looked up once, when a model is loaded, and never again.

use std::fmt;
use std::marker::PhantomData;
use std::sync::atomic::{AtomicU64, Ordering};

use crate::raw;

/// Index of an object of kind `K` in the [`Model`](crate::Model) that gave it.
///
/// An id used with another model names another object, or panics where that model has fewer.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub struct Id<K> {
    index: usize,
    kind: PhantomData<K>,
}

/// Index of a body.
pub type BodyId = Id<Body>;
/// Index of a joint.
pub type JointId = Id<Joint>;
/// Index of a geom.
pub type GeomId = Id<Geom>;
/// Index of a site.
pub type SiteId = Id<Site>;
/// Index of a camera.
pub type CameraId = Id<Camera>;
/// Index of an actuator, and of its control.
pub type ActuatorId = Id<Actuator>;
/// Index of a mocap body among the mocap bodies.
pub type MocapId = Id<Mocap>;

impl<K> Id<K> {
    pub(crate) fn new(index: usize) -> Self {
        Self { index, kind: PhantomData }
    }

    /// Position in MuJoCo's arrays, from 0.
    pub fn index(self) -> usize {
        self.index
    }
}

impl<K: Kind> fmt::Debug for Id<K> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{} {}", K::NOUN, self.index)
    }
}

/// A kind of object that has ids. Implemented by the marker types of this module only.
pub trait Kind: sealed::Sealed {
    /// The word that MJCF uses.
    const NOUN: &'static str;
}

/// A kind of object that MuJoCo knows names of.
pub trait Named: Kind + sealed::Lookup {}

mod sealed {
    use crate::raw;

    pub trait Sealed {}

    pub trait Lookup {
        const OBJECT: raw::mjtObj;
        fn count(model: &raw::mjModel) -> i32;
    }
}

pub(crate) use sealed::Lookup;

/// Marks ids of bodies.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Body {}
/// Marks ids of joints.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Joint {}
/// Marks ids of geoms.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Geom {}
/// Marks ids of sites.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Site {}
/// Marks ids of cameras.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Camera {}
/// Marks ids of actuators.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Actuator {}
/// Marks ids of mocap bodies.
#[derive(Clone, Copy, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum Mocap {}

macro_rules! named_kind {
    ($kind:ty, $noun:literal, $object:ident, $count:ident) => {
        impl sealed::Sealed for $kind {}
        impl Kind for $kind {
            const NOUN: &'static str = $noun;
        }
        impl sealed::Lookup for $kind {
            const OBJECT: raw::mjtObj = raw::$object;
            fn count(model: &raw::mjModel) -> i32 {
                model.$count
            }
        }
        impl Named for $kind {}
    };
}

named_kind!(Body, "body", mjOBJ_BODY, nbody);
named_kind!(Joint, "joint", mjOBJ_JOINT, njnt);
named_kind!(Geom, "geom", mjOBJ_GEOM, ngeom);
named_kind!(Site, "site", mjOBJ_SITE, nsite);
named_kind!(Camera, "camera", mjOBJ_CAMERA, ncam);
named_kind!(Actuator, "actuator", mjOBJ_ACTUATOR, nu);

impl sealed::Sealed for Mocap {}
impl Kind for Mocap {
    const NOUN: &'static str = "mocap";
}

/// Tells the renderers of a process apart. It prints as `renderer 3 (64 x 48)`, width first.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct RendererId {
    number: u64,
    width: usize,
    height: usize,
}

impl RendererId {
    /// An id that no other renderer has, of images of this size in pixels.
    pub(crate) fn next(width: usize, height: usize) -> Self {
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
