//! Settings of one run over a task stream.

use std::path::Path;

use envs::{Embodiment, TaskRegistry, VecEnvSettings};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rl::{RlError, SacSettings};
use serde::{Deserialize, Serialize};
use symmetry::{D2, Group};

use crate::error::RunError;
use crate::schedule::{StreamClock, TaskSchedule, Timetable, VisitOrder};
use crate::stream::SwitchableVecEnv;
use learner::overrides::{parse_json, read_json};
use learner::{DeviceChoice, GroupingSettings, LearnerSettings, TaskLabel};

/// Number of the ChaCha stream that draws the schedule. The numbers of the experiment's streams are
/// counted down from the top, since the learner's count up from 0 under the same seed.
const SCHEDULE: u64 = u64::MAX;
const ENVIRONMENTS: u64 = u64::MAX - 1;
const EVALUATION: u64 = u64::MAX - 2;
/// Largest distance and half extent of a camera in metres.
const MAX_CAMERA_LENGTH: f64 = 100.0;
/// Number of 32-bit words between consecutive seeds of a ChaCha stream: one block of ChaCha.
const BLOCK: u128 = 16;

/// Settings of a run, as `experiment.json` holds them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Experiment {
    /// Settings of the learner; its seed is the seed of the whole run.
    pub learner: LearnerSettings,
    /// Settings of the environments; `threads` holds for the learner, too, and `seed` must be 0,
    /// since placements follow the run's seed.
    pub envs: VecEnvSettings,
    /// Order and length of the training stream's visits to task groups.
    pub schedule: TaskSchedule,
    /// Number, times and length of the run's evaluations.
    pub evaluation: EvaluationPlan,
    /// Interval and number of the run's checkpoints.
    pub checkpoints: CheckpointPlan,
}

/// Number of rollouts between a run's checkpoints, and number of checkpoints that are kept.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct CheckpointPlan {
    /// Number of rollouts between checkpoints, at least 1; the last rollout is always saved.
    pub every: usize,
    /// Number of newest checkpoints that are kept, at least 1. A run whose newest checkpoint is
    /// damaged resumes from an older one.
    pub keep: usize,
}

impl Default for CheckpointPlan {
    fn default() -> Self {
        Self { every: 10, keep: 3 }
    }
}

/// Number and length of a run's evaluations, each of which plays all four variants of each group.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EvaluationPlan {
    /// Episodes in each environment and variant after the stream, at least 1.
    #[serde(rename = "rounds")]
    pub episodes_per_env: usize,
    /// Episodes in each environment and variant before the stream and after each visit; 0 turns
    /// these evaluations off.
    #[serde(rename = "visit_rounds")]
    pub visit_episodes_per_env: usize,
    /// Rollouts between further evaluations within visits, at least 1, counted from the start of
    /// the stream; `None` for no such evaluations. They play `visit_episodes_per_env` episodes,
    /// which must then be at least 1.
    #[serde(default)]
    pub every: Option<usize>,
    /// Number of times that the learner is asked, after the stream, for the policy of each variant,
    /// with each of 1, 4 and 20 shown episodes. A learner with one policy or with ground truth is
    /// never asked.
    #[serde(default, rename = "looks")]
    pub recognition_repeats: usize,
    /// Seed of the placements, independent of the run's: all methods and seeds are scored on the
    /// same episodes.
    #[serde(default)]
    pub seed: u64,
    /// `true` if each variant is scored at placements of its own. By default, the placements of the
    /// four variants of a group are mirror images of one another, so that their scores differ by
    /// broken symmetries alone; but four such episodes hold hardly more information than one.
    #[serde(default)]
    pub distinct_placements: bool,
}

impl EvaluationPlan {
    /// Evaluation plan with a single evaluation, after the training stream, of one episode in each
    /// environment and variant.
    pub const FINAL_ONLY: Self = Self {
        episodes_per_env: 1,
        visit_episodes_per_env: 0,
        every: None,
        recognition_repeats: 0,
        seed: 0,
        distinct_placements: false,
    };

