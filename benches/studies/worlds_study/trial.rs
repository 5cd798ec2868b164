//! Trial of one world: a stream of visits, and a learner without networks. Its policies are
//! stand-ins: scripted experts whose skill grows with the iterations that they are trained in.

use std::sync::{Arc, Mutex, MutexGuard, PoisonError};
use std::time::Duration;

use learner::{
    CommonSettings, Grouping, GroupingSettings, IterationReport, Learner, NewPolicyInit,
    PolicyCollection, PolicyCollectionSettings, PolicyTrainer, ReassignedRolloutHandling,
};
use rand::seq::SliceRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rl::{
    Actor, AlgorithmState, BoxedEnvError, Decisions, EnvSpec, ExportPolicy, ExportedPolicy,
    FeatureExtractor, MeasureUnitActivity, Observations, OnPolicyActor, PolicyOutput, RlError,
    RolloutBuffer, Transition, UnitActivity, ValueFunction, VectorEnv,
};
use serde::{Deserialize, Serialize};
use worlds::{GroupVisit, TaskStream, World};

use crate::baseline::BaselineGrouping;
use crate::cases::{AssignmentRule, SUDDEN_CHANGE_ITERATION, StudyCase};
use crate::{Answer, Job};

pub const ENVS: usize = 5;
/// Number of rounds of a rollout, in each of which every environment runs one episode.
pub const ROUNDS_PER_ROLLOUT: usize = 4;
pub const HORIZON: usize = 20;
/// Number of visits of each group, unless the plan sets the number of all visits.
const VISITS: usize = 2;

/// Outcome of one iteration of the learner.
#[derive(Clone, Copy, Debug)]
pub struct IterationOutcome {
    /// Group of the last round that was trained on.
    pub group: usize,
    pub policy: usize,
    pub rounds: usize,
    /// `true` if the group was met in an earlier visit.
    pub is_known: bool,
    /// Number of the last round that was trained on.
    pub last: usize,
    /// Group of each round that was trained on.
    pub learnt: [Option<usize>; ROUNDS_PER_ROLLOUT],
}

/// Outcome of a learner's whole stream in one world.
#[derive(Clone, Debug, Default)]
pub struct StreamOutcome {
    pub distinct: usize,
    pub policies: usize,
    pub turns: Vec<IterationOutcome>,
    /// Policy that each policy was merged into, if it was.
    pub merged_into: Vec<Option<usize>>,
    /// Time of the decisions of the slowest turn.
    pub slowest: Duration,
}

impl StreamOutcome {
    /// Returns the policy that `policy` was merged into by the end of the stream, or `policy`
    /// itself if it was not merged.
    pub fn policy_after_merges(&self, policy: usize) -> usize {
        let next = |&index: &usize| self.merged_into.get(index).copied().flatten();
        let merges = std::iter::successors(Some(policy), next);
        merges.last().unwrap_or(policy)
    }

    /// Returns the number of policies that were merged into others.
    pub fn num_merged_policies(&self) -> usize {
        self.merged_into.iter().flatten().count()
    }

    /// Returns the number of policies that are left after all merges.
    pub fn num_remaining_policies(&self) -> usize {
        self.policies - self.num_merged_policies()
    }
}

/// Stream of a world, shared with policies that read its hidden state.
#[derive(Clone, Debug)]
struct Shared(Arc<Mutex<Bed>>);

#[derive(Debug)]
struct Bed {
    stream: TaskStream,
    case: StudyCase,
    /// First round of the latest training data, and the group of each of its rounds.
    learnt: (usize, [Option<usize>; ROUNDS_PER_ROLLOUT]),
}

impl Shared {
    fn lock(&self) -> MutexGuard<'_, Bed> {
        self.0.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

impl PartialEq for Shared {
    fn eq(&self, other: &Self) -> bool {
        Arc::ptr_eq(&self.0, &other.0)
    }
}

impl Bed {
    fn group_at(&self, round: usize) -> usize {
        let group = self.stream.group_in_round(round);
        self.stream.world().first_equal_group(group)
    }
}

/// Environments of a learner that shares the stream with its policies.
struct Environments {
    spec: EnvSpec,
    bed: Shared,
}

impl VectorEnv for Environments {
    fn spec(&self) -> &EnvSpec {
        &self.spec
    }

