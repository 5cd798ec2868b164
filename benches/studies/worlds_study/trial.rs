//! Trial of one world: a stream of visits, and a learner without networks that assigns them. Its
//! policies are stand-ins: scripted experts whose skill grows with the turns that they are trained
//! on.

use std::time::{Duration, Instant};

use cluster::Decision;
use evidence::{
    Account, Accountant, Course, EvidenceError, Finding, Look, Recogniser, RecogniserSettings,
    Situation,
};
use rand::seq::SliceRandom;
use rand::{Rng, RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rl::{Observations, Transition, VectorEnv};
use worlds::{TaskStream, Visit, World};

use crate::{Answer, Plan};

pub const ENVS: usize = 5;
/// Number of rounds of a rollout, which has 20 episodes.
pub const ROUNDS: usize = 4;
pub const HORIZON: usize = 20;
/// Number of visits of each group, unless the plan sets the number of all visits.
const VISITS: usize = 2;

/// Outcome of one turn of the learner.
#[derive(Clone, Copy, Debug)]
pub struct Turn {
    /// Group of the last round that was trained on.
    pub group: usize,
    pub policy: usize,
    pub rounds: usize,
    /// `true` if the group was met in an earlier visit.
    pub is_known: bool,
    /// `true` if the first rollout was cut at the round in which its group changed; `None` if the
    /// group did not change.
    pub is_cut: Option<bool>,
    /// Number of the last round that was trained on.
    pub last: usize,
    /// Group of each round that was trained on.
    pub learnt: [Option<usize>; ROUNDS],
}

/// Outcome of one world.
#[derive(Clone, Debug, Default)]
pub struct Outcome {
    pub distinct: usize,
    pub policies: usize,
    pub turns: Vec<Turn>,
    /// Policy that each policy was merged into, if it was.
    pub heirs: Vec<Option<usize>>,
    /// Time of the decisions of the slowest turn.
    pub slowest: Duration,
    /// Size of the recogniser's state as text (bytes).
    pub state: usize,
}

impl Outcome {
    /// Returns the policy that a policy was merged into in the end, or itself.
    pub fn now(&self, policy: usize) -> usize {
        let heir = |&index: &usize| self.heirs.get(index).copied().flatten();
        let heirs = std::iter::successors(Some(policy), heir);
        heirs.last().unwrap_or(policy)
    }

    /// Returns the number of policies that were merged into others.
    pub fn merged(&self) -> usize {
        self.heirs.iter().flatten().count()
    }

    /// Returns the number of policies that are left.
    pub fn left(&self) -> usize {
        self.policies - self.merged()
    }
}

/// State of a stream in one world, with its learner.
pub struct Trial {
    stream: TaskStream,
    rounds: usize,
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
    /// Draws the visits of a world, and starts its stream.
    pub fn of(world: World, plan: &Plan) -> Answer<Self> {
        let mut rng = ChaCha8Rng::seed_from_u64(world.seed ^ 0xdeca);
        let number = plan.visits.unwrap_or(VISITS * world.groups.len());
        let mut visits = Vec::new();
        while visits.len() < number {
            let mut groups: Vec<usize> = (0..world.groups.len()).collect();
            groups.shuffle(&mut rng);
            visits.extend(
                groups
                    .into_iter()
                    .map(|group| Visit { group, rounds: rng.random_range(plan.stay.clone()) }),
            );
        }
        visits.truncate(number);
        let rounds = visits.iter().map(|visit| visit.rounds).sum();
        let mut stream = TaskStream::new(world, visits, ENVS)?.with_horizon(HORIZON);
        let spec = stream.spec().clone();
        let mut now = Observations::new(&spec);
        stream.reset(&mut now)?;
        let settings = RecogniserSettings::default();
        Ok(Self {
            stream,
            rounds,
            recogniser: Recogniser::new(settings)?,
            accountant: Accountant::new(
                spec.image_shape,
                &spec.vector_irreps,
                &spec.action_irreps,
                settings.filters,
            )?,
            policies: vec![StandIn::default()],
            current: 0,
            rng,
            now,
            deciding: Duration::ZERO,
            outcome: Outcome::default(),
        })
    }

    /// Runs the stream to its end.
    pub fn run(mut self) -> Answer<Outcome> {
        let mut met: Vec<Option<usize>> = vec![None; self.stream.world().groups.len()];
        while self.stream.num_rounds_ended() < self.rounds {
            let turn = self.turn()?;
            let since = *met[turn.group].get_or_insert(turn.last);
            self.outcome.turns.push(Turn {
                is_known: has_returned((since..=turn.last).map(|round| self.group_at(round))),
                ..turn
            });
        }
        let state = self.recogniser.state(serde_json::value::Serializer);
        Ok(Outcome {
            distinct: self.stream.world().num_distinct_groups(),
            policies: self.policies.len(),
            heirs: self.recogniser.heirs(),
            state: state.map_or(0, |state| state.to_string().len()),
            ..self.outcome
        })
    }

    fn group_at(&self, round: usize) -> usize {
        let group = self.stream.group_in_round(round);
        self.stream.world().first_equal_group(group)
    }

    /// Takes one turn of the learner: rollouts, assignment, update, and a search for duplicates.
    fn turn(&mut self) -> Answer<Turn> {
        let begins = self.stream.num_rounds_ended();
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
            (accounts, last) = self.follow(finding, accounts)?;
        }
        let learnt = self.learn(&accounts)?;
        // before rounds in which a possible duplicate acts, since nothing is trained on them
        let ends = self.stream.num_rounds_ended();
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
            rounds: self.stream.num_rounds_ended() - begins,
            is_known: false,
            is_cut: changed.map(|changed| cut == Some(changed)),
            last: ends - 1 - (ROUNDS - learnt.iter().flatten().count()),
            learnt,
        })
    }

    /// Trains the current policy on its last rollout, and returns the groups of the rounds that
    /// were trained on.
    fn learn(&mut self, accounts: &[Account]) -> Answer<[Option<usize>; ROUNDS]> {
        let clock = Instant::now();
        let end = self.recogniser.learn(self.current, accounts, &mut self.rng)?;
        self.deciding += clock.elapsed();
        let ends = self.stream.num_rounds_ended();
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

    /// Calls the recogniser, and adds the time to that of the turn's decisions.
    fn ask(
        &mut self,
        question: impl FnOnce(&Recogniser, usize, &mut ChaCha8Rng) -> Result<Finding, EvidenceError>,
    ) -> Answer<Finding> {
        let clock = Instant::now();
        let finding = question(&self.recogniser, self.current, &mut self.rng)?;
        self.deciding += clock.elapsed();
        Ok(finding)
    }

    /// Lets a policy act that may serve the same group as the current one, and merges the two if it
    /// does.
    fn look_for_twin(&mut self, finding: &Finding) -> Answer<()> {
        let policy = self.current;
        let Some(twin) = self.recogniser.twin(policy, &finding.accepted()) else {
            return Ok(());
        };
        self.current = twin;
        let heard = self.roll_out(1)?;
        let is_twin = self.recogniser.compare(policy, twin, &heard, &mut self.rng)?;
        self.current = policy;
        if is_twin {
            let again = self.roll_out(1)?;
            let merge = self.recogniser.merge(policy, twin, &heard, &again, &mut self.rng)?;
            self.current = merge.map_or(policy, |merge| merge.kept);
        }
        Ok(())
    }

    /// Lets proposed policies act until one is accepted or all are rejected. Returns the accounts
    /// of the last rollout, and the finding about it.
    fn follow(
        &mut self,
        mut finding: Finding,
        mut accounts: Vec<Account>,
    ) -> Answer<(Vec<Account>, Option<Finding>)> {
        while finding.decision != Decision::Existing(self.current) {
            let Decision::Existing(policy) = finding.decision else {
                self.current = self.policies.len();
                self.policies.push(StandIn::default());
                return Ok((self.roll_out(ROUNDS)?, None));
            };
            self.current = policy;
            let rejected = finding.rejected.clone();
            if finding.is_contested {
                let heard = self.roll_out(1)?;
                finding = self.review(&heard, &rejected, finding.is_unproven)?;
                if finding.decision != Decision::Existing(policy) {
                    continue;
                }
            }
            accounts = self.roll_out(ROUNDS)?;
            finding = self.review(&accounts, &rejected, finding.is_unproven)?;
        }
        Ok((accounts, Some(finding)))
    }

    fn review(
        &mut self,
        accounts: &[Account],
        rejected: &[usize],
        is_unproven: bool,
    ) -> Answer<Finding> {
        self.ask(|recogniser, collector, rng| {
            let situation = Situation { collector, rejected, is_unproven };
            recogniser.review(accounts, situation, rng)
        })
    }

    /// Lets the current policy act for some rounds.
    fn roll_out(&mut self, rounds: usize) -> Answer<Vec<Account>> {
        let mut accounts = Vec::new();
        for _ in 0..rounds {
            let courses = self.round()?;
            accounts.extend(self.accountant.accounts(&courses)?);
        }
        Ok(accounts)
    }

    fn round(&mut self) -> Answer<Vec<Course>> {
        let spec = self.stream.spec().clone();
        let began = self.stream.num_rounds_ended() * ENVS * HORIZON;
        let images = self.now.images.chunks(spec.image_len());
        let begin = |image: &[u8]| Course {
            began,
            image: image.to_vec(),
            is_whole: true,
            ..Course::default()
        };
        let mut courses: Vec<Course> = images.map(begin).collect();
        let mut transition = Transition::new(&spec);
        for _ in 0..HORIZON {
            let actor = &self.policies[self.current];
            let mut actions = Vec::with_capacity(2 * ENVS);
            for env in 0..ENVS {
                actions.extend(actor.act(&self.stream, env, &mut self.rng));
            }
            self.stream.step(&actions, &mut transition)?;
            for (env, course) in courses.iter_mut().enumerate() {
                let own = 2 * env..2 * env + 2;
                course.vectors.extend(&self.now.vectors[own.clone()]);
                course.actions.extend(&actions[own]);
                course.rewards.push(transition.rewards[env]);
            }
            self.now.clone_from(&transition.observations);
        }
        Ok(courses)
    }
}

