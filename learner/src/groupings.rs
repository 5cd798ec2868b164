//! Groupings: which policy a rollout belongs to, behind the trait [`Grouping`].
//!
//! To add one: implement [`Grouping`], and give it a value of [`GroupingSettings`].

mod evidence;
mod grouping;
mod oracle;
mod settings;
mod threshold;

pub use evidence::EvidenceGrouping;
pub use grouping::{
    AssignmentData, AssignmentPurpose, EpisodeRequirements, Grouping, GroupingDecision,
    GroupingUpdateInput, GroupingUpdateResult, RecognisedPolicy, RolloutEpisodes,
};
pub use oracle::{SinglePolicyGrouping, TaskLabel};
pub use settings::{GroupingSettings, RemovedGroupingSettings};
pub use threshold::ThresholdGrouping;
