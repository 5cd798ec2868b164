//! Whose task new episodes show: the accounts of each policy, and decisions by them.

use std::collections::VecDeque;

use cluster::{
    Candidate, Decision, Evidence, Frames, JointTest, Judgement, PermutationTest, Side, Source,
    SourceTest, Verdict, joint_test,
};
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use serde::{Deserialize, Serialize};

use crate::account::Account;
use crate::cut::find_cut;
use crate::error::EvidenceError;
use crate::probability::Probabilities;
use crate::settings::RecogniserSettings;

/// Another policy takes over from one that acted and is accepted where it fits what is seen at the
/// beginning of episodes by so many standard deviations better,
const MARGIN: f64 = 3.0;
/// and where that has at most this probability for the one that acted. Groups that look alike, too,
/// differ by chance.
const UNLIKELY: f64 = 1e-3;

/// Standard deviations of looks that weigh as much as a motion that is another altogether, where
/// policies are ranked.
const MOTION_WEIGHT: f64 = 10.0;

/// A source of evidence.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    Picture,
    Vector,
    Motion,
    Earnings,
}

impl Kind {
    /// Whether it is there before anybody acts.
    fn is_look(self) -> bool {
        matches!(self, Self::Picture | Self::Vector)
    }

    fn point(self, account: &Account) -> Option<&[f32]> {
        match self {
            Self::Picture => Some(&account.picture),
            Self::Vector => Some(&account.vector),
            Self::Motion => account.motion.as_deref(),
            Self::Earnings => account.earned.as_ref().map(std::slice::from_ref),
        }
    }
}

/// What a policy is known by: the accounts of the latest episodes on which it learnt.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
struct Memory {
    accounts: VecDeque<Account>,
    /// Mean earnings of the first rollout on which it learnt.
    beginning: Option<f64>,
}

/// What speaks for and against one policy.
#[derive(Clone, Debug, PartialEq)]
pub struct Opinion {
    kinds: Vec<Kind>,
    test: Option<JointTest>,
    /// By how much motion changed, as a share, and which share of the earnings was lost.
    changed: f64,
    lost: f64,
    verdict: Verdict,
    /// Episodes that the policy remembers.
    remembered: usize,
}

impl Opinion {
    /// The test of all sources; none where the policy remembers too little.
    pub fn test(&self) -> Option<&JointTest> {
        self.test.as_ref()
    }

    /// The same in the words of the crate `cluster`: the distance of the first source that says
    /// something, and the test of the largest score.
    pub fn evidence(&self, settings: &RecogniserSettings, look: Look) -> Evidence {
        let distance = self
            .sources()
            .next()
            .map_or(0.0, |(_, source)| source.distance);
        let judgement = match &self.test {
            Some(test) => Judgement::Tested {
                test: PermutationTest {
                    distance: test.null.mean + test.score * test.null.sd,
                    null: test.null,
                    score: test.score,
                    p_value: test.p_value,
                    tail_p_value: self.tail_p_value(),
                },
                limit: match look {
                    Look::First => settings.doubt,
                    Look::Second => settings.level,
                },
            },
            None => Judgement::BufferTooSmall {
                episodes: self.remembered,
                needed: settings.min_episodes,
            },
        };
        Evidence {
            distance,
            judgement,
            verdict: self.verdict,
        }
    }

    /// The outcome.
    pub fn verdict(&self) -> Verdict {
        self.verdict
    }

    /// The smallest p-value by the fitted tail, adjusted for the number of sources; 1 where nothing
    /// was tested.
    pub fn tail_p_value(&self) -> f64 {
        let tests = self
            .test
            .iter()
            .flat_map(|test| test.sources.iter().flatten());
        tests.map(|source| source.tail_p_value).fold(1.0, f64::min)
    }

    /// The share of what the policy had learnt to earn that these episodes did not pay; zero where
    /// it was not asked.
    pub fn lost(&self) -> f64 {
        self.lost
    }

    pub(crate) fn is_refused(&self) -> bool {
        self.verdict == Verdict::Refused
    }

    /// The largest score of what is seen at the beginning of episodes. Policies that were not
    /// tested come last.
    fn look_score(&self) -> f64 {
        if self.test.is_none() {
            return f64::INFINITY;
        }
        let looks = self.sources().filter(|(kind, _)| kind.is_look());
        let scores = looks.map(|(_, source)| source.score);
        scores.fold(f64::NEG_INFINITY, f64::max)
    }

    /// How badly the policy fits: by looks, and among those that look alike by motion, which hardly
    /// depends on who acts.
    fn misfit(&self) -> f64 {
        self.look_score() + MOTION_WEIGHT * self.changed
    }

    /// Whether what is seen at the beginning of episodes speaks against the policy at this level.
    fn looks_doubtful(&self, level: f64) -> bool {
        self.sources()
            .any(|(kind, source)| kind.is_look() && source.p_value <= level)
    }

