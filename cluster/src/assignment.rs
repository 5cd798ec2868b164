//! Evidence and decisions of policy assignment (lines 8-15 of the paper's Algorithm 1), and the
//! paper's own rule.

use crate::check::check_range;
use crate::error::Result;
use crate::frames::RolloutAndBufferFeatures;
use crate::permutation::PermutationTestResult;
use crate::wasserstein::wasserstein1;

/// Policy that a rollout is assigned to: an existing one, a new one, or none yet.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum AssignedPolicy {
    /// Existing policy, given by its index among the candidates.
    Existing(usize),
    /// New policy, since no candidate fits.
    New,
    /// No policy yet: no candidate fits, but one rollout is too little to create a policy.
    Undecided,
}

/// Outcome of the comparison of a rollout with one candidate policy: accepted, doubted or rejected.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum PolicyVerdict {
    /// Candidate policy accepted: the rollout may belong to its task group.
    Accepted,
    /// Candidate policy doubted: the rollout probably does not belong to its task group; a second
    /// test decides.
    Doubted,
    /// Candidate policy rejected: the rollout does not belong to its task group.
    Rejected,
}

/// Evidence on the assignment of a rollout to one candidate policy: distance, permutation test and
/// verdict.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct PolicyEvidence {
    /// 1-Wasserstein distance between the points of the rollout and of the policy's buffer, in the
    /// unit of the features.
    pub distance: f64,
    /// Permutation test of the candidate policy; `None` under the paper's rule, or if its buffer
    /// holds too few episodes. It is then accepted for lack of evidence against it.
    pub test: Option<PermutationTestResult>,
    /// Outcome of the comparison of the rollout with the candidate policy.
    pub verdict: PolicyVerdict,
}

impl PolicyEvidence {
    /// Returns the score of the permutation test, in standard deviations above the mean of random
    /// splits; `None` without a test.
    pub fn test_score(&self) -> Option<f64> {
        self.test.map(|test| test.score)
    }

    /// Returns the sort key of a candidate policy: tested ones by score, then the others by
    /// distance.
    fn rank(&self) -> (bool, f64) {
        self.test_score().map_or((true, self.distance), |score| (false, score))
    }
}

/// Decision on the policy of a rollout, with the evidence for each candidate policy.
#[derive(Clone, Debug, PartialEq)]
pub struct PolicyAssignment {
    /// Policy that the rollout is assigned to.
    pub decision: AssignedPolicy,
    /// Evidence for and against each candidate policy, in the order of the candidates.
    pub evidence: Vec<PolicyEvidence>,
}

impl PolicyAssignment {
    /// Returns the index of the candidate policy that fits best, accepted or not: of the tested
    /// ones that with the smallest score, without any the nearest; `None` without candidates.
    pub fn best_candidate(&self) -> Option<usize> {
        let ranked = self.evidence.iter().enumerate();
        let best = ranked.min_by(|(_, a), (_, b)| {
            let ((a_last, a), (b_last, b)) = (a.rank(), b.rank());
            a_last.cmp(&b_last).then(a.total_cmp(&b))
        });
        best.map(|(index, _)| index)
    }
}

/// Assigns a rollout by the paper's rule: to the candidate policy at the smallest `W1` distance, on
/// a tie the first, or to a new policy if that exceeds `threshold` (`d_epsilon`, 1.0 in the paper).
/// The rule depends on the scale of the features.
///
/// # Errors
/// Clouds that cannot be compared, or a threshold that is negative or not finite.
pub fn assign_by_threshold(
    candidates: &[RolloutAndBufferFeatures],
    threshold: f64,
) -> Result<PolicyAssignment> {
    let inside = (0.0..f64::INFINITY).contains(&threshold);
    check_range("threshold", threshold, inside, "a finite number, at least 0")?;
    let compared = candidates.iter().map(|RolloutAndBufferFeatures { rollout, buffer }| {
        rollout.check_alike(buffer)?;
        let distance = wasserstein1(rollout.features(), buffer.features(), rollout.dim())?;
        let is_near = distance <= threshold;
        Ok(PolicyEvidence {
            distance,
            test: None,
            verdict: if is_near { PolicyVerdict::Accepted } else { PolicyVerdict::Rejected },
        })
    });
    let evidence: Vec<PolicyEvidence> = compared.collect::<Result<_>>()?;
    let mut assignment = PolicyAssignment { decision: AssignedPolicy::New, evidence };
    if let Some(nearest) = assignment.best_candidate()
        && assignment.evidence[nearest].verdict == PolicyVerdict::Accepted
    {
        assignment.decision = AssignedPolicy::Existing(nearest);
    }
    Ok(assignment)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::frames::FrameFeatures;

    #[test]
    fn the_papers_rule_compares_with_its_threshold() {
        // two points 3 apart: the distance is exactly 3, and the paper rejects only what exceeds
        // the threshold
        let points = |x: f32| FrameFeatures::new(vec![x], 1, 1).unwrap();
        let away = |x: f32| RolloutAndBufferFeatures { buffer: points(x), rollout: points(0.0) };
        let decide = |threshold, candidates: &[RolloutAndBufferFeatures]| {
            assign_by_threshold(candidates, threshold).unwrap().decision
        };
        assert_eq!(decide(3.0, &[away(3.0)]), AssignedPolicy::Existing(0));
        assert_eq!(decide(2.999, &[away(3.0)]), AssignedPolicy::New);
        assert_eq!(decide(3.0, &[away(2.0), away(-1.0), away(1.0)]), AssignedPolicy::Existing(1));
        assert_eq!(decide(1.0, &[]), AssignedPolicy::New);
        let evidence = assign_by_threshold(&[away(2.0)], 1.0).unwrap().evidence[0];
        assert_eq!((evidence.distance, evidence.test_score()), (2.0, None));
        for wrong in [-1.0, f64::NAN, f64::INFINITY] {
            assert!(assign_by_threshold(&[away(1.0)], wrong).is_err());
        }
    }

    #[test]
    fn candidates_that_cannot_be_compared_are_rejected() {
        let frames = |dim| FrameFeatures::new(vec![0.0; 4 * dim], 2, dim).unwrap();
        let good = RolloutAndBufferFeatures { buffer: frames(3), rollout: frames(3) };
        let odd = RolloutAndBufferFeatures { buffer: frames(2), rollout: frames(3) };
        let message = assign_by_threshold(&[good, odd], 1.0).unwrap_err().to_string();
        assert_eq!(message, "dim is 3 in one cloud and 2 in the other, expected the same");
    }
}
