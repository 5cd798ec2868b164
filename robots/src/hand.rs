//! Hand of a robot of which nothing but the URDF is known: its link, fingers and direction.

use glam::DVec3;

use crate::description::{PositionSource, RobotDescription};
use crate::error::DescriptionError;

/// Distance (metres) below which two frames count as being at one place.
const SAME_PLACE: f64 = 1e-3;

impl RobotDescription {
    /// Returns the name of the link that is taken for the hand: the last one before the tree
    /// branches into links that move, for instance fingers. Where nothing moves any more, single
    /// fixed links, such as a flange and a tool, belong to the arm.
    pub fn default_hand(&self) -> &str {
        let mut link = 0;
        loop {
            let children: Vec<usize> = self.children(link).collect();
            let moving: Vec<usize> =
                children.iter().copied().filter(|&child| self.moving_joints(child) > 0).collect();
            link = match (&moving[..], &children[..]) {
                ([only], _) | ([], [only]) => *only,
                _ => return &self.links[link].name,
            };
        }
    }

    /// Returns the names of the two fingers of the link `hand`, if it has such: two branches with
    /// one moving joint each, both of which one element of the position vector drives.
    ///
    /// # Errors
    /// [`DescriptionError::UnknownLink`].
    pub fn default_fingers(&self, hand: &str) -> Result<Option<[String; 2]>, DescriptionError> {
        let hand = self.link_index(hand, "the robot's hand")?;
        let branches = self.children(hand).filter(|&child| self.moving_joints(child) > 0);
        let Ok([one, other]) = <[usize; 2]>::try_from(branches.collect::<Vec<_>>()) else {
            return Ok(None);
        };
        let is_finger = |&branch: &usize| self.moving_joints(branch) == 1;
        let drives = [one, other].map(|branch| {
            let mut links = branch..self.subtree_end(branch);
            links.find_map(|link| Some((link, self.driving_dof(link)?)))
        });
        Ok(match ([one, other].iter().all(is_finger), drives) {
            (true, [Some((first, dof)), Some((second, same))]) if dof == same => {
                Some([first, second].map(|link| self.links[link].name.clone()))
            }
            _ => None,
        })
    }

    /// Returns the axis of the link `hand` (of its x, y and z, with a sign) along which it reaches
    /// out: towards the links that move on it, or else away from the link that carries it.
    ///
    /// # Errors
    /// [`DescriptionError::UnknownLink`].
    pub fn default_approach_axis(&self, hand: &str) -> Result<DVec3, DescriptionError> {
        let hand = self.link_index(hand, "the robot's hand")?;
        let poses = self.link_poses(&self.rest_positions());
        let place = poses[hand].position;
        let moving = (hand + 1..self.subtree_end(hand))
            .filter(|&link| self.joints[link - 1].motion.is_some())
            .map(|link| poses[link].position - place);
        let fingers: DVec3 = moving.sum();
        let ancestors = std::iter::successors(Some(hand), |&link| {
            link.checked_sub(1).map(|joint| self.joints[joint].parent)
        });
        let mut ways = std::iter::once(fingers)
            .chain(ancestors.map(|link| place - poses[link].position))
            .filter(|way| way.length() > SAME_PLACE);
        let way = ways.next().unwrap_or(poses[hand].rotation * DVec3::Z);
        let own = poses[hand].rotation.conjugate() * way;
        let along = own.abs().max_position();
        Ok(DVec3::AXES[along] * own[along].signum())
    }

    /// Returns the index in the position vector that moves a link against its parent, by the link's
    /// index.
    fn driving_dof(&self, link: usize) -> Option<usize> {
        match self.joints[link - 1].motion?.drive {
            PositionSource::Free { dof } | PositionSource::Follows { dof, .. } => Some(dof),
        }
    }

    fn children(&self, link: usize) -> impl Iterator<Item = usize> {
        let joints = self.joints.iter().enumerate();
        joints.filter(move |(_, joint)| joint.parent == link).map(|(index, _)| index + 1)
    }

    /// Returns the number of moving joints of the branch that begins with the joint of `link`.
    fn moving_joints(&self, link: usize) -> usize {
        let branch = link..self.subtree_end(link);
        branch.filter(|&below| self.joints[below - 1].motion.is_some()).count()
    }

    /// Returns the index after the last link that hangs on `link`. Links are in depth-first order.
    fn subtree_end(&self, link: usize) -> usize {
        let after = (link + 1..self.links.len()).find(|&next| self.joints[next - 1].parent < link);
        after.unwrap_or(self.links.len())
    }
}