    /// The sources that say something.
    fn sources(&self) -> impl Iterator<Item = (Kind, &SourceTest)> {
        let tests = self.test.iter().flat_map(|test| &test.sources);
        let pairs = self.kinds.iter().zip(tests);
        pairs.filter_map(|(&kind, source)| Some((kind, source.as_ref()?)))
    }
}

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

/// How many rollouts a decision may rest on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Look {
    /// One: a doubt asks for another one.
    First,
    /// Two, or one that the policy in question collected itself: the decision is for good.
    Second,
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
    /// A deserialiser's.
    pub fn restore<'de, D: serde::Deserializer<'de>>(&mut self, state: D) -> Result<(), D::Error> {
        self.memories = Vec::deserialize(state)?;
        Ok(())
    }

    /// Tells that `policy` learns from episodes of its own; the next new policy has the number of
    /// those that are known. What shows another group than the first of these episodes is not
    /// remembered.
    ///
    /// # Errors
    /// A number beyond that, or points that cannot be compared.
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
        let mut accounts: Vec<&Account> = accounts.iter().collect();
        accounts.sort_by_key(|account| account.began);
        accounts.truncate(self.cut(&accounts, rng)?.unwrap_or(accounts.len()));
        let accounts = accounts.into_iter().cloned().collect::<Vec<_>>();
        if policy == policies {
            self.memories.push(Memory::default());
        }
        let memory = &mut self.memories[policy];
        memory.beginning = memory.beginning.or(mean_earned(accounts.iter()));
        memory.accounts.extend(accounts);
        let too_many = memory.accounts.len().saturating_sub(self.settings.memory);
        memory.accounts.drain(..too_many);
        Ok(())
    }

    /// Decides on one rollout of `situation.collector`. `Existing` of another policy asks for a
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
        let accounts = self.in_order(accounts)?;
        let cut = self.cut(&accounts, rng)?;
        Ok(Finding {
            cut: cut.map(|cut| accounts[cut].began),
            ..self.look(&accounts[cut.unwrap_or(0)..], collector, rng)?
        })
    }

    /// One first look.
    fn look<R: Rng + ?Sized>(
        &self,
        accounts: &[&Account],
        collector: usize,
        rng: &mut R,
    ) -> Result<Finding, EvidenceError> {
        let situation = Situation {
            collector,
            refused: &[],
        };
        let opinions = self.opinions(accounts, situation, Look::First, rng)?;
        Ok(Finding {
            decision: self.first_decision(&opinions, collector),
            opinions,
            cut: None,
            refused: Vec::new(),
        })
    }

    /// The number of accounts before a change of group, where both sides show enough episodes.
    fn cut<R: Rng + ?Sized>(
        &self,
        accounts: &[&Account],
        rng: &mut R,
    ) -> Result<Option<usize>, EvidenceError> {
        let settings = &self.settings;
        let cut = find_cut(accounts, settings.cut, settings.permutations, rng)?;
        let least = settings.min_episodes;
        Ok(cut.filter(|&cut| cut >= least && accounts.len() - cut >= least))
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
        let accounts = self.in_order(accounts)?;
        let cut = self.cut(&accounts, rng)?;
        let later = &accounts[cut.unwrap_or(0)..];
        let situation = Situation {
            collector,
            refused: &[],
        };
        let finding = self.decide(later, situation, rng)?;
        Ok(Finding {
            cut: cut.map(|_| later[0].began),
            ..finding
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
        let mut finding = self.decide(&accounts, situation, rng)?;
        let keep = Decision::Existing(situation.collector);
        if finding.decision != keep
            && let Some(cut) = self.cut(&accounts, rng)?
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
        Ok(Probabilities::of(&opinions))
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
        let mut opinion = Opinion {
            kinds: sources_of(accounts, &remembered, own),
            test: None,
            changed: changed(accounts, &remembered),
            lost: memory.lost(accounts),
            verdict: Verdict::Accepted,
            remembered: remembered.len(),
        };
        if remembered.len() < settings.min_episodes {
            return Ok(opinion);
        }
        let source = |&kind: &Kind| {
            let (rollout, buffer) = (frames(accounts, kind)?, frames(&remembered, kind)?);
            let side = match kind {
                Kind::Earnings => Side::Less,
                _ => Side::Both,
            };
            Ok(Source {
                clouds: Candidate { buffer, rollout },
                side,
            })
        };
        let sources = opinion.kinds.iter().map(source);
        let sources: Vec<Source> = sources.collect::<Result<_, EvidenceError>>()?;
        let permutations = match look {
            Look::First => settings.permutations,
            Look::Second => 4 * settings.permutations,
        };
        opinion.test = Some(joint_test(&sources, permutations, rng)?);
        opinion.verdict = self.verdict(&opinion, look);
        Ok(opinion)
    }

    /// The first look trusts the exact p-values, the second the tail's; a difference that speaks
    /// against a policy for good must be large as well, and one that only its course shows must be
    /// so from the beginning.
    fn verdict(&self, opinion: &Opinion, look: Look) -> Verdict {
        let settings = &self.settings;
        let mut against = opinion.sources().filter(|&(kind, source)| {
            let large = match kind {
                Kind::Picture | Kind::Vector => {
                    look == Look::First || source.ratio() >= settings.min_ratio
                }
                Kind::Motion => opinion.changed >= settings.min_motion,
                Kind::Earnings => opinion.lost >= settings.min_loss,
            };
            large
                && match look {
                    Look::First => source.p_value <= settings.doubt,
                    Look::Second => source.tail_p_value <= settings.level,
                }
        });
        match (against.next(), look) {
            (None, _) => Verdict::Accepted,
            (Some(_), Look::First) => Verdict::Doubted,
            (Some(_), Look::Second) => Verdict::Refused,
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

/// The accepted policy that fits best; the first of equals.
fn best(opinions: &[Opinion], eligible: impl Fn(usize) -> bool) -> Option<usize> {
    let accepted = (0..opinions.len())
        .filter(|&policy| opinions[policy].verdict == Verdict::Accepted && eligible(policy));
    let misfit = |policy: &usize| opinions[*policy].misfit();
    accepted.min_by(|a, b| misfit(a).total_cmp(&misfit(b)))
}

/// The policy that acted, unless another one fits much better.
fn keep_or(collector: usize, other: Option<usize>, opinions: &[Opinion]) -> usize {
    let own = &opinions[collector];
    let mut looks = own.sources().filter(|(kind, _)| kind.is_look());
    let is_unlikely = looks.any(|(_, source)| source.tail_p_value <= UNLIKELY);
    let better = |policy: &usize| opinions[*policy].look_score() + MARGIN < own.look_score();
    other
        .filter(|policy| is_unlikely && better(policy))
        .unwrap_or(collector)
}

impl Memory {
    /// The share of what was learnt to earn that `accounts` did not pay, at most 1 for those that
    /// pay what the first rollout paid.
    fn lost(&self, accounts: &[&Account]) -> f64 {
        let now = mean_earned(accounts.iter().copied());
        let home = mean_earned(self.accounts.iter());
        match (self.beginning, home, now) {
            (Some(beginning), Some(home), Some(now)) if home > beginning => {
                (home - now) / (home - beginning)
            }
            _ => 0.0,
        }
    }
}

/// By how much the mean motion of two lists differs, as a share of the second one's; zero where it
/// is not known.
fn changed(accounts: &[&Account], remembered: &[&Account]) -> f64 {
    match (mean_motion(accounts), mean_motion(remembered)) {
        (Some(now), Some(home)) if now.len() == home.len() => {
            let norm = |values: &mut dyn Iterator<Item = f64>| values.map(|v| v * v).sum::<f64>();
            let apart = norm(&mut now.iter().zip(&home).map(|(now, home)| now - home));
            (apart / norm(&mut home.iter().copied()).max(f64::MIN_POSITIVE)).sqrt()
        }
        _ => 0.0,
    }
}

fn mean_motion(accounts: &[&Account]) -> Option<Vec<f64>> {
    let known: Vec<&Vec<f32>> = accounts.iter().filter_map(|a| a.motion.as_ref()).collect();
    let mut mean = vec![0.0; known.first()?.len()];
    for motion in &known {
        for (sum, &entry) in mean.iter_mut().zip(motion.iter()) {
            *sum += f64::from(entry) / known.len() as f64;
        }
    }
    Some(mean)
}

fn mean_earned<'a>(accounts: impl Iterator<Item = &'a Account>) -> Option<f64> {
    let earned: Vec<f64> = accounts.filter_map(|a| a.earned.map(f64::from)).collect();
    (!earned.is_empty()).then(|| earned.iter().sum::<f64>() / earned.len() as f64)
}

/// The sources that all of these accounts have; courses count where both sides are of one policy.
pub(crate) fn sources_of(accounts: &[&Account], others: &[&Account], own: bool) -> Vec<Kind> {
    let whole = |account: &&Account| account.motion.is_some() && account.earned.is_some();
    match own && accounts.iter().chain(others).all(whole) {
        true => vec![Kind::Picture, Kind::Vector, Kind::Motion, Kind::Earnings],
        false => vec![Kind::Picture, Kind::Vector],
    }
}

/// The points of one source.
pub(crate) fn frames(accounts: &[&Account], kind: Kind) -> Result<Frames, EvidenceError> {
    let points: Vec<&[f32]> = accounts.iter().filter_map(|a| kind.point(a)).collect();
    let dim = points.first().map_or(0, |point| point.len());
    Ok(Frames::new(points.concat(), 1, dim)?)
}
