//! Experiments as they come: a method, and how long it may take.

use clap::ValueEnum;
use envs::{TaskGroup, VecEnvSettings};
use serde::{Deserialize, Serialize};
use symmetry::{D2, Group};

use crate::experiment::{CheckpointPlan, EvaluationPlan, Experiment};
use crate::groupings::GroupingSettings;
use crate::learners::{CoversSettings, LearnerSettings};
use crate::schedule::Schedule;

/// Side of the paper's pictures (pixels).
const PAPER_PICTURES: usize = 128;

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
    /// One D2-equivariant policy for everything.
    Equi,
    /// One ordinary policy for everything.
    Cnn,
    /// COVERS read literally: the paper's network, pictures, rule and hyper-parameters. Slow.
    Paper,
}

impl Method {
    /// Every method.
    pub const ALL: [Self; 6] = [
        Self::Covers,
        Self::CoversGt,
        Self::CoversCnn,
        Self::Equi,
        Self::Cnn,
        Self::Paper,
    ];

    /// The name as options spell it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Covers => "covers",
            Self::CoversGt => "covers-gt",
            Self::CoversCnn => "covers-cnn",
            Self::Equi => "equi",
            Self::Cnn => "cnn",
            Self::Paper => "paper",
        }
    }

    /// The learner's settings.
    pub fn learner(self) -> CoversSettings {
        let mut settings = match self {
            Self::Paper => CoversSettings::paper(),
            _ => CoversSettings::default(),
        };
        if matches!(self, Self::CoversCnn | Self::Cnn) {
            settings.network.group = Group::C1;
        }
        match self {
            Self::CoversGt => settings.grouping = GroupingSettings::Oracle,
            Self::Equi | Self::Cnn => settings.grouping = GroupingSettings::Single,
            Self::Covers | Self::CoversCnn | Self::Paper => {}
        }
        settings
    }

    fn envs(self) -> VecEnvSettings {
        let mut envs = VecEnvSettings::default();
        if self == Self::Paper {
            envs.camera.size = PAPER_PICTURES;
        }
        envs
    }
}

/// How long a run may take.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum, Serialize, Deserialize)]
#[serde(rename_all = "kebab-case")]
pub enum Budget {
    /// Seconds; shows that every part works. Nothing is learnt.
    Smoke,
    /// Minutes; learns Goal Reach and Drawer Close and tells all four groups apart.
    Short,
    /// About half an hour on two busy cores; every group three times, and more of the two that take
    /// longer.
    Full,
    /// As `full`, but every group twice, and only one variant of each is learnt; the others appear
    /// in evaluations.
    ZeroShot,
}

impl Budget {
    /// The name as options spell it.
    pub fn name(self) -> &'static str {
        match self {
            Self::Smoke => "smoke",
            Self::Short => "short",
            Self::Full => "full",
            Self::ZeroShot => "zero-shot",
        }
    }

    /// The run of a method.
    pub fn experiment(self, method: Method) -> Experiment {
        let (mut learner, mut envs) = (method.learner(), method.envs());
        if self == Self::Smoke {
            envs.num_envs = 8;
            envs.control.horizon = 100;
            learner.rollout_steps = 8 * 10;
            learner.ppo.epochs = 1;
        }
        let rollout = learner.rollout_steps;
        Experiment {
            learner: LearnerSettings::Covers(learner),
            envs,
            schedule: self.schedule(rollout),
            evaluation: self.evaluation(),
            checkpoints: CheckpointPlan {
                every: if self == Self::Smoke { 3 } else { 10 },
                ..CheckpointPlan::default()
            },
        }
    }

    /// The stream of learners with rollouts of this many decisions.
    fn schedule(self, rollout: usize) -> Schedule {
        let (cycles, rollouts) = match self {
            Self::Smoke => (1, [2, 2, 2, 2]),
            Self::Short => (2, [10, 5, 14, 5]),
            Self::Full => (3, [8, 36, 12, 40]),
            Self::ZeroShot => (2, [8, 36, 12, 40]),
        };
        let decisions = rollouts.map(|rollouts| rollouts * rollout);
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
            Self::Smoke | Self::Short => EvaluationPlan::AT_THE_END,
            Self::Full | Self::ZeroShot => EvaluationPlan {
                rounds: 2,
                // as many, so that what is forgotten by the end shows on the same episodes
                visit_rounds: 2,
                ..EvaluationPlan::AT_THE_END
            },
        }
    }
}

#[cfg(test)]
mod tests {
    use envs::TaskRegistry;

    use super::*;

    #[test]
    fn every_preset_is_a_run_that_can_be_finished() {
        for method in Method::ALL {
            for budget in Budget::value_variants() {
                let experiment = budget.experiment(method);
                experiment.check(&TaskRegistry::standard()).unwrap();
            }
            let option = method.to_possible_value().unwrap();
            assert_eq!(option.get_name(), method.name());
        }
        for budget in Budget::value_variants() {
            let option = budget.to_possible_value().unwrap();
            assert_eq!(option.get_name(), budget.name());
        }
    }

    #[test]
    fn methods_differ_in_networks_and_groupings_alone() {
        let covers = Method::Covers.learner();
        for method in [
            Method::CoversGt,
            Method::CoversCnn,
            Method::Equi,
            Method::Cnn,
        ] {
            let mut settings = method.learner();
            assert_ne!(settings, covers, "{method:?}");
            settings.network.group = covers.network.group;
            settings.grouping = covers.grouping;
            assert_eq!(settings, covers, "{method:?}");
        }
    }
}
