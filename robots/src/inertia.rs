//! Inertias for simulation, which must be those of rigid bodies.

use std::f64::consts::PI;

use glam::{DMat3, DVec3};

use crate::capsule::Capsule;
use crate::description::{Inertia, Link, RobotDescription};
use crate::error::DescriptionError;
use crate::pose::Pose;

/// Smallest mass of a body (kg); a link of less is a frame.
const LEAST_MASS: f64 = 1e-6;
/// Smallest principal inertia of a body (kg m^2).
const LEAST_INERTIA: f64 = 1e-12;
/// Tolerance of the triangle inequality, relative to the trace, because files round their numbers.
const ROUNDING: f64 = 1e-6;
/// Density (kg/m^3) of a body whose mass is estimated from its shapes: that of water, as in MuJoCo.
const DENSITY: f64 = 1000.0;
/// Estimated mass (kg) of a body without shapes.
const SMALL_MASS: f64 = 1e-3;
/// Estimated inertia (m^2) of each kilogram: that of a ball with a radius of 5 cm.
const INERTIA_PER_MASS: f64 = 1e-3;

impl RobotDescription {
    /// Returns the inertias of the links for a simulation, with errors where they are estimates,
    /// each with a note on the estimate.
    ///
    /// A link that a joint moves, or one that is fixed to it, must have a mass, and links that move
    /// must have possible inertias.
    pub(crate) fn simulated_inertias(
        &self,
    ) -> (Vec<Option<Inertia>>, Vec<(DescriptionError, String)>) {
        let bodies = self.rigid_bodies();
        let mut defects = Vec::new();
        let inertia = |(index, stated): (usize, &Link)| {
            let mut members = self.links.iter().zip(&bodies).filter(|(_, body)| **body == index);
            let is_massless =
                index > 0 && bodies[index] == index && members.all(|(l, _)| mass(l) == 0.0);
            let (name, own) = (&stated.name, stated.inertia.filter(|_| mass(stated) > 0.0));
            match own.map(physical).transpose() {
                Ok(None) if is_massless => {
                    let estimate = estimated(stated);
                    let (link, joint) = (name.clone(), self.joints[index - 1].name.clone());
                    let assumed = format!("{:.3} kg are assumed", estimate.mass);
                    let note = format!("the link `{name}` has no mass; {assumed}");
                    defects.push((DescriptionError::MissingInertia { link, joint }, note));
                    Some(estimate)
                }
                Ok(own) => own,
                Err(_) if bodies[index] == 0 => None,
                Err((inertia, reason)) => {
                    let mean = trace(&inertia.tensor) / 3.0;
                    let none = INERTIA_PER_MASS * inertia.mass;
                    let moment = if mean > LEAST_INERTIA { mean } else { none };
                    let [x, y, z] = inertia.tensor.to_cols_array_2d();
                    let tensor = [x[0], y[1], z[2], x[1], x[2], y[2]];
                    let assumed = format!("{moment:.3e} kg m^2 about all axes is assumed");
                    let note = format!("the link `{name}` has an impossible inertia; {assumed}");
                    let link = name.clone();
                    defects.push((DescriptionError::InvalidInertia { link, tensor, reason }, note));
                    Some(Inertia { tensor: identity(moment), ..inertia })
                }
            }
        };
        let inertias = self.links.iter().enumerate().map(inertia).collect();
        (inertias, defects)
    }

    /// Returns, for each link, the first of the links that are fixed to it, itself included.
    pub(crate) fn rigid_bodies(&self) -> Vec<usize> {
        let mut bodies = vec![0];
        for (index, joint) in self.joints.iter().enumerate() {
            let fixed_to = bodies[joint.parent];
            bodies.push(joint.motion.map_or(fixed_to, |_| index + 1));
        }
        bodies
    }
}

