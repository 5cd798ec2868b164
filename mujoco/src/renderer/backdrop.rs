//! Drawing over a backdrop: static geoms are drawn once, and moving ones over their picture.

use super::setup::fixed_camera;
use super::{CameraAndMirror, RenderMirror, Renderer, check_opengl};
use crate::data::Data;
use crate::error::RenderError;
use crate::ids::RendererId;
use crate::raw;

/// Picture and depth buffer of the geoms that no joint moves, from one camera.
///
/// A backdrop belongs to the renderer that drew it.
#[derive(Clone, Debug, Default)]
pub struct StaticBackdrop {
    /// Renderer and camera of the backdrop's picture; `None` if there is no complete picture.
    source: Option<(RendererId, CameraAndMirror)>,
    /// `true` if a geom of the backdrop is transparent. Geoms that move behind it cannot be drawn
    /// over the backdrop.
    transparent: bool,
    /// Poses of camera and lights when the backdrop was drawn.
    viewpoint: Viewpoint,
    /// Picture `[height, width, 3]` of the static geoms, bottom row first, reflected in the mirror
    /// of the view.
    rgb: Vec<u8>,
    /// Depth buffer `[height, width]` of the static geoms, in OpenGL's units.
    depth: Vec<f32>,
    /// Last picture of all geoms over the backdrop, `[height, width, 3]`.
    last: Vec<u8>,
    /// Poses of the moving geoms in the last picture over the backdrop.
    last_poses: Vec<Pose>,
    /// `true` if the last picture over the backdrop is complete and shows `last_poses`.
    complete: bool,
}

/// Position, direction and upward direction of the two eyes and of the lights; lights have no
/// upward direction.
type Viewpoint = Vec<[[f32; 3]; 3]>;

/// Position, rotation matrix and size of a geom in MuJoCo's scene. The size is included because a
/// segment of a tendon changes it.
type Pose = ([f32; 3], [f32; 9], [f32; 3]);

impl Renderer {
    /// Draws the geoms that no joint moves into `backdrop`, for [`Renderer::render_over_backdrop`].
    ///
    /// After an error the backdrop holds no picture.
    ///
    /// # Errors
    /// Errors of [`Renderer::render`].
    pub fn render_backdrop(
        &mut self,
        data: &mut Data,
        view: impl Into<CameraAndMirror>,
        backdrop: &mut StaticBackdrop,
    ) -> Result<(), RenderError> {
        let view = view.into();
        let CameraAndMirror { camera, mirror } = view;
        backdrop.source = None;
        backdrop.complete = false;
        backdrop.rgb.resize(self.image_len(), 0);
        backdrop.depth.resize(self.image_len() / 3, 0.0);
        self.check_arguments(data, camera, &backdrop.rgb)?;
        self.in_own_context(|renderer| {
            renderer.update_scene(data, fixed_camera(camera), mirror, raw::mjCAT_STATIC)?;
            backdrop.transparent = renderer.is_transparent();
            backdrop.viewpoint.clear();
            backdrop.viewpoint.extend(renderer.viewpoint());
            renderer.draw(&mut backdrop.rgb, Some(&mut backdrop.depth));
            check_opengl("drawing a backdrop")
        })?;
        backdrop.source = Some((self.id(), view));
        Ok(())
    }

    /// Draws the picture from the view of `backdrop`, bit for bit as [`Renderer::render`] does, but
    /// renders only the geoms that joints move. The others are copied from the backdrop, and the
    /// whole picture is copied from the last one if no geom has moved since.
    ///
    /// The other geoms must not have moved since the backdrop was drawn, for instance by setting a
    /// mocap body. Everything is rendered if any geom is transparent, if there are shadows or
    /// skins, and if the camera or a light has moved.
    ///
    /// # Errors
    /// Errors of [`Renderer::render`]; [`RenderError::NoBackdrop`] for a backdrop that was never
    /// drawn, [`RenderError::OtherRenderer`] for one that another renderer drew.
    pub fn render_over_backdrop(
        &mut self,
        data: &mut Data,
        backdrop: &mut StaticBackdrop,
        out: &mut [u8],
    ) -> Result<(), RenderError> {
        let CameraAndMirror { camera, mirror } = self.view_of(backdrop)?;
        self.check_arguments(data, camera, out)?;
        let camera = fixed_camera(camera);
        self.in_own_context(|renderer| {
            renderer.update_scene(data, camera, mirror, raw::mjCAT_DYNAMIC)?;
            if renderer.is_up_to_date(backdrop) {
                check_opengl("drawing over a backdrop")?;
            } else if renderer.needs_full_render(backdrop) {
                return renderer.draw_all(data, camera, mirror, out);
            } else {
                renderer.draw_over(backdrop, mirror)?;
            }
            out.copy_from_slice(&backdrop.last);
            Ok(())
        })
    }

