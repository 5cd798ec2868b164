//! Masses and inertias of links, and checks that a rigid body can have them.

use glam::{DMat3, DVec3};

use super::origin;
use crate::description::{Inertia, RobotDescription};
use crate::error::DescriptionError;
use crate::error::{check_numbers, require};

/// Smallest mass of a link with mass (kg).
const LEAST_MASS: f64 = 1e-6;
/// Smallest principal inertia of a link with mass (kg m^2).
const LEAST_INERTIA: f64 = 1e-12;
/// Tolerance of the triangle inequality, relative to the trace, because files round their numbers.
const ROUNDING: f64 = 1e-6;

/// Reads the mass and inertia of a link. `None` if it has no `<inertial>`.
pub(super) fn inertia(link: &urdf_rs::Link) -> Result<Option<Inertia>, DescriptionError> {
    let stated = &link.inertial;
    let place = || format!("inertial of link `{}`", link.name);
    let (mass, what) = (stated.mass.value, "the mass");
    check_numbers(place, what, &[mass])?;
    let own = tensor(&stated.inertia);
    check_numbers(place, "the inertia", &own.to_cols_array())?;
    let pose = origin(place, &stated.origin)?;
    // `urdf-rs` reads a missing `<inertial>` as zeros
    if mass == 0.0 && own == DMat3::ZERO {
        return Ok(None);
    }
    let holds = mass >= LEAST_MASS;
    require(holds, place, what, mass, "a milligram or more")?;
    let own = physical(&link.name, own)?;
    let turn = DMat3::from_quat(pose.rotation);
    Ok(Some(Inertia { mass, centre_of_mass: pose.position, tensor: turn * own * turn.transpose() }))
}

fn tensor(stated: &urdf_rs::Inertia) -> DMat3 {
    let [xx, yy, zz] = [stated.ixx, stated.iyy, stated.izz];
    let [xy, xz, yz] = [stated.ixy, stated.ixz, stated.iyz];
    DMat3::from_cols_array(&[xx, xy, xz, xy, yy, yz, xz, yz, zz])
}

/// Checks that all principal inertias are positive and none exceeds the sum of the others (the
/// triangle inequality). Returns the tensor, corrected if rounding violates the inequality.
///
/// The triangle inequality holds exactly where the second moment of mass, half the trace times the
/// identity less the inertia, has no negative eigenvalue (Wensing, Kim, Slotine 2018, "Linear
/// matrix inequalities for physically consistent inertial parameter identification", section III).
fn physical(link: &str, tensor: DMat3) -> Result<DMat3, DescriptionError> {
    let identity = |scale: f64| DMat3::from_diagonal(DVec3::splat(scale));
    let trace = tensor.x_axis.x + tensor.y_axis.y + tensor.z_axis.z;
    let rounding = ROUNDING * trace;
    let second = identity(0.5 * trace) - tensor;
    let reason = "a principal inertia is below 1e-12";
    refuse_unless(is_positive(&(tensor - identity(LEAST_INERTIA))), link, &tensor, reason)?;
    let excess = "a principal inertia exceeds the sum of the others";
    refuse_unless(is_positive(&(second + identity(rounding))), link, &tensor, excess)?;
    let sound = is_positive(&(second - identity(rounding)));
    // a multiple of the identity adds twice as much to two of three as to the third
    Ok(if sound { tensor } else { tensor + identity(4.0 * rounding) })
}

/// Rejects links without mass that a joint moves: MuJoCo cannot simulate them.
pub(super) fn check_moving(description: &RobotDescription) -> Result<(), DescriptionError> {
    let carried = description.joints.iter().zip(&description.links[1..]);
    let mut moved = carried.filter(|(joint, _)| joint.motion.is_some());
    match moved.find(|(_, link)| link.inertia.is_none()) {
        None => Ok(()),
        Some((joint, link)) => Err(DescriptionError::MissingInertia {
            link: link.name.clone(),
            joint: joint.name.clone(),
        }),
    }
}

fn refuse_unless(
    holds: bool,
    link: &str,
    tensor: &DMat3,
    reason: &'static str,
) -> Result<(), DescriptionError> {
    if holds {
        return Ok(());
    }
    let [x, y, z] = [tensor.x_axis, tensor.y_axis, tensor.z_axis];
    Err(DescriptionError::InvalidInertia {
        link: link.to_owned(),
        tensor: [x.x, y.y, z.z, x.y, x.z, y.z],
        reason,
    })
}

/// Returns `true` if a symmetric matrix is positive definite (Sylvester's criterion).
fn is_positive(matrix: &DMat3) -> bool {
    let [x, y] = [matrix.x_axis, matrix.y_axis];
    x.x > 0.0 && x.x * y.y - x.y * y.x > 0.0 && matrix.determinant() > 0.0
}

#[cfg(test)]
mod tests {
    use super::*;

    fn diagonal(x: f64, y: f64, z: f64) -> DMat3 {
        DMat3::from_diagonal(DVec3::new(x, y, z))
    }

    #[test]
    fn the_triangle_inequality_holds_in_any_axes() {
        let turn = DMat3::from_euler(glam::EulerRot::XYZ, 0.4, 1.1, -2.0);
        for (moments, holds) in [
            ((1.0, 1.0, 1.0), true),
            ((1.0, 2.0, 2.9), true),
            // a thin plate
            ((1.0, 1.0, 2.0), true),
            ((1.0, 1.0, 2.01), false),
            ((5.0, 1.0, 1.0), false),
            ((-1.0, 1.0, 1.0), false),
            ((-1.0, -1.0, -1.0), false),
            ((0.0, 1.0, 1.0), false),
        ] {
            let (x, y, z) = moments;
            let tensor = turn * diagonal(x, y, z) * turn.transpose();
            assert_eq!(physical("l", tensor).is_ok(), holds, "{moments:?}");
        }
    }
}