    /// Returns the number of episodes per environment in the evaluation that is due within a visit,
    /// `rollouts` rollouts after the start of the stream; 0 if none is due.
    pub(crate) fn episodes_per_env_within_visit(&self, rollouts: usize) -> usize {
        let due = |every| rollouts.is_multiple_of(every);
        if self.every.is_some_and(due) { self.visit_episodes_per_env } else { 0 }
    }
}

impl Experiment {
    /// Reads a run's settings from a JSON file, as a run's folder holds them.
    ///
    /// # Errors
    /// [`RunError::Read`] with the file and the problem; for an unknown field it suggests the
    /// nearest known one.
    pub fn read(path: &Path) -> Result<Self, RunError> {
        Ok(read_json(path)?)
    }

    /// Reads a run's settings from JSON text.
    ///
    /// # Errors
    /// [`learner::LearnerError::NotJson`], [`learner::LearnerError::UnknownSetting`],
    /// [`learner::LearnerError::WrongSetting`].
    pub fn parse(text: &str) -> Result<Self, RunError> {
        Ok(parse_json(text)?)
    }

    /// Sets the seed of the run.
    pub fn with_seed(mut self, seed: u64) -> Self {
        self.learner.set_seed(seed);
        self
    }

    /// Sets the number of worker threads, on which results do not depend.
    pub fn with_threads(mut self, threads: usize) -> Self {
        self.envs.threads = threads;
        self
    }

    /// Sets the device that policies are updated on.
    ///
    /// # Errors
    /// Errors of [`LearnerSettings::set_device`].
    pub fn with_device(mut self, choice: DeviceChoice) -> Result<Self, RunError> {
        self.learner.set_device(choice)?;
        Ok(self)
    }

    /// Sets the embodiment of the environments.
    pub fn with_embodiment(mut self, embodiment: Embodiment) -> Self {
        self.envs.embodiment = embodiment;
        self
    }

    /// Sets the symmetry group of the networks and keeps their width; [`Group::C1`] gives ordinary
    /// networks.
    pub fn with_symmetry_group(mut self, group: Group) -> Self {
        self.learner.set_symmetry_group(group);
        self
    }

    /// Rejects settings like [`Experiment::check`], but its errors have the names that parts of the
    /// program have for settings.
    pub(crate) fn check_parts(&self, tasks: &TaskRegistry) -> Result<(), RunError> {
        self.check_counts()?;
        if self.evaluation.every.is_some() && self.evaluation.visit_episodes_per_env == 0 {
            return Err(RunError::invalid(
                "evaluation.visit_rounds",
                "0",
                "at least 1 with `evaluation.every`, whose evaluations use this number",
            ));
        }
        self.schedule.check()?;
        self.schedule.resolve_groups(tasks)?;
        self.check_environment_parts()?;
        self.check_rollouts()?;
        self.check_visits()?;
        self.check_replay()?;
        let spec = SwitchableVecEnv::env_spec(&self.envs);
        self.learner.new_learner(&spec, &TaskLabel::default())?;
        Ok(())
    }

    /// Rejects counts of 0 and counts that no run finishes in any reasonable time.
    fn check_counts(&self) -> Result<(), RunError> {
        let plan = &self.evaluation;
        let (grouping, epochs) = match &self.learner {
            LearnerSettings::Covers(settings) => (settings.grouping, settings.ppo.epochs),
            LearnerSettings::OffPolicy(settings) => (settings.grouping, 1),
        };
        let permutations = match grouping {
            GroupingSettings::Evidence(settings) => settings.permutations,
            _ => 0,
        };
        for (name, value, range, expected) in [
            ("evaluation.rounds", plan.episodes_per_env, 1..=10_000, "1 to 10000"),
            ("evaluation.visit_rounds", plan.visit_episodes_per_env, 0..=10_000, "0 to 10000"),
            ("evaluation.looks", plan.recognition_repeats, 0..=10_000, "0 to 10000"),
            ("evaluation.every", plan.every.unwrap_or(1), 1..=usize::MAX, "at least 1"),
            ("checkpoints.every", self.checkpoints.every, 1..=usize::MAX, "at least 1"),
            ("checkpoints.keep", self.checkpoints.keep, 1..=usize::MAX, "at least 1"),
            ("covers.ppo.epochs", epochs, 0..=10_000, "1 to 10000"),
            ("grouping.evidence.permutations", permutations, 0..=1_000_000, "20 to 1000000"),
        ] {
            if !range.contains(&value) {
                let value = value.to_string();
                return Err(RunError::invalid(name, value, expected));
            }
        }
        Ok(())
    }

