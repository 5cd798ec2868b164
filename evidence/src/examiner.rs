//! Asks one policy's memory about new episodes.

use cluster::{JointTest, SourceTest, Verdict, joint_test_until};
use rand_chacha::ChaCha8Rng;

use crate::account::Account;
use crate::error::EvidenceError;
use crate::memory::Memory;
use crate::opinion::{Kind, Look, Opinion, Role, SURE, changed, is_doubtful, sources, whole};
use crate::settings::RecogniserSettings;

/// So many splits, the one at hand included, that reach the largest score end a test: nothing will
/// come of it.
const REACHING: f64 = 8.0;

/// How much weaker than the level evidence may be of a policy that lost all that it had learnt.
const MOST_WEIGHT: f64 = 30.0;
/// A policy that earns so many standard deviations more than when it began has learnt something.
const LEARNT: f64 = 1.0;
/// One that earns so many more, and lost at most the following share of the least loss that counts,
/// serves where it is.
const PROOF: f64 = 3.0;
const FEW: f64 = 1.0 / 3.0;
/// Where a policy returns and serves, distances of looks may exceed those of chance by so many times
/// as much as elsewhere.
const EXCUSED: f64 = 2.5;
/// The same for one that looks spoke against when it was named.
const FARTHEST: f64 = 4.0;
/// Motion and the way that pays change while a policy learns. They count where their distance is so
/// many times what chance makes of it.
const LEAST_RATIO: f64 = 2.0;

/// Tests with settings.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Examiner<'a>(pub(crate) &'a RecogniserSettings);

