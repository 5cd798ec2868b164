//! A thread that owns some of the environments and the renderers of their scenes.

use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::Arc;
use std::sync::mpsc::{Receiver, Sender, channel};
use std::thread::JoinHandle;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use symmetry::D2;

use crate::EnvError;
use crate::dynamics::Dynamics;
use crate::picture::{Painter, RGB, stack};
use crate::scene::Scene;
use crate::settings::VecEnvSettings;
use crate::tabletop::{ACTION_DIM, TableTop, VECTOR_DIM};
use crate::task::TaskGroup;

/// What a worker is asked to do; it answers each with [`Rows`] or an error.
pub(crate) enum Command {
    /// Simulate this scene from the next reset on, with variants drawn from these elements.
    SetTasks(Arc<Scene>, Vec<D2>),
    /// Start an episode everywhere.
    Reset(Rows),
    /// Hold these actions for one decision.
    Step(Rows),
}

/// The worker's share of a batch; sent back and forth, so that nothing is allocated per step.
#[derive(Default)]
pub(crate) struct Rows {
    pub actions: Vec<f32>,
    pub images: Vec<u8>,
    pub vectors: Vec<f32>,
    pub final_images: Vec<u8>,
    pub final_vectors: Vec<f32>,
    pub rewards: Vec<f32>,
    pub success: Vec<bool>,
    pub truncated: Vec<bool>,
}

impl Rows {
    pub(crate) fn new(envs: usize, image_len: usize) -> Self {
        Self {
            actions: vec![0.0; envs * ACTION_DIM],
            images: vec![0; envs * image_len],
            vectors: vec![0.0; envs * VECTOR_DIM],
            final_images: vec![0; envs * image_len],
            final_vectors: vec![0.0; envs * VECTOR_DIM],
            rewards: vec![0.0; envs],
            success: vec![false; envs],
            truncated: vec![false; envs],
        }
    }
}

type Reply = Result<Option<Rows>, EnvError>;

/// The handle of one worker thread.
pub(crate) struct Worker {
    /// The environments that this worker owns.
    pub envs: Range<usize>,
    index: usize,
    commands: Option<Sender<Command>>,
    replies: Receiver<Reply>,
    thread: Option<JoinHandle<()>>,
}

impl Worker {
    pub(crate) fn spawn(
        index: usize,
        envs: Range<usize>,
        settings: VecEnvSettings,
    ) -> Result<Self, EnvError> {
        let (commands, inbox) = channel();
        let (outbox, replies) = channel();
        let owned = envs.clone();
        let thread = std::thread::Builder::new()
            .name(format!("envs-{index}"))
            .spawn(move || {
                let mut share = Share::new(owned, settings);
                while let Ok(command) = inbox.recv() {
                    if outbox.send(share.obey(command)).is_err() {
                        break;
                    }
                }
            })
            .map_err(|source| EnvError::Spawn {
                worker: index,
                source,
            })?;
        Ok(Self {
            envs,
            index,
            commands: Some(commands),
            replies,
            thread: Some(thread),
        })
    }

    /// Hands over a command; that the thread is gone shows when its answer is awaited.
    pub(crate) fn send(&self, command: Command) {
        if let Some(commands) = &self.commands {
            let _ = commands.send(command);
        }
    }

    /// Waits for the answer to the last command.
    pub(crate) fn receive(&mut self) -> Reply {
        self.replies.recv().unwrap_or_else(|_| {
            let worker = self.index;
            let message = self.autopsy();
            Err(EnvError::WorkerLost { worker, message })
        })
    }

    fn autopsy(&mut self) -> String {
        let Some(Err(panic)) = self.thread.take().map(JoinHandle::join) else {
            return "it had ended before".to_owned();
        };
        let text = panic.downcast_ref::<&str>().map(ToString::to_string);
        text.or_else(|| panic.downcast_ref::<String>().cloned())
            .unwrap_or_else(|| "no message".to_owned())
    }
}

impl Drop for Worker {
    fn drop(&mut self) {
        self.commands = None;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}

/// One environment slot: its random stream and its episode's first picture.
struct Slot {
    index: usize,
    rng: ChaCha8Rng,
    first: Vec<u8>,
}

/// A group's tables, one a slot, and the painter they share.
struct Tables {
    tables: Vec<TableTop>,
    painter: Painter,
}

/// What a worker thread owns.
struct Share {
    settings: VecEnvSettings,
    slots: Vec<Slot>,
    groups: BTreeMap<TaskGroup, Tables>,
    current: Option<TaskGroup>,
    elements: Vec<D2>,
    picture: Vec<u8>,
}

impl Share {
    fn new(envs: Range<usize>, settings: VecEnvSettings) -> Self {
        let pixels = settings.camera.size * settings.camera.size * RGB;
        let slots = envs.map(|index| {
            let mut rng = ChaCha8Rng::seed_from_u64(settings.seed);
            rng.set_stream(index as u64);
            Slot {
                index,
                rng,
                first: vec![0; pixels],
            }
        });
        Self {
            settings,
            slots: slots.collect(),
            groups: BTreeMap::new(),
            current: None,
            elements: Vec::new(),
            picture: vec![0; pixels],
        }
    }

