//! Inverse kinematics by damped least squares, for velocities and for poses.

use std::f64::consts::PI;
use std::time::{Duration, Instant};

use glam::{DQuat, DVec3};

use crate::chain::{Chain, ChainJoint};
use crate::description::check_length;
use crate::error::{ControlError, MissedTarget, require_finite};
use crate::pose::{Pose, UNIT_LENGTH, is_unit_length};
use crate::twist::Twist;

/// Solver for the joint velocities that move a tip as wanted, with buffers that are reused.
#[derive(Clone, Debug, PartialEq)]
pub(crate) struct JointVelocitySolver {
    orientation: OrientationConstraint,
    /// Columns of the Jacobian.
    columns: Vec<Twist>,
    /// `true` for joints whose velocity is fixed at a bound.
    held: Vec<bool>,
    velocities: Vec<f64>,
}

impl JointVelocitySolver {
    pub(crate) fn new(joints: usize, orientation: OrientationConstraint) -> Self {
        Self {
            orientation,
            columns: vec![Twist::ZERO; joints],
            held: vec![false; joints],
            velocities: vec![0.0; joints],
        }
    }

    /// Returns the last solution, one velocity for each joint.
    pub(crate) fn joint_velocities(&self) -> &[f64] {
        &self.velocities
    }

    /// Solves for joint velocities within `bounds` that move the tip by `wanted`, which has no
    /// rotation that the orientation leaves free; redundant joints move as `posture` requests.
    ///
    /// With damping `l` it minimises `|J v - wanted|^2 + l^2 |v - posture|^2` (Wampler 1986,
    /// "Manipulator inverse kinematic solutions based on vector formulations and damped
    /// least-squares methods"). The joint that leaves its bounds the most is held at its bound, and
    /// the others are solved again, until all are within (Flacco, De Luca, Khatib 2012, "Motion
    /// control of redundant robots under joint constraints: saturation in the null space").
    pub(crate) fn solve(
        &mut self,
        chain: &Chain,
        configuration: &[f64],
        wanted: Twist,
        damping: f64,
        posture: impl Fn(usize) -> f64,
        bounds: impl Fn(usize) -> [f64; 2],
    ) {
        let tip = chain.jacobian(configuration, &mut self.columns);
        for column in &mut self.columns {
            *column = self.orientation.constrained(&tip, *column);
        }
        self.held.fill(false);
        // each pass holds one more joint, so this many always suffice
        for _ in 0..=self.held.len() {
            self.solve_free(wanted, damping, &posture);
            let Some((joint, bound)) = self.worst_violation(&bounds) else {
                return;
            };
            self.held[joint] = true;
            self.velocities[joint] = bound;
        }
    }

    /// Solves for the joints that are not held.
    fn solve_free(&mut self, wanted: Twist, damping: f64, posture: impl Fn(usize) -> f64) {
        let mut system = [[0.0; 6]; 6];
        let mut rest = wanted;
        for joint in 0..self.held.len() {
            let column = self.columns[joint];
            if !self.held[joint] {
                self.velocities[joint] = posture(joint);
                add_square(&mut system, column);
            }
            rest = rest + -self.velocities[joint] * column;
        }
        // (J J^T + l^2 I) m = rest, then v += J^T m: six equations for any number of joints
        (0..6).for_each(|row| system[row][row] += damping * damping);
        let multipliers = Twist::from(solve(&system, rest.to_array()));
        for joint in (0..self.held.len()).filter(|&joint| !self.held[joint]) {
            self.velocities[joint] += self.columns[joint].dot(&multipliers);
        }
    }

    /// Returns the free joint that is furthest out of its bounds, and the bound that it exceeds.
    /// `None` if all are within their bounds.
    fn worst_violation(&self, bounds: impl Fn(usize) -> [f64; 2]) -> Option<(usize, f64)> {
        let mut worst = None;
        let mut furthest = 0.0;
        for joint in (0..self.held.len()).filter(|&joint| !self.held[joint]) {
            let velocity = self.velocities[joint];
            let [low, high] = bounds(joint);
            let bound = velocity.max(low).min(high);
            if (velocity - bound).abs() > furthest {
                furthest = (velocity - bound).abs();
                worst = Some((joint, bound));
            }
        }
        worst
    }
}

