//! Grouping by evidence that no policy owns: pictures, motion and earnings of whole episodes.

use cluster::{Assignment, Decision};
use evidence::{Account, Accountant, Finding, Look, Recogniser, RecogniserSettings, Situation};
use rand_chacha::ChaCha8Rng;
use serde_json::Value;

use crate::error::CoversError;

use super::grouping::{Candidates, Episodes, Grouping};

/// Compares accounts of episodes with those on which each policy learnt ([`evidence::Recogniser`]);
/// a policy that is proposed must act itself before it is believed.
#[derive(Clone, Debug)]
pub struct Evident(Recogniser);

impl Evident {
    /// Knows no policy yet.
    ///
    /// # Errors
    /// A setting out of range.
    pub fn new(settings: RecogniserSettings) -> Result<Self, CoversError> {
        Ok(Self(Recogniser::new(settings)?))
    }

    /// The accounts of episodes. What another policy did says nothing of `policy`.
    fn accounts(&self, episodes: Episodes<'_>, policy: usize) -> Result<Vec<Account>, CoversError> {
        let Episodes { spec, courses, .. } = episodes;
        let filters = self.0.settings().filters;
        let accountant = Accountant::new(spec.image, &spec.vector, &spec.action, filters)?;
        let mut accounts = accountant.accounts(courses)?;
        if policy != episodes.collector {
            accounts.iter_mut().for_each(Account::forget_course);
        }
        Ok(accounts)
    }

    fn look(
        &self,
        candidates: &mut dyn Candidates,
        look: Look,
        rng: &mut ChaCha8Rng,
    ) -> Result<Assignment, CoversError> {
        let episodes = candidates.episodes();
        let collector = episodes.collector;
        let accounts = self.accounts(episodes, collector)?;
        let finding = match look {
            Look::First => self.0.assign(&accounts, collector, rng)?,
            Look::Second => self.0.settle(&accounts, collector, rng)?,
        };
        Ok(self.assignment(&finding, look))
    }

    fn assignment(&self, finding: &Finding, look: Look) -> Assignment {
        let opinions = finding.opinions.iter();
        Assignment {
            decision: finding.decision,
            evidence: opinions
                .map(|opinion| opinion.evidence(self.0.settings(), look))
                .collect(),
        }
    }
}

impl Grouping for Evident {
    fn min_episodes(&self) -> usize {
        self.0.settings().min_episodes
    }

    fn assign(
        &self,
        candidates: &mut dyn Candidates,
        rng: &mut ChaCha8Rng,
    ) -> Result<Assignment, CoversError> {
        self.look(candidates, Look::First, rng)
    }

    fn settle(
        &self,
        candidates: &mut dyn Candidates,
        rng: &mut ChaCha8Rng,
    ) -> Result<Assignment, CoversError> {
        self.look(candidates, Look::Second, rng)
    }

    fn review(
        &self,
        candidates: &mut dyn Candidates,
        refused: &mut Vec<usize>,
        rng: &mut ChaCha8Rng,
    ) -> Result<Option<Assignment>, CoversError> {
        let episodes = candidates.episodes();
        let collector = episodes.collector;
        let accounts = self.accounts(episodes, collector)?;
        let situation = Situation { collector, refused };
        let finding = self.0.review(&accounts, situation, rng)?;
        if finding.decision == Decision::Existing(collector) {
            return Ok(None);
        }
        refused.clone_from(&finding.refused);
        Ok(Some(self.assignment(&finding, Look::Second)))
    }

    fn remember(
        &mut self,
        index: usize,
        episodes: Episodes<'_>,
        rng: &mut ChaCha8Rng,
    ) -> Result<(), CoversError> {
        let accounts = self.accounts(episodes, index)?;
        self.0.learn(index, &accounts, rng)?;
        Ok(())
    }

    fn state(&self) -> Value {
        // lists of numbers have no value that fails; if one did, `restore` would refuse this text
        // and show it
        let state = self.0.state(serde_json::value::Serializer);
        state.unwrap_or_else(|error| Value::String(format!("accounts were not saved: {error}")))
    }

    fn restore(&mut self, state: &Value, policies: usize) -> Result<(), String> {
        self.0.restore(state).map_err(|error| error.to_string())?;
        let known = self.0.policies();
        // a policy that was opened last may not have learnt anything
        match known == policies || (known == 0 && policies == 1) {
            true => Ok(()),
            false => Err(format!("accounts of {known} policies, expected {policies}")),
        }
    }
}
