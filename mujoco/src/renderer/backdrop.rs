//! Pictures over a backdrop: what stands still is drawn once, what moves is drawn over it.

use super::{CameraView, Renderer, check_opengl};
use crate::data::Data;
use crate::error::RenderError;
use crate::ids::RendererId;
use crate::raw;

/// What a camera sees of the geoms that no joint moves, and how far away it is.
///
/// It belongs to the renderer that drew it.
#[derive(Clone, Debug, Default)]
pub struct Backdrop {
    /// Who drew it and how; none before that, and while it is being drawn.
    drawn: Option<(RendererId, CameraView)>,
    /// Whether one can see through one of its geoms. What moves behind that cannot be drawn over
    /// it.
    transparent: bool,
    /// Where camera and lights were.
    viewpoint: Viewpoint,
    /// `[H, W, 3]`, bottom row first, in the view's mirror.
    rgb: Vec<u8>,
    /// `[H, W]`, as OpenGL measures it.
    depth: Vec<f32>,
    /// The last picture over it, `[H, W, 3]`.
    last: Vec<u8>,
    /// Where the moving geoms of the last picture were.
    last_poses: Vec<Pose>,
    /// Whether the last picture is whole and shows those poses.
    whole: bool,
}

/// Position, direction and upward direction of the two eyes and the lights; lights have no upward
/// direction.
type Viewpoint = Vec<[[f32; 3]; 3]>;

/// Position, rotation matrix and size of a geom, as MuJoCo's scene holds them; a piece of tendon
/// changes its size.
type Pose = ([f32; 3], [f32; 9], [f32; 3]);

impl Renderer {
    /// Draws the geoms that no joint moves into `backdrop`, for [`Renderer::render_over`].
    ///
    /// After an error the backdrop holds no picture.
    ///
    /// # Errors
    /// As [`Renderer::render`].
    pub fn draw_backdrop(
        &mut self,
        data: &mut Data,
        view: impl Into<CameraView>,
        backdrop: &mut Backdrop,
    ) -> Result<(), RenderError> {
        let view = view.into();
        backdrop.drawn = None;
        backdrop.whole = false;
        backdrop.rgb.resize(self.image_len(), 0);
        backdrop.depth.resize(self.image_len() / 3, 0.0);
        self.check_arguments(data, view.camera, &backdrop.rgb)?;
        self.in_own_context(|renderer| {
            renderer.update_scene(data, view, raw::mjCAT_STATIC)?;
            backdrop.transparent = renderer.is_transparent();
            backdrop.viewpoint.clear();
            backdrop.viewpoint.extend(renderer.viewpoint());
            renderer.draw(&mut backdrop.rgb, Some(&mut backdrop.depth));
            check_opengl("drawing a backdrop")
        })?;
        backdrop.drawn = Some((self.id(), view));
        Ok(())
    }

    /// As [`Renderer::render`] with the view of `backdrop`, to the same bits, but draws only the
    /// geoms that joints move. The others are taken from the backdrop, and everything is taken
    /// from the last picture over it where no geom has moved since.
    ///
    /// That holds as long as nothing has moved the other geoms since the backdrop was drawn, as
    /// setting a mocap body does. Everything is drawn where a geom is transparent, whether it
    /// moves or not, where there are shadows or skins, and where the camera or a light has moved.
    ///
    /// # Errors
    /// As [`Renderer::render`]; [`RenderError::NoBackdrop`] for a backdrop that was never drawn,
    /// [`RenderError::OtherRenderer`] for one that another renderer drew.
    pub fn render_over(
        &mut self,
        data: &mut Data,
        backdrop: &mut Backdrop,
        out: &mut [u8],
    ) -> Result<(), RenderError> {
        let view = self.view_of(backdrop)?;
        self.check_arguments(data, view.camera, out)?;
        self.in_own_context(|renderer| {
            renderer.update_scene(data, view, raw::mjCAT_DYNAMIC)?;
            if renderer.is_shown(backdrop) {
                check_opengl("drawing over a backdrop")?;
            } else if renderer.must_draw_all(backdrop) {
                return renderer.draw_all(data, view, out);
            } else {
                renderer.draw_over(backdrop, view)?;
            }
            out.copy_from_slice(&backdrop.last);
            Ok(())
        })
    }

