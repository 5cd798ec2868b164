//! Grouping by labels: the upper bound that the paper calls COVERS-GT.

use std::sync::{Arc, Mutex, PoisonError};

use cluster::{Assignment, Decision};
use rand_chacha::ChaCha8Rng;
use serde::Deserialize;
use serde_json::Value;

use crate::error::CoversError;

use super::grouping::{Answer, Candidates, Grouping};

/// The name of the group that runs, shared by a run, which writes it, and an oracle, which reads
/// it.
#[derive(Clone, Debug, Default)]
pub struct Labels(Arc<Mutex<Option<String>>>);

impl Labels {
    /// Says which group runs from here on.
    pub(crate) fn set(&self, group: &str) {
        *self.0.lock().unwrap_or_else(PoisonError::into_inner) = Some(group.to_owned());
    }

    fn get(&self) -> Option<String> {
        let label = self.0.lock();
        label.unwrap_or_else(PoisonError::into_inner).clone()
    }
}

/// Opens one policy for each label. The only grouping that receives labels.
#[derive(Debug)]
pub struct Oracle {
    labels: Labels,
    /// The label of each policy.
    known: Vec<String>,
}

impl Oracle {
    /// Reads the labels that a run writes.
    pub(crate) fn new(labels: Labels) -> Self {
        Self {
            labels,
            known: Vec::new(),
        }
    }

    fn policy(&self, label: &str) -> Option<usize> {
        self.known.iter().position(|known| known == label)
    }
}

impl Grouping for Oracle {
    fn min_episodes(&self) -> usize {
        1
    }

    fn assign(&self, _: &mut dyn Candidates, _: &mut ChaCha8Rng) -> Answer {
        let label = self.labels.get().ok_or_else(unlabelled)?;
        let policy = self.policy(&label);
        let decision = policy.map_or(Decision::New, Decision::Existing);
        Ok(Assignment {
            decision,
            evidence: Vec::new(),
        })
    }

    fn adopt(&mut self, index: usize) {
        if index == self.known.len() {
            self.known.push(self.labels.get().unwrap_or_default());
        }
    }

    fn state(&self) -> Value {
        self.known.clone().into()
    }

    fn restore(&mut self, state: &Value, policies: usize) -> Result<(), String> {
        let known: Vec<String> = Vec::deserialize(state).map_err(|error| error.to_string())?;
        // before the first rollout there is a policy, and no label
        if known.len() != policies && !(known.is_empty() && policies == 1) {
            return Err(format!("{} labels of {policies} policies", known.len()));
        }
        self.known = known;
        Ok(())
    }
}

/// The error of an oracle that nobody told a label.
pub(super) fn unlabelled() -> CoversError {
    CoversError::Setting {
        name: "grouping",
        value: "oracle".to_owned(),
        expected: "a grouping without labels, or a learner that a run trains: only runs and their \
                   evaluations know labels",
    }
}

#[cfg(test)]
mod tests {
    use cluster::{Candidate, Contest};
    use rand::SeedableRng;

    use super::*;
    use crate::groupings::grouping::Episodes;

    /// An oracle must not look at pictures.
    struct Blind;

    impl Candidates for Blind {
        fn clouds(&mut self) -> Result<Vec<Candidate>, CoversError> {
            panic!("an oracle does not compare")
        }

        fn contests(&mut self, _: [usize; 2], _: usize) -> Result<[Contest; 2], CoversError> {
            panic!("an oracle does not compare")
        }

        fn began(&self) -> Vec<usize> {
            panic!("an oracle does not order")
        }

        fn episodes(&self) -> Episodes<'_> {
            panic!("an oracle does not look")
        }
    }

    fn ask(oracle: &Oracle) -> Decision {
        let mut rng = ChaCha8Rng::seed_from_u64(0);
        oracle.assign(&mut Blind, &mut rng).unwrap().decision
    }

    #[test]
    fn every_label_has_a_policy_and_looking_opens_none() {
        let labels = Labels::default();
        let mut oracle = Oracle::new(labels.clone());
        let mut rng = ChaCha8Rng::seed_from_u64(0);
        let message = oracle.assign(&mut Blind, &mut rng).unwrap_err().to_string();
        assert!(message.contains("a grouping without labels"), "{message}");
        labels.set("a");
        oracle.adopt(0);
        assert_eq!(ask(&oracle), Decision::Existing(0));
        labels.set("b");
        assert_eq!(ask(&oracle), Decision::New);
        labels.set("a");
        assert_eq!(ask(&oracle), Decision::Existing(0), "b was only looked at");
        labels.set("b");
        oracle.adopt(1);
        let state = oracle.state();
        let mut restored = Oracle::new(labels.clone());
        restored.restore(&state, 2).unwrap();
        assert_eq!(ask(&restored), Decision::Existing(1));
        assert!(restored.restore(&state, 3).is_err());
        assert!(restored.restore(&Value::from(3), 2).is_err());
    }
}
