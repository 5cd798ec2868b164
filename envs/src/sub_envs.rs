//! The environments of one worker thread, and the renderers of their scenes.

use std::any::Any;
use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::ops::Range;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

use mujoco::Backdrop;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use symmetry::D2;

use crate::camera::RGB;
use crate::disturber::{Disturber, Sight};
use crate::error::EnvError;
use crate::renderer::SceneRenderer;
#[cfg(test)]
use crate::rows::Fault;
use crate::rows::{Command, Failure, Reply, Rows, Turn, row_mut};
use crate::scene::Scene;
use crate::settings::VecEnvSettings;
use crate::tabletop::{ACTION_DIM, TableTop, VECTOR_DIM};
use crate::task::TaskGroup;

/// One environment slot: its random stream, its camera, its episode's first picture, and what
/// stands still in that episode.
struct Slot {
    index: usize,
    rng: ChaCha8Rng,
    sight: Sight,
    first: Vec<u8>,
    backdrop: Backdrop,
    #[cfg(test)]
    fault: Option<Fault>,
}

/// What a worker thread owns.
pub(crate) struct SubEnvs {
    settings: VecEnvSettings,
    slots: Vec<Slot>,
    /// Of every group that was prepared; one that failed is thrown away and made anew.
    renderers: BTreeMap<TaskGroup, SceneRenderer>,
    /// Simulations of the present group, one a slot.
    tables: Vec<TableTop>,
    /// Those of groups that ran before. Given back to the allocator instead, megabytes of almost
    /// equal sizes leave gaps: memory grew as much with every group, and went up and down with
    /// every switch.
    parked: BTreeMap<TaskGroup, Vec<TableTop>>,
    elements: Vec<D2>,
    picture: Vec<u8>,
    /// Where pictures are randomised; renderers then draw no marks.
    disturber: Option<Disturber>,
}

impl SubEnvs {
    pub(crate) fn new(envs: Range<usize>, settings: VecEnvSettings) -> Self {
        let pixels = settings.camera.size * settings.camera.size * RGB;
        let slots = envs.map(|index| Slot {
            index,
            rng: slot_rng(settings.seed, index),
            sight: Sight::new(settings.seed, index),
            first: vec![0; pixels],
            backdrop: Backdrop::default(),
            #[cfg(test)]
            fault: None,
        });
        let disturber = |amounts| Disturber::new(amounts, settings.camera);
        Self {
            settings,
            slots: slots.collect(),
            renderers: BTreeMap::new(),
            tables: Vec::new(),
            parked: BTreeMap::new(),
            elements: Vec::new(),
            picture: vec![0; pixels],
            disturber: settings.randomisation.map(disturber),
        }
    }

    pub(crate) fn handle(&mut self, command: Command) -> Reply {
        let without_rows = |result| Reply { rows: None, result };
        match command {
            Command::Prepare(scene) => without_rows(self.prepare(scene)),
            Command::SetTasks(scene, elements) => without_rows(self.set_tasks(&scene, elements)),
            Command::Reseed(seed) => without_rows(self.reseed(seed)),
            Command::Advance(rows) => self.with_rows(rows, Self::advance),
            Command::Experts(rows) => self.with_rows(rows, Self::experts),
            #[cfg(test)]
            Command::Inject(row, fault) => {
                self.slots[row].fault = Some(fault);
                without_rows(Ok(()))
            }
        }
    }

    fn with_rows(
        &mut self,
        mut rows: Rows,
        work: fn(&mut Self, &mut Rows) -> Result<(), EnvError>,
    ) -> Reply {
        let result = work(self, &mut rows);
        Reply { rows: Some(rows), result }
    }

    fn reseed(&mut self, seed: u64) -> Result<(), EnvError> {
        for slot in &mut self.slots {
            slot.rng = slot_rng(seed, slot.index);
            slot.sight = Sight::new(seed, slot.index);
        }
        Ok(())
    }

