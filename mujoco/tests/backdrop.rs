//! Drawing over a backdrop: its renderer, and recovery from OpenGL errors.

#![allow(clippy::unwrap_used, reason = "test code")]

use std::ffi::c_void;
use std::mem;
use std::sync::Arc;

use khronos_egl as egl;
use mujoco::{
    CameraId, Data, Model, OpenGlBackend, RenderError, RenderOptions, Renderer, StaticBackdrop,
};

const BACKENDS: [OpenGlBackend; 1] = [OpenGlBackend::EglSurfaceless];
const SCENE: &str = r#"<worldbody>
    <camera name="top" pos="0 0 2"/>
    <geom type="box" size=".6 .3 .1" rgba="0 1 0 1"/>
    <body pos="-.3 0 .4"><joint type="slide" axis="1 0 0"/><geom size=".2" rgba="1 0 0 1"/></body>
  </worldbody>"#;

fn renderer(model: &Arc<Model>, width: usize, height: usize) -> Renderer {
    renderer_with(model, width, height, RenderOptions::default())
}

fn renderer_with(
    model: &Arc<Model>,
    width: usize,
    height: usize,
    options: RenderOptions,
) -> Renderer {
    Renderer::with_backends(Arc::clone(model), width, height, options, &BACKENDS).unwrap()
}

fn simulation() -> Data {
    simulation_of(SCENE)
}

fn simulation_of(scene: &str) -> Data {
    let model = Model::from_xml(&format!("<mujoco>{scene}</mujoco>")).unwrap();
    let mut data = Data::new(Arc::new(model));
    data.forward().unwrap();
    data
}

/// Moves all joints to this place.
fn move_to(data: &mut Data, x: f64) {
    data.qpos_mut().fill(x);
    data.forward().unwrap();
}

fn top(data: &Data) -> CameraId {
    data.model().camera("top").unwrap()
}

/// Renderer with a backdrop that it has drawn.
fn drawn(data: &mut Data, width: usize, height: usize) -> (Renderer, StaticBackdrop) {
    let mut renderer = renderer(data.model(), width, height);
    let mut backdrop = StaticBackdrop::default();
    let camera = top(data);
    renderer.render_backdrop(data, camera, &mut backdrop).unwrap();
    (renderer, backdrop)
}

/// Draws over a backdrop into memory that holds another picture.
fn over(renderer: &mut Renderer, data: &mut Data, backdrop: &mut StaticBackdrop) -> Vec<u8> {
    let mut image = vec![7; renderer.image_len()];
    renderer.render_over_backdrop(data, backdrop, &mut image).unwrap();
    image
}

fn whole(renderer: &mut Renderer, data: &mut Data) -> Vec<u8> {
    let mut image = vec![0; renderer.image_len()];
    let camera = top(data);
    renderer.render(data, camera, &mut image).unwrap();
    image
}

/// A picture rotated by a quarter turn has as many bytes and other rows.
#[test]
fn a_backdrop_of_another_renderer_is_refused_whatever_its_size() {
    let mut data = simulation();
    let (painter, mut backdrop) = drawn(&mut data, 8, 4);
    for (width, height) in [(4, 8), (8, 4), (16, 4)] {
        let mut other = renderer(data.model(), width, height);
        let mut out = vec![0; other.image_len()];
        let refused = other.render_over_backdrop(&mut data, &mut backdrop, &mut out);
        let expected = RenderError::OtherRenderer { drawn_by: painter.id(), used_by: other.id() };
        assert_eq!(refused, Err(expected.clone()));
        let text = expected.to_string();
        assert!(text.contains("(8 x 4)"), "{text}");
        assert!(text.contains(&format!("({width} x {height})")), "{text}");
        assert!(out.iter().all(|byte| *byte == 0), "nothing is drawn");
    }
}

/// Makes OpenGL corrupt every picture of the current context, and report an error, until it is
/// dropped.
struct Spoilt {
    disable: unsafe extern "C" fn(u32),
}

const GL_COLOR_LOGIC_OP: u32 = 0x0BF2;
/// Writes zeros instead of drawing.
const GL_CLEAR: u32 = 0x1500;
const NO_CAPABILITY: u32 = 0xFFFF;

