//! Drawing in a mirror: the reflected scene is drawn, and its picture is flipped back.

use super::Renderer;
use crate::error::RenderError;
use crate::ids::CameraId;
use crate::model::Model;
use crate::{raw, releases};

/// Reflection in which a scene is drawn; the finished picture is flipped back.
///
/// The picture shows the scene as it is, whatever the mirror. Only decisions of OpenGL that depend
/// on handedness differ: an edge through the exact middle of a pixel belongs to the shape on one
/// side of it, and a mirror swaps the sides. So two scenes that mirror each other have pictures
/// that mirror each other bit for bit if one of them is drawn in the mirror between them.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub struct RenderMirror {
    /// `true` to draw the scene with left and right swapped.
    pub swaps_left_right: bool,
    /// `true` to draw the scene with top and bottom swapped.
    pub swaps_top_bottom: bool,
}

/// Camera, and the mirror that its pictures are drawn in.
///
/// A [`CameraId`] alone converts to a view without a mirror.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct CameraAndMirror {
    /// Camera through which the scene is drawn.
    pub camera: CameraId,
    /// Mirror in which the scene is drawn.
    pub mirror: RenderMirror,
}

impl From<CameraId> for CameraAndMirror {
    fn from(camera: CameraId) -> Self {
        let mirror = RenderMirror::default();
        Self { camera, mirror }
    }
}

impl RenderMirror {
    /// Returns `true` if the mirror swaps handedness; both flips together are a rotation and do
    /// not.
    fn reverses_orientation(self) -> bool {
        self.swaps_left_right != self.swaps_top_bottom
    }

    /// Converts an image that OpenGL drew in this mirror, `[H, width, 3]` with the bottom row
    /// first, to the picture of the scene with the top row first.
    ///
    /// No other code of the project flips OpenGL's images.
    pub(super) fn flip_back(self, image: &mut [u8], width: usize) {
        let (pixels, _) = image.as_chunks_mut::<3>();
        match (self.swaps_left_right, self.swaps_top_bottom) {
            (false, true) => {}
            (true, false) => pixels.reverse(),
            (false, false) => reverse_rows(pixels, width),
            (true, true) => pixels.chunks_exact_mut(width).for_each(<[_]>::reverse),
        }
    }
}

fn reverse_rows(pixels: &mut [[u8; 3]], width: usize) {
    let rows = pixels.len() / width;
    for top in 0..rows / 2 {
        let (upper, lower) = pixels.split_at_mut((rows - 1 - top) * width);
        upper[top * width..][..width].swap_with_slice(&mut lower[..width]);
    }
}

impl Renderer {
    /// Reflects MuJoCo's scene in the planes through the camera's axis that `mirror` names.
    pub(super) fn reflect_scene(
        &mut self,
        model: &Model,
        mirror: RenderMirror,
    ) -> Result<(), RenderError> {
        if mirror == RenderMirror::default() {
            return Ok(());
        }
        self.check_shapes(model, mirror)?;
        let scene = &mut *self.scene;
        // SAFETY: a function of two plain values; the scene's hold the two eyes.
        let eye = unsafe {
            raw::mjv_averageCamera(&raw const scene.camera[0], &raw const scene.camera[1])
        };
        let planes = [
            (mirror.swaps_left_right, cross(eye.forward, eye.up)),
            (mirror.swaps_top_bottom, eye.up),
        ];
        for normal in planes.into_iter().filter_map(|(flips, normal)| flips.then_some(normal)) {
            for light in &mut scene.lights[..scene.nlight as usize] {
                reflect(&mut light.dir, [0.0; 3], normal);
                reflect(&mut light.pos, eye.pos, normal);
            }
            // SAFETY: MuJoCo has filled `ngeom` entries of the array, and nobody else holds a view
            // of it.
            let geoms =
                unsafe { std::slice::from_raw_parts_mut(scene.geoms, scene.ngeom as usize) };
            for geom in geoms {
                reflect_geom(geom, eye.pos, normal);
            }
        }
        Ok(())
    }

