//! Grouping by evidence that no policy owns: pictures, motion and returns of whole episodes.

use cluster::{Assignment, Decision};
use evidence::{
    Account, Accountant, Album, Finding, Look, Recogniser, RecogniserSettings, Situation,
};
use rand_chacha::ChaCha8Rng;
use serde_json::Value;

use crate::error::LearnerError;

use super::grouping::{
    Candidates, Episodes, Grouping, GroupingDecision, Learned, Lesson, Needs, Query, Trial,
};

/// Grouping that compares summaries of episodes with those that each policy trained on
/// ([`evidence::Recogniser`]). A policy that replaces another one must pass a trial.
#[derive(Debug)]
pub struct Evident {
    recogniser: Recogniser,
    /// Cache of picture features: a decision and the lesson after it use the same pictures.
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
    /// `policy` collected them, since those depend on who acts.
    fn accounts(
        &mut self,
        episodes: Episodes<'_>,
        policy: usize,
    ) -> Result<Vec<Account>, LearnerError> {
        let Episodes { spec, courses, .. } = episodes;
        let filters = self.recogniser.settings().filters;
        let accountant =
            Accountant::new(spec.image_shape, &spec.vector_irreps, &spec.action_irreps, filters)?;
        let mut accounts = accountant.accounts_with(courses, &mut self.album)?;
        if policy != episodes.collector {
            accounts.iter_mut().for_each(Account::forget_course);
        }
        Ok(accounts)
    }

    fn decision(&self, finding: Finding, look: Look) -> GroupingDecision {
        let settings = self.recogniser.settings();
        let accepted = match finding.decision {
            Decision::Existing(_) => finding.accepted(),
            Decision::New | Decision::Undecided => Vec::new(),
        };
        let opinions = finding.opinions.iter();
        let assignment = Assignment {
            decision: finding.decision,
            evidence: opinions.map(|o| o.evidence(settings, look)).collect(),
        };
        GroupingDecision {
            cut: finding.cut,
            trial: if finding.is_contested { Trial::Episodes } else { Trial::Rollout },
            provisional: finding.is_unproven,
            rejected: finding.rejected,
            accepted,
            ..assignment.into()
        }
    }

    /// Decides on fewer episodes than the tests need, by the probabilities of the policies.
    fn likeliest(
        &self,
        accounts: &[Account],
        rng: &mut ChaCha8Rng,
    ) -> Result<GroupingDecision, LearnerError> {
        let likeliest = self.recogniser.recognise(accounts, rng)?.likeliest();
        let decision = likeliest.map_or(Decision::Undecided, Decision::Existing);
        Ok(GroupingDecision::of(decision))
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
        let look = match query {
            Query::Recognition if accounts.len() < self.needs().episodes => {
                return self.likeliest(&accounts, rng);
            }
            Query::Rollout | Query::Recognition => Look::First,
            Query::TwoRollouts | Query::Trial(_) => Look::Second,
        };
        let finding = match query {
            Query::Trial(earlier) => {
                let situation = Situation {
                    collector,
                    rejected: &earlier.rejected,
                    is_unproven: earlier.provisional,
                };
                self.recogniser.review(&accounts, situation, rng)?
            }
            _ => self.recogniser.assign(&accounts, collector, look, rng)?,
        };
        Ok(self.decision(finding, look))
    }

    /// Remembers a rollout, or merges two policies. Before that both act in the group: first the
    /// one from another group, and if it serves this one, the policy of this group again.
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
                    let heard = self.accounts(first, twin)?;
                    let again = self.accounts(again, policy)?;
                    self.recogniser.merge(policy, twin, &heard, &again, rng)?;
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
