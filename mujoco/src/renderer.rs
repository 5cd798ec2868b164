//! Off-screen renderer: `mjvScene` and `mjrContext`, with an OpenGL context of its own.

use std::sync::Arc;

use crate::backend::OpenGlBackend;
use crate::data::Data;
use crate::error::RenderError;
use crate::gl::{GlContext, PreviousContext};
use crate::ids::CameraId;
use crate::ids::RendererId;
use crate::model::Model;
use crate::{raw, releases};

mod backdrop;
mod mirror;
mod setup;

pub use backdrop::StaticBackdrop;
pub use mirror::{CameraAndMirror, RenderMirror};

use setup::{fixed_camera, free_camera, make_drawing, make_scene, visible};

/// Largest width or height of a renderer's image, in pixels.
const MAX_SIDE: usize = 4096;

/// Options of a renderer: groups of geoms and sites that are drawn, and shadows. Reflections, sky,
/// fog and anti-aliasing are never drawn, because they are slow in software OpenGL.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct RenderOptions {
    /// Flag for each geom group, 0 to 5: `true` if its geoms are drawn; 0, 1 and 2 by default.
    pub visible_geom_groups: [bool; 6],
    /// Flag for each site group, 0 to 5: `true` if its sites are drawn; none by default.
    pub visible_site_groups: [bool; 6],
    /// `true` if lights cast shadows; off by default, because they are slow in software.
    pub shadows: bool,
}

impl Default for RenderOptions {
    fn default() -> Self {
        Self {
            visible_geom_groups: [true, true, true, false, false, false],
            visible_site_groups: [false; 6],
            shadows: false,
        }
    }
}

/// Camera that belongs to no model: it looks at a point from a distance.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct FreeCamera {
    /// Point in the middle of the image (metres).
    pub target: [f64; 3],
    /// Distance from the camera to the target (metres), above 0.
    pub distance: f64,
    /// Angle (radians) about z of the viewing direction; 0 looks along x, a quarter turn along y.
    pub azimuth: f64,
    /// Angle (radians) of the viewing direction above the horizon; negative to look down.
    pub elevation: f64,
}

/// Renderer of images of one size of one [`Model`], through its fixed cameras or a [`FreeCamera`].
///
/// Mirrored scenes give mirrored images bit for bit if one of them is drawn in a [`RenderMirror`].
/// Without one they do if the camera looks straight down on the axis of the mirror, the light comes
/// from straight above, round shapes stand upright, and no edge or colour falls exactly between two
/// pixels or two levels. The pixels of a *lying* cylinder or capsule may differ by a few levels:
/// each of its quads is cut into triangles that do not mirror.
///
/// A renderer stays on the thread that made it (it is not `Send`); a thread may have several.
///
/// If the embedding program has an OpenGL context current, through the same library, that context
/// is current again when a method returns. Otherwise the renderer's own stays current.
///
/// ```compile_fail
/// fn assert_send<T: Send>() {}
/// assert_send::<mujoco::Renderer>();
/// ```
pub struct Renderer {
    id: RendererId,
    model: Arc<Model>,
    width: usize,
    height: usize,
    options: Box<raw::mjvOption>,
    scene: Box<raw::mjvScene>,
    drawing: Box<raw::mjrContext>,
    shadows: bool,
    /// Depth buffer of the geoms drawn over a backdrop (picture of the static geoms), bottom row
    /// first.
    depth: Vec<f32>,
    // last, so that it outlives what `drop` frees in it
    gl: GlContext,
}

impl Renderer {
    /// Creates a renderer of images of `width` x `height` pixels, each 1 to 4096.
    ///
    /// EGL without a surface is tried first, EGL with a pixel buffer next, OSMesa last; the
    /// environment variable `COVERS_GL` (`egl` or `osmesa`) restricts the choice.
    ///
    /// # Errors
    /// [`RenderError::NoContext`] lists the backends tried, their errors and the packages to
    /// install; [`RenderError::ImageSizeOutOfRange`]; [`RenderError::UnknownBackend`].
    pub fn new(
        model: Arc<Model>,
        width: usize,
        height: usize,
        options: RenderOptions,
    ) -> Result<Self, RenderError> {
        Self::with_backends(model, width, height, options, OpenGlBackend::allowed_by_env()?)
    }

    /// Creates a renderer with the first of the OpenGL backends `backends` that works.
    ///
    /// # Errors
    /// Errors of [`Renderer::new`].
    pub fn with_backends(
        model: Arc<Model>,
        width: usize,
        height: usize,
        options: RenderOptions,
        backends: &[OpenGlBackend],
    ) -> Result<Self, RenderError> {
        let sides = 1..=MAX_SIDE;
        if !sides.contains(&width) || !sides.contains(&height) {
            return Err(RenderError::ImageSizeOutOfRange { width, height, limit: MAX_SIDE });
        }
        let (gl, previous) = GlContext::new(backends)?;
        let backend = gl.backend();
        let made = Self::in_context(gl, model, width, height, &options);
        let restored = restore(backend, previous);
        made.and_then(|renderer| restored.map(|()| renderer))
    }