fn add_square(system: &mut [[f64; 6]; 6], column: Twist) {
    let column = column.to_array();
    for (row, left) in system.iter_mut().zip(column) {
        row.iter_mut().zip(column).for_each(|(sum, right)| *sum += left * right);
    }
}

/// Part of a target's orientation that the tip must have.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub enum OrientationConstraint {
    /// All of it.
    #[default]
    Full,
    /// Direction of one axis of the tip, a vector in the tip's frame; rotation about it is free.
    Axis(DVec3),
    /// None of it: the position alone.
    Free,
}

impl OrientationConstraint {
    /// Rejects an [`OrientationConstraint::Axis`] that is zero or not finite.
    pub(crate) fn check(&self) -> Result<(), ControlError> {
        match self {
            Self::Axis(axis) if axis.try_normalize().is_none() => {
                Err(ControlError::InvalidSetting {
                    name: "orientation",
                    value: format!("the axis {axis}"),
                    expected: "a finite axis that is not zero",
                })
            }
            _ => Ok(()),
        }
    }

    /// Returns the error of the tip, without the rotation that is free, as the twist that moves it
    /// to `target` in one second.
    pub fn pose_error(&self, tip: &Pose, target: &Pose) -> Twist {
        let [linear, turn] = tip.displacement_to(target);
        let angular = match self {
            Self::Full => turn,
            Self::Axis(axis) => {
                let [from, to] = [tip, target].map(|of| of.rotation * axis.normalize());
                DQuat::from_rotation_arc(from, to).to_scaled_axis()
            }
            Self::Free => DVec3::ZERO,
        };
        Twist { linear, angular }
    }

    /// Returns `twist` of the tip without the rotation that the constraint leaves free.
    pub(crate) fn constrained(&self, tip: &Pose, twist: Twist) -> Twist {
        let angular = match self {
            Self::Full => twist.angular,
            Self::Axis(axis) => twist.angular.reject_from(tip.rotation * axis.normalize()),
            Self::Free => DVec3::ZERO,
        };
        Twist { angular, ..twist }
    }
}

/// Settings of the inverse kinematics of [`Chain::solve_ik_with_settings`].
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct IkSettings {
    /// Part of the target's orientation that a solution must have.
    pub orientation: OrientationConstraint,
    /// Maximum number of searches, at least 1: one from the seed, and the others from
    /// configurations that are spread over the ranges of the joints, the same ones in every call.
    pub max_searches: usize,
    /// Time after which no further search begins. Results depend on the clock only where this limit
    /// ends the searches.
    pub time_limit: Duration,
}

impl Default for IkSettings {
    fn default() -> Self {
        Self {
            orientation: OrientationConstraint::Full,
            max_searches: 50,
            time_limit: Duration::from_millis(50),
        }
    }
}

impl IkSettings {
    fn check(&self) -> Result<(), ControlError> {
        if self.max_searches == 0 {
            return Err(ControlError::InvalidSetting {
                name: "max_searches",
                value: "0".to_owned(),
                expected: "at least 1 search",
            });
        }
        self.orientation.check()
    }
}

/// Maximum number of iterations of a search from the seed.
const ITERATIONS: usize = 500;
/// Maximum number of iterations of a search from elsewhere.
const RESTART_ITERATIONS: usize = 60;
/// Largest error of the tip (metres, radians) that [`Chain::solve_ik`] accepts.
const PRECISION: f64 = 1e-10;
/// Largest motion of a joint in one iteration (metres, radians).
const MAX_STEP: f64 = 0.3;
/// Fraction of the displacement to the seed by which an iteration moves redundant joints.
const SEED_PULL: f64 = 0.1;
/// Number of iterations with [`SEED_PULL`]; the later ones minimise the error of the tip alone.
const PULLED_ITERATIONS: usize = 100;
/// Damping of [`Chain::solve_ik`] at the target; half of the squared error is added to its square
/// (Sugihara 2011, "Solvability-unconcerned inverse kinematics by the Levenberg-Marquardt method").
const LEAST_DAMPING: f64 = 1e-3;