    fn prepare(&mut self, scene: Arc<Scene>) -> Result<(), EnvError> {
        if let Entry::Vacant(entry) = self.renderers.entry(scene.group) {
            let renderer = match self.disturber {
                None => SceneRenderer::new(scene),
                Some(_) => SceneRenderer::of_table(scene),
            };
            entry.insert(renderer?);
        }
        Ok(())
    }

    fn set_tasks(&mut self, scene: &Arc<Scene>, elements: Vec<D2>) -> Result<(), EnvError> {
        self.elements = elements;
        let present = |tables: &Vec<TableTop>| {
            let first = tables.first();
            first.is_some_and(|table| Arc::ptr_eq(table.scene(), scene))
        };
        if present(&self.tables) {
            return Ok(());
        }
        let mut tables = match self.parked.remove(&scene.group).filter(present) {
            Some(parked) => parked,
            None => self.simulations(scene)?,
        };
        tables.iter_mut().for_each(TableTop::end_episode);
        let before = std::mem::replace(&mut self.tables, tables);
        if let Some(table) = before.first() {
            self.parked.insert(table.scene().group, before);
        }
        Ok(())
    }

    /// A simulation for each slot.
    fn simulations(&self, scene: &Arc<Scene>) -> Result<Vec<TableTop>, EnvError> {
        let table = |_| TableTop::new(Arc::clone(scene), self.settings.control);
        self.slots.iter().map(table).collect()
    }

    fn advance(&mut self, rows: &mut Rows) -> Result<(), EnvError> {
        rows.failures.clear();
        (0..self.slots.len()).try_for_each(|row| self.turn(row, rows))
    }

    fn turn(&mut self, row: usize, rows: &mut Rows) -> Result<(), EnvError> {
        match rows.turns[row] {
            Turn::Step | Turn::StepAndStay => {
                if !self.attempt(row, rows, Self::decide)? {
                    rows.end_early(row);
                }
            }
            Turn::Reset | Turn::Rest => rows.clear(row),
        }
        if rows.turns[row] == Turn::Reset || rows.begins_anew(row) {
            self.attempt(row, rows, Self::begin)?;
        }
        Ok(())
    }

    fn experts(&mut self, rows: &mut Rows) -> Result<(), EnvError> {
        let actions = rows.actions.chunks_exact_mut(ACTION_DIM);
        for ((table, slot), action) in self.tables.iter().zip(&self.slots).zip(actions) {
            let expert = table.expert_action();
            action.copy_from_slice(&expert.map_err(|error| error.of(slot.index))?);
        }
        Ok(())
    }

    /// Does `work` in one row and says whether it succeeded. Errors and panics are failures of that
    /// row alone, except for those of rendering, which all rows share.
    fn attempt(
        &mut self,
        row: usize,
        rows: &mut Rows,
        work: fn(&mut Self, usize, &mut Rows) -> Result<(), EnvError>,
    ) -> Result<bool, EnvError> {
        // a panic leaves nothing half done that the next `begin` of this row does not do afresh
        let caught = catch_unwind(AssertUnwindSafe(|| work(self, row, rows)));
        let panicked = |panic: Box<dyn Any + Send>| {
            let message = panic_message(&*panic);
            Err(EnvError::Panicked { message })
        };
        let env = self.slots[row].index;
        match caught.unwrap_or_else(panicked) {
            Ok(()) => Ok(true),
            Err(error @ EnvError::Render(_)) => {
                self.renderers.remove(&self.tables[row].scene().group);
                Err(error.of(env))
            }
            Err(error) => {
                rows.failures.push(Failure { env, error });
                Ok(false)
            }
        }
    }

