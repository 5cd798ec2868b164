//! Environments of one worker thread, and the renderers of their task groups' scenes.

use std::any::Any;
use std::collections::BTreeMap;
use std::collections::btree_map::Entry;
use std::ops::Range;
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::sync::Arc;

use mujoco::StaticBackdrop;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use symmetry::D2;

use crate::arm_occlusion::ArmOcclusion;
use crate::camera::RGB_CHANNELS;
use crate::domain_randomiser::{CameraErrors, VisualDomainRandomiser};
use crate::error::EnvError;
#[cfg(test)]
use crate::messages::Fault;
use crate::messages::{
    EnvCommand, EnvFailure, EnvSnapshot, PictureSettings, WorkerBatch, WorkerCommand, WorkerReply,
    row_mut,
};
use crate::renderer::{SceneRenderer, ViewRenderer, ViewSettings};
use crate::scene::Scene;
use crate::settings::VecEnvSettings;
use crate::tabletop::{ACTION_DIM, STATE_DETAILS_DIM, TableTop, VECTOR_OBSERVATION_DIM};
use crate::task::TaskGroup;

/// State of one environment besides its simulation: random stream, camera errors, first picture,
/// backdrop and occlusion of the episode.
struct Slot {
    index: usize,
    rng: ChaCha8Rng,
    camera_state: CameraErrors,
    first: Vec<u8>,
    backdrop: StaticBackdrop,
    occlusion: ArmOcclusion,
    #[cfg(test)]
    fault: Option<Fault>,
}

/// Environments and renderers that a worker thread owns.
pub(crate) struct SubEnvs {
    settings: VecEnvSettings,
    slots: Vec<Slot>,
    /// Renderer of each prepared task group. A renderer that failed is dropped and made again.
    renderers: BTreeMap<TaskGroup, SceneRenderer>,
    /// Renderers for people, made at first use.
    views: BTreeMap<(TaskGroup, ViewSettings), ViewRenderer>,
    /// Simulations of the current task group, one per environment.
    tables: Vec<TableTop>,
    /// Simulations of earlier task groups, kept for their return. Freeing blocks of several
    /// megabytes and almost equal sizes fragments the heap: memory would grow with every group.
    parked: BTreeMap<TaskGroup, Vec<TableTop>>,
    elements: Vec<D2>,
    picture: Vec<u8>,
    /// Randomiser of the pictures, if any; the renderers then draw no marks.
    randomiser: Option<VisualDomainRandomiser>,
}

impl SubEnvs {
    pub(crate) fn new(envs: Range<usize>, settings: VecEnvSettings) -> Self {
        let pixels = settings.camera.size * settings.camera.size * RGB_CHANNELS;
        let slots = envs.map(|index| Slot {
            index,
            rng: slot_rng(settings.seed, index),
            camera_state: CameraErrors::new(settings.seed, index),
            first: vec![0; pixels],
            backdrop: StaticBackdrop::default(),
            occlusion: ArmOcclusion::Off,
            #[cfg(test)]
            fault: None,
        });
        let randomiser = |amounts| VisualDomainRandomiser::new(amounts, settings.camera);
        Self {
            settings,
            slots: slots.collect(),
            renderers: BTreeMap::new(),
            views: BTreeMap::new(),
            tables: Vec::new(),
            parked: BTreeMap::new(),
            elements: Vec::new(),
            picture: vec![0; pixels],
            randomiser: settings.randomisation.map(randomiser),
        }
    }

