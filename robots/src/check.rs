//! Check of a robot description: figures, and what looks wrong or is missing.

use std::time::{Duration, Instant};

use glam::DVec3;
use serde::Serialize;

use crate::capsule::Capsule;
use crate::chain::Chain;
use crate::control::{TwistControlSettings, TwistController};
use crate::description::{
    Inertia, Joint, JointMotionKind, JointMotionSpec, Link, RobotDescription,
};
use crate::error::{ControlError, DescriptionError};
use crate::ik::IkSettings;
use crate::mjcf::{JointServoSettings, MjcfSettings, TouchingLinkPairs};
use crate::pose::Pose;
use crate::robot_file::RobotFile;

/// Time after which no further target is tried, nor another search for the last one begun: searches
/// of arms with hundreds of joints take long.
const IK_TIME: Duration = Duration::from_secs(5);
/// Number of the first posture that makes a target. Searches start from postures with lower ones.
const FIRST_TARGET: usize = 1000;
/// Masses of all links together (kg) that arms have.
const MASSES: [f64; 2] = [0.05, 500.0];
/// Reaches (metres) outside of which the unit looks wrong.
const REACHES: [f64; 2] = [0.005, 5.0];
/// Distance (metres) of a shape or centre of mass from its link's origin, and position of a slide's
/// limit, beyond which their unit looks wrong.
const LARGEST_EXTENT: f64 = 5.0;
/// Position (radians) of a hinge's limit, two turns, beyond which its unit looks wrong.
const HINGE_LIMIT: f64 = 13.0;
/// Speed of a hinge (rad/s) beyond which its unit looks wrong.
const HINGE_SPEED: f64 = 50.0;
/// Inertia per mass (m^2), that of a mass 2 m away, beyond which its unit looks wrong.
const INERTIA_PER_MASS: f64 = 4.0;

/// Result of the check of a robot's description: its figures, and what is missing or looks wrong.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct RobotCheckReport {
    /// Name of the robot.
    pub name: String,
    /// Number of links.
    pub links: usize,
    /// Joints that move.
    pub joints: Vec<JointSummary>,
    /// Mass of all links (kg).
    pub mass_kg: f64,
    /// Name of the hand's link.
    pub hand: String,
    /// Axis of the hand that points down at work; `None` if it was not found.
    pub approach_axis: Option<[f64; 3]>,
    /// Names of the hand's own two fingers; `None` if it has none, or none that are recognised.
    pub fingers: Option<[String; 2]>,
    /// `true` if nothing moves on the hand, so that it gets a gripper with two fixed claws.
    pub has_fixed_claws: bool,
    /// Joints from the base to the hand; empty if they form no chain.
    pub chain: Vec<String>,
    /// Bound on the distance of the hand from the first joint in any posture (metres); `None`
    /// without chain or limit.
    pub reach_m: Option<f64>,
    /// Number of targets for inverse kinematics that were tried in at most 5 s: poses of the hand in
    /// postures that are spread over the ranges of the joints.
    pub ik_targets: usize,
    /// Number of these targets that inverse kinematics finds from the middle of the ranges.
    pub ik_found: usize,
    /// Median and largest time of a target (ms); zero without targets.
    pub ik_median_and_max_ms: [f64; 2],
    /// Pairs of links that touch at rest or in most postures, and therefore do not collide in the
    /// simulation.
    pub touching: TouchingLinkPairs,
    /// Values that look as if they were in another unit.
    pub unit_warnings: Vec<String>,
    /// Values of the file that were replaced, left out or reduced.
    pub notes: Vec<String>,
    /// Collision shapes that are missing, with the reasons.
    pub missing_shapes: Vec<String>,
    /// Reasons for which the robot cannot be simulated with servos, controlled, or used with its
    /// own gripper.
    pub problems: Vec<String>,
}

