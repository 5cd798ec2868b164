//! Renderers of the pictures that a learner observes (the table without the arm, and a disc at the
//! gripper), and of pictures for viewers.

use std::sync::Arc;

use mujoco::{CameraAndMirror, CameraId, RenderMirror, RenderOptions, Renderer, StaticBackdrop};

use crate::arm_occlusion::{ArmOcclusion, PictureMemory};
use crate::camera::{GripperMark, ObservationPictures, RGB_CHANNELS};
use crate::error::EnvError;
use crate::scene::{ARM_GEOM_GROUP, Scene};
use crate::tabletop::TableTop;

/// Renderer of one scene through its top-down camera; stays on the thread that made it.
pub struct SceneRenderer {
    scene: Arc<Scene>,
    renderer: Renderer,
    mark: Option<GripperMark>,
    /// Last rendered picture, before downsampling and without the mark `[drawn_size, drawn_size,
    /// 3]`.
    rendered: Vec<u8>,
}

impl SceneRenderer {
    /// Creates a renderer of a learner's view of `scene`: the table without the arm, and a mark at
    /// the gripper.
    ///
    /// # Errors
    /// [`EnvError::Render`] if no off-screen OpenGL is available.
    pub fn new(scene: Arc<Scene>) -> Result<Self, EnvError> {
        let mark = Some(scene.camera.mark);
        Self::showing(scene, false, mark)
    }

    /// Creates a renderer of a real camera's view: with the arm, without the mark.
    ///
    /// # Errors
    /// [`EnvError::Render`] if no off-screen OpenGL is available.
    pub fn with_arm(scene: Arc<Scene>) -> Result<Self, EnvError> {
        Self::showing(scene, true, None)
    }

    /// Creates a renderer of the table without arm and mark, the background that in-painting starts
    /// from.
    ///
    /// # Errors
    /// [`EnvError::Render`] if no off-screen OpenGL is available.
    pub fn without_arm(scene: Arc<Scene>) -> Result<Self, EnvError> {
        Self::showing(scene, false, None)
    }

    fn showing(scene: Arc<Scene>, arm: bool, mark: Option<GripperMark>) -> Result<Self, EnvError> {
        let size = scene.camera.rendered_size();
        // by default tables and objects are drawn; not the arm, collision shapes (4) or marks (5)
        let mut options = RenderOptions::default();
        options.visible_geom_groups[ARM_GEOM_GROUP] = arm;
        let renderer = Renderer::new(Arc::clone(&scene.model), size, size, options)?;
        Ok(Self { scene, renderer, mark, rendered: vec![0; size * size * RGB_CHANNELS] })
    }

    /// Renders the camera's view of `table` into `rgb` `[size, size, 3]`; row 0 is the largest y,
    /// column 0 the smallest x.
    ///
    /// # Errors
    /// [`EnvError::NotReset`] if no episode is running, [`EnvError::Render`].
    pub fn render(&mut self, table: &mut TableTop, rgb: &mut [u8]) -> Result<(), EnvError> {
        let view = self.view(table)?;
        self.renderer.render(table.simulation_mut(), view, &mut self.rendered)?;
        self.finish_picture(table, rgb);
        Ok(())
    }

    /// Draws everything that no joint moves into `backdrop`, for
    /// [`SceneRenderer::render_over_backdrop`] in the episode that `table` has begun.
    ///
    /// # Errors
    /// Errors of [`SceneRenderer::render`].
    pub fn render_backdrop(
        &mut self,
        table: &mut TableTop,
        backdrop: &mut StaticBackdrop,
    ) -> Result<(), EnvError> {
        let view = self.view(table)?;
        Ok(self.renderer.render_backdrop(table.simulation_mut(), view, backdrop)?)
    }

