//! Arrays of `mjModel` and `mjData`, each with the length that MuJoCo gave it.
//!
//! The constants below are the only place where a pointer meets its length. Code that reads through
//! them cannot choose another element type, width or length.

use std::slice;

use crate::raw;

/// Pointer to the first element of an array of MuJoCo. Releases declare some arrays of bytes with
/// another type of equal size.
pub(crate) trait ArrayStart<T> {
    /// Returns the pointer as one to elements of type `T`.
    fn elements(self) -> *mut T;
}

macro_rules! same_elements {
    ($($element:ty),+) => {
        $(impl ArrayStart<$element> for *mut $element {
            fn elements(self) -> *mut $element {
                self
            }
        })+
    };
}

same_elements!(f64, f32, i32, u8);

/// Flags of recent releases, which are 0 or 1 as those of earlier ones.
impl ArrayStart<u8> for *mut bool {
    fn elements(self) -> *mut u8 {
        self.cast()
    }
}

/// Array `[count, N]` of elements `T` in the C struct `S`, where the model determines `count`.
pub(crate) struct ArrayField<S, T, const N: usize> {
    start: fn(&S) -> *mut T,
    count: fn(&raw::mjModel) -> usize,
}

impl<S, T, const N: usize> ArrayField<S, T, N> {
    /// Describes an array by its start in `S` and its number of rows in a model.
    ///
    /// # Safety
    /// In every `S` that MuJoCo makes for a model, `start` must be the address of an array of
    /// `count * N` initialised elements that lives as long as the `S`, or `count` must be 0.
    const unsafe fn new(start: fn(&S) -> *mut T, count: fn(&raw::mjModel) -> usize) -> Self {
        Self { start, count }
    }

    fn len(&self, model: &raw::mjModel) -> usize {
        (self.count)(model)
    }

    /// Returns the rows of this array in `owner`, which belongs to `model`.
    ///
    /// # Safety
    /// MuJoCo must have made `owner` for `model`, and nobody may write to the array while the
    /// result lives.
    pub(crate) unsafe fn rows<'a>(&self, owner: &'a S, model: &raw::mjModel) -> &'a [[T; N]] {
        match self.len(model) {
            // nothing is promised about the pointer of an empty array
            0 => &[],
            // SAFETY: what `new` asks for, and the caller's promise.
            len => unsafe { slice::from_raw_parts((self.start)(owner).cast(), len) },
        }
    }

    /// Returns the rows of this array in `owner`, which belongs to `model`, for writing.
    ///
    /// # Safety
    /// MuJoCo must have made `owner` for `model`, and nobody may read or write the array while the
    /// result lives.
    pub(crate) unsafe fn rows_mut<'a>(
        &self,
        owner: &'a mut S,
        model: &raw::mjModel,
    ) -> &'a mut [[T; N]] {
        match self.len(model) {
            0 => &mut [],
            // SAFETY: what `new` asks for, and the caller's promise.
            len => unsafe { slice::from_raw_parts_mut((self.start)(owner).cast(), len) },
        }
    }
}

impl<T, const N: usize> ArrayField<raw::mjModel, T, N> {
    /// Returns the rows of this array in `model` itself, for writing.
    ///
    /// # Safety
    /// MuJoCo must have made `model`, and nobody may read or write the array while the result
    /// lives.
    pub(crate) unsafe fn own_rows_mut<'a>(&self, model: &'a mut raw::mjModel) -> &'a mut [[T; N]] {
        match self.len(model) {
            0 => &mut [],
            // SAFETY: what `new` asks for, and the caller's promise.
            len => unsafe { slice::from_raw_parts_mut((self.start)(model).cast(), len) },
        }
    }
}