/// Moving joint of a checked robot, with its limits. Units are radians and newton metres, or metres
/// and newtons of a slide.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct JointSummary {
    /// Name of the joint.
    pub name: String,
    /// `true` for a slide, `false` for a hinge.
    pub slides: bool,
    /// `true` if the joint follows another one.
    pub follows: bool,
    /// Lowest and highest position; `None` without limits.
    pub range: Option<[f64; 2]>,
    /// Maximum speed; `None` if the file states none.
    pub max_speed: Option<f64>,
    /// Maximum force or torque; `None` if the file states none.
    pub max_effort: Option<f64>,
}

impl RobotCheckReport {
    /// Number of targets for inverse kinematics where time does not run out.
    pub const MAX_IK_TARGETS: usize = 100;

    /// Returns `true` if the robot can be simulated and controlled, fingers and direction of its
    /// hand are clear, and no unit looks wrong.
    pub fn passes(&self) -> bool {
        self.problems.is_empty() && self.unit_warnings.is_empty()
    }
}

impl RobotFile {
    /// Reads the URDF and checks the robot with the settings of this file.
    ///
    /// # Errors
    /// Those of [`RobotFile::read_description`]; [`DescriptionError::UnknownLink`] for the hand.
    pub fn check_report(&self) -> Result<RobotCheckReport, DescriptionError> {
        self.read_description()?.check_with(self)
    }
}

impl RobotDescription {
    /// Checks the robot with the hand `hand`, or [`RobotDescription::default_hand_link`] if `None`.
    ///
    /// # Errors
    /// [`DescriptionError::UnknownLink`] for a hand that the robot does not have.
    pub fn check_report(&self, hand: Option<&str>) -> Result<RobotCheckReport, DescriptionError> {
        let hand = hand.map(str::to_owned);
        self.check_with(&RobotFile { hand, ..RobotFile::default() })
    }

    fn check_with(&self, file: &RobotFile) -> Result<RobotCheckReport, DescriptionError> {
        let hand = file.hand_link(self);
        self.link_index(hand, "the robot's hand")?;
        let fingers = file.finger_links(self);
        let mut problems = Vec::new();
        problems.extend(fingers.as_ref().err().map(ToString::to_string));
        for finger in fingers.iter().flatten().flatten() {
            let found = self.link_index(finger, "a finger of the robot's hand");
            problems.extend(found.err().map(|error| error.to_string()));
        }
        let axis = file.approach_axis(self);
        problems.extend(axis.as_ref().err().map(ToString::to_string));
        problems.extend(file.check_base().err().map(|error| error.to_string()));
        let settings =
            MjcfSettings { servo: Some(JointServoSettings::default()), ..MjcfSettings::default() };
        problems.extend(self.to_mjcf(&settings).err().map(|error| error.to_string()));
        let chain = Chain::new(self, hand);
        problems.extend(chain.as_ref().err().map(ToString::to_string));
        let chain = chain.ok();
        if let Some(chain) = &chain {
            let posture = chain.quasi_random_configuration(0);
            let control =
                TwistController::new(chain.clone(), &posture, TwistControlSettings::default());
            // the conversion to MJCF names reversed ranges
            let other =
                control.err().filter(|error| !matches!(error, ControlError::ReversedRange { .. }));
            problems.extend(other.map(|error| error.to_string()));
        }
        let ik = chain.as_ref().map(|of| IkFigures::measure(of, IK_TIME)).unwrap_or_default();
        let reach = chain.as_ref().map(Chain::max_reach).filter(|reach| reach.is_finite());
        Ok(RobotCheckReport {
            name: self.name.clone(),
            links: self.links.len(),
            joints: self.joints.iter().filter_map(joint_check).collect(),
            mass_kg: self.mass(),
            // a sum with zero is never -0
            approach_axis: axis.ok().map(|axis| (axis + DVec3::ZERO).to_array()),
            has_fixed_claws: matches!(fingers, Ok(None)),
            fingers: fingers.ok().flatten(),
            hand: hand.to_owned(),
            reach_m: reach,
            ik_targets: ik.times_ms.len(),
            ik_found: ik.found,
            ik_median_and_max_ms: ik.median_and_max_ms(),
            chain: chain.iter().flat_map(|of| of.joints()).map(|of| of.name.clone()).collect(),
            touching: self.touching_pairs(),
            unit_warnings: self.unit_warnings(reach),
            notes: self.notes.iter().cloned().chain(self.restriction_notes()).collect(),
            missing_shapes: self.missing_shapes.clone(),
            problems,
        })
    }

