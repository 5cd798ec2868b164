//! Differences between the releases of MuJoCo that this crate is built with: 2.2.2, and 3.2 or
//! later.
//!
//! Those in types and lengths of arrays are allowed for by the tests of `arrays` and `fields`.

use std::ffi::CStr;

#[cfg(not(mujoco3))]
use crate::fields::model::{BODY_SIMPLE, DOF_SIMPLENUM};
#[cfg(mujoco3)]
use crate::fields::model::{BODY_SIMPLE, EQ_OBJTYPE, MAT_TEXID};
use crate::raw;

/// Length of a name of a file in memory (bytes, with its NUL) that every release has room for.
pub(crate) const MAX_NAME_LEN: usize = 1000;

#[cfg(not(mujoco3))]
const _: () = assert!(MAX_NAME_LEN <= raw::mjMAXVFSNAME as usize);

#[cfg(mujoco3)]
const _: () = assert!(raw::mjNTEXROLE == 10, "the length of MAT_TEXID's rows");

/// Adds a file with a copy of `content`, of `size` bytes, to `files`. Returns MuJoCo's status: 0, or
/// another number if the file was not added (2 for a name that was added before).
#[cfg(not(mujoco3))]
pub(crate) fn add_buffer(files: &mut raw::mjVFS, name: &CStr, content: &[u8], size: i32) -> i32 {
    // SAFETY: live mjVFS, NUL-terminated name shorter than mjMAXVFSNAME, positive size.
    let status = unsafe { raw::mj_makeEmptyFileVFS(files, name.as_ptr(), size) };
    if status == 0 {
        let slot = files.filedata[files.nfile as usize - 1].cast::<u8>();
        // SAFETY: MuJoCo has just allocated `size` bytes, the length of `content`, for the last
        // file; `content` is no part of them.
        unsafe { std::ptr::copy_nonoverlapping(content.as_ptr(), slot, content.len()) };
    }
    status
}

/// Adds a file with a copy of `content`, of `size` bytes, to `files`. Returns MuJoCo's status: 0, or
/// another number if the file was not added (2 for a name that was added before).
#[cfg(mujoco3)]
pub(crate) fn add_buffer(files: &mut raw::mjVFS, name: &CStr, content: &[u8], size: i32) -> i32 {
    // SAFETY: live mjVFS, NUL-terminated name; MuJoCo copies `size` bytes, the length of `content`.
    unsafe { raw::mj_addBufferVFS(files, name.as_ptr(), content.as_ptr().cast(), size) }
}

