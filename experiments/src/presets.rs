//! Experiments as they come: a method, and how long it may take.

use clap::ValueEnum;
use envs::{Beside, Randomisation, TaskGroup, VecEnvSettings};
use rl::{NetworkSettings, PpoSettings, SymmetryLoss};
use serde::{Deserialize, Serialize};
use symmetry::{D2, Group};

use crate::experiment::{CheckpointPlan, EvaluationPlan, Experiment};
use crate::schedule::Schedule;
use learner::{CoversSettings, GroupingSettings, LearnerSettings, OffPolicySettings};

/// Environments of every method: a rollout of 500 decisions is an episode of each.
const NUM_ENVS: usize = 10;
/// Side of the paper's pictures (pixels).
const PAPER_PICTURES: usize = 128;
/// Pixels that are drawn along each side of one that is seen.
const OVERSAMPLING: usize = 3;

/// The methods of the paper's table, each one value of configuration.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Method {
    /// COVERS: D2-equivariant policies, grouped by distances.
    Covers,
    /// COVERS with ground truth: the same policies, grouped by labels.
    CoversGt,
    /// COVERS with ordinary networks of equal width, grouped by distances.
    CoversCnn,
    /// COVERS with ordinary networks of about as many parameters, half as wide.
    CoversCnnSlim,
    /// COVERS that learns from randomised pictures, as those of a real camera, without close-ups.
    CoversRandomised,
    /// One D2-equivariant policy for everything.
    Equi,
    /// One ordinary policy for everything.
    Cnn,
    /// COVERS with ordinary networks that pay for what is not equivariant.
    CnnDrac,
    /// Soft actor-critic with a replay: one ordinary policy for everything.
    Clear,
    /// CLEAR with cloning of the actions in its replay.
    ClearBc,
    /// CLEAR with a recurrent context.
    #[value(name = "3rl")]
    #[serde(rename = "3rl")]
    ThreeRl,
    /// Soft actor-critic with D2-equivariant policies and a replay for each, grouped by distances.
    EquiSac,
    /// COVERS read literally: the paper's network, pictures, rule and hyper-parameters. Slow.
    Paper,
}

impl Method {
    /// Every method.
    pub const ALL: [Self; 13] = [
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
        Self::Paper,
    ];

    /// The name as options spell it.
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
            Self::Paper => "paper",
        }
    }

    /// The learner's settings.
    pub fn learner(self) -> LearnerSettings {
        LearnerSettings::OffPolicy(match self {
            Self::Clear => OffPolicySettings::clear(),
            Self::ClearBc => OffPolicySettings::clear_bc(),
            Self::ThreeRl => OffPolicySettings::three_rl(),
            Self::EquiSac => OffPolicySettings::equi_sac(),
            _ => return LearnerSettings::Covers(self.covers()),
        })
    }

    /// COVERS, or what differs from it in its settings.
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

    /// The method that a run is of: its learner and its environments are those of the method's
    /// preset, under some budget. The stream, the evaluation and the checkpoints belong to no
    /// method; seeds and threads do not count. None for settings of one's own.
    pub fn of(run: &Experiment) -> Option<Self> {
        let is = |method: &Self| {
            let mut budgets = Budget::value_variants().iter();
            budgets.any(|budget| budget.preset_like(*method, run) == *run)
        };
        Self::ALL.into_iter().find(is)
    }

    /// Whether pictures have close-ups. Randomised ones have none. A replay holds what stands still
    /// once an episode, and would hold close-ups with every step. The table's runs are kept, and
    /// older.
    fn shows_close_ups(self, budget: Budget) -> bool {
        let without = [
            Self::CoversRandomised,
            Self::Clear,
            Self::ClearBc,
            Self::ThreeRl,
            Self::EquiSac,
            Self::Paper,
        ];
        budget != Budget::Table && !without.contains(&self)
    }

    fn envs(self, budget: Budget) -> VecEnvSettings {
        let mut envs = VecEnvSettings { num_envs: NUM_ENVS, ..VecEnvSettings::default() };
        match self {
            Self::Paper => envs.camera.size = PAPER_PICTURES,
            Self::CoversRandomised => envs.randomisation = Some(Randomisation::NOMINAL),
            _ => {}
        }
        if self.shows_close_ups(budget) {
            envs.camera.oversampling = OVERSAMPLING;
            envs.camera.beside = Beside::CloseUp;
        }
        envs
    }
}

