//! The errors of this crate.

use cluster::ClusterError;

/// Why evidence could not be gathered or weighed.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum EvidenceError {
    /// A picture that is smaller than a filter, or has no channel.
    #[error(
        "pictures are {height} x {width} with {channels} channels, expected at least 7 x 7 with \
         1 to 1000"
    )]
    PictureSize {
        /// Rows.
        height: usize,
        /// Columns.
        width: usize,
        /// Channels.
        channels: usize,
    },
    /// A list of another length than its sizes say.
    #[error("{what} holds {got} values, expected {expected}")]
    Length {
        /// The list.
        what: &'static str,
        /// Its length.
        got: usize,
        /// What its sizes say.
        expected: usize,
    },
    /// A setting outside its range.
    #[error("setting `{name}` is {value}, expected {expected}")]
    Setting {
        /// Its name.
        name: &'static str,
        /// Its value.
        value: f64,
        /// The range in words.
        expected: &'static str,
    },
    /// Too few episodes to decide anything.
    #[error("got {got} episodes, expected at least {needed}")]
    TooFewEpisodes {
        /// Episodes given.
        got: usize,
        /// Episodes needed.
        needed: usize,
    },
    /// A number that no comparison can use.
    #[error("{what} holds {value}, expected finite numbers: check what the environment returns")]
    NotFinite {
        /// The source.
        what: &'static str,
        /// The value.
        value: f64,
    },
    /// A state that remembers more than the settings allow.
    #[error(
        "{got} accounts of one policy, expected at most {most}: set `memory` as it was when they \
         were kept"
    )]
    TooManyAccounts {
        /// Accounts given.
        got: usize,
        /// The setting `memory`.
        most: usize,
    },
    /// A state that another version wrote.
    #[error(
        "the state has format {got}, expected {expected}: go on with the version that wrote it, or \
         begin anew"
    )]
    StateVersion {
        /// The format of the state.
        got: u32,
        /// The format that is read.
        expected: u32,
    },
    /// A policy that was never told of.
    #[error("policy {policy} was named, {policies} are known")]
    NoPolicy {
        /// The index given.
        policy: usize,
        /// Policies known.
        policies: usize,
    },
    /// Heirs that lead nowhere.
    #[error(
        "the heirs of policy {policy} follow each other in a circle, expected one that acts: the \
         state is damaged, take another one"
    )]
    HeirsInCircle {
        /// A policy whose heirs do so.
        policy: usize,
    },
    /// Distances and tests.
    #[error(transparent)]
    Cluster(#[from] ClusterError),
}