    fn horizon(&self) -> Option<usize> {
        Some(HORIZON)
    }

    fn reset(&mut self, out: &mut Observations) -> Result<(), BoxedEnvError> {
        self.bed.lock().stream.reset(out)
    }

    fn step(&mut self, actions: &[f32], out: &mut Transition) -> Result<(), BoxedEnvError> {
        self.bed.lock().stream.step(actions, out)
    }
}

/// Draws the visits of a stream.
fn visits(job: &Job, world: &World, rng: &mut ChaCha8Rng) -> Vec<GroupVisit> {
    if job.case == StudyCase::RareGroup {
        let pair = [(0, 49), (1, 1)];
        let pair =
            pair.map(|(group, rollouts)| GroupVisit::new(group, ROUNDS_PER_ROLLOUT * rollouts));
        return pair.repeat(4);
    }
    let groups = world.groups.len();
    // a nuisance has the time to act
    let least = if world.scene == world.changed_scene { 1 } else { 4 };
    let number = job.plan.visits.unwrap_or(VISITS * groups.max(least));
    let mut visits = Vec::new();
    while visits.len() < number {
        let mut order: Vec<usize> = (0..groups).collect();
        order.shuffle(rng);
        let stay = |group| GroupVisit::new(group, rng.random_range(job.plan.rounds()));
        visits.extend(order.into_iter().map(stay));
    }
    visits.truncate(number);
    visits
}

/// State of a stream in one world, with its learner.
pub struct StreamTrial {
    rounds: usize,
    env: Environments,
    learner: PolicyCollection<StandInSettings>,
    outcome: StreamOutcome,
}

impl StreamTrial {
    /// Draws a world and its visits, and creates a learner for their stream, which
    /// [`StreamTrial::run`] runs.
    pub fn new(job: &Job) -> Answer<Self> {
        let world = job.case.world(job.seed);
        let seed = job.seed ^ 0xdeca;
        let visits = visits(job, &world, &mut ChaCha8Rng::seed_from_u64(seed));
        let rounds = visits.iter().map(|visit| visit.rounds).sum();
        let distinct = world.num_distinct_groups();
        let stream = TaskStream::new(world, visits, ENVS)?.with_horizon(HORIZON);
        let spec = stream.spec().clone();
        let bed = Shared(Arc::new(Mutex::new(Bed {
            stream,
            case: job.case,
            learnt: (0, [None; ROUNDS_PER_ROLLOUT]),
        })));
        // a baseline, as the paper's rule, trains the assigned policy on the rollout as it is
        let (handover, grouping): (_, Box<dyn Grouping>) = match job.rule {
            AssignmentRule::Evidence => (
                ReassignedRolloutHandling::CollectAgain,
                GroupingSettings::default().build_grouping()?,
            ),
            rule => (
                ReassignedRolloutHandling::Reuse,
                Box::new(BaselineGrouping::new(rule, &spec, seed)?),
            ),
        };
        let settings = StandInSettings { seed, handover, bed: Some(bed.clone()) };
        Ok(Self {
            rounds,
            learner: PolicyCollection::with_grouping(settings, &spec, grouping)?,
            env: Environments { spec, bed },
            outcome: StreamOutcome { distinct, ..StreamOutcome::default() },
        })
    }

    /// Runs the stream to its end.
    pub fn run(mut self) -> Answer<StreamOutcome> {
        let groups = self.env.bed.lock().stream.world().groups.len();
        let mut met: Vec<Option<usize>> = vec![None; groups];
        while self.round() < self.rounds {
            let turn = self.turn()?;
            let since = *met[turn.group].get_or_insert(turn.last);
            let bed = self.env.bed.lock();
            let is_known = has_returned((since..=turn.last).map(|round| bed.group_at(round)));
            self.outcome.turns.push(IterationOutcome { is_known, ..turn });
        }
        Ok(StreamOutcome { policies: self.learner.policy_count(), ..self.outcome })
    }

