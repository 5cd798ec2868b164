//! What one worker thread owns: some of the environments, and the renderers of their scenes.

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

use crate::EnvError;
use crate::batch::Batch;
use crate::picture::{Painter, RGB, stack};
use crate::scene::Scene;
use crate::settings::VecEnvSettings;
use crate::tabletop::{ACTION_DIM, TableTop, VECTOR_DIM};
use crate::task::TaskGroup;
use crate::vec_env::Failure;

/// What a worker is asked to do; it answers each with a [`Reply`].
pub(crate) enum Command {
    /// Make a renderer for this scene, where there is none yet.
    Prepare(Arc<Scene>),
    /// Simulate this scene, which is prepared, from the next reset on, with variants drawn from these elements.
    SetTasks(Arc<Scene>, Vec<D2>),
    /// Draw what follows from the streams of this seed.
    Reseed(u64),
    /// Start an episode everywhere.
    Reset(Rows),
    /// Hold these actions for one decision.
    Step(Rows),
    /// Do this to the table of one row before its next decision.
    #[cfg(test)]
    Sabotage(usize, fn(&mut TableTop)),
}

/// An answer: the rows that came with the command, and what ended it, if anything.
pub(crate) struct Reply {
    pub rows: Option<Rows>,
    pub result: Result<(), EnvError>,
}

/// The worker's share of a batch; sent back and forth, so that nothing is allocated per step.
pub(crate) struct Rows {
    pub actions: Vec<f32>,
    pub batch: Batch,
    pub failures: Vec<Failure>,
}

impl Rows {
    /// Rows for as many environments as `settings` say.
    pub(crate) fn new(settings: &VecEnvSettings) -> Self {
        Self {
            actions: vec![0.0; settings.num_envs * ACTION_DIM],
            batch: Batch::new(settings),
            failures: Vec::new(),
        }
    }

    /// Ends the episode of `row` at its last observation, as a time-out would.
    fn end_early(&mut self, row: usize) {
        let batch = &mut self.batch;
        let image = batch.images.len() / batch.rewards.len();
        copy_row(&batch.images, &mut batch.final_images, row, image);
        copy_row(&batch.vectors, &mut batch.final_vectors, row, VECTOR_DIM);
        batch.rewards[row] = 0.0;
        batch.success[row] = false;
        batch.truncated[row] = true;
    }
}

/// One environment slot: its random stream, its episode's first picture, and what stands still in that episode.
struct Slot {
    index: usize,
    rng: ChaCha8Rng,
    first: Vec<u8>,
    backdrop: Backdrop,
    #[cfg(test)]
    sabotage: Option<fn(&mut TableTop)>,
}

/// What a worker thread owns.
pub(crate) struct Share {
    settings: VecEnvSettings,
    slots: Vec<Slot>,
    /// Of every group that was prepared.
    painters: BTreeMap<TaskGroup, Painter>,
    /// Of the present group, one a slot: a simulation takes megabytes, and making one a fraction of a millisecond.
    tables: Vec<TableTop>,
    elements: Vec<D2>,
    picture: Vec<u8>,
}

impl Share {
    pub(crate) fn new(envs: Range<usize>, settings: VecEnvSettings) -> Self {
        let pixels = settings.camera.size * settings.camera.size * RGB;
        let slots = envs.map(|index| Slot {
            index,
            rng: slot_rng(settings.seed, index),
            first: vec![0; pixels],
            backdrop: Backdrop::default(),
            #[cfg(test)]
            sabotage: None,
        });
        Self {
            settings,
            slots: slots.collect(),
            painters: BTreeMap::new(),
            tables: Vec::new(),
            elements: Vec::new(),
            picture: vec![0; pixels],
        }
    }

    pub(crate) fn obey(&mut self, command: Command) -> Reply {
        let (rows, result) = match command {
            Command::Prepare(scene) => (None, self.prepare(scene)),
            Command::SetTasks(scene, elements) => (None, self.set_tasks(&scene, elements)),
            Command::Reseed(seed) => {
                for slot in &mut self.slots {
                    slot.rng = slot_rng(seed, slot.index);
                }
                (None, Ok(()))
            }
            Command::Reset(mut rows) => {
                let result = self.reset(&mut rows);
                (Some(rows), result)
            }
            Command::Step(mut rows) => {
                let result = self.step(&mut rows);
                (Some(rows), result)
            }
            #[cfg(test)]
            Command::Sabotage(row, deed) => {
                self.slots[row].sabotage = Some(deed);
                (None, Ok(()))
            }
        };
        Reply { rows, result }
    }

    fn prepare(&mut self, scene: Arc<Scene>) -> Result<(), EnvError> {
        if let Entry::Vacant(entry) = self.painters.entry(scene.group) {
            entry.insert(Painter::new(scene)?);
        }
        Ok(())
    }

