//! Recogniser of task groups: remembers summaries of each policy's episodes, and decides which
//! policy new episodes belong to.

use std::collections::VecDeque;

use cluster::{Decision, Verdict, change_places, change_test};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::account::Account;
use crate::choice::Choice;
use crate::error::{EvidenceError, Result};
use crate::examiner::Examiner;
use crate::memory::{Memory, check, known};
use crate::opinion::{Kind, Look, Opinion, Role, frames, whole};
use crate::probability::{Probabilities, weight};
use crate::settings::RecogniserSettings;

/// Decision on the policy of a rollout, with its reasons.
#[derive(Clone, Debug, PartialEq)]
pub struct Finding {
    /// Policy that the episodes are assigned to: an existing one, a new one, or none yet.
    pub decision: Decision,
    /// Evidence for and against each policy, in the order of the policies.
    pub opinions: Vec<Opinion>,
    /// Changepoint, in decisions of all environments since the start of the rollout, if the task
    /// group changed: episodes that began before it belong to the earlier group.
    /// [`Recogniser::assign`] judges the later episodes, [`Recogniser::review`] the earlier ones,
    /// unless `group_changed`.
    pub cut: Option<usize>,
    /// `true` if the task group changed after the acting policy was proposed, so that earlier
    /// rollouts show another task group.
    pub group_changed: bool,
    /// Indices of the policies that are rejected for this task group from here on.
    pub rejected: Vec<usize>,
    /// Trial that the named policy must pass, unless it is the one that acted.
    pub trial: Trial,
    /// `true` if the named policy is provisional: evidence from before it acted rejects it, because
    /// pictures or vectors differ or it was merged, so its returns must show that it serves the
    /// group.
    pub is_provisional: bool,
}

/// Trial that a policy must pass if a decision names it in place of the policy that acted.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq)]
pub enum Trial {
    /// No trial of the named policy: the decision is final.
    #[default]
    None,
    /// One rollout that the named policy collects itself.
    Rollout,
    /// A few episodes of the named policy first, as many as a decision needs and at least one in
    /// each environment, since several policies may fit; then one rollout.
    Episodes,
    /// No trial before the named policy trains, since it would come too late: the task group
    /// changed while another policy was on trial. The named policy trains on the rollout of that
    /// one. If that one only acted for a few episodes, the named policy collects a rollout for
    /// review.
    Waived,
}

impl Trial {
    /// Returns the trial of a named policy: first episodes if several policies may fit, else a
    /// rollout.
    fn of_policy(is_contested: bool) -> Self {
        if is_contested { Self::Episodes } else { Self::Rollout }
    }
}

impl Finding {
    /// Returns the indices of the policies that the evidence accepts.
    pub fn accepted(&self) -> Vec<usize> {
        let policies = 0..self.opinions.len();
        policies.filter(|&policy| self.opinions[policy].verdict == Verdict::Accepted).collect()
    }
}

/// Context of a decision on a rollout: the policy that acted, the rejected policies and earlier
/// decisions.
#[derive(Clone, Copy, Debug, Default)]
pub struct Situation<'a> {
    /// Index of the policy that acted in the episodes.
    pub collector: usize,
    /// Indices of the policies that were rejected for the same task group before.
    pub rejected: &'a [usize],
    /// Value of [`Finding::is_provisional`] in the decision that proposed the acting policy.
    pub is_provisional: bool,
    /// `true` if the decision may be [`Decision::Undecided`], so that another rollout is collected.
    pub can_wait: bool,
}

impl Situation<'_> {
    /// Creates the context of a rollout by a policy that was not proposed before, with no rejected
    /// policies.
    pub fn of(collector: usize) -> Self {
        Self { collector, can_wait: true, ..Self::default() }
    }
}

/// Episodes that a decision is about, sorted by time, and their context.
#[derive(Clone, Copy)]
struct Case<'a> {
    accounts: &'a [&'a Account],
    situation: Situation<'a>,
}

