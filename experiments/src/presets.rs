//! Preset experiments: a method and a budget.

use clap::ValueEnum;
use envs::{ExtraViews, TaskGroup, VecEnvSettings, VisualDomainRandomisation};
use rl::{NetworkSettings, PpoSettings, SymmetryLossSettings};
use serde::{Deserialize, Serialize};
use symmetry::{D2, Group};

use crate::experiment::{CheckpointPlan, EvaluationPlan, Experiment};
use crate::schedule::TaskSchedule;
use learner::overrides::SettingOverride;
use learner::{CoversSettings, GroupingSettings, LearnerSettings, OffPolicySettings};

/// Number of environments of a run, so that a rollout of 500 decisions in all is one episode of 50
/// in each.
const NUM_ENVS: usize = 10;
/// Width and height of the camera images in the paper (pixels).
const PAPER_PICTURES: usize = 128;
/// Rendered pixels along each side of one pixel of an observation.
const OVERSAMPLING: usize = 3;

/// Method by which a run trains, such as COVERS or CLEAR, defined by its settings alone.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// COVERS with PPO, as in the paper: D2-equivariant policies; distances assign rollouts to
    /// them.
    Covers,
    /// COVERS with ground truth: group labels assign rollouts to D2-equivariant policies.
    CoversGt,
    /// COVERS with ordinary networks of equal width; distances assign rollouts to policies.
    CoversCnn,
    /// COVERS with ordinary networks of half the width, with about as many parameters.
    CoversCnnSlim,
    /// COVERS trained on randomised images, like those of a real camera, without close-ups.
    CoversRandomised,
    /// One D2-equivariant policy for all groups.
    Equi,
    /// One policy with an ordinary convolutional network for all groups.
    Cnn,
    /// COVERS with ordinary networks and a loss that penalises broken symmetries.
    CnnDrac,
    /// CLEAR: soft actor-critic with a replay buffer, one ordinary policy for all groups.
    Clear,
    /// CLEAR with behavioural cloning of the actions in its replay buffer.
    ClearBc,
    /// 3RL: CLEAR with a recurrent context of the last few steps.
    #[value(name = "3rl")]
    #[serde(rename = "3rl")]
    ThreeRl,
    /// Soft actor-critic with D2-equivariant policies, each with a replay buffer, assigned as in
    /// COVERS.
    EquiSac,
    /// COVERS with soft actor-critic: learns from fewer decisions than `covers`.
    #[default]
    CoversSac,
    /// COVERS as published: the paper's network, image size, assignment rule and hyper-parameters;
    /// slow.
    Paper,
}

impl Method {
    /// All methods, each of which has a preset.
    pub const ALL: [Self; 14] = [
        Self::Covers,
        Self::CoversGt,
        Self::CoversCnn,
        Self::CoversCnnSlim,
        Self::CoversRandomised,
        Self::Equi,
        Self::Cnn,
        Self::CnnDrac,
        Self::Clear,
        Self::ClearBc,
        Self::ThreeRl,
        Self::EquiSac,
        Self::CoversSac,
        Self::Paper,
    ];