/// Returns the mass of a link, or zero for a frame.
fn mass(link: &Link) -> f64 {
    link.inertia.map(|inertia| inertia.mass).filter(|mass| *mass >= LEAST_MASS).unwrap_or(0.0)
}

/// Estimates the inertia of a link from capsules of water around its shapes.
fn estimated(link: &Link) -> Inertia {
    let masses = link.shapes.iter().map(|placed| {
        let Capsule { ends: [start, end], radius } = placed.enclosing_capsule(&Pose::IDENTITY);
        let volume = PI * radius * radius * (start.distance(end) + 4.0 / 3.0 * radius);
        (DENSITY * volume, start.midpoint(end))
    });
    let add = |(mass, moment): (f64, DVec3), (own, centre)| (mass + own, moment + own * centre);
    let (mass, moment) = masses.fold((0.0, DVec3::ZERO), add);
    let (mass, moment) = if mass > LEAST_MASS { (mass, moment) } else { (SMALL_MASS, DVec3::ZERO) };
    Inertia { mass, centre_of_mass: moment / mass, tensor: identity(INERTIA_PER_MASS * mass) }
}

fn identity(scale: f64) -> DMat3 {
    DMat3::from_diagonal(DVec3::splat(scale))
}

fn trace(tensor: &DMat3) -> f64 {
    tensor.x_axis.x + tensor.y_axis.y + tensor.z_axis.z
}

/// Checks that all principal inertias are positive and none exceeds the sum of the others (the
/// triangle inequality). Returns the inertia, corrected if rounding violates the inequality.
///
/// The triangle inequality holds exactly where the second moment of mass, half the trace times the
/// identity less the inertia, has no negative eigenvalue (Wensing, Kim, Slotine 2018, "Linear
/// matrix inequalities for physically consistent inertial parameter identification", section III).
fn physical(inertia: Inertia) -> Result<Inertia, (Inertia, &'static str)> {
    let tensor = inertia.tensor;
    let trace = trace(&tensor);
    let rounding = ROUNDING * trace;
    let second = identity(0.5 * trace) - tensor;
    if !is_positive(&(tensor - identity(LEAST_INERTIA))) {
        return Err((inertia, "a principal inertia is below 1e-12"));
    }
    if !is_positive(&(second + identity(rounding))) {
        return Err((inertia, "a principal inertia exceeds the sum of the others"));
    }
    let sound = is_positive(&(second - identity(rounding)));
    // a multiple of the identity adds twice as much to two of three as to the third
    let tensor = if sound { tensor } else { tensor + identity(4.0 * rounding) };
    Ok(Inertia { tensor, ..inertia })
}

/// Returns `true` if a symmetric matrix is positive definite (Sylvester's criterion).
fn is_positive(matrix: &DMat3) -> bool {
    let [x, y] = [matrix.x_axis, matrix.y_axis];
    x.x > 0.0 && x.x * y.y - x.y * y.x > 0.0 && matrix.determinant() > 0.0
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_triangle_inequality_holds_in_any_axes() {
        let turn = DMat3::from_euler(glam::EulerRot::XYZ, 0.4, 1.1, -2.0);
        // the third is a thin plate
        let possible = [[1.0, 1.0, 1.0], [1.0, 2.0, 2.9], [1.0, 1.0, 2.0]].map(|m| (m, true));
        let excessive = [[1.0, 1.0, 2.01], [5.0, 1.0, 1.0], [0.0, 1.0, 1.0]].map(|m| (m, false));
        let negative = [[-1.0, 1.0, 1.0], [-1.0, -1.0, -1.0]].map(|m| (m, false));
        for (moments, holds) in possible.into_iter().chain(excessive).chain(negative) {
            let own = DMat3::from_diagonal(DVec3::from_array(moments));
            let tensor = turn * own * turn.transpose();
            let inertia = Inertia { mass: 1.0, centre_of_mass: DVec3::ZERO, tensor };
            assert_eq!(physical(inertia).is_ok(), holds, "{moments:?}");
        }
    }
}
