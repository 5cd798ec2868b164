//! Drawing through OSMesa, in a program of its own since a process can use one OpenGL library only.

#![allow(clippy::unwrap_used, reason = "test code")]

mod support;

use std::ffi::c_void;
use std::ptr;
use std::sync::Arc;

use libloading::os::unix::{Library, RTLD_LOCAL, RTLD_NOW, Symbol};
use mujoco::{
    Data, Model, OpenGlBackend, OpenGlContextError, RenderError, RenderOptions, Renderer,
};

const OSMESA: [OpenGlBackend; 1] = [OpenGlBackend::OsMesa];

#[test]
fn rows_and_columns_are_where_they_belong_and_mirrored_scenes_give_mirror_images() {
    support::check_pictures(&OSMESA);
}

#[test]
fn egl_is_refused_once_osmesa_draws() {
    let model = Arc::new(Model::from_xml("<mujoco><worldbody/></mujoco>").unwrap());
    let new = |backends: &[OpenGlBackend]| {
        Renderer::with_backends(model.clone(), 8, 8, RenderOptions::default(), backends)
    };
    let first = new(&OSMESA).unwrap();
    assert_eq!(first.backend(), OpenGlBackend::OsMesa);
    let Err(RenderError::NoContext { tried }) = new(&[OpenGlBackend::EglSurfaceless]) else {
        panic!("two OpenGL libraries in one process");
    };
    let in_use = "libOSMesa.so.8".into();
    assert_eq!(tried[0].1, OpenGlContextError::LibraryInUse { in_use });
}

type Raw = *mut c_void;
type Create = unsafe extern "C" fn(u32, Raw) -> Raw;
type MakeCurrent = unsafe extern "C" fn(Raw, Raw, u32, i32, i32) -> u8;
type GetCurrent = unsafe extern "C" fn() -> Raw;
type GetBuffer = unsafe extern "C" fn(Raw, *mut i32, *mut i32, *mut i32, *mut Raw) -> u8;
type Destroy = unsafe extern "C" fn(Raw);

const OSMESA_RGBA: u32 = 0x1908;
const GL_UNSIGNED_BYTE: u32 = 0x1401;

/// Functions of OSMesa that the embedding program calls.
struct Program {
    create: Symbol<Create>,
    make_current: Symbol<MakeCurrent>,
    get_current: Symbol<GetCurrent>,
    get_buffer: Symbol<GetBuffer>,
    destroy: Symbol<Destroy>,
}

impl Program {
    fn new() -> Self {
        // SAFETY: loading OSMesa runs no initialisers with preconditions, and its header declares
        // these functions with these signatures.
        unsafe {
            let library = Library::open(Some("libOSMesa.so.8"), RTLD_NOW | RTLD_LOCAL).unwrap();
            Self {
                create: library.get(b"OSMesaCreateContext\0").unwrap(),
                make_current: library.get(b"OSMesaMakeCurrent\0").unwrap(),
                get_current: library.get(b"OSMesaGetCurrentContext\0").unwrap(),
                get_buffer: library.get(b"OSMesaGetColorBuffer\0").unwrap(),
                destroy: library.get(b"OSMesaDestroyContext\0").unwrap(),
            }
        }
    }
}

/// Two contexts of the embedding program, with buffers of their own.
#[test]
fn the_programs_context_is_current_again_after_every_call() {
    let program = Program::new();
    let xml = r#"<mujoco><worldbody><camera name="top" pos="0 0 2"/></worldbody></mujoco>"#;
    let model = Arc::new(Model::from_xml(xml).unwrap());
    let camera = model.camera("top").unwrap();
    let mut data = Data::new(Arc::clone(&model));
    data.forward().unwrap();
    for (width, height) in [(3, 2), (2, 5)] {
        let mut pixels = vec![0_u8; 4 * 16];
        let buffer: Raw = pixels.as_mut_ptr().cast();
        // SAFETY: valid format, no context to share with; the buffer holds the pixels and outlives
        // the context.
        let context = unsafe {
            let context = (program.create)(OSMESA_RGBA, ptr::null_mut());
            assert_ne!((program.make_current)(context, buffer, GL_UNSIGNED_BYTE, width, height), 0);
            context
        };
        let assert_current = |after| {
            let (mut got, mut format, mut at) = ([0, 0], 0, ptr::null_mut());
            let [w, h] = &mut got;
            // SAFETY: live context; each pointer is to a local variable.
            let current = unsafe {
                (program.get_buffer)(context, w, h, &raw mut format, &raw mut at);
                (program.get_current)()
            };
            assert_eq!(current, context, "after {after}");
            assert_eq!((got, at), ([width, height], buffer), "after {after}");
        };
        let options = RenderOptions::default();
        let renderer = Renderer::with_backends(Arc::clone(&model), 6, 4, options, &OSMESA);
        assert_current("making a renderer");
        let mut renderer = renderer.unwrap();
        let mut image = vec![0; renderer.image_len()];
        renderer.render(&mut data, camera, &mut image).unwrap();
        assert_current("drawing");
        drop(renderer);
        assert_current("dropping a renderer");
        // SAFETY: the context is released from this thread first, and not used afterwards.
        unsafe {
            (program.make_current)(ptr::null_mut(), ptr::null_mut(), 0, 0, 0);
            (program.destroy)(context);
        }
    }
}
