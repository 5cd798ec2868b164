//! Inertias for simulation, which must be those of rigid bodies.

use std::f64::consts::PI;

use glam::{DMat3, DVec3};

use crate::capsule::Capsule;
use crate::description::{Inertia, Link, RobotDescription};
use crate::error::{DescriptionError, FROM_ZERO, check_numbers, is_bounded_from_zero, require};
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

/// Finding about a link whose inertia in the file cannot be simulated as it is.
pub(crate) struct InertiaFinding {
    /// Index of the link.
    pub(crate) link: usize,
    /// Error of simulating the link without a repair; `None` where none is needed.
    pub(crate) error: Option<DescriptionError>,
    /// Inertia that is used instead.
    pub(crate) note: String,
}

impl RobotDescription {
    /// Returns the links' inertias for a simulation, and a finding for each that is not the file's.
    ///
    /// A link that a joint moves, or one that is fixed to it, must have a mass, and links that move
    /// must have possible inertias.
    pub(crate) fn simulated_inertias(&self) -> (Vec<Option<Inertia>>, Vec<InertiaFinding>) {
        let bodies = self.rigid_bodies();
        let mut findings = Vec::new();
        let inertia = |(link, stated): (usize, &Link)| {
            let mut members = self.links.iter().zip(&bodies).filter(|(_, body)| **body == link);
            let is_massless =
                link > 0 && bodies[link] == link && members.all(|(member, _)| mass(member) == 0.0);
            let name = &stated.name;
            let mut find = |error, problem: &str| {
                let note = format!("`<inertial>` of the link `{name}`: {problem}");
                findings.push(InertiaFinding { link, error, note });
            };
            if is_massless {
                let estimate = estimated(stated);
                let joint = self.joints[link - 1].name.clone();
                let error = DescriptionError::MissingInertia { link: name.clone(), joint };
                find(Some(error), &format!("no mass, so {:.3} kg is assumed", estimate.mass));
                return Some(estimate);
            }
            let own = stated.inertia?;
            if mass(stated) == 0.0 {
                find(None, "ignored, because its mass is below a milligram");
                return None;
            }
            match physical(own) {
                Ok(inertia) if inertia == own => Some(own),
                Ok(inertia) => {
                    let reason = "because it barely meets the triangle inequality";
                    find(None, &format!("enlarged by 4e-6 of its trace, {reason}"));
                    Some(inertia)
                }
                Err(reason) if bodies[link] == 0 => {
                    find(None, &format!("ignored, because {reason}; the link does not move"));
                    None
                }
                Err(reason) => {
                    let mean = trace(&own.tensor) / 3.0;
                    let is_possible = mean > LEAST_INERTIA;
                    let moment = if is_possible { mean } else { INERTIA_PER_MASS * own.mass };
                    let error = impossible(name, &own.tensor, reason);
                    let assumed = format!("{moment:.3e} kg m^2 about all axes is assumed");
                    find(Some(error), &format!("{reason}, so {assumed}"));
                    Some(Inertia { tensor: identity(moment), ..own })
                }
            }
        };
        let mut inertias = self.links.iter().enumerate().map(inertia).collect::<Vec<_>>();
        for link in (1..bodies.len()).filter(|&link| bodies[link] == link) {
            findings.extend(self.bring_mass_near(link, &bodies, &mut inertias));
        }
        (inertias, findings)
    }

    /// Gives a moving link the inertia of the next link of its rigid body that has one, if neither
    /// it nor a link fixed to it directly does: MuJoCo 2.2.2 looks for mass no further. Returns the
    /// finding about it.
    fn bring_mass_near(
        &self,
        link: usize,
        bodies: &[usize],
        inertias: &mut [Option<Inertia>],
    ) -> Option<InertiaFinding> {
        let owner =
            (link..bodies.len()).find(|&of| bodies[of] == link && inertias[of].is_some())?;
        let is_near = |of: usize| of == link || self.joints[of - 1].parent == link;
        if (link..bodies.len())
            .any(|of| bodies[of] == link && is_near(of) && inertias[of].is_some())
        {
            return None;
        }
        let mut pose = Pose::IDENTITY;
        let mut ancestor = owner;
        while ancestor != link {
            let joint = &self.joints[ancestor - 1];
            (pose, ancestor) = (joint.origin * pose, joint.parent);
        }
        inertias[link] = inertias[owner].take().map(|own| own.in_frame(&pose));
        let [from, to] = [owner, link].map(|of| &self.links[of].name);
        let note = format!(
            "`<inertial>` of the link `{from}`: simulated as part of the link `{to}`, to which it \
             is fixed by links without mass"
        );
        Some(InertiaFinding { link: owner, error: None, note })
    }

    /// Returns, for each link, the first link of the rigid body that it belongs to.
    pub(crate) fn rigid_bodies(&self) -> Vec<usize> {
        let mut bodies = vec![0];
        for (index, joint) in self.joints.iter().enumerate() {
            let fixed_to = bodies[joint.parent];
            bodies.push(joint.motion.map_or(fixed_to, |_| index + 1));
        }
        bodies
    }
}

/// Rejects the inertia of the link `name` if its numbers could not be in a URDF, or if it counts
/// and no rigid body has it.
pub(crate) fn check_inertia(name: &str, inertia: &Inertia) -> Result<(), DescriptionError> {
    let Inertia { mass, centre_of_mass, tensor } = inertia;
    let place = || format!("the link `{name}`");
    require(is_bounded_from_zero(*mass), place, "its mass", *mass, FROM_ZERO)?;
    check_numbers(place, "its centre of mass", &centre_of_mass.to_array())?;
    check_numbers(place, "its inertia", &tensor.to_cols_array())?;
    if *mass < LEAST_MASS {
        return Ok(());
    }
    if !tensor.abs_diff_eq(tensor.transpose(), ROUNDING * trace(tensor).abs()) {
        return Err(impossible(name, tensor, "its matrix is not symmetric"));
    }
    physical(*inertia).map(|_| ()).map_err(|reason| impossible(name, tensor, reason))
}

/// Returns the error of a link with an inertia that no rigid body has.
fn impossible(name: &str, tensor: &DMat3, reason: &'static str) -> DescriptionError {
    let [x, y, z] = tensor.to_cols_array_2d();
    let components = [x[0], y[1], z[2], x[1], x[2], y[2]];
    DescriptionError::InvalidInertia { link: name.to_owned(), tensor: components, reason }
}

fn mass(link: &Link) -> f64 {
    link.inertia.map(|inertia| inertia.mass).filter(|mass| *mass >= LEAST_MASS).unwrap_or(0.0)
}

fn estimated(link: &Link) -> Inertia {
    let capsules = link.shapes.iter().flat_map(|of| of.enclosing_capsules(&Pose::IDENTITY));
    let masses = capsules.map(|Capsule { ends: [start, end], radius }| {
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
fn physical(inertia: Inertia) -> Result<Inertia, &'static str> {
    let tensor = inertia.tensor;
    let trace = trace(&tensor);
    let rounding = ROUNDING * trace;
    let second = identity(0.5 * trace) - tensor;
    if !is_positive(&(tensor - identity(LEAST_INERTIA))) {
        return Err("a principal inertia is below 1e-12");
    }
    if !is_positive(&(second + identity(rounding))) {
        return Err("a principal inertia exceeds the sum of the others");
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
