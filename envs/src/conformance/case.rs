//! One variant of one scene to test, and random actions to drive it.

use std::fmt;
use std::sync::Arc;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use symmetry::D2;

use crate::control::ControlSettings;
use crate::error::EnvError;
use crate::scene::Scene;
use crate::tabletop::{ACTION_DIM, StepResult, TableTop, VECTOR_OBSERVATION_DIM};

/// Outcome of testing a conformance rule: `None` if it holds, or a description of the violation.
pub(super) type RuleResult = Result<Option<String>, EnvError>;

/// Returns the description `finding()` of a rule's violation, or `None` if the rule `holds`.
pub(super) fn unless(holds: bool, finding: impl FnOnce() -> String) -> Option<String> {
    (!holds).then(finding)
}

/// Variant of a scene that the conformance rules are tested on.
pub(super) struct Case {
    pub scene: Arc<Scene>,
    pub element: D2,
}

impl Case {
    pub(super) fn table(&self) -> Result<TableTop, EnvError> {
        TableTop::new(Arc::clone(&self.scene), self.scene.layout.control_settings())
    }

    /// Returns an environment at the start of the episode of `seed`.
    pub(super) fn started(&self, seed: u64) -> Result<TableTop, EnvError> {
        let mut table = self.table()?;
        self.reset(&mut table, seed)?;
        Ok(table)
    }

    pub(super) fn reset(&self, table: &mut TableTop, seed: u64) -> Result<(), EnvError> {
        table.reset(self.element, &mut ChaCha8Rng::seed_from_u64(seed))
    }

    pub(super) fn decisions_per_episode(&self) -> usize {
        self.scene.layout.control_settings().decisions_per_episode()
    }

    /// Returns the layout's action settings, changed to one decision in each control step.
    pub(super) fn fine_control(&self) -> ControlSettings {
        let control = self.scene.layout.control_settings();
        ControlSettings {
            action_repeat: 1,
            displacement: control.displacement / control.action_repeat as f64,
            ..control
        }
    }

    pub(super) fn random_actions(&self, seed: u64) -> RandomActions {
        RandomActions::new(seed, &self.scene.layout.control_settings())
    }
}

impl RandomActions {
    /// Creates random actions for an environment with the action settings `control`.
    pub(super) fn new(seed: u64, control: &ControlSettings) -> Self {
        Self {
            rng: ChaCha8Rng::seed_from_u64(seed),
            action: [0.0; ACTION_DIM],
            // 10 control steps are a decision of the symmetric layout; Meta-World's is one control
            // step
            hold: (10 / control.action_repeat).max(1),
            decision: 0,
        }
    }
}

impl fmt::Display for Case {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let Scene { layout, embodiment, group, .. } = *self.scene;
        write!(f, "{group} {}, {embodiment}, {layout}", self.element)
    }
}

/// Random actions, each held for an eighth of a second as decisions of the symmetric layout are.
/// Half of the components are at their limits.
pub(super) struct RandomActions {
    rng: ChaCha8Rng,
    action: [f32; ACTION_DIM],
    /// Number of decisions that a random action is held for.
    hold: usize,
    decision: usize,
}

impl RandomActions {
    pub(super) fn next(&mut self) -> [f32; ACTION_DIM] {
        if self.decision.is_multiple_of(self.hold) {
            self.action =
                std::array::from_fn(|_| self.rng.random_range(-2.0_f32..2.0).clamp(-1.0, 1.0));
        }
        self.decision += 1;
        self.action
    }
}

/// Vector observation, reward and flags of one decision, as bits for exact comparison.
pub(super) type Bits = ([u32; VECTOR_OBSERVATION_DIM], u64, [bool; 3]);

/// Takes `decisions` random decisions in `table` and returns the outcome of each, without pictures.
pub(super) fn run(
    table: &mut TableTop,
    actions: &mut RandomActions,
    decisions: usize,
) -> Result<Vec<Bits>, EnvError> {
    let decide = |_| {
        let StepResult { reward, success, success_at_end, truncated } =
            table.step(&actions.next())?;
        let vector = table.observe()?.map(f32::to_bits);
        Ok((vector, reward.to_bits(), [success, success_at_end, truncated]))
    };
    (0..decisions).map(decide).collect()
}
