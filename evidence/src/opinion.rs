//! What speaks for and against one policy: the sources of evidence and their test.

use std::fmt;

use cluster::{
    Candidate, Evidence, Frames, JointTest, Judgement, PermutationTest, Side, Source, SourceTest,
    Verdict,
};

use crate::account::Account;
use crate::error::EvidenceError;
use crate::settings::RecogniserSettings;

/// Standard deviations of looks that weigh as much as a motion that is another altogether, where
/// policies are ranked.
const MOTION_WEIGHT: f64 = 10.0;

/// A source of evidence.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Kind {
    Picture,
    Vector,
    Motion,
    Slope,
    Earnings,
}

impl Kind {
    /// What is there before anybody acts.
    pub(crate) const LOOKS: [Self; 2] = [Self::Picture, Self::Vector];
    pub(crate) const ALL: [Self; 5] =
        [Self::Picture, Self::Vector, Self::Motion, Self::Slope, Self::Earnings];

    /// Whether it is there before anybody acts.
    pub(crate) fn is_look(self) -> bool {
        matches!(self, Self::Picture | Self::Vector)
    }

    pub(crate) fn name(self) -> &'static str {
        match self {
            Self::Picture => "picture",
            Self::Vector => "vector",
            Self::Motion => "motion",
            Self::Slope => "slope",
            Self::Earnings => "earnings",
        }
    }

    pub(crate) fn point(self, account: &Account) -> Option<&[f32]> {
        match self {
            Self::Picture => Some(&account.picture),
            Self::Vector => Some(&account.vector),
            Self::Motion => account.motion.as_deref(),
            Self::Slope => account.slope.as_deref(),
            Self::Earnings => account.earned.as_ref().map(std::slice::from_ref),
        }
    }
}

/// How many rollouts a decision may rest on.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Look {
    /// One: a doubt asks for another one.
    First,
    /// Two, or one that the policy in question collected itself: the decision is for good.
    Second,
}

/// What a policy had to do with the episodes at hand.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) enum Role {
    /// Nothing: another one acted.
    Stranger,
    /// It acted, and goes on from where it learnt last.
    Stays,
    /// It acted after it had been away: its group may have drifted meanwhile.
    Returns,
    /// The same, though looks spoke against it: it must show that it serves, as far as it has
    /// learnt.
    Excused,
}

/// What speaks for and against one policy.
#[derive(Clone, Debug, PartialEq)]
pub struct Opinion {
    pub(crate) kinds: Vec<Kind>,
    pub(crate) test: Option<JointTest>,
    /// By how much motion changed, as a share, and which share of the earnings was lost.
    pub(crate) changed: f64,
    /// By how much the way that pays changed.
    pub(crate) turned: f64,
    pub(crate) lost: f64,
    /// The standard error of that share.
    pub(crate) lost_error: f64,
    /// What the policy has learnt to earn, in standard deviations of what it earns.
    pub(crate) learnt: f64,
    /// How much more these episodes earned than its first ones did, in their standard deviations.
    pub(crate) gained: f64,
    pub(crate) role: Role,
    pub(crate) verdict: Verdict,
    /// Episodes that the policy remembers.
    pub(crate) remembered: usize,
}

impl Opinion {
    /// The test of all sources; none where the policy remembers too little.
    pub fn test(&self) -> Option<&JointTest> {
        self.test.as_ref()
    }

    /// The same in the words of the crate `cluster`: the distance of the first source that says
    /// something, and the test of the largest score.
    pub fn evidence(&self, settings: &RecogniserSettings, look: Look) -> Evidence {
        let distance = self.sources().next().map_or(0.0, |(_, source)| source.distance);
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
        Evidence { distance, judgement, verdict: self.verdict }
    }

    /// The outcome.
    pub fn verdict(&self) -> Verdict {
        self.verdict
    }

    /// The smallest p-value by the fitted tail, adjusted for the number of sources; 1 where nothing
    /// was tested.
    pub fn tail_p_value(&self) -> f64 {
        let tests = self.test.iter().flat_map(|test| test.sources.iter().flatten());
        tests.map(|source| source.tail_p_value).fold(1.0, f64::min)
    }

    /// By how much motion changed, as a share; zero where it is not known.
    pub fn changed(&self) -> f64 {
        self.changed
    }

    pub(crate) fn is_refused(&self) -> bool {
        self.verdict == Verdict::Refused
    }

    /// The largest score of what is seen at the beginning of episodes. Policies that were not
    /// tested come last.
    pub(crate) fn look_score(&self) -> f64 {
        if self.test.is_none() {
            return f64::INFINITY;
        }
        let looks = self.sources().filter(|(kind, _)| kind.is_look());
        let scores = looks.map(|(_, source)| source.score);
        scores.fold(f64::NEG_INFINITY, f64::max)
    }

    /// The largest ratio of a distance of looks to what chance makes of it.
    pub fn look_ratio(&self) -> f64 {
        let looks = self.sources().filter(|(kind, _)| kind.is_look());
        looks.map(|(_, source)| source.ratio()).fold(0.0, f64::max)
    }

