//! From p-values to the probability of each policy.

/// How likely it is that each policy's group is at hand, and that none is.
#[derive(Clone, Debug, PartialEq)]
pub struct Probabilities {
    /// One item a policy, in their order.
    pub policies: Vec<f64>,
    /// The probability of a group that no policy knows.
    pub none: f64,
}

/// How much "none of these" weighs beside a policy that nothing speaks against.
const NONE: f64 = 0.05;
/// What a policy weighs at least whose difference may be drift.
const ACCEPTED: f64 = 0.1;

impl Probabilities {
    /// For each policy the p-value of its group, and whether a difference may be drift.
    pub(crate) fn of(policies: impl Iterator<Item = (f64, bool)>) -> Self {
        let weights: Vec<f64> = policies.map(weight).collect();
        let all = weights.iter().sum::<f64>() + NONE;
        Self {
            policies: weights.into_iter().map(|weight| weight / all).collect(),
            none: NONE / all,
        }
    }

    /// The likeliest policy; none where that is likelier.
    pub fn likeliest(&self) -> Option<usize> {
        let policies = self.policies.iter().enumerate();
        let best = policies.max_by(|(_, a), (_, b)| a.total_cmp(b));
        best.filter(|(_, p)| **p >= self.none)
            .map(|(index, _)| index)
    }
}

/// The bound `-e p ln p` on the Bayes factor in favour of a null hypothesis whose p-value is p:
/// Sellke, Bayarri and Berger, "Calibration of p values for testing precise null hypotheses", The
/// American Statistician 55 (2001), equation 2.
fn bayes_factor(p: f64) -> f64 {
    match p < (-1.0_f64).exp() {
        true => -std::f64::consts::E * p * p.max(f64::MIN_POSITIVE).ln(),
        false => 1.0,
    }
}

fn weight((p, may_be_drift): (f64, bool)) -> f64 {
    let weight = bayes_factor(p);
    match may_be_drift {
        true => weight.max(ACCEPTED),
        false => weight,
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn the_factor_falls_from_one_to_zero() {
        assert_eq!(bayes_factor(1.0), 1.0);
        assert_eq!(bayes_factor(0.0), 0.0);
        assert!(
            (bayes_factor(0.05) - 0.407).abs() < 1e-3,
            "the paper's table 1"
        );
        assert!(bayes_factor(0.3) > bayes_factor(0.01));
    }
}
