//! Conversion of p-values into a probability for each policy.

/// Probability for each policy that episodes belong to its task group, and that they belong to
/// none.
#[derive(Clone, Debug, PartialEq)]
pub struct TaskGroupProbabilities {
    /// Probability of each policy's task group, in the order of the policies.
    pub policies: Vec<f64>,
    /// Probability of a task group that no policy knows.
    pub none: f64,
    /// Outlier score of each policy, which ranks equal probabilities.
    outlier_scores: Vec<f64>,
}

/// Weight of a task group that no policy knows, relative to 1 for a policy without evidence against
/// it.
const UNKNOWN_WEIGHT: f64 = 0.05;
/// Least weight of a policy at which episodes count as typical of it; this is a p-value of 0.07.
const TYPICAL_WEIGHT: f64 = 0.5;
/// Least weight of a policy whose difference from the episodes may be drift.
const DRIFT_WEIGHT: f64 = 0.1;

impl TaskGroupProbabilities {
    /// Creates the probabilities from the weight and the outlier score of each policy.
    pub(crate) fn new(policies: impl Iterator<Item = (f64, f64)>) -> Self {
        let (weights, outlier_scores) = policies.unzip::<_, _, Vec<_>, Vec<_>>();
        let all = weights.iter().sum::<f64>() + UNKNOWN_WEIGHT;
        let share = |weight: f64| weight / all;
        Self {
            policies: weights.into_iter().map(share).collect(),
            none: share(UNKNOWN_WEIGHT),
            outlier_scores,
        }
    }

    /// Returns the index of the most probable policy; `None` if it is more probable that none fits.
    /// Among equals the smallest outlier score wins, then the first policy.
    pub fn most_probable_policy(&self) -> Option<usize> {
        let policies = self.policies.iter().zip(&self.outlier_scores).enumerate();
        let best = policies
            .min_by(|(_, (p, score)), (_, (q, other))| q.total_cmp(p).then(score.total_cmp(other)));
        best.filter(|(_, (p, _))| **p >= self.none).map(|(index, _)| index)
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

    fn most_probable_policy(policies: &[(f64, f64)]) -> Option<usize> {
        let weighed = policies.iter().map(|&(p, score)| (weight(p, true), score));
        TaskGroupProbabilities::new(weighed).most_probable_policy()
    }

    #[test]
    fn of_equals_the_best_fit_is_named_and_then_the_first() {
        assert_eq!(most_probable_policy(&[(0.5, 2.0), (0.9, 1.0)]), Some(1));
        assert_eq!(most_probable_policy(&[(0.5, 1.0), (0.9, 2.0)]), Some(0));
        assert_eq!(most_probable_policy(&[(0.5, 1.0), (0.9, 1.0)]), Some(0));
        assert_eq!(most_probable_policy(&[(0.01, 0.0), (0.9, 1.0)]), Some(1));
        assert_eq!(
            TaskGroupProbabilities::new([(0.0, 0.0)].into_iter()).most_probable_policy(),
            None
        );
    }

    #[test]
    fn one_strange_episode_is_typical_of_no_policy() {
        // of 41 episodes, the strange one is the farthest from the rest
        let [strange, usual] = [1.0 / 41.0, 0.3].map(|p_value| (weight(p_value, true), 0.0));
        assert!(!TaskGroupProbabilities::new([strange; 3].into_iter()).fits_any_policy());
        assert!(TaskGroupProbabilities::new([strange, usual].into_iter()).fits_any_policy());
        assert!(!TaskGroupProbabilities::new([].into_iter()).fits_any_policy());
    }

    #[test]
    fn the_factor_falls_from_one_to_zero() {
        assert_eq!((bayes_factor(1.0), bayes_factor(0.0)), (1.0, 0.0));
        assert!((bayes_factor(0.05) - 0.407).abs() < 1e-3, "the paper's table 1");
        assert!(bayes_factor(0.3) > bayes_factor(0.01));
    }
}
