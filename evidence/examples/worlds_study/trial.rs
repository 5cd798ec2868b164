//! One world: a stream of visits, and a learner without networks that assigns them.

use std::time::{Duration, Instant};

use cluster::Decision;
use evidence::{
    Account, Accountant, EvidenceError, Finding, Look, Recogniser, RecogniserSettings, Situation,
};
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rl::{BoxError, Observations, VectorEnv};
use worlds::{Stream, Visit, World, WorldError};

use crate::arguments::Plan;
use crate::rollout::roll_out;
use crate::stand_in::StandIn;

pub const ENVS: usize = 5;
/// Rounds of a rollout: 20 episodes.
pub const ROUNDS: usize = 4;
pub const HORIZON: usize = 20;
/// Visits of each group, where nobody says how many there are in all.
const VISITS: usize = 2;

/// What can go wrong.
#[derive(Debug, thiserror::Error)]
pub enum TrialError {
    #[error(
        "`{0}` is none of: FIRST, COUNT, KIND, --visits N, --stay A-B, --alarms, --csv FILE, \
         --explain"
    )]
    Argument(String),
    #[error(transparent)]
    Evidence(#[from] EvidenceError),
    #[error(transparent)]
    World(#[from] WorldError),
    #[error("the environments: {0}")]
    Environment(BoxError),
    #[error("the results: {0}")]
    Results(#[from] std::io::Error),
}

/// What came of one turn.
#[derive(Clone, Copy, Debug)]
pub struct Turn {
    /// The group of the last round that was learnt from.
    pub group: usize,
    pub policy: usize,
    pub rounds: usize,
    /// Whether the group was met in an earlier visit.
    pub is_known: bool,
    /// Whether the first rollout was cut at the round in which its group changed, if it did.
    pub is_cut: Option<bool>,
    /// The number of the last round that was learnt from.
    pub last: usize,
    /// The group of each round that was learnt from.
    pub learnt: [Option<usize>; ROUNDS],
}

/// What came of one world.
#[derive(Clone, Debug, Default)]
pub struct Outcome {
    pub distinct: usize,
    pub policies: usize,
    pub turns: Vec<Turn>,
    /// For each policy the one that acts for its group since the two were merged.
    pub heirs: Vec<Option<usize>>,
    /// Time of the decisions of one turn.
    pub slowest: Duration,
    /// Size of the recogniser's state as text.
    pub state: usize,
    pub log: Vec<String>,
}

impl Outcome {
    /// The policy that a policy is since merges.
    pub fn now(&self, policy: usize) -> usize {
        let heir = |&policy: &usize| self.heirs.get(policy).copied().flatten();
        let heirs = std::iter::successors(Some(policy), heir);
        heirs.last().unwrap_or(policy)
    }

    /// The number of policies that were merged into others.
    pub fn merged(&self) -> usize {
        self.heirs.iter().flatten().count()
    }

    /// The number of policies that are left.
    pub fn left(&self) -> usize {
        self.policies - self.merged()
    }
}

/// A world under way.
pub struct Trial {
    stream: Stream,
    rounds: usize,
    alarms: bool,
    recogniser: Recogniser,
    accountant: Accountant,
    policies: Vec<StandIn>,
    current: usize,
    rng: ChaCha8Rng,
    now: Observations,
    deciding: Duration,
    outcome: Outcome,
}

impl Trial {
    /// Draws visits and starts.
    pub fn of(world: World, plan: &Plan) -> Result<Self, TrialError> {
        let mut rng = ChaCha8Rng::seed_from_u64(world.seed ^ 0xdeca);
        let number = plan.visits.unwrap_or(VISITS * world.groups.len());
        let mut visits = Vec::new();
        while visits.len() < number {
            let mut groups: Vec<usize> = (0..world.groups.len()).collect();
            groups.shuffle(&mut rng);
            visits.extend(groups.into_iter().map(|group| Visit {
                group,
                rounds: rng.random_range(plan.stay.clone()),
            }));
        }
        visits.truncate(number);
        let rounds = visits.iter().map(|visit| visit.rounds).sum();
        let mut stream = Stream::new(world, visits, ENVS)?.with_horizon(HORIZON);
        let spec = stream.spec().clone();
        let mut now = Observations::new(&spec);
        stream.reset(&mut now).map_err(TrialError::Environment)?;
        let settings = RecogniserSettings::default();
        Ok(Self {
            stream,
            rounds,
            alarms: plan.alarms,
            recogniser: Recogniser::new(settings)?,
            accountant: Accountant::new(spec.image, &spec.vector, &spec.action, settings.filters)?,
            policies: vec![StandIn::default()],
            current: 0,
            rng,
            now,
            deciding: Duration::ZERO,
            outcome: Outcome::default(),
        })
    }

    /// Runs the stream to its end.
    pub fn run(mut self) -> Result<Outcome, TrialError> {
        let mut met: Vec<Option<usize>> = vec![None; self.stream.world().groups.len()];
        while self.stream.rounds() < self.rounds {
            let turn = self.turn()?;
            let since = *met[turn.group].get_or_insert(turn.last);
            self.outcome.turns.push(Turn {
                is_known: has_returned((since..=turn.last).map(|round| self.group_at(round))),
                ..turn
            });
        }
        let state = self.recogniser.state(serde_json::value::Serializer);
        Ok(Outcome {
            distinct: self.stream.world().distinct(),
            policies: self.policies.len(),
            heirs: self.recogniser.heirs(),
            state: state.map_or(0, |state| state.to_string().len()),
            ..self.outcome
        })
    }

    fn group_at(&self, round: usize) -> usize {
        let group = self.stream.group_at(round);
        self.stream.world().representative(group)
    }

    /// One turn of the learner.
    fn turn(&mut self) -> Result<Turn, TrialError> {
        let begins = self.stream.rounds();
        self.deciding = Duration::ZERO;
        let mut accounts = self.roll_out(ROUNDS)?;
        let mut cut = None;
        let mut last = None;
        if self.recogniser.policies() > 0 {
            let mut finding = self.ask(|recogniser, current, rng| {
                recogniser.assign(&accounts, current, Look::First, rng)
            })?;
            cut = finding.cut;
            if finding.decision == Decision::Undecided {
                let first = accounts;
                accounts = self.roll_out(ROUNDS)?;
                let both = [first, accounts.clone()].concat();
                finding = self.ask(|recogniser, current, rng| {
                    recogniser.assign(&both, current, Look::Second, rng)
                })?;
                cut = finding.cut.or(cut);
            }
            if self.is_forced() {
                finding.decision = Decision::New;
            }
            (accounts, last) = self.follow(finding, accounts)?;
        }
        let learnt = self.learn(&accounts)?;
        // before anybody is heard, which takes rounds, too
        let ends = self.stream.rounds();
        let policy = self.current;
        if let Some(finding) = last {
            self.look_for_twin(&finding)?;
        }
        self.outcome.slowest = self.outcome.slowest.max(self.deciding);
        let changed =
            (begins + 1..begins + ROUNDS).find(|&r| self.group_at(r) != self.group_at(r - 1));
        let cut = cut.map(|cut| cut / (ENVS * HORIZON));
        Ok(Turn {
            group: learnt.iter().flatten().last().copied().unwrap_or(0),
            policy,
            rounds: self.stream.rounds() - begins,
            is_known: false,
            is_cut: changed.map(|changed| cut == Some(changed)),
            last: ends - 1 - (ROUNDS - learnt.iter().flatten().count()),
            learnt,
        })
    }

    /// Whether a superfluous policy is opened by force; there must be time to merge it.
    fn is_forced(&self) -> bool {
        let group = self.group_at(self.stream.rounds() - 1);
        let turns = self.outcome.turns.iter().filter(|turn| turn.group == group);
        let is_early = 3 * self.stream.rounds() < self.rounds;
        self.alarms && is_early && turns.count() == 3
    }

    /// Lets the current policy learn from its last rollout; returns the groups that it learnt from.
    fn learn(&mut self, accounts: &[Account]) -> Result<[Option<usize>; ROUNDS], TrialError> {
        let clock = Instant::now();
        let end = self
            .recogniser
            .learn(self.current, accounts, &mut self.rng)?;
        self.deciding += clock.elapsed();
        let ends = self.stream.rounds();
        let learnt = std::array::from_fn(|index| {
            let round = ends + index - ROUNDS;
            let is_own = end.is_none_or(|end| round * ENVS * HORIZON < end);
            is_own.then(|| self.group_at(round))
        });
        let of = |group| learnt.iter().flatten().filter(|&&g| g == group).count();
        if let Some(&most) = learnt.iter().flatten().max_by_key(|&&group| of(group)) {
            self.policies[self.current].learn(most);
        }
        Ok(learnt)
    }

    /// Asks the recogniser, and notes what it said and how long that took.
    fn ask(
        &mut self,
        question: impl FnOnce(&Recogniser, usize, &mut ChaCha8Rng) -> Result<Finding, EvidenceError>,
    ) -> Result<Finding, TrialError> {
        let clock = Instant::now();
        let finding = question(&self.recogniser, self.current, &mut self.rng)?;
        self.deciding += clock.elapsed();
        self.note(&finding);
        Ok(finding)
    }

    /// Lets a policy act that may serve the same group as the current one; if it does, one goes.
    fn look_for_twin(&mut self, finding: &Finding) -> Result<(), TrialError> {
        let policy = self.current;
        let Some(twin) = self.recogniser.twin(policy, &finding.accepted()) else {
            return Ok(());
        };
        self.current = twin;
        let heard = self.roll_out(1)?;
        let is_twin = self
            .recogniser
            .compare(policy, twin, &heard, &mut self.rng)?;
        self.current = policy;
        if is_twin {
            let again = self.roll_out(1)?;
            let both = (&heard[..], &again[..]);
            let merge = self.recogniser.merge(policy, twin, both, &mut self.rng)?;
            self.current = merge.map_or(policy, |merge| merge.kept);
        }
        let heirs = self.recogniser.heirs();
        let line = format!("{twin} was compared with {policy}: {is_twin}, {heirs:?}");
        self.outcome.log.push(line);
        Ok(())
    }

    /// Lets proposed policies act until one is accepted or all are refused; returns the accounts of
    /// the last rollout, and what was said of it.
    fn follow(
        &mut self,
        mut finding: Finding,
        mut accounts: Vec<Account>,
    ) -> Result<(Vec<Account>, Option<Finding>), TrialError> {
        while finding.decision != Decision::Existing(self.current) {
            let Decision::Existing(policy) = finding.decision else {
                self.current = self.policies.len();
                self.policies.push(StandIn::default());
                return Ok((self.roll_out(ROUNDS)?, None));
            };
            self.current = policy;
            let refused = finding.refused.clone();
            if finding.is_contested {
                let heard = self.roll_out(1)?;
                finding = self.review(&heard, &refused, finding.is_unproven)?;
                if finding.decision != Decision::Existing(policy) {
                    continue;
                }
            }
            accounts = self.roll_out(ROUNDS)?;
            finding = self.review(&accounts, &refused, finding.is_unproven)?;
        }
        Ok((accounts, Some(finding)))
    }

    fn review(
        &mut self,
        accounts: &[Account],
        refused: &[usize],
        is_unproven: bool,
    ) -> Result<Finding, TrialError> {
        self.ask(|recogniser, collector, rng| {
            let situation = Situation {
                collector,
                refused,
                is_unproven,
            };
            recogniser.review(accounts, situation, rng)
        })
    }

    /// Lets the current policy act for some rounds.
    fn roll_out(&mut self, rounds: usize) -> Result<Vec<Account>, TrialError> {
        let actor = &self.policies[self.current];
        let (stream, now) = (&mut self.stream, &mut self.now);
        roll_out(
            stream,
            now,
            actor,
            (&self.accountant, rounds),
            &mut self.rng,
        )
    }

    /// One line for a finding.
    fn note(&mut self, finding: &Finding) {
        let ends = self.stream.rounds();
        let groups: Vec<usize> = (ends.saturating_sub(ROUNDS)..ends)
            .map(|r| self.group_at(r))
            .collect();
        let mut line = format!(
            "{ends}: groups {groups:?}, policy {} {:?}: {:?}, cut {:?}, refused {:?};",
            self.current,
            self.policies[self.current],
            finding.decision,
            finding.cut,
            finding.refused,
        );
        for opinion in &finding.opinions {
            line += &format!(" {opinion}");
        }
        self.outcome.log.push(line);
    }
}

/// Whether the group that is first and last in these rounds was left in between.
fn has_returned(mut groups: impl Iterator<Item = usize>) -> bool {
    let first = groups.next();
    groups.any(|group| Some(group) != first)
}

#[cfg(test)]
mod tests {
    use super::*;
    use worlds::Kind;

    /// Rounds in which policies are heard after the turn's update belong to nobody.
    #[test]
    fn a_turn_is_dated_by_what_it_learnt() {
        let plan = Plan {
            visits: Some(6),
            stay: 8..=12,
            ..Plan::default()
        };
        let mut trial = Trial::of(World::draw(Kind::Target, 1000), &plan).unwrap();
        let mut heard = 0;
        while trial.stream.rounds() < trial.rounds {
            let turn = trial.turn().unwrap();
            assert_eq!(trial.group_at(turn.last), turn.group);
            let dropped = ROUNDS - turn.learnt.iter().flatten().count();
            heard += trial.stream.rounds() - 1 - dropped - turn.last;
        }
        assert!(heard > 0, "no policy was heard");
    }

    #[test]
    fn a_group_is_known_only_in_a_later_visit() {
        assert!(!has_returned([3].into_iter()), "the turn that meets it");
        assert!(!has_returned([3, 3, 3].into_iter()), "the same visit");
        assert!(has_returned([3, 3, 1, 1, 3].into_iter()));
    }
}
