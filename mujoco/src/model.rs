//! `mjModel`: the simulated model, immutable and shared.

use std::ffi::CString;
use std::ptr::NonNull;
use std::sync::Arc;

use crate::error::ModelError;
use crate::fields::ArrayField;
use crate::fields::model::{
    BODY_MOCAPID, GEOM_BODYID, GEOM_CONAFFINITY, GEOM_CONTYPE, GEOM_GROUP, GEOM_RGBA, GEOM_SIZE,
    GEOM_TYPE, JNT_BODYID, JNT_DOFADR, JNT_LIMITED, JNT_QPOSADR, JNT_RANGE, JNT_TYPE,
};
use crate::ids::{
    ActuatorIdMarker, BodyId, BodyIdMarker, CameraIdMarker, GeomId, GeomIdMarker, Id, JointId,
    JointIdMarker, Lookup, MocapId, NamedObjectKind, SiteIdMarker,
};
use crate::load::{check_file_references, load};
use crate::{raw, releases};

/// Declares methods that return sizes of the C struct `mjModel`.
macro_rules! sizes {
    ($($(#[$doc:meta])* $size:ident,)+) => {
        $(
            $(#[$doc])*
            pub fn $size(&self) -> usize {
                self.as_raw().$size as usize
            }
        )+
    };
}

/// Declares methods that find MuJoCo objects of a kind by name.
macro_rules! finders {
    ($($(#[$doc:meta])* $find:ident: $kind:ident,)+) => {
        $(
            $(#[$doc])*
            ///
            /// # Errors
            /// [`ModelError::UnknownName`] lists the names that exist.
            pub fn $find(&self, name: &str) -> Result<Id<$kind>, ModelError> {
                self.find::<$kind>(name)
            }
        )+
    };
}

/// Compiled MuJoCo model, which simulations and renderers share. Immutable; share it through `Arc`
/// between [`Data`](crate::Data) and [`Renderer`](crate::Renderer) of any number of threads.
///
/// # Panics
/// An id belongs to the model that returned it. Methods that take an id panic if it comes from a
/// larger model.
pub struct Model {
    raw: NonNull<raw::mjModel>,
    warning: Option<String>,
    /// Shared by a model and its reflections.
    family: Arc<()>,
}

// SAFETY: nothing writes to an mjModel once it is in a `Model`: `from_files` and the methods that
// return an altered copy write before that, and later MuJoCo takes it as `const mjModel*`.
unsafe impl Send for Model {}
// SAFETY: as above; concurrent reads of memory that nobody writes.
unsafe impl Sync for Model {}

impl Model {
    /// Compiles MJCF given as one string.
    ///
    /// # Errors
    /// [`ModelError::LoadFailed`] with MuJoCo's own message; [`ModelError::VersionMismatch`] if the
    /// library has another version than the header.
    pub fn from_xml(xml: &str) -> Result<Self, ModelError> {
        Self::from_files("model.xml", &[("model.xml", xml.as_bytes())])
    }

    /// Compiles the MJCF (or URDF) file `main`, one of `files` (names and contents).
    ///
    /// Included files, meshes and textures are looked up among `files` by their plain names,
    /// whatever their folder. The disk is not read, except by MuJoCo 3 for included files that are
    /// missing. With MuJoCo 3 the flag `midphase` is off, whatever the XML says.
    ///
    /// # Errors
    /// Errors of [`Model::from_xml`]. [`ModelError::NoMainFile`] if `main` is not among `files`;
    /// [`ModelError::InvalidFileSize`] for an empty or huge file; [`ModelError::InvalidFileName`]
    /// for a name with a folder, and for a path inside the XML that would lead out of `files`: an
    /// absolute one, or one in an absolute folder, of a file that is not given.
    pub fn from_files(main: &str, files: &[(&str, &[u8])]) -> Result<Self, ModelError> {
        let (mut raw, warning) = load(main, files)?;
        // SAFETY: nobody else holds the model yet.
        releases::disable_bounding_volumes(unsafe { raw.as_mut() });
        let model = Self { raw, warning, family: Arc::new(()) };
        // SAFETY: MuJoCo made the model.
        if !unsafe { releases::actuators_are_scalar(model.as_raw()) } {
            return Err(ModelError::VectorActuators { file: main.into() });
        }
        Ok(model)
    }

    /// Wraps `raw`, a copy of this model with other values, as a model of its own.
    pub(crate) fn relative(&self, raw: NonNull<raw::mjModel>) -> Self {
        Self { raw, warning: self.warning.clone(), family: Arc::new(()) }
    }

    /// Wraps `raw`, a copy of this model with mirrored poses, as a model for the same renderers.
    pub(crate) fn reflection(&self, raw: NonNull<raw::mjModel>) -> Self {
        let mut model = self.relative(raw);
        model.family = Arc::clone(&self.family);
        model
    }

    /// Returns `true` if both are one model, or copies of one with mirrored poses.
    pub(crate) fn is_of_family(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.family, &other.family)
    }

    /// Checks the name of the model file `main` and the paths inside the XML, as
    /// [`Model::from_files`] does, without compiling.
    ///
    /// # Errors
    /// [`ModelError::NoMainFile`], and [`ModelError::InvalidFileName`] for `main` and for a path
    /// inside the XML, as in [`Model::from_files`].
    pub fn check_file_references(main: &str, files: &[(&str, &[u8])]) -> Result<(), ModelError> {
        check_file_references(main, files).map(|_| ())
    }

    /// Returns MuJoCo's warning during compilation, if any.
    pub fn compile_warning(&self) -> Option<&str> {
        self.warning.as_deref()
    }

    sizes! {
        /// Returns the number of generalised positions, the length of `qpos`.
        nq,
        /// Returns the number of degrees of freedom, the length of `qvel`.
        nv,
        /// Returns the number of actuators, the length of `ctrl`.
        nu,
        /// Returns the number of mocap bodies of the model.
        nmocap,
        /// Returns the number of bodies of the model, including the world.
        nbody,
        /// Returns the number of geoms of the model.
        ngeom,
    }

    /// Returns the simulated duration of a physics step, in seconds.
    pub fn timestep(&self) -> f64 {
        self.as_raw().opt.timestep
    }

    finders! {
        /// Returns the id of the body called `name`.
        body: BodyIdMarker,
        /// Returns the id of the joint called `name`.
        joint: JointIdMarker,
        /// Returns the id of the geom called `name`.
        geom: GeomIdMarker,
        /// Returns the id of the site called `name`.
        site: SiteIdMarker,
        /// Returns the id of the camera called `name`.
        camera: CameraIdMarker,
        /// Returns the id of the actuator called `name`.
        actuator: ActuatorIdMarker,
    }

    /// Returns the id of the mocap body called `name`.
    ///
    /// # Errors
    /// [`ModelError::UnknownName`]; [`ModelError::NotMocapBody`] if the body is an ordinary one.
    pub fn mocap_body(&self, name: &str) -> Result<MocapId, ModelError> {
        let body = self.body(name)?;
        let index = self.mocap_index(body);
        index.map(Id::new).ok_or_else(|| ModelError::NotMocapBody {
            name: name.into(),
            known: self.mocap_names(),
        })
    }

    /// Returns the name of an object; `None` if the XML gives none.
    pub fn name_of<K: NamedObjectKind>(&self, id: Id<K>) -> Option<&str> {
        self.object_name(K::OBJECT, id.index())
    }

    /// Lists the bodies, joints, geoms, sites, cameras and actuators without a name, for instance
    /// `geom 3`.
    pub fn unnamed_objects(&self) -> Vec<String> {
        let kinds = [
            self.unnamed_of::<BodyIdMarker>(),
            self.unnamed_of::<JointIdMarker>(),
            self.unnamed_of::<GeomIdMarker>(),
            self.unnamed_of::<SiteIdMarker>(),
            self.unnamed_of::<CameraIdMarker>(),
            self.unnamed_of::<ActuatorIdMarker>(),
        ];
        kinds.concat()
    }

    /// Returns the type of a joint.
    pub fn joint_type(&self, joint: JointId) -> JointType {
        JointType::from_raw(self.value(&JNT_TYPE, joint))
    }

    /// Returns the index of a joint's first element in `qpos`.
    pub fn joint_qpos_address(&self, joint: JointId) -> usize {
        self.value(&JNT_QPOSADR, joint) as usize
    }

    /// Returns the index of a joint's first element in `qvel`.
    pub fn joint_dof_address(&self, joint: JointId) -> usize {
        self.value(&JNT_DOFADR, joint) as usize
    }

    /// Returns the body that a joint moves.
    pub fn joint_body(&self, joint: JointId) -> BodyId {
        Id::new(self.value(&JNT_BODYID, joint) as usize)
    }

    /// Returns the lower and upper limit of a joint, in metres or radians; `None` if it is not
    /// limited.
    pub fn joint_range(&self, joint: JointId) -> Option<[f64; 2]> {
        let limited = self.value(&JNT_LIMITED, joint) != 0;
        limited.then(|| self.rows(&JNT_RANGE)[joint.index()])
    }

    /// Returns the body that a geom is fixed to.
    pub fn geom_body(&self, geom: GeomId) -> BodyId {
        Id::new(self.value(&GEOM_BODYID, geom) as usize)
    }

    /// Returns the ids of all geoms, in the model's order.
    pub fn geoms(&self) -> impl Iterator<Item = GeomId> {
        (0..self.ngeom()).map(Id::new)
    }

    /// Returns the shape of a geom, whose axis, if any, is the z axis of its frame. `None` for
    /// planes, ellipsoids, meshes and height fields.
    pub fn geom_shape(&self, geom: GeomId) -> Option<GeomShape> {
        let [x, y, z] = self.geom_size(geom);
        let kind = self.value(&GEOM_TYPE, geom);
        match kind.cast_unsigned() {
            raw::mjGEOM_SPHERE => Some(GeomShape::Sphere { radius: x }),
            raw::mjGEOM_CAPSULE => Some(GeomShape::Capsule { radius: x, half_length: y }),
            raw::mjGEOM_CYLINDER => Some(GeomShape::Cylinder { radius: x, half_length: y }),
            raw::mjGEOM_BOX => Some(GeomShape::Box { half: [x, y, z] }),
            _ => None,
        }
    }

    /// Returns the geom group (0 to 5) of a geom; [`RenderOptions`](crate::RenderOptions) shows and
    /// hides groups.
    pub fn geom_group(&self, geom: GeomId) -> usize {
        self.value(&GEOM_GROUP, geom) as usize
    }

    /// Returns the colour of a geom, (red, green, blue, opacity) in [0, 1]. The colour of a
    /// material is not included.
    pub fn geom_rgba(&self, geom: GeomId) -> [f32; 4] {
        self.rows(&GEOM_RGBA)[geom.index()]
    }

    /// Returns the size of a geom in metres; the meaning of the three numbers depends on its type.
    pub fn geom_size(&self, geom: GeomId) -> [f64; 3] {
        self.rows(&GEOM_SIZE)[geom.index()]
    }

    /// Returns the collision masks of a geom: (contype, conaffinity). With (0, 0) it collides only
    /// in an explicit `<pair>`.
    pub fn geom_collision_masks(&self, geom: GeomId) -> (i32, i32) {
        (self.value(&GEOM_CONTYPE, geom), self.value(&GEOM_CONAFFINITY, geom))
    }

    /// Returns MuJoCo's `mjModel`, for reading fields without a method, and for functions that take
    /// a `const mjModel*`.
    ///
    /// Plain fields can be read directly. Arrays are pointers, and reading through one is `unsafe`:
    /// `mjmodel.h` documents the number of elements. Writing through one is never allowed, since
    /// threads share models.
    pub fn as_raw(&self) -> &raw::mjModel {
        // SAFETY: the pointer is valid until `drop`, and nobody writes to the model.
        unsafe { self.raw.as_ref() }
    }

    fn find<K: NamedObjectKind>(&self, name: &str) -> Result<Id<K>, ModelError> {
        self.index_of::<K>(name).map(Id::new).ok_or_else(|| ModelError::UnknownName {
            kind: K::MJCF_NAME,
            name: name.into(),
            known: self.names::<K>().map(Into::into).collect(),
        })
    }

    fn index_of<K: NamedObjectKind>(&self, name: &str) -> Option<usize> {
        // the empty name would match the first object that has none
        let c_name = CString::new(name).ok().filter(|name| !name.is_empty())?;
        // SAFETY: live model and NUL-terminated name; MuJoCo returns -1 where it finds nothing.
        let index =
            unsafe { raw::mj_name2id(self.as_raw(), K::OBJECT.cast_signed(), c_name.as_ptr()) };
        usize::try_from(index).ok()
    }

    fn names<K: NamedObjectKind>(&self) -> impl Iterator<Item = &str> {
        let count = <K as Lookup>::count(self.as_raw());
        (0..count).filter_map(|index| self.name_of(Id::<K>::new(index)))
    }

    fn unnamed_of<K: NamedObjectKind>(&self) -> Vec<String> {
        (0..<K as Lookup>::count(self.as_raw()))
            .filter(|&index| self.name_of(Id::<K>::new(index)).is_none())
            .map(|index| format!("{} {index}", K::MJCF_NAME))
            .collect()
    }

    fn mocap_index(&self, body: BodyId) -> Option<usize> {
        usize::try_from(self.value(&BODY_MOCAPID, body)).ok()
    }

    fn mocap_names(&self) -> Vec<String> {
        let bodies =
            (0..self.nbody()).map(Id::new).filter(|&body| self.mocap_index(body).is_some());
        bodies.filter_map(|body| self.name_of(body).map(Into::into)).collect()
    }

    pub(crate) fn rows<T, const N: usize>(
        &self,
        field: &ArrayField<raw::mjModel, T, N>,
    ) -> &[[T; N]] {
        // SAFETY: MuJoCo made the model, and nobody writes to it.
        unsafe { field.rows(self.as_raw(), self.as_raw()) }
    }

    fn value<T: Copy, K>(&self, field: &ArrayField<raw::mjModel, T, 1>, id: Id<K>) -> T {
        self.rows(field)[id.index()][0]
    }
}

impl Drop for Model {
    fn drop(&mut self) {
        // SAFETY: MuJoCo allocated it, and every `Data` and `Renderer` holds an `Arc` of us.
        unsafe { raw::mj_deleteModel(self.raw.as_ptr()) };
    }
}

impl std::fmt::Debug for Model {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        let mut debug = f.debug_struct("Model");
        debug.field("nq", &self.nq()).field("nv", &self.nv()).field("nu", &self.nu());
        debug
            .field("nmocap", &self.nmocap())
            .field("nbody", &self.nbody())
            .field("ngeom", &self.ngeom());
        debug.finish()
    }
}

/// Type of a joint, by the motion that it permits.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum JointType {
    /// Free joint: position (3) and orientation (4) of a body in the world.
    Free,
    /// Ball joint: orientation (4) of a body about a point.
    Ball,
    /// Sliding joint: displacement (metres) along an axis.
    Slide,
    /// Hinge: angle (radians) about an axis.
    Hinge,
}

impl JointType {
    /// Converts a value of MuJoCo's `mjtJoint`, which has four.
    pub(crate) fn from_raw(value: i32) -> Self {
        match value.cast_unsigned() {
            raw::mjJNT_FREE => Self::Free,
            raw::mjJNT_BALL => Self::Ball,
            raw::mjJNT_SLIDE => Self::Slide,
            _ => Self::Hinge,
        }
    }
}

/// Shape of a geom, in its own frame, in metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum GeomShape {
    /// Sphere around the origin of the geom's frame.
    Sphere {
        /// Radius of the sphere (metres).
        radius: f64,
    },
    /// Capsule: a cylinder along z with a hemisphere on either end.
    Capsule {
        /// Radius of cylinder and hemispheres (metres).
        radius: f64,
        /// Half the length of the cylinder (metres), without the hemispheres.
        half_length: f64,
    },
    /// Cylinder along the z axis of the geom's frame.
    Cylinder {
        /// Radius of the cylinder (metres).
        radius: f64,
        /// Half the length of the cylinder (metres).
        half_length: f64,
    },
    /// Box with sides along the axes of the geom's frame.
    Box {
        /// Half the extent of the box along x, y and z (metres).
        half: [f64; 3],
    },
}
