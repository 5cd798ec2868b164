//! Test of new episodes against the memory of one policy.

use cluster::{JointTest, SourceTest, Verdict, joint_test};
use rand_chacha::ChaCha8Rng;

use crate::account::Account;
use crate::error::Result;
use crate::memory::Memory;
use crate::opinion::{Kind, Look, Opinion, Role, SURE, changed, is_doubtful, sources, whole};
use crate::settings::RecogniserSettings;

/// Number of random splits, including the observed one, that must reach the observed score to end a
/// permutation test early.
// Stopping insignificant tests does not raise the rate of false alarms (Besag and Clifford, 1991).
const REACHING: f64 = 8.0;

/// Increase of the significance level of returns, as a multiple of it, for a policy that lost its
/// whole gain in return.
const MOST_WEIGHT: f64 = 30.0;
/// Least rise of a policy's return since its first rollout that counts as a gain, in standard
/// deviations of the return.
const MIN_GAIN: f64 = 1.0;
/// Least rise of a policy's return by which returns prove that the policy serves a task group, in
/// standard deviations of the return.
const PROVEN_GAIN: f64 = 3.0;
/// Largest loss of a policy that is proven by its returns, as a share of `min_loss`: a tenth of its
/// gain in return with the default of 0.3.
const MAX_LOSS: f64 = 1.0 / 3.0;
/// Factor on `min_ratio - 1` for a policy that acts again after a time without training: drift may
/// have changed its task group meanwhile.
// With the default of 1.2 the limit is 1.5: within it lie 19 of 20 groups whose colours drifted by
// a tenth of their range, and one of 100 other groups (docs/assignment_figures.md).
const DRIFTED: f64 = 2.5;
/// Factor on `min_ratio - 1` for a policy that is far nearer than all others: the limit is 1.8 with
/// the default of 1.2.
const FARTHEST: f64 = 4.0;
/// Least ratio of the distance of motion or slope to its mean over random splits: both change in
/// training.
const LEAST_RATIO: f64 = 2.0;

/// Tester of policies by permutation tests, with the settings of the recogniser.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Examiner<'a>(pub(crate) &'a RecogniserSettings);

