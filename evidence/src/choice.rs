//! Who is proposed among those that nothing speaks against.

use cluster::Verdict;

use crate::opinion::Opinion;

/// Another policy takes over from one that acted and is accepted where it fits what is seen at the
/// beginning of episodes by so many standard deviations better,
const MARGIN: f64 = 3.0;
/// and where that has at most this probability for the one that acted. Groups that look alike, too,
/// differ by chance.
const UNLIKELY: f64 = 1e-3;

/// The accepted policy that fits best; the first of equals.
pub(crate) fn fittest(opinions: &[Opinion], eligible: impl Fn(usize) -> bool) -> Option<usize> {
    let accepted = (0..opinions.len())
        .filter(|&policy| opinions[policy].verdict == Verdict::Accepted && eligible(policy));
    let misfit = |policy: &usize| opinions[*policy].misfit();
    accepted.min_by(|a, b| misfit(a).total_cmp(&misfit(b)))
}

/// The accepted policies that fit about as well as the fittest. The one that has learnt most comes
/// first: what it earns shows best whether it is meant.
pub(crate) fn rivals(opinions: &[Opinion], eligible: impl Fn(usize) -> bool) -> Vec<usize> {
    let Some(fittest) = fittest(opinions, &eligible) else {
        return Vec::new();
    };
    let most = opinions[fittest].misfit() + MARGIN;
    let is_near = |&policy: &usize| {
        let opinion = &opinions[policy];
        opinion.verdict == Verdict::Accepted && eligible(policy) && opinion.misfit() <= most
    };
    let mut near: Vec<usize> = (0..opinions.len()).filter(is_near).collect();
    near.sort_by(|&a, &b| opinions[b].learnt.total_cmp(&opinions[a].learnt));
    near
}

/// The policy whose looks differ least among the eligible ones that were tested.
pub(crate) fn drifted(opinions: &[Opinion], eligible: impl Fn(usize) -> bool) -> Option<usize> {
    let tested =
        (0..opinions.len()).filter(|&policy| opinions[policy].test.is_some() && eligible(policy));
    let ratio = |policy: &usize| opinions[*policy].look_ratio();
    tested.min_by(|a, b| ratio(a).total_cmp(&ratio(b)))
}

/// The policy that acted, unless another one fits much better.
pub(crate) fn keep_or_better(collector: usize, opinions: &[Opinion]) -> usize {
    let own = &opinions[collector];
    let other = fittest(opinions, |policy| policy != collector);
    let mut looks = own.sources().filter(|(kind, _)| kind.is_look());
    let is_unlikely = looks.any(|(_, source)| source.tail_p_value <= UNLIKELY);
    let better = |policy: &usize| opinions[*policy].look_score() + MARGIN < own.look_score();
    other
        .filter(|policy| is_unlikely && better(policy))
        .unwrap_or(collector)
}