    /// Returns the method's name on the command line and in settings.
    pub fn name(self) -> &'static str {
        match self {
            Self::Covers => "covers",
            Self::CoversGt => "covers-gt",
            Self::CoversCnn => "covers-cnn",
            Self::CoversCnnSlim => "covers-cnn-slim",
            Self::CoversRandomised => "covers-randomised",
            Self::Equi => "equi",
            Self::Cnn => "cnn",
            Self::CnnDrac => "cnn-drac",
            Self::Clear => "clear",
            Self::ClearBc => "clear-bc",
            Self::ThreeRl => "3rl",
            Self::EquiSac => "equi-sac",
            Self::CoversSac => "covers-sac",
            Self::Paper => "paper",
        }
    }

    /// Returns the settings of the method's learner for the standard four groups, as all budgets of
    /// these but `smoke` have them.
    pub fn learner_settings(self) -> LearnerSettings {
        LearnerSettings::OffPolicy(match self {
            Self::Clear => OffPolicySettings::clear_baseline(),
            Self::ClearBc => OffPolicySettings::clear_baseline_with_cloning(),
            Self::ThreeRl => OffPolicySettings::three_rl_baseline(),
            Self::EquiSac => OffPolicySettings::equi_sac(),
            Self::CoversSac => OffPolicySettings::covers_sac(),
            _ => return LearnerSettings::Covers(self.covers()),
        })
    }

    /// Returns the settings of COVERS with the changes that define this method.
    fn covers(self) -> CoversSettings {
        let mut settings = match self {
            Self::Paper => CoversSettings::paper(),
            _ => CoversSettings::default(),
        };
        let plain = [Self::CoversCnn, Self::Cnn, Self::CnnDrac];
        if plain.contains(&self) {
            settings.network.group = Group::C1;
        }
        match self {
            Self::CoversCnnSlim => settings.network = slim(),
            Self::CoversGt => settings.grouping = GroupingSettings::Oracle,
            Self::Equi | Self::Cnn => settings.grouping = GroupingSettings::Single,
            Self::CnnDrac => settings.ppo = symmetrised(settings.ppo),
            _ => {}
        }
        settings
    }

    /// Returns the method whose preset has the run's learner and environments, under any budget;
    /// `None` for custom settings. Seed, threads, stream, evaluation and checkpoints may differ.
    pub fn from_experiment(run: &Experiment) -> Option<Self> {
        let is = |method: &Self| {
            let mut budgets = Budget::value_variants().iter();
            budgets.any(|budget| budget.preset_with_run_settings(*method, run) == *run)
        };
        Self::ALL.into_iter().find(is)
    }

    /// Returns the settings of a run, changed by `overrides`, with the noise that this method's
    /// preset has for the run's stream, unless an override sets the noise.
    pub fn adapt_to_stream(self, mut run: Experiment, overrides: &[SettingOverride]) -> Experiment {
        if !overrides.iter().any(|change| change.sets("off_policy.noise_correlation")) {
            adapt_noise(&mut run.learner, self, &run.schedule);
        }
        run
    }

    /// Returns `true` if the method's observations include a close-up of the table below the hand.
    fn shows_close_ups(self, budget: Budget) -> bool {
        // Close-ups cannot be randomised. A replay buffer stores still channels once per episode,
        // but would store close-ups with every step. The published runs of the table had none.
        let without = [
            Self::CoversRandomised,
            Self::Clear,
            Self::ClearBc,
            Self::ThreeRl,
            Self::EquiSac,
            Self::Paper,
        ];
        budget != Budget::TableProtocol && !without.contains(&self)
    }

    fn envs(self, budget: Budget) -> VecEnvSettings {
        let mut envs = VecEnvSettings { num_envs: NUM_ENVS, ..VecEnvSettings::default() };
        match self {
            Self::Paper => envs.camera.size = PAPER_PICTURES,
            Self::CoversRandomised => envs.randomisation = Some(VisualDomainRandomisation::NOMINAL),
            _ => {}
        }
        if self.shows_close_ups(budget) {
            envs.camera.oversampling = OVERSAMPLING;
            envs.camera.extra_views = ExtraViews::CloseUp;
        }
        envs
    }
}

/// Adds a loss that penalises broken symmetries to PPO and halves the epochs. The loss evaluates
/// every decision twice, so each still contributes to at most as many gradients as with other
/// methods.
fn symmetrised(ppo: PpoSettings) -> PpoSettings {
    PpoSettings { epochs: ppo.epochs / 2, symmetry: Some(SymmetryLossSettings::default()), ..ppo }
}

/// Returns the settings of an ordinary network of half the default width. A kernel between regular
/// fields of D2 has a quarter of the parameters of an ordinary one, so both networks have about as
/// many.
fn slim() -> NetworkSettings {
    NetworkSettings {
        group: Group::C1,
        ..NetworkSettings::with_strided_encoder(vec![2, 4, 8, 8], 16)
    }
}