impl Examiner<'_> {
    /// Tests the episodes `accounts` against those that one policy remembers; `role` says how the
    /// policy relates to the tested episodes.
    pub(crate) fn opine(
        self,
        memory: &Memory,
        accounts: &[&Account],
        role: Role,
        look: Look,
        rng: &mut ChaCha8Rng,
    ) -> Result<Opinion> {
        let least = self.0.min_episodes;
        let remembered: Vec<&Account> = memory.accounts.iter().collect();
        // motion and returns depend on who acts, so they count only if this policy acted
        let courses = whole(accounts, least).zip(whole(&memory.home(), least));
        let (kinds, seen, home) = match courses.filter(|_| role != Role::Stranger) {
            Some((seen, home)) => (Kind::ALL, seen, home),
            None => (Kind::LOOKS, accounts.to_vec(), remembered.clone()),
        };
        // a merged policy is rejected unless it acted itself
        let is_out = memory.is_gone() && role == Role::Stranger;
        let mut opinion = Opinion {
            verdict: if is_out { Verdict::Rejected } else { Verdict::Accepted },
            test: None,
            kinds,
            changed: changed(accounts, &remembered, Kind::Motion),
            turned: changed(accounts, &remembered, Kind::Slope),
            lost: memory.lost(accounts),
            lost_error: memory.lost_error(accounts),
            gain: memory.gain(),
            episode_gain: memory.gain_of(accounts),
            role,
        };
        // a first look cannot change a rejection; a second one ranks rejected policies by distance
        if remembered.len() < least || (is_out && look == Look::First) {
            return Ok(opinion);
        }
        let sources = sources(kinds, &seen, &home)?;
        let all = self.0.permutations;
        let stages = [all / 4, all / 2, all, 3 * all];
        let stages = if look == Look::First { &stages[..3] } else { &stages[..] };
        let decided = |test: &JointTest| self.is_decided(&opinion, test, look);
        let test = joint_test(&sources, stages, decided, rng)?;
        opinion.test = Some(test);
        if !is_out {
            opinion.verdict = self.verdict(&opinion, look);
        }
        Ok(opinion)
    }

    /// Returns `true` if more random splits would not change the outcome of a test: enough of them
    /// reach the largest score, or a difference that counts is far more significant than the level
    /// requires.
    fn is_decided(self, opinion: &Opinion, test: &JointTest, look: Look) -> bool {
        let reaching = test.overall.p_value * (1 + test.overall.null.permutations) as f64;
        let limit = SURE * self.level(look);
        let is_sure = |(kind, source): (Kind, &SourceTest)| {
            source.tail_p_value <= limit && self.counts(opinion, look, kind, source)
        };
        // `reaching` is a whole number but for rounding, hence the half
        reaching > REACHING - 0.5 || opinion.sources_of(test).any(is_sure)
    }

    fn level(self, look: Look) -> f64 {
        match look {
            Look::First => self.0.doubt,
            Look::Second => self.0.level,
        }
    }

    /// Returns the verdict on a policy after a finished test. The first look uses exact p-values,
    /// the second those of the fitted tail, because its level is finer than the number of splits
    /// resolves.
    fn verdict(self, opinion: &Opinion, look: Look) -> Verdict {
        let level = self.level(look);
        let mut against = opinion.sources().filter(|&(kind, source)| match look {
            Look::First => is_doubtful(source, level),
            Look::Second => source.tail_p_value <= level * self.weight(opinion, kind),
        });
        let is_against = against.any(|(kind, source)| self.counts(opinion, look, kind, source))
            || (opinion.role == Role::Provisional && !self.may_keep(opinion));
        match (is_against, look) {
            (false, _) => Verdict::Accepted,
            (true, Look::First) => Verdict::Doubted,
            (true, Look::Second) => Verdict::Rejected,
        }
    }

    /// Returns `true` if a significant difference of one source counts against a policy. It must be
    /// large, except for pictures and vectors at the first look, which only asks for more data.
    fn counts(self, opinion: &Opinion, look: Look, kind: Kind, source: &SourceTest) -> bool {
        (look == Look::First && kind.is_look()) || self.is_large(opinion, kind, source)
    }

    /// Returns the least distance ratio at which pictures and vectors reject a policy. It is larger
    /// for a policy that returns and proves by its returns that it serves the group, or has gained
    /// too little to prove anything.
    fn least_ratio(self, opinion: &Opinion) -> f64 {
        let cannot_show = opinion.kinds.contains(&Kind::Earnings) && opinion.gain < PROVEN_GAIN;
        let may_serve = self.is_proven(opinion) || cannot_show;
        match opinion.role {
            Role::Returns if may_serve => self.drifted(),
            Role::Provisional if may_serve => self.farthest(),
            _ => self.0.min_ratio,
        }
    }

    /// Returns the largest distance ratio that counts as drift while a policy was away.
    pub(crate) fn drifted(self) -> f64 {
        1.0 + DRIFTED * (self.0.min_ratio - 1.0)
    }

    /// Returns the largest distance ratio that counts as drift if all other policies are far away.
    pub(crate) fn farthest(self) -> f64 {
        1.0 + FARTHEST * (self.0.min_ratio - 1.0)
    }

    /// Returns the factor on the significance level of a source: for returns it rises from 1 to 31
    /// with the lost share of the gain, for other sources it is 1.
    fn weight(self, opinion: &Opinion, kind: Kind) -> f64 {
        let least = self.0.min_loss;
        let share = (opinion.lost - least) / (1.0 - least).max(f64::MIN_POSITIVE);
        match kind {
            Kind::Earnings => 1.0 + MOST_WEIGHT * share.clamp(0.0, 1.0),
            _ => 1.0,
        }
    }

    /// Returns `true` if the returns of the tested episodes prove that the policy serves their task
    /// group as well as its own.
    pub(crate) fn is_proven(self, opinion: &Opinion) -> bool {
        self.keeps(opinion) && opinion.episode_gain >= PROVEN_GAIN
    }

    /// Returns `true` if the policy earned about as much in the tested episodes as in the ones that
    /// it remembers.
    pub(crate) fn keeps(self, opinion: &Opinion) -> bool {
        opinion.kinds.contains(&Kind::Earnings) && !self.is_loss(opinion.lost)
    }

    /// Returns `true` if the policy may earn as much in the tested episodes as in its remembered
    /// ones, within one standard error. A policy whose pictures or vectors differ must pass this
    /// check: that a few episodes of its own do not reject it again proves nothing.
    fn may_keep(self, opinion: &Opinion) -> bool {
        opinion.kinds.contains(&Kind::Earnings) && !self.is_loss(opinion.lost - opinion.lost_error)
    }

    /// Returns `true` if a policy that loses the share `lost` of its gain in return no longer
    /// serves the task group.
    pub(crate) fn is_loss(self, lost: f64) -> bool {
        lost > MAX_LOSS * self.0.min_loss
    }

    /// Returns `true` if the policy's return has risen so much in training that a loss would show
    /// in its returns.
    pub(crate) fn has_proven_gain(self, memory: &Memory) -> bool {
        memory.gain() >= PROVEN_GAIN
    }

    /// Returns `true` if the policy's return has risen in training at all, so that its loss in
    /// another task group could show.
    pub(crate) fn has_gain(self, memory: &Memory) -> bool {
        memory.gain() >= MIN_GAIN
    }

    /// Returns `true` if a difference is larger than drift or training explains, whatever its
    /// significance.
    pub(crate) fn is_large(self, opinion: &Opinion, kind: Kind, source: &SourceTest) -> bool {
        match kind {
            Kind::Picture | Kind::Vector => source.ratio() >= self.least_ratio(opinion),
            Kind::Motion => opinion.changed >= self.0.min_motion && source.ratio() >= LEAST_RATIO,
            // a policy with a proven gain is judged by its returns instead
            Kind::Slope => {
                let has_turned = opinion.turned >= self.0.min_motion;
                opinion.gain < PROVEN_GAIN && has_turned && source.ratio() >= LEAST_RATIO
            }
            Kind::Earnings => opinion.lost >= self.0.min_loss,
        }
    }

    /// Returns `true` if one rollout is enough to reject a policy for good.
    pub(crate) fn surely_rejects(self, opinion: &Opinion) -> bool {
        self.speaks_against(opinion, SURE * self.0.level)
    }

    /// Returns `true` if a source shows a difference that is large, and significant at the level
    /// `level`.
    pub(crate) fn speaks_against(self, opinion: &Opinion, level: f64) -> bool {
        self.against(opinion, level).next().is_some()
    }

    /// Returns the sources with a difference that is large, and significant at the level `level`.
    pub(crate) fn against(self, opinion: &Opinion, level: f64) -> impl Iterator<Item = Kind> {
        let against = opinion.sources().filter(move |(_, source)| source.tail_p_value <= level);
        let large = against.filter(move |&(kind, source)| self.is_large(opinion, kind, source));
        large.map(|(kind, _)| kind)
    }
}
