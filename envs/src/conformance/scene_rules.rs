//! Conformance rules for a whole scene: its names, pictures and variants.

use std::collections::HashSet;
use std::sync::Arc;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use glam::DVec3;

use super::case::{Case, RuleResult, run, unless};
use crate::camera::RGB_CHANNELS;
use crate::error::EnvError;
use crate::renderer::SceneRenderer;
use crate::tabletop::TableTop;
use crate::task::Placement;

/// Displacement (metres) of an object at which pictures must change.
const VISIBLE_DISPLACEMENT: f64 = 0.02;
/// Displacement (metres) at the end of an episode at which pictures must have changed.
const FINAL_DISPLACEMENT: f64 = 1e-3;
/// Distance from an axis of the table (metres) beyond which a point lies off the axis.
const OFF_AXIS: f64 = 1e-3;
/// Number of random placements whose quadrant is checked.
const PLACEMENTS: usize = 100;

pub(super) fn names(case: &Case) -> RuleResult {
    let model = &case.scene.model;
    let (unnamed, warning) = (model.unnamed_objects(), model.compile_warning());
    let holds = unnamed.is_empty() && warning.is_none();
    let found = || format!("without a name: {unnamed:?}; MuJoCo warns: {warning:?}");
    Ok(unless(holds, found))
}

/// Checks that pictures change if the task's object moves, or the gripper in tasks without one.
pub(super) fn moving_pictures(case: &Case) -> RuleResult {
    if case.scene.object_body.is_some() { moving_object(case) } else { moving_mark(case) }
}

/// Checks that pictures show the object that the expert moves. No mark is drawn, because it would
/// show that the gripper moves.
fn moving_object(case: &Case) -> RuleResult {
    let mut renderer = SceneRenderer::without_arm(Arc::clone(&case.scene))?;
    let mut table = case.started(1)?;
    let before = picture(&mut renderer, &mut table)?;
    let start = table.task_state()?.object;
    let (mut unseen, last) = (None, case.decisions_per_episode());
    for decision in 1..=last {
        let action = table.expert_action()?;
        table.step(&action)?;
        let way = table.task_state()?.object.distance(start);
        if way > VISIBLE_DISPLACEMENT || (decision == last && way > FINAL_DISPLACEMENT) {
            if picture(&mut renderer, &mut table)? != before {
                return Ok(None);
            }
            unseen = Some((decision, way));
        }
    }
    let found = |(decision, way)| {
        format!("the object is {way} m from where it was in decision {decision}, and nothing shows")
    };
    Ok(unseen.map(found))
}

fn moving_mark(case: &Case) -> RuleResult {
    let mut renderer = SceneRenderer::new(Arc::clone(&case.scene))?;
    let mut table = case.started(1)?;
    let before = picture(&mut renderer, &mut table)?;
    // as long in either layout: 200 control steps
    let decisions = 200 / case.scene.layout.control_settings().action_repeat;
    run(&mut table, &mut case.random_actions(6), decisions)?;
    let after = picture(&mut renderer, &mut table)?;
    Ok(unless(before != after, || "nothing changes".to_owned()))
}

/// Checks that the variants differ: placements keep to one quadrant, and start pictures differ
/// unless the goal is observable. A placement on an axis would make two variants equal, and so
/// would objects that pictures do not show.
pub(super) fn distinct_variants(case: &Case) -> RuleResult {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let placements: Vec<Placement> =
        (0..PLACEMENTS).map(|_| case.scene.sample_placement(&mut rng)).collect();
    let placement = placements[0];
    let elements = case.scene.layout.group_elements();
    if elements.len() > 1 && !off_centre(&placements) {
        let found = "neither the object nor the goal stays in one quadrant, 1 mm off its axes";
        return Ok(Some(found.to_owned()));
    }
    let mut renderer = SceneRenderer::new(Arc::clone(&case.scene))?;
    let mut table = case.table()?;
    let mut pictures = HashSet::new();
    for &element in elements {
        table.reset_to(element, placement)?;
        pictures.insert(picture(&mut renderer, &mut table)?);
    }
    // goals of observable-goal tasks may be invisible: the vector then tells variants apart
    let holds = pictures.len() == elements.len() || case.scene.goal_observable;
    let found = || format!("{} pictures of {} variants", pictures.len(), elements.len());
    Ok(unless(holds, found))
}

/// Returns `true` if the objects, or the goals, of all placements lie in one quadrant, off its
/// axes.
fn off_centre(placements: &[Placement]) -> bool {
    let points: [fn(&Placement) -> DVec3; 2] = [|p| p.object, |p| p.goal];
    points.iter().any(|point| {
        // relative to the quadrant of the first placement
        let side = point(&placements[0]).signum();
        let off_axis = |p| (point(p) * side).truncate().min_element() > OFF_AXIS;
        placements.iter().all(off_axis)
    })
}

fn picture(renderer: &mut SceneRenderer, table: &mut TableTop) -> Result<Vec<u8>, EnvError> {
    let size = table.scene().camera.size;
    let mut rgb = vec![0; size * size * RGB_CHANNELS];
    renderer.render(table, &mut rgb)?;
    Ok(rgb)
}
