//! Drawing inside a program that has OpenGL contexts of its own, through EGL.

#![allow(clippy::unwrap_used, reason = "test code")]

use std::sync::Arc;

use khronos_egl as egl;
use mujoco::{
    CameraAndMirror, Data, Model, OpenGlBackend, RenderError, RenderMirror, RenderOptions,
    Renderer, StaticBackdrop,
};

const SCENE: &str = r#"<mujoco>
  <asset><mesh name="wedge" vertex="0 0 0  .5 0 0  0 .3 0  .1 .1 .4"/></asset>
  <worldbody>
    <camera name="top" pos="0 0 2"/>
    <geom type="box" size=".6 .3 .1" rgba="0 1 0 1"/>
    <geom type="mesh" mesh="wedge" pos="0 0 .2"/>
  </worldbody></mujoco>"#;

type Egl = egl::DynamicInstance<egl::EGL1_5>;

const SURFACELESS: egl::Enum = 0x31DD;
const CONFIG: [egl::Int; 3] = [egl::SURFACE_TYPE, egl::PBUFFER_BIT, egl::NONE];

/// Embedding program with contexts of its own, each with a surface to draw on.
struct Program {
    egl: Egl,
    display: egl::Display,
    config: egl::Config,
}

type Target = (egl::Context, egl::Surface);

impl Program {
    fn new() -> Self {
        // SAFETY: loading EGL runs no initialisers with preconditions.
        let egl = unsafe { Egl::load_required() }.unwrap();
        // SAFETY: the default display is what this platform takes.
        let display = unsafe {
            egl.get_platform_display(SURFACELESS, egl::DEFAULT_DISPLAY, &[egl::ATTRIB_NONE])
        };
        let display = display.unwrap();
        egl.initialize(display).unwrap();
        let config = egl.choose_first_config(display, &CONFIG).unwrap().unwrap();
        Self { egl, display, config }
    }

    fn context(&self, api: egl::Enum) -> Target {
        self.egl.bind_api(api).unwrap();
        let (egl, display, config) = (&self.egl, self.display, self.config);
        let context = egl.create_context(display, config, None, &[egl::NONE]);
        let size = [egl::WIDTH, 7, egl::HEIGHT, 5, egl::NONE];
        let surface = egl.create_pbuffer_surface(display, config, &size);
        (context.unwrap(), surface.unwrap())
    }

    fn make_current(&self, (context, surface): Target) {
        let surface = Some(surface);
        self.egl.make_current(self.display, surface, surface, Some(context)).unwrap();
    }

    fn make_none_current(&self) {
        self.egl.make_current(self.display, None, None, None).unwrap();
    }

    fn current(&self) -> (Option<egl::Context>, [Option<egl::Surface>; 2]) {
        let surfaces = [egl::DRAW, egl::READ].map(|which| self.egl.get_current_surface(which));
        (self.egl.get_current_context(), surfaces)
    }

    fn assert_current(&self, (context, surface): Target, after: &str) {
        let expected = (Some(context), [Some(surface); 2]);
        assert_eq!(self.current(), expected, "after {after}");
    }
}

fn renderer(model: &Arc<Model>) -> Renderer {
    let backends = [OpenGlBackend::EglSurfaceless];
    Renderer::with_backends(Arc::clone(model), 12, 8, RenderOptions::default(), &backends).unwrap()
}

#[test]
fn the_programs_context_is_current_again_after_every_call() {
    let program = Program::new();
    let targets = [egl::OPENGL_API, egl::OPENGL_ES_API].map(|api| program.context(api));
    let model = Arc::new(Model::from_xml(SCENE).unwrap());
    let camera = model.camera("top").unwrap();
    let mut data = Data::new(Arc::clone(&model));
    data.forward().unwrap();

    for target in targets {
        program.make_current(target);
        let api = program.egl.query_api();
        let mut renderer = renderer(&model);
        program.assert_current(target, "making a renderer");
        assert_eq!(program.egl.query_api(), api);

        let mut image = vec![0; renderer.image_len()];
        renderer.render(&mut data, camera, &mut image).unwrap();
        program.assert_current(target, "drawing");
        assert!(image.iter().any(|byte| *byte > 0));

        let (mut backdrop, mut over) = (StaticBackdrop::default(), vec![0; image.len()]);
        renderer.render_backdrop(&mut data, camera, &mut backdrop).unwrap();
        program.assert_current(target, "drawing a backdrop");
        renderer.render_over_backdrop(&mut data, &mut backdrop, &mut over).unwrap();
        program.assert_current(target, "drawing over a backdrop");
        assert_eq!(over, image);

        let mirror = RenderMirror { swaps_left_right: true, swaps_top_bottom: false };
        let refused = renderer.render(&mut data, CameraAndMirror { camera, mirror }, &mut image);
        assert!(matches!(refused, Err(RenderError::NotMirrorSymmetric { .. })));
        program.assert_current(target, "an error");

        drop(renderer);
        program.assert_current(target, "dropping a renderer");
    }
    program.make_none_current();
}

/// The crate restores none of its own contexts, since that would only cause switches.
#[test]
fn without_a_context_of_the_program_the_renderers_own_stays_current() {
    let program = Program::new();
    let model = Arc::new(Model::from_xml(SCENE).unwrap());
    let camera = model.camera("top").unwrap();
    let mut data = Data::new(Arc::clone(&model));
    data.forward().unwrap();
    let (mut one, mut two) = (renderer(&model), renderer(&model));
    let mut image = vec![0; one.image_len()];
    one.render(&mut data, camera, &mut image).unwrap();
    let own = program.current();
    two.render(&mut data, camera, &mut image).unwrap();
    assert_ne!(program.current(), own);
    one.render(&mut data, camera, &mut image).unwrap();
    assert_eq!(program.current(), own);

    // the program takes the thread back for a while
    let target = program.context(egl::OPENGL_API);
    program.make_current(target);
    two.render(&mut data, camera, &mut image).unwrap();
    program.assert_current(target, "drawing with the second renderer");
    drop((one, two));
    program.assert_current(target, "dropping both");
    program.make_none_current();
}