    /// Rejects settings like [`Experiment::check_environments`], with the names of
    /// [`Experiment::check_parts`].
    pub(crate) fn check_environment_parts(&self) -> Result<(), RunError> {
        self.envs.check()?;
        self.check_layout()?;
        self.check_camera()?;
        self.check_seed()
    }

    /// Rejects a layout without some of the variants, which evaluations show.
    fn check_layout(&self) -> Result<(), RunError> {
        let layout = self.envs.layout;
        if layout.group_elements() == D2::ALL {
            return Ok(());
        }
        Err(RunError::invalid(
            "envs.layout",
            layout.name(),
            "symmetric: runs are evaluated on all four variants",
        ))
    }

    /// Rejects cameras so far away or with so wide a view that OpenGL overflows.
    fn check_camera(&self) -> Result<(), RunError> {
        let camera = &self.envs.camera;
        for (name, value) in
            [("envs.camera.height", camera.height), ("envs.camera.half_extent", camera.half_extent)]
        {
            if value > MAX_CAMERA_LENGTH {
                return Err(RunError::invalid(name, value, "at most 100 m"));
            }
        }
        Ok(())
    }

    /// Rejects rollouts shorter than an episode: since every rollout begins with a reset, late
    /// states of episodes would never be seen.
    fn check_rollouts(&self) -> Result<(), RunError> {
        let horizon = self.envs.control.decisions_per_episode();
        let steps = self.learner.rollout_steps() / self.envs.num_envs;
        if steps >= horizon {
            return Ok(());
        }
        Err(RlError::ShortRollout { steps, horizon }.into())
    }

    /// Rejects a replay buffer that would store image channels once per episode although they
    /// change within it, or that holds less than a rollout, and a stream that ends before a policy
    /// first acts or takes its first gradient step.
    fn check_replay(&self) -> Result<(), RunError> {
        let LearnerSettings::OffPolicy(settings) = &self.learner else {
            return Ok(());
        };
        let constant_channels = self.envs.camera.extra_views.num_constant_channels();
        let decisions = match settings.grouping {
            GroupingSettings::Single => self.schedule.total_decisions(),
            // both numbers count for each policy
            _ => self.schedule.min_group_decisions(),
        } as u64;
        let (warm_up, burn_in) = (settings.warm_up, settings.sac.burn_in);
        for (name, value, fits, expected) in [
            (
                "off_policy.still_channels",
                settings.still_channels as u64,
                settings.still_channels <= constant_channels,
                "at most 3 where `envs.camera.beside` is `first`, and 0 with close-ups",
            ),
            (
                "off_policy.capacity",
                settings.capacity as u64,
                settings.capacity >= settings.rollout_steps,
                "at least `off_policy.rollout_steps`",
            ),
            (
                "off_policy.warm_up",
                warm_up,
                warm_up < decisions,
                "fewer decisions than the stream has of each group: a policy might never act",
            ),
            (
                "off_policy.sac.burn_in",
                burn_in,
                burn_in < decisions,
                "fewer decisions than the stream has of each group: a policy might never learn",
            ),
        ] {
            if !fits {
                return Err(RunError::invalid(name, value, expected));
            }
        }
        let SacSettings { newest_share, updates_per_step, .. } = settings.sac;
        if newest_share > 0.0 && settings.newest_steps == 0 {
            let expected = "0 where `off_policy.newest_steps` is 0";
            return Err(RunError::invalid("off_policy.sac.newest_share", newest_share, expected));
        }
        if ((decisions - burn_in) as f64) * f64::from(updates_per_step) < 1.0 {
            let (name, expected) =
                ("off_policy.sac.updates_per_step", "enough for a gradient step in each group");
            return Err(RunError::invalid(name, updates_per_step, expected));
        }
        Ok(())
    }

