//! Whose task new episodes show: the accounts of each policy, and decisions by them.

use cluster::{Decision, SourceTest, Verdict, joint_test};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::de::Error as _;
use serde::{Deserialize, Serialize as _};

use crate::account::Account;
use crate::choice::{best, keep_or};
use crate::cut::find_cut;
use crate::error::EvidenceError;
use crate::memory::{Memory, check, known};
use crate::opinion::{Kind, Look, Opinion, changed, sources, whole};
use crate::probability::{Probabilities, Weighed};
use crate::settings::RecogniserSettings;

/// A decision and its reasons.
#[derive(Clone, Debug, PartialEq)]
pub struct Finding {
    /// Whose task the episodes show.
    pub decision: Decision,
    /// One item a policy.
    pub opinions: Vec<Opinion>,
    /// Where the group changed, if it did: episodes that began before this number of decisions
    /// belong to what ran before, and had no part in the decision.
    pub cut: Option<usize>,
    /// Policies that are out of question in this matter from here on.
    pub refused: Vec<usize>,
}

/// Who acted, and who is out of question.
#[derive(Clone, Copy, Debug)]
pub struct Situation<'a> {
    /// The policy that acted in the episodes at hand.
    pub collector: usize,
    /// Policies that were refused before in the same matter.
    pub refused: &'a [usize],
}

/// Remembers what each policy learnt on, and decides whose task new episodes show.
#[derive(Clone, Debug, PartialEq)]
pub struct Recogniser {
    settings: RecogniserSettings,
    memories: Vec<Memory>,
}

impl Recogniser {
    /// Knows no policy yet.
    ///
    /// # Errors
    /// A setting outside its range.
    pub fn new(settings: RecogniserSettings) -> Result<Self, EvidenceError> {
        settings.check()?;
        Ok(Self {
            settings,
            memories: Vec::new(),
        })
    }

    /// The settings.
    pub fn settings(&self) -> &RecogniserSettings {
        &self.settings
    }

    /// The number of policies that learnt anything.
    pub fn policies(&self) -> usize {
        self.memories.len()
    }