    /// Renders the camera's view over the episode's backdrop, bit for bit as
    /// [`SceneRenderer::render`] does: in about half the time, and almost for free while no object
    /// moves.
    ///
    /// # Errors
    /// Errors of [`SceneRenderer::render`].
    pub fn render_over_backdrop(
        &mut self,
        table: &mut TableTop,
        backdrop: &mut StaticBackdrop,
        rgb: &mut [u8],
    ) -> Result<(), EnvError> {
        self.draw_over_backdrop(table, backdrop)?;
        self.finish_picture(table, rgb);
        Ok(())
    }

    /// Draws the camera's view over the backdrop into `rendered`.
    fn draw_over_backdrop(
        &mut self,
        table: &mut TableTop,
        backdrop: &mut StaticBackdrop,
    ) -> Result<(), EnvError> {
        table.variant().ok_or(EnvError::NotReset)?;
        let simulation = table.simulation_mut();
        Ok(self.renderer.render_over_backdrop(simulation, backdrop, &mut self.rendered)?)
    }

    /// Renders what a learner observes: as [`SceneRenderer::render_over_backdrop`], but with what
    /// the arm hides as it was last seen, if `occlusion` is not off. It is kept between the pictures
    /// of an episode.
    ///
    /// # Errors
    /// Errors of [`SceneRenderer::render`]; [`EnvError::Inpainting`].
    pub(crate) fn render_observed(
        &mut self,
        table: &mut TableTop,
        backdrop: &mut StaticBackdrop,
        occlusion: &mut ArmOcclusion,
        rgb: &mut [u8],
    ) -> Result<(), EnvError> {
        self.draw_over_backdrop(table, backdrop)?;
        match occlusion {
            ArmOcclusion::Off => (),
            ArmOcclusion::Pending => {
                let capsules = table.arm_capsules()?;
                let memory = PictureMemory::new(&self.scene.camera, &capsules, &self.rendered)?;
                *occlusion = ArmOcclusion::Active(Box::new(memory));
            }
            ArmOcclusion::Active(memory) => {
                memory.apply(&table.arm_capsules()?, &mut self.rendered)?;
            }
        }
        self.finish_picture(table, rgb);
        Ok(())
    }

    /// Returns the scene's camera, with a mirror for exactly symmetric scenes. Each variant is then
    /// drawn mirrored to the canonical one, so all four pass the same numbers to OpenGL, and their
    /// pictures mirror bit for bit.
    fn view(&self, table: &TableTop) -> Result<CameraAndMirror, EnvError> {
        let element = table.variant().ok_or(EnvError::NotReset)?.element;
        let mirrors = self.scene.mirrors_exactly();
        Ok(CameraAndMirror {
            camera: self.scene.camera_id,
            mirror: RenderMirror {
                swaps_left_right: mirrors && element.flips_x(),
                swaps_top_bottom: mirrors && element.flips_y(),
            },
        })
    }

    /// Composes the image `[size, size, C]` of an observation of `table` from the last rendered
    /// picture, the current one `current` and the episode's first one.
    pub fn compose_observation(
        &self,
        table: &TableTop,
        current: &[u8],
        first: &[u8],
        image: &mut [u8],
    ) {
        let pictures = ObservationPictures {
            current,
            first,
            rendered: &self.rendered,
            hand: table.hand_position(),
        };
        self.scene.camera.compose_observation(&pictures, image);
    }

    /// Downsamples the rendered picture into `rgb` and adds the mark.
    fn finish_picture(&self, table: &TableTop, rgb: &mut [u8]) {
        // marks after downsampling, so that their edges stay those of the observed pixels
        self.scene.camera.downsample(&self.rendered, rgb);
        if let Some(mark) = &self.mark {
            // not on `rendered`, since close-ups are cut from it and have no mark
            self.scene.camera.draw_gripper_mark(mark, table.hand_position(), rgb);
        }
    }
}