    fn obey(&mut self, command: Command) -> Reply {
        match command {
            Command::SetTasks(scene, elements) => self.set_tasks(scene, elements).map(|()| None),
            Command::Reset(mut rows) => self.reset(&mut rows).map(|()| Some(rows)),
            Command::Step(mut rows) => self.step(&mut rows).map(|()| Some(rows)),
        }
    }

    /// Ends whatever ran before: a step without a reset is refused, also where this fails.
    fn set_tasks(&mut self, scene: Arc<Scene>, elements: Vec<D2>) -> Result<(), EnvError> {
        self.current = None;
        let group = scene.group;
        match self.groups.get_mut(&group) {
            Some(known) => known.tables.iter_mut().for_each(TableTop::end_episode),
            None => {
                let tables = Tables::new(scene, self.settings.dynamics, self.slots.len())?;
                self.groups.insert(group, tables);
            }
        }
        self.current = Some(group);
        self.elements = elements;
        Ok(())
    }

    fn reset(&mut self, rows: &mut Rows) -> Result<(), EnvError> {
        (0..self.slots.len()).try_for_each(|row| {
            let index = self.slots[row].index;
            self.begin(row, rows).map_err(|error| error.of(index))
        })
    }

    /// Starts an episode in slot `row` and writes its first observation.
    fn begin(&mut self, row: usize, rows: &mut Rows) -> Result<(), EnvError> {
        let slot = &mut self.slots[row];
        let Tables { tables, painter } = current(&mut self.groups, self.current)?;
        let element = self.elements[slot.rng.random_range(0..self.elements.len())];
        tables[row].reset(element, &mut slot.rng)?;
        painter.paint(&mut tables[row], &mut slot.first)?;
        stack(
            &slot.first,
            &slot.first,
            chunk(&mut rows.images, row, self.settings.image_len()),
        );
        chunk(&mut rows.vectors, row, VECTOR_DIM).copy_from_slice(&tables[row].observe()?);
        Ok(())
    }

    fn step(&mut self, rows: &mut Rows) -> Result<(), EnvError> {
        (0..self.slots.len()).try_for_each(|row| {
            let index = self.slots[row].index;
            self.decide(row, rows).map_err(|error| error.of(index))
        })
    }

    /// Takes one decision in slot `row`, writes what it led to, and starts the next episode where one ended.
    fn decide(&mut self, row: usize, rows: &mut Rows) -> Result<(), EnvError> {
        let Tables { tables, painter } = current(&mut self.groups, self.current)?;
        let mut action = [0.0; ACTION_DIM];
        action.copy_from_slice(chunk(&mut rows.actions, row, ACTION_DIM));
        let step = tables[row].step(&action)?;
        painter.paint(&mut tables[row], &mut self.picture)?;
        rows.rewards[row] = step.reward as f32;
        rows.success[row] = step.success;
        rows.truncated[row] = step.truncated;
        let (images, vectors) = if step.truncated {
            (&mut rows.final_images, &mut rows.final_vectors)
        } else {
            (&mut rows.images, &mut rows.vectors)
        };
        let image = chunk(images, row, self.settings.image_len());
        stack(&self.picture, &self.slots[row].first, image);
        chunk(vectors, row, VECTOR_DIM).copy_from_slice(&tables[row].observe()?);
        if step.truncated {
            self.begin(row, rows)?;
        }
        Ok(())
    }
}

impl Tables {
    fn new(scene: Arc<Scene>, dynamics: Dynamics, count: usize) -> Result<Self, EnvError> {
        let tables = (0..count)
            .map(|_| TableTop::new(Arc::clone(&scene), dynamics))
            .collect::<Result<_, _>>()?;
        let painter = Painter::new(scene)?;
        Ok(Self { tables, painter })
    }
}

fn current(
    groups: &mut BTreeMap<TaskGroup, Tables>,
    group: Option<TaskGroup>,
) -> Result<&mut Tables, EnvError> {
    group
        .and_then(|group| groups.get_mut(&group))
        .ok_or(EnvError::NotReset)
}

fn chunk<T>(values: &mut [T], row: usize, len: usize) -> &mut [T] {
    &mut values[row * len..(row + 1) * len]
}
