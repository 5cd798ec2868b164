//! Hand of a robot of which nothing but the URDF is known: its link, fingers and direction.

use std::ops::Range;

use glam::DVec3;

use crate::description::RobotDescription;
use crate::error::{DescriptionError, require};

/// Distance (metres) below which two frames count as being at one place.
const SAME_PLACE: f64 = 1e-3;
/// Cosine of the largest angle at which a direction counts as that of an axis: 18 degrees.
const ALIGNED: f64 = 0.95;

impl RobotDescription {
    /// Returns the name of the link that is taken for the hand: the last one before the tree
    /// branches into links that move, for instance fingers. Where nothing moves any more, single
    /// fixed links, such as a flange and a tool, belong to the arm.
    pub fn default_hand_link(&self) -> &str {
        let mut link = 0;
        loop {
            let children: Vec<usize> = self.children(link).collect();
            link = match (&self.moving_branches(link)[..], &children[..]) {
                ([only], _) | ([], [only]) => *only,
                _ => return &self.links[link].name,
            };
        }
    }

    /// Returns the names of the two fingers of the link `hand`: two branches with one moving joint
    /// each, both of which one element of the position vector drives. `None` if nothing moves on
    /// it.
    ///
    /// # Errors
    /// [`DescriptionError::UnknownLink`]; [`DescriptionError::UnknownFingers`] if other branches
    /// than two such fingers move.
    pub fn default_finger_links(
        &self,
        hand: &str,
    ) -> Result<Option<[String; 2]>, DescriptionError> {
        let index = self.link_index(hand, "the robot's hand")?;
        let branches = self.moving_branches(index);
        if branches.is_empty() {
            return Ok(None);
        }
        let name = |link: usize| self.links[link].name.clone();
        self.two_fingers(&branches).map(|links| Some(links.map(name))).ok_or_else(|| {
            let branches = branches.iter().map(|&link| name(link)).collect();
            DescriptionError::UnknownFingers { hand: hand.to_owned(), branches }
        })
    }

    /// Returns the moving links of two branches, if they are fingers that one joint moves.
    fn two_fingers(&self, branches: &[usize]) -> Option<[usize; 2]> {
        let &[one, other] = branches else {
            return None;
        };
        let finger = |branch: usize| {
            let links = branch..self.descendants(branch).end;
            let mut moving = links
                .filter_map(|link| Some((link, self.joints[link - 1].motion?.drive.dof_index())));
            moving.next().filter(|_| moving.next().is_none())
        };
        let ((first, dof), (second, same)) = (finger(one)?, finger(other)?);
        (dof == same).then_some([first, second])
    }

    /// Returns the axis of the link `hand` (of its x, y and z, with a sign) along which it reaches
    /// out: towards the links that move on it, or else away from the link that carries it.
    ///
    /// # Errors
    /// [`DescriptionError::UnknownLink`]; [`DescriptionError::NumberOutOfRange`] if that direction
    /// is more than 18 degrees off each axis.
    pub fn default_approach_axis(&self, hand: &str) -> Result<DVec3, DescriptionError> {
        let index = self.link_index(hand, "the robot's hand")?;
        let poses = self.link_poses(&self.rest_positions());
        let place = poses[index].position;
        let moving = self
            .descendants(index)
            .filter(|&link| self.joints[link - 1].motion.is_some())
            .map(|link| poses[link].position - place);
        let fingers: DVec3 = moving.sum();
        let ancestors = std::iter::successors(Some(index), |&link| {
            link.checked_sub(1).map(|joint| self.joints[joint].parent)
        });
        let mut ways = std::iter::once(fingers)
            .chain(ancestors.map(|link| place - poses[link].position))
            .filter(|way| way.length() > SAME_PLACE);
        let way = ways.next().unwrap_or(poses[index].rotation * DVec3::Z);
        let own = poses[index].rotation.conjugate() * way.normalize();
        let along = own.abs().max_position();
        require(
            own[along].abs() >= ALIGNED,
            || format!("the hand `{hand}`"),
            "the largest component of the direction in which it reaches out",
            own[along].abs(),
            "at least 0.95; set `approach_axis` in a JSON file of its settings",
        )?;
        Ok(DVec3::AXES[along] * own[along].signum())
    }

    /// Returns the indices of all links below the link `link` in the tree.
    pub fn descendants(&self, link: usize) -> Range<usize> {
        // links are in depth-first order
        let after = (link + 1..self.links.len()).find(|&next| self.joints[next - 1].parent < link);
        link + 1..after.unwrap_or(self.links.len())
    }

    /// Returns the children of a link whose branches have joints that move.
    fn moving_branches(&self, link: usize) -> Vec<usize> {
        let moves = |&child: &usize| {
            let joints = &self.joints[child - 1..self.descendants(child).end - 1];
            joints.iter().any(|joint| joint.motion.is_some())
        };
        self.children(link).filter(moves).collect()
    }

    fn children(&self, link: usize) -> impl Iterator<Item = usize> {
        let joints = self.joints.iter().enumerate();
        joints.filter(move |(_, joint)| joint.parent == link).map(|(index, _)| index + 1)
    }
}