/// Number of turns after which a policy's skill is 1 - 1/e.
const TURNS: f32 = 3.0;
/// Half-width of the uniform exploration noise of a skilled policy.
const EXPLORATION: f32 = 0.3;
/// Number of the latest turns that determine a policy's skill.
const MEMORY: usize = 8;

/// Stand-in for a policy. It acts for the group that it was trained on most of late, and its skill
/// grows with the number of these turns.
#[derive(Clone, Debug, Default)]
pub struct StandIn {
    learnt: Vec<usize>,
}

impl StandIn {
    /// Trains one turn on tasks of `group`.
    pub fn learn(&mut self, group: usize) {
        self.learnt.push(group);
        if self.learnt.len() > MEMORY {
            self.learnt.remove(0);
        }
    }

    /// Returns the group that the policy acts for, and its skill in [0, 1).
    fn skill(&self) -> Option<(usize, f32)> {
        let turns = |group| self.learnt.iter().filter(|&&learnt| learnt == group).count();
        let most = self.learnt.iter().copied().max_by_key(|&group| turns(group))?;
        Some((most, 1.0 - (-(turns(most) as f32) / TURNS).exp()))
    }

    /// Returns an action in environment `env`: that of the expert, mixed with noise by skill.
    pub fn act<R: Rng>(&self, stream: &TaskStream, env: usize, rng: &mut R) -> [f32; 2] {
        let (group, skill) = self.skill().unwrap_or((0, 0.0));
        stream.expert_action(env, group).map(|action| {
            let noise: f32 = rng.random_range(-1.0..1.0);
            skill * (action + EXPLORATION * noise) + (1.0 - skill) * noise
        })
    }
}

/// Returns `true` if the group that is first and last in these rounds was left in between.
fn has_returned(mut groups: impl Iterator<Item = usize>) -> bool {
    let first = groups.next();
    groups.any(|group| Some(group) != first)
}

#[cfg(test)]
mod tests {
    use super::*;
    use worlds::WorldKind;

    /// Rounds in which possible duplicates act after the turn's update are not trained on.
    #[test]
    fn a_turn_is_dated_by_what_it_learnt() {
        let plan = Plan { visits: Some(6), stay: 8..=12 };
        let mut trial = Trial::of(World::random(WorldKind::Target, 1000), &plan).unwrap();
        let mut heard = 0;
        while trial.stream.num_rounds_ended() < trial.rounds {
            let turn = trial.turn().unwrap();
            assert_eq!(trial.group_at(turn.last), turn.group);
            let dropped = ROUNDS - turn.learnt.iter().flatten().count();
            heard += trial.stream.num_rounds_ended() - 1 - dropped - turn.last;
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
