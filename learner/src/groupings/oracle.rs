//! Groupings without evidence: one policy for each label, the upper bound that the paper calls
//! COVERS-GT, and one policy for everything.

use std::sync::{Arc, Mutex, PoisonError};

use cluster::AssignedPolicy;
use rand_chacha::ChaCha8Rng;
use serde::Deserialize;
use serde_json::Value;

use crate::error::LearnerError;

use super::grouping::{
    AssignmentData, AssignmentPurpose, Grouping, GroupingDecision, GroupingUpdateInput,
    GroupingUpdateResult,
};

/// Grouping with a single policy for all rollouts: the paper's baselines Equi and CNN.
#[derive(Clone, Copy, Debug, Default)]
pub struct SinglePolicyGrouping;

impl Grouping for SinglePolicyGrouping {
    fn assign(
        &mut self,
        _: AssignmentPurpose<'_>,
        _: &mut dyn AssignmentData,
        _: &mut ChaCha8Rng,
    ) -> Result<GroupingDecision, LearnerError> {
        Ok(GroupingDecision::for_policy(AssignedPolicy::Existing(0)))
    }
}

/// Ground-truth label of the current task group, shared by all clones: a run writes it, and an
/// oracle grouping reads it.
#[derive(Clone, Debug, Default)]
pub struct TaskLabel(Arc<Mutex<Option<String>>>);

impl TaskLabel {
    /// Sets the label of the task group that the environments show from now on.
    pub fn set(&self, group: &str) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Some(group.to_owned());
    }

    fn get(&self) -> Option<String> {
        let label = self.0.lock();
        label.unwrap_or_else(PoisonError::into_inner).clone()
    }
}

/// Grouping that creates one policy for each ground-truth label of a task group; the other
/// groupings receive no labels.
#[derive(Debug)]
pub struct OracleGrouping {
    labels: TaskLabel,
    /// Label of the task group of each policy.
    known: Vec<String>,
}

impl OracleGrouping {
    /// Creates a grouping that reads the labels written by a run.
    pub(crate) fn new(labels: TaskLabel) -> Self {
        Self { labels, known: Vec::new() }
    }

    fn policy(&self, label: &str) -> Option<usize> {
        self.known.iter().position(|known| known == label)
    }
}

impl Grouping for OracleGrouping {
    fn assign(
        &mut self,
        request: AssignmentPurpose<'_>,
        _: &mut dyn AssignmentData,
        _: &mut ChaCha8Rng,
    ) -> Result<GroupingDecision, LearnerError> {
        let label = self.labels.get().ok_or_else(unlabelled)?;
        let policy = self.policy(&label);
        // the label may change before the new policy trains, so it is recorded here
        if policy.is_none() && !matches!(request, AssignmentPurpose::Recognise) {
            self.known.push(label);
        }
        let decision = policy.map_or(AssignedPolicy::New, AssignedPolicy::Existing);
        Ok(GroupingDecision::for_policy(decision))
    }

    /// Records the label of the very first rollout, for which there is no request.
    fn update(
        &mut self,
        _: GroupingUpdateInput<'_>,
        _: &mut ChaCha8Rng,
    ) -> Result<GroupingUpdateResult, LearnerError> {
        if self.known.is_empty() {
            self.known.push(self.labels.get().unwrap_or_default());
        }
        Ok(GroupingUpdateResult::default())
    }

    fn state(&self) -> Value {
        self.known.clone().into()
    }

    fn restore(&mut self, state: &Value, policies: usize) -> Result<(), String> {
        let known: Vec<String> = Vec::deserialize(state).map_err(|error| error.to_string())?;
        // before the first rollout there is policy 0, but no label yet
        if known.len() != policies && !(known.is_empty() && policies == 1) {
            return Err(format!("{} labels of {policies} policies", known.len()));
        }
        self.known = known;
        Ok(())
    }
}

/// Returns the error of the grouping [`OracleGrouping`] if no label was set.
pub(super) fn unlabelled() -> LearnerError {
    let expected = "a grouping without labels, or a learner that a run trains: only runs and their \
                    evaluations know labels";
    LearnerError::invalid("grouping", "oracle", expected)
}

#[cfg(test)]
mod tests {
    use cluster::{NearerPolicyInputs, RolloutAndBufferFeatures};
    use evidence::PreviousParameters;
    use rand::SeedableRng;

    use super::*;
    use crate::groupings::grouping::RolloutEpisodes;

    const ROLLOUT: AssignmentPurpose<'static> = AssignmentPurpose::Assign {
        allow_undecided: true,
        previous_parameters: PreviousParameters::Unavailable,
    };

    /// An oracle must not look at pictures.
    struct Blind;

    impl AssignmentData for Blind {
        fn clouds(&mut self) -> Result<Vec<RolloutAndBufferFeatures>, LearnerError> {
            panic!("an oracle does not compare")
        }

        fn comparisons(
            &mut self,
            _: [usize; 2],
            _: usize,
        ) -> Result<[NearerPolicyInputs; 2], LearnerError> {
            panic!("an oracle does not compare")
        }

        fn episodes(&self) -> RolloutEpisodes<'_> {
            panic!("an oracle does not look")
        }
    }

    fn ask(
        oracle: &mut OracleGrouping,
        request: AssignmentPurpose<'_>,
    ) -> Result<AssignedPolicy, LearnerError> {
        let mut rng = ChaCha8Rng::seed_from_u64(0);
        Ok(oracle.assign(request, &mut Blind, &mut rng)?.policy)
    }

    #[test]
    fn every_label_has_a_policy_and_recognition_creates_none() {
        let labels = TaskLabel::default();
        let mut oracle = OracleGrouping::new(labels.clone());
        let message = ask(&mut oracle, ROLLOUT).unwrap_err().to_string();
        assert!(message.contains("a grouping without labels"), "{message}");
        labels.set("a");
        let first = GroupingUpdateInput::Probes { policy: 0, probes: &[] };
        let mut rng = ChaCha8Rng::seed_from_u64(0);
        oracle.update(first, &mut rng).unwrap();
        let mut decide = |label: &str, request| {
            labels.set(label);
            ask(&mut oracle, request).unwrap()
        };
        assert_eq!(decide("a", ROLLOUT), AssignedPolicy::Existing(0));
        assert_eq!(decide("b", AssignmentPurpose::Recognise), AssignedPolicy::New);
        assert_eq!(decide("c", ROLLOUT), AssignedPolicy::New);
        assert_eq!(decide("c", AssignmentPurpose::Recognise), AssignedPolicy::Existing(1));
        assert_eq!(decide("a", ROLLOUT), AssignedPolicy::Existing(0));
        assert_eq!(decide("b", ROLLOUT), AssignedPolicy::New, "recognition did not create it");
        let state = oracle.state();
        let mut restored = OracleGrouping::new(labels.clone());
        restored.restore(&state, 3).unwrap();
        let again = ask(&mut restored, ROLLOUT).unwrap();
        assert_eq!(again, AssignedPolicy::Existing(2));
        assert!(restored.restore(&state, 4).is_err());
        assert!(restored.restore(&Value::from(3), 2).is_err());
    }
}