    /// How badly the policy fits: by looks, and among those that look alike by motion, which hardly
    /// depends on who acts.
    pub(crate) fn misfit(&self) -> f64 {
        self.look_score() + MOTION_WEIGHT * self.changed
    }

    /// Whether what is seen at the beginning of episodes speaks against the policy at this level.
    pub(crate) fn looks_doubtful(&self, level: f64) -> bool {
        self.sources().any(|(kind, source)| kind.is_look() && is_doubtful(source, level))
    }

    /// The sources that say something.
    pub(crate) fn sources(&self) -> impl Iterator<Item = (Kind, &SourceTest)> {
        self.test.iter().flat_map(|test| self.sources_of(test))
    }

    /// The same in a test that is not finished.
    pub(crate) fn sources_of<'a>(
        &'a self,
        test: &'a JointTest,
    ) -> impl Iterator<Item = (Kind, &'a SourceTest)> {
        let pairs = self.kinds.iter().zip(&test.sources);
        pairs.filter_map(|(&kind, source)| Some((kind, source.as_ref()?)))
    }
}

/// What decides, in one line.
impl fmt::Display for Opinion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "{:?}", self.verdict)?;
        for (kind, source) in self.sources() {
            let (name, tail) = (kind.name(), source.tail_p_value);
            write!(f, " {name} {:.1} ({:.2}, p {tail:.0e})", source.score, source.ratio())?;
        }
        let (changed, lost, learnt) = (self.changed, self.lost, self.learnt);
        let (gained, turned) = (self.gained, self.turned);
        write!(
            f,
            " changed {changed:.2} turned {turned:.2} lost {lost:.2} learnt {learnt:.1} gained {gained:.1}"
        )
    }
}

/// A difference ends a test once its p-value by the tail is this share of the level.
pub(crate) const SURE: f64 = 1e-3;

/// Whether a source shows a difference at this level: by its exact p-value, or surely by its tail,
/// where the test ended before exact p-values were fine enough.
pub(crate) fn is_doubtful(source: &SourceTest, level: f64) -> bool {
    source.p_value <= level || source.tail_p_value <= SURE * level
}

/// By how much the means of two lists differ, as a share of the second one's; zero where it
/// is not known.
pub(crate) fn changed(accounts: &[&Account], remembered: &[&Account], kind: Kind) -> f64 {
    match (mean_of(accounts, kind), mean_of(remembered, kind)) {
        (Some(now), Some(home)) if now.len() == home.len() => {
            let norm = |values: &mut dyn Iterator<Item = f64>| values.map(|v| v * v).sum::<f64>();
            let apart = norm(&mut now.iter().zip(&home).map(|(now, home)| now - home));
            (apart / norm(&mut home.iter().copied()).max(f64::MIN_POSITIVE)).sqrt()
        }
        _ => 0.0,
    }
}

fn mean_of(accounts: &[&Account], kind: Kind) -> Option<Vec<f64>> {
    let known: Vec<&[f32]> = accounts.iter().filter_map(|a| kind.point(a)).collect();
    let mut mean = vec![0.0; known.first()?.len()];
    for motion in &known {
        for (sum, &entry) in mean.iter_mut().zip(motion.iter()) {
            *sum += f64::from(entry) / known.len() as f64;
        }
    }
    Some(mean)
}

pub(crate) fn mean_earned<'a>(accounts: impl Iterator<Item = &'a Account>) -> Option<f64> {
    let earned: Vec<f64> = accounts.filter_map(|a| a.earned.map(f64::from)).collect();
    (!earned.is_empty()).then(|| earned.iter().sum::<f64>() / earned.len() as f64)
}

/// The accounts of whole episodes: every source needs the same ones. None where they are fewer than
/// `least` or than half, so that looks alone, of all accounts, say more.
pub(crate) fn whole<'a>(accounts: &[&'a Account], least: usize) -> Option<Vec<&'a Account>> {
    let is_whole = |account: &&&Account| account.motion.is_some() && account.earned.is_some();
    let whole: Vec<&Account> = accounts.iter().filter(is_whole).copied().collect();
    (whole.len() >= least && 2 * whole.len() >= accounts.len()).then_some(whole)
}

/// The points of one source.
pub(crate) fn frames(accounts: &[&Account], kind: Kind) -> Result<Frames, EvidenceError> {
    let points: Vec<&[f32]> = accounts.iter().filter_map(|a| kind.point(a)).collect();
    let dim = points.first().map_or(0, |point| point.len());
    Ok(Frames::new(points.concat(), 1, dim)?)
}

/// What each kind says of a rollout, and of what is remembered.
pub(crate) fn sources(
    kinds: &[Kind],
    rollout: &[&Account],
    remembered: &[&Account],
) -> Result<Vec<Source>, EvidenceError> {
    let source = |&kind: &Kind| {
        let (rollout, buffer) = (frames(rollout, kind)?, frames(remembered, kind)?);
        let side = match kind {
            Kind::Earnings => Side::Less,
            _ => Side::Both,
        };
        Ok(Source { clouds: Candidate { buffer, rollout }, side })
    };
    kinds.iter().map(source).collect()
}
