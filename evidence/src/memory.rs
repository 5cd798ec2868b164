//! Memory of the episodes that one policy trained on.

use std::collections::VecDeque;

use serde::{Deserialize, Serialize};

use crate::error::{EvidenceError, Result, check_finite, check_len};
use crate::policy_test::{EvidenceSource, mean_return};
use crate::summary::EpisodeSummary;

/// Summaries of the latest episodes that a policy trained on, or collected after an update that
/// changed how it acts; its task group is recognised by them.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct PolicyMemory {
    #[serde(rename = "accounts")]
    pub(crate) summaries: VecDeque<EpisodeSummary>,
    /// `false` for a policy that was created for episodes of others and did not train yet.
    pub(crate) is_trained: bool,
    /// Mean return of the first rollout that the policy trained on.
    #[serde(rename = "beginning")]
    pub(crate) initial_return: Option<f64>,
    /// Indices of the policies that were compared with this one and serve other task groups.
    #[serde(rename = "apart")]
    pub(crate) distinct_from: Vec<usize>,
    /// Index of the policy that this one was merged into, which now acts for its task group.
    #[serde(rename = "heir")]
    pub(crate) merged_into: Option<usize>,
    /// Episodes that the policy collected after an update that changed how it acts; they are
    /// remembered when it trains next.
    #[serde(default, skip_serializing_if = "Vec::is_empty")]
    pub(crate) after_update: Vec<EpisodeSummary>,
}

impl PolicyMemory {
    /// Returns `true` if the policy was merged into another one.
    pub(crate) fn is_merged(&self) -> bool {
        self.merged_into.is_some()
    }

    /// Records that the latest update changed how the policy acts, as in the episodes
    /// `after_update`: motion and returns of remembered episodes, and of those that it trains on
    /// next, no longer count.
    // Its next episodes would differ from them, too.
    pub(crate) fn record_changing_update(&mut self, after_update: Vec<EpisodeSummary>) {
        self.summaries.iter_mut().for_each(EpisodeSummary::keep_only_first_observation);
        self.after_update = after_update;
    }

    /// Records the summaries of episodes that the policy trains on; keeps the latest `most` of all.
    pub(crate) fn record_training(&mut self, summaries: Vec<&EpisodeSummary>, most: usize) {
        if !self.is_trained {
            // a policy may train on a rollout that it was created for, and remembers it already
            self.summaries.retain(|summary| !summaries.contains(&summary));
        }
        let mean = mean_return(summaries.iter().copied());
        self.initial_return = self.initial_return.or(mean);
        self.is_trained = true;
        let after_update = std::mem::take(&mut self.after_update);
        let is_superseded = !after_update.is_empty();
        let summaries = summaries.into_iter().cloned().map(|mut summary| {
            if is_superseded {
                summary.keep_only_first_observation();
            }
            summary
        });
        self.append(summaries.chain(after_update), most);
    }

    /// Appends episode summaries to the memory and keeps the latest `most` of all.
    pub(crate) fn append(&mut self, summaries: impl Iterator<Item = EpisodeSummary>, most: usize) {
        self.summaries.extend(summaries);
        let too_many = self.summaries.len().saturating_sub(most);
        self.summaries.drain(..too_many);
    }

    /// Returns the remembered episodes that new ones are compared with: the later half if returns
    /// are clearly higher there, since training has changed the policy's behaviour, and all
    /// otherwise.
    pub(crate) fn recent(&self) -> Vec<&EpisodeSummary> {
        let all: Vec<&EpisodeSummary> = self.summaries.iter().collect();
        let (before, late) = all.split_at(all.len() / 2);
        let means = mean_return(before.iter().copied()).zip(mean_return(late.iter().copied()));
        match means {
            Some((earlier, mean)) if mean - earlier > PROGRESS * return_sd(&all) => late.to_vec(),
            _ => all,
        }
    }

    /// Returns the rise of the policy's mean return since its first rollout, in standard deviations
    /// of its recent returns, at least 0. The larger it is, the more surely a loss shows.
    pub(crate) fn gain(&self) -> f64 {
        self.gain_in(&self.recent())
    }

    /// Returns the rise of the mean return of `summaries` over that of the policy's first rollout,
    /// in standard deviations of the returns of `summaries`, at least 0; 0 if either is unknown.
    pub(crate) fn gain_in(&self, summaries: &[&EpisodeSummary]) -> f64 {
        match (self.initial_return, mean_return(summaries.iter().copied())) {
            (Some(initial), Some(now)) => {
                let sd = return_sd(summaries).max(f64::MIN_POSITIVE);
                ((now - initial) / sd).clamp(0.0, f64::MAX)
            }
            _ => 0.0,
        }
    }

    /// Returns the share of the policy's gain in return that is missing in the episodes
    /// `summaries`: at most 1 at the return of the first rollout, negative above the remembered
    /// return, 0 without a gain.
    pub(crate) fn return_loss(&self, summaries: &[&EpisodeSummary]) -> f64 {
        let now = mean_return(summaries.iter().copied());
        match self.return_and_gain().zip(now) {
            Some(((remembered, gain), now)) => (remembered - now) / gain,
            None => 0.0,
        }
    }

