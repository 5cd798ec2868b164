//! Inertias for simulation, which must be those of rigid bodies.

use std::f64::consts::PI;

use glam::{DMat3, DVec3};

use crate::capsule::{PlacedShape, Shape};
use crate::description::{Description, Inertia};
use crate::error::DescriptionError;
use crate::pose::Pose;

/// Smallest mass of a body (kg).
const LEAST_MASS: f64 = 1e-6;
/// Smallest principal inertia of a body (kg m^2).
const LEAST_INERTIA: f64 = 1e-12;
/// Tolerance of the triangle inequality, relative to the trace, because files round their numbers.
const ROUNDING: f64 = 1e-6;
/// Density (kg/m^3) of a body whose mass is estimated from its shapes: that of water, as in MuJoCo.
const DENSITY: f64 = 1000.0;
/// Reason for which a body without mass is rejected.
const NO_MASS: &str = "it has no mass";
/// Estimated inertia of a body without shapes: one gram, a few centimetres across.
const SMALL: Inertia = Inertia {
    mass: 1e-3,
    centre: DVec3::ZERO,
    tensor: DMat3::from_cols(
        DVec3::new(1e-6, 0.0, 0.0),
        DVec3::new(0.0, 1e-6, 0.0),
        DVec3::new(0.0, 0.0, 1e-6),
    ),
};

impl Description {
    /// Returns the inertias of the links for a simulation, and notes on repairs.
    ///
    /// Where a link that a joint moves has no inertia, or a link that is fixed to it has an
    /// impossible one, the links that are fixed to each other get one inertia together. If that is
    /// impossible, too, it is an error or, with `repair`, an estimate. Links that are fixed to the
    /// world need none.
    pub(crate) fn simulated_inertias(
        &self,
        repair: bool,
    ) -> (Vec<Option<Inertia>>, Vec<String>, Vec<DescriptionError>) {
        let bodies = self.rigid_bodies();
        let mut inertias: Vec<_> = self.links.iter().map(|link| link.inertia).collect();
        let (mut notes, mut errors) = (Vec::new(), Vec::new());
        let frames = self.frames_in_bodies();
        for body in (0..bodies.len()).filter(|&link| bodies[link] == link) {
            let members = (body..bodies.len()).filter(|&link| bodies[link] == body);
            let members: Vec<usize> = members.collect();
            let own = members.iter().map(|&link| inertias[link]);
            let sound: Result<Vec<_>, _> = own.map(|own| own.map(physical).transpose()).collect();
            let is_frame = body > 0 && inertias[body].is_none();
            if let (Ok(sound), false) = (sound, is_frame) {
                members.iter().zip(sound).for_each(|(&link, sound)| inertias[link] = sound);
                continue;
            }
            let placed = members.iter().filter_map(|&l| Some(inertias[l]?.placed(&frames[l])));
            let whole = sum(placed);
            members.iter().for_each(|&link| inertias[link] = None);
            if body == 0 {
                continue;
            }
            let name = &self.links[body].name;
            inertias[body] = match whole.map_or(Err(NO_MASS), physical) {
                Ok(whole) => Some(whole),
                Err(_) if repair => {
                    let shapes = members.iter().flat_map(|&link| {
                        let shapes = self.links[link].shapes.iter();
                        let frame = frames[link];
                        shapes.map(move |shape| solid(shape).placed(&(frame * shape.pose)))
                    });
                    let (inertia, note) = repaired(whole, sum(shapes));
                    notes.push(format!("the link `{name}` {note}"));
                    Some(inertia)
                }
                Err(NO_MASS) => {
                    let (link, joint) = (name.clone(), self.joints[body - 1].name.clone());
                    errors.push(DescriptionError::MissingInertia { link, joint });
                    None
                }
                Err(reason) => {
                    let (link, tensor) = (name.clone(), whole.unwrap_or(SMALL).tensor);
                    let [x, y, z] = [tensor.x_axis, tensor.y_axis, tensor.z_axis];
                    let tensor = [x.x, y.y, z.z, x.y, x.z, y.z];
                    errors.push(DescriptionError::Inertia { link, tensor, reason });
                    None
                }
            };
        }
        (inertias, notes, errors)
    }

    /// Returns the robot with masses and inertias that can be simulated, and notes on them.
    pub(crate) fn repaired(mut self) -> Self {
        let (inertias, notes, _) = self.simulated_inertias(true);
        self.links.iter_mut().zip(inertias).for_each(|(link, inertia)| link.inertia = inertia);
        self.notes.extend(notes);
        self
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

    /// Returns the pose of each link in the frame of the first of the links that are fixed to it.
    fn frames_in_bodies(&self) -> Vec<Pose> {
        let mut frames = vec![Pose::IDENTITY];
        for joint in &self.joints {
            let fixed = frames[joint.parent] * joint.origin;
            frames.push(joint.motion.map_or(fixed, |_| Pose::IDENTITY));
        }
        frames
    }
}

impl Inertia {
    /// Returns the inertia of a body that is at `pose`.
    fn placed(&self, pose: &Pose) -> Self {
        let turn = DMat3::from_quat(pose.rotation);
        let tensor = turn * self.tensor * turn.transpose();
        Self { mass: self.mass, centre: pose.point(self.centre), tensor }
    }

