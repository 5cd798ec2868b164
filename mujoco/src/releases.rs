//! Differences between the releases of MuJoCo that this crate is built with: 2.2.2 and 3.

use std::ffi::CStr;

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

/// Returns a release as text, for instance `2.2.2` for 222 and `3.17.0` for 3017000, as
/// `mj_version()` counts them.
pub(crate) fn format_version(version: i32) -> String {
    let base = if version < 100_000 { 10 } else { 1000 };
    format!("{}.{}.{}", version / (base * base), version / base % base, version % base)
}

/// Adds a file with a copy of `content`, of `size` bytes, to `files`. Returns MuJoCo's status: 0, or
/// 2 for a name that was added before.
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
/// 2 for a name that was added before.
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
#[cfg(not(actuator_counts))]
pub(crate) fn actuators_are_scalar(_model: &raw::mjModel) -> bool {
    true
}

/// Returns `true` if every actuator has one control and one output, as in releases without counts of
/// these. Lengths of arrays rely on it.
#[cfg(actuator_counts)]
pub(crate) fn actuators_are_scalar(model: &raw::mjModel) -> bool {
    [model.nactuator, model.nout] == [model.nu; 2]
}

/// Lets collisions be searched without the trees of bounding volumes, which releases 3 compile for
/// the geoms of each body and which do not fit geoms that were moved since.
#[cfg(not(mujoco3))]
pub(crate) fn ignore_bounding_volumes(_model: &mut raw::mjModel) {}

/// Lets collisions be searched without the trees of bounding volumes, which releases 3 compile for
/// the geoms of each body and which do not fit geoms that were moved since.
#[cfg(mujoco3)]
pub(crate) fn ignore_bounding_volumes(model: &mut raw::mjModel) {
    model.opt.disableflags |= raw::mjDSBL_MIDPHASE.cast_signed();
}

/// Returns `true` if the last update of `scene` lacked room for all geoms, and forgets it.
#[cfg(not(mujoco3))]
pub(crate) fn take_scene_overflow(_scene: &mut raw::mjvScene, data: &mut raw::mjData) -> bool {
    std::mem::take(&mut data.warning[raw::mjWARN_VGEOMFULL as usize].number) > 0
}

/// Returns `true` if the last update of `scene` may have lacked room for all geoms. Releases 3 tell
/// it in different ways; a full scene is one in all of them.
#[cfg(mujoco3)]
pub(crate) fn take_scene_overflow(scene: &mut raw::mjvScene, _data: &mut raw::mjData) -> bool {
    scene.ngeom >= scene.maxgeom
}

/// Returns `true` if a geom of `model` has a texture.
#[cfg(not(mujoco3))]
pub(crate) fn is_textured(geom: &raw::mjvGeom, _model: &raw::mjModel) -> bool {
    geom.texid >= 0
}

/// Returns `true` if a geom of `model` has a texture.
#[cfg(mujoco3)]
pub(crate) fn is_textured(geom: &raw::mjvGeom, model: &raw::mjModel) -> bool {
    let Some(material) = usize::try_from(geom.matid).ok().filter(|&m| m < model.nmat as usize)
    else {
        return false;
    };
    let roles = raw::mjNTEXROLE as usize;
    // SAFETY: `mat_texid` is `[nmat, mjNTEXROLE]`, by `mjxmacro.h`, and the material is one of them.
    let textures =
        unsafe { std::slice::from_raw_parts(model.mat_texid.add(material * roles), roles) };
    textures.iter().any(|&texture| texture >= 0)
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn releases_are_written_with_points() {
        for (number, text) in [(222, "2.2.2"), (327, "3.2.7"), (3_017_000, "3.17.0")] {
            assert_eq!(format_version(number), text);
        }
    }
}