    /// The state as a value that [`Recogniser::restore`] takes.
    ///
    /// # Errors
    /// A serialiser's.
    pub fn state<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
        self.memories.serialize(serializer)
    }

    /// Takes a state back.
    ///
    /// # Errors
    /// A deserialiser's, numbers that are not finite, lists of other lengths, or a policy without
    /// accounts or with more than `memory`.
    pub fn restore<'de, D: serde::Deserializer<'de>>(&mut self, state: D) -> Result<(), D::Error> {
        let memories: Vec<Memory> = Vec::deserialize(state)?;
        let most = self.settings.memory;
        let mut checks = memories.iter().map(|memory| memory.check(most));
        let checked = checks.try_for_each(|check| check);
        checked
            .and_then(|()| check(known(&memories)))
            .map_err(D::Error::custom)?;
        self.memories = memories;
        Ok(())
    }

    /// Tells that `policy` learns from episodes of its own; the next new policy has the number of
    /// those that are known. What shows another group than the first of these episodes is not
    /// remembered.
    ///
    /// # Errors
    /// A number beyond that, no episode, numbers that are not finite, or lists of other lengths
    /// than those that are remembered. Nothing is learnt then.
    pub fn learn<R: Rng + ?Sized>(
        &mut self,
        policy: usize,
        accounts: &[Account],
        rng: &mut R,
    ) -> Result<(), EvidenceError> {
        let policies = self.memories.len();
        if policy > policies {
            return Err(EvidenceError::NoPolicy { policy, policies });
        }
        if accounts.is_empty() {
            return Err(EvidenceError::TooFewEpisodes { got: 0, needed: 1 });
        }
        check(known(&self.memories).chain(accounts))?;
        let mut accounts: Vec<&Account> = accounts.iter().collect();
        accounts.sort_by_key(|account| account.began);
        accounts.truncate(find_cut(&accounts, &self.settings, rng)?.unwrap_or(accounts.len()));
        if policy == policies {
            self.memories.push(Memory::default());
        }
        self.memories[policy].learn(accounts, self.settings.memory);
        Ok(())
    }

    /// Decides on one rollout of `collector`. `Existing` of another policy asks for a
    /// rollout of that one and for [`Recogniser::review`]; `Undecided` asks for one more of the
    /// same policy and for [`Recogniser::settle`]. Of a rollout that shows two groups the later one
    /// counts.
    ///
    /// # Errors
    /// Too few episodes, no such collector, or points that cannot be compared.
    pub fn assign<R: Rng + ?Sized>(
        &self,
        accounts: &[Account],
        collector: usize,
        rng: &mut R,
    ) -> Result<Finding, EvidenceError> {
        self.judge(accounts, collector, Look::First, rng)
    }

    /// Decides on the later of the groups that the episodes show.
    fn judge<R: Rng + ?Sized>(
        &self,
        accounts: &[Account],
        collector: usize,
        look: Look,
        rng: &mut R,
    ) -> Result<Finding, EvidenceError> {
        let accounts = self.in_order(accounts)?;
        let cut = find_cut(&accounts, &self.settings, rng)?;
        let later = &accounts[cut.unwrap_or(0)..];
        let situation = Situation {
            collector,
            refused: &[],
        };
        let finding = match look {
            Look::First => self.look(later, situation, rng)?,
            Look::Second => self.decide(later, situation, rng)?,
        };
        Ok(Finding {
            cut: cut.map(|_| later[0].began),
            ..finding
        })
    }

    /// One first look.
    fn look<R: Rng + ?Sized>(
        &self,
        accounts: &[&Account],
        situation: Situation,
        rng: &mut R,
    ) -> Result<Finding, EvidenceError> {
        let opinions = self.opinions(accounts, situation, Look::First, rng)?;
        Ok(Finding {
            decision: self.first_decision(&opinions, situation.collector),
            opinions,
            cut: None,
            refused: Vec::new(),
        })
    }

    /// Decides on two rollouts of `collector` for good, after [`Recogniser::assign`] was undecided
    /// on the first. If they show two groups one after the other, the decision is on the later one.
    ///
    /// # Errors
    /// Those of [`Recogniser::assign`].
    pub fn settle<R: Rng + ?Sized>(
        &self,
        accounts: &[Account],
        collector: usize,
        rng: &mut R,
    ) -> Result<Finding, EvidenceError> {
        self.judge(accounts, collector, Look::Second, rng)
    }

    /// Decides on a rollout of `situation.collector`, which an earlier decision proposed: what it
    /// does itself in the task at hand speaks for or against it, too. Of a rollout that shows two
    /// groups the earlier one counts, for which the policy was proposed.
    ///
    /// # Errors
    /// Those of [`Recogniser::assign`].
    pub fn review<R: Rng + ?Sized>(
        &self,
        accounts: &[Account],
        situation: Situation,
        rng: &mut R,
    ) -> Result<Finding, EvidenceError> {
        let accounts = self.in_order(accounts)?;
        let mut finding = self.decide(&accounts, situation, rng)?;
        let keep = Decision::Existing(situation.collector);
        if finding.decision != keep
            && let Some(cut) = find_cut(&accounts, &self.settings, rng)?
        {
            finding = self.decide(&accounts[..cut], situation, rng)?;
            finding.cut = Some(accounts[cut].began);
        }
        // one that has been tried is not tried again
        if finding.decision != keep {
            finding.refused.push(situation.collector);
        }
        Ok(finding)
    }

    /// How likely each policy is, for episodes in which nobody in particular acted; one is enough.
    ///
    /// # Errors
    /// No episode, or points that cannot be compared.
    pub fn recognise<R: Rng + ?Sized>(
        &self,
        accounts: &[Account],
        rng: &mut R,
    ) -> Result<Probabilities, EvidenceError> {
        if accounts.is_empty() {
            return Err(EvidenceError::TooFewEpisodes { got: 0, needed: 1 });
        }
        let situation = Situation {
            collector: self.memories.len(),
            refused: &[],
        };
        let accounts: Vec<&Account> = accounts.iter().collect();
        let opinions = self.opinions(&accounts, situation, Look::Second, rng)?;
        let weighed = opinions.iter().map(|opinion| Weighed {
            p_value: opinion.test().map(|_| opinion.tail_p_value()),
            may_be_drift: !self.speaks_against(opinion, self.settings.doubt),
            misfit: opinion.misfit(),
        });
        Ok(Probabilities::of(&weighed.collect::<Vec<_>>()))
    }

    /// The accounts in the order in which their episodes began.
    fn in_order<'a>(&self, accounts: &'a [Account]) -> Result<Vec<&'a Account>, EvidenceError> {
        let (got, needed) = (accounts.len(), self.settings.min_episodes);
        if got < needed {
            return Err(EvidenceError::TooFewEpisodes { got, needed });
        }
        let mut accounts: Vec<&Account> = accounts.iter().collect();
        accounts.sort_by_key(|account| account.began);
        Ok(accounts)
    }

    fn opinions<R: Rng + ?Sized>(
        &self,
        accounts: &[&Account],
        situation: Situation,
        look: Look,
        rng: &mut R,
    ) -> Result<Vec<Opinion>, EvidenceError> {
        // each policy has a generator of its own, so that threads change nothing
        let seeds: Vec<u64> = self.memories.iter().map(|_| rng.random()).collect();
        let asked = seeds.into_par_iter().enumerate().map(|(policy, seed)| {
            let own = policy == situation.collector;
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let mut opinion = self.opine(&self.memories[policy], accounts, own, look, &mut rng)?;
            if situation.refused.contains(&policy) {
                opinion.verdict = Verdict::Refused;
            }
            Ok(opinion)
        });
        asked.collect()
    }

    fn opine(
        &self,
        memory: &Memory,
        accounts: &[&Account],
        own: bool,
        look: Look,
        rng: &mut ChaCha8Rng,
    ) -> Result<Opinion, EvidenceError> {
        let settings = &self.settings;
        let remembered: Vec<&Account> = memory.accounts.iter().collect();
        // courses count where both sides are of one policy
        let least = settings.min_episodes;
        let courses = whole(accounts, least).zip(whole(&remembered, least));
        let (kinds, seen, home) = match courses.filter(|_| own) {
            Some((seen, home)) => (Kind::ALL.to_vec(), seen, home),
            None => (Kind::LOOKS.to_vec(), accounts.to_vec(), remembered.clone()),
        };
        let mut opinion = Opinion {
            kinds,
            test: None,
            changed: changed(accounts, &remembered),
            lost: memory.lost(accounts),
            verdict: Verdict::Accepted,
            remembered: remembered.len(),
        };
        if remembered.len() < least {
            return Ok(opinion);
        }
        let sources = sources(&opinion.kinds, &seen, &home)?;
        let permutations = match look {
            Look::First => settings.permutations,
            Look::Second => 3 * settings.permutations,
        };
        opinion.test = Some(joint_test(&sources, permutations, rng)?);
        opinion.verdict = self.verdict(&opinion, look);
        Ok(opinion)
    }

    /// The first look trusts the exact p-values, the second the tail's; a difference that speaks
    /// against a policy for good must be large as well, and one that only its course shows must be
    /// so from the beginning.
    fn verdict(&self, opinion: &Opinion, look: Look) -> Verdict {
        let (doubt, level) = (self.settings.doubt, self.settings.level);
        match look {
            Look::First => {
                let mut against = opinion.sources().filter(|(_, s)| s.p_value <= doubt);
                let doubted = |(kind, source): (Kind, &SourceTest)| {
                    kind.is_look() || self.is_large(opinion, kind, source)
                };
                match against.any(doubted) {
                    true => Verdict::Doubted,
                    false => Verdict::Accepted,
                }
            }
            Look::Second if self.speaks_against(opinion, level) => Verdict::Refused,
            Look::Second => Verdict::Accepted,
        }
    }

    /// Whether a source shows a difference that is large, and significant at this level.
    fn speaks_against(&self, opinion: &Opinion, level: f64) -> bool {
        let mut against = opinion.sources().filter(|(_, s)| s.tail_p_value <= level);
        against.any(|(kind, source)| self.is_large(opinion, kind, source))
    }

    /// Whether a difference is more than drift.
    fn is_large(&self, opinion: &Opinion, kind: Kind, source: &SourceTest) -> bool {
        match kind {
            Kind::Picture | Kind::Vector => source.ratio() >= self.settings.min_ratio,
            Kind::Motion => opinion.changed >= self.settings.min_motion,
            Kind::Earnings => opinion.lost >= self.settings.min_loss,
        }
    }

    fn first_decision(&self, opinions: &[Opinion], collector: usize) -> Decision {
        let own = opinions.get(collector);
        let other = best(opinions, |policy| policy != collector);
        match (own, other) {
            (Some(own), _) if own.verdict == Verdict::Accepted => {
                Decision::Existing(keep_or(collector, other, opinions))
            }
            // what happened under a policy cannot speak for others, and a second look is cheaper
            // than trying them
            (Some(own), _) if !own.looks_doubtful(self.settings.doubt) => Decision::Undecided,
            (_, Some(policy)) => Decision::Existing(policy),
            _ => Decision::Undecided,
        }
    }

    fn decide<R: Rng + ?Sized>(
        &self,
        accounts: &[&Account],
        situation: Situation,
        rng: &mut R,
    ) -> Result<Finding, EvidenceError> {
        let collector = situation.collector;
        let opinions = self.opinions(accounts, situation, Look::Second, rng)?;
        let own = opinions.get(collector);
        let other = best(&opinions, |policy| policy != collector);
        let decision = match (own, other) {
            (Some(own), _) if own.verdict == Verdict::Accepted => {
                Decision::Existing(keep_or(collector, other, &opinions))
            }
            (_, Some(policy)) => Decision::Existing(policy),
            (_, None) => Decision::New,
        };
        let refused = |policy: &usize| opinions[*policy].is_refused();
        Ok(Finding {
            decision,
            cut: None,
            refused: (0..opinions.len()).filter(refused).collect(),
            opinions,
        })
    }
}