    /// The view of a backdrop that this renderer has drawn.
    fn view_of(&self, backdrop: &Backdrop) -> Result<CameraView, RenderError> {
        let (drawn_by, view) = backdrop.drawn.ok_or(RenderError::NoBackdrop)?;
        if drawn_by == self.id() {
            Ok(view)
        } else {
            Err(RenderError::OtherRenderer { drawn_by, used_by: self.id() })
        }
    }

    /// Brings the last picture over `backdrop` up to date with the scene.
    fn draw_over(&mut self, backdrop: &mut Backdrop, view: CameraView) -> Result<(), RenderError> {
        backdrop.whole = false;
        let mut depth = std::mem::take(&mut self.depth);
        depth.resize(backdrop.depth.len(), 0.0);
        backdrop.last.resize(backdrop.rgb.len(), 0);
        self.draw(&mut backdrop.last, Some(&mut depth));
        compose(&mut backdrop.last, &backdrop.rgb, &depth, &backdrop.depth);
        view.mirror.turn_back(&mut backdrop.last, self.width);
        self.depth = depth;
        check_opengl("drawing over a backdrop")?;
        let poses = self.geoms().iter();
        let poses = poses.map(|geom| (geom.pos, geom.mat, geom.size));
        backdrop.last_poses.clear();
        backdrop.last_poses.extend(poses);
        backdrop.whole = true;
        Ok(())
    }

    /// Whether the last picture over `backdrop` is one of the scene: no geom, eye or light has
    /// moved since. What else a picture over a backdrop takes does not change.
    fn is_shown(&self, backdrop: &Backdrop) -> bool {
        let (geoms, poses) = (self.geoms(), &backdrop.last_poses);
        let stays = |(geom, (pos, mat, size)): (&raw::mjvGeom, &Pose)| {
            same(&geom.pos, pos) && same(&geom.mat, mat) && same(&geom.size, size)
        };
        backdrop.whole
            && geoms.len() == poses.len()
            && geoms.iter().zip(poses).all(stays)
            && !self.looks_from_elsewhere(backdrop)
    }

    /// Whether what moves and what stands still cannot be drawn one after the other.
    fn must_draw_all(&self, backdrop: &Backdrop) -> bool {
        let transparent = || backdrop.transparent || self.is_transparent();
        let elsewhere = || self.looks_from_elsewhere(backdrop);
        self.shadows || self.scene.nskin > 0 || transparent() || elsewhere()
    }

    /// Whether the camera or a light has moved since the backdrop was drawn.
    fn looks_from_elsewhere(&self, backdrop: &Backdrop) -> bool {
        let mut before = backdrop.viewpoint.iter().map(|point| point.as_flattened());
        let mut now = self.viewpoint();
        let all = now.all(|now| before.next().is_some_and(|it| same(it, now.as_flattened())));
        !(all && before.next().is_none())
    }

    /// Whether one can see through a geom of the scene.
    fn is_transparent(&self) -> bool {
        self.geoms().iter().any(|geom| geom.rgba[3] < 1.0)
    }

    fn viewpoint(&self) -> impl Iterator<Item = [[f32; 3]; 3]> {
        let eyes = self.scene.camera.iter();
        let eyes = eyes.map(|eye| [eye.pos, eye.forward, eye.up]);
        let lights = self.scene.lights[..self.scene.nlight as usize].iter();
        eyes.chain(lights.map(|light| [light.pos, light.dir, [0.0; 3]]))
    }

    pub(super) fn geoms(&self) -> &[raw::mjvGeom] {
        let count = self.scene.ngeom as usize;
        // SAFETY: MuJoCo has filled `ngeom` entries of the array, which only `update_scene` and
        // `reflect_scene` write to.
        unsafe { std::slice::from_raw_parts(self.scene.geoms, count) }
    }
}

/// Whether numbers are the same to the last bit; without a branch for each of them.
fn same(a: &[f32], b: &[f32]) -> bool {
    let differences = a.iter().zip(b).map(|(a, b)| a.to_bits() ^ b.to_bits());
    differences.fold(0, |all, difference| all | difference) == 0
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