    fn round(&self) -> usize {
        self.env.bed.lock().stream.num_rounds_ended()
    }

    /// Takes one iteration of the learner.
    fn turn(&mut self) -> Answer<IterationOutcome> {
        let begins = self.round();
        let iteration = self.learner.learn(&mut self.env)?;
        let IterationReport { policy, merged_into, seconds, .. } = iteration;
        self.outcome.merged_into = merged_into;
        let deciding = Duration::from_secs_f64(seconds.assignment);
        self.outcome.slowest = self.outcome.slowest.max(deciding);
        let (first, learnt) = self.env.bed.lock().learnt;
        let rounds = learnt.iter().flatten().count();
        Ok(IterationOutcome {
            group: learnt.iter().flatten().last().copied().unwrap_or(0),
            policy,
            rounds: self.round() - begins,
            is_known: false,
            last: first + rounds.saturating_sub(1),
            learnt,
        })
    }
}

/// Number of iterations after which a policy's skill is 1 - 1/e.
const ITERATIONS: f32 = 3.0;
/// Half-width of the uniform exploration noise of a skilled policy.
const EXPLORATION: f32 = 0.3;
/// Number of the latest iterations that determine a policy's skill.
const MEMORY: usize = 8;

/// Settings of a learner whose policies are scripted experts instead of networks, with a skill that
/// grows with the number of training iterations.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
pub struct StandInSettings {
    seed: u64,
    handover: ReassignedRolloutHandling,
    #[serde(skip)]
    bed: Option<Shared>,
}

/// Scripted expert that stands in for a policy: it acts for the group that it was trained on most
/// in its latest iterations, and its skill grows with their number.
#[derive(Clone, Debug, Default)]
pub struct StandInPolicy {
    learnt: Vec<usize>,
    /// Number of iterations.
    trained: usize,
    bed: Option<Shared>,
}

/// Trainer of a [`StandInPolicy`], which shows it the groups of the rounds trained on instead of
/// optimising parameters.
pub struct StandInTrainer(Option<Shared>);

impl PolicyCollectionSettings for StandInSettings {
    type Trainer = StandInTrainer;

    fn common(&self) -> CommonSettings {
        CommonSettings {
            grouping: GroupingSettings::default(),
            first_frames: 1,
            rollout_steps: ENVS * ROUNDS_PER_ROLLOUT * HORIZON,
            buffer_episodes: Some(100),
            handover: self.handover,
            new_policy: NewPolicyInit::Random,
            seed: self.seed,
        }
    }

    fn new_policy(&self, _: &EnvSpec, _: u64) -> Result<StandInPolicy, RlError> {
        Ok(StandInPolicy { bed: self.bed.clone(), ..StandInPolicy::default() })
    }

    fn policy_with_params(&self, spec: &EnvSpec, _: Vec<f32>) -> Result<StandInPolicy, RlError> {
        self.new_policy(spec, 0)
    }

    fn params(_: &StandInPolicy) -> &[f32] {
        &[]
    }

    fn new_rollout(&self, spec: &EnvSpec, steps: usize) -> Result<RolloutBuffer, RlError> {
        RolloutBuffer::new(spec, steps)
    }

    fn new_training(&self, _: &EnvSpec, _: &StandInPolicy) -> Result<StandInTrainer, RlError> {
        Ok(StandInTrainer(self.bed.clone()))
    }
}

impl PolicyTrainer for StandInTrainer {
    type Policy = StandInPolicy;
    type Rollout = RolloutBuffer;

    fn adapt_rollout(_: &mut StandInPolicy, _: &mut RolloutBuffer) -> Result<(), RlError> {
        Ok(())
    }