impl Spoilt {
    fn new() -> Self {
        // SAFETY: EGL is loaded already; loading it again runs nothing.
        let egl = unsafe { egl::DynamicInstance::<egl::EGL1_5>::load_required() }.unwrap();
        assert!(egl.get_current_context().is_some(), "a renderer's context");
        let function = |name| egl.get_proc_address(name).unwrap() as *const c_void;
        // SAFETY: OpenGL declares the three functions with this signature.
        let [enable, disable, logic_op] = unsafe {
            ["glEnable", "glDisable", "glLogicOp"].map(|name| {
                mem::transmute::<*const c_void, unsafe extern "C" fn(u32)>(function(name))
            })
        };
        // SAFETY: a context is current; a wrong value is an error that OpenGL keeps.
        unsafe {
            logic_op(GL_CLEAR);
            enable(GL_COLOR_LOGIC_OP);
            enable(NO_CAPABILITY);
        }
        Self { disable }
    }
}

impl Drop for Spoilt {
    fn drop(&mut self) {
        // SAFETY: the context of `new` is still current.
        unsafe { (self.disable)(GL_COLOR_LOGIC_OP) };
    }
}

fn is_opengl_error(result: Result<(), RenderError>) -> bool {
    matches!(result, Err(RenderError::OpenGl { code: 0x0500, .. }))
}

#[test]
fn what_an_error_has_spoilt_is_drawn_again() {
    let mut data = simulation();
    let (mut renderer, mut backdrop) = drawn(&mut data, 12, 8);
    let mut out = over(&mut renderer, &mut data, &mut backdrop);
    move_to(&mut data, 0.3);
    let spoilt = Spoilt::new();
    assert!(is_opengl_error(renderer.render_over_backdrop(&mut data, &mut backdrop, &mut out)));
    drop(spoilt);
    // the ball has not moved since
    let after = over(&mut renderer, &mut data, &mut backdrop);
    let expected = whole(&mut renderer, &mut data);
    assert!(expected.iter().any(|byte| *byte > 0));
    assert_eq!(after, expected);
}

#[test]
fn a_backdrop_that_an_error_has_spoilt_is_none() {
    let mut data = simulation();
    let (mut renderer, mut backdrop) = drawn(&mut data, 12, 8);
    let camera = top(&data);
    let spoilt = Spoilt::new();
    assert!(is_opengl_error(renderer.render_backdrop(&mut data, camera, &mut backdrop)));
    drop(spoilt);
    let mut out = vec![0; renderer.image_len()];
    let refused = renderer.render_over_backdrop(&mut data, &mut backdrop, &mut out);
    assert_eq!(refused, Err(RenderError::NoBackdrop));
}

/// Draws over a backdrop at several places of what moves, and compares with complete pictures.
fn check_motion(scene: &str, places: &[f64], options: RenderOptions) {
    let mut data = simulation_of(scene);
    let mut renderer = renderer_with(data.model(), 24, 16, options);
    let (mut backdrop, camera) = (StaticBackdrop::default(), top(&data));
    renderer.render_backdrop(&mut data, camera, &mut backdrop).unwrap();
    let mut pictures = Vec::new();
    for &x in places {
        move_to(&mut data, x);
        let out = over(&mut renderer, &mut data, &mut backdrop);
        let expected = whole(&mut renderer, &mut data);
        assert!(out == expected, "{scene} at {x}");
        assert!(!pictures.contains(&expected), "the motion must show");
        pictures.push(expected);
    }
}

/// A ball above a table moves below a static bridge, which hides it at times.
#[test]
fn pictures_over_a_backdrop_are_the_whole_pictures() {
    let shadows = RenderOptions { shadows: true, ..RenderOptions::default() };
    let (opaque, glass) = ("0 0 1 1", "0 0 1 .5");
    for (bridge, ball, options) in [
        (opaque, "1 0 0 1", RenderOptions::default()),
        (glass, "1 0 0 1", RenderOptions::default()),
        (opaque, "1 0 0 .5", RenderOptions::default()),
        (opaque, "1 0 0 1", shadows),
    ] {
        let scene = format!(
            r#"<visual><quality shadowsize="256"/></visual><worldbody>
                 <camera name="top" pos="0 0 2"/>
                 <light directional="true" pos="-2 0 3" dir="1 0 -1"/>
                 <geom type="box" size="5 5 .1"/>
                 <geom type="box" size=".1 .5 .02" pos="0 0 .8" rgba="{bridge}"/>
                 <body pos="0 0 .4"><joint type="slide" axis="1 0 0"/>
                   <geom size=".2" rgba="{ball}"/></body></worldbody>"#
        );
        check_motion(&scene, &[-0.6, -0.45, -0.3, -0.15, 0.0, 0.15, 0.3], options);
    }
}