impl Chain {
    /// Solves the inverse kinematics for a full pose of the tip, with the default settings.
    ///
    /// # Errors
    /// Those of [`Chain::solve_ik_with_settings`].
    ///
    /// # Panics
    /// If `seed` is not as long as the chain.
    pub fn solve_ik(&self, target: &Pose, seed: &[f64]) -> Result<Vec<f64>, ControlError> {
        self.solve_ik_with_settings(target, seed, &IkSettings::default())
    }

    /// Solves the inverse kinematics: a configuration `[len]` within all ranges that brings the tip
    /// to `target`. The first search starts at `seed` and prefers solutions near it.
    ///
    /// # Errors
    /// [`ControlError::NotFinite`], [`ControlError::JointOutOfRange`] for a seed out of range,
    /// [`ControlError::ReversedRange`], [`ControlError::InvalidSetting`], also for a target whose
    /// rotation is no unit quaternion; [`ControlError::OutOfReach`] for a target beyond the length
    /// of the arm, and [`ControlError::NoSolution`] where no search succeeds.
    ///
    /// # Panics
    /// If `seed` is not as long as the chain.
    pub fn solve_ik_with_settings(
        &self,
        target: &Pose,
        seed: &[f64],
        settings: &IkSettings,
    ) -> Result<Vec<f64>, ControlError> {
        let started = Instant::now();
        check_length("seed", seed.len(), self.joints().len());
        check_joint_ranges(self, seed)?;
        settings.check()?;
        let finite = target.position.is_finite() && target.rotation.is_finite();
        require_finite(finite, "the target", format_args!("{target:?}"))?;
        let length = target.rotation.length();
        if !is_unit_length(length) {
            return Err(ControlError::InvalidSetting {
                name: "the length of the target's rotation",
                value: length.to_string(),
                expected: UNIT_LENGTH,
            });
        }
        check_reach(self, target, settings.orientation)?;
        let mut search = Search {
            chain: self,
            target,
            solver: JointVelocitySolver::new(seed.len(), settings.orientation),
        };
        let mut nearest = search.run(seed.to_vec(), ITERATIONS, PULLED_ITERATIONS);
        let mut searches = 1;
        while nearest.0 >= PRECISION
            && searches < settings.max_searches
            && started.elapsed() < settings.time_limit
        {
            let found = search.run(spread(&self.ranges(), seed, searches), RESTART_ITERATIONS, 0);
            searches += 1;
            if found.0 < nearest.0 {
                nearest = found;
            }
        }
        let (error, configuration) = nearest;
        if error < PRECISION {
            return Ok(configuration);
        }
        let miss = tip_miss(self, settings.orientation, &configuration, target);
        Err(ControlError::NoSolution { miss, searches })
    }
}

impl Chain {
    /// Returns configuration `number` of a sequence that is spread evenly over the ranges of the
    /// joints, of each at most half a turn (or as many metres) to either side of the middle. Number
    /// 0 is the middle itself, and zero for joints without limits.
    pub fn quasi_random_configuration(&self, number: usize) -> Vec<f64> {
        let ranges = self.ranges();
        let middle = |range: &Option<[f64; 2]>| range.map_or(0.0, |[low, high]| low.midpoint(high));
        let middle: Vec<f64> = ranges.iter().map(middle).collect();
        if number == 0 { middle } else { spread(&ranges, &middle, number) }
    }

    fn ranges(&self) -> Vec<Option<[f64; 2]>> {
        self.joints().iter().map(|joint| joint.motion.range).collect()
    }