impl Examiner<'_> {
    /// What speaks for and against a policy of this memory.
    pub(crate) fn opine(
        self,
        memory: &Memory,
        accounts: &[&Account],
        role: Role,
        look: Look,
        rng: &mut ChaCha8Rng,
    ) -> Result<Opinion, EvidenceError> {
        let least = self.0.min_episodes;
        let remembered: Vec<&Account> = memory.accounts.iter().collect();
        // courses count where both sides are of one policy
        let courses = whole(accounts, least).zip(whole(&memory.home(), least));
        let (kinds, seen, home) = match courses.filter(|_| role != Role::Stranger) {
            Some((seen, home)) => (Kind::ALL.to_vec(), seen, home),
            None => (Kind::LOOKS.to_vec(), accounts.to_vec(), remembered.clone()),
        };
        let mut opinion = untested(memory, accounts, kinds, role);
        let is_out = opinion.is_refused();
        if remembered.len() < least || (is_out && look == Look::First) {
            return Ok(opinion);
        }
        let sources = sources(&opinion.kinds, &seen, &home)?;
        let stages = self.stages(look);
        let decided = |test: &JointTest| self.is_decided(&opinion, test, look);
        let test = joint_test_until(&sources, &stages, decided, rng)?;
        opinion.test = Some(test);
        if !is_out {
            opinion.verdict = self.verdict(&opinion, look);
        }
        Ok(opinion)
    }

    /// Numbers of random splits after which a test may end.
    fn stages(self, look: Look) -> Vec<usize> {
        let all = self.0.permutations;
        match look {
            Look::First => vec![all / 4, all / 2, all],
            Look::Second => vec![all / 4, all / 2, all, 3 * all],
        }
    }

    /// Whether more splits would change nothing: enough of them reach the largest score, or a
    /// difference that counts is surer than any level asks for.
    fn is_decided(self, opinion: &Opinion, test: &JointTest, look: Look) -> bool {
        let reaching = test.p_value * (1 + test.null.permutations) as f64;
        let limit = SURE * self.level(look);
        let is_sure = |(kind, source): (Kind, &SourceTest)| {
            source.tail_p_value <= limit && self.counts(opinion, look, kind, source)
        };
        reaching > REACHING - 0.5 || opinion.sources_of(test).any(is_sure)
    }

    fn level(self, look: Look) -> f64 {
        match look {
            Look::First => self.0.doubt,
            Look::Second => self.0.level,
        }
    }

    /// The first look trusts the exact p-values, the second the tail's.
    fn verdict(self, opinion: &Opinion, look: Look) -> Verdict {
        let level = self.level(look);
        let mut against = opinion.sources().filter(|&(kind, source)| match look {
            Look::First => is_doubtful(source, level),
            Look::Second => source.tail_p_value <= level * self.weight(opinion, kind),
        });
        let is_against = against.any(|(kind, source)| self.counts(opinion, look, kind, source))
            || (opinion.role == Role::Excused && !self.may_keep(opinion));
        match (is_against, look) {
            (false, _) => Verdict::Accepted,
            (true, Look::First) => Verdict::Doubted,
            (true, Look::Second) => Verdict::Refused,
        }
    }

    /// Whether a difference counts at all: one that speaks against a policy for good must be large,
    /// and one that only its course shows must be so from the beginning.
    fn counts(self, opinion: &Opinion, look: Look, kind: Kind, source: &SourceTest) -> bool {
        (look == Look::First && kind.is_look()) || self.is_large(opinion, kind, source)
    }

    /// From which ratio on looks speak against a policy: a larger one where it returns and shows
    /// that it serves where it is, or has learnt too little to show anything.
    fn least_ratio(self, opinion: &Opinion) -> f64 {
        let cannot_show = opinion.kinds.contains(&Kind::Earnings) && opinion.learnt < PROOF;
        let may_serve = self.is_proven(opinion) || cannot_show;
        match opinion.role {
            Role::Returns if may_serve => self.drifted(),
            Role::Excused if may_serve => self.farthest(),
            _ => self.0.min_ratio,
        }
    }

    /// The largest ratio that drift may have caused while a policy was away.
    pub(crate) fn drifted(self) -> f64 {
        1.0 + EXCUSED * (self.0.min_ratio - 1.0)
    }

    /// The same for one that is by far the nearest.
    pub(crate) fn farthest(self) -> f64 {
        1.0 + FARTHEST * (self.0.min_ratio - 1.0)
    }

    /// How much weaker the evidence may be: the more of the earnings is lost, the less it takes.
    fn weight(self, opinion: &Opinion, kind: Kind) -> f64 {
        let least = self.0.min_loss;
        let share = (opinion.lost - least) / (1.0 - least).max(f64::MIN_POSITIVE);
        match kind {
            Kind::Earnings => 1.0 + MOST_WEIGHT * share.clamp(0.0, 1.0),
            _ => 1.0,
        }
    }

    /// Whether a policy has shown in these episodes that it serves them as it serves its own.
    pub(crate) fn is_proven(self, opinion: &Opinion) -> bool {
        self.keeps(opinion) && opinion.gained >= PROOF
    }

    /// Whether a policy earned in these episodes about what it earns at home.
    pub(crate) fn keeps(self, opinion: &Opinion) -> bool {
        opinion.kinds.contains(&Kind::Earnings) && !self.is_loss(opinion.lost)
    }

    /// Whether a policy may earn that, as far as these episodes tell. Looks that spoke against it
    /// stand: that few episodes of its own do not speak against it once more is no proof.
    fn may_keep(self, opinion: &Opinion) -> bool {
        opinion.kinds.contains(&Kind::Earnings) && !self.is_loss(opinion.lost - opinion.lost_error)
    }

    /// Whether a share of what was learnt to earn is so large that a policy that loses it serves no
    /// more.
    pub(crate) fn is_loss(self, lost: f64) -> bool {
        lost > FEW * self.0.min_loss
    }

    /// Whether a policy has learnt so much that it would notice a loss.
    pub(crate) fn knows(self, memory: &Memory) -> bool {
        memory.learnt() >= PROOF
    }

    /// Whether a policy has learnt anything that it could show elsewhere.
    pub(crate) fn has_learnt(self, memory: &Memory) -> bool {
        memory.learnt() >= LEARNT
    }

    /// Whether a difference is more than drift. What looks another is drift up to a larger
    /// difference where the policy has shown that it serves there, or cannot show anything.
    fn is_large(self, opinion: &Opinion, kind: Kind, source: &SourceTest) -> bool {
        match kind {
            Kind::Picture | Kind::Vector => source.ratio() >= self.least_ratio(opinion),
            Kind::Motion => opinion.changed >= self.0.min_motion && source.ratio() >= LEAST_RATIO,
            // one that has learnt is known by what it earns
            Kind::Slope => {
                let has_turned = opinion.turned >= self.0.min_motion;
                opinion.learnt < PROOF && has_turned && source.ratio() >= LEAST_RATIO
            }
            Kind::Earnings => opinion.lost >= self.0.min_loss,
        }
    }

    /// Whether one rollout is enough to refuse a policy.
    pub(crate) fn surely_refuses(self, opinion: &Opinion) -> bool {
        self.speaks_against(opinion, SURE * self.0.level)
    }

    /// Whether a source shows a difference that is large, and significant at this level.
    pub(crate) fn speaks_against(self, opinion: &Opinion, level: f64) -> bool {
        let mut against = opinion.sources().filter(|(_, s)| s.tail_p_value <= level);
        against.any(|(kind, source)| self.is_large(opinion, kind, source))
    }
}

/// What is known before a test. A policy that has an heir is refused, unless it acted itself to
/// show that it serves.
fn untested(memory: &Memory, accounts: &[&Account], kinds: Vec<Kind>, role: Role) -> Opinion {
    let remembered: Vec<&Account> = memory.accounts.iter().collect();
    Opinion {
        kinds,
        test: None,
        changed: changed(accounts, &remembered, Kind::Motion),
        turned: changed(accounts, &remembered, Kind::Slope),
        lost: memory.lost(accounts),
        lost_error: memory.lost_error(accounts),
        learnt: memory.learnt(),
        gained: memory.gained(accounts),
        role,
        verdict: if memory.is_gone() && role == Role::Stranger {
            Verdict::Refused
        } else {
            Verdict::Accepted
        },
        remembered: remembered.len(),
    }
}