/// Size of a preset run: its task groups, number of training decisions, and evaluations.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Budget {
    /// Run of seconds: a test that every part works, too short to train a policy.
    Smoke,
    /// Run of minutes: two visits of every group, enough to distinguish all four. Visits of
    /// `covers-sac` are shorter than those of other methods, as in `full` and `zero-shot`.
    Short,
    /// Less than ten minutes of training: three visits of every group, longer ones for the two
    /// harder groups.
    Full,
    /// Protocol of the table of methods (docs/results/protocol.md): 204,000 decisions, images
    /// without close-ups, 100 final episodes of each group and variant, cheap evaluations between.
    #[value(name = "table")]
    #[serde(rename = "table")]
    TableProtocol,
    /// Training on one variant of each group, two visits each, 174,000 decisions (40,000 of
    /// `covers-sac`); the other variants appear in evaluations only.
    ZeroShot,
    /// Ten groups in which nothing is held, two visits each, 886,000 decisions
    /// (228,000 of `covers-sac`).
    Ten,
    /// The ten groups of Meta-World's MT10, two visits each, 1,000,000 decisions (370,000
    /// of `covers-sac`).
    Mt10,
    /// All fourteen groups, two visits each, 1,370,000 decisions (440,000 of `covers-sac`).
    All,
}

impl Budget {
    /// Returns the budget's name on the command line and in settings.
    pub fn name(self) -> &'static str {
        match self {
            Self::Smoke => "smoke",
            Self::Short => "short",
            Self::Full => "full",
            Self::TableProtocol => "table",
            Self::ZeroShot => "zero-shot",
            Self::Ten => "ten",
            Self::Mt10 => "mt10",
            Self::All => "all",
        }
    }

    /// Returns the settings of a run of `method` under this budget.
    pub fn preset_experiment(self, method: Method) -> Experiment {
        let (mut learner, mut envs) = (method.learner_settings(), method.envs(self));
        if self == Self::Smoke {
            envs.num_envs = 8;
            envs.control.horizon = 100;
            hurry(&mut learner);
        }
        let schedule = self.schedule(method, learner.rollout_steps());
        adapt_noise(&mut learner, method, &schedule);
        Experiment {
            learner,
            envs,
            schedule,
            evaluation: self.evaluation(),
            checkpoints: CheckpointPlan {
                every: if self == Self::Smoke { 3 } else { 20 },
                ..CheckpointPlan::default()
            },
        }
    }

    /// Returns the preset of a method with the stream, evaluation, checkpoints, seed and threads of
    /// `run`. If `run` assigns policies by a rule that only earlier versions had, the preset takes
    /// that rule, too.
    pub fn preset_with_run_settings(self, method: Method, run: &Experiment) -> Experiment {
        let mut preset = self.preset_experiment(method).with_seed(run.learner.seed());
        preset.learner.copy_removed_grouping_from(&run.learner);
        adapt_noise(&mut preset.learner, method, &run.schedule);
        Experiment {
            schedule: run.schedule.clone(),
            evaluation: run.evaluation,
            checkpoints: run.checkpoints,
            ..preset.with_threads(run.envs.threads)
        }
    }

    /// Returns the schedule of task groups that a run of `method` trains on. The smoke budget's
    /// visits last whole rollouts, of `rollout` decisions.
    fn schedule(self, method: Method, rollout: usize) -> TaskSchedule {
        let unit = if self == Self::Smoke { rollout } else { 1000 };
        // of Goal Reach, Button Press, Drawer Close and Plate Slide, in units
        let standard = |visits: [usize; 4]| {
            TaskGroup::STANDARD.into_iter().zip(visits.map(|visit| visit * unit)).collect()
        };
        let learns_fast = method == Method::CoversSac;
        let long = |groups: &[TaskGroup]| {
            groups.iter().map(|&group| (group, long_visit(group, learns_fast))).collect()
        };
        let visits: Vec<_> = match self {
            Self::Smoke => standard([2, 2, 2, 2]),
            Self::Short if learns_fast => standard([3, 5, 4, 8]),
            Self::Full if learns_fast => standard([4, 6, 3, 8]),
            Self::ZeroShot if learns_fast => standard([3, 6, 3, 8]),
            Self::Short => standard([4, 12, 6, 28]),
            Self::Full => standard([4, 12, 6, 31]),
            Self::TableProtocol => standard([6, 18, 9, 35]),
            Self::ZeroShot => standard([8, 27, 12, 40]),
            Self::Ten => long(&TaskGroup::TEN_WITHOUT_GRASPING),
            Self::Mt10 => long(&TaskGroup::MT10),
            Self::All => long(&TaskGroup::ALL),
        };
        let cycles = match self {
            Self::Smoke => 1,
            Self::Full | Self::TableProtocol => 3,
            Self::Short | Self::ZeroShot | Self::Ten | Self::Mt10 | Self::All => 2,
        };
        let mut schedule = TaskSchedule::shuffled(cycles, &visits);
        if self == Self::ZeroShot {
            for plan in &mut schedule.groups {
                plan.variants = vec![D2::Identity];
            }
        }
        schedule
    }

    fn evaluation(self) -> EvaluationPlan {
        match self {
            Self::Smoke => EvaluationPlan { recognition_repeats: 1, ..EvaluationPlan::FINAL_ONLY },
            Self::Short => EvaluationPlan { episodes_per_env: 2, ..EvaluationPlan::FINAL_ONLY },
            Self::Full | Self::ZeroShot => EvaluationPlan {
                episodes_per_env: 4,
                // as many as in the end, so that forgetting is measured on the same episodes
                visit_episodes_per_env: 4,
                ..EvaluationPlan::FINAL_ONLY
            },
            // an evaluation after each of 20 visits plays all groups seen so far
            Self::Ten | Self::Mt10 | Self::All => EvaluationPlan {
                episodes_per_env: 2,
                visit_episodes_per_env: 2,
                ..EvaluationPlan::FINAL_ONLY
            },
            // 10 rounds of 10 environments give 100 episodes; evaluations between play a fifth
            Self::TableProtocol => EvaluationPlan {
                episodes_per_env: 10,
                visit_episodes_per_env: 2,
                recognition_repeats: 10,
                ..EvaluationPlan::FINAL_ONLY
            },
        }
    }
}

