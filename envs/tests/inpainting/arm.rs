//! Arm and camera of a scene, in the form that in-painting needs.

use envs::{ARM_GEOM_GROUP, Camera, TableTop};
use glam::{DMat3, DVec3};
use inpainting::{ArmLink, GripperMark};
use mujoco::{Data, GeomId, GeomShape, Model};

/// Returns the mark that learners see over the gripper.
pub fn mark(camera: &Camera) -> GripperMark {
    GripperMark {
        outer_radius: camera.mark.radius,
        hole_radius: camera.mark.hole,
        color: camera.mark.color,
        reference_depth: camera.height,
    }
}

/// Links of a model's drawn arm: a capsule around each of its shapes, between two points of the
/// link, and bundles of thin ones around boxes, which a single capsule would exceed by centimetres.
#[derive(Clone, Debug)]
pub struct Arm {
    bones: Vec<Bone>,
    links: Vec<ArmLink>,
}

/// Axis of a capsule in its geom's frame: its middle, its direction and its half length (metres).
#[derive(Clone, Copy, Debug)]
struct Bone {
    geom: GeomId,
    middle: DVec3,
    axis: usize,
    half_length: f64,
}

/// Largest half width of the strips that a box is cut into, along its longest side (metres): half a
/// pixel of a 64-pixel picture.
const STRIP: f64 = 0.004;

impl Arm {
    /// Collects the arm of `model`; an error message for a shape without known capsules.
    pub fn new(model: &Model) -> Result<Self, String> {
        let (mut bones, mut links) = (Vec::new(), Vec::new());
        for geom in model.geoms() {
            if model.geom_group(geom) != ARM_GEOM_GROUP {
                continue;
            }
            let name = model.name_of(geom).unwrap_or("without a name");
            let shape = model.geom_shape(geom).ok_or_else(|| {
                format!("the arm's geom `{name}` is no sphere, capsule, cylinder or box")
            })?;
            for (bone, radius) in around(geom, shape) {
                let joints = [2 * bones.len(), 2 * bones.len() + 1];
                links.push(ArmLink { end_joints: joints, radius });
                bones.push(bone);
            }
        }
        Ok(Self { bones, links })
    }

    /// Returns the links, by index into [`Arm::joints`].
    pub fn links(&self) -> &[ArmLink] {
        &self.links
    }

    /// Returns the ends of the links of `table`'s arm (metres, world frame).
    pub fn joints(&self, table: &TableTop) -> Vec<DVec3> {
        let data = table.simulation();
        self.bones.iter().flat_map(|bone| bone.ends(data)).collect()
    }
}

impl Bone {
    fn ends(&self, data: &Data) -> [DVec3; 2] {
        let axes = data.geom_axes(self.geom).map(DVec3::from_array);
        let place = DVec3::from_array(data.geom_position(self.geom));
        let middle =
            place + DMat3::from_cols_array_2d(&axes.map(|axis| axis.to_array())) * self.middle;
        [-1.0, 1.0].map(|side| middle + side * self.half_length * axes[self.axis])
    }
}

/// Returns capsules that cover a shape, with their radii (metres).
fn around(geom: GeomId, shape: GeomShape) -> Vec<(Bone, f64)> {
    let upright = |half_length, radius| {
        let bone = Bone { geom, middle: DVec3::ZERO, axis: 2, half_length };
        vec![(bone, radius)]
    };
    match shape {
        GeomShape::Sphere { radius } => upright(0.0, radius),
        GeomShape::Capsule { radius, half_length }
        | GeomShape::Cylinder { radius, half_length } => upright(half_length, radius),
        GeomShape::Box { half } => bundle(geom, half),
    }
}

/// Cuts a box into strips along its longest side, and encloses each in a capsule that touches its
/// surface.
fn bundle(geom: GeomId, half: [f64; 3]) -> Vec<(Bone, f64)> {
    let longest = (0..3).max_by(|&a, &b| half[a].total_cmp(&half[b]));
    let axis = longest.unwrap_or(0);
    let across = [(axis + 1) % 3, (axis + 2) % 3];
    let counts = across.map(|side| (half[side] / STRIP).ceil().max(1.0) as usize);
    let widths = [0, 1].map(|i| half[across[i]] / counts[i] as f64);
    let radius = widths[0].hypot(widths[1]);
    let cells = (0..counts[0]).flat_map(|i| (0..counts[1]).map(move |j| [i, j]));
    let outer = cells.filter(|cell| (0..2).any(|i| cell[i] == 0 || cell[i] + 1 == counts[i]));
    let strips = outer.map(|cell| {
        let mut middle = DVec3::ZERO;
        for i in 0..2 {
            middle[across[i]] = (2 * cell[i] + 1) as f64 * widths[i] - half[across[i]];
        }
        let bone = Bone { geom, middle, axis, half_length: half[axis] };
        (bone, radius)
    });
    strips.collect()
}