/// Declares constants of type [`ArrayField`], and a table of them for the test of their lengths in
/// `arrays.rs`.
macro_rules! fields {
    (
        $owner:ident:
        $($(#[$condition:meta])* $name:ident = $field:ident: [$kind:ty; $count:ident, $width:literal],)*
    ) => {
        use super::{ArrayField, ArrayStart};
        use crate::raw;

        $(
            $(#[$condition])*
            pub(crate) const $name: ArrayField<raw::$owner, $kind, $width> = {
                // SAFETY: `mjxmacro.h`, which MuJoCo allocates by, gives the array these lengths,
                // and MuJoCo fills it before it hands the struct out.
                unsafe { ArrayField::new(|owner| owner.$field.elements(), |model| model.$count as usize) }
            };
        )*

        #[cfg(test)]
        pub(crate) const TABLE: &[[&str; 4]] = &[
            $(
                $(#[$condition])*
                [stringify!($kind), stringify!($field), stringify!($count), stringify!($width)]
            ),*
        ];
    };
}

/// Arrays of `mjModel`, one [`ArrayField`] each.
pub(crate) mod model {
    fields! { mjModel:
        #[cfg(actuator_counts)]
        ACTUATOR_CTRLNUM = actuator_ctrlnum: [i32; nu, 1],
        #[cfg(actuator_counts)]
        ACTUATOR_OUTNUM = actuator_outnum: [i32; nu, 1],
        BODY_IPOS = body_ipos: [f64; nbody, 3],
        BODY_IQUAT = body_iquat: [f64; nbody, 4],
        BODY_MOCAPID = body_mocapid: [i32; nbody, 1],
        BODY_PARENTID = body_parentid: [i32; nbody, 1],
        BODY_POS = body_pos: [f64; nbody, 3],
        BODY_QUAT = body_quat: [f64; nbody, 4],
        BODY_SAMEFRAME = body_sameframe: [u8; nbody, 1],
        BODY_SIMPLE = body_simple: [u8; nbody, 1],
        CAM_BODYID = cam_bodyid: [i32; ncam, 1],
        #[cfg(not(mujoco3))]
        DOF_SIMPLENUM = dof_simplenum: [i32; nv, 1],
        EQ_OBJ1ID = eq_obj1id: [i32; neq, 1],
        EQ_OBJ2ID = eq_obj2id: [i32; neq, 1],
        #[cfg(mujoco3)]
        EQ_OBJTYPE = eq_objtype: [i32; neq, 1],
        EQ_TYPE = eq_type: [i32; neq, 1],
        GEOM_BODYID = geom_bodyid: [i32; ngeom, 1],
        GEOM_CONAFFINITY = geom_conaffinity: [i32; ngeom, 1],
        GEOM_CONTYPE = geom_contype: [i32; ngeom, 1],
        GEOM_GROUP = geom_group: [i32; ngeom, 1],
        GEOM_POS = geom_pos: [f64; ngeom, 3],
        GEOM_QUAT = geom_quat: [f64; ngeom, 4],
        GEOM_RGBA = geom_rgba: [f32; ngeom, 4],
        GEOM_SAMEFRAME = geom_sameframe: [u8; ngeom, 1],
        GEOM_SIZE = geom_size: [f64; ngeom, 3],
        GEOM_TYPE = geom_type: [i32; ngeom, 1],
        JNT_AXIS = jnt_axis: [f64; njnt, 3],
        JNT_BODYID = jnt_bodyid: [i32; njnt, 1],
        JNT_DOFADR = jnt_dofadr: [i32; njnt, 1],
        JNT_LIMITED = jnt_limited: [u8; njnt, 1],
        JNT_POS = jnt_pos: [f64; njnt, 3],
        JNT_QPOSADR = jnt_qposadr: [i32; njnt, 1],
        JNT_RANGE = jnt_range: [f64; njnt, 2],
        JNT_TYPE = jnt_type: [i32; njnt, 1],
        LIGHT_BODYID = light_bodyid: [i32; nlight, 1],
        #[cfg(mujoco3)]
        MAT_TEXID = mat_texid: [i32; nmat, 10],
        QPOS_SPRING = qpos_spring: [f64; nq, 1],
        QPOS0 = qpos0: [f64; nq, 1],
        SITE_BODYID = site_bodyid: [i32; nsite, 1],
        SITE_POS = site_pos: [f64; nsite, 3],
        SITE_QUAT = site_quat: [f64; nsite, 4],
        SITE_SAMEFRAME = site_sameframe: [u8; nsite, 1],
    }
}

/// Arrays of `mjData`, one [`ArrayField`] each.
pub(crate) mod data {
    fields! { mjData:
        ACT = act: [f64; na, 1],
        ACTUATOR_FORCE = actuator_force: [f64; nu, 1],
        CTRL = ctrl: [f64; nu, 1],
        GEOM_XMAT = geom_xmat: [f64; ngeom, 9],
        GEOM_XPOS = geom_xpos: [f64; ngeom, 3],
        MOCAP_POS = mocap_pos: [f64; nmocap, 3],
        MOCAP_QUAT = mocap_quat: [f64; nmocap, 4],
        QACC = qacc: [f64; nv, 1],
        QACC_WARMSTART = qacc_warmstart: [f64; nv, 1],
        QFRC_APPLIED = qfrc_applied: [f64; nv, 1],
        QPOS = qpos: [f64; nq, 1],
        QVEL = qvel: [f64; nv, 1],
        SITE_XPOS = site_xpos: [f64; nsite, 3],
        USERDATA = userdata: [f64; nuserdata, 1],
        XFRC_APPLIED = xfrc_applied: [f64; nbody, 6],
        XPOS = xpos: [f64; nbody, 3],
        XQUAT = xquat: [f64; nbody, 4],
    }
}
