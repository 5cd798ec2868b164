//! The arm of this crate's scenes, as in-painting wants it.

use glam::DVec3;
use mujoco::{Data, GeomId, Shape};

use super::limbs::Limb;
use crate::picture::ARM;
use crate::scene::Scene;
use crate::tabletop::TableTop;

/// The links of a scene's arm as it is drawn: a capsule around each of its shapes, between two points of the link.
#[derive(Clone, Debug)]
pub struct Skeleton {
    bones: Vec<Bone>,
    limbs: Vec<Limb>,
}

/// The middle line of a shape: the geom's axis and how far it reaches to either side of the middle (metres).
#[derive(Clone, Copy, Debug)]
struct Bone {
    geom: GeomId,
    axis: usize,
    half_length: f64,
}

impl Skeleton {
    /// The skeleton of `scene`'s embodiment.
    pub fn new(scene: &Scene) -> Self {
        let model = &scene.model;
        let arm = model.geoms().filter(|&geom| model.geom_group(geom) == ARM);
        let capsules = arm.filter_map(|geom| Some((geom, around(model.geom_shape(geom)?))));
        let (bones, radii): (Vec<_>, Vec<_>) = capsules
            .map(|(geom, (axis, half_length, radius))| {
                let bone = Bone {
                    geom,
                    axis,
                    half_length,
                };
                (bone, radius)
            })
            .unzip();
        let limbs = radii.into_iter().enumerate().map(|(index, radius)| Limb {
            joints: [2 * index, 2 * index + 1],
            radius,
        });
        Self {
            bones,
            limbs: limbs.collect(),
        }
    }

    /// The links, by index into [`Skeleton::joints`].
    pub fn limbs(&self) -> &[Limb] {
        &self.limbs
    }

    /// Where the ends of the links of `table`'s arm are (metres, world frame).
    pub fn joints(&self, table: &TableTop) -> Vec<DVec3> {
        let data = table.simulation();
        self.bones.iter().flat_map(|bone| bone.ends(data)).collect()
    }
}

impl Bone {
    fn ends(&self, data: &Data) -> [DVec3; 2] {
        let middle = DVec3::from_array(data.geom_position(self.geom));
        let axis = DVec3::from_array(data.geom_axes(self.geom)[self.axis]);
        [-1.0, 1.0].map(|side| middle + side * self.half_length * axis)
    }
}

/// A capsule around a shape: the axis of its frame, half the length of its middle line, and its radius (metres).
fn around(shape: Shape) -> (usize, f64, f64) {
    match shape {
        Shape::Sphere { radius } => (2, 0.0, radius),
        Shape::Capsule {
            radius,
            half_length,
        }
        | Shape::Cylinder {
            radius,
            half_length,
        } => (2, half_length, radius),
        Shape::Box { half } => {
            let longest = (0..3).max_by(|&a, &b| half[a].total_cmp(&half[b]));
            let axis = longest.unwrap_or(0);
            let across: f64 = (0..3)
                .filter(|&i| i != axis)
                .map(|i| half[i] * half[i])
                .sum();
            (axis, half[axis], across.sqrt())
        }
    }
}
