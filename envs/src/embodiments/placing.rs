//! Place of an arm at the table: its base, its ready posture, and the orientation that it holds.

use std::f64::consts::FRAC_PI_2;
use std::time::Duration;

use glam::{DQuat, DVec3};
use robots::{Chain, IkSettings, OrientationConstraint, Pose, RobotDescription};

use crate::error::{EnvError, ReachShortfall};
use crate::layout::HAND_TARGET_START;

/// Places of the hand in the tasks, in one quadrant (metres): those that scripted experts come to
/// with `hand`, and a few millimetres more. The others are their mirror images.
const PLACES: [DVec3; 4] = [
    DVec3::new(0.2, 0.185, 0.055),
    DVec3::new(0.2, 0.185, 0.19),
    DVec3::new(0.2, 0.12, 0.27),
    DVec3::new(0.15, 0.15, 0.29),
];
/// Positions of the base along y that are tried (metres): first behind the table, then on its near
/// edge, where objects of flipped variants stand.
const BEHIND: [f64; 7] = [-0.44, -0.48, -0.52, -0.56, -0.62, -0.68, -0.76];
const ON_EDGE: [f64; 2] = [-0.4, -0.36];
/// Heights of the base over the table that are tried (metres).
const HEIGHTS: [f64; 5] = [0.0, 0.1, 0.2, 0.3, 0.45];
/// Number of seeds from which ready postures are found: the middle of the ranges, and others.
const SEEDS: usize = 6;
/// Lowest height of links over the table (metres), for the links that move.
const LOWEST: f64 = 0.03;
/// Rotation of the hand's frame at work: its z points down, its y along the table's.
const DOWN: DQuat = DQuat::from_xyzw(0.0, 1.0, 0.0, 0.0);

/// Arm at its place.
#[derive(Clone, Debug)]
pub(super) struct PlacedArm {
    /// Pose of the base.
    pub base: Pose,
    /// Number of quarter turns about the hand's z by which its fingers are mounted.
    pub quarter_turns: usize,
    /// Configuration with the hand over the centre, pointing down.
    pub ready: Vec<f64>,
    /// Part of the orientation that the hand can keep at all places.
    pub orientation: OrientationConstraint,
    /// Number of places that the hand reaches before the first one that it does not.
    reached: usize,
    /// First place that the hand does not reach.
    missed: Option<DVec3>,
    /// Speed (m/s) that the hand has in every direction at all places.
    speed: f64,
}

/// Options of the search for a place.
pub(super) struct Placing<'a> {
    /// Robot with its base at the origin.
    pub robot: &'a RobotDescription,
    /// Link of the hand's frame, whose z is to point down.
    pub hand: &'a str,
    /// Quarter turns about the hand's z in which the fingers may be mounted.
    pub quarter_turns: &'a [usize],
    /// Position of the base (metres), if it is given.
    pub base_position: Option<DVec3>,
    /// Angle by which the base is turned about z (radians), if it is given.
    pub base_yaw: Option<f64>,
}

