//! Whose task new episodes show: the accounts of each policy, and decisions by them.

use cluster::{Decision, Verdict, change_places, change_test};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;

use crate::account::Account;
use crate::choice::Choice;
use crate::error::EvidenceError;
use crate::examiner::Examiner;
use crate::memory::{Memory, check, known};
use crate::opinion::{Kind, Look, Opinion, Role, frames, whole};
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
    /// Whether looks alone do not say that it is the policy named: it is worth while to let it act
    /// for some episodes before it acts for a rollout.
    pub is_contested: bool,
    /// Whether what was seen before the policy named acted speaks against it: it looks another, or
    /// has an heir, and must show that it serves, as far as it has learnt.
    pub is_unproven: bool,
}

impl Finding {
    /// Returns the policies that nothing speaks against.
    pub fn accepted(&self) -> Vec<usize> {
        let policies = 0..self.opinions.len();
        policies.filter(|&policy| self.opinions[policy].verdict() == Verdict::Accepted).collect()
    }
}

/// Who acted, and who is out of question.
#[derive(Clone, Copy, Debug, Default)]
pub struct Situation<'a> {
    /// The policy that acted in the episodes at hand.
    pub collector: usize,
    /// Policies that were refused before in the same matter.
    pub refused: &'a [usize],
    /// As the finding said that proposed the one that acted ([`Finding::is_unproven`]).
    pub is_unproven: bool,
}

impl Situation<'_> {
    /// Nobody was refused, and nobody proposed the policy that acted.
    fn of(collector: usize) -> Self {
        Self { collector, ..Self::default() }
    }
}

/// Remembers what each policy learnt on, and decides whose task new episodes show.
#[derive(Clone, Debug, PartialEq)]
pub struct Recogniser {
    settings: RecogniserSettings,
    pub(crate) memories: Vec<Memory>,
}

impl Recogniser {
    /// Knows no policy yet.
    ///
    /// # Errors
    /// A setting outside its range.
    pub fn new(settings: RecogniserSettings) -> Result<Self, EvidenceError> {
        settings.check()?;
        Ok(Self { settings, memories: Vec::new() })
    }

    /// The settings.
    pub fn settings(&self) -> &RecogniserSettings {
        &self.settings
    }

    /// The number of policies that learnt anything.
    pub fn policies(&self) -> usize {
        self.memories.len()
    }

    /// Tells that `policy` learns from episodes of its own; the next new policy has the number of
    /// those that are known. One that was merged is asked again from here on. What shows another
    /// group than the first of these episodes is not remembered: returns the number of decisions
    /// before the first episode that is left out, if one is.
    ///
    /// # Errors
    /// A number beyond that, no episode, numbers that are not finite, or lists of other lengths
    /// than those that are remembered. Nothing is learnt then.
    pub fn learn<R: Rng + ?Sized>(
        &mut self,
        policy: usize,
        accounts: &[Account],
        rng: &mut R,
    ) -> Result<Option<usize>, EvidenceError> {
        let policies = self.memories.len();
        if policy != policies {
            self.check_policy(policy)?;
        }
        if accounts.is_empty() {
            return Err(EvidenceError::TooFewEpisodes { got: 0, needed: 1 });
        }
        check(known(&self.memories).chain(accounts))?;
        let mut accounts = sorted(accounts);
        let cut = find_cut(&accounts, &self.settings, rng)?;
        let end = cut.map(|cut| accounts[cut].began);
        accounts.truncate(cut.unwrap_or(accounts.len()));
        let is_outdated = self.is_outdated(policy, &accounts, rng)?;
        if policy == policies {
            self.memories.push(Memory::default());
        }
        self.revive(policy);
        let memory = &mut self.memories[policy];
        if is_outdated {
            memory.accounts.clear();
        }
        memory.learn(accounts, self.settings.memory);
        Ok(end)
    }

    /// Whether what a policy remembers, if it is known, looks no more like that on which it is
    /// about to learn: its group drifted while it was away.
    fn is_outdated<R: Rng + ?Sized>(
        &self,
        policy: usize,
        accounts: &[&Account],
        rng: &mut R,
    ) -> Result<bool, EvidenceError> {
        let mut own = ChaCha8Rng::seed_from_u64(rng.random());
        if accounts.len() < self.settings.min_episodes {
            return Ok(false);
        }
        let mut memory = self.memories.get(policy).cloned().unwrap_or_default();
        // it is about to have none
        memory.heir = None;
        let (examiner, role) = (Examiner(&self.settings), Role::Stranger);
        let opinion = examiner.opine(&memory, accounts, role, Look::Second, &mut own)?;
        Ok(opinion.is_refused())
    }

