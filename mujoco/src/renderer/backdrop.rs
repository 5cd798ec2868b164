//! Pictures over a backdrop: what stands still is drawn once, what moves is drawn over it.

use super::{Renderer, View, check_opengl};
use crate::data::Data;
use crate::error::RenderError;
use crate::raw;

/// What a camera sees of the geoms that no joint moves, and how far away it is.
#[derive(Clone, Debug, Default)]
pub struct Backdrop {
    /// How it was drawn; none before that.
    view: Option<View>,
    /// `[H, W, 3]`, bottom row first, in the view's mirror.
    rgb: Vec<u8>,
    /// `[H, W]`, as OpenGL measures it.
    depth: Vec<f32>,
    /// The last picture over it, and where the moving geoms were: position and rotation of each.
    last: Vec<u8>,
    poses: Vec<[f32; 12]>,
}

impl Renderer {
    /// Draws the geoms that no joint moves into `backdrop`, for [`Renderer::render_over`].
    ///
    /// # Errors
    /// As [`Renderer::render`].
    pub fn draw_backdrop(
        &mut self,
        data: &mut Data,
        view: impl Into<View>,
        backdrop: &mut Backdrop,
    ) -> Result<(), RenderError> {
        let view = view.into();
        backdrop.rgb.resize(self.image_len(), 0);
        backdrop.depth.resize(self.image_len() / 3, 0.0);
        self.check_arguments(data, view.camera, &backdrop.rgb)?;
        self.make_current()?;
        self.update_scene(data, view, raw::mjCAT_STATIC)?;
        backdrop.view = Some(view);
        backdrop.last.clear();
        self.draw(&mut backdrop.rgb, Some(&mut backdrop.depth));
        check_opengl("drawing a backdrop")
    }

    /// As [`Renderer::render`] with the view of `backdrop`, to the same bits, but draws only the geoms that joints move; the others are taken from
    /// there, and everything where none has moved since the last picture. That holds as long as nothing has moved the
    /// others since the backdrop was drawn, as setting a mocap body does.
    ///
    /// Where a moving geom is transparent, or there are shadows, everything is drawn.
    ///
    /// # Errors
    /// As [`Renderer::render`]; [`RenderError::Buffer`] for a backdrop of another size, [`RenderError::NoBackdrop`] for one that was never drawn.
    pub fn render_over(
        &mut self,
        data: &mut Data,
        backdrop: &mut Backdrop,
        out: &mut [u8],
    ) -> Result<(), RenderError> {
        let view = backdrop.view.ok_or(RenderError::NoBackdrop)?;
        self.check_arguments(data, view.camera, &backdrop.rgb)?;
        self.check_arguments(data, view.camera, out)?;
        self.make_current()?;
        self.update_scene(data, view, raw::mjCAT_DYNAMIC)?;
        if self.shadows || self.is_transparent() {
            return self.render(data, view, out);
        }
        if self.have_moved(backdrop) {
            backdrop.last.resize(out.len(), 0);
            let mut depth = std::mem::take(&mut self.depth);
            depth.resize(backdrop.depth.len(), 0.0);
            self.draw(&mut backdrop.last, Some(&mut depth));
            compose(&mut backdrop.last, &backdrop.rgb, &depth, &backdrop.depth);
            view.mirror.turn_back(&mut backdrop.last, self.width);
            self.depth = depth;
        }
        out.copy_from_slice(&backdrop.last);
        check_opengl("drawing over a backdrop")
    }

    /// Whether the scene differs from that of the last picture over `backdrop`, which is taken note of.
    fn have_moved(&self, backdrop: &mut Backdrop) -> bool {
        let poses = self.geoms().iter().map(|geom| {
            let mut pose = [0.0; 12];
            pose[..3].copy_from_slice(&geom.pos);
            pose[3..].copy_from_slice(&geom.mat);
            pose
        });
        if !backdrop.last.is_empty() && backdrop.poses.iter().copied().eq(poses.clone()) {
            return false;
        }
        backdrop.poses.clear();
        backdrop.poses.extend(poses);
        true
    }

    /// Whether a geom of the scene lets others shine through.
    fn is_transparent(&self) -> bool {
        self.geoms().iter().any(|geom| geom.rgba[3] < 1.0)
    }

    pub(super) fn geoms(&self) -> &[raw::mjvGeom] {
        let count = self.scene.ngeom as usize;
        // SAFETY: MuJoCo has filled `ngeom` entries of the array, which only `update_scene` writes to.
        unsafe { std::slice::from_raw_parts(self.scene.geoms, count) }
    }
}

/// Keeps of `rgb` what is nearer than the backdrop, and takes the rest from there.
fn compose(rgb: &mut [u8], backdrop: &[u8], depth: &[f32], backdrop_depth: &[f32]) {
    let pixels = rgb.chunks_exact_mut(3).zip(backdrop.chunks_exact(3));
    for ((pixel, behind), (near, far)) in pixels.zip(depth.iter().zip(backdrop_depth)) {
        if near > far {
            pixel.copy_from_slice(behind);
        }
    }
}