    /// Returns the inertia of two bodies that are fixed to each other.
    fn joined(self, other: Self) -> Self {
        let mass = self.mass + other.mass;
        let centre =
            (self.mass * self.centre + other.mass * other.centre) / mass.max(f64::MIN_POSITIVE);
        // parallel axes
        let about = |body: Self| {
            let way = body.centre - centre;
            let outer = DMat3::from_cols(way.x * way, way.y * way, way.z * way);
            body.tensor + body.mass * (identity(way.length_squared()) - outer)
        };
        Self { mass, centre, tensor: about(self) + about(other) }
    }
}

fn sum(bodies: impl Iterator<Item = Inertia>) -> Option<Inertia> {
    bodies.reduce(Inertia::joined)
}

fn identity(scale: f64) -> DMat3 {
    DMat3::from_diagonal(DVec3::splat(scale))
}

/// Returns the inertia of a box of water around a shape, in the shape's frame.
fn solid(placed: &PlacedShape) -> Inertia {
    let half = match placed.shape {
        Shape::Sphere { radius } => DVec3::splat(radius),
        Shape::Capsule { radius, length } => DVec3::new(radius, radius, radius + 0.5 * length),
        Shape::Cylinder { radius, length } => DVec3::new(radius, radius, 0.5 * length),
        Shape::Box { half } => half,
    };
    let mass = DENSITY * 8.0 * half.element_product();
    let squares = half * half;
    let tensor = DMat3::from_diagonal(mass / 3.0 * (DVec3::splat(squares.element_sum()) - squares));
    Inertia { mass, centre: DVec3::ZERO, tensor }
}

/// Returns a possible inertia in place of that of a body, and a note. `shapes` is the estimate from
/// the shapes.
fn repaired(whole: Option<Inertia>, shapes: Option<Inertia>) -> (Inertia, String) {
    let Some(whole) = whole.filter(|whole| whole.mass >= LEAST_MASS) else {
        let inertia = shapes.and_then(|shapes| physical(shapes).ok()).unwrap_or(SMALL);
        return (inertia, format!("has no mass; {:.3} kg are assumed", inertia.mass));
    };
    let mean = trace(&whole.tensor) / 3.0;
    // of a ball of water, where the file gives no inertia at all
    let radius = (whole.mass / (DENSITY * 4.0 / 3.0 * PI)).cbrt();
    let moment = if mean > LEAST_INERTIA { mean } else { 0.4 * whole.mass * radius * radius };
    let note = format!(
        "has an inertia that no rigid body can have; {moment:.3e} kg m^2 about all axes is assumed"
    );
    (Inertia { tensor: identity(moment), ..whole }, note)
}

fn trace(tensor: &DMat3) -> f64 {
    tensor.x_axis.x + tensor.y_axis.y + tensor.z_axis.z
}

/// Checks that the mass and all principal inertias are positive and none exceeds the sum of the
/// others (the triangle inequality). Returns the inertia, corrected if rounding violates the
/// inequality.
///
/// The triangle inequality holds exactly where the second moment of mass, half the trace times the
/// identity less the inertia, has no negative eigenvalue (Wensing, Kim, Slotine 2018, "Linear
/// matrix inequalities for physically consistent inertial parameter identification", section III).
fn physical(inertia: Inertia) -> Result<Inertia, &'static str> {
    if inertia.mass < LEAST_MASS {
        return Err(NO_MASS);
    }
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
        for (moments, holds) in [
            ([1.0, 1.0, 1.0], true),
            ([1.0, 2.0, 2.9], true),
            // a thin plate
            ([1.0, 1.0, 2.0], true),
            ([1.0, 1.0, 2.01], false),
            ([5.0, 1.0, 1.0], false),
            ([-1.0, 1.0, 1.0], false),
            ([-1.0, -1.0, -1.0], false),
            ([0.0, 1.0, 1.0], false),
        ] {
            let own = DMat3::from_diagonal(DVec3::from_array(moments));
            let inertia = Inertia { tensor: turn * own * turn.transpose(), ..SMALL };
            assert_eq!(physical(inertia).is_ok(), holds, "{moments:?}");
            assert!(physical(repaired(Some(inertia), None).0).is_ok(), "{moments:?}");
        }
    }

    /// Two halves of a box, joined, are the box.
    #[test]
    fn halves_make_a_whole() {
        let pose = Pose::from_xyz_rpy([0.3, -0.1, 0.2], [0.5, 1.0, -2.0]);
        let solid = |x: f64, half: DVec3| {
            let own = solid(&PlacedShape { pose: Pose::IDENTITY, shape: Shape::Box { half } });
            own.placed(&(pose * Pose::at(x * DVec3::X)))
        };
        let half = DVec3::new(0.1, 0.2, 0.3);
        let whole = solid(0.0, half.with_x(0.2));
        let joined = solid(-0.1, half).joined(solid(0.1, half));
        assert!((whole.mass - joined.mass).abs() < 1e-12 && (whole.mass - 96.0).abs() < 1e-12);
        assert!(whole.centre.distance(joined.centre) < 1e-12);
        assert!(whole.tensor.abs_diff_eq(joined.tensor, 1e-12), "{whole:?} {joined:?}");
    }
}
