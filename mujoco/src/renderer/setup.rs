//! Initialisation of MuJoCo's structs for rendering.

use std::mem::MaybeUninit;

use super::{FreeCamera, RenderOptions};
use crate::ids::CameraId;
use crate::model::Model;
use crate::raw;

/// Creates MuJoCo's rendering context, with an off-screen buffer of `width` x `height` pixels.
pub(super) fn make_drawing(
    model: &Model,
    width: usize,
    height: usize,
    options: &RenderOptions,
) -> Box<raw::mjrContext> {
    // buffer sizes are read from the model, which is shared, so a shallow copy is altered
    let mut copy = *model.as_raw();
    copy.vis.global.offwidth = width as i32;
    copy.vis.global.offheight = height as i32;
    copy.vis.quality.offsamples = 0;
    if !options.shadows {
        copy.vis.quality.shadowsize = 0;
    }
    let mut drawing = Box::new(MaybeUninit::uninit());
    // SAFETY: `mjr_defaultContext` fills the struct in; the copy's pointers are the model's, alive
    // and only read; an OpenGL context with the features MuJoCo needs is current.
    unsafe {
        raw::mjr_defaultContext(drawing.as_mut_ptr());
        raw::mjr_makeContext(
            &raw const copy,
            drawing.as_mut_ptr(),
            raw::mjFONTSCALE_100.cast_signed(),
        );
        raw::mjr_setBuffer(raw::mjFB_OFFSCREEN.cast_signed(), drawing.as_mut_ptr());
        drawing.assume_init()
    }
}

pub(super) fn make_scene(model: &Model, options: &RenderOptions) -> Box<raw::mjvScene> {
    let sizes = model.as_raw();
    // one per geom and site, one per piece of tendon, and one more: a full scene counts as an
    // overflow
    let max_geoms = (sizes.ngeom + sizes.nsite + sizes.nskin + 2 * sizes.nwrap + 1) as usize;
    let mut scene = Box::new(MaybeUninit::uninit());
    // SAFETY: `mjv_defaultScene` fills the struct in; live model and positive size.
    let mut scene: Box<raw::mjvScene> = unsafe {
        raw::mjv_defaultScene(scene.as_mut_ptr());
        raw::mjv_makeScene(model.as_raw(), scene.as_mut_ptr(), max_geoms as i32);
        scene.assume_init()
    };
    scene.flags.fill(0);
    scene.flags[raw::mjRND_CULL_FACE as usize] = 1;
    scene.flags[raw::mjRND_SHADOW as usize] = options.shadows.into();
    scene
}

pub(super) fn visible(options: &RenderOptions) -> Box<raw::mjvOption> {
    let mut visible = Box::new(MaybeUninit::uninit());
    // SAFETY: `mjv_defaultOption` fills the struct in.
    let mut visible: Box<raw::mjvOption> = unsafe {
        raw::mjv_defaultOption(visible.as_mut_ptr());
        visible.assume_init()
    };
    visible.geomgroup = options.visible_geom_groups.map(u8::from);
    visible.sitegroup = options.visible_site_groups.map(u8::from);
    visible.flags.fill(0);
    for flag in [raw::mjVIS_TEXTURE, raw::mjVIS_TENDON, raw::mjVIS_STATIC, raw::mjVIS_SKIN] {
        visible.flags[flag as usize] = 1;
    }
    visible
}

/// Returns a free camera, MuJoCo's default.
fn default_camera() -> raw::mjvCamera {
    let mut view = MaybeUninit::uninit();
    // SAFETY: `mjv_defaultCamera` fills the struct in.
    unsafe {
        raw::mjv_defaultCamera(view.as_mut_ptr());
        view.assume_init()
    }
}

pub(super) fn free_camera(camera: &FreeCamera) -> raw::mjvCamera {
    raw::mjvCamera {
        lookat: camera.target,
        distance: camera.distance,
        azimuth: camera.azimuth.to_degrees(),
        elevation: camera.elevation.to_degrees(),
        ..default_camera()
    }
}

pub(super) fn fixed_camera(camera: CameraId) -> raw::mjvCamera {
    let mut view = default_camera();
    view.type_ = raw::mjCAMERA_FIXED.cast_signed();
    view.fixedcamid = camera.index() as i32;
    view
}