impl Placing<'_> {
    /// Searches for the place where the hand reaches all places of the tasks. Places behind the
    /// table come first, then those where the hand is fastest.
    ///
    /// # Errors
    /// [`EnvError::OutOfReach`] with the place where it reaches the most.
    pub fn search(&self) -> Result<PlacedArm, EnvError> {
        let yaw = self.base_yaw.unwrap_or(FRAC_PI_2);
        let grid = |ys: &[f64]| -> Vec<DVec3> {
            ys.iter().flat_map(|&y| HEIGHTS.map(|z| DVec3::new(0.0, y, z))).collect()
        };
        let stages = match self.base_position {
            Some(position) => vec![vec![position]],
            None => vec![grid(&BEHIND), grid(&ON_EDGE)],
        };
        let mut best = PlacedArm::nowhere(stages[0][0]);
        for position in stages.into_iter().flatten() {
            if best.missed.is_none() && BEHIND[0] < position.y {
                break;
            }
            let base = Pose::from_xyz_rpy(position.to_array(), [0.0, 0.0, yaw]);
            if let Some(placed) = self.posture(base)?.filter(|placed| placed.is_better(&best)) {
                best = placed;
            }
        }
        match best.missed {
            None => Ok(best),
            Some(missed) => Err(EnvError::OutOfReach(Box::new(ReachShortfall {
                name: self.robot.name().to_owned(),
                reached: best.reached,
                places: places().count(),
                base: best.base.position,
                missed,
                distance: missed.distance(best.base.position),
                reach: Chain::new(self.robot, self.hand)?.reach(),
            }))),
        }
    }

    /// Returns the ready posture with the base at `base`: the first one that holds the hand still
    /// at all places, or else the best one. `None` if the hand does not point down over the centre.
    fn posture(&self, base: Pose) -> Result<Option<PlacedArm>, EnvError> {
        let robot = self.robot.clone().with_base_pose(base)?;
        let chain = Chain::new(&robot, self.hand)?;
        let mut best: Option<PlacedArm> = None;
        // the middle of the ranges comes first, since arms look natural near it
        for seed in (0..SEEDS).map(|number| chain.spread_configuration(number)) {
            let Some(placed) = self.ready(&robot, &chain, &seed) else {
                continue;
            };
            if placed.missed.is_none() && placed.orientation == OrientationConstraint::Full {
                return Ok(Some(placed));
            }
            if best.as_ref().is_none_or(|other| placed.is_better(other)) {
                best = Some(placed);
            }
        }
        Ok(best)
    }

    /// Returns the ready posture near `seed`, without turns of the hand if it can do without.
    fn ready(&self, robot: &RobotDescription, chain: &Chain, seed: &[f64]) -> Option<PlacedArm> {
        let free = solve(chain, HAND_TARGET_START, DOWN, seed, AROUND_Z)?;
        let turned = chain.tip_pose(&free).rotation;
        // the fingers open along y where that is nearest
        let near = |&turns: &usize| (turned * mounted(turns)).dot(DOWN).abs();
        let turns = self.quarter_turns.iter().copied();
        let quarter_turns = turns.max_by(|a, b| near(a).total_cmp(&near(b)))?;
        let rotation = DOWN * mounted(quarter_turns).conjugate();
        let visit = |ready: Vec<f64>, orientation| {
            let mut placed = PlacedArm {
                base: robot.base_pose(),
                quarter_turns,
                speed: chain.tip_speed(&ready, orientation),
                ready,
                orientation,
                reached: 0,
                missed: None,
            };
            placed.visit(robot, chain, rotation);
            placed
        };
        let full = OrientationConstraint::Full;
        let held = solve(chain, HAND_TARGET_START, rotation, &free, full);
        let still = held.map(|ready| visit(ready, full)).filter(|held| held.missed.is_none());
        Some(still.unwrap_or_else(|| visit(free, AROUND_Z)))
    }
}

/// Constraint that leaves the rotation about the vertical free.
const AROUND_Z: OrientationConstraint = OrientationConstraint::Axis(DVec3::Z);

/// Returns the rotation of fingers that are mounted so many quarter turns about the hand's z.
pub(super) fn mounted(quarter_turns: usize) -> DQuat {
    DQuat::from_rotation_z(quarter_turns as f64 * FRAC_PI_2)
}

impl PlacedArm {
    /// Moves the hand from the centre to all places, up to the first one that it does not reach,
    /// and notes how fast it is there.
    fn visit(&mut self, robot: &RobotDescription, chain: &Chain, rotation: DQuat) {
        self.missed = places().find(|&place| {
            let solved = solve(chain, place, rotation, &self.ready, self.orientation);
            let above = solved.filter(|joints| lowest(robot, chain, joints) > LOWEST);
            let speed = above.map_or(0.0, |joints| chain.tip_speed(&joints, self.orientation));
            self.reached += usize::from(speed > 0.0);
            self.speed = self.speed.min(speed);
            // a hand that cannot move in some direction is at the end of its reach
            speed == 0.0
        });
    }

    fn is_better(&self, other: &Self) -> bool {
        let holds = |of: &Self| of.orientation == OrientationConstraint::Full;
        let key = |of: &Self| (of.reached, holds(of));
        key(self) > key(other) || key(self) == key(other) && self.speed > other.speed
    }

    /// Returns an arm that points down nowhere.
    fn nowhere(base: DVec3) -> Self {
        Self {
            base: Pose::from_position(base),
            quarter_turns: 0,
            ready: Vec::new(),
            orientation: OrientationConstraint::Full,
            reached: 0,
            missed: Some(HAND_TARGET_START),
            speed: 0.0,
        }
    }
}

/// Returns the places of the hand in all variants (metres).
fn places() -> impl Iterator<Item = DVec3> {
    let signs = [[1.0, 1.0], [-1.0, 1.0], [1.0, -1.0], [-1.0, -1.0]];
    let mirrored = PLACES
        .into_iter()
        .flat_map(move |place| signs.map(|[x, y]| DVec3::new(x * place.x, y * place.y, place.z)));
    mirrored.chain([HAND_TARGET_START.with_z(PLACES[0].z)])
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
    chain.solve_ik_with(&Pose { position, rotation }, seed, &settings).ok()
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