    /// Returns the mass of all links (kg).
    fn mass(&self) -> f64 {
        let masses = self.links.iter().filter_map(|link| link.inertia).map(|of| of.mass);
        // the sum of nothing would be -0
        masses.fold(0.0, |sum, mass| sum + mass)
    }

    fn restriction_notes(&self) -> impl Iterator<Item = String> {
        self.restrictions.iter().map(|of| {
            let [low, high] = of.range;
            format!(
                "the range of the joint `{}` is reduced to {low} to {high}, so that `{}`, which \
                 follows it, stays within its own",
                of.joint, of.follower
            )
        })
    }

    fn unit_warnings(&self, reach: Option<f64>) -> Vec<String> {
        let mut warnings = self.unit_warnings.clone();
        let mut warn = |is_right: bool, what: String, unit: &str| {
            if !is_right {
                warnings.push(format!("{what}: is the file in {unit}?"));
            }
        };
        let total = self.mass();
        let all = format!("the links weigh {total:.3} kg together");
        warn(total <= MASSES[1], all.clone(), "grams, or pounds, instead of kilograms");
        warn(total == 0.0 || total >= MASSES[0], all, "tonnes instead of kilograms");
        if let Some(reach) = reach {
            let length = format!("the arm is {reach:.3} m long");
            warn(reach <= REACHES[1], length.clone(), "millimetres or inches instead of metres");
            // a hand on the only joint has a reach of zero in any unit
            warn(reach == 0.0 || reach >= REACHES[0], length, "kilometres instead of metres");
        }
        for link in &self.links {
            let name = &link.name;
            let far = extent(link);
            let shapes = format!("shapes of the link `{name}` are {far:.1} m from it");
            warn(
                far <= LARGEST_EXTENT,
                shapes,
                "millimetres (a mesh needs `scale`) instead of metres",
            );
            if let Some(Inertia { mass, centre_of_mass, tensor }) =
                link.inertia.filter(|of| of.mass > 0.0)
            {
                let away = centre_of_mass.length();
                let centre =
                    format!("the centre of mass of the link `{name}` is {away:.1} m from it");
                warn(away <= LARGEST_EXTENT, centre, "millimetres instead of metres");
                let largest = tensor.x_axis.x.max(tensor.y_axis.y).max(tensor.z_axis.z);
                let inertia = format!("the link `{name}` of {mass} kg has {largest} kg m^2");
                let unit = "kg mm^2 or g m^2 instead of kg m^2";
                warn(largest <= INERTIA_PER_MASS * mass, inertia, unit);
            }
        }
        for (joint, motion) in self.free_joints() {
            let limit = motion.range.map_or(0.0, |[low, high]| low.abs().max(high.abs()));
            let name = &joint.name;
            if motion.kind == JointMotionKind::Slide {
                let range = format!("the joint `{name}` slides as far as {limit} m");
                warn(limit <= LARGEST_EXTENT, range, "millimetres instead of metres");
                continue;
            }
            let range = format!("the joint `{name}` turns as far as {limit} rad");
            warn(limit <= HINGE_LIMIT, range, "degrees instead of radians");
            let speed = motion.max_speed.unwrap_or(0.0);
            let fast = format!("the joint `{name}` turns at up to {speed} rad/s");
            warn(speed <= HINGE_SPEED, fast, "degrees instead of radians");
        }
        warnings
    }
}

