//! Grouping by the 1-Wasserstein distance of invariant features.

use cluster::{assign_by_threshold, lead};
use rand_chacha::ChaCha8Rng;

use crate::error::LearnerError;

use super::grouping::{Candidates, Grouping, GroupingDecision, Query};

/// Grouping of the paper: compares a rollout's first frames (`O`) with those that each policy keeps
/// (`B`), in that policy's features, and takes the nearest policy within a threshold.
#[derive(Clone, Copy, Debug)]
pub struct Distance {
    threshold: f64,
}

impl Distance {
    /// Creates a grouping with the largest distance within a task group (`d_epsilon`), in the
    /// features' unit.
    ///
    /// # Errors
    /// A threshold that is negative or not finite.
    pub fn new(threshold: f64) -> Result<Self, LearnerError> {
        assign_by_threshold(&[], threshold)?;
        Ok(Self { threshold })
    }
}

impl Grouping for Distance {
    fn assign(
        &mut self,
        _: Query<'_>,
        candidates: &mut dyn Candidates,
        _: &mut ChaCha8Rng,
    ) -> Result<GroupingDecision, LearnerError> {
        let assignment = assign_by_threshold(&candidates.clouds()?, self.threshold)?;
        Ok(assignment.into())
    }
}

/// Largest number of episodes of each policy that [`nearest`] compares with a rollout; this bounds
/// the time of the networks.
const COMPARED: usize = 40;

/// Returns the policy whose first frames are nearest to those of the rollout; 0 if `policies` is
/// empty.
///
/// A frame unlike all remembered ones, for example of another camera, may by chance be less distant
/// in the features of a wrong policy. So every two policies are compared in the features of both,
/// and the nearer one is compared with the next.
///
/// # Errors
/// Errors of a network.
pub(super) fn nearest(
    candidates: &mut dyn Candidates,
    policies: impl IntoIterator<Item = usize>,
) -> Result<usize, LearnerError> {
    let mut best = None;
    for policy in policies {
        best = match best {
            Some(best) if lead(&candidates.contests([best, policy], COMPARED)?)? >= 0.0 => {
                Some(best)
            }
            _ => Some(policy),
        };
    }
    Ok(best.unwrap_or(0))
}

#[cfg(test)]
mod tests {
    use cluster::{Candidate, Contest, Frames};
    use rand::{RngExt, SeedableRng};

    use super::*;
    use crate::groupings::grouping::Episodes;

    /// Policies that know frames around -1 and 1 of two features. The first feature alone tells
    /// whose a frame is, and policy 1 hardly sees it.
    struct Glance {
        seen: [f32; 2],
        rng: ChaCha8Rng,
    }

    impl Glance {
        const SIGHT: [[f32; 2]; 2] = [[1.0, 1.0], [0.2, 1.0]];

        fn frames(&self, policy: usize, points: &[[f32; 2]]) -> Frames {
            let [x, y] = Self::SIGHT[policy];
            let seen = points.iter().flat_map(|p| [x * p[0], y * p[1]]);
            Frames::new(seen.collect(), 1, 2).unwrap()
        }

        fn home(&self, policy: usize) -> Vec<[f32; 2]> {
            let mut rng = self.rng.clone();
            let centre = [-1.0, 1.0][policy];
            let mut near = |width: f32| rng.random_range(-width..width);
            let points = (0..40).map(|_| [centre + near(0.5), near([0.5, 1.5][policy])]);
            points.collect()
        }
    }

    impl Candidates for Glance {
        fn clouds(&mut self) -> Result<Vec<Candidate>, LearnerError> {
            panic!("two policies at a time are compared")
        }

        fn contests(&mut self, rivals: [usize; 2], _: usize) -> Result<[Contest; 2], LearnerError> {
            Ok(rivals.map(|policy| Contest {
                rollout: self.frames(policy, &[self.seen]),
                rivals: rivals.map(|rival| self.frames(policy, &self.home(rival))),
            }))
        }

        fn episodes(&self) -> Episodes<'_> {
            panic!("first frames are compared")
        }
    }

    /// The second feature of the first frame is beyond what policy 0 knows and within what policy 1
    /// does.
    #[test]
    fn a_strange_frame_goes_to_the_policy_whose_frames_it_is_nearer_to() {
        let mut glance = Glance { seen: [0.0; 2], rng: ChaCha8Rng::seed_from_u64(3) };
        for (seen, expected) in [([-1.0, 1.2], 0), ([-1.0, 0.1], 0), ([1.0, 0.1], 1)] {
            glance.seen = seen;
            assert_eq!(nearest(&mut glance, [0, 1]).unwrap(), expected);
            assert_eq!(nearest(&mut glance, [1, 0]).unwrap(), expected);
        }
        assert_eq!(nearest(&mut glance, []).unwrap(), 0);
    }
}
