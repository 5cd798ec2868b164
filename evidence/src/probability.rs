//! Conversion of p-values into a probability for each policy.

/// Probability that episodes show each policy's task group, or one that no policy knows.
#[derive(Clone, Debug, PartialEq)]
pub struct Probabilities {
    /// Probability of each policy's task group, in the order of the policies.
    pub policies: Vec<f64>,
    /// Probability of a task group that no policy knows.
    pub none: f64,
    /// Outlier score of each policy, which ranks equal probabilities.
    misfits: Vec<f64>,
}

/// Evidence about one policy that its probability depends on.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Weighed {
    /// Tail p-value; `None` if the policy was merged or remembers too few episodes to be tested.
    pub(crate) p_value: Option<f64>,
    /// `true` if no source shows a significant difference larger than drift.
    pub(crate) may_be_drift: bool,
    pub(crate) misfit: f64,
}

/// Weight of "none of these", relative to 1 for a policy without evidence against it.
const NONE: f64 = 0.05;
/// Least weight of a policy whose own episodes would look like these: a p-value of 0.07.
const TYPICAL: f64 = 0.5;
/// Least weight of a policy whose difference may be drift.
const ACCEPTED: f64 = 0.1;

impl Probabilities {
    pub(crate) fn of(policies: &[Weighed]) -> Self {
        let weights: Vec<f64> = policies.iter().map(weight).collect();
        let all = weights.iter().sum::<f64>() + NONE;
        Self {
            policies: weights.into_iter().map(|weight| weight / all).collect(),
            none: NONE / all,
            misfits: policies.iter().map(|weighed| weighed.misfit).collect(),
        }
    }

    /// Returns the index of the likeliest policy; `None` if "none of these" is likelier. Among
    /// equals the best fit wins, then the first.
    pub fn likeliest(&self) -> Option<usize> {
        let policies = self.policies.iter().zip(&self.misfits).enumerate();
        let best = policies.min_by(|(_, (p, misfit)), (_, (q, other))| {
            q.total_cmp(p).then(misfit.total_cmp(other))
        });
        best.filter(|(_, (p, _))| **p >= self.none).map(|(index, _)| index)
    }

    /// Returns `true` if the episodes are nothing unusual for at least one policy. If they are
    /// unusual for all, as images of another camera, probabilities compare what is never right.
    pub fn is_typical(&self) -> bool {
        let most = self.policies.iter().copied().fold(0.0, f64::max);
        most * NONE >= TYPICAL * self.none
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

fn weight(weighed: &Weighed) -> f64 {
    let weight = weighed.p_value.map_or(0.0, bayes_factor);
    if weighed.may_be_drift && weighed.p_value.is_some() { weight.max(ACCEPTED) } else { weight }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn likeliest(policies: &[(Option<f64>, f64)]) -> Option<usize> {
        let weighed = policies.iter().map(|&(p_value, misfit)| Weighed {
            p_value,
            may_be_drift: true,
            misfit,
        });
        Probabilities::of(&weighed.collect::<Vec<_>>()).likeliest()
    }

    #[test]
    fn of_equals_the_best_fit_is_named_and_then_the_first() {
        assert_eq!(likeliest(&[(Some(0.5), 2.0), (Some(0.9), 1.0)]), Some(1));
        assert_eq!(likeliest(&[(Some(0.5), 1.0), (Some(0.9), 2.0)]), Some(0));
        assert_eq!(likeliest(&[(Some(0.5), 1.0), (Some(0.9), 1.0)]), Some(0));
        assert_eq!(likeliest(&[(Some(0.01), 0.0), (Some(0.9), 1.0)]), Some(1));
    }

    #[test]
    fn who_was_not_tested_is_not_named() {
        assert_eq!(likeliest(&[(None, 0.0), (Some(0.1), 3.0)]), Some(1));
        assert_eq!(likeliest(&[(None, 0.0)]), None);
    }

    #[test]
    fn one_strange_episode_is_typical_of_no_policy() {
        // of 41 episodes, the strange one is the farthest from the rest
        let strange = Weighed { p_value: Some(1.0 / 41.0), may_be_drift: true, misfit: 0.0 };
        let usual = Weighed { p_value: Some(0.3), ..strange };
        assert!(!Probabilities::of(&[strange; 3]).is_typical());
        assert!(Probabilities::of(&[strange, usual]).is_typical());
        assert!(!Probabilities::of(&[]).is_typical());
    }

    #[test]
    fn the_factor_falls_from_one_to_zero() {
        assert_eq!(bayes_factor(1.0), 1.0);
        assert_eq!(bayes_factor(0.0), 0.0);
        assert!((bayes_factor(0.05) - 0.407).abs() < 1e-3, "the paper's table 1");
        assert!(bayes_factor(0.3) > bayes_factor(0.01));
    }
}
