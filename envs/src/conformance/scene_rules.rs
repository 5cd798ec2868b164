//! Rules of a whole scene: its names and its pictures.

use std::collections::HashSet;
use std::sync::Arc;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use glam::DVec3;

use super::case::{Case, Finding, run, unless};
use crate::camera::RGB;
use crate::error::EnvError;
use crate::renderer::SceneRenderer;
use crate::tabletop::TableTop;
use crate::task::Placement;

/// An object that is this far from where it was (metres) shows.
const MOVED: f64 = 0.02;
/// One that is farther than this when the episode ends (metres) shows by then.
const STILL: f64 = 1e-3;
/// A point that keeps this far from an axis (metres) is beside it.
const BESIDE: f64 = 1e-3;
/// Placements that are drawn to see where they lie.
const PLACEMENTS: usize = 100;

pub(super) fn names(case: &Case) -> Finding {
    let model = &case.scene.model;
    let (unnamed, warning) = (model.unnamed(), model.warning());
    let holds = unnamed.is_empty() && warning.is_none();
    let found = || format!("without a name: {unnamed:?}; MuJoCo warns: {warning:?}");
    Ok(unless(holds, found))
}

/// The object shows where the expert moves it, and the gripper in tasks without one.
pub(super) fn moving_pictures(case: &Case) -> Finding {
    if case.scene.object_body.is_some() { moving_object(case) } else { moving_mark(case) }
}

/// No mark is drawn, which would show that the gripper moves.
fn moving_object(case: &Case) -> Finding {
    let mut renderer = SceneRenderer::of_table(Arc::clone(&case.scene))?;
    let mut table = case.started(1)?;
    let before = picture(&mut renderer, &mut table)?;
    let start = table.measurement()?.object;
    let (mut unseen, last) = (None, case.decisions());
    for decision in 1..=last {
        let action = table.expert_action()?;
        table.step(&action)?;
        let way = table.measurement()?.object.distance(start);
        if way > MOVED || (decision == last && way > STILL) {
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

fn moving_mark(case: &Case) -> Finding {
    let mut renderer = SceneRenderer::new(Arc::clone(&case.scene))?;
    let mut table = case.started(1)?;
    let before = picture(&mut renderer, &mut table)?;
    let decisions = 200 / case.scene.layout.control().action_repeat;
    run(&mut table, &mut case.random_actions(6), decisions)?;
    let after = picture(&mut renderer, &mut table)?;
    Ok(unless(before != after, || "nothing changes".to_owned()))
}

/// A placement on an axis would make two variants one, and so would objects that do not show.
pub(super) fn distinct_variants(case: &Case) -> Finding {
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let placements: Vec<Placement> = (0..PLACEMENTS).map(|_| case.scene.place(&mut rng)).collect();
    let placement = placements[0];
    let elements = case.scene.layout.elements();
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
    let holds = pictures.len() == elements.len() || case.scene.goal_observable;
    let found = || format!("{} pictures of {} variants", pictures.len(), elements.len());
    Ok(unless(holds, found))
}

/// Whether the objects, or the goals, of all placements lie in one quadrant and beside its axes.
fn off_centre(placements: &[Placement]) -> bool {
    let points: [fn(&Placement) -> DVec3; 2] = [|p| p.object, |p| p.goal];
    points.iter().any(|point| {
        let side = point(&placements[0]).signum();
        let beside = |p| (point(p) * side).truncate().min_element() > BESIDE;
        placements.iter().all(beside)
    })
}

fn picture(renderer: &mut SceneRenderer, table: &mut TableTop) -> Result<Vec<u8>, EnvError> {
    let size = table.scene().camera.size;
    let mut rgb = vec![0; size * size * RGB];
    renderer.render(table, &mut rgb)?;
    Ok(rgb)
}