    fn set_tasks(&mut self, scene: &Arc<Scene>, elements: Vec<D2>) -> Result<(), EnvError> {
        self.elements = elements;
        let known = self.tables.first();
        if !known.is_some_and(|table| Arc::ptr_eq(table.scene(), scene)) {
            // the old ones go first, so that there are never two sets
            self.tables.clear();
            let table = |_| TableTop::new(Arc::clone(scene), self.settings.dynamics);
            self.tables = self.slots.iter().map(table).collect::<Result<_, _>>()?;
        }
        Ok(())
    }

    fn reset(&mut self, rows: &mut Rows) -> Result<(), EnvError> {
        rows.failures.clear();
        (0..self.slots.len()).try_for_each(|row| self.attempt(row, rows, Self::begin).map(|_| ()))
    }

    fn step(&mut self, rows: &mut Rows) -> Result<(), EnvError> {
        rows.failures.clear();
        for row in 0..self.slots.len() {
            if !self.attempt(row, rows, Self::decide)? {
                rows.end_early(row);
            }
            if rows.batch.truncated[row] {
                self.attempt(row, rows, Self::begin)?;
            }
        }
        Ok(())
    }

    /// Does `work` in one row and says whether it succeeded. Errors and panics are failures of that row alone, except for those of
    /// drawing, which all rows share.
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
            Err(error @ EnvError::Render(_)) => Err(error.of(env)),
            Err(error) => {
                rows.failures.push(Failure { env, error });
                Ok(false)
            }
        }
    }

    /// Starts an episode in slot `row` and writes its first observation.
    fn begin(&mut self, row: usize, rows: &mut Rows) -> Result<(), EnvError> {
        let (table, slot) = (&mut self.tables[row], &mut self.slots[row]);
        let painter = painter_of(&mut self.painters, table)?;
        // where this fails, the next decision must not go on with an old episode
        table.end_episode();
        let element = self.elements[slot.rng.random_range(0..self.elements.len())];
        table.reset(element, &mut slot.rng)?;
        painter.paint_backdrop(table, &mut slot.backdrop)?;
        painter.paint_over(table, &mut slot.backdrop, &mut slot.first)?;
        let image = chunk(&mut rows.batch.images, row, self.settings.image_len());
        stack(&slot.first, &slot.first, image);
        chunk(&mut rows.batch.vectors, row, VECTOR_DIM).copy_from_slice(&table.observe()?);
        Ok(())
    }

    /// Takes one decision in slot `row` and writes what it led to, all or nothing.
    fn decide(&mut self, row: usize, rows: &mut Rows) -> Result<(), EnvError> {
        let (table, slot) = (&mut self.tables[row], &mut self.slots[row]);
        let painter = painter_of(&mut self.painters, table)?;
        #[cfg(test)]
        slot.sabotage
            .take()
            .into_iter()
            .for_each(|deed| deed(table));
        let mut action = [0.0; ACTION_DIM];
        action.copy_from_slice(chunk(&mut rows.actions, row, ACTION_DIM));
        let step = table.step(&action)?;
        let vector = table.observe()?;
        painter.paint_over(table, &mut slot.backdrop, &mut self.picture)?;
        let batch = &mut rows.batch;
        batch.rewards[row] = step.reward as f32;
        batch.success[row] = step.success;
        batch.truncated[row] = step.truncated;
        let (images, vectors) = if step.truncated {
            (&mut batch.final_images, &mut batch.final_vectors)
        } else {
            (&mut batch.images, &mut batch.vectors)
        };
        let image = chunk(images, row, self.settings.image_len());
        stack(&self.picture, &slot.first, image);
        chunk(vectors, row, VECTOR_DIM).copy_from_slice(&vector);
        Ok(())
    }
}

/// Every environment draws from a stream of its own.
fn slot_rng(seed: u64, index: usize) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(index as u64);
    rng
}

fn painter_of<'a>(
    painters: &'a mut BTreeMap<TaskGroup, Painter>,
    table: &TableTop,
) -> Result<&'a mut Painter, EnvError> {
    let painter = painters.get_mut(&table.scene().group);
    painter.ok_or(EnvError::NotReset)
}

fn chunk<T>(values: &mut [T], row: usize, len: usize) -> &mut [T] {
    &mut values[row * len..(row + 1) * len]
}

fn copy_row<T: Copy>(from: &[T], to: &mut [T], row: usize, len: usize) {
    chunk(to, row, len).copy_from_slice(&from[row * len..(row + 1) * len]);
}

/// What a panic said.
pub(crate) fn panic_message(panic: &(dyn Any + Send)) -> String {
    let text = panic.downcast_ref::<&str>().map(ToString::to_string);
    text.or_else(|| panic.downcast_ref::<String>().cloned())
        .unwrap_or_else(|| "no message".to_owned())
}
