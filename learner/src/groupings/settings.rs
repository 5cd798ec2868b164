//! Registry of groupings: settings that name one.

use evidence::RecogniserSettings;
use serde::{Deserialize, Serialize};

use crate::error::LearnerError;

use super::evidence::EvidenceGrouping;
use super::grouping::Grouping;
use super::oracle::{OracleGrouping, SinglePolicyGrouping, TaskLabel, unlabelled};
use super::threshold::ThresholdGrouping;

/// Choice of a grouping, which assigns rollouts to policies, with its settings.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum GroupingSettings {
    /// Permutation test on camera images, motion and returns of whole episodes, which does not use
    /// the policies' features.
    Evidence(RecogniserSettings),
    /// The paper's rule: the nearest policy in 1-Wasserstein distance, or a new policy if the
    /// distance is above `d_epsilon`.
    Threshold {
        /// Largest distance (`d_epsilon`) at which a rollout belongs to a policy, in the unit of
        /// the features.
        threshold: f64,
    },
    /// One policy for all task groups.
    Single,
    /// One policy for each ground-truth label of a task group. Only a run can give labels.
    Oracle,
    /// Removed grouping `calibrated` of earlier versions. Reports read it in the settings of their
    /// runs, but no learner has it.
    #[serde(rename = "calibrated")]
    Removed(RemovedGroupingSettings),
}

/// Settings of the removed grouping `calibrated`, which are ignored.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
pub struct RemovedGroupingSettings {}

impl Default for GroupingSettings {
    fn default() -> Self {
        Self::Evidence(RecogniserSettings::default())
    }
}

impl GroupingSettings {
    /// Grouping by the paper's rule with its threshold, `d_epsilon = 1.0`.
    pub const PAPER: Self = Self::Threshold { threshold: 1.0 };

    /// Creates the grouping for a learner outside a run.
    ///
    /// # Errors
    /// A setting out of range, and [`GroupingSettings::Oracle`], since only runs have labels.
    pub fn build_grouping(&self) -> Result<Box<dyn Grouping>, LearnerError> {
        match self {
            Self::Oracle => Err(unlabelled()),
            _ => self.build_with(&TaskLabel::default()),
        }
    }

    /// Creates the grouping for a run that writes `labels`.
    pub(crate) fn build_with(&self, labels: &TaskLabel) -> Result<Box<dyn Grouping>, LearnerError> {
        Ok(match *self {
            Self::Evidence(settings) => Box::new(EvidenceGrouping::new(settings)?),
            Self::Threshold { threshold } => Box::new(ThresholdGrouping::new(threshold)?),
            Self::Single => Box::new(SinglePolicyGrouping),
            Self::Oracle => Box::new(OracleGrouping::new(labels.clone())),
            Self::Removed(_) => {
                let expected = "evidence, which replaces it; to continue a run, take the version \
                                of this program that began it";
                return Err(LearnerError::invalid("grouping", "calibrated", expected));
            }
        })
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn settings_survive_a_file_and_unknown_names_are_refused() {
        let all = [
            GroupingSettings::default(),
            GroupingSettings::PAPER,
            GroupingSettings::Single,
            GroupingSettings::Oracle,
        ];
        let read = |text: &str| serde_json::from_str::<GroupingSettings>(text);
        for settings in all {
            let text = serde_json::to_string(&settings).unwrap();
            assert_eq!(read(&text).unwrap(), settings);
        }
        for wrong in [r#""orakel""#, r#"{"threshold": {"threshold": 1.0, "slack": 2.0}}"#] {
            assert!(read(wrong).unwrap_err().to_string().contains("unknown"));
        }
    }

    #[test]
    fn labels_and_ranges_are_asked_for() {
        let refuse =
            |settings: GroupingSettings| settings.build_grouping().err().unwrap().to_string();
        assert!(refuse(GroupingSettings::Oracle).contains("a grouping without labels"));
        let message = refuse(GroupingSettings::Threshold { threshold: f64::NAN });
        assert!(message.contains("NaN"), "{message}");
        let removed = serde_json::from_str(r#"{"calibrated": {"doubt": 0.02}}"#).unwrap();
        assert!(refuse(removed).contains("evidence, which replaces it"));
        assert!(GroupingSettings::Single.build_grouping().is_ok());
    }
}