    /// Rejects a seed of the environments, which would have no effect.
    fn check_seed(&self) -> Result<(), RunError> {
        match self.envs.seed {
            0 => Ok(()),
            seed => Err(RunError::invalid(
                "envs.seed",
                seed,
                "0: placements are drawn from the learner's seed",
            )),
        }
    }

    /// Returns the decisions of one episode in all environments together. On
    /// [`StreamClock::EnvironmentTime`], task switches happen at multiples of that number.
    fn block(&self) -> usize {
        self.envs.num_envs * self.envs.control.decisions_per_episode()
    }

    /// Rejects rollouts that would make a stream on [`StreamClock::EnvironmentTime`] depend on the
    /// learner, and visits so short that they would be skipped: shorter than an episode or, on
    /// [`StreamClock::LearnerIterations`], than a rollout.
    fn check_visits(&self) -> Result<(), RunError> {
        let (rollout, block) = (self.learner.rollout_steps(), self.block());
        let (shortest, expected) = match (self.schedule.clock, self.schedule.order) {
            (StreamClock::EnvironmentTime, _) if !rollout.is_multiple_of(block) => {
                return Err(RunError::invalid(
                    "rollout_steps",
                    format!("{rollout}, which is not a multiple of {block}"),
                    "a multiple of `envs.num_envs` times the decisions of an episode \
                        (`--set off_policy.rollout_steps=N`, or `covers.rollout_steps`), or \
                        `--set schedule.clock=turns`",
                ));
            }
            (StreamClock::EnvironmentTime, _) => {
                (block, "at least `envs.num_envs` times the decisions of an episode")
            }
            // random switches happen between rollouts
            (StreamClock::LearnerIterations, VisitOrder::Switching) => return Ok(()),
            (StreamClock::LearnerIterations, _) => {
                (rollout, "at least `rollout_steps` with `schedule.clock` = `turns`")
            }
        };
        let mut plans = self.schedule.groups.iter();
        match plans.find(|plan| plan.decisions < shortest) {
            None => Ok(()),
            Some(plan) => Err(RunError::invalid(
                "schedule.groups",
                format!("{} decisions of {}", plan.decisions, plan.group),
                expected,
            )),
        }
    }

    /// Draws the visits of the training stream to task groups from the run's seed.
    pub(crate) fn timetable(&self) -> Timetable {
        let period = match self.schedule.clock {
            StreamClock::EnvironmentTime => self.block(),
            StreamClock::LearnerIterations => self.learner.rollout_steps(),
        };
        let rng = &mut self.stream_rng(SCHEDULE);
        Timetable::new(self.schedule.draw_visits(period, rng))
    }

    /// Returns the seeds of the training environments, indexed by the decisions so far or, on
    /// [`StreamClock::LearnerIterations`], by the iteration.
    pub(crate) fn environment_seeds(&self) -> SeedSequence {
        SeedSequence(self.stream_rng(ENVIRONMENTS))
    }

    /// Returns the seed of evaluation episodes, which depends on the evaluation plan alone.
    pub fn evaluation_seed(&self) -> u64 {
        random_stream(self.evaluation.seed, EVALUATION).random()
    }

    fn stream_rng(&self, stream: u64) -> ChaCha8Rng {
        random_stream(self.learner.seed(), stream)
    }
}

fn random_stream(seed: u64, stream: u64) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(stream);
    rng
}

/// Sequence of random seeds, of which each can be computed from its index alone, without the
/// earlier ones.
#[derive(Clone, Debug)]
pub(crate) struct SeedSequence(ChaCha8Rng);