/// Largest number of undecided rollouts that are kept until another one of their task group
/// appears.
// A group that is visited once in 16 undecided rollouts is still found.
const MOST_HELD: usize = 16;

/// Least p-value at which two undecided rollouts are taken for one task group.
// A policy that is created from two groups serves neither, and a rollout that waits costs little:
// one of ten pairs of one group waits for a third rollout. Of 72 worlds with visits of one or two
// rollouts 82 % had as many policies as groups, 79 % with 0.2 and 47 % with 0.02 (seeds 1000 on).
const ALIKE: f64 = 0.1;

/// Number of random orders of a changepoint test for each random split of a first look at a
/// rollout.
// Energy distances of an order are cheap: one pass over the pairs of episodes (`change_test`).
const ORDERS: usize = 4;

/// Number of policies without training from which on rollouts of new task groups are kept undecided
/// instead of creating a policy.
const MOST_UNTRAINED: usize = 8;

/// Undecided rollout: no policy trained on it, since its episodes were too few to decide.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub(crate) struct Held {
    /// Index of the policy that acted in the undecided rollout.
    pub(crate) collector: usize,
    pub(crate) accounts: Vec<Account>,
}

/// Recogniser of task groups: remembers the episodes that each policy trained on, and decides whose
/// task new episodes show.
#[derive(Clone, Debug, PartialEq)]
pub struct Recogniser {
    settings: RecogniserSettings,
    pub(crate) memories: Vec<Memory>,
    /// Undecided rollouts that are kept, the latest last.
    pub(crate) held: VecDeque<Held>,
}

impl Recogniser {
    /// Creates a recogniser that knows no policies yet.
    ///
    /// # Errors
    /// A setting outside its range.
    pub fn new(settings: RecogniserSettings) -> Result<Self> {
        settings.check()?;
        Ok(Self { settings, memories: Vec::new(), held: VecDeque::new() })
    }

    /// Returns the settings of the recogniser.
    pub fn settings(&self) -> &RecogniserSettings {
        &self.settings
    }

    /// Returns the number of policies that trained on any episode or were created for some.
    pub fn policies(&self) -> usize {
        self.memories.len()
    }