    /// Starts an episode in slot `row` and writes its first observation.
    fn begin(&mut self, row: usize, rows: &mut Rows) -> Result<(), EnvError> {
        self.prepare(Arc::clone(self.tables[row].scene()))?;
        let (table, slot) = (&mut self.tables[row], &mut self.slots[row]);
        let renderer = renderer_of(&mut self.renderers, table)?;
        // where this fails, the next decision must not go on with an old episode
        table.end_episode();
        let element = self.elements[slot.rng.random_range(0..self.elements.len())];
        table.reset(element, &mut slot.rng)?;
        renderer.draw_backdrop(table, &mut slot.backdrop)?;
        renderer.render_over(table, &mut slot.backdrop, &mut slot.first)?;
        if let Some(disturber) = &mut self.disturber {
            disturber.begin(&mut slot.sight);
            disturber.disturb(&mut slot.sight, table.hand(), &mut slot.first);
        }
        let image = row_mut(&mut rows.batch.images, row, self.settings.image_len());
        renderer.compose(table, &slot.first, &slot.first, image);
        row_mut(&mut rows.batch.vectors, row, VECTOR_DIM).copy_from_slice(&table.observe()?);
        Ok(())
    }

    /// Takes one decision in slot `row` and writes what it led to, all or nothing.
    fn decide(&mut self, row: usize, rows: &mut Rows) -> Result<(), EnvError> {
        let (table, slot) = (&mut self.tables[row], &mut self.slots[row]);
        let renderer = renderer_of(&mut self.renderers, table)?;
        #[cfg(test)]
        slot.break_with_fault(table, renderer);
        let mut action = [0.0; ACTION_DIM];
        action.copy_from_slice(row_mut(&mut rows.actions, row, ACTION_DIM));
        let step = table.step(&action)?;
        let vector = table.observe()?;
        renderer.render_over(table, &mut slot.backdrop, &mut self.picture)?;
        if let Some(disturber) = &mut self.disturber {
            disturber.disturb(&mut slot.sight, table.hand(), &mut self.picture);
        }
        let (images, vectors) = rows.write_step(row, &step);
        let image = row_mut(images, row, self.settings.image_len());
        renderer.compose(table, &self.picture, &slot.first, image);
        row_mut(vectors, row, VECTOR_DIM).copy_from_slice(&vector);
        Ok(())
    }
}

#[cfg(test)]
impl Slot {
    fn break_with_fault(&mut self, table: &mut TableTop, renderer: &mut SceneRenderer) {
        if let Some(fault) = self.fault.take() {
            fault(table, renderer);
        }
    }
}

/// Every environment draws from a stream of its own.
fn slot_rng(seed: u64, index: usize) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(index as u64);
    rng
}

fn renderer_of<'a>(
    renderers: &'a mut BTreeMap<TaskGroup, SceneRenderer>,
    table: &TableTop,
) -> Result<&'a mut SceneRenderer, EnvError> {
    let renderer = renderers.get_mut(&table.scene().group);
    renderer.ok_or(EnvError::NotReset)
}

/// What a panic said.
pub(crate) fn panic_message(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().map(ToString::to_string);
    text.or_else(|| panic.downcast_ref::<String>().cloned())
        .unwrap_or_else(|| "no message".to_owned())
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_group_that_comes_back_finds_its_simulations_without_episodes() {
        let settings = VecEnvSettings::default();
        let [reach, drawer] = [TaskGroup::GOAL_REACH, TaskGroup::DRAWER_CLOSE].map(|group| {
            let (embodiment, camera) = (settings.embodiment, settings.camera);
            let scene = Scene::in_layout(settings.layout, group, embodiment, camera);
            Arc::new(scene.unwrap())
        });
        let mut envs = SubEnvs::new(0..2, settings);
        let switch = |envs: &mut SubEnvs, scene| {
            envs.set_tasks(scene, D2::ALL.to_vec()).unwrap();
            envs.tables.as_ptr()
        };
        let first = switch(&mut envs, &reach);
        envs.tables[0].reset(D2::Identity, &mut slot_rng(0, 0)).unwrap();
        assert_eq!(switch(&mut envs, &reach), first);
        assert!(envs.tables[0].step(&[0.0; ACTION_DIM]).is_ok(), "its episode goes on");
        assert_ne!(switch(&mut envs, &drawer), first);
        assert_eq!(switch(&mut envs, &reach), first);
        let message = envs.tables[0].step(&[0.0; ACTION_DIM]).unwrap_err().to_string();
        assert!(message.contains("reset"), "{message}");
    }
}
