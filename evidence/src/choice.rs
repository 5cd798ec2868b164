//! Choice of a policy among those that the evidence accepts.

use cluster::PolicyVerdict;

use crate::policy_test::PolicyTestResult;

/// Number of standard deviations by which first images and vectors must fit another policy better
/// before it replaces an accepted policy that acted.
const MARGIN: f64 = 3.0;
/// Largest p-value of the acting policy's first images or vectors at which it can be replaced.
// Groups that look alike differ by chance, too, so a better score alone is not enough.
const UNLIKELY: f64 = 1e-3;
/// Least quotient of the excesses over 1 of two distance ratios, every other policy's by the
/// nearest one's, for the nearest one to be singled out.
// Nearest at 1.6 and all others beyond 2.5, since 1.5 = 2.5 * 0.6 (docs/assignment.md, "Return").
const ISOLATION: f64 = 2.5;

/// Tests of all policies on the same episodes and the index of the policy that acted in them, from
/// which a policy is chosen.
pub(crate) struct PolicyChoice<'a> {
    tests: &'a [PolicyTestResult],
    collector: usize,
}

impl<'a> PolicyChoice<'a> {
    pub(crate) fn new(tests: &'a [PolicyTestResult], collector: usize) -> Self {
        Self { tests, collector }
    }

    /// Returns the test of the policy that acted; `None` if it is not one of the policies.
    pub(crate) fn collector_test(&self) -> Option<&'a PolicyTestResult> {
        self.tests.get(self.collector)
    }

    /// Returns the test of a policy.
    pub(crate) fn test(&self, policy: usize) -> &'a PolicyTestResult {
        &self.tests[policy]
    }

    /// Returns `true` if the episodes' first images and vectors do not differ from those that the
    /// acting policy remembers, at the significance level `level`.
    pub(crate) fn looks_familiar(&self, level: f64) -> bool {
        self.collector_test().is_some_and(|test| !test.first_observation_differs(level))
    }

    /// Returns the index of the acting policy, or of an accepted other one that fits much better;
    /// `None` if the acting policy is not accepted.
    pub(crate) fn accepted_collector(&self) -> Option<usize> {
        self.collector_test().filter(|test| test.verdict == PolicyVerdict::Accepted)?;
        Some(self.better_other().unwrap_or(self.collector))
    }

    /// Returns the index of the accepted other policy that fits best, if first images and vectors
    /// are unlikely for the acting policy and fit the other one much better.
    pub(crate) fn better_other(&self) -> Option<usize> {
        let own = self.collector_test()?;
        let is_unlikely = own.first_observation_p_value() <= UNLIKELY;
        let is_better = |policy: &usize| {
            self.tests[*policy].first_observation_score() + MARGIN < own.first_observation_score()
        };
        self.best_other().filter(|policy| is_unlikely && is_better(policy))
    }

    /// Returns the indices of the accepted policies, except the acting one, that fit about as well
    /// as the best of them; the largest gain in return comes first, because returns then say most.
    pub(crate) fn accepted_others(&self) -> Vec<usize> {
        let Some(best) = self.best_other() else {
            return Vec::new();
        };
        let most = self.tests[best].outlier_score() + MARGIN;
        let is_near = |policy: &usize| self.tests[*policy].outlier_score() <= most;
        let mut near: Vec<usize> = self.others().filter(is_near).collect();
        near.sort_by(|&a, &b| self.tests[b].gain.total_cmp(&self.tests[a].gain));
        near
    }

    /// Returns the index of a policy to whose task group the episodes may belong although it has
    /// drifted while other policies acted; `None` if there is none. This is the eligible policy
    /// with the smallest distance ratio, if that is below `max_isolated` and every other policy
    /// that is not merged with it is far more distant; otherwise the nearest policy that
    /// `can_prove` by its returns that it serves the group, if its ratio is below `max`.
    pub(crate) fn drifted(
        &self,
        max: f64,
        max_isolated: f64,
        is_eligible: impl Fn(usize) -> bool,
        can_prove: impl Fn(usize) -> bool,
        are_merged: impl Fn(usize, usize) -> bool,
    ) -> Option<usize> {
        let ratio = |policy: usize| self.tests[policy].first_observation_ratio();
        let mut tested: Vec<usize> =
            (0..self.tests.len()).filter(|&policy| self.tests[policy].test.is_some()).collect();
        tested.sort_by(|&a, &b| ratio(a).total_cmp(&ratio(b)));
        let mut eligible = tested.iter().copied().filter(|&policy| is_eligible(policy));
        let nearest = eligible.clone().next()?;
        let far = 1.0 + ISOLATION * (ratio(nearest) - 1.0).max(0.0);
        let is_other = |&other: &usize| other != nearest && !are_merged(nearest, other);
        let next = tested.iter().copied().find(is_other);
        if next.is_some_and(|next| ratio(next) >= far) && ratio(nearest) < max_isolated {
            return Some(nearest);
        }
        let near = eligible.find(|&policy| can_prove(policy));
        near.filter(|&policy| ratio(policy) < max)
    }

    /// Returns the indices of the accepted policies except the one that acted.
    fn others(&self) -> impl Iterator<Item = usize> {
        (0..self.tests.len()).filter(|&policy| {
            policy != self.collector && self.tests[policy].verdict == PolicyVerdict::Accepted
        })
    }

    /// Returns the accepted policy, except the acting one, that fits best; on a tie the first.
    fn best_other(&self) -> Option<usize> {
        let score = |policy: &usize| self.tests[*policy].outlier_score();
        self.others().min_by(|a, b| score(a).total_cmp(&score(b)))
    }
}