    /// Decides on one rollout of `collector`, or for good on two ([`Look`]). `Existing` of another
    /// policy asks for a rollout of that one and for [`Recogniser::review`]; `Undecided`, of a
    /// first look alone, asks for one more of the same policy and for a second look at both. Of
    /// episodes that show two groups, the later group counts.
    ///
    /// # Errors
    /// Too few episodes, no such collector, or points that cannot be compared.
    pub fn assign<R: Rng + ?Sized>(
        &self,
        accounts: &[Account],
        collector: usize,
        look: Look,
        rng: &mut R,
    ) -> Result<Finding, EvidenceError> {
        let accounts = self.in_order(accounts)?;
        let cut = find_cut(&accounts, &self.settings, rng)?;
        let later = &accounts[cut.unwrap_or(0)..];
        let situation = Situation::of(collector);
        let finding = match look {
            Look::First => self.look(later, situation, rng)?,
            Look::Second => self.decide(later, situation, Role::Stays, rng)?,
        };
        Ok(Finding { cut: cut.map(|_| later[0].began), ..finding })
    }

    /// One first look.
    fn look<R: Rng + ?Sized>(
        &self,
        accounts: &[&Account],
        situation: Situation,
        rng: &mut R,
    ) -> Result<Finding, EvidenceError> {
        let opinions = self.opinions(accounts, situation, (Look::First, Role::Stays), rng)?;
        let choice = Choice::new(&opinions, situation.collector);
        let rivals = choice.rivals();
        let alike = choice.is_alike(self.settings.doubt);
        let is_sure = |own| Examiner(&self.settings).surely_refuses(own);
        let sure = choice.own().is_some_and(is_sure);
        // what happened under a policy cannot speak for others: they are tried at once where
        // it is beyond doubt, and else a second look is cheaper
        let rival = rivals.first().copied().filter(|_| sure || !alike);
        let named = choice.kept().or(rival);
        Ok(Finding {
            decision: named.map_or(Decision::Undecided, Decision::Existing),
            cut: None,
            refused: sure.then_some(situation.collector).into_iter().collect(),
            is_contested: alike || rivals.len() > 1,
            is_unproven: false,
            opinions,
        })
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
        let role = if situation.is_unproven { Role::Excused } else { Role::Returns };
        let mut finding = self.decide(&accounts, situation, role, rng)?;
        let keep = Decision::Existing(situation.collector);
        if finding.decision != keep
            && let Some(cut) = find_cut(&accounts, &self.settings, rng)?
        {
            finding = self.decide(&accounts[..cut], situation, role, rng)?;
            finding.cut = Some(accounts[cut].began);
        }
        if finding.decision == keep {
            finding.is_unproven = situation.is_unproven
        } else {
            // one that has been tried is not tried again
            finding.refused.push(situation.collector)
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
        let situation = Situation::of(self.memories.len());
        let accounts: Vec<&Account> = accounts.iter().collect();
        let opinions = self.opinions(&accounts, situation, (Look::Second, Role::Stranger), rng)?;
        let examiner = Examiner(&self.settings);
        let weighed = opinions.iter().zip(&self.memories);
        let weighed = weighed.map(|(opinion, memory)| Weighed {
            p_value: (opinion.test().filter(|_| !memory.is_gone())).map(|_| opinion.tail_p_value()),
            may_be_drift: !examiner.speaks_against(opinion, self.settings.doubt),
            misfit: opinion.misfit(),
        });
        Ok(Probabilities::of(&weighed.collect::<Vec<_>>()))
    }

    /// Whether a policy may be meant that looks another, or has an heir: it was away.
    fn may_have_drifted(&self, policy: usize, situation: Situation) -> bool {
        policy != situation.collector && !situation.refused.contains(&policy)
    }

    /// Refuses a policy that was never told of.
    pub(crate) fn check_policy(&self, policy: usize) -> Result<(), EvidenceError> {
        let policies = self.memories.len();
        if policy < policies { Ok(()) } else { Err(EvidenceError::NoPolicy { policy, policies }) }
    }

    /// The accounts in the order in which their episodes began.
    pub(crate) fn in_order<'a>(
        &self,
        accounts: &'a [Account],
    ) -> Result<Vec<&'a Account>, EvidenceError> {
        let (got, needed) = (accounts.len(), self.settings.min_episodes);
        if got < needed {
            return Err(EvidenceError::TooFewEpisodes { got, needed });
        }
        Ok(sorted(accounts))
    }

    /// What each policy says, in its role.
    fn opinions<R: Rng + ?Sized>(
        &self,
        accounts: &[&Account],
        situation: Situation,
        (look, role): (Look, Role),
        rng: &mut R,
    ) -> Result<Vec<Opinion>, EvidenceError> {
        // each policy has a generator of its own, so that threads change nothing
        let seeds: Vec<u64> = self.memories.iter().map(|_| rng.random()).collect();
        let examiner = Examiner(&self.settings);
        let asked = seeds.into_par_iter().enumerate().map(|(policy, seed)| {
            let role = if policy == situation.collector { role } else { Role::Stranger };
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let memory = &self.memories[policy];
            let mut opinion = examiner.opine(memory, accounts, role, look, &mut rng)?;
            if situation.refused.contains(&policy) {
                opinion.verdict = Verdict::Refused;
            }
            Ok(opinion)
        });
        asked.collect()
    }

    /// One second look.
    fn decide<R: Rng + ?Sized>(
        &self,
        accounts: &[&Account],
        situation: Situation,
        role: Role,
        rng: &mut R,
    ) -> Result<Finding, EvidenceError> {
        let opinions = self.opinions(accounts, situation, (Look::Second, role), rng)?;
        let choice = Choice::new(&opinions, situation.collector);
        let rivals = choice.rivals();
        let named = choice.kept().or_else(|| rivals.first().copied());
        let examiner = Examiner(&self.settings);
        let most = (examiner.drifted(), examiner.farthest());
        let may_have = |policy| self.may_have_drifted(policy, situation);
        let can_show = |policy: usize| examiner.knows(&self.memories[policy]);
        let are_kin = |a: usize, b: usize| {
            self.memories[a].heir == Some(b) || self.memories[b].heir == Some(a)
        };
        let named = named.or_else(|| choice.drifted(most, may_have, can_show, are_kin));
        Ok(Finding {
            decision: named.map_or(Decision::New, Decision::Existing),
            cut: None,
            refused: self.refused(&opinions, named, situation),
            is_contested: choice.is_alike(self.settings.doubt) || rivals.len() != 1,
            is_unproven: named.is_some_and(|policy| opinions[policy].is_refused()),
            opinions,
        })
    }

    /// The policies that are out of question for good: the refused ones, but for the one named. One
    /// that has an heir must have been tried.
    fn refused(
        &self,
        opinions: &[Opinion],
        named: Option<usize>,
        situation: Situation,
    ) -> Vec<usize> {
        let is_refused = |&policy: &usize| {
            let is_tried = !self.memories[policy].is_gone() || situation.refused.contains(&policy);
            opinions[policy].is_refused() && named != Some(policy) && is_tried
        };
        (0..opinions.len()).filter(is_refused).collect()
    }
}

