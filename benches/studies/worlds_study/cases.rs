//! Rows of the tables: kinds of worlds, streams and rules.

use std::ops::RangeInclusive;

use clap::ValueEnum;
use serde::{Deserialize, Serialize};
use worlds::{World, WorldKind};

use crate::trial::ROUNDS_PER_ROLLOUT;

/// Kind of world, stream or policies that one row of a table tests.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum StudyCase {
    Kind(WorldKind),
    /// Two groups, one of which has one rollout of fifty.
    RareGroup,
    /// Policies that earn nothing before iteration [`SUDDEN_CHANGE_ITERATION`], and are skilled at
    /// once.
    SuddenSuccess,
    /// Policies that lose all skill in iteration [`SUDDEN_CHANGE_ITERATION`], and learn again.
    Collapse,
}

/// Training iteration of a policy, from 1, in which it suddenly succeeds or collapses.
pub const SUDDEN_CHANGE_ITERATION: usize = 8;

impl StudyCase {
    pub fn all() -> Vec<Self> {
        let special = [Self::RareGroup, Self::SuddenSuccess, Self::Collapse];
        WorldKind::ALL.into_iter().map(Self::Kind).chain(special).collect()
    }

    pub fn name(&self) -> &'static str {
        match self {
            Self::Kind(kind) => kind.name(),
            Self::RareGroup => "rare-group",
            Self::SuddenSuccess => "sudden-success",
            Self::Collapse => "collapse",
        }
    }

    pub fn world(&self, seed: u64) -> World {
        match self {
            Self::Kind(kind) => World::random(*kind, seed),
            Self::RareGroup => World::random_with_num_groups(WorldKind::Appearance, seed, 2),
            Self::SuddenSuccess | Self::Collapse => World::random(WorldKind::Identical, seed),
        }
    }
}

/// Number and length of the visits of a stream, as command-line options. The default visits last
/// three rollouts to ten, with switches in the middle of some.
#[derive(Clone, Debug, Default, PartialEq, clap::Args)]
pub struct VisitPlan {
    /// Visits of all groups together, for a table of this stream alone [default: two of each group,
    /// and at least eight if surroundings change]
    #[arg(long)]
    pub visits: Option<usize>,
    /// Rounds that a visit lasts, for a table of this stream alone; a rollout has 4
    /// [default: 12-40]
    #[arg(long, value_parser = range)]
    pub stay: Option<RangeInclusive<usize>>,
}

pub fn range(word: &str) -> Result<RangeInclusive<usize>, String> {
    let ends = word.split_once('-');
    let ends = ends.and_then(|(from, to)| Some((from.parse().ok()?, to.parse().ok()?)));
    let range = ends.filter(|(from, to)| (1..=*to).contains(from));
    let range = range.map(|(from, to)| from..=to);
    range.ok_or_else(|| "expected two rising numbers from 1 on, such as 12-40".to_owned())
}

impl VisitPlan {
    /// Returns five plans of streams, each with visits of one length, from one rollout to thirty.
    pub fn fixed_length_plans() -> [Self; 5] {
        [(60, 1), (240, 1), (60, 2), (60, 3), (16, 30)].map(|(visits, rollouts)| Self {
            visits: Some(visits),
            stay: Some(ROUNDS_PER_ROLLOUT * rollouts..=ROUNDS_PER_ROLLOUT * rollouts),
        })
    }

    pub fn rounds(&self) -> RangeInclusive<usize> {
        self.stay.clone().unwrap_or(12..=40)
    }
}

/// Rule by which a rollout is assigned to a policy.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize, ValueEnum)]
pub enum AssignmentRule {
    /// The learner's own rule.
    #[default]
    Evidence,
    /// Permutation test of colour histograms.
    Histogram,
    /// Permutation test of pictures, each averaged over its mirror images.
    Image,
    /// Permutation test of the features of an untrained network.
    Network,
    /// The paper's threshold of 1.0 on the features of an untrained network.
    Threshold,
}