    fn learn(
        &mut self,
        policy: &mut StandInPolicy,
        rollout: &mut RolloutBuffer,
        _: &mut ChaCha8Rng,
    ) -> Result<Vec<(String, f64)>, RlError> {
        let Some(bed) = &self.0 else {
            return Ok(Vec::new());
        };
        let mut bed = bed.lock();
        let first = bed.stream.num_rounds_ended() - ROUNDS_PER_ROLLOUT;
        let kept = rollout.steps_per_env() / HORIZON;
        let learnt =
            std::array::from_fn(|index| (index < kept).then(|| bed.group_at(first + index)));
        bed.learnt = (first, learnt);
        policy.learn(&learnt, bed.case);
        Ok(Vec::new())
    }

    fn algorithm_state(&self) -> AlgorithmState<'_> {
        AlgorithmState::default()
    }

    fn restore_algorithm(&mut self, _: &AlgorithmState<'_>) -> Result<(), RlError> {
        Ok(())
    }
}

impl StandInPolicy {
    /// Trains on rounds of these groups.
    fn learn(&mut self, groups: &[Option<usize>], case: StudyCase) {
        let of = |group| groups.iter().flatten().filter(|&&g| g == group).count();
        let most = groups.iter().flatten().copied().max_by_key(|&group| of(group));
        self.trained += 1;
        if case == StudyCase::Collapse && self.trained == SUDDEN_CHANGE_ITERATION {
            self.learnt.clear();
            return;
        }
        self.learnt.extend(most);
        if self.learnt.len() > MEMORY {
            self.learnt.remove(0);
        }
    }

    /// Returns the group that the policy acts for, and its skill in [0, 1).
    fn skill(&self, case: StudyCase) -> Option<(usize, f32)> {
        let iterations = |group| self.learnt.iter().filter(|&&learnt| learnt == group).count();
        let most = self.learnt.iter().copied().max_by_key(|&group| iterations(group))?;
        let fails = case == StudyCase::SuddenSuccess && self.trained < SUDDEN_CHANGE_ITERATION;
        let skill = 1.0 - (-(iterations(most) as f32) / ITERATIONS).exp();
        Some((most, if fails { 0.0 } else { skill }))
    }

    /// Writes the actions `[N, 2]` of an expert, mixed with noise in [-1, 1] by skill.
    fn mix(&self, noise: impl Iterator<Item = f32>, out: &mut [f32]) {
        let Some(bed) = &self.bed else {
            return;
        };
        let bed = bed.lock();
        let (group, skill) = self.skill(bed.case).unwrap_or((0, 0.0));
        let expert = (0..ENVS).flat_map(|env| bed.stream.expert_action(env, group));
        for ((taken, action), noisy) in out.iter_mut().zip(expert).zip(noise) {
            *taken = skill * (action + EXPLORATION * noisy) + (1.0 - skill) * noisy;
        }
    }
}

impl Actor for StandInPolicy {
    type Memory = ();

    fn new_memory(&self, _: usize) {}

    fn act(
        &mut self,
        _: &Observations,
        (): &mut (),
        rng: &mut ChaCha8Rng,
        out: &mut [f32],
    ) -> Result<(), RlError> {
        self.mix(std::iter::repeat_with(|| rng.random_range(-1.0..1.0)), out);
        Ok(())
    }

    fn mean_actions(
        &mut self,
        _: &Observations,
        (): &mut (),
        out: &mut [f32],
    ) -> Result<(), RlError> {
        self.mix(std::iter::repeat(0.0), out);
        Ok(())
    }
}

impl ValueFunction for StandInPolicy {
    fn values(&mut self, _: &Observations, out: &mut [f32]) -> Result<(), RlError> {
        out.fill(0.0);
        Ok(())
    }
}

impl OnPolicyActor for StandInPolicy {
    fn decide(
        &mut self,
        _: &Observations,
        (): &mut (),
        noise: &[f32],
        out: &mut Decisions,
    ) -> Result<(), RlError> {
        // the logistic function is within 0.01 of a normal variable's distribution, so that the
        // noise becomes uniform
        let uniform = noise.iter().map(|z| 2.0 / (1.0 + (-1.702 * z).exp()) - 1.0);
        self.mix(uniform, &mut out.actions);
        Ok(())
    }
}