/// Returns the largest numbers of contacts and of constraints, and the attributes of `<size>` that
/// set them.
#[cfg(not(mujoco3))]
pub(crate) fn buffer_limits(model: &raw::mjModel) -> [(usize, &'static str); 2] {
    [(model.nconmax as usize, "nconmax"), (model.njmax as usize, "njmax")]
}

/// Returns the memory (bytes) for contacts and for constraints, and the attributes of `<size>` that
/// set it.
#[cfg(mujoco3)]
pub(crate) fn buffer_limits(model: &raw::mjModel) -> [(usize, &'static str); 2] {
    [(model.narena as usize, "memory"); 2]
}

/// Returns `true` if every actuator has one control and one output, as in releases without counts of
/// these. Lengths of arrays rely on it.
///
/// # Safety
/// MuJoCo must have made the model.
#[cfg(not(actuator_counts))]
pub(crate) unsafe fn actuators_are_scalar(_model: &raw::mjModel) -> bool {
    true
}

/// Returns `true` if every actuator has one control and one output, as in releases without counts of
/// these. Lengths of arrays rely on it.
///
/// # Safety
/// MuJoCo must have made the model.
#[cfg(actuator_counts)]
pub(crate) unsafe fn actuators_are_scalar(model: &raw::mjModel) -> bool {
    use crate::fields::model::{ACTUATOR_CTRLNUM, ACTUATOR_OUTNUM};

    // the two arrays are as long as supposed here only where the totals agree
    [model.nactuator, model.nout] == [model.nu; 2]
        && [&ACTUATOR_CTRLNUM, &ACTUATOR_OUTNUM].iter().all(|counts| {
            // SAFETY: the caller's promise, and the totals agree.
            unsafe { counts.rows(model, model) }.iter().all(|count| *count == [1])
        })
}

/// Lets collisions be searched without the trees of bounding volumes that 2.2.2 does not have.
#[cfg(not(mujoco3))]
pub(crate) fn disable_bounding_volumes(_model: &mut raw::mjModel) {}

/// Lets collisions be searched without the trees of bounding volumes that 2.2.2 does not have. They
/// fit no geoms that were moved since, and bring contacts of mirrored geoms in another order.
#[cfg(mujoco3)]
pub(crate) fn disable_bounding_volumes(model: &mut raw::mjModel) {
    model.opt.disableflags |= raw::mjDSBL_MIDPHASE.cast_signed();
}

/// Returns the type of the objects that a constraint holds at a point or in a pose.
///
/// # Safety
/// MuJoCo must have made the model.
#[cfg(not(mujoco3))]
pub(crate) unsafe fn held_object_type(_model: &raw::mjModel, _equality: usize) -> raw::mjtObj {
    raw::mjOBJ_BODY
}

/// Returns the type of the objects that a constraint holds at a point or in a pose.
///
/// # Safety
/// MuJoCo must have made the model.
#[cfg(mujoco3)]
pub(crate) unsafe fn held_object_type(model: &raw::mjModel, equality: usize) -> raw::mjtObj {
    // SAFETY: the caller's promise.
    let [object] = unsafe { EQ_OBJTYPE.rows(model, model) }[equality];
    object.cast_unsigned()
}

/// Returns `true` if the layout of the inertia matrix relies on the frames of `body` and its joints,
/// as they were compiled.
///
/// # Safety
/// MuJoCo must have made the model.
#[cfg(not(mujoco3))]
pub(crate) unsafe fn has_fixed_inertia_frame(_model: &raw::mjModel, _body: usize) -> bool {
    false
}

/// Returns `true` if the layout of the inertia matrix relies on the frames of `body` and its joints,
/// as they were compiled.
///
/// # Safety
/// MuJoCo must have made the model.
#[cfg(mujoco3)]
pub(crate) unsafe fn has_fixed_inertia_frame(model: &raw::mjModel, body: usize) -> bool {
    // SAFETY: the caller's promise.
    let simple = unsafe { BODY_SIMPLE.rows(model, model) };
    simple[body] != [0]
}

/// Clears the flags by which MuJoCo takes the inertia of a body for diagonal, where the layout of
/// the inertia matrix does not rely on them.
///
/// # Safety
/// MuJoCo must have made the model, and nobody may read or write its arrays meanwhile.
#[cfg(not(mujoco3))]
pub(crate) unsafe fn forget_diagonal_inertia(model: &mut raw::mjModel) {
    // SAFETY: the caller's promise.
    unsafe {
        BODY_SIMPLE.own_rows_mut(model).fill([0]);
        DOF_SIMPLENUM.own_rows_mut(model).fill([0]);
    }
}

/// Clears the flags by which MuJoCo takes the inertia of a body for diagonal, where the layout of
/// the inertia matrix does not rely on them.
///
/// # Safety
/// MuJoCo must have made the model, and nobody may read or write its arrays meanwhile.
#[cfg(mujoco3)]
pub(crate) unsafe fn forget_diagonal_inertia(_model: &mut raw::mjModel) {}

/// Returns `true` if the last update of `scene` lacked room for all geoms, and forgets it.
#[cfg(not(mujoco3))]
pub(crate) fn take_scene_overflow(_scene: &mut raw::mjvScene, data: &mut raw::mjData) -> bool {
    std::mem::take(&mut data.warning[raw::mjWARN_VGEOMFULL as usize].number) > 0
}

/// Returns `true` if the last update of `scene` may have lacked room for all geoms: releases tell it
/// in different ways, but the scene is full in all of them.
#[cfg(mujoco3)]
pub(crate) fn take_scene_overflow(scene: &mut raw::mjvScene, _data: &mut raw::mjData) -> bool {
    scene.ngeom >= scene.maxgeom
}

/// Returns `true` if a geom of `model` has a texture.
///
/// # Safety
/// MuJoCo must have made the model.
#[cfg(not(mujoco3))]
pub(crate) unsafe fn is_textured(geom: &raw::mjvGeom, _model: &raw::mjModel) -> bool {
    geom.texid >= 0
}

/// Returns `true` if a geom of `model` has a texture.
///
/// # Safety
/// MuJoCo must have made the model.
#[cfg(mujoco3)]
pub(crate) unsafe fn is_textured(geom: &raw::mjvGeom, model: &raw::mjModel) -> bool {
    // SAFETY: the caller's promise.
    let textures = unsafe { MAT_TEXID.rows(model, model) };
    let own = usize::try_from(geom.matid).ok().and_then(|material| textures.get(material));
    own.is_some_and(|roles| roles.iter().any(|&texture| texture >= 0))
}