/// Settings of a view of a scene for people: viewpoint, arm and picture size.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord)]
pub struct ViewSettings {
    /// `true` for the view from a corner of the table, which faces the robot; `false` for the view
    /// from above.
    pub from_corner: bool,
    /// `true` to show the arm.
    pub shows_arm: bool,
    /// Number of pixels along either side of the picture, 1 to 4096.
    pub size: usize,
}

/// Renderer of one scene for people, in the view of its [`ViewSettings`]; stays on the thread that
/// made it.
pub struct ViewRenderer {
    renderer: Renderer,
    camera: CameraId,
}

impl ViewRenderer {
    /// Creates a renderer of `scene` in the view of the settings `view`.
    ///
    /// # Errors
    /// [`EnvError::Render`] for a size out of range, or if no off-screen OpenGL is available.
    pub fn new(scene: &Scene, view: ViewSettings) -> Result<Self, EnvError> {
        let model = Arc::clone(&scene.model);
        let camera = if view.from_corner { scene.perspective_id } else { scene.camera_id };
        let mut options = RenderOptions::default();
        options.visible_geom_groups[ARM_GEOM_GROUP] = view.shows_arm;
        let renderer = Renderer::new(model, view.size, view.size, options)?;
        Ok(Self { renderer, camera })
    }

    /// Renders the present state of `table` into `rgb` `[size, size, 3]`.
    ///
    /// # Errors
    /// [`EnvError::NotReset`] if no episode is running, [`EnvError::Render`].
    pub fn render(&mut self, table: &mut TableTop, rgb: &mut [u8]) -> Result<(), EnvError> {
        table.variant().ok_or(EnvError::NotReset)?;
        Ok(self.renderer.render(table.simulation_mut(), self.camera, rgb)?)
    }
}

/// Renderer of a scene with its arm from a corner of the table, with shadows and smooth edges, for
/// viewers; stays on the thread that made it.
pub struct CornerViewRenderer {
    camera: CameraId,
    renderer: Renderer,
    /// Last picture of twice the width and height, RGB.
    rendered: Vec<u8>,
}

impl CornerViewRenderer {
    /// Creates a renderer of pictures of `width` x `height` pixels.
    ///
    /// # Errors
    /// [`EnvError::Render`] for a width or height out of `1..=2048`, or if no off-screen OpenGL is
    /// available.
    pub fn new(scene: &Scene, width: usize, height: usize) -> Result<Self, EnvError> {
        let mut options = RenderOptions { shadows: true, ..RenderOptions::default() };
        options.visible_geom_groups[ARM_GEOM_GROUP] = true;
        let model = Arc::clone(&scene.model);
        let renderer = Renderer::new(model, 2 * width, 2 * height, options)?;
        let rendered = vec![0; renderer.image_len()];
        Ok(Self { camera: scene.perspective_id, renderer, rendered })
    }

    /// Renders the view of `table` `[height, width, 3]`: each pixel is the mean of four.
    ///
    /// # Errors
    /// [`EnvError::Render`].
    pub fn render(&mut self, table: &mut TableTop) -> Result<Vec<u8>, EnvError> {
        self.renderer.render(table.simulation_mut(), self.camera, &mut self.rendered)?;
        let row = self.renderer.width() * RGB_CHANNELS;
        let pairs = self.rendered.chunks_exact(2 * row);
        let picture = pairs.flat_map(|pair| {
            let (upper, lower) = pair.split_at(row);
            let mean = |x: usize, channel: usize| {
                let at = [x, x + RGB_CHANNELS].map(|x| x + channel);
                let sum: u16 =
                    at.map(|at| u16::from(upper[at]) + u16::from(lower[at])).iter().sum();
                (sum / 4) as u8
            };
            let lefts = (0..row).step_by(2 * RGB_CHANNELS);
            let pixels = lefts.flat_map(|x| (0..RGB_CHANNELS).map(move |channel| mean(x, channel)));
            pixels.collect::<Vec<u8>>()
        });
        Ok(picture.collect())
    }
}
