//! Rules of a whole scene: its names and its pictures.

use std::collections::HashSet;
use std::sync::Arc;

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::case::{Case, Finding, run, unless};
use crate::error::EnvError;
use crate::renderer::{RGB, SceneRenderer};
use crate::tabletop::TableTop;

pub(super) fn names(case: &Case) -> Finding {
    let model = &case.scene.model;
    let (unnamed, warning) = (model.unnamed(), model.warning());
    let holds = unnamed.is_empty() && warning.is_none();
    let found = || format!("without a name: {unnamed:?}; MuJoCo warns: {warning:?}");
    Ok(unless(holds, found))
}

/// What happens within 200 control steps of random actions shows.
pub(super) fn moving_pictures(case: &Case) -> Finding {
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
    let placement = case.scene.place(&mut ChaCha8Rng::seed_from_u64(1));
    let elements = case.scene.layout.elements();
    let points = [placement.object, placement.goal];
    let beside = |axis: usize| points.iter().any(|point| point[axis].abs() > 1e-3);
    if elements.len() > 1 && !(beside(0) && beside(1)) {
        return Ok(Some(format!("{placement:?} is on an axis")));
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

fn picture(renderer: &mut SceneRenderer, table: &mut TableTop) -> Result<Vec<u8>, EnvError> {
    let size = table.scene().camera.size;
    let mut rgb = vec![0; size * size * RGB];
    renderer.render(table, &mut rgb)?;
    Ok(rgb)
}