    /// Creates a renderer in the OpenGL context `gl`, which is current.
    fn in_context(
        gl: GlContext,
        model: Arc<Model>,
        width: usize,
        height: usize,
        options: &RenderOptions,
    ) -> Result<Self, RenderError> {
        let renderer = Self {
            id: RendererId::new_unique(width, height),
            drawing: make_drawing(&model, width, height, options),
            scene: make_scene(&model, options),
            options: visible(options),
            model,
            width,
            height,
            shadows: options.shadows,
            depth: Vec::new(),
            gl,
        };
        check_opengl("making the context")?;
        Ok(renderer)
    }

    /// Returns the backend of the renderer's OpenGL context.
    pub fn backend(&self) -> OpenGlBackend {
        self.gl.backend()
    }

    /// Returns the renderer's id, which no other renderer of the process has.
    pub fn id(&self) -> RendererId {
        self.id
    }

    /// Returns the width of the renderer's images, in pixels.
    pub fn width(&self) -> usize {
        self.width
    }

    /// Returns the height of the renderer's images, in pixels.
    pub fn height(&self) -> usize {
        self.height
    }

    /// Returns the number of bytes of the renderer's images: height x width x 3.
    pub fn image_len(&self) -> usize {
        self.width * self.height * 3
    }

    /// Draws the scene from `view`, a camera with or without a [`RenderMirror`], into `out`,
    /// `[H, W, 3]` RGB with the top row first.
    ///
    /// Positions are the derived ones: call [`Data::forward`] first.
    ///
    /// # Errors
    /// [`RenderError::OtherModel`], [`RenderError::WrongImageLength`],
    /// [`RenderError::UnknownCamera`], [`RenderError::SceneFull`],
    /// [`RenderError::NotMirrorSymmetric`], [`RenderError::MakeCurrentFailed`],
    /// [`RenderError::RestoreContextFailed`], [`RenderError::OpenGl`].
    pub fn render(
        &mut self,
        data: &mut Data,
        view: impl Into<CameraAndMirror>,
        out: &mut [u8],
    ) -> Result<(), RenderError> {
        let CameraAndMirror { camera, mirror } = view.into();
        self.check_arguments(data, camera, out)?;
        self.in_own_context(|renderer| renderer.draw_all(data, fixed_camera(camera), mirror, out))
    }

    /// Draws the scene from `camera` into `out`, `[H, W, 3]` RGB with the top row first.
    ///
    /// Positions are the derived ones: call [`Data::forward`] first.
    ///
    /// # Errors
    /// Errors of [`Renderer::render`] without those of mirrors and unknown cameras;
    /// [`RenderError::InvalidFreeCamera`].
    pub fn render_from(
        &mut self,
        data: &mut Data,
        camera: &FreeCamera,
        out: &mut [u8],
    ) -> Result<(), RenderError> {
        self.check_target(data, out)?;
        let FreeCamera { target: [x, y, z], distance, azimuth, elevation } = *camera;
        let is_finite = [x, y, z, distance, azimuth, elevation].iter().all(|part| part.is_finite());
        if !is_finite || distance <= 0.0 {
            return Err(RenderError::InvalidFreeCamera { camera: format!("{camera:?}") });
        }
        let mirror = RenderMirror::default();
        self.in_own_context(|renderer| renderer.draw_all(data, free_camera(camera), mirror, out))
    }

    fn draw_all(
        &mut self,
        data: &mut Data,
        camera: raw::mjvCamera,
        mirror: RenderMirror,
        out: &mut [u8],
    ) -> Result<(), RenderError> {
        self.update_scene(data, camera, mirror, raw::mjCAT_ALL)?;
        self.draw(out, None);
        mirror.flip_back(out, self.width);
        check_opengl("drawing")
    }

    /// Calls `work` with this renderer's OpenGL context current, then makes the embedding program's
    /// own context current again, if it had one.
    fn in_own_context(
        &mut self,
        work: impl FnOnce(&mut Self) -> Result<(), RenderError>,
    ) -> Result<(), RenderError> {
        let previous = self.gl.make_current()?;
        let done = work(self);
        done.and(restore(self.backend(), previous))
    }

    fn check_arguments(
        &self,
        data: &Data,
        camera: CameraId,
        out: &[u8],
    ) -> Result<(), RenderError> {
        self.check_target(data, out)?;
        let count = self.model.as_raw().ncam as usize;
        if camera.index() >= count {
            return Err(RenderError::UnknownCamera { index: camera.index(), count });
        }
        Ok(())
    }