    /// Remembers that `policy` trains on the episodes `accounts`, in which it acted. A new policy
    /// has the index [`policies`](Self::policies). A merge of `policy` is undone. Episodes after a
    /// changepoint are left out: returns the decisions before the first of them, if there is one.
    ///
    /// # Errors
    /// A larger index, no episode, numbers that are not finite, or lists whose length differs from
    /// the remembered ones. Nothing is remembered then.
    pub fn learn(
        &mut self,
        policy: usize,
        accounts: &[Account],
        rng: &mut impl Rng,
    ) -> Result<Option<usize>> {
        self.check_actor(policy)?;
        if accounts.is_empty() {
            return Err(EvidenceError::TooFewEpisodes { got: 0, needed: 1 });
        }
        check(known(&self.memories).chain(accounts))?;
        let mut accounts = sorted(accounts);
        let cut = self.find_cut(&accounts, rng)?;
        let end = cut.map(|cut| accounts[cut].began);
        accounts.truncate(cut.unwrap_or(accounts.len()));
        let is_outdated = self.is_outdated(policy, &accounts, rng)?;
        if policy == self.memories.len() {
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

    /// Returns `true` if a policy's memory no longer matches the pictures or vectors that it is
    /// about to train on, because its group drifted while it was away.
    fn is_outdated(
        &self,
        policy: usize,
        accounts: &[&Account],
        rng: &mut impl Rng,
    ) -> Result<bool> {
        let mut own = ChaCha8Rng::seed_from_u64(rng.random());
        if accounts.len() < self.settings.min_episodes {
            return Ok(false);
        }
        let mut memory = self.memories.get(policy).cloned().unwrap_or_default();
        // training is about to undo a merge, which would otherwise count as a rejection
        memory.heir = None;
        let role = Role::Stranger;
        let opinion = self.examiner().opine(&memory, accounts, role, Look::Second, &mut own)?;
        Ok(opinion.is_rejected())
    }

    /// Decides which policy one rollout of `situation.collector` belongs to. `Existing` with
    /// another policy, and `New`, ask for a rollout of that policy and for [`Recogniser::review`].
    /// A rollout that is too little to decide is held, and judged together with the next one that
    /// looks like it. `Undecided`, if `situation` allows it, asks for another rollout; no policy
    /// may train on this one. After a changepoint, only the later episodes count.
    ///
    /// # Errors
    /// [`EvidenceError::NoPolicy`] for a collector above [`policies`](Self::policies); too few
    /// episodes, or episodes that cannot be compared.
    pub fn assign(
        &mut self,
        accounts: &[Account],
        situation: Situation,
        rng: &mut impl Rng,
    ) -> Result<Finding> {
        self.check_actor(situation.collector)?;
        let accounts = self.in_order(accounts)?;
        let cut = self.find_cut(&accounts, rng)?;
        let case = Case { accounts: &accounts[cut.unwrap_or(0)..], situation };
        let mut finding = self.look(case, rng)?;
        if finding.decision == Decision::Undecided {
            finding = self.look_again(case, finding, rng)?;
        }
        finding.cut = cut.map(|cut| accounts[cut].began);
        Ok(finding)
    }

    /// Decides on episodes that a first look left undecided, together with kept undecided rollouts
    /// of the same task group; without such, keeps them if the situation allows it.
    fn look_again(
        &mut self,
        case: Case,
        undecided: Finding,
        rng: &mut impl Rng,
    ) -> Result<Finding> {
        let earlier = self.recall(case, rng)?;
        if earlier.is_empty() && case.situation.can_wait {
            self.hold(case);
            return Ok(undecided);
        }
        let all: Vec<&Account> = earlier.iter().chain(case.accounts.iter().copied()).collect();
        let case = Case { accounts: &all, ..case };
        let finding = self.decide(case, Role::Stays, rng)?;
        self.open(case, finding)
    }

    /// Creates the policy that a decision asks for, which remembers the pictures and vectors of the
    /// episodes. If there are `max_policies` already, the most similar one is named instead,
    /// without a trial. If too many wait for their first training, the episodes are held.
    fn open(&mut self, case: Case, finding: Finding) -> Result<Finding> {
        if finding.decision != Decision::New {
            return Ok(finding);
        }
        if self.memories.len() >= self.settings.max_policies {
            let similar = self.most_similar(&finding.opinions);
            let decision = Decision::Existing(similar.unwrap_or(case.situation.collector));
            return Ok(Finding { decision, trial: Trial::None, ..finding });
        }
        let untrained = self.memories.iter().filter(|memory| !memory.is_trained).count();
        if case.situation.can_wait && untrained >= MOST_UNTRAINED {
            self.hold(case);
            return Ok(Finding { decision: Decision::Undecided, ..finding });
        }
        let mut memory = Memory::default();
        let accounts = case.accounts.iter().map(|account| account.without_course());
        memory.remember(accounts, self.settings.memory);
        self.memories.push(memory);
        Ok(finding)
    }

    /// Returns the index of the policy that fits best among those that were tested and not merged.
    fn most_similar(&self, opinions: &[Opinion]) -> Option<usize> {
        let is_tested =
            |&policy: &usize| !self.memories[policy].is_gone() && opinions[policy].test.is_some();
        let misfit = |policy: &usize| opinions[*policy].misfit();
        (0..opinions.len()).filter(is_tested).min_by(|a, b| misfit(a).total_cmp(&misfit(b)))
    }

    /// Decides on the policy of one rollout at the first look.
    fn look(&self, case: Case, rng: &mut impl Rng) -> Result<Finding> {
        let collector = case.situation.collector;
        let opinions = self.opinions(case, Look::First, Role::Stays, rng)?;
        let choice = Choice::new(&opinions, collector);
        let rivals = choice.rivals();
        let alike = choice.is_alike(self.settings.doubt);
        let sure = choice.own().is_some_and(|own| self.examiner().surely_rejects(own));
        // motion and returns under this policy are no evidence about others, so trying another one
        // costs a rollout: it pays off if this policy is surely wrong or its pictures differ; in
        // other cases a second look at this policy is cheaper
        let rival = rivals.first().copied().filter(|_| sure || !alike);
        let named = choice.kept().or(rival);
        Ok(Finding {
            decision: named.map_or(Decision::Undecided, Decision::Existing),
            cut: None,
            group_changed: false,
            rejected: sure.then_some(collector).into_iter().collect(),
            trial: Trial::of_policy(alike || rivals.len() > 1),
            is_provisional: false,
            opinions,
        })
    }

    /// Reviews the policy `situation.collector`, which an earlier decision proposed, by a rollout
    /// that it collected itself. Its own motion and returns are compared, too. If it is rejected
    /// and there is a changepoint, only the earlier episodes count, for whose group the policy was
    /// proposed. If pictures or vectors reject a policy that they had accepted, the group has
    /// changed, and the rollout is judged as by [`Recogniser::assign`].
    ///
    /// # Errors
    /// Errors of [`Recogniser::assign`].
    pub fn review(
        &mut self,
        accounts: &[Account],
        situation: Situation,
        rng: &mut impl Rng,
    ) -> Result<Finding> {
        self.check_policy(situation.collector)?;
        let accounts = self.in_order(accounts)?;
        let role = if situation.is_provisional { Role::Provisional } else { Role::Returns };
        let mut case = Case { accounts: &accounts, situation };
        let mut finding = self.decide(case, role, rng)?;
        let keep = Decision::Existing(situation.collector);
        let mut cut = None;
        if finding.decision != keep {
            cut = self.find_cut(&accounts, rng)?;
        }
        if let Some(cut) = cut {
            case.accounts = &accounts[..cut];
            finding = self.decide(case, role, rng)?;
            finding.cut = Some(accounts[cut].began);
        }
        if finding.decision == keep {
            finding.is_provisional = situation.is_provisional;
            return Ok(finding);
        }
        if !situation.is_provisional && self.has_moved(&finding.opinions[situation.collector]) {
            case.accounts = &accounts[cut.unwrap_or(0)..];
            let mut found = self.start_over(case, cut.is_some(), rng)?;
            // trials could go on for ever in groups that change with every rollout
            if !situation.can_wait && found.trial != Trial::Waived {
                found.trial = Trial::None;
            }
            found.cut = cut.map(|cut| accounts[cut].began);
            return Ok(Finding { group_changed: true, ..found });
        }
        // no policy is tried twice for one task, or trials might never end
        finding.rejected.push(situation.collector);
        self.open(case, finding)
    }

    /// Decides on a rollout whose collector was proposed for another task group. In a short visit
    /// the named policy would act too late, so it trains on the rollout without a trial.
    fn start_over(&mut self, case: Case, is_cut: bool, rng: &mut impl Rng) -> Result<Finding> {
        let situation = Situation { rejected: &[], is_provisional: false, ..case.situation };
        let case = Case { situation, ..case };
        let finding = self.look(case, rng)?;
        match finding.decision {
            Decision::Existing(_) if !is_cut && finding.trial == Trial::Rollout => {
                Ok(Finding { trial: Trial::Waived, ..finding })
            }
            Decision::Existing(_) if !situation.can_wait => Ok(finding),
            _ => {
                let undecided = Finding { decision: Decision::Undecided, ..finding };
                self.look_again(case, undecided, rng)
            }
        }
    }

    /// Returns `true` if pictures or vectors reject a policy at the final level: its task group has
    /// changed.
    fn has_moved(&self, opinion: &Opinion) -> bool {
        self.examiner().against(opinion, self.settings.level).any(Kind::is_look)
    }

    /// Keeps an undecided rollout, or its latest `memory` episodes. The latest [`MOST_HELD`]
    /// rollouts are kept.
    fn hold(&mut self, case: Case) {
        while self.held.len() >= MOST_HELD {
            self.held.pop_front();
        }
        let first = case.accounts.len().saturating_sub(self.settings.memory);
        let accounts = case.accounts[first..].iter().copied().cloned().collect();
        self.held.push_back(Held { collector: case.situation.collector, accounts });
    }

    /// Removes and returns the kept undecided rollout that is most like the episodes of `case`, if
    /// it may be of the same task group; otherwise nothing.
    fn recall(&mut self, case: Case, rng: &mut impl Rng) -> Result<Vec<Account>> {
        let collector = case.situation.collector;
        let (mut own, mut best) = (ChaCha8Rng::seed_from_u64(rng.random()), None);
        for (index, held) in self.held.iter().enumerate() {
            let memory = Memory { accounts: held.accounts.clone().into(), ..Memory::default() };
            let role = if held.collector == collector { Role::Stays } else { Role::Stranger };
            let examiner = self.examiner();
            let opinion = examiner.opine(&memory, case.accounts, role, Look::First, &mut own)?;
            let score = opinion.look_score();
            let is_alike = opinion.test.as_ref().is_some_and(|test| test.overall.p_value >= ALIKE);
            if is_alike && best.is_none_or(|(_, least)| score < least) {
                best = Some((index, score));
            }
        }
        let Some(mut held) = best.and_then(|(index, _)| self.held.remove(index)) else {
            return Ok(Vec::new());
        };
        if held.collector != collector {
            held.accounts.iter_mut().for_each(Account::forget_course);
        }
        Ok(held.accounts)
    }

    /// Returns the probability of each policy's task group, from pictures and vectors of at least
    /// one episode, whichever policy acted.
    ///
    /// # Errors
    /// No episode, or episodes that cannot be compared.
    pub fn recognise(&self, accounts: &[Account], rng: &mut impl Rng) -> Result<Probabilities> {
        if accounts.is_empty() {
            return Err(EvidenceError::TooFewEpisodes { got: 0, needed: 1 });
        }
        let accounts: Vec<&Account> = accounts.iter().collect();
        // an index beyond all policies: none of them acted
        let situation = Situation::of(self.memories.len());
        let case = Case { accounts: &accounts, situation };
        let opinions = self.opinions(case, Look::Second, Role::Stranger, rng)?;
        let weighed = opinions.iter().zip(&self.memories).map(|(opinion, memory)| {
            let may_be_drift = !self.examiner().speaks_against(opinion, self.settings.doubt);
            let is_known = opinion.test.is_some() && !memory.is_gone();
            let own = if is_known { weight(opinion.tail_p_value(), may_be_drift) } else { 0.0 };
            (own, opinion.misfit())
        });
        Ok(Probabilities::new(weighed))
    }

    /// Returns the tester of policies.
    pub(crate) fn examiner(&self) -> Examiner<'_> {
        Examiner(&self.settings)
    }

    /// Checks that an acting policy's index is known, or that of the next new policy.
    fn check_actor(&self, policy: usize) -> Result<()> {
        if policy == self.memories.len() { Ok(()) } else { self.check_policy(policy) }
    }

    /// Checks that a policy index is known.
    pub(crate) fn check_policy(&self, policy: usize) -> Result<()> {
        let policies = self.memories.len();
        if policy < policies { Ok(()) } else { Err(EvidenceError::NoPolicy { policy, policies }) }
    }

    /// Sorts summaries by time, after checking that they are enough for a test.
    pub(crate) fn in_order<'a>(&self, accounts: &'a [Account]) -> Result<Vec<&'a Account>> {
        let (got, needed) = (accounts.len(), self.settings.min_episodes);
        if got < needed {
            return Err(EvidenceError::TooFewEpisodes { got, needed });
        }
        Ok(sorted(accounts))
    }

    /// Tests all policies in parallel: the acting one in the given role, the others as
    /// [`Role::Stranger`].
    fn opinions(
        &self,
        case: Case,
        look: Look,
        role: Role,
        rng: &mut impl Rng,
    ) -> Result<Vec<Opinion>> {
        // each policy has its own generator, so the result does not depend on threads
        let seeds: Vec<u64> = self.memories.iter().map(|_| rng.random()).collect();
        let Case { accounts, situation } = case;
        let asked = seeds.into_par_iter().enumerate().map(|(policy, seed)| {
            let role = if policy == situation.collector { role } else { Role::Stranger };
            let mut own = ChaCha8Rng::seed_from_u64(seed);
            let memory = &self.memories[policy];
            let mut opinion = self.examiner().opine(memory, accounts, role, look, &mut own)?;
            if situation.rejected.contains(&policy) {
                opinion.verdict = Verdict::Rejected;
            }
            Ok(opinion)
        });
        asked.collect()
    }

    /// Decides finally on the policy of two rollouts or of a trial.
    fn decide(&self, case: Case, role: Role, rng: &mut impl Rng) -> Result<Finding> {
        let Situation { collector, rejected, .. } = case.situation;
        let opinions = self.opinions(case, Look::Second, role, rng)?;
        let choice = Choice::new(&opinions, collector);
        let rivals = choice.rivals();
        let named = choice.kept().or_else(|| rivals.first().copied());
        let examiner = self.examiner();
        let (most, farthest) = (examiner.drifted(), examiner.farthest());
        // a policy that looks differ from is proposed if it did not act and was not tried before
        let may_have = |policy| policy != collector && !rejected.contains(&policy);
        let can_show = |policy: usize| examiner.has_proven_gain(&self.memories[policy]);
        let are_kin = |a: usize, b: usize| {
            self.memories[a].heir == Some(b) || self.memories[b].heir == Some(a)
        };
        let named = named.or_else(|| choice.drifted(most, farthest, may_have, can_show, are_kin));
        // merged policies stay eligible until they were tried
        let is_rejected = |&policy: &usize| {
            let is_tried = !self.memories[policy].is_gone() || rejected.contains(&policy);
            opinions[policy].is_rejected() && named != Some(policy) && is_tried
        };
        Ok(Finding {
            decision: named.map_or(Decision::New, Decision::Existing),
            cut: None,
            group_changed: false,
            rejected: (0..opinions.len()).filter(is_rejected).collect(),
            trial: Trial::of_policy(choice.is_alike(self.settings.doubt) || rivals.len() != 1),
            is_provisional: named.is_some_and(|policy| opinions[policy].is_rejected()),
            opinions,
        })
    }

    /// Returns the number of episodes, sorted by time, before a changepoint; `None` if there is
    /// none. Episodes that began together stay together.
    ///
    /// Only the latest summaries are tested, twice as many as a policy remembers, to bound the
    /// time.
    fn find_cut(&self, accounts: &[&Account], rng: &mut impl Rng) -> Result<Option<usize>> {
        let RecogniserSettings { memory, min_episodes, permutations, .. } = self.settings;
        let latest = &accounts[accounts.len().saturating_sub(2 * memory)..];
        let (kinds, seen) = match whole(latest, min_episodes) {
            Some(seen) => (Kind::ALL, seen),
            None => (Kind::LOOKS, latest.to_vec()),
        };
        let began: Vec<_> = seen.iter().map(|account| account.began).collect();
        let cuts = change_places(&began, min_episodes);
        if cuts.is_empty() {
            return Ok(None);
        }
        let all = kinds.iter().map(|&kind| frames(&seen, kind));
        let all = all.collect::<Result<Vec<_>>>()?;
        let test = change_test(&all, &cuts, ORDERS * permutations, rng)?;
        let start = seen[test.cut].began;
        let cut = accounts.partition_point(|account| account.began < start);
        Ok((test.p_value <= self.settings.cut).then_some(cut))
    }
}

/// Sorts summaries by the time at which their episodes began.
fn sorted(accounts: &[Account]) -> Vec<&Account> {
    let mut accounts: Vec<&Account> = accounts.iter().collect();
    accounts.sort_by_key(|account| account.began);
    accounts
}
