//! Grouping by labels: the upper bound that the paper calls COVERS-GT.

use std::sync::{Arc, Mutex, PoisonError};

use cluster::{Assignment, Decision};
use rand_chacha::ChaCha8Rng;
use serde::Deserialize;
use serde_json::Value;

use crate::error::CoversError;

use super::grouping::{Candidates, Grouping};

/// The name of the group that runs, shared by a run, which writes it, and an [`Oracle`], which
/// reads it.
#[derive(Clone, Debug, Default)]
pub struct Labels(Arc<Mutex<String>>);

impl Labels {
    /// Says which group runs from here on.
    pub(crate) fn set(&self, group: &str) {
        group.clone_into(&mut self.0.lock().unwrap_or_else(PoisonError::into_inner));
    }

    fn get(&self) -> String {
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

    fn assign(
        &self,
        _: &mut dyn Candidates,
        _: &mut ChaCha8Rng,
    ) -> Result<Assignment, CoversError> {
        let decision = match self.policy(&self.labels.get()) {
            Some(policy) => Decision::Existing(policy),
            None if self.known.is_empty() => Decision::Existing(0),
            None => Decision::New,
        };
        Ok(Assignment {
            decision,
            evidence: Vec::new(),
        })
    }

    fn adopt(&mut self, index: usize) {
        if index == self.known.len() {
            self.known.push(self.labels.get());
        }
    }

    fn state(&self) -> Value {
        self.known.clone().into()
    }

    fn restore(&mut self, state: &Value) -> Result<(), String> {
        self.known = Vec::deserialize(state).map_err(|error| error.to_string())?;
        Ok(())
    }
}

#[cfg(test)]
mod tests {
    use cluster::Candidate;
    use rand::SeedableRng;

    use super::*;

    /// An oracle must not look at pictures.
    struct Blind;

    impl Candidates for Blind {
        fn policies(&self) -> usize {
            0
        }

        fn clouds(&mut self) -> Result<Vec<Candidate>, CoversError> {
            panic!("an oracle does not compare")
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
        labels.set("a");
        assert_eq!(ask(&oracle), Decision::Existing(0));
        oracle.adopt(0);
        labels.set("b");
        assert_eq!(ask(&oracle), Decision::New);
        labels.set("a");
        assert_eq!(ask(&oracle), Decision::Existing(0), "b was only looked at");
        labels.set("b");
        oracle.adopt(1);
        let state = oracle.state();
        let mut restored = Oracle::new(labels.clone());
        restored.restore(&state).unwrap();
        assert_eq!(ask(&restored), Decision::Existing(1));
        assert!(restored.restore(&Value::from(3)).is_err());
    }
}
