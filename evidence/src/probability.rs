//! Conversion of p-values into a probability for each policy.

/// Probability for each policy that episodes belong to its task group, and that they belong to
/// none.
#[derive(Clone, Debug, PartialEq)]
pub struct TaskGroupProbabilities {
    /// Probability of each policy's task group, in the order of the policies.
    pub policies: Vec<f64>,
    /// Probability of a task group that no policy knows.
    pub none: f64,
    /// Candidates, in the order of the policies.
    candidates: Vec<CandidatePolicy>,
}

/// Policy whose task group episodes may belong to.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct CandidatePolicy {
    /// Probability before normalisation.
    pub(crate) weight: f64,
    /// Outlier score, which ranks equal probabilities.
    pub(crate) outlier_score: f64,
    /// `true` if the policy's return has risen in training.
    pub(crate) has_gain: bool,
}

/// Weight of a task group that no policy knows, relative to 1 for a policy without evidence against
/// it.
const UNKNOWN_WEIGHT: f64 = 0.05;
/// Least weight of a policy at which episodes count as typical of it; this is a p-value of 0.07.
const TYPICAL_WEIGHT: f64 = 0.5;
/// Least weight of a policy whose difference from the episodes may be drift.
const DRIFT_WEIGHT: f64 = 0.1;

impl TaskGroupProbabilities {
    /// Creates the probabilities of the candidates.
    pub(crate) fn new(candidates: Vec<CandidatePolicy>) -> Self {
        let all = candidates.iter().map(|policy| policy.weight).sum::<f64>() + UNKNOWN_WEIGHT;
        let share = |weight: f64| weight / all;
        Self {
            policies: candidates.iter().map(|policy| share(policy.weight)).collect(),
            none: share(UNKNOWN_WEIGHT),
            candidates,
        }
    }

    /// Returns the index of the most probable policy; `None` if it is more probable that none fits.
    /// Among equals the smallest outlier score wins, then the first policy. A policy that has
    /// learnt nothing gives way to the most probable one that has, if that is at least half as
    /// probable.
    pub fn most_probable_policy(&self) -> Option<usize> {
        let best = self.most_probable_among(|_| true)?;
        let least = (TYPICAL_WEIGHT * self.policies[best]).max(self.none);
        let may_act =
            |policy: usize| self.candidates[policy].has_gain && self.policies[policy] >= least;
        let has_gain = self.candidates[best].has_gain;
        let other = if has_gain { None } else { self.most_probable_among(may_act) };
        other.or(Some(best)).filter(|&policy| self.policies[policy] >= self.none)
    }

    fn most_probable_among(&self, may_act: impl Fn(usize) -> bool) -> Option<usize> {
        let score = |policy: usize| self.candidates[policy].outlier_score;
        let policies = (0..self.policies.len()).filter(|&policy| may_act(policy));
        policies.min_by(|&a, &b| {
            self.policies[b].total_cmp(&self.policies[a]).then(score(a).total_cmp(&score(b)))
        })
    }

    /// Returns `true` if the episodes are typical of at least one policy. If they are typical of
    /// none, as with images of another camera, the probabilities mean little.
    pub fn fits_any_policy(&self) -> bool {
        let most = self.policies.iter().copied().fold(0.0, f64::max);
        most * UNKNOWN_WEIGHT >= TYPICAL_WEIGHT * self.none
    }
}

/// Returns the bound `-e p ln p` on the Bayes factor in favour of a null hypothesis with p-value p:
/// Sellke, Bayarri and Berger, "Calibration of p values for testing precise null hypotheses", The
/// American Statistician 55 (2001), equation 2.
fn bayes_factor(p: f64) -> f64 {
    // the bound holds for p < 1/e, where it reaches 1
    if p < (-1.0_f64).exp() {
        -std::f64::consts::E * p * p.max(f64::MIN_POSITIVE).ln()
    } else {
        1.0
    }
}

/// Returns the weight of a policy, its probability before normalisation, from the tail p-value of
/// its test; `may_be_drift` says that no source shows a significant difference larger than drift.
pub(crate) fn weight(p_value: f64, may_be_drift: bool) -> f64 {
    bayes_factor(p_value).max(if may_be_drift { DRIFT_WEIGHT } else { 0.0 })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn candidate(weight: f64, outlier_score: f64) -> CandidatePolicy {
        CandidatePolicy { weight, outlier_score, has_gain: true }
    }

    fn most_probable_policy(policies: &[(f64, f64)]) -> Option<usize> {
        let weighed = policies.iter().map(|&(p, score)| candidate(weight(p, true), score));
        TaskGroupProbabilities::new(weighed.collect()).most_probable_policy()
    }

    #[test]
    fn of_equals_the_best_fit_is_named_and_then_the_first() {
        assert_eq!(most_probable_policy(&[(0.5, 2.0), (0.9, 1.0)]), Some(1));
        assert_eq!(most_probable_policy(&[(0.5, 1.0), (0.9, 2.0)]), Some(0));
        assert_eq!(most_probable_policy(&[(0.5, 1.0), (0.9, 1.0)]), Some(0));
        assert_eq!(most_probable_policy(&[(0.01, 0.0), (0.9, 1.0)]), Some(1));
        let unknown = TaskGroupProbabilities::new(vec![candidate(0.0, 0.0)]);
        assert_eq!(unknown.most_probable_policy(), None);
    }

    #[test]
    fn a_policy_that_has_learnt_nothing_gives_way_to_one_that_fits_about_as_well() {
        let named = |p_value: f64, gains: [bool; 2]| {
            let mut candidates = [1.0, weight(p_value, true)].map(|weight| candidate(weight, 0.0));
            candidates[0].has_gain = gains[0];
            candidates[1].has_gain = gains[1];
            TaskGroupProbabilities::new(candidates.to_vec()).most_probable_policy()
        };
        assert_eq!(named(0.2, [false, true]), Some(1));
        // far less probable
        assert_eq!(named(0.01, [false, true]), Some(0));
        assert_eq!(named(0.2, [false, false]), Some(0));
        assert_eq!(named(0.2, [true, true]), Some(0));
        assert_eq!(named(0.2, [true, false]), Some(0));
    }

    #[test]
    fn one_strange_episode_is_typical_of_no_policy() {
        // of 41 episodes, the strange one is the farthest from the rest
        let [strange, usual] =
            [1.0 / 41.0, 0.3].map(|p_value| candidate(weight(p_value, true), 0.0));
        assert!(!TaskGroupProbabilities::new(vec![strange; 3]).fits_any_policy());
        assert!(TaskGroupProbabilities::new(vec![strange, usual]).fits_any_policy());
        assert!(!TaskGroupProbabilities::new(vec![]).fits_any_policy());
    }

    #[test]
    fn the_factor_falls_from_one_to_zero() {
        assert_eq!((bayes_factor(1.0), bayes_factor(0.0)), (1.0, 0.0));
        assert!((bayes_factor(0.05) - 0.407).abs() < 1e-3, "the paper's table 1");
        assert!(bayes_factor(0.3) > bayes_factor(0.01));
    }
}
