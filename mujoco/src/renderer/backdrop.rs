//! Pictures over a backdrop: what stands still is drawn once, what moves is drawn over it.

use super::{Renderer, check_opengl, flip_rows};
use crate::data::Data;
use crate::error::RenderError;
use crate::ids::CameraId;
use crate::raw;

/// What a camera sees of the geoms that no joint moves, and how far away it is.
#[derive(Clone, Debug, Default)]
pub struct Backdrop {
    /// `[H, W, 3]`, bottom row first.
    rgb: Vec<u8>,
    /// `[H, W]`, as OpenGL measures it.
    depth: Vec<f32>,
}

impl Renderer {
    /// Draws the geoms that no joint moves into `backdrop`, for [`Renderer::render_over`].
    ///
    /// # Errors
    /// As [`Renderer::render`].
    pub fn draw_backdrop(
        &mut self,
        data: &mut Data,
        camera: CameraId,
        backdrop: &mut Backdrop,
    ) -> Result<(), RenderError> {
        backdrop.rgb.resize(self.image_len(), 0);
        backdrop.depth.resize(self.image_len() / 3, 0.0);
        self.check_arguments(data, camera, &backdrop.rgb)?;
        self.make_current()?;
        self.update_scene(data, camera, raw::mjCAT_STATIC)?;
        self.draw(&mut backdrop.rgb, Some(&mut backdrop.depth));
        check_opengl("drawing a backdrop")
    }

    /// As [`Renderer::render`], to the same bits, but draws only the geoms that joints move; the others are taken from
    /// `backdrop`. That holds as long as nothing has moved the others since, as setting a mocap body does.
    ///
    /// Where a moving geom is transparent, or there are shadows, everything is drawn.
    ///
    /// # Errors
    /// As [`Renderer::render`]; [`RenderError::Buffer`] for a backdrop of another size, or one that was never drawn.
    pub fn render_over(
        &mut self,
        data: &mut Data,
        camera: CameraId,
        backdrop: &Backdrop,
        out: &mut [u8],
    ) -> Result<(), RenderError> {
        self.check_arguments(data, camera, &backdrop.rgb)?;
        self.check_arguments(data, camera, out)?;
        self.make_current()?;
        self.update_scene(data, camera, raw::mjCAT_DYNAMIC)?;
        if self.shadows || self.is_transparent() {
            return self.render(data, camera, out);
        }
        if self.scene.ngeom == 0 {
            out.copy_from_slice(&backdrop.rgb);
        } else {
            let mut depth = std::mem::take(&mut self.depth);
            depth.resize(backdrop.depth.len(), 0.0);
            self.draw(out, Some(&mut depth));
            compose(out, &depth, backdrop);
            self.depth = depth;
        }
        flip_rows(out, 3 * self.width);
        check_opengl("drawing over a backdrop")
    }

    /// Whether a geom of the scene lets others shine through.
    fn is_transparent(&self) -> bool {
        let count = self.scene.ngeom as usize;
        // SAFETY: MuJoCo has filled `ngeom` entries of the array, which only `update_scene` writes to.
        let geoms = unsafe { std::slice::from_raw_parts(self.scene.geoms, count) };
        geoms.iter().any(|geom| geom.rgba[3] < 1.0)
    }
}

/// Keeps of `out` what is nearer than the backdrop, and takes the rest from there.
fn compose(out: &mut [u8], depth: &[f32], backdrop: &Backdrop) {
    let distances = depth.iter().zip(&backdrop.depth);
    let pixels = out.chunks_exact_mut(3).zip(backdrop.rgb.chunks_exact(3));
    for ((pixel, behind), (near, far)) in pixels.zip(distances) {
        if near > far {
            pixel.copy_from_slice(behind);
        }
    }
}