/// Lets the noise of `covers-sac` last where the stream has other groups than the standard four:
/// handles are pulled in some of them, which independent noise rarely does by chance
/// (docs/results/efficiency.md, "Noise that lasts").
fn adapt_noise(learner: &mut LearnerSettings, method: Method, schedule: &TaskSchedule) {
    let is_standard = |name: &String| TaskGroup::STANDARD.iter().any(|group| group.name() == name);
    let has_others = !schedule.groups.iter().all(|plan| is_standard(&plan.group));
    if let (LearnerSettings::OffPolicy(settings), Method::CoversSac) = (learner, method) {
        settings.noise_correlation = if has_others { 0.5 } else { 0.0 };
    }
}

/// Returns the length of a visit (decisions) in streams of ten groups or more.
fn long_visit(group: TaskGroup, learns_fast: bool) -> usize {
    // odd multiples of an episode in each of ten environments: rollouts of two episodes, as the
    // paper's, span task switches; rollouts of methods that learn fast are single episodes
    let known_lengths = [
        (TaskGroup::GOAL_REACH, [6_500, 3_500]),
        (TaskGroup::BUTTON_PRESS, [18_500, 6_500]),
        (TaskGroup::DRAWER_CLOSE, [9_500, 6_500]),
        (TaskGroup::PLATE_SLIDE, [45_500, 9_500]),
        (TaskGroup::DOOR_OPEN, [60_500, 40_500]),
        (TaskGroup::PUSH, [60_500, 15_500]),
        (TaskGroup::PICK_PLACE, [60_500, 40_500]),
        (TaskGroup::PEG_INSERT_SIDE, [60_500, 40_500]),
    ];
    let found = known_lengths.into_iter().find(|(known, _)| *known == group);
    let [others, fast] = found.map_or([60_500, 9_500], |(_, lengths)| lengths);
    if learns_fast { fast } else { others }
}

/// Shortens rollouts to eight environments times ten decisions, and updates to a minimum that still
/// runs every part.
fn hurry(learner: &mut LearnerSettings) {
    const ROLLOUT: usize = 8 * 10;
    match learner {
        LearnerSettings::Covers(settings) => {
            settings.rollout_steps = ROLLOUT;
            settings.ppo.epochs = 1;
        }
        LearnerSettings::OffPolicy(settings) => {
            settings.rollout_steps = ROLLOUT;
            settings.capacity = 3 * ROLLOUT;
            settings.warm_up = 40;
            settings.newest_steps = 40;
            settings.sac.burn_in = ROLLOUT as u64;
            settings.sac.batch = 32;
            settings.sac.updates_per_step = 0.05;
        }
    }
}

#[cfg(test)]
mod tests;