/// Accounts in the order in which their episodes began.
fn sorted(accounts: &[Account]) -> Vec<&Account> {
    let mut accounts: Vec<&Account> = accounts.iter().collect();
    accounts.sort_by_key(|account| account.began);
    accounts
}

/// Random orders of a test, for each random split of a first look: they cost next to nothing.
const ORDERS: usize = 4;

/// The number of accounts, in the order in which their episodes began, that show another group than
/// the rest; none where one group explains all. Episodes that began together stay together.
///
/// Bounded in time: only the latest accounts are looked at, twice as many as a policy remembers.
fn find_cut<R: Rng + ?Sized>(
    accounts: &[&Account],
    settings: &RecogniserSettings,
    rng: &mut R,
) -> Result<Option<usize>, EvidenceError> {
    let latest = &accounts[accounts.len().saturating_sub(2 * settings.memory)..];
    let (kinds, seen) = match whole(latest, settings.min_episodes) {
        Some(seen) => (Kind::ALL.to_vec(), seen),
        None => (Kind::LOOKS.to_vec(), latest.to_vec()),
    };
    let began: Vec<_> = seen.iter().map(|account| account.began).collect();
    let cuts = change_places(&began, settings.min_episodes);
    if cuts.is_empty() {
        return Ok(None);
    }
    let all = kinds.iter().map(|&kind| frames(&seen, kind));
    let all = all.collect::<Result<Vec<_>, _>>()?;
    let test = change_test(&all, &cuts, ORDERS * settings.permutations, rng)?;
    let began = seen[test.cut].began;
    let cut = accounts.partition_point(|account| account.began < began);
    Ok((test.p_value <= settings.cut).then_some(cut))
}