    /// Returns the least of the speeds (m/s) that the tip can reach along the three axes of the
    /// world in `configuration` `[len]`, without turning except where `orientation` leaves it free.
    /// Between the axes it may be slower. Joints without maximum speed count as infinitely fast.
    ///
    /// # Panics
    /// If `configuration` is not as long as the chain.
    pub fn slowest_axis_tip_speed(
        &self,
        configuration: &[f64],
        orientation: OrientationConstraint,
    ) -> f64 {
        let mut solver = JointVelocitySolver::new(configuration.len(), orientation);
        let mut columns = vec![Twist::ZERO; configuration.len()];
        let tip = self.jacobian(configuration, &mut columns);
        let speeds = DVec3::AXES.map(|axis| {
            let wanted = Twist::from_linear(axis);
            let free = [f64::NEG_INFINITY, f64::INFINITY];
            solver.solve(self, configuration, wanted, LEAST_DAMPING, |_| 0.0, |_| free);
            let velocities = solver.joint_velocities();
            let parts = columns.iter().zip(velocities);
            let reached = parts.fold(Twist::ZERO, |sum, (&column, &v)| sum + v * column);
            let lost = orientation.constrained(&tip, reached) + -1.0 * wanted;
            let used = self.joints().iter().zip(velocities).map(|(joint, velocity)| {
                joint.motion.max_speed.map_or(0.0, |speed| velocity.abs() / speed)
            });
            // a direction in which the tip cannot move is none in which it has a speed
            if lost.dot(&lost) > LOST * LOST { 0.0 } else { 1.0 / used.fold(0.0, f64::max) }
        });
        speeds.into_iter().fold(f64::INFINITY, f64::min)
    }
}

/// Part of a motion that may be lost where a tip counts as able to follow it.
const LOST: f64 = 0.05;

/// Search for a configuration that brings the tip of a chain to a target.
struct Search<'a> {
    chain: &'a Chain,
    target: &'a Pose,
    solver: JointVelocitySolver,
}

impl Search<'_> {
    /// Searches from a configuration, in the first `pulled` iterations for one near it. Returns the
    /// remaining error of the tip, the larger one of distance (metres) and angle (radians), and the
    /// last configuration.
    fn run(
        &mut self,
        mut configuration: Vec<f64>,
        iterations: usize,
        pulled: usize,
    ) -> (f64, Vec<f64>) {
        let joints = self.chain.joints();
        let start = configuration.clone();
        let mut iteration = 0;
        loop {
            let error = self
                .solver
                .orientation
                .pose_error(&self.chain.tip_pose(&configuration), self.target);
            let size = error.linear.length().max(error.angular.length());
            if size < PRECISION || iteration == iterations {
                return (size, configuration);
            }
            let damping = (0.5 * error.dot(&error) + LEAST_DAMPING * LEAST_DAMPING).sqrt();
            let bounds = |joint: usize| {
                let [low, high] = range_margins(&joints[joint], configuration[joint]);
                [low.max(-MAX_STEP), high.min(MAX_STEP)]
            };
            let pull = if iteration < pulled { SEED_PULL } else { 0.0 };
            let posture = |joint: usize| pull * (start[joint] - configuration[joint]);
            self.solver.solve(self.chain, &configuration, error, damping, posture, bounds);
            step_joints(joints, &mut configuration, self.solver.joint_velocities(), 1.0);
            iteration += 1;
        }
    }
}

/// Rejects a target that is farther from the base of the chain than the links are long.
fn check_reach(
    chain: &Chain,
    target: &Pose,
    orientation: OrientationConstraint,
) -> Result<(), ControlError> {
    let (base, to_last) = chain.reach_bound();
    let tip = chain.tip_in_last_joint();
    let (part, point, reach) = if orientation == OrientationConstraint::Full {
        let turn = target.rotation * tip.rotation.conjugate();
        ("last joint", target.position - turn * tip.position, to_last)
    } else {
        ("tip", target.position, to_last + tip.position.length())
    };
    let distance = point.distance(base);
    if distance <= reach + REACH_TOLERANCE * (1.0 + reach) {
        return Ok(());
    }
    Err(ControlError::OutOfReach { target: target.position, part, distance, reach })
}

