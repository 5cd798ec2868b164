//! Search for the place of an arm's base at the table, with a ready posture.

use std::f64::consts::FRAC_PI_2;
use std::time::Duration;

use glam::{DQuat, DVec3};
use robots::{
    Chain, IkSettings, OrientationConstraint, Pose, RobotDescription, TwistControlSettings,
    TwistController,
};

use crate::error::{EnvError, ReachShortfall};
use crate::layout::HAND_TARGET_START;

/// Positions (metres) that the hand must reach, for x, y >= 0: corners of the volume of most of the
/// scripted experts' paths in the four standard groups. Paths go up to 15 mm beyond it, those of
/// Plate Slide to y = 0.3 m; there an arm may stand at the end of its reach.
const REQUIRED_HAND_POSITIONS: [DVec3; 4] = [
    DVec3::new(0.2, 0.185, 0.055),
    DVec3::new(0.2, 0.185, 0.19),
    DVec3::new(0.2, 0.12, 0.27),
    DVec3::new(0.15, 0.15, 0.29),
];
/// Positions of the base along y that are tried first (metres).
const BASE_Y_BEHIND_TABLE: [f64; 7] = [-0.44, -0.48, -0.52, -0.56, -0.62, -0.68, -0.76];
/// Positions of the base along y that are tried last (metres): objects of flipped variants stand
/// near them.
const BASE_Y_ON_TABLE_EDGE: [f64; 2] = [-0.4, -0.36];
/// Heights of the base above the table that are tried (metres).
const BASE_Z: [f64; 5] = [0.0, 0.1, 0.2, 0.3, 0.45];
/// Number of seeds from which ready postures are found: the middle of the ranges, and others.
const SEEDS: usize = 6;
/// Minimum height (metres) of the arm's joint origins above the table, except the first.
const MIN_JOINT_HEIGHT: f64 = 0.03;
/// Rotation of the hand's frame at work: its z points down, its y along the table's.
const DOWN: DQuat = DQuat::from_xyzw(0.0, 1.0, 0.0, 0.0);

/// Constraint that leaves the rotation about the vertical free.
const AROUND_Z: OrientationConstraint = OrientationConstraint::Axis(DVec3::Z);

/// Pose of an arm's base at the table, with a posture for work and the hand's reach from there.
#[derive(Clone, Debug)]
pub(super) struct BasePlacement {
    /// Pose of the base.
    pub base: Pose,
    /// Number of quarter turns about the hand's z by which its fingers are mounted.
    pub quarter_turns: usize,
    /// Configuration with the hand over the centre, pointing down.
    pub ready: Vec<f64>,
    /// Part of the orientation that the hand keeps at all required positions.
    pub orientation: OrientationConstraint,
    /// Number of required positions that the hand reaches.
    reached: usize,
    /// First required position that the hand does not reach.
    missed: Option<DVec3>,
    /// Smallest of the speeds (m/s) that the hand has along the world's axes at the required
    /// positions.
    slowest_tip_speed: f64,
}

/// Inputs of a search for the place of an arm's base at the table.
pub(super) struct BasePlacementSearch<'a> {
    /// Robot with its base at the origin.
    pub robot: &'a RobotDescription,
    /// Link of the hand's frame, whose z is to point down.
    pub hand: &'a str,
    /// Quarter turns about the hand's z in which the fingers may be mounted.
    pub quarter_turns: &'a [usize],
    /// Position of the base (metres), if it is given.
    pub base_position: Option<DVec3>,
    /// Angle by which the base is turned about z (radians).
    pub base_yaw: f64,
}

