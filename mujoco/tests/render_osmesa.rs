//! Drawing through OSMesa. A program of its own: a process can use one OpenGL library.

mod support;

use std::sync::Arc;

use mujoco::{Backend, Model, RenderError, RenderOptions, Renderer};

const OSMESA: [Backend; 1] = [Backend::OsMesa];

#[test]
fn rows_and_columns_are_where_they_belong() {
    support::check_orientation(&OSMESA);
}

#[test]
fn mirrored_scenes_give_mirror_images() {
    support::check_mirrored_scenes(&OSMESA);
}

#[test]
fn egl_is_refused_once_osmesa_draws() {
    let model = Arc::new(Model::from_xml("<mujoco><worldbody/></mujoco>").unwrap());
    let new = |backends: &[Backend]| {
        Renderer::with_backends(model.clone(), 8, 8, RenderOptions::default(), backends)
    };
    let first = new(&OSMESA).unwrap();
    assert_eq!(first.backend(), Backend::OsMesa);
    let Err(RenderError::NoContext { tried }) = new(&[Backend::EglSurfaceless]) else {
        panic!("two OpenGL libraries in one process");
    };
    assert!(tried[0].1.contains("libOSMesa"), "{tried:?}");
}
