//! Errors of episode summaries, tests of policies and stored states.

use cluster::ClusterError;

pub(crate) type Result<T> = std::result::Result<T, EvidenceError>;

/// Errors of episode summaries and of a recogniser: its settings, tests of policies and stored
/// states.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum EvidenceError {
    /// Image that is smaller than a filter, or has no channel or more than 1000.
    #[error(
        "images are {height} x {width} with {channels} channels, expected at least 7 x 7 with \
         1 to 1000"
    )]
    ImageSize {
        /// Number of rows of pixels of the image.
        height: usize,
        /// Number of columns of pixels of the image.
        width: usize,
        /// Number of channels of the image.
        channels: usize,
    },
    /// List of numbers, such as the vectors of an episode, of the wrong length.
    #[error("{what} holds {got} values, expected {expected}")]
    Length {
        /// Name of the list of numbers that has the wrong length.
        what: &'static str,
        /// Length of the list.
        got: usize,
        /// Length that the dimensions of the list require.
        expected: usize,
    },
    /// Setting outside its range.
    #[error("setting `{name}` is {value}, expected {expected}")]
    InvalidSetting {
        /// Name of the setting that is out of range.
        name: &'static str,
        /// Rejected value of the setting.
        value: f64,
        /// Valid range of the setting, in words.
        expected: &'static str,
    },
    /// Too few episodes for a decision on their task group.
    #[error("got {got} episodes, expected at least {needed}")]
    TooFewEpisodes {
        /// Number of episodes given.
        got: usize,
        /// Number of episodes that a decision needs.
        needed: usize,
    },
    /// Infinite or NaN value in the summary of an episode.
    #[error("{what} holds {value}, expected finite numbers: check what the environment returns")]
    NotFinite {
        /// Source of evidence that holds the number.
        what: &'static str,
        /// Infinite or NaN value.
        value: f64,
    },
    /// Stored state of a recogniser with more episodes for a policy than the settings allow.
    #[error(
        "{got} episodes of one policy, expected at most {most}: set `memory` as it was when they \
         were stored"
    )]
    TooManyEpisodes {
        /// Number of episodes that the state stores for the policy.
        got: usize,
        /// Largest number of episodes for a policy, the setting `memory`.
        most: usize,
    },
    /// Stored state of a recogniser in the format of another version.
    #[error(
        "the state has format {got}, expected {expected}: continue with the version that wrote it, or \
         start again"
    )]
    StateVersion {
        /// Format number of the stored state.
        got: u32,
        /// Only format number that this version reads.
        expected: u32,
    },
    /// Policy index that is not known.
    #[error("policy {policy} was named, {policies} are known")]
    NoPolicy {
        /// Index of the policy that is not known.
        policy: usize,
        /// Number of known policies.
        policies: usize,
    },
    /// Stored state in which merges form a cycle, so that none of its policies acts.
    #[error(
        "the policies that policy {policy} was merged into form a cycle, expected one that acts: \
         the state is damaged, take another one"
    )]
    CyclicMerge {
        /// Index of a policy on the cycle or leading into it.
        policy: usize,
    },
    /// Error of a Wasserstein distance or a permutation test.
    #[error(transparent)]
    Cluster(#[from] ClusterError),
}

/// Checks that a list of numbers has the expected length.
pub(crate) fn check_len(what: &'static str, got: usize, expected: usize) -> Result<()> {
    if got == expected { Ok(()) } else { Err(EvidenceError::Length { what, got, expected }) }
}

/// Checks that a number is finite.
pub(crate) fn check_finite(what: &'static str, value: f64) -> Result<()> {
    if value.is_finite() { Ok(()) } else { Err(EvidenceError::NotFinite { what, value }) }
}
