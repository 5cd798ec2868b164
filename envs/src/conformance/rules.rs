//! Conformance rules for variants, and the check that applies every rule.

use std::sync::Arc;

use symmetry::D2;

use crate::camera::Camera;
use crate::control::ControlSettings;
use crate::embodiment::Embodiment;
use crate::error::EnvError;
use crate::layout::Layout;
use crate::scene::Scene;
use crate::tabletop::{ACTION_DIM, StepResult, TableTop, VECTOR_OBSERVATION_DIM};
use crate::task::{StepReward, TaskGroup};

use super::case::{Case, RandomActions, RuleResult, run, unless};
use super::experts::measure_expert;
use super::scene_rules;
use super::symmetry::measure_symmetry;

/// Violation of a conformance rule by a task group, or an error that ended the check.
#[derive(Debug, thiserror::Error)]
#[non_exhaustive]
pub enum ConformanceError {
    /// Conformance rule that the task group violates in one case.
    #[error("{case}: {rule}: {finding}")]
    RuleViolated {
        /// Variant, embodiment and layout in which the rule is violated.
        case: String,
        /// Description of the violated rule.
        rule: &'static str,
        /// Description of the violation.
        finding: String,
    },
    /// Scene that cannot be made, or environment that failed during a check.
    #[error("{case}: {source}")]
    CheckFailed {
        /// Variant (or task group), embodiment and layout of the failed check.
        case: String,
        /// Error that ended the check.
        source: Box<EnvError>,
    },
}