/// Relative rounding of a distance that still counts as within reach.
const REACH_TOLERANCE: f64 = 1e-9;

/// Returns configuration `number`, from 1, of a sequence that is spread evenly over `ranges`, of
/// each the stretch of at most one turn (or as many metres) that is centred on the seed as far as
/// the limits allow.
///
/// Point `number` of Roberts' sequence with the powers of 1/g, where g^(d + 1) = g + 1 for d joints
/// (Roberts 2018, "The unreasonable effectiveness of quasirandom sequences").
pub(crate) fn spread(ranges: &[Option<[f64; 2]>], seed: &[f64], number: usize) -> Vec<f64> {
    let dimension = seed.len() as f64;
    let g = (0..50).fold(2.0_f64, |g, _| (1.0 + g).powf(1.0 / (dimension + 1.0)));
    let position = |index: usize, range: Option<[f64; 2]>, start: f64| {
        let [one, other] = range.unwrap_or([f64::MIN, f64::MAX]);
        // a file may state them the wrong way round
        let [low, high] = [one.min(other), one.max(other)];
        let half = PI.min(0.5 * (high - low));
        let middle = start.max(low + half).min(high - half);
        let part = (0.5 + number as f64 / g.powi(index as i32 + 1)).fract();
        (middle + (2.0 * part - 1.0) * half).clamp(low, high)
    };
    let joints = ranges.iter().zip(seed).enumerate();
    joints.map(|(index, (&range, &start))| position(index, range, start)).collect()
}

/// Returns the displacements (metres, radians) from `position` to the lower and the upper end of a
/// joint's range; infinite for a joint without limits.
pub(crate) fn range_margins(joint: &ChainJoint, position: f64) -> [f64; 2] {
    let [low, high] = joint.motion.range.unwrap_or([f64::NEG_INFINITY, f64::INFINITY]);
    [low - position, high - position]
}

/// Advances a configuration by `seconds` of joint velocities, clamped to the ranges of the joints.
pub(crate) fn step_joints(
    joints: &[ChainJoint],
    configuration: &mut [f64],
    velocities: &[f64],
    seconds: f64,
) {
    for ((joint, position), velocity) in joints.iter().zip(configuration).zip(velocities) {
        let [low, high] = joint.motion.range.unwrap_or([f64::NEG_INFINITY, f64::INFINITY]);
        // the solved velocities keep to the ranges up to rounding
        *position = (*position + seconds * velocity).clamp(low, high);
    }
}

/// Rejects a configuration with a joint outside of its range, and ranges that are reversed.
pub(crate) fn check_joint_ranges(chain: &Chain, configuration: &[f64]) -> Result<(), ControlError> {
    for (joint, &position) in chain.joints().iter().zip(configuration) {
        let range = joint.motion.range.unwrap_or([f64::MIN, f64::MAX]);
        if range[0] > range[1] {
            return Err(ControlError::ReversedRange { joint: joint.name.clone(), range });
        }
        if !(range[0]..=range[1]).contains(&position) {
            let joint = joint.name.clone();
            return Err(ControlError::JointOutOfRange { joint, position, range });
        }
    }
    Ok(())
}

/// Returns the miss of the tip in `configuration`: its distance and angle from `target`, and a
/// joint at the end of its range, if any.
pub(crate) fn tip_miss(
    chain: &Chain,
    orientation: OrientationConstraint,
    configuration: &[f64],
    target: &Pose,
) -> MissedTarget {
    let tip = chain.tip_pose(configuration);
    let error = orientation.pose_error(&tip, target);
    let mut joints = chain.joints().iter().zip(configuration);
    let stuck = joints.find(|&(joint, &position)| {
        let [low, high] = range_margins(joint, position);
        (-low).min(high) < LIMIT_TOLERANCE
    });
    MissedTarget {
        target: target.position,
        reached: tip.position,
        distance: error.linear.length(),
        angle: error.angular.length(),
        joint: stuck.map(|(joint, _)| joint.name.clone()),
    }
}