    fn check_target(&self, data: &Data, out: &[u8]) -> Result<(), RenderError> {
        if !data.model().is_of_family(&self.model) {
            return Err(RenderError::OtherModel);
        }
        if out.len() != self.image_len() {
            return Err(RenderError::WrongImageLength {
                expected: self.image_len(),
                got: out.len(),
            });
        }
        Ok(())
    }

    /// Updates MuJoCo's scene with the geoms of some categories (moving, static or both), reflected
    /// in `mirror`.
    fn update_scene(
        &mut self,
        data: &mut Data,
        mut camera: raw::mjvCamera,
        mirror: RenderMirror,
        categories: raw::mjtCatBit,
    ) -> Result<(), RenderError> {
        let model: *const raw::mjModel = data.model().as_raw();
        // SAFETY: live model, data of this very model, options, camera and scene, which has room
        // for the geoms of every model of the family; no perturbation.
        unsafe {
            raw::mjv_updateScene(
                model,
                data.as_mut_ptr(),
                &raw const *self.options,
                std::ptr::null(),
                &raw mut camera,
                categories.cast_signed(),
                &raw mut *self.scene,
            );
        }
        if releases::take_scene_overflow(&mut self.scene, data.raw_mut()) {
            return Err(RenderError::SceneFull { limit: self.scene.maxgeom as usize });
        }
        self.reflect_scene(data.model(), mirror)
    }

    /// Draws MuJoCo's scene and reads the image back, bottom row first.
    fn draw(&mut self, out: &mut [u8], depth: Option<&mut [f32]>) {
        let (width, height) = (self.width as i32, self.height as i32);
        let viewport = raw::mjrRect { left: 0, bottom: 0, width, height };
        let depth = depth.map_or(std::ptr::null_mut(), <[f32]>::as_mut_ptr);
        // SAFETY: the context that `drawing` was made in is current; `out` and `depth` hold exactly
        // the viewport's pixels (checked by the callers); NULL asks for no depth.
        unsafe {
            raw::mjr_render(viewport, &raw mut *self.scene, &raw const *self.drawing);
            raw::mjr_readPixels(out.as_mut_ptr(), depth, viewport, &raw const *self.drawing);
        }
    }
}

impl Drop for Renderer {
    fn drop(&mut self) {
        // SAFETY: MuJoCo made both; the context's objects belong to our OpenGL context, and are
        // freed with it anyway where it cannot be made current.
        unsafe {
            if let Ok(previous) = self.gl.make_current() {
                raw::mjr_freeContext(&raw mut *self.drawing);
                // an error cannot be reported from `drop`
                let _ = previous.restore();
            }
            raw::mjv_freeScene(&raw mut *self.scene);
        }
    }
}

fn restore(backend: OpenGlBackend, previous: PreviousContext) -> Result<(), RenderError> {
    previous.restore().map_err(|reason| RenderError::RestoreContextFailed { backend, reason })
}

fn check_opengl(during: &'static str) -> Result<(), RenderError> {
    // SAFETY: an OpenGL context is current and MuJoCo has loaded its functions.
    match unsafe { raw::mjr_getError() } {
        0 => Ok(()),
        code => Err(RenderError::OpenGl { code: code.cast_unsigned(), during }),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use khronos_egl as egl;

    fn renderer() -> (Data, Renderer) {
        let xml = r#"<mujoco><worldbody><camera name="top" pos="0 0 2"/></worldbody></mujoco>"#;
        let model = Arc::new(Model::from_xml(xml).unwrap());
        let backends = [OpenGlBackend::EglSurfaceless];
        let options = RenderOptions::default();
        let renderer = Renderer::with_backends(Arc::clone(&model), 12, 8, options, &backends);
        (Data::new(model), renderer.unwrap())
    }

    #[test]
    fn a_lost_context_is_an_error_of_its_renderer_alone() {
        let (mut data, mut lost) = renderer();
        // SAFETY: EGL is loaded already; loading it again runs nothing.
        let egl = unsafe { egl::DynamicInstance::<egl::EGL1_5>::load_required() }.unwrap();
        let (display, context) = (egl.get_current_display(), egl.get_current_context());
        let (mut other_data, mut other) = renderer();
        egl.destroy_context(display.unwrap(), context.unwrap()).unwrap();
        let camera = data.model().camera("top").unwrap();
        let mut image = vec![0; lost.image_len()];
        let error = lost.render(&mut data, camera, &mut image).unwrap_err();
        assert!(matches!(error, RenderError::MakeCurrentFailed { .. }), "{error:?}");
        let text = error.to_string();
        assert!(text.contains("lost") && text.contains("make a new renderer"));
        other.render(&mut other_data, camera, &mut image).unwrap();
    }
}