/// Description of a conformance rule, and the function that checks it.
type Rule = (&'static str, fn(&Case) -> RuleResult);

const OF_SCENES: [Rule; 3] = [
    ("everything in the scene has a name", scene_rules::names),
    ("pictures show what happens", scene_rules::moving_pictures),
    ("variants differ", scene_rules::distinct_variants),
];

/// Conformance rules for every variant in every layout.
const OF_VARIANTS: [Rule; 6] = [
    ("figures are finite and in range", ranges),
    ("a seed fixes an episode and another changes it", determinism),
    ("tables do not disturb one another", independence),
    ("observations vary and hidden goals are zero", variation),
    ("a saved episode continues to the same bits", continuation),
    ("doing nothing solves nothing", idleness),
];

/// Conformance rules for every variant of the symmetric layout.
const OF_MIRRORED_VARIANTS: [Rule; 2] =
    [("the expert solves it", solution), ("it mirrors its canonical twin", mirror)];

/// Checks `group` against every conformance rule, in each layout that it supports, with the
/// standard embodiments and in all variants. Takes some seconds.
///
/// The scene compiles without a warning and everything in it has a name. In every control step
/// observations, rewards, their terms and the expert's commands are finite and in range. Only the
/// horizon ends an episode. Episodes depend on the seed alone, tables do not affect each other, and
/// a saved episode continues to the same bits. Observations vary, and pictures show a moved object.
/// Placements keep to one quadrant, so variants differ. A policy that does nothing never succeeds.
/// In the symmetric layout the expert solves each variant, and each mirrors the identity variant as
/// far as its embodiment does.
///
/// # Errors
/// The first [`ConformanceError`].
pub fn check_task_conformance(group: TaskGroup) -> Result<(), ConformanceError> {
    let mut embodiments = Embodiment::STANDARD.into_iter();
    embodiments.try_for_each(|embodiment| check_task_conformance_with(group, embodiment))
}

/// Checks `group` with one embodiment alone, for instance one of yours, against the rules of
/// [`check_task_conformance`].
///
/// # Errors
/// The first [`ConformanceError`].
pub fn check_task_conformance_with(
    group: TaskGroup,
    embodiment: Embodiment,
) -> Result<(), ConformanceError> {
    for layout in Layout::ALL {
        if layout == Layout::MetaWorld && group.identity_task().meta_world_settings().is_none() {
            continue;
        }
        let scene = Scene::new_in_layout(layout, group, embodiment, Camera::default()).map_err(
            |source| ConformanceError::CheckFailed {
                case: format!("{group}, {embodiment}, {layout}"),
                source: Box::new(source),
            },
        )?;
        check_scene(&Arc::new(scene))?;
    }
    Ok(())
}

fn check_scene(scene: &Arc<Scene>) -> Result<(), ConformanceError> {
    for (index, &element) in scene.layout.group_elements().iter().enumerate() {
        let scene = Arc::clone(scene);
        let case = Case { scene, element };
        // scene rules do not depend on the variant; the identity comes first in every layout
        if index == 0 {
            ask(&case, &OF_SCENES)?;
        }
        ask(&case, &OF_VARIANTS)?;
        if case.scene.layout == Layout::Symmetric {
            ask(&case, &OF_MIRRORED_VARIANTS)?;
        }
    }
    Ok(())
}

fn ask(case: &Case, rules: &[Rule]) -> Result<(), ConformanceError> {
    for &(rule, finding) in rules {
        let finding = finding(case).map_err(|source| ConformanceError::CheckFailed {
            case: case.to_string(),
            source: Box::new(source),
        })?;
        if let Some(finding) = finding {
            return Err(ConformanceError::RuleViolated { case: case.to_string(), rule, finding });
        }
    }
    Ok(())
}

/// Checks that observations, rewards and commands are in range in every control step, under random
/// actions and under the expert's.
fn ranges(case: &Case) -> RuleResult {
    let control = case.fine_control();
    let mut actions = RandomActions::new(2, &control);
    let of_random = in_range(case, |_| Ok(actions.next()))?;
    match of_random {
        None => in_range(case, TableTop::expert_action),
        found => Ok(found),
    }
}

fn in_range(
    case: &Case,
    mut act: impl FnMut(&TableTop) -> Result<[f32; ACTION_DIM], EnvError>,
) -> RuleResult {
    let control = case.fine_control();
    let mut table = TableTop::new(Arc::clone(&case.scene), control)?;
    case.reset(&mut table, 1)?;
    for count in 1..=control.horizon {
        let action = act(&table)?;
        let step = table.step(&action)?;
        let reward = table.reward(f64::from(action[3]))?;
        let (vector, command) = (table.observe()?, table.expert_command()?);
        let holds = step_in_range(&step, count == control.horizon)
            && reward_in_range(&reward)
            && vector_in_range(&vector)
            && command.hand.is_finite()
            && (-1.0..=1.0).contains(&command.finger);
        if !holds {
            let found =
                format!("control step {count}: {step:?}, {reward:?}, {vector:?}, {command:?}");
            return Ok(Some(found));
        }
    }
    let ended = matches!(table.step(&[0.0; ACTION_DIM]), Err(EnvError::NotReset));
    Ok(unless(ended, || "the episode goes on after the horizon".to_owned()))
}

fn step_in_range(step: &StepResult, last: bool) -> bool {
    (0.0..=1.0).contains(&step.reward)
        && step.success >= step.success_at_end
        && step.truncated == last
}

fn reward_in_range(reward: &StepReward) -> bool {
    (0.0..=10.0).contains(&reward.reward)
        && (0.0..=1.0).contains(&reward.approach_reward)
        && (0.0..=1.0).contains(&reward.in_place_reward)
        && reward.goal_distance.is_finite()
        && reward.goal_distance >= 0.0
}

fn vector_in_range(vector: &[f32; VECTOR_OBSERVATION_DIM]) -> bool {
    let [x, y, z, aperture, goal_x, goal_y, goal_z, lead @ ..] = vector;
    // wider than the bounds of the hand's target in either layout, with room for overshoot
    x.abs() < 0.7
        && y.abs() < 0.7
        && (-0.1..0.7).contains(z)
        && (0.0..=1.0).contains(aperture)
        && [goal_x, goal_y, goal_z].iter().all(|goal| goal.abs() < 0.5)
        // the weld's target may run ahead of a blocked hand as far as its bounds
        && lead.iter().all(|lead| lead.abs() < 0.7)
}

fn determinism(case: &Case) -> RuleResult {
    let fresh = |seed| run(&mut case.started(seed)?, &mut case.random_actions(7), 25);
    let first = fresh(1)?;
    // a table with a history, to show that a reset erases it
    let mut used = case.started(5)?;
    run(&mut used, &mut case.random_actions(8), 37)?;
    case.reset(&mut used, 1)?;
    let again = run(&mut used, &mut case.random_actions(7), 25)?;
    let finding = if fresh(1)? != first {
        "two episodes of one seed differ"
    } else if again != first {
        "the previous episode affects the next"
    } else if fresh(2)? == first {
        "the seed changes nothing"
    } else {
        return Ok(None);
    };
    Ok(Some(finding.to_owned()))
}

fn independence(case: &Case) -> RuleResult {
    let (mut one, mut other) = (case.started(1)?, case.started(2)?);
    let (mut left, mut right) = (case.random_actions(3), case.random_actions(4));
    let mut interleaved = Vec::new();
    for _ in 0..20 {
        interleaved.extend(run(&mut one, &mut left, 1)?);
        run(&mut other, &mut right, 1)?;
    }
    let alone = run(&mut case.started(1)?, &mut case.random_actions(3), 20)?;
    let found = || "an episode differs where another runs in between".to_owned();
    Ok(unless(interleaved == alone, found))
}

fn variation(case: &Case) -> RuleResult {
    let mut low = [f32::INFINITY; VECTOR_OBSERVATION_DIM];
    let mut high = [f32::NEG_INFINITY; VECTOR_OBSERVATION_DIM];
    for seed in 0..2 {
        let mut table = case.started(seed)?;
        let mut actions = case.random_actions(seed);
        for _ in 0..case.decisions_per_episode() / 2 {
            for (i, value) in table.observe()?.into_iter().enumerate() {
                low[i] = low[i].min(value);
                high[i] = high[i].max(value);
            }
            table.step(&actions.next())?;
        }
    }
    let observable = case.scene.goal_observable;
    // hand, aperture and lead must always vary; the goal, at 4 to 6, only where it is shown
    let varies = |i: usize| observable || !(4..7).contains(&i);
    let wrong = (0..VECTOR_OBSERVATION_DIM).find(|&i| (high[i] - low[i] > 1e-3) != varies(i));
    Ok(wrong.map(|i| format!("component {i} of the vector is in {}..={}", low[i], high[i])))
}

/// Checks that an episode that is saved and restored continues to the same bits. The solver's warm
/// start is part of the state: contacts and welds are solved to the same bits only from the same
/// start.
fn continuation(case: &Case) -> RuleResult {
    let mut table = case.started(1)?;
    run(&mut table, &mut case.random_actions(9), 15)?;
    let (snapshot, before) = (table.save()?, table.observe()?);
    let straight = run(&mut table, &mut case.random_actions(10), 25)?;
    let mut elsewhere = case.started(3)?;
    elsewhere.restore(&snapshot)?;
    let seen = elsewhere.observe()?;
    let resumed = run(&mut elsewhere, &mut case.random_actions(10), 25)?;
    let finding = if seen.map(f32::to_bits) != before.map(f32::to_bits) {
        "the restored observation differs"
    } else if straight != resumed {
        "the restored episode continues differently"
    } else {
        return Ok(None);
    };
    Ok(Some(finding.to_owned()))
}

fn idleness(case: &Case) -> RuleResult {
    let mut table = case.started(3)?;
    for decision in 0..case.decisions_per_episode() {
        if table.step(&[0.0; ACTION_DIM])?.success {
            return Ok(Some(format!("success in decision {decision}")));
        }
    }
    Ok(None)
}

fn solution(case: &Case) -> RuleResult {
    let row = measure_expert(&case.scene, case.element, ControlSettings::default(), 2)?;
    Ok(unless(row.passes(), || format!("{row:?}")))
}

fn mirror(case: &Case) -> RuleResult {
    if case.element == D2::Identity {
        return Ok(None); // its own twin
    }
    let row = measure_symmetry(&case.scene, case.element, 1)?;
    Ok(unless(row.passes(), || format!("{row:?}")))
}
