//! Grouping by evidence that no policy owns: pictures, motion and earnings of whole episodes.

use std::cell::RefCell;

use cluster::{Assignment, Decision};
use evidence::{
    Account, Accountant, Album, Finding, Look, Merge, Recogniser, RecogniserSettings, Situation,
};
use rand_chacha::ChaCha8Rng;
use serde_json::Value;

use crate::error::CoversError;

use super::grouping::{Answer, Candidates, Episodes, Grouping, Recognised};

/// Compares accounts of episodes with those on which each policy learnt ([`evidence::Recogniser`]);
/// a policy that is proposed must act itself before it is believed.
#[derive(Debug)]
pub struct Evident {
    recogniser: Recogniser,
    /// Pictures that were described lately.
    album: RefCell<Album>,
    /// What was said last.
    last: RefCell<Option<Finding>>,
}

impl Evident {
    /// Knows no policy yet.
    ///
    /// # Errors
    /// A setting out of range.
    pub fn new(settings: RecogniserSettings) -> Result<Self, CoversError> {
        Ok(Self {
            recogniser: Recogniser::new(settings)?,
            album: RefCell::default(),
            last: RefCell::new(None),
        })
    }

    /// The accounts of episodes. What another policy did says nothing of `policy`.
    fn accounts(&self, episodes: Episodes<'_>, policy: usize) -> Result<Vec<Account>, CoversError> {
        let Episodes { spec, courses, .. } = episodes;
        let filters = self.recogniser.settings().filters;
        let accountant = Accountant::new(spec.image, &spec.vector, &spec.action, filters)?;
        let mut accounts = accountant.accounts_with(courses, &mut self.album.borrow_mut())?;
        if policy != episodes.collector {
            accounts.iter_mut().for_each(Account::forget_course);
        }
        Ok(accounts)
    }

    fn look(&self, candidates: &mut dyn Candidates, look: Look, rng: &mut ChaCha8Rng) -> Answer {
        let episodes = candidates.episodes();
        let collector = episodes.collector;
        let accounts = self.accounts(episodes, collector)?;
        let finding = self.recogniser.assign(&accounts, collector, look, rng)?;
        Ok(self.assignment(finding, look))
    }

    fn assignment(&self, finding: Finding, look: Look) -> Assignment {
        let opinions = finding.opinions.iter();
        let assignment = Assignment {
            decision: finding.decision,
            evidence: opinions
                .map(|opinion| opinion.evidence(self.recogniser.settings(), look))
                .collect(),
        };
        self.last.replace(Some(finding));
        assignment
    }
}

impl Grouping for Evident {
    fn min_episodes(&self) -> usize {
        self.recogniser.settings().min_episodes
    }

    fn assign(&self, candidates: &mut dyn Candidates, rng: &mut ChaCha8Rng) -> Answer {
        self.look(candidates, Look::First, rng)
    }

    fn settle(&self, candidates: &mut dyn Candidates, rng: &mut ChaCha8Rng) -> Answer {
        self.look(candidates, Look::Second, rng)
    }

    /// Fewer episodes than the tests need are weighed by probabilities.
    fn recognise(
        &self,
        candidates: &mut dyn Candidates,
        rng: &mut ChaCha8Rng,
    ) -> Result<Recognised, CoversError> {
        let episodes = candidates.episodes();
        if episodes.courses.len() >= self.min_episodes() {
            let assignment = self.look(candidates, Look::First, rng)?;
            return Ok(Recognised::of(&assignment));
        }
        let collector = episodes.collector;
        let accounts = self.accounts(episodes, collector)?;
        let likeliest = self.recogniser.recognise(&accounts, rng)?.likeliest();
        Ok(Recognised {
            policy: likeliest.unwrap_or(0),
            fits: likeliest.is_some(),
        })
    }

    fn refused(&self) -> Vec<usize> {
        let last = self.last.borrow();
        last.as_ref()
            .map_or_else(Vec::new, |finding| finding.refused.clone())
    }

    fn cut(&self) -> Option<usize> {
        self.last.borrow().as_ref()?.cut
    }

    fn is_unproven(&self) -> bool {
        let last = self.last.borrow();
        last.as_ref().is_some_and(|finding| finding.is_unproven)
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
        let is_unproven = self.is_unproven();
        let situation = Situation {
            collector,
            refused,
            is_unproven,
        };
        let finding = self.recogniser.review(&accounts, situation, rng)?;
        let stays = finding.decision == Decision::Existing(collector);
        if !stays {
            refused.clone_from(&finding.refused);
        }
        let assignment = self.assignment(finding, Look::Second);
        Ok((!stays).then_some(assignment))
    }

    fn remember(
        &mut self,
        index: usize,
        episodes: Episodes<'_>,
        rng: &mut ChaCha8Rng,
    ) -> Result<Option<usize>, CoversError> {
        let accounts = self.accounts(episodes, index)?;
        Ok(self.recogniser.learn(index, &accounts, rng)?)
    }

    fn is_contested(&self) -> bool {
        self.last
            .borrow()
            .as_ref()
            .is_some_and(|finding| finding.is_contested)
    }

    fn twin(&self, index: usize) -> Option<usize> {
        let last = self.last.borrow();
        let finding = last
            .as_ref()
            .filter(|f| f.decision == Decision::Existing(index));
        self.recogniser.twin(index, finding?)
    }

    fn compare(
        &mut self,
        index: usize,
        twin: usize,
        episodes: Episodes<'_>,
        rng: &mut ChaCha8Rng,
    ) -> Result<bool, CoversError> {
        let accounts = self.accounts(episodes, twin)?;
        Ok(self.recogniser.compare(index, twin, &accounts, rng)?)
    }

    fn merge(
        &mut self,
        index: usize,
        twin: usize,
        [heard, again]: [Episodes<'_>; 2],
        rng: &mut ChaCha8Rng,
    ) -> Result<Option<Merge>, CoversError> {
        let heard = self.accounts(heard, twin)?;
        let again = self.accounts(again, index)?;
        Ok(self.recogniser.merge(index, twin, (&heard, &again), rng)?)
    }

    fn heirs(&self) -> Option<Vec<Option<usize>>> {
        Some(self.recogniser.heirs())
    }

    fn state(&self) -> Value {
        // lists of numbers have no value that fails; if one did, `restore` would refuse this text
        // and show it
        let state = self.recogniser.state(serde_json::value::Serializer);
        state.unwrap_or_else(|error| Value::String(format!("accounts were not saved: {error}")))
    }

    fn restore(&mut self, state: &Value, policies: usize) -> Result<(), String> {
        let mut restored = self.recogniser.clone();
        let read = restored.restore(state);
        read.map_err(|error| error.to_string())?;
        let known = restored.policies();
        // a policy that was opened last may not have learnt anything
        if known != policies && (known, policies) != (0, 1) {
            return Err(format!("accounts of {known} policies, expected {policies}"));
        }
        self.recogniser = restored;
        Ok(())
    }
}