/// With a loss of broken symmetries, which runs every decision twice, in half as many passes: a
/// decision goes through at most as many gradients as with other methods.
fn symmetrised(ppo: PpoSettings) -> PpoSettings {
    PpoSettings { epochs: ppo.epochs / 2, symmetry: Some(SymmetryLoss::default()), ..ppo }
}

/// An ordinary network of half the width of the default one: a kernel between regular fields of D2
/// has a quarter of the numbers of an ordinary one, so both have about as many parameters.
fn slim() -> NetworkSettings {
    NetworkSettings { group: Group::C1, ..NetworkSettings::strided(vec![2, 4, 8, 8], 16) }
}

/// How long a run may take.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Budget {
    /// Seconds; shows that every part works. Nothing is learnt.
    Smoke,
    /// Minutes; every group twice, which is enough to tell all four apart.
    Short,
    /// Less than ten minutes of learning; every group three times, and more of the two that take
    /// longer.
    Full,
    /// What a table of methods takes: 204,000 decisions, pictures without close-ups, 100 episodes of
    /// each group and variant in the end, and cheap evaluations in between
    /// (docs/results/protocol.md).
    Table,
    /// Every group twice, 174,000 decisions, and only one variant of each is learnt; the others
    /// appear in evaluations.
    ZeroShot,
}

impl Budget {
    /// The name as options spell it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Smoke => "smoke",
            Self::Short => "short",
            Self::Full => "full",
            Self::Table => "table",
            Self::ZeroShot => "zero-shot",
        }
    }

    /// The run of a method.
    pub fn experiment(self, method: Method) -> Experiment {
        let (mut learner, mut envs) = (method.learner(), method.envs(self));
        if self == Self::Smoke {
            envs.num_envs = 8;
            envs.control.horizon = 100;
            hurry(&mut learner);
        }
        let rollout = learner.rollout_steps();
        Experiment {
            learner,
            envs,
            schedule: self.schedule(rollout),
            evaluation: self.evaluation(),
            checkpoints: CheckpointPlan {
                every: if self == Self::Smoke { 3 } else { 20 },
                ..CheckpointPlan::default()
            },
        }
    }

    /// The preset of a method with the stream, the evaluation, the checkpoints, the seed and the
    /// threads of a run.
    pub fn preset_like(self, method: Method, run: &Experiment) -> Experiment {
        let preset = self.experiment(method).with_seed(run.learner.seed());
        Experiment {
            schedule: run.schedule.clone(),
            evaluation: run.evaluation,
            checkpoints: run.checkpoints,
            ..preset.with_threads(run.envs.threads)
        }
    }

    /// The stream; the shortest one is for learners with rollouts of this many decisions.
    fn schedule(self, rollout: usize) -> Schedule {
        let (cycles, visits) = match self {
            Self::Smoke => (1, [2, 2, 2, 2]),
            Self::Short => (2, [4, 12, 6, 28]),
            Self::Full => (3, [4, 12, 6, 31]),
            Self::Table => (3, [6, 18, 9, 35]),
            Self::ZeroShot => (2, [8, 27, 12, 40]),
        };
        let unit = if self == Self::Smoke { rollout } else { 1000 };
        let decisions = visits.map(|visit| visit * unit);
        let visits: Vec<_> = TaskGroup::STANDARD.into_iter().zip(decisions).collect();
        let mut schedule = Schedule::shuffled(cycles, &visits);
        if self == Self::ZeroShot {
            for plan in &mut schedule.groups {
                plan.variants = vec![D2::Identity];
            }
        }
        schedule
    }

    fn evaluation(self) -> EvaluationPlan {
        match self {
            Self::Smoke => EvaluationPlan { looks: 1, ..EvaluationPlan::AT_THE_END },
            Self::Short => EvaluationPlan { rounds: 2, ..EvaluationPlan::AT_THE_END },
            Self::Full | Self::ZeroShot => EvaluationPlan {
                rounds: 4,
                // as many, so that what is forgotten by the end shows on the same episodes
                visit_rounds: 4,
                ..EvaluationPlan::AT_THE_END
            },
            // of 10 environments each; an evaluation plays a fifth of the last one's episodes
            Self::Table => EvaluationPlan {
                rounds: 10,
                visit_rounds: 2,
                looks: 10,
                ..EvaluationPlan::AT_THE_END
            },
        }
    }
}

/// Short rollouts of eight environments and little to do with each, but something of everything.
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