/// The tendon's middle and direction stay while its ends approach each other.
#[test]
fn a_tendon_that_shortens_is_drawn_again() {
    let scene = r#"<worldbody>
        <camera name="top" pos="0 0 2"/>
        <geom type="box" size=".6 .3 .1" rgba="0 1 0 1"/>
        <body pos=".5 0 .4"><joint name="right" type="slide" axis="1 0 0"/>
          <geom size=".05" group="3"/><site name="right"/></body>
        <body pos="-.5 0 .4"><joint name="left" type="slide" axis="-1 0 0"/>
          <geom size=".05" group="3"/><site name="left"/></body></worldbody>
      <tendon><spatial width=".05" rgba="1 0 0 1"><site site="left"/><site site="right"/></spatial>
      </tendon>"#;
    check_motion(scene, &[0.0, -0.25], RenderOptions::default());
}

/// OpenGL may pad rows to a multiple of four bytes.
#[test]
fn rows_of_any_width_are_read() {
    let half = |width: usize| {
        let scene = r#"<visual>
            <headlight ambient="1 1 1" diffuse="0 0 0" specular="0 0 0"/></visual><worldbody>
              <camera name="top" pos="0 0 2"/>
              <geom type="box" size="5 5 .1" pos="-5 0 0" rgba="1 0 0 1"/>
              <geom type="box" size="5 5 .1" pos="5 0 0" rgba="0 1 0 1"/>
              <body pos="0 .5 .4"><joint type="slide" axis="1 0 0"/><geom size=".2" group="3"/></body>
            </worldbody>"#;
        let mut data = simulation_of(scene);
        let (mut renderer, mut backdrop) = drawn(&mut data, width, 8);
        let out = over(&mut renderer, &mut data, &mut backdrop);
        assert_eq!(out, whole(&mut renderer, &mut data));
        out
    };
    for width in [13, 14, 15] {
        let image = half(width);
        for (index, pixel) in image.chunks_exact(3).enumerate() {
            match 2 * (index % width) + 1 {
                column if column < width => assert_eq!(pixel, [255, 0, 0], "{width}: {index}"),
                column if column > width => assert_eq!(pixel, [0, 255, 0], "{width}: {index}"),
                _ => {}
            }
        }
    }
}

/// Motion here changes the picture of static geoms, or concerns no geom.
#[test]
fn moving_cameras_lights_and_skins_are_drawn_as_they_are() {
    let table = r#"<geom type="box" size=".6 .3 .1" rgba="0 1 0 1"/>"#;
    let still = r#"<camera name="top" pos="0 0 2"/>"#;
    let slide = r#"<joint type="slide" axis="1 0 0"/>"#;
    let scenes = [
        format!(
            r#"<worldbody>{table}<body>{slide}<geom size=".1" pos="0 0 .3"/>
               <camera name="top" pos="0 0 2"/></body></worldbody>"#
        ),
        format!(
            r#"<worldbody>{table}{still}<body>{slide}<geom size=".1" pos="0 0 .3"/>
               <light pos="0 0 2" dir="0 0 -1" cutoff="10"/></body></worldbody>"#
        ),
        format!(
            r#"<asset><skin name="cloth" rgba="1 0 0 1" face="0 1 2"
                 vertex="-.2 -.2 .5  .2 -.2 .5  0 .2 .5">
                 <bone body="bone" bindpos="0 0 0" bindquat="1 0 0 0"
                   vertid="0 1 2" vertweight="1 1 1"/></skin></asset>
               <worldbody>{table}{still}<body name="bone">{slide}
                 <geom size=".1" group="3"/></body></worldbody>"#
        ),
    ];
    for scene in scenes {
        check_motion(&scene, &[0.0, 0.3, -0.2], RenderOptions::default());
    }
}
