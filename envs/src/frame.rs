//! Between the canonical frame and the world.

use glam::DVec3;
use symmetry::D2;

/// Maps a point between the canonical and the world frame; every element is its own inverse.
pub(crate) fn map(element: D2, point: DVec3) -> DVec3 {
    let [x, y] = element.apply_xy([point.x, point.y]);
    DVec3::new(x, y, point.z)
}

/// Orientation (w, x, y, z) of an object under `element`: flips along y turn it by half a turn
/// instead of mirroring it, which is the same for objects that are their own mirror image along x.
pub(crate) fn facing(element: D2) -> [f64; 4] {
    if element.flips_y() {
        [0.0, 0.0, 0.0, 1.0]
    } else {
        [1.0, 0.0, 0.0, 0.0]
    }
}