/// Largest distance (metres, radians) at which a joint counts as at the end of its range.
const LIMIT_TOLERANCE: f64 = 1e-6;

/// Solves `a x = b` by the Cholesky factorisation `a = l l^T`. `a` must be symmetric and positive
/// definite; only its lower triangle is read.
fn solve(a: &[[f64; 6]; 6], b: [f64; 6]) -> [f64; 6] {
    let l = factor(a);
    let mut x = b;
    for row in 0..6 {
        let known: f64 = (0..row).map(|column| l[row][column] * x[column]).sum();
        x[row] = (x[row] - known) / l[row][row];
    }
    for row in (0..6).rev() {
        let known: f64 = (row + 1..6).map(|column| l[column][row] * x[column]).sum();
        x[row] = (x[row] - known) / l[row][row];
    }
    x
}

/// Returns the lower triangular factor `l` of `a = l l^T`.
fn factor(a: &[[f64; 6]; 6]) -> [[f64; 6]; 6] {
    let mut l = [[0.0; 6]; 6];
    for row in 0..6 {
        for column in 0..=row {
            let known: f64 = (0..column).map(|k| l[row][k] * l[column][k]).sum();
            let rest = a[row][column] - known;
            l[row][column] = if row == column { rest.sqrt() } else { rest / l[column][column] };
        }
    }
    l
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::gen3;

    /// A redundant arm moves its tip as wanted with any one joint held, each at a bound of its own.
    #[test]
    fn the_other_joints_do_what_a_held_one_cannot() {
        let arm = gen3::gen3_description().unwrap();
        let chain = Chain::new(&arm, "tool_link").unwrap();
        let configuration = [0.4, 0.7, 2.5, -1.5, 0.6, -1.0, 1.2];
        let wanted =
            Twist { linear: DVec3::new(0.1, -0.2, 0.05), angular: DVec3::new(0.0, 0.1, -0.1) };
        let mut solver = JointVelocitySolver::new(7, OrientationConstraint::Full);
        let mut solve = |bounds: &dyn Fn(usize) -> [f64; 2]| {
            solver.solve(&chain, &configuration, wanted, 1e-6, |_| 0.0, bounds);
            solver.joint_velocities().to_vec()
        };
        let free = solve(&|_| [f64::NEG_INFINITY, f64::INFINITY]);
        let mut columns = [Twist::ZERO; 7];
        chain.jacobian(&configuration, &mut columns);
        for (held, velocity) in free.into_iter().enumerate() {
            let bound = 0.5 * velocity;
            let bounds = |joint: usize| {
                if joint == held {
                    [bound.min(0.0), bound.max(0.0)]
                } else {
                    [f64::NEG_INFINITY, f64::INFINITY]
                }
            };
            let velocities = solve(&bounds);
            assert_eq!(velocities[held], bound);
            let parts = columns.iter().zip(&velocities);
            let twist = parts.fold(Twist::ZERO, |sum, (&column, &v)| sum + v * column);
            let missing = twist + -1.0 * wanted;
            assert!(missing.dot(&missing).sqrt() < 1e-6, "{held}: {twist:?}");
        }
    }

    #[test]
    fn the_solution_solves() {
        // m m^T + 0.1 of a matrix without structure
        let m: [[f64; 6]; 6] = std::array::from_fn(|i| {
            std::array::from_fn(|j| (1.7 * i as f64 + 2.3 * j as f64).sin())
        });
        let a: [[f64; 6]; 6] = std::array::from_fn(|i| {
            std::array::from_fn(|j| {
                let product: f64 = (0..6).map(|k| m[i][k] * m[j][k]).sum();
                product + if i == j { 0.1 } else { 0.0 }
            })
        });
        let b = [1.0, -2.0, 3.0, -4.0, 5.0, -6.0];
        let x = solve(&a, b);
        for (row, expected) in a.iter().zip(b) {
            let got: f64 = row.iter().zip(x).map(|(coefficient, x)| coefficient * x).sum();
            assert!((got - expected).abs() < 1e-11, "{got} {expected}");
        }
    }
}
