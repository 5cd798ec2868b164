//! Grouping by camera pictures, motion and returns of whole episodes, instead of features that a
//! policy has learnt.

use cluster::{Assignment, Decision};
use evidence::{
    Account, Accountant, Album, Finding, Opinion, Recogniser, RecogniserSettings, Situation,
};
use rand_chacha::ChaCha8Rng;
use serde_json::Value;

use crate::error::LearnerError;

use super::distance::nearest;
use super::grouping::{
    Candidates, Episodes, Grouping, GroupingDecision, Learned, Lesson, Needs, Query,
};

/// Grouping that compares summaries of episodes with those that each policy trained on
/// ([`evidence::Recogniser`]). A policy that replaces another one must pass a trial.
#[derive(Debug)]
pub struct Evident {
    recogniser: Recogniser,
    /// Cache of picture features: a decision and the call of [`Grouping::learn`] after it use the
    /// same pictures.
    album: Album,
}

impl Evident {
    /// Creates a grouping that knows no policies yet.
    ///
    /// # Errors
    /// A setting out of range.
    pub fn new(settings: RecogniserSettings) -> Result<Self, LearnerError> {
        Ok(Self { recogniser: Recogniser::new(settings)?, album: Album::default() })
    }

    /// Returns the summaries of episodes, without motion and returns if a policy other than
    /// `policy` collected them, since those depend on the policy that acts.
    fn accounts(
        &mut self,
        episodes: Episodes<'_>,
        policy: usize,
    ) -> Result<Vec<Account>, LearnerError> {
        let Episodes { spec, courses, .. } = episodes;
        let filters = self.recogniser.settings().filters;
        let accountant =
            Accountant::new(spec.image_shape, &spec.vector_irreps, &spec.action_irreps, filters)?;
        let mut accounts = accountant.accounts(courses, &mut self.album)?;
        if policy != episodes.collector {
            accounts.iter_mut().for_each(Account::forget_course);
        }
        Ok(accounts)
    }

    /// Returns the most probable policy for episodes that are not used for training. Episodes that
    /// are unusual for all policies, as images of another camera, are compared in the policies' own
    /// features instead, which depend less on traces of in-painting.
    fn recognise(
        &self,
        accounts: &[Account],
        candidates: &mut dyn Candidates,
        rng: &mut ChaCha8Rng,
    ) -> Result<GroupingDecision, LearnerError> {
        let found = self.recogniser.recognise(accounts, rng)?;
        let best = match found.likeliest().filter(|_| found.is_typical()) {
            Some(policy) => policy,
            None => {
                let heirs = self.recogniser.heirs().into_iter().enumerate();
                let left = heirs.filter(|(_, heir)| heir.is_none()).map(|(policy, _)| policy);
                nearest(candidates, left)?
            }
        };
        let fits = found.policies.get(best).is_some_and(|&p| p >= found.none);
        let policy = if fits { Decision::Existing(best) } else { Decision::Undecided };
        Ok(GroupingDecision { nearest: Some(best), ..GroupingDecision::of(policy) })
    }
}

impl From<Finding> for GroupingDecision {
    fn from(finding: Finding) -> Self {
        let accepted = match finding.decision {
            Decision::Existing(_) => finding.accepted(),
            Decision::New | Decision::Undecided => Vec::new(),
        };
        let evidence = finding.opinions.iter().map(Opinion::evidence).collect();
        Self {
            cut: finding.cut,
            group_changed: finding.group_changed,
            trial: finding.trial,
            is_provisional: finding.is_provisional,
            rejected: finding.rejected,
            accepted,
            ..Assignment { decision: finding.decision, evidence }.into()
        }
    }
}

impl Grouping for Evident {
    fn needs(&self) -> Needs {
        Needs { episodes: self.recogniser.settings().min_episodes, whole_episodes: true }
    }

    fn assign(
        &mut self,
        query: Query<'_>,
        candidates: &mut dyn Candidates,
        rng: &mut ChaCha8Rng,
    ) -> Result<GroupingDecision, LearnerError> {
        let episodes = candidates.episodes();
        let collector = episodes.collector;
        let accounts = self.accounts(episodes, collector)?;
        let finding = match query {
            Query::Recognition => return self.recognise(&accounts, candidates, rng),
            Query::Rollout { can_wait } => {
                let situation = Situation { can_wait, ..Situation::of(collector) };
                self.recogniser.assign(&accounts, situation, rng)?
            }
            Query::Trial { earlier, can_wait } => {
                let situation = Situation {
                    collector,
                    rejected: &earlier.rejected,
                    is_provisional: earlier.is_provisional,
                    can_wait,
                };
                self.recogniser.review(&accounts, situation, rng)?
            }
        };
        Ok(finding.into())
    }

    /// Remembers a rollout, or merges two policies. Before a merge both act in the task group of
    /// `policy`: first the other policy, and if it serves the group, `policy` again.
    fn learn(&mut self, lesson: Lesson<'_>, rng: &mut ChaCha8Rng) -> Result<Learned, LearnerError> {
        let (mut end, mut probe) = (None, None);
        match lesson {
            Lesson::Rollout { policy, accepted, episodes } => {
                let accounts = self.accounts(episodes, policy)?;
                end = self.recogniser.learn(policy, &accounts, rng)?;
                probe = self.recogniser.twin(policy, accepted);
            }
            Lesson::Probes { policy, probes } => match *probes {
                [first] => {
                    let twin = first.collector;
                    let accounts = self.accounts(first, twin)?;
                    let is_twin = self.recogniser.compare(policy, twin, &accounts, rng)?;
                    probe = is_twin.then_some(policy);
                }
                [first, again, ..] => {
                    let twin = first.collector;
                    let of_twin = self.accounts(first, twin)?;
                    let again = self.accounts(again, policy)?;
                    self.recogniser.merge(policy, twin, &of_twin, &again, rng)?;
                }
                [] => {}
            },
        }
        Ok(Learned { end, probe, merged_into: self.recogniser.heirs() })
    }

    fn state(&self) -> Value {
        // numbers always serialise; if they did not, `restore` would reject this text and print it
        let state = self.recogniser.state(serde_json::value::Serializer);
        state.unwrap_or_else(|error| Value::String(format!("accounts were not saved: {error}")))
    }

    fn restore(&mut self, state: &Value, policies: usize) -> Result<(), String> {
        let mut restored = self.recogniser.clone();
        let read = restored.restore(state);
        read.map_err(|error| error.to_string())?;
        let known = restored.policies();
        // a fresh learner has one policy, which has not trained yet
        if known != policies && (known, policies) != (0, 1) {
            return Err(format!("accounts of {known} policies, expected {policies}"));
        }
        self.recogniser = restored;
        Ok(())
    }
}
