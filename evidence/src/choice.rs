//! Choice of a policy among those that the evidence accepts.

use cluster::Verdict;

use crate::opinion::Opinion;

/// Number of standard deviations by which first pictures and vectors must fit another policy better
/// before it replaces an accepted policy that acted.
const MARGIN: f64 = 3.0;
/// Largest p-value of the acting policy's first pictures or vectors at which it can be replaced.
// Groups that look alike differ by chance, too, so a better score alone is not enough.
const UNLIKELY: f64 = 1e-3;
/// Least quotient of the excesses over 1 of two distance ratios, every other policy's by the
/// nearest one's, for the nearest one to be singled out.
// Nearest at 1.6 and all others beyond 2.5, since 1.5 = 2.5 * 0.6 (docs/assignment.md, "Return").
const APART: f64 = 2.5;

/// Evidence for and against all policies, from episodes in which one of them acted.
pub(crate) struct Choice<'a> {
    opinions: &'a [Opinion],
    collector: usize,
}

impl<'a> Choice<'a> {
    pub(crate) fn new(opinions: &'a [Opinion], collector: usize) -> Self {
        Self { opinions, collector }
    }

    /// Returns the evidence for the policy that acted; `None` if it is not one of the policies.
    pub(crate) fn own(&self) -> Option<&'a Opinion> {
        self.opinions.get(self.collector)
    }

    /// Returns `true` if first pictures and vectors do not reject the acting policy at this
    /// significance level.
    pub(crate) fn is_alike(&self, level: f64) -> bool {
        self.own().is_some_and(|own| !own.looks_doubtful(level))
    }

    /// Returns the acting policy, or another one that fits much better; `None` if the acting policy
    /// is not accepted.
    pub(crate) fn kept(&self) -> Option<usize> {
        let own = self.own().filter(|own| own.verdict == Verdict::Accepted)?;
        let mut looks = own.sources().filter(|(kind, _)| kind.is_look());
        let is_unlikely = looks.any(|(_, source)| source.tail_p_value <= UNLIKELY);
        let better =
            |policy: &usize| self.opinions[*policy].look_score() + MARGIN < own.look_score();
        let other = self.fittest().filter(|policy| is_unlikely && better(policy));
        Some(other.unwrap_or(self.collector))
    }

    /// Returns the accepted policies, except the acting one, that fit about as well as the best.
    /// The policy with the largest gain in return comes first, because its returns say most.
    pub(crate) fn rivals(&self) -> Vec<usize> {
        let Some(fittest) = self.fittest() else {
            return Vec::new();
        };
        let most = self.opinions[fittest].misfit() + MARGIN;
        let is_near = |policy: &usize| self.opinions[*policy].misfit() <= most;
        let mut near: Vec<usize> = self.others().filter(is_near).collect();
        near.sort_by(|&a, &b| self.opinions[b].gain.total_cmp(&self.opinions[a].gain));
        near
    }

    /// Returns the index of a policy whose task group may have drifted while other policies acted.
    /// This is the eligible policy with the smallest distance ratio, if that is below `farthest`
    /// and every other policy that is not merged with it is far more distant; otherwise the nearest
    /// policy that `can_show` by its earnings that it serves the group, if its ratio is below
    /// `most`.
    pub(crate) fn drifted(
        &self,
        most: f64,
        farthest: f64,
        is_eligible: impl Fn(usize) -> bool,
        can_show: impl Fn(usize) -> bool,
        are_kin: impl Fn(usize, usize) -> bool,
    ) -> Option<usize> {
        let ratio = |policy: usize| self.opinions[policy].look_ratio();
        let mut tested: Vec<usize> = (0..self.opinions.len())
            .filter(|&policy| self.opinions[policy].test.is_some())
            .collect();
        tested.sort_by(|&a, &b| ratio(a).total_cmp(&ratio(b)));
        let mut eligible = tested.iter().copied().filter(|&policy| is_eligible(policy));
        let nearest = eligible.clone().next()?;
        let far = 1.0 + APART * (ratio(nearest) - 1.0).max(0.0);
        let mut others =
            tested.iter().filter(|&&other| other != nearest && !are_kin(nearest, other));
        let is_apart = others.next().is_some_and(|&next| ratio(next) >= far);
        if is_apart && ratio(nearest) < farthest {
            return Some(nearest);
        }
        let near = eligible.find(|&policy| can_show(policy));
        near.filter(|&policy| ratio(policy) < most)
    }

    /// Returns the accepted policies except the one that acted.
    fn others(&self) -> impl Iterator<Item = usize> {
        (0..self.opinions.len()).filter(|&policy| {
            policy != self.collector && self.opinions[policy].verdict == Verdict::Accepted
        })
    }

    /// Returns the accepted policy, except the acting one, that fits best; the first of equals.
    fn fittest(&self) -> Option<usize> {
        let misfit = |policy: &usize| self.opinions[*policy].misfit();
        self.others().min_by(|a, b| misfit(a).total_cmp(&misfit(b)))
    }
}
