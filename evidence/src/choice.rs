//! Who is proposed among those that nothing speaks against.

use cluster::Verdict;

use crate::opinion::Opinion;

/// Another policy takes over from one that acted and is accepted where it fits what is seen at the
/// beginning of episodes by so many standard deviations better,
const MARGIN: f64 = 3.0;
/// and where that has at most this probability for the one that acted. Groups that look alike, too,
/// differ by chance.
const UNLIKELY: f64 = 1e-3;
/// A policy is by far the nearest if the ratio of every other one exceeds 1 by so many times as
/// much.
const APART: f64 = 2.5;

/// All policies' opinions of episodes in which one of them acted.
pub(crate) struct Choice<'a> {
    opinions: &'a [Opinion],
    collector: usize,
}

impl<'a> Choice<'a> {
    pub(crate) fn new(opinions: &'a [Opinion], collector: usize) -> Self {
        Self { opinions, collector }
    }

    /// The opinion on the policy that acted, if it is one of them.
    pub(crate) fn own(&self) -> Option<&'a Opinion> {
        self.opinions.get(self.collector)
    }

    /// Whether the policy that acted is at home by the looks, at this level.
    pub(crate) fn is_alike(&self, level: f64) -> bool {
        self.own().is_some_and(|own| !own.looks_doubtful(level))
    }

    /// Where the policy that acted is accepted: it, unless another one fits much better.
    pub(crate) fn kept(&self) -> Option<usize> {
        let own = self.own().filter(|own| own.verdict == Verdict::Accepted)?;
        let mut looks = own.sources().filter(|(kind, _)| kind.is_look());
        let is_unlikely = looks.any(|(_, source)| source.tail_p_value <= UNLIKELY);
        let better =
            |policy: &usize| self.opinions[*policy].look_score() + MARGIN < own.look_score();
        let other = self.fittest().filter(|policy| is_unlikely && better(policy));
        Some(other.unwrap_or(self.collector))
    }

    /// The accepted policies, but for the one that acted, that fit about as well as the fittest.
    /// The one that has learnt most comes first: what it earns shows best whether it is meant.
    pub(crate) fn rivals(&self) -> Vec<usize> {
        let Some(fittest) = self.fittest() else {
            return Vec::new();
        };
        let most = self.opinions[fittest].misfit() + MARGIN;
        let is_near = |policy: &usize| self.opinions[*policy].misfit() <= most;
        let mut near: Vec<usize> = self.others().filter(is_near).collect();
        near.sort_by(|&a, &b| self.opinions[b].learnt.total_cmp(&self.opinions[a].learnt));
        near
    }

    /// The policy whose looks differ least among the eligible ones that were tested: where every
    /// other policy but its kin differs by far more, if it differs by less than the ratio
    /// `farthest`; else among those that can show that they serve, if it differs by less than
    /// `most`.
    pub(crate) fn drifted(
        &self,
        (most, farthest): (f64, f64),
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

    /// The accepted policies, but for the one that acted.
    fn others(&self) -> impl Iterator<Item = usize> {
        (0..self.opinions.len()).filter(|&policy| {
            policy != self.collector && self.opinions[policy].verdict == Verdict::Accepted
        })
    }

    /// The one of them that fits best; the first of equals.
    fn fittest(&self) -> Option<usize> {
        let misfit = |policy: &usize| self.opinions[*policy].misfit();
        self.others().min_by(|a, b| misfit(a).total_cmp(&misfit(b)))
    }
}