fn joint_check(joint: &Joint) -> Option<JointSummary> {
    let JointMotionSpec { kind, range, max_speed, max_effort, .. } = joint.motion?;
    let follows = !joint.motion?.is_free();
    let slides = kind == JointMotionKind::Slide;
    Some(JointSummary { name: joint.name.clone(), slides, follows, range, max_speed, max_effort })
}

/// Returns the largest distance of a shape from the origin of its link (metres).
fn extent(link: &Link) -> f64 {
    let capsules = link.shapes.iter().flat_map(|shape| shape.enclosing_capsules(&Pose::IDENTITY));
    let far =
        |Capsule { ends: [start, end], radius }: Capsule| start.length().max(end.length()) + radius;
    capsules.map(far).fold(0.0, f64::max)
}

/// Targets that inverse kinematics finds, and its times.
#[derive(Default)]
struct IkFigures {
    found: usize,
    /// Time of each target (ms), in rising order.
    times_ms: Vec<f64>,
}

impl IkFigures {
    fn measure(chain: &Chain, time: Duration) -> Self {
        let seed = chain.quasi_random_configuration(0);
        let (mut figures, started) = (Self::default(), Instant::now());
        for number in FIRST_TARGET..FIRST_TARGET + RobotCheckReport::MAX_IK_TARGETS {
            let before = started.elapsed();
            if before >= time {
                break;
            }
            let settings = IkSettings { time_limit: time - before, ..IkSettings::default() };
            let target = chain.tip_pose(&chain.quasi_random_configuration(number));
            let solved = chain.solve_ik_with_settings(&target, &seed, &settings);
            figures.found += usize::from(solved.is_ok());
            figures.times_ms.push(1e3 * (started.elapsed() - before).as_secs_f64());
        }
        figures.times_ms.sort_by(f64::total_cmp);
        figures
    }

    fn median_and_max_ms(&self) -> [f64; 2] {
        let at = |index: usize| self.times_ms.get(index).copied().unwrap_or_default();
        [at(self.times_ms.len() / 2), self.times_ms.last().copied().unwrap_or_default()]
    }
}

impl Chain {
    /// Returns a bound on the distance of the tip (metres) from [`Chain::reach_centre`] in any
    /// configuration. Infinite with a slide without limits.
    pub fn max_reach(&self) -> f64 {
        let (_, to_last) = self.reach_bound();
        to_last + self.tip_in_last_joint().position.length()
    }

    /// Returns the point (metres, world) from which [`Chain::max_reach`] is measured: the first
    /// joint or, if that turns, the point of its axis nearest to the next joint.
    pub fn reach_centre(&self) -> DVec3 {
        self.reach_bound().0
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// A chain of 120 joints, whose single targets take seconds.
    #[test]
    fn targets_are_tried_as_long_as_there_is_time() {
        let mut parts = "<link name=\"0\"/>".to_owned();
        for joint in 0..120 {
            let next = joint + 1;
            let axis = ["1 0 0", "0 1 0", "0 0 1"][joint % 3];
            parts += &format!(
                "<link name=\"{next}\"/><joint name=\"{next}\" type=\"revolute\">\
                 <origin xyz=\"0 0 0.1\"/><parent link=\"{joint}\"/><child link=\"{next}\"/>\
                 <axis xyz=\"{axis}\"/><limit lower=\"-0.01\" upper=\"0.2\"/></joint>"
            );
        }
        let robot = RobotDescription::from_urdf(&format!("<robot>{parts}</robot>")).unwrap();
        let chain = Chain::new(&robot, "120").unwrap();
        let figures = IkFigures::measure(&chain, Duration::from_millis(1));
        assert_eq!(figures.times_ms.len(), 1);
        let [median, most] = figures.median_and_max_ms();
        assert!(median >= 1.0 && most >= median, "{median} {most}");
        assert_eq!(IkFigures::measure(&chain, Duration::ZERO).median_and_max_ms(), [0.0; 2]);
    }
}
