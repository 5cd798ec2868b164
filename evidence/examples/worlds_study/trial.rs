//! One world: a stream of visits, and a learner without networks that assigns them.

use cluster::Decision;
use evidence::{
    Account, Accountant, Course, EvidenceError, Finding, Recogniser, RecogniserSettings, Situation,
};
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rl::{BoxError, Observations, Transition, VectorEnv};
use worlds::{Stream, Visit, World, WorldError};

use crate::stand_in::StandIn;

const ENVS: usize = 5;
/// Rounds of a rollout: 20 episodes.
const ROUNDS: usize = 4;
const HORIZON: usize = 20;
/// Visits of each group.
const VISITS: usize = 2;
/// Rounds that a visit lasts: three rollouts to ten, with switches in the middle of some.
const STAY: std::ops::RangeInclusive<usize> = 12..=40;

/// What can go wrong.
#[derive(Debug, thiserror::Error)]
pub enum TrialError {
    #[error("`{0}` is no number")]
    Argument(String),
    #[error(transparent)]
    Evidence(#[from] EvidenceError),
    #[error(transparent)]
    World(#[from] WorldError),
    #[error("the environments: {0}")]
    Environment(BoxError),
}

/// What came of one turn.
#[derive(Clone, Copy, Debug)]
pub struct Turn {
    /// The group that ran at the end.
    pub group: usize,
    pub policy: usize,
    pub rollouts: usize,
    /// Whether the group was met in an earlier visit.
    pub is_known: bool,
    /// Whether the first rollout was cut at the round in which its group changed, if it did.
    pub is_cut: Option<bool>,
}

/// What came of one world.
#[derive(Clone, Debug)]
pub struct Outcome {
    pub distinct: usize,
    pub policies: usize,
    pub turns: Vec<Turn>,
}

/// A world under way.
pub struct Trial {
    stream: Stream,
    rounds: usize,
    recogniser: Recogniser,
    accountant: Accountant,
    policies: Vec<StandIn>,
    current: usize,
    rng: ChaCha8Rng,
    now: Observations,
}

impl Trial {
    /// Draws visits and starts.
    pub fn of(world: World) -> Result<Self, TrialError> {
        let mut rng = ChaCha8Rng::seed_from_u64(world.seed ^ 0xdeca);
        let mut visits = Vec::new();
        for _ in 0..VISITS {
            let mut groups: Vec<usize> = (0..world.groups.len()).collect();
            groups.shuffle(&mut rng);
            visits.extend(groups.into_iter().map(|group| Visit {
                group,
                rounds: rng.random_range(STAY),
            }));
        }
        let rounds = visits.iter().map(|visit| visit.rounds).sum();
        let mut stream = Stream::new(world, visits, ENVS)?.with_horizon(HORIZON);
        let spec = stream.spec().clone();
        let mut now = Observations::new(&spec);
        stream.reset(&mut now).map_err(TrialError::Environment)?;
        let settings = RecogniserSettings::default();
        Ok(Self {
            stream,
            rounds,
            recogniser: Recogniser::new(settings)?,
            accountant: Accountant::new(spec.image, &spec.vector, &spec.action, settings.filters)?,
            policies: vec![StandIn::default()],
            current: 0,
            rng,
            now,
        })
    }

    /// Runs the stream to its end.
    pub fn run(mut self) -> Result<Outcome, TrialError> {
        let mut turns = Vec::new();
        let mut met: Vec<Option<usize>> = vec![None; self.stream.world().groups.len()];
        while self.stream.rounds() < self.rounds {
            let turn = self.turn()?;
            let last = self.stream.rounds() - 1;
            let since = *met[turn.group].get_or_insert(last);
            turns.push(Turn {
                is_known: has_returned((since..=last).map(|round| self.group_at(round))),
                ..turn
            });
        }
        Ok(Outcome {
            distinct: self.stream.world().distinct(),
            policies: self.policies.len(),
            turns,
        })
    }

    fn group_at(&self, round: usize) -> usize {
        let group = self.stream.group_at(round);
        self.stream.world().representative(group)
    }

    /// One turn of the learner.
    fn turn(&mut self) -> Result<Turn, TrialError> {
        let begins = self.stream.rounds();
        let mut accounts = self.roll_out(self.current)?;
        let mut rollouts = 1;
        let mut cut = None;
        if self.recogniser.policies() > 0 {
            let rng = &mut self.rng;
            let mut finding = self.recogniser.assign(&accounts, self.current, rng)?;
            cut = finding.cut;
            if finding.decision == Decision::Undecided {
                let first = accounts;
                accounts = self.roll_out(self.current)?;
                rollouts += 1;
                let both = [first, accounts.clone()].concat();
                finding = self.recogniser.settle(&both, self.current, &mut self.rng)?;
                cut = finding.cut.or(cut);
            }
            (accounts, rollouts) = self.follow(finding, accounts, rollouts)?;
        }
        self.recogniser
            .learn(self.current, &accounts, &mut self.rng)?;
        let group = self.group_at(self.stream.rounds() - 1);
        // of a mixed rollout the policy learns the half that began it
        let half = self.group_at(self.stream.rounds() - ROUNDS / 2 - 1);
        self.policies[self.current].learn(half);
        let changed =
            (begins + 1..begins + ROUNDS).find(|&r| self.group_at(r) != self.group_at(r - 1));
        let cut = cut.map(|cut| cut / (ENVS * HORIZON));
        Ok(Turn {
            group,
            policy: self.current,
            rollouts,
            is_known: false,
            is_cut: changed.map(|changed| cut == Some(changed)),
        })
    }

    /// Lets proposed policies act until one is accepted or all are refused; returns the accounts of
    /// the last rollout.
    fn follow(
        &mut self,
        mut finding: Finding,
        mut accounts: Vec<Account>,
        mut rollouts: usize,
    ) -> Result<(Vec<Account>, usize), TrialError> {
        while finding.decision != Decision::Existing(self.current) {
            rollouts += 1;
            let Decision::Existing(policy) = finding.decision else {
                self.current = self.policies.len();
                self.policies.push(StandIn::default());
                return Ok((self.roll_out(self.current)?, rollouts));
            };
            self.current = policy;
            accounts = self.roll_out(policy)?;
            let situation = Situation {
                collector: policy,
                refused: &finding.refused,
            };
            finding = self
                .recogniser
                .review(&accounts, situation, &mut self.rng)?;
        }
        Ok((accounts, rollouts))
    }

    /// Lets a policy act for some rounds.
    fn roll_out(&mut self, policy: usize) -> Result<Vec<Account>, TrialError> {
        let mut accounts = Vec::new();
        for _ in 0..ROUNDS {
            let courses = self.round(policy)?;
            accounts.extend(self.accountant.accounts(&courses)?);
        }
        Ok(accounts)
    }

    fn round(&mut self, policy: usize) -> Result<Vec<Course>, TrialError> {
        let began = self.stream.rounds() * ENVS * HORIZON;
        let spec = self.stream.spec().clone();
        let images = self.now.images.chunks(spec.image_len());
        let mut courses: Vec<Course> = images
            .map(|image| Course {
                began,
                image: image.to_vec(),
                is_whole: true,
                ..Course::default()
            })
            .collect();
        let mut transition = Transition::new(&spec);
        for _ in 0..HORIZON {
            let actor = &self.policies[policy];
            let mut actions = Vec::with_capacity(2 * ENVS);
            for env in 0..ENVS {
                actions.extend(actor.act(&self.stream, env, &mut self.rng));
            }
            self.stream
                .step(&actions, &mut transition)
                .map_err(TrialError::Environment)?;
            for (env, course) in courses.iter_mut().enumerate() {
                course
                    .vectors
                    .extend(&self.now.vectors[2 * env..2 * env + 2]);
                course.actions.extend(&actions[2 * env..2 * env + 2]);
                course.rewards.push(transition.rewards[env]);
            }
            self.now.clone_from(&transition.observations);
        }
        Ok(courses)
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

    #[test]
    fn a_group_is_known_only_in_a_later_visit() {
        assert!(!has_returned([3].into_iter()), "the turn that meets it");
        assert!(!has_returned([3, 3, 3].into_iter()), "the same visit");
        assert!(has_returned([3, 3, 1, 1, 3].into_iter()));
    }
}