    /// Rejects geoms of the scene that are not mirror-symmetric: no motion brings them to their
    /// mirror image.
    fn check_shapes(&self, model: &Model, mirror: RenderMirror) -> Result<(), RenderError> {
        let asymmetric = |geom: &&raw::mjvGeom| {
            !MIRROR_SYMMETRIC.contains(&geom.type_.cast_unsigned())
                // SAFETY: MuJoCo made the model, and nobody writes to it.
                || unsafe { releases::is_textured(geom, model.as_raw()) }
        };
        let skins = self.scene.nskin as usize;
        let geom = self.geoms().iter().find(asymmetric).filter(|_| mirror.reverses_orientation());
        match geom {
            Some(geom) => {
                Err(RenderError::NotMirrorSymmetric { what: "geom", index: geom.objid as usize })
            }
            None if skins > 0 => Err(RenderError::NotMirrorSymmetric { what: "skin", index: 0 }),
            None => Ok(()),
        }
    }
}

/// Types of geoms that are symmetric in any plane through their axes.
const MIRROR_SYMMETRIC: [raw::mjtGeom; 6] = [
    raw::mjGEOM_PLANE,
    raw::mjGEOM_SPHERE,
    raw::mjGEOM_CAPSULE,
    raw::mjGEOM_ELLIPSOID,
    raw::mjGEOM_CYLINDER,
    raw::mjGEOM_BOX,
];

/// Moves a geom to the pose of its mirror image.
fn reflect_geom(geom: &mut raw::mjvGeom, point: [f32; 3], normal: [f32; 3]) {
    reflect(&mut geom.pos, point, normal);
    for axis in 0..3 {
        let mut column = [0, 3, 6].map(|row| geom.mat[row + axis]);
        reflect(&mut column, [0.0; 3], normal);
        // the geom is symmetric across its x axis, so reversing that axis makes the frame
        // right-handed again without changing the shape
        let sign = if axis == 0 { -1.0 } else { 1.0 };
        for (row, value) in column.into_iter().enumerate() {
            geom.mat[3 * row + axis] = sign * value;
        }
    }
}

/// Reflects the point `value` in the plane through `point` with the given normal. The result is
/// exact if the plane contains the origin and is perpendicular to an axis.
fn reflect(value: &mut [f32; 3], point: [f32; 3], normal: [f32; 3]) {
    let height: f32 = (0..3).map(|i| (value[i] - point[i]) * normal[i]).sum();
    for i in 0..3 {
        value[i] -= 2.0 * height * normal[i];
    }
}

fn cross(a: [f32; 3], b: [f32; 3]) -> [f32; 3] {
    [a[1] * b[2] - a[2] * b[1], a[2] * b[0] - a[0] * b[2], a[0] * b[1] - a[1] * b[0]]
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn pictures_are_turned_back() {
        // bottom row first: 1 2 / 3 4 / 5 6 seen from above is 5 6 / 3 4 / 1 2
        let drawn: Vec<u8> = (1..=6).flat_map(|pixel| [pixel; 3]).collect();
        for (columns, rows, expected) in [
            (false, false, [5, 6, 3, 4, 1, 2]),
            (true, false, [6, 5, 4, 3, 2, 1]),
            (false, true, [1, 2, 3, 4, 5, 6]),
            (true, true, [2, 1, 4, 3, 6, 5]),
        ] {
            let mut image = drawn.clone();
            RenderMirror { swaps_left_right: columns, swaps_top_bottom: rows }
                .flip_back(&mut image, 2);
            let expected: Vec<u8> = expected.into_iter().flat_map(|pixel| [pixel; 3]).collect();
            assert_eq!(image, expected, "columns {columns}, rows {rows}");
        }
    }

    #[test]
    fn reflecting_twice_changes_nothing_and_once_keeps_the_plane() {
        let (point, normal) = ([0.5, -1.0, 2.0], [0.6, 0.0, 0.8]);
        let start = [0.25, 3.0, -1.5];
        let mut value = start;
        reflect(&mut value, point, normal);
        let height = |v: [f32; 3]| (0..3).map(|i| (v[i] - point[i]) * normal[i]).sum::<f32>();
        assert!((height(value) + height(start)).abs() < 1e-6);
        reflect(&mut value, point, normal);
        assert!((0..3).all(|i| (value[i] - start[i]).abs() < 1e-6), "{value:?}");
    }
}