impl BasePlacementSearch<'_> {
    /// Returns the best placement from which the hand reaches all required positions: if possible
    /// behind the table, then without turns of the hand, then where the hand is fastest.
    ///
    /// # Errors
    /// [`EnvError::OutOfReach`] with the placement from which it reaches the most;
    /// [`EnvError::Control`] for joints that cannot be controlled.
    pub fn search(&self) -> Result<BasePlacement, EnvError> {
        let unplaced = Chain::new(self.robot, self.hand)?;
        let middle = unplaced.quasi_random_configuration(0);
        // reports what keeps the arm from moving before the search takes it for a short reach
        TwistController::new(unplaced, &middle, TwistControlSettings::default())?;
        let grid = |ys: &[f64]| -> Vec<DVec3> {
            ys.iter().flat_map(|&y| BASE_Z.map(|z| DVec3::new(0.0, y, z))).collect()
        };
        let stages = match self.base_position {
            Some(position) => [vec![position], Vec::new()],
            None => [grid(&BASE_Y_BEHIND_TABLE), grid(&BASE_Y_ON_TABLE_EDGE)],
        };
        let base_at =
            |position: DVec3| Pose::from_xyz_rpy(position.to_array(), [0.0, 0.0, self.base_yaw]);
        let first = base_at(stages[0][0]);
        let mut best: Option<BasePlacement> = None;
        for stage in stages {
            for position in stage {
                let placement = self.posture(base_at(position))?;
                best = preferred(best, placement);
            }
            if best.as_ref().is_some_and(|placement| placement.missed.is_none()) {
                break;
            }
        }
        let (base, reached, missed) = match best {
            Some(BasePlacement { base, reached, missed: Some(missed), .. }) => {
                (base, reached, missed)
            }
            Some(placement) => return Ok(placement),
            // nowhere does the hand point down over the centre
            None => (first, 0, HAND_TARGET_START),
        };
        let chain = Chain::new(&self.robot.clone().with_base_pose(base)?, self.hand)?;
        Err(EnvError::OutOfReach(Box::new(ReachShortfall {
            name: self.robot.name().to_owned(),
            reached,
            required: required_hand_positions().count(),
            base: base.position,
            missed,
            distance: missed.distance(chain.reach_centre()),
            reach: chain.max_reach(),
        })))
    }

    /// Returns the placement with the base at `base`: with the first posture that holds the hand
    /// still at all required positions, or else with the best one. `None` if the hand does not
    /// point down over the centre.
    fn posture(&self, base: Pose) -> Result<Option<BasePlacement>, EnvError> {
        let robot = self.robot.clone().with_base_pose(base)?;
        let chain = Chain::new(&robot, self.hand)?;
        let mut best = None;
        // the middle of the ranges comes first, since arms look natural near it
        for seed in (0..SEEDS).map(|number| chain.quasi_random_configuration(number)) {
            let placement = self.ready(&robot, &chain, &seed);
            let holds = |of: &BasePlacement| of.missed.is_none() && of.holds_rotation();
            if placement.as_ref().is_some_and(holds) {
                return Ok(placement);
            }
            best = preferred(best, placement);
        }
        Ok(best)
    }

    /// Returns the placement with a ready posture near `seed`, without turns of the hand if it can
    /// do without.
    fn ready(
        &self,
        robot: &RobotDescription,
        chain: &Chain,
        seed: &[f64],
    ) -> Option<BasePlacement> {
        let free = solve(chain, HAND_TARGET_START, DOWN, seed, AROUND_Z)?;
        let turned = chain.tip_pose(&free).rotation;
        // the fingers open along y where that is nearest
        let near = |&turns: &usize| (turned * gripper_rotation(turns)).dot(DOWN).abs();
        let turns = self.quarter_turns.iter().copied();
        let quarter_turns = turns.max_by(|a, b| near(a).total_cmp(&near(b)))?;
        let rotation = DOWN * gripper_rotation(quarter_turns).conjugate();
        let measured = |ready: Vec<f64>, orientation| {
            let mut placement = BasePlacement {
                base: robot.base_pose(),
                quarter_turns,
                slowest_tip_speed: chain.slowest_axis_tip_speed(&ready, orientation),
                ready,
                orientation,
                reached: 0,
                missed: None,
            };
            placement.measure_reach(robot, chain, rotation);
            placement
        };
        let full = OrientationConstraint::Full;
        let held = solve(chain, HAND_TARGET_START, rotation, &free, full);
        let still = held.map(|ready| measured(ready, full)).filter(|of| of.missed.is_none());
        Some(still.unwrap_or_else(|| measured(free, AROUND_Z)))
    }
}