impl SeedSequence {
    /// Returns the seed with index `number`, from 0, in the sequence.
    pub fn nth_seed(&self, number: usize) -> u64 {
        let mut rng = self.0.clone();
        rng.set_word_pos(BLOCK * number as u128);
        rng.random()
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::presets::{Budget, Method};
    use envs::Layout;
    use evidence::RecogniserSettings;
    use learner::{CoversSettings, NewPolicyInit, OffPolicySettings};

    fn smoke() -> Experiment {
        Budget::Smoke.preset_experiment(Method::Covers)
    }

    fn covers(experiment: &mut Experiment) -> &mut CoversSettings {
        match &mut experiment.learner {
            LearnerSettings::Covers(settings) => settings,
            other => panic!("{other:?}"),
        }
    }

    fn evidence(permutations: usize) -> GroupingSettings {
        let settings = RecogniserSettings::default();
        GroupingSettings::Evidence(RecogniserSettings { permutations, ..settings })
    }

    #[test]
    fn a_replay_that_would_keep_a_close_up_once_an_episode_is_refused() {
        let tasks = TaskRegistry::with_standard();
        let mut run = Budget::Smoke.preset_experiment(Method::Clear);
        run.envs.camera.extra_views = envs::ExtraViews::CloseUp;
        let message = run.check(&tasks).unwrap_err().to_string();
        assert!(message.contains("`off_policy.still_channels` is 3"), "{message}");
        match &mut run.learner {
            LearnerSettings::OffPolicy(settings) => settings.still_channels = 0,
            other => panic!("{other:?}"),
        }
        assert!(run.check(&tasks).is_ok());
    }

    #[test]
    fn no_two_purposes_share_a_random_stream() {
        let experiment = smoke().with_seed(7);
        let first_words = |mut rng: ChaCha8Rng| -> [u64; 2] { [rng.random(), rng.random()] };
        let seeds = experiment.environment_seeds();
        let seeds = (0..20).map(|number| seeds.nth_seed(number));
        let seeds = seeds.chain([experiment.evaluation_seed()]);
        let slots = seeds.flat_map(|seed| (0..20).map(move |stream| (seed, stream)));
        let slots = slots.map(|(seed, stream)| {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            rng.set_stream(stream);
            rng
        });
        let learner = (0..4).map(|stream| experiment.stream_rng(stream));
        let own = [SCHEDULE, ENVIRONMENTS, EVALUATION].map(|stream| experiment.stream_rng(stream));
        let all: Vec<_> = learner.chain(own).chain(slots).map(first_words).collect();
        let different: std::collections::HashSet<_> = all.iter().collect();
        assert_eq!(different.len(), all.len());
    }

    #[test]
    fn all_runs_are_scored_on_the_same_episodes_unless_told() {
        let seed = |run, evaluation| {
            let mut experiment = smoke().with_seed(run);
            experiment.evaluation.seed = evaluation;
            experiment.evaluation_seed()
        };
        assert_eq!(seed(1, 0), seed(2, 0));
        assert_ne!(seed(1, 0), seed(1, 1));
    }

    #[test]
    fn runs_that_could_not_finish_are_refused() {
        type Spoil = fn(&mut Experiment);
        let cases: [(Spoil, &str); 28] = [
            (|e| e.schedule.cycles = 0, "cycles"),
            (|e| e.evaluation.episodes_per_env = 0, "evaluation.rounds"),
            (|e| e.evaluation.every = Some(0), "evaluation.every"),
            (|e| e.evaluation.every = Some(3), "evaluation.visit_rounds"),
            (|e| e.checkpoints.every = 0, "checkpoints.every"),
            (|e| e.checkpoints.keep = 0, "checkpoints.keep"),
            (|e| e.envs.threads = 0, "threads"),
            (|e| e.envs.num_envs *= 2, "steps end before an episode"),
            (|e| e.envs.camera.size = 44, "44"),
            (|e| e.envs.camera.mark.radius = 3.0, "radius"),
            (|e| e.envs.control.displacement = 4.0, "displacement"),
            (|e| e.envs.layout = Layout::MetaWorld, "expected symmetric"),
            (|e| e.schedule.groups[0].group = "peg-insert".to_owned(), "peg-insert"),
            (|e| covers(e).rollout_steps += 1, "rollout_steps"),
            (|e| e.envs.control.horizon *= 2, "steps end before an episode"),
            (|e| e.envs.seed = 1, "envs.seed"),
            (|e| e.schedule.groups[1].decisions = 79, "79 decisions of button-press"),
            (
                |e| {
                    e.schedule.clock = StreamClock::LearnerIterations;
                    e.schedule.groups[1].decisions = 79;
                },
                "79 decisions of button-press",
            ),
            (|e| covers(e).rollout_steps = 120, "rollout_steps"),
            (
                |e| {
                    covers(e).grouping = GroupingSettings::Oracle;
                    covers(e).new_policy = NewPolicyInit::Copy;
                },
                "new_policy",
            ),
            (
                |e| {
                    covers(e).grouping = GroupingSettings::Single;
                    covers(e).new_policy = NewPolicyInit::Copy;
                },
                "new_policy",
            ),
            (|e| e.evaluation.episodes_per_env = usize::MAX, "evaluation.rounds"),
            (|e| e.evaluation.visit_episodes_per_env = usize::MAX, "evaluation.visit_rounds"),
            (|e| e.evaluation.recognition_repeats = usize::MAX, "evaluation.looks"),
            (|e| covers(e).ppo.epochs = usize::MAX, "epochs"),
            (|e| covers(e).grouping = evidence(usize::MAX), "permutations"),
            (|e| e.envs.camera.height = 1e308, "height"),
            (|e| e.envs.camera.half_extent = 1e308, "half_extent"),
        ];
        for (spoil, named) in cases {
            refused(smoke(), spoil, named);
        }
    }

    #[test]
    fn replays_from_which_nothing_would_be_learnt_are_refused() {
        type Spoil = fn(&mut OffPolicySettings);
        let cases: [(Spoil, &str); 7] = [
            // one group is visited for six rollouts, and the others for two
            (|replay| replay.warm_up = 3 * replay.rollout_steps as u64, "warm_up"),
            (|replay| replay.capacity = replay.rollout_steps - 1, "capacity"),
            (|replay| replay.warm_up = 1_000_000, "warm_up"),
            (|replay| replay.sac.burn_in = 1_000_000, "burn_in"),
            (|replay| replay.sac.burn_in = 3 * replay.rollout_steps as u64, "burn_in"),
            (|replay| replay.sac.updates_per_step = 0.0, "updates_per_step"),
            (|replay| (replay.sac.newest_share, replay.newest_steps) = (0.5, 0), "newest_share"),
        ];
        for (spoil, named) in cases {
            let mut sac = Budget::Smoke.preset_experiment(Method::CoversSac).with_threads(1);
            sac.schedule.groups[0].decisions *= 3;
            let spoil_learner = |e: &mut Experiment| match &mut e.learner {
                LearnerSettings::OffPolicy(settings) => spoil(settings),
                other => panic!("{other:?}"),
            };
            refused(sac, spoil_learner, named);
        }
    }

    /// Checks that settings are accepted before a change, and refused after it by these words.
    fn refused(mut experiment: Experiment, spoil: impl FnOnce(&mut Experiment), named: &str) {
        let tasks = TaskRegistry::with_standard();
        experiment.check(&tasks).unwrap();
        spoil(&mut experiment);
        let message = experiment.check(&tasks).unwrap_err().to_string();
        assert!(message.contains(named), "{named}: {message}");
    }

    #[test]
    fn a_field_that_is_there_twice_is_refused() {
        let text = serde_json::to_string(&smoke()).unwrap();
        let twice = text.replace("\"cycles\":1", "\"cycles\":1,\"cycles\":2");
        assert_ne!(twice, text);
        let message = Experiment::parse(&twice).unwrap_err().to_string();
        assert!(message.contains("duplicate field `cycles`"), "{message}");
    }
}
