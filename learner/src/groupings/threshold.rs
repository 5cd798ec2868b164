//! Grouping by the 1-Wasserstein distance of invariant features.

use cluster::{assign_by_threshold, nearer_policy_margin};
use rand_chacha::ChaCha8Rng;

use crate::error::LearnerError;

use super::grouping::{AssignmentData, AssignmentPurpose, Grouping, GroupingDecision};

/// Grouping of the paper: compares a rollout's first frames (`O`) with those that each policy keeps
/// (`B`), in that policy's features, and takes the nearest policy within a threshold, or else a new
/// one.
#[derive(Clone, Copy, Debug)]
pub struct ThresholdGrouping {
    threshold: f64,
}

impl ThresholdGrouping {
    /// Creates a grouping in which a rollout belongs to a policy up to the distance `threshold`
    /// (the paper's `d_epsilon`), in the features' unit.
    ///
    /// # Errors
    /// A threshold that is negative or not finite.
    pub fn new(threshold: f64) -> Result<Self, LearnerError> {
        assign_by_threshold(&[], threshold)?;
        Ok(Self { threshold })
    }
}

impl Grouping for ThresholdGrouping {
    fn assign(
        &mut self,
        _: AssignmentPurpose<'_>,
        data: &mut dyn AssignmentData,
        _: &mut ChaCha8Rng,
    ) -> Result<GroupingDecision, LearnerError> {
        Ok(assign_by_threshold(&data.clouds()?, self.threshold)?.into())
    }
}

/// Largest number of episodes of each policy that [`nearest_policy`] compares with a rollout; this
/// bounds the time of the networks.
const MAX_COMPARED: usize = 40;

/// Returns the index of the policy in `policies` whose first frames are nearest to those of the
/// rollout; 0 if `policies` is empty.
///
/// A frame unlike all remembered ones, for example of another camera, may by chance be less distant
/// in the features of a wrong policy. So every two policies are compared in the features of both,
/// and the nearer one is compared with the next.
///
/// # Errors
/// Errors of a network.
pub(super) fn nearest_policy(
    data: &mut dyn AssignmentData,
    policies: impl IntoIterator<Item = usize>,
) -> Result<usize, LearnerError> {
    let mut policies = policies.into_iter();
    let mut best = policies.next().unwrap_or(0);
    for policy in policies {
        if nearer_policy_margin(&data.comparisons([best, policy], MAX_COMPARED)?)? < 0.0 {
            best = policy;
        }
    }
    Ok(best)
}

#[cfg(test)]
mod tests {
    use cluster::{FrameFeatures, NearerPolicyInputs, RolloutAndBufferFeatures};
    use rand::{RngExt, SeedableRng};

    use super::*;
    use crate::groupings::grouping::RolloutEpisodes;

    /// Policies that know frames around -1 and 1 of two features. The first feature alone separates
    /// them, and policy 1 hardly sees it.
    struct TwoFeatures {
        seen: [f32; 2],
        rng: ChaCha8Rng,
    }

    impl TwoFeatures {
        const SCALES: [[f32; 2]; 2] = [[1.0, 1.0], [0.2, 1.0]];

        fn frames(&self, policy: usize, points: &[[f32; 2]]) -> FrameFeatures {
            let [x, y] = Self::SCALES[policy];
            let seen = points.iter().flat_map(|p| [x * p[0], y * p[1]]);
            FrameFeatures::new(seen.collect(), 1, 2).unwrap()
        }

        fn known(&self, policy: usize) -> Vec<[f32; 2]> {
            let mut rng = self.rng.clone();
            let centre = [-1.0, 1.0][policy];
            let mut near = |width: f32| rng.random_range(-width..width);
            let points = (0..40).map(|_| [centre + near(0.5), near([0.5, 1.5][policy])]);
            points.collect()
        }
    }

    impl AssignmentData for TwoFeatures {
        fn clouds(&mut self) -> Result<Vec<RolloutAndBufferFeatures>, LearnerError> {
            panic!("two policies at a time are compared")
        }

        fn comparisons(
            &mut self,
            policies: [usize; 2],
            _: usize,
        ) -> Result<[NearerPolicyInputs; 2], LearnerError> {
            Ok(policies.map(|policy| NearerPolicyInputs {
                rollout: self.frames(policy, &[self.seen]),
                policies: policies.map(|other| self.frames(policy, &self.known(other))),
            }))
        }

        fn episodes(&self) -> RolloutEpisodes<'_> {
            panic!("first frames are compared")
        }
    }

    /// The second feature of the first frame is beyond what policy 0 knows and within what policy 1
    /// does.
    #[test]
    fn an_unusual_frame_goes_to_the_policy_whose_frames_it_is_nearer_to() {
        let mut data = TwoFeatures { seen: [0.0; 2], rng: ChaCha8Rng::seed_from_u64(3) };
        for (seen, expected) in [([-1.0, 1.2], 0), ([-1.0, 0.1], 0), ([1.0, 0.1], 1)] {
            data.seen = seen;
            assert_eq!(nearest_policy(&mut data, [0, 1]).unwrap(), expected);
            assert_eq!(nearest_policy(&mut data, [1, 0]).unwrap(), expected);
        }
        assert_eq!(nearest_policy(&mut data, []).unwrap(), 0);
    }
}
