//! The picture that a learner sees: the table without the arm, a disc at the gripper, and behind it
//! the episode's first picture or a close-up.

use std::sync::Arc;

use mujoco::{Backdrop, CameraView, Mirror, RenderOptions, Renderer};

use crate::camera::{Mark, Pictures, RGB};
use crate::error::EnvError;
use crate::scene::{ARM_GEOM_GROUP, Scene};
use crate::tabletop::TableTop;

/// Renders one scene from its camera; lives on the thread that made it.
pub struct SceneRenderer {
    scene: Arc<Scene>,
    renderer: Renderer,
    mark: Option<Mark>,
    /// What was drawn last `[drawn_size, drawn_size, 3]`, before it was shrunk and marked.
    drawn: Vec<u8>,
}

impl SceneRenderer {
    /// A renderer of what a learner sees of `scene`: the table without the arm, and a mark at the
    /// gripper.
    ///
    /// # Errors
    /// [`EnvError::Render`] where no off-screen OpenGL can be had.
    pub fn new(scene: Arc<Scene>) -> Result<Self, EnvError> {
        let mark = Some(scene.camera.mark);
        Self::showing(scene, false, mark)
    }

    /// A renderer of what a real camera would see: the arm, and no mark.
    ///
    /// # Errors
    /// As [`SceneRenderer::new`].
    pub fn with_arm(scene: Arc<Scene>) -> Result<Self, EnvError> {
        Self::showing(scene, true, None)
    }

    /// A renderer of the table alone: the background that in-painting starts from.
    ///
    /// # Errors
    /// As [`SceneRenderer::new`].
    pub fn of_table(scene: Arc<Scene>) -> Result<Self, EnvError> {
        Self::showing(scene, false, None)
    }

    fn showing(scene: Arc<Scene>, arm: bool, mark: Option<Mark>) -> Result<Self, EnvError> {
        let drawn = scene.camera.drawn_size();
        // the default draws tables and objects, not the arm, collision shapes (4) or marks (5)
        let mut options = RenderOptions::default();
        options.geom_groups[ARM_GEOM_GROUP] = arm;
        let renderer = Renderer::new(Arc::clone(&scene.model), drawn, drawn, options)?;
        Ok(Self { scene, renderer, mark, drawn: vec![0; drawn * drawn * RGB] })
    }

    /// Draws what the camera over `table` sees into `rgb` `[size, size, 3]`; row 0 is the largest
    /// y, column 0 the smallest x.
    ///
    /// # Errors
    /// [`EnvError::NotReset`] where no episode runs, [`EnvError::Render`].
    pub fn render(&mut self, table: &mut TableTop, rgb: &mut [u8]) -> Result<(), EnvError> {
        let view = self.view(table)?;
        self.renderer.render(table.simulation_mut(), view, &mut self.drawn)?;
        self.develop(table, rgb);
        Ok(())
    }

    /// Draws what stands still during the episode that `table` has begun, for
    /// [`SceneRenderer::render_over`].
    ///
    /// # Errors
    /// As [`SceneRenderer::render`].
    pub fn draw_backdrop(
        &mut self,
        table: &mut TableTop,
        backdrop: &mut Backdrop,
    ) -> Result<(), EnvError> {
        let view = self.view(table)?;
        let drawn = self.renderer.draw_backdrop(table.simulation_mut(), view, backdrop);
        Ok(drawn?)
    }

    /// Draws what [`SceneRenderer::render`] does, to the same bits, over the backdrop of the same
    /// episode: in about half the time, and in next to none while no object moves.
    ///
    /// # Errors
    /// As [`SceneRenderer::render`].
    pub fn render_over(
        &mut self,
        table: &mut TableTop,
        backdrop: &mut Backdrop,
        rgb: &mut [u8],
    ) -> Result<(), EnvError> {
        table.variant().ok_or(EnvError::NotReset)?;
        self.renderer.render_over(table.simulation_mut(), backdrop, &mut self.drawn)?;
        self.develop(table, rgb);
        Ok(())
    }

    /// The camera. Where variants are exact mirror images, each is drawn in the mirror that brings
    /// it to the canonical one. So all four hand the same numbers to OpenGL, and their pictures
    /// mirror bit for bit.
    fn view(&self, table: &TableTop) -> Result<CameraView, EnvError> {
        let element = table.variant().ok_or(EnvError::NotReset)?.element;
        let mirrors = self.scene.embodiment.mirrors_exactly();
        Ok(CameraView {
            camera: self.scene.camera_id,
            mirror: Mirror {
                columns: mirrors && element.flips_x(),
                rows: mirrors && element.flips_y(),
            },
        })
    }

    /// Makes the image of an observation of `table`, `[size, size, C]`, of the picture that was
    /// drawn last, `now`, and the episode's first one.
    pub fn compose(&self, table: &TableTop, now: &[u8], first: &[u8], image: &mut [u8]) {
        let pictures = Pictures { now, first, drawn: &self.drawn, hand: table.hand() };
        self.scene.camera.compose(&pictures, image);
    }

    /// Makes `rgb` of what was drawn.
    fn develop(&self, table: &TableTop, rgb: &mut [u8]) {
        self.scene.camera.shrink(&self.drawn, rgb);
        if let Some(mark) = &self.mark {
            self.scene.camera.draw_mark(mark, table.hand(), rgb);
        }
    }
}