/// Returns the rotation of a gripper mounted `quarter_turns` quarter turns about the hand's z axis.
pub(super) fn gripper_rotation(quarter_turns: usize) -> DQuat {
    DQuat::from_rotation_z(quarter_turns as f64 * FRAC_PI_2)
}

impl BasePlacement {
    /// Moves the hand from the centre to each required position, and notes those that it reaches
    /// and how fast it is there.
    fn measure_reach(&mut self, robot: &RobotDescription, chain: &Chain, rotation: DQuat) {
        for position in required_hand_positions() {
            let solved = solve(chain, position, rotation, &self.ready, self.orientation);
            let above = solved.filter(|joints| lowest(robot, chain, joints) > MIN_JOINT_HEIGHT);
            let speed =
                above.map_or(0.0, |joints| chain.slowest_axis_tip_speed(&joints, self.orientation));
            self.slowest_tip_speed = self.slowest_tip_speed.min(speed);
            // a hand that cannot move along some axis is at the end of its reach
            if speed > 0.0 {
                self.reached += 1;
            } else {
                self.missed = self.missed.or(Some(position));
            }
        }
    }

    fn holds_rotation(&self) -> bool {
        self.orientation == OrientationConstraint::Full
    }

    fn is_preferred_to(&self, other: &Self) -> bool {
        let key = |of: &Self| (of.reached, of.holds_rotation());
        key(self) > key(other)
            || key(self) == key(other) && self.slowest_tip_speed > other.slowest_tip_speed
    }
}

/// Returns the better one of two placements, the first one if they are equally good.
fn preferred(one: Option<BasePlacement>, other: Option<BasePlacement>) -> Option<BasePlacement> {
    match (one, other) {
        (Some(old), Some(new)) => Some(if new.is_preferred_to(&old) { new } else { old }),
        (old, new) => old.or(new),
    }
}

/// Returns the positions (metres) that the hand must reach in all variants.
fn required_hand_positions() -> impl Iterator<Item = DVec3> {
    let signs = [[1.0, 1.0], [-1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]];
    let mirrored = REQUIRED_HAND_POSITIONS
        .into_iter()
        .flat_map(move |of| signs.map(|[x, y]| DVec3::new(x * of.x, y * of.y, of.z)));
    mirrored.chain([HAND_TARGET_START.with_z(REQUIRED_HAND_POSITIONS[0].z)])
}

/// Returns a configuration near `seed`, if there is one.
fn solve(
    chain: &Chain,
    position: DVec3,
    rotation: DQuat,
    seed: &[f64],
    orientation: OrientationConstraint,
) -> Option<Vec<f64>> {
    // one search, so that the hand can move there without turning the arm over
    let settings = IkSettings { orientation, max_searches: 1, time_limit: Duration::MAX };
    chain.solve_ik_with_settings(&Pose { position, rotation }, seed, &settings).ok()
}

/// Returns the lowest height of the chain's joints (metres), without the first, which stands on the
/// base.
fn lowest(robot: &RobotDescription, chain: &Chain, joints: &[f64]) -> f64 {
    let mut positions = robot.rest_positions();
    for (joint, position) in chain.joints().iter().zip(joints) {
        positions[joint.dof_index] = *position;
    }
    let poses = robot.link_poses(&positions);
    let above = &chain.joints()[1..];
    let links = robot.joints().iter().zip(&poses[1..]);
    let heights = links
        .filter(|(joint, _)| above.iter().any(|of| of.name == joint.name))
        .map(|(_, pose)| pose.position.z);
    heights.fold(f64::INFINITY, f64::min)
}
