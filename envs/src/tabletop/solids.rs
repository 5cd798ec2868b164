//! What is to be seen on a table, as shapes: for programs that draw it themselves.

use glam::{DMat3, DVec3};
use mujoco::Shape;

use crate::renderer::ARM_GEOM_GROUP;

use super::TableTop;

/// Groups of geoms that pictures show: tables and objects, and the arm. Collision shapes and marks
/// are in others.
const SHOWN: std::ops::RangeInclusive<usize> = 0..=ARM_GEOM_GROUP;

/// A shape of one colour and where it is.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Solid<'a> {
    /// Its name in the scene, which no other has; geoms of a scene from outside may have none.
    pub name: Option<&'a str>,
    /// The shape, in its own frame (metres).
    pub shape: Shape,
    /// Where its centre is (metres, world frame).
    pub position: DVec3,
    /// Its x, y and z axis in the world, as columns.
    pub axes: DMat3,
    /// Red, green, blue and opacity in `[0, 1]`.
    pub rgba: [f32; 4],
    /// Whether it belongs to the arm or the gripper.
    pub is_arm: bool,
}

impl TableTop {
    /// Every ball, capsule, cylinder and box that a camera may see, in the scene's order. The floor,
    /// a plane, is none of them.
    pub fn solids(&self) -> impl Iterator<Item = Solid<'_>> {
        let (data, model) = (&self.data, self.data.model());
        model.geoms().filter_map(move |geom| {
            let group = model.geom_group(geom);
            SHOWN.contains(&group).then_some(())?;
            Some(Solid {
                name: model.name(geom),
                shape: model.geom_shape(geom)?,
                position: DVec3::from_array(data.geom_position(geom)),
                axes: DMat3::from_cols_array_2d(&data.geom_axes(geom)),
                rgba: model.geom_rgba(geom),
                is_arm: group == ARM_GEOM_GROUP,
            })
        })
    }
}