    pub(crate) fn handle(&mut self, command: WorkerCommand) -> WorkerReply {
        let without_rows = |result| WorkerReply { rows: None, result };
        match command {
            WorkerCommand::Prepare(scene) => without_rows(self.prepare(scene)),
            WorkerCommand::SetTasks(scene, elements) => {
                without_rows(self.set_task_group(&scene, elements))
            }
            WorkerCommand::Reseed(seeds) => without_rows(self.reseed(&seeds)),
            WorkerCommand::Advance(rows) => self.with_rows(rows, Self::advance),
            WorkerCommand::Experts(rows) => self.with_rows(rows, Self::experts),
            WorkerCommand::Details(rows) => self.with_rows(rows, Self::state_details),
            WorkerCommand::Render(rows) => self.with_rows(rows, Self::render),
            WorkerCommand::Save(rows) => self.with_rows(rows, Self::save),
            WorkerCommand::Restore(rows) => self.with_rows(rows, Self::restore),
            #[cfg(test)]
            WorkerCommand::Inject(row, fault) => {
                self.slots[row].fault = Some(fault);
                without_rows(Ok(()))
            }
        }
    }

    fn with_rows(
        &mut self,
        mut rows: WorkerBatch,
        work: fn(&mut Self, &mut WorkerBatch) -> Result<(), EnvError>,
    ) -> WorkerReply {
        let result = work(self, &mut rows);
        WorkerReply { rows: Some(rows), result }
    }

    fn reseed(&mut self, seeds: &[(u64, usize)]) -> Result<(), EnvError> {
        for slot in &mut self.slots {
            let (seed, stream) = seeds[slot.index];
            slot.rng = slot_rng(seed, stream);
            slot.camera_state = CameraErrors::new(seed, stream);
        }
        Ok(())
    }

    fn prepare(&mut self, scene: Arc<Scene>) -> Result<(), EnvError> {
        if let Entry::Vacant(entry) = self.renderers.entry(scene.group) {
            let renderer = match self.randomiser {
                // the randomiser draws the mark itself, after its disturbances
                None => SceneRenderer::new(scene),
                Some(_) => SceneRenderer::without_arm(scene),
            };
            entry.insert(renderer?);
        }
        Ok(())
    }