    /// Returns the standard error of the share that [`return_loss`](Self::return_loss) returns.
    pub(crate) fn return_loss_error(&self, summaries: &[&EpisodeSummary]) -> f64 {
        let variance = |of: &[&EpisodeSummary]| return_sd(of).powi(2) / of.len().max(1) as f64;
        let error = (variance(summaries) + variance(&self.recent())).sqrt();
        self.return_and_gain().map_or(0.0, |(_, gain)| error / gain)
    }

    /// Returns the mean return of the policy's recent episodes and its rise since the first
    /// rollout, raised to at least half of that mean; `None` if it did not rise or is unknown.
    fn return_and_gain(&self) -> Option<(f64, f64)> {
        let remembered = mean_return(self.recent().into_iter())?;
        let gain = remembered - self.initial_return?;
        // at least half of the return, or noise would be a large share of a small gain
        (gain > 0.0).then(|| (remembered, gain.max(remembered.abs() / 2.0)))
    }
}

/// Number of standard deviations by which the later half of a policy's returns must be higher to
/// count as progress.
const PROGRESS: f64 = 0.5;

/// Returns the standard deviation of the known returns; 0 if there are none.
fn return_sd(summaries: &[&EpisodeSummary]) -> f64 {
    let Some(mean) = mean_return(summaries.iter().copied()) else {
        return 0.0;
    };
    let returns = summaries.iter().filter_map(|s| s.episode_return);
    let squares = returns.map(|r| (f64::from(r) - mean).powi(2));
    let (sum, count) = squares.fold((0.0, 0.0), |(sum, count), s| (sum + s, count + 1.0));
    f64::sqrt(sum / count)
}

/// Rejects memories of policies whose merges, of one policy into another, form a cycle.
pub(crate) fn check_merges(memories: &[PolicyMemory]) -> Result<()> {
    let next = |&policy: &usize| memories[policy].merged_into;
    // without a cycle, a chain of merges visits each policy at most once
    let is_cyclic =
        |policy: &usize| std::iter::successors(Some(*policy), next).nth(memories.len()).is_some();
    match (0..memories.len()).find(is_cyclic) {
        Some(policy) => Err(EvidenceError::CyclicMerge { policy }),
        None => Ok(()),
    }
}

/// Returns the episode summaries that all policies remember.
pub(crate) fn all_summaries(
    memories: &[PolicyMemory],
) -> impl Iterator<Item = &EpisodeSummary> + Clone {
    memories.iter().flat_map(|memory| memory.summaries.iter().chain(&memory.after_update))
}

/// Checks that episode summaries can be compared: all numbers are finite, and the points of each
/// source of evidence have the same length.
pub(crate) fn check_comparable<'a>(
    summaries: impl Iterator<Item = &'a EpisodeSummary> + Clone,
) -> Result<()> {
    for &source in EvidenceSource::ALL {
        let mut expected = None;
        for point in summaries.clone().filter_map(|summary| source.point(summary)) {
            let expected = *expected.get_or_insert(point.len().max(1));
            check_len(source.name(), point.len(), expected)?;
            point.iter().try_for_each(|&value| check_finite(source.name(), value.into()))?;
        }
    }
    Ok(())
}

#[cfg(test)]
mod tests {
    use super::*;

    fn with_return(episode_return: f32) -> EpisodeSummary {
        EpisodeSummary {
            began: 0,
            image_features: vec![0.0],
            first_vector: vec![0.0],
            motion: None,
            reward_gradient: None,
            episode_return: Some(episode_return),
        }
    }

    fn memory(initial_return: f64, remembered: f32) -> PolicyMemory {
        let (summaries, initial_return) = ([with_return(remembered)].into(), Some(initial_return));
        PolicyMemory { summaries, initial_return, ..PolicyMemory::default() }
    }

    #[test]
    fn a_gain_can_be_lost_and_noise_is_no_loss() {
        let loss = |initial, remembered, now| {
            memory(initial, remembered).return_loss(&[&with_return(now)])
        };
        assert!(loss(100.0, 101.0, 99.5) < 0.05);
        assert!(loss(-101.0, -100.0, -101.5) < 0.05);
        assert_eq!(loss(0.0, 100.0, 60.0), 0.4);
        assert_eq!(loss(-20.0, -4.0, -12.0), 0.5);
        assert!(loss(0.0, 100.0, 110.0) < 0.0, "a higher return");
        assert_eq!(loss(100.0, 100.0, 10.0), 0.0, "no gain");
        // two episodes with returns of 40 and 80, where the remembered 100 has no spread
        let (low, high) = (with_return(40.0), with_return(80.0));
        let memory = memory(0.0, 100.0);
        assert_eq!(memory.return_loss(&[&low, &high]), 0.4);
        let error = memory.return_loss_error(&[&low, &high]);
        assert!((error - 0.2 / f64::sqrt(2.0)).abs() < 1e-12, "{error}");
    }
}