impl FeatureExtractor for StandInPolicy {
    fn feature_dim(&self) -> usize {
        1
    }

    fn features(&mut self, _: &Observations, out: &mut [f32]) -> Result<(), RlError> {
        out.fill(0.0);
        Ok(())
    }
}

impl MeasureUnitActivity for StandInPolicy {
    fn unit_activity(&self, _: &Observations, (): &()) -> Result<UnitActivity, RlError> {
        Ok(UnitActivity::default())
    }
}

impl ExportPolicy for StandInPolicy {
    fn export(&self) -> Result<ExportedPolicy, RlError> {
        Err(RlError::NotExportable { part: "a stand-in" })
    }

    fn reference_output(&mut self, _: &Observations) -> Result<PolicyOutput, RlError> {
        Err(RlError::NotExportable { part: "a stand-in" })
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
    use crate::cases::VisitPlan;
    use worlds::WorldKind;

    fn job(case: StudyCase, visits: usize, stay: usize) -> Job {
        let plan = VisitPlan { visits: Some(visits), stay: Some(stay..=stay + 4) };
        Job { case, rule: AssignmentRule::Evidence, plan, seed: 1000 }
    }

    /// Rounds in which possible duplicates act after the update are not trained on.
    #[test]
    fn a_turn_is_dated_by_what_it_learnt() {
        let mut trial = StreamTrial::new(&job(StudyCase::Kind(WorldKind::Target), 6, 8)).unwrap();
        let mut auditions = 0;
        while trial.round() < trial.rounds {
            let turn = trial.turn().unwrap();
            assert_eq!(trial.env.bed.lock().group_at(turn.last), turn.group);
            let dropped = ROUNDS_PER_ROLLOUT - turn.learnt.iter().flatten().count();
            auditions += trial.round() - 1 - dropped - turn.last;
        }
        assert!(auditions > 0, "no policy had an audition");
    }

    #[test]
    fn skill_grows_and_turns_where_the_case_says() {
        let target = StudyCase::Kind(WorldKind::Target);
        let cases = [
            (target, [0.9, 0.9]),
            (StudyCase::SuddenSuccess, [0.0, 0.9]),
            (StudyCase::Collapse, [0.9, 0.0]),
        ];
        for (case, expected) in cases {
            let mut policy = StandInPolicy::default();
            let skills = (1..=SUDDEN_CHANGE_ITERATION).map(|_| {
                policy.learn(&[Some(3)], case);
                policy.skill(case).map_or(0.0, |(_, skill)| skill)
            });
            let skills: Vec<f32> = skills.collect();
            for (skill, least) in skills[SUDDEN_CHANGE_ITERATION - 2..].iter().zip(expected) {
                assert!((least..=least * 1.1).contains(skill), "{case:?} {skills:?}");
            }
        }
    }

    #[test]
    fn baselines_see_what_they_describe() {
        for rule in [
            AssignmentRule::Histogram,
            AssignmentRule::Image,
            AssignmentRule::Network,
            AssignmentRule::Threshold,
        ] {
            for kind in [WorldKind::Colour, WorldKind::Reward, WorldKind::Identical] {
                let job = Job { rule, ..job(StudyCase::Kind(kind), 4, 8) };
                let policies = StreamTrial::new(&job).unwrap().run().unwrap().policies;
                let sees = kind == WorldKind::Colour && rule != AssignmentRule::Threshold;
                assert_eq!(policies > 1, sees, "{rule:?} {kind:?}");
            }
        }
    }

    #[test]
    fn a_group_is_known_only_in_a_later_visit() {
        assert!(!has_returned([3].into_iter()), "the turn that meets it");
        assert!(!has_returned([3, 3, 3].into_iter()), "the same visit");
        assert!(has_returned([3, 3, 1, 1, 3].into_iter()));
    }
}