    fn set_task_group(&mut self, scene: &Arc<Scene>, elements: Vec<D2>) -> Result<(), EnvError> {
        self.elements = elements;
        let present = |tables: &Vec<TableTop>| {
            tables.first().is_some_and(|table| Arc::ptr_eq(table.scene(), scene))
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

    /// Creates a simulation of `scene` for each environment.
    fn simulations(&self, scene: &Arc<Scene>) -> Result<Vec<TableTop>, EnvError> {
        let table = |_| TableTop::new(Arc::clone(scene), self.settings.control);
        self.slots.iter().map(table).collect()
    }

    fn advance(&mut self, rows: &mut WorkerBatch) -> Result<(), EnvError> {
        rows.failures.clear();
        (0..self.slots.len()).try_for_each(|row| self.run_command(row, rows))
    }

    fn run_command(&mut self, row: usize, rows: &mut WorkerBatch) -> Result<(), EnvError> {
        match rows.commands[row] {
            EnvCommand::Step | EnvCommand::StepNoAutoReset => {
                if !self.attempt(row, rows, Self::decide)? {
                    rows.end_as_truncated(row);
                }
            }
            EnvCommand::Reset | EnvCommand::Idle => rows.clear(row),
        }
        if rows.commands[row] == EnvCommand::Reset || rows.auto_resets(row) {
            self.attempt(row, rows, Self::begin_episode)?;
        }
        Ok(())
    }

    fn experts(&mut self, rows: &mut WorkerBatch) -> Result<(), EnvError> {
        let actions = rows.actions.chunks_exact_mut(ACTION_DIM);
        for ((table, slot), action) in self.tables.iter().zip(&self.slots).zip(actions) {
            let expert = table.expert_action();
            action.copy_from_slice(&expert.map_err(|error| error.in_env(slot.index))?);
        }
        Ok(())
    }

    fn state_details(&mut self, rows: &mut WorkerBatch) -> Result<(), EnvError> {
        let details = rows.details.chunks_exact_mut(STATE_DETAILS_DIM);
        for (table, out) in self.tables.iter().zip(details) {
            out.fill(f32::NAN);
            // an environment that failed has no episode
            if let Ok(own) = table.state_details() {
                out.copy_from_slice(&own);
            }
        }
        Ok(())
    }

    fn render(&mut self, rows: &mut WorkerBatch) -> Result<(), EnvError> {
        let Some((view, pictures)) = &mut rows.view else { return Ok(()) };
        let picture = view.size * view.size * RGB_CHANNELS;
        for (row, (table, slot)) in self.tables.iter_mut().zip(&self.slots).enumerate() {
            let renderer = match self.views.entry((table.scene().group, *view)) {
                Entry::Occupied(entry) => entry.into_mut(),
                Entry::Vacant(entry) => entry.insert(ViewRenderer::new(table.scene(), *view)?),
            };
            let rendered = renderer.render(table, row_mut(pictures, row, picture));
            if let Err(error) = rendered {
                // the OpenGL context may be lost; the next call makes new renderers
                self.views.clear();
                return Err(error.in_env(slot.index));
            }
        }
        Ok(())
    }

    fn save(&mut self, rows: &mut WorkerBatch) -> Result<(), EnvError> {
        let image = self.settings.image_len();
        let tables = self.tables.iter().zip(&self.slots).enumerate();
        let snapshots = tables.map(|(row, (table, slot))| {
            Ok::<_, EnvError>(EnvSnapshot {
                table: table.save().map_err(|error| error.in_env(slot.index))?,
                rng: slot.rng.clone(),
                camera_state: slot.camera_state.clone(),
                first: slot.first.clone(),
                occlusion: slot.occlusion.clone(),
                image: row_mut(&mut rows.batch.images, row, image).to_vec(),
                vector: row_mut(&mut rows.batch.vectors, row, VECTOR_OBSERVATION_DIM).to_vec(),
                pictures: PictureSettings::new(&self.settings),
            })
        });
        rows.snapshots = snapshots.collect::<Result<_, _>>()?;
        Ok(())
    }

    fn restore(&mut self, rows: &mut WorkerBatch) -> Result<(), EnvError> {
        let image = self.settings.image_len();
        for (row, snapshot) in std::mem::take(&mut rows.snapshots).into_iter().enumerate() {
            self.prepare(Arc::clone(self.tables[row].scene()))?;
            let (table, slot) = (&mut self.tables[row], &mut self.slots[row]);
            table.restore(&snapshot.table).map_err(|error| error.in_env(slot.index))?;
            let renderer = renderer_of(&mut self.renderers, table)?;
            if let Err(error) = renderer.render_backdrop(table, &mut slot.backdrop) {
                // the OpenGL context may be lost; the next call makes a new renderer
                self.renderers.remove(&table.scene().group);
                return Err(error);
            }
            row_mut(&mut rows.batch.images, row, image).copy_from_slice(&snapshot.image);
            row_mut(&mut rows.batch.vectors, row, VECTOR_OBSERVATION_DIM)
                .copy_from_slice(&snapshot.vector);
            (slot.rng, slot.camera_state) = (snapshot.rng, snapshot.camera_state);
            (slot.first, slot.occlusion) = (snapshot.first, snapshot.occlusion);
        }
        Ok(())
    }

    /// Calls `work` for the environment `row` and returns `true` if it succeeded. Errors and panics
    /// are failures of that row alone, except errors of rendering, which affect all rows.
    fn attempt(
        &mut self,
        row: usize,
        rows: &mut WorkerBatch,
        work: fn(&mut Self, usize, &mut WorkerBatch) -> Result<(), EnvError>,
    ) -> Result<bool, EnvError> {
        // unwind safe, since the next `begin_episode` of this row resets everything that a panic
        // may leave half done
        let caught = catch_unwind(AssertUnwindSafe(|| work(self, row, rows)));
        let panicked = |panic: Box<dyn Any + Send>| {
            let message = panic_message(&*panic);
            Err(EnvError::Panicked { message })
        };
        let env = self.slots[row].index;
        match caught.unwrap_or_else(panicked) {
            Ok(()) => Ok(true),
            Err(error @ EnvError::Render(_)) => {
                // the OpenGL context may be lost; `begin_episode` makes a new renderer
                self.renderers.remove(&self.tables[row].scene().group);
                Err(error.in_env(env))
            }
            Err(error) => {
                // its picture may be missing, so the episode cannot go on
                self.tables[row].end_episode();
                rows.failures.push(EnvFailure { env, error });
                Ok(false)
            }
        }
    }

    /// Starts an episode in environment `row` of the worker and writes its first observation.
    fn begin_episode(&mut self, row: usize, rows: &mut WorkerBatch) -> Result<(), EnvError> {
        self.prepare(Arc::clone(self.tables[row].scene()))?;
        let (table, slot) = (&mut self.tables[row], &mut self.slots[row]);
        let renderer = renderer_of(&mut self.renderers, table)?;
        // ended first, so that a failure below leaves no episode for the next decision to continue
        table.end_episode();
        let element = self.elements[slot.rng.random_range(0..self.elements.len())];
        table.reset(element, &mut slot.rng)?;
        renderer.render_backdrop(table, &mut slot.backdrop)?;
        slot.occlusion = if slot.camera_state.draw_occlusion(self.settings.camera.arm_occlusion) {
            ArmOcclusion::Pending
        } else {
            ArmOcclusion::Off
        };
        let Slot { backdrop, occlusion, first, .. } = slot;
        renderer.render_observed(table, backdrop, occlusion, first)?;
        if let Some(randomiser) = &mut self.randomiser {
            randomiser.begin_episode(&mut slot.camera_state);
            randomiser.add_camera_errors(
                &mut slot.camera_state,
                table.hand_position(),
                &mut slot.first,
            );
        }
        let image = row_mut(&mut rows.batch.images, row, self.settings.image_len());
        renderer.compose_observation(table, &slot.first, &slot.first, image);
        row_mut(&mut rows.batch.vectors, row, VECTOR_OBSERVATION_DIM)
            .copy_from_slice(&table.observe()?);
        Ok(())
    }

    /// Takes one decision in environment `row` of the worker and writes its outcome, or nothing if
    /// it fails.
    fn decide(&mut self, row: usize, rows: &mut WorkerBatch) -> Result<(), EnvError> {
        let (table, slot) = (&mut self.tables[row], &mut self.slots[row]);
        let renderer = renderer_of(&mut self.renderers, table)?;
        #[cfg(test)]
        slot.break_with_fault(table, renderer);
        let mut action = [0.0; ACTION_DIM];
        action.copy_from_slice(row_mut(&mut rows.actions, row, ACTION_DIM));
        let step = table.step(&action)?;
        let vector = table.observe()?;
        let Slot { backdrop, occlusion, .. } = slot;
        renderer.render_observed(table, backdrop, occlusion, &mut self.picture)?;
        if let Some(randomiser) = &mut self.randomiser {
            randomiser.add_camera_errors(
                &mut slot.camera_state,
                table.hand_position(),
                &mut self.picture,
            );
        }
        let (images, vectors) = rows.write_step(row, &step);
        let image = row_mut(images, row, self.settings.image_len());
        renderer.compose_observation(table, &self.picture, &slot.first, image);
        row_mut(vectors, row, VECTOR_OBSERVATION_DIM).copy_from_slice(&vector);
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

/// Returns the random stream of an environment, independent of all others.
fn slot_rng(seed: u64, index: usize) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    // one seed, one stream per environment: results do not depend on the number of threads
    rng.set_stream(index as u64);
    rng
}

fn renderer_of<'a>(
    renderers: &'a mut BTreeMap<TaskGroup, SceneRenderer>,
    table: &TableTop,
) -> Result<&'a mut SceneRenderer, EnvError> {
    renderers.get_mut(&table.scene().group).ok_or(EnvError::NotReset)
}

/// Returns the text of a panic's message.
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
            let scene = Scene::new_in_layout(settings.layout, group, embodiment, camera);
            Arc::new(scene.unwrap())
        });
        let mut envs = SubEnvs::new(0..2, settings);
        let switch = |sub_envs: &mut SubEnvs, scene| {
            sub_envs.set_task_group(scene, D2::ALL.to_vec()).unwrap();
            sub_envs.tables.as_ptr()
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