    /// Returns the camera and mirror of a backdrop that this renderer has drawn.
    fn view_of(&self, backdrop: &StaticBackdrop) -> Result<CameraAndMirror, RenderError> {
        let (drawn_by, view) = backdrop.source.ok_or(RenderError::NoBackdrop)?;
        if drawn_by == self.id() {
            Ok(view)
        } else {
            Err(RenderError::OtherRenderer { drawn_by, used_by: self.id() })
        }
    }

    /// Draws the moving geoms of the scene over `backdrop`, into its last picture.
    fn draw_over(
        &mut self,
        backdrop: &mut StaticBackdrop,
        mirror: RenderMirror,
    ) -> Result<(), RenderError> {
        // stays `false` after an error, so that the next call does not reuse the picture
        backdrop.complete = false;
        let mut depth = std::mem::take(&mut self.depth);
        depth.resize(backdrop.depth.len(), 0.0);
        backdrop.last.resize(backdrop.rgb.len(), 0);
        self.draw(&mut backdrop.last, Some(&mut depth));
        compose(&mut backdrop.last, &backdrop.rgb, &depth, &backdrop.depth);
        mirror.flip_back(&mut backdrop.last, self.width);
        self.depth = depth;
        check_opengl("drawing over a backdrop")?;
        let poses = self.geoms().iter().map(|geom| (geom.pos, geom.mat, geom.size));
        backdrop.last_poses.clear();
        backdrop.last_poses.extend(poses);
        backdrop.complete = true;
        Ok(())
    }

    /// Returns `true` if the last picture over `backdrop` shows the present scene: no geom, eye or
    /// light has moved since. Nothing else can change such a picture.
    fn is_up_to_date(&self, backdrop: &StaticBackdrop) -> bool {
        let (geoms, poses) = (self.geoms(), &backdrop.last_poses);
        let stays = |(geom, (pos, mat, size)): (&raw::mjvGeom, &Pose)| {
            same_bits(&geom.pos, pos) && same_bits(&geom.mat, mat) && same_bits(&geom.size, size)
        };
        backdrop.complete
            && geoms.len() == poses.len()
            && geoms.iter().zip(poses).all(stays)
            && !self.viewpoint_changed(backdrop)
    }

    /// Returns `true` if moving geoms cannot be drawn over the picture of static ones, so that all
    /// must be rendered.
    fn needs_full_render(&self, backdrop: &StaticBackdrop) -> bool {
        let transparent = || backdrop.transparent || self.is_transparent();
        let elsewhere = || self.viewpoint_changed(backdrop);
        self.shadows || self.scene.nskin > 0 || transparent() || elsewhere()
    }

    /// Returns `true` if the camera or a light has moved since the backdrop was drawn.
    fn viewpoint_changed(&self, backdrop: &StaticBackdrop) -> bool {
        let mut before = backdrop.viewpoint.iter().map(|point| point.as_flattened());
        let mut now = self.viewpoint();
        let all = now.all(|now| before.next().is_some_and(|it| same_bits(it, now.as_flattened())));
        !(all && before.next().is_none())
    }

    /// Returns `true` if a geom of the scene is transparent.
    fn is_transparent(&self) -> bool {
        self.geoms().iter().any(|geom| geom.rgba[3] < 1.0)
    }

    fn viewpoint(&self) -> impl Iterator<Item = [[f32; 3]; 3]> {
        let eyes = self.scene.camera.iter().map(|eye| [eye.pos, eye.forward, eye.up]);
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

/// Returns `true` if the numbers of two lists are equal bit for bit. The loop has no branches.
fn same_bits(a: &[f32], b: &[f32]) -> bool {
    let differences = a.iter().zip(b).map(|(a, b)| a.to_bits() ^ b.to_bits());
    differences.fold(0, |all, difference| all | difference) == 0
}

/// Keeps the pixels of `rgb` that are nearer to the camera than the backdrop, and copies the others
/// from the backdrop.
fn compose(rgb: &mut [u8], backdrop: &[u8], depth: &[f32], backdrop_depth: &[f32]) {
    let pixels = rgb.chunks_exact_mut(3).zip(backdrop.chunks_exact(3));
    for ((pixel, behind), (near, far)) in pixels.zip(depth.iter().zip(backdrop_depth)) {
        if near > far {
            pixel.copy_from_slice(behind);
        }
    }
}
