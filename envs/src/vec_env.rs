//! Vector environment: worker threads step many environments, each thread with its own off-screen
//! renderer.

use std::collections::BTreeMap;
use std::ops::Range;
use std::sync::Arc;

use symmetry::D2;

use crate::batch::{ObservationsMut, StepResultsMut};
use crate::camera::RGB_CHANNELS;
use crate::control::check_action;
use crate::error::EnvError;
use crate::messages::{
    EnvCommand, EnvFailure, EnvSnapshot, PictureSettings, WorkerBatch, WorkerCommand, copy_row,
};
use crate::renderer::ViewSettings;
use crate::scene::Scene;
use crate::settings::VecEnvSettings;
use crate::tabletop::{ACTION_DIM, STATE_DETAILS_DIM, VECTOR_OBSERVATION_DIM};
use crate::task::TaskGroup;
use crate::worker::Worker;

/// Vectorised environment: N table-top environments that step together on one task group. Where an
/// episode ends, the next begins at once with a newly drawn variant.
///
/// Environment i draws from its own random stream, so results depend on the seed alone.
///
/// If an environment fails in a step (its simulation diverges, or its code panics), the others go
/// on. Its episode ends like a time-out at the observation before that step: reward 0, `truncated`,
/// that observation as the final one. Its next episode has then begun. If that restart fails, the
/// row keeps its observation, and every step tries again. [`VecEnv::reset`] and [`VecEnv::step`]
/// return these failures; a failed restart is a second failure of its environment.
///
/// If rendering fails, for instance because the OpenGL context is lost, the call fails for all
/// environments. The next [`VecEnv::reset`] makes new renderers and recovers.
///
/// A fork copies no worker threads, so in a forked child every call that needs them returns
/// [`EnvError::UsedAfterFork`], and dropping the environments there leaks their memory.
pub struct VecEnv {
    settings: VecEnvSettings,
    scenes: BTreeMap<TaskGroup, Arc<Scene>>,
    workers: Vec<Worker>,
    rows: Vec<WorkerBatch>,
    failures: Vec<EnvFailure>,
    /// `true` while episodes run: after a reset, until the task group changes or a call fails.
    running: bool,
    /// Identifier of the process with the worker threads.
    process: u32,
}

impl VecEnv {
    /// Creates N environments of `group` on worker threads; each episode's variant is drawn
    /// uniformly from `elements`.
    ///
    /// # Errors
    /// [`EnvError::InvalidSetting`], [`EnvError::NoVariants`], [`EnvError::NoSuchVariant`], or an
    /// error of MuJoCo or OpenGL.
    pub fn new(
        settings: VecEnvSettings,
        group: TaskGroup,
        elements: &[D2],
    ) -> Result<Self, EnvError> {
        Self::new_shard(settings, group, elements, 0..settings.num_envs)
    }

    /// Creates only the environments with indices in `share`, one process's part of all N. They are
    /// those of [`VecEnv::new`]. Arrays have rows for all N, of which calls write only those of the
    /// share. An empty share is allowed: there may be more processes than environments.
    ///
    /// # Errors
    /// As [`VecEnv::new`], and [`EnvError::InvalidSetting`] for a `share` that ends before it starts
    /// or beyond the environments.
    pub fn new_shard(
        settings: VecEnvSettings,
        group: TaskGroup,
        elements: &[D2],
        share: Range<usize>,
    ) -> Result<Self, EnvError> {
        settings.check()?;
        if share.start > share.end || share.end > settings.num_envs {
            return Err(EnvError::InvalidSetting {
                name: "share",
                value: format!("{share:?}"),
                expected: "a range within 0..num_envs that does not end before it starts",
            });
        }
        let mut vec_env = Self {
            settings,
            scenes: BTreeMap::new(),
            workers: Vec::new(),
            rows: Vec::new(),
            failures: Vec::new(),
            running: false,
            process: std::process::id(),
        };
        // before any thread starts, because the first model of a process configures software
        // rendering (see `mujoco`)
        vec_env.scene(group)?;
        vec_env.workers = spawn(settings, share)?;
        vec_env.set_task_group(group, elements)?;
        Ok(vec_env)
    }

    /// Returns the settings of the environments, with the seed of the last [`VecEnv::reseed`].
    pub fn settings(&self) -> &VecEnvSettings {
        &self.settings
    }

    /// Makes the models and renderers of `groups` and simulates their scenes to rest, so that
    /// [`VecEnv::set_task_group`] is cheap from then on.
    ///
    /// # Errors
    /// [`EnvError::DuplicateTask`] if another task of this name is prepared, or an error of MuJoCo
    /// or OpenGL.
    pub fn prepare_task_groups(&mut self, groups: &[TaskGroup]) -> Result<(), EnvError> {
        for &group in groups {
            let scene = self.scene(group)?;
            self.broadcast(|| WorkerCommand::Prepare(Arc::clone(&scene)))?;
        }
        Ok(())
    }

    /// Switches every environment to `group`, with variants drawn uniformly from `elements`.
    /// Running episodes end: call [`VecEnv::reset`] next.
    ///
    /// A group that is not prepared is prepared first, see [`VecEnv::prepare_task_groups`].
    ///
    /// # Errors
    /// [`EnvError::DuplicateTask`] if another task of this name is prepared,
    /// [`EnvError::NoVariants`], [`EnvError::NoSuchVariant`], or an error of MuJoCo or OpenGL. If
    /// the group is rejected, running episodes go on.
    pub fn set_task_group(&mut self, group: TaskGroup, elements: &[D2]) -> Result<(), EnvError> {
        if elements.is_empty() {
            return Err(EnvError::NoVariants { group });
        }
        let layout = self.settings.layout;
        elements.iter().try_for_each(|&g| layout.check_variant(g))?;
        self.prepare_task_groups(&[group])?;
        let scene = self.scene(group)?;
        self.running = false;
        self.broadcast(|| WorkerCommand::SetTasks(Arc::clone(&scene), elements.to_vec()))
    }

    /// Restarts the random streams of variants, placements and camera errors from `seed`. Episodes
    /// from the next [`VecEnv::reset`] on are those of a new environment with this seed.
    ///
    /// # Errors
    /// [`EnvError::WorkerLost`].
    pub fn reseed(&mut self, seed: u64) -> Result<(), EnvError> {
        let streams = (0..self.settings.num_envs).map(|env| (seed, env)).collect();
        self.restart_streams(streams)?;
        self.settings.seed = seed;
        Ok(())
    }

    /// Restarts the random streams of environment i from `seeds[i]`; its episodes from the next
    /// reset on are those of a vector of one environment with that seed.
    ///
    /// # Errors
    /// [`EnvError::LengthMismatch`], [`EnvError::WorkerLost`].
    pub fn reseed_each(&mut self, seeds: &[u64]) -> Result<(), EnvError> {
        check_len("seeds", seeds.len(), self.settings.num_envs)?;
        self.restart_streams(seeds.iter().map(|&seed| (seed, 0)).collect())
    }

    fn restart_streams(&mut self, streams: Arc<[(u64, usize)]>) -> Result<(), EnvError> {
        self.broadcast(|| WorkerCommand::Reseed(Arc::clone(&streams)))
    }

    /// Returns the scene of `group`, compiled on this thread at its first use and shared by all
    /// workers.
    fn scene(&mut self, group: TaskGroup) -> Result<Arc<Scene>, EnvError> {
        if let Some(scene) = self.scenes.get(&group) {
            if scene.group.instance_id() == group.instance_id() {
                return Ok(Arc::clone(scene));
            }
            let name = group.name().to_owned();
            return Err(EnvError::DuplicateTask { name });
        }
        let VecEnvSettings { layout, embodiment, camera, .. } = self.settings;
        let scene = Arc::new(Scene::new_in_layout(layout, group, embodiment, camera)?);
        self.scenes.insert(group, Arc::clone(&scene));
        Ok(scene)
    }

    /// Starts a new episode in every environment, writes the first observations to `out`, and
    /// returns the environments that failed.
    ///
    /// # Errors
    /// [`EnvError::LengthMismatch`] for buffers of the wrong size, or an error of OpenGL.
    pub fn reset(&mut self, out: ObservationsMut<'_>) -> Result<&[EnvFailure], EnvError> {
        self.check_observations(&out)?;
        self.prepare_rows();
        self.rows.iter_mut().for_each(|rows| rows.commands.fill(EnvCommand::Reset));
        self.run(WorkerCommand::Advance)?;
        self.copy_observations(out);
        Ok(&self.failures)
    }

    /// Holds `actions` `[N, 4]` for one decision in every environment, begins the next episode
    /// where one ended, and returns the environments that failed.
    ///
    /// # Errors
    /// [`EnvError::LengthMismatch`] or [`EnvError::NonFiniteAction`], and nothing has moved;
    /// [`EnvError::NotReset`]; an [`EnvError::InEnv`] with an error of OpenGL, after which
    /// [`VecEnv::reset`] makes new renderers.
    pub fn step(
        &mut self,
        actions: &[f32],
        out: StepResultsMut<'_>,
    ) -> Result<&[EnvFailure], EnvError> {
        self.check_step(actions, &out)?;
        self.require_running()?;
        self.rows.iter_mut().for_each(|rows| rows.commands.fill(EnvCommand::Step));
        self.advance_rows(actions, out)
    }

    /// Executes `commands` `[N]` with `actions` `[N, 4]`, and returns the environments that failed.
    /// The caller thus decides when each episode begins.
    ///
    /// Environments that take no decision get reward 0 and flags `false`. A resting one keeps its
    /// last observation.
    ///
    /// # Errors
    /// Errors of [`VecEnv::step`]; [`EnvError::NotReset`] for commands other than `Reset` before
    /// the first reset, or after the tasks changed or a call failed. One environment without a
    /// running episode is an [`EnvFailure`] of that environment.
    pub fn execute_commands(
        &mut self,
        actions: &[f32],
        commands: &[EnvCommand],
        out: StepResultsMut<'_>,
    ) -> Result<&[EnvFailure], EnvError> {
        self.check_step(actions, &out)?;
        check_len("commands", commands.len(), self.settings.num_envs)?;
        if commands.iter().any(|&command| command != EnvCommand::Reset) {
            self.require_running()?;
        }
        self.prepare_rows();
        for (rows, worker) in self.rows.iter_mut().zip(&self.workers) {
            rows.commands.copy_from_slice(&commands[worker.envs.clone()]);
        }
        self.advance_rows(actions, out)
    }

    /// Writes the scripted experts' actions for the present states to `actions` `[N, 4]`.
    ///
    /// # Errors
    /// [`EnvError::LengthMismatch`], [`EnvError::NotReset`], [`EnvError::NonFiniteCommand`];
    /// episodes go on.
    pub fn expert_actions(&mut self, actions: &mut [f32]) -> Result<(), EnvError> {
        check_len("actions", actions.len(), self.settings.num_envs * ACTION_DIM)?;
        self.require_running()?;
        self.send_rows(WorkerCommand::Experts)?;
        for (rows, worker) in self.rows.iter().zip(&self.workers) {
            actions[action_range(worker)].copy_from_slice(&rows.actions);
        }
        Ok(())
    }

    /// Writes the positions of the present states and the reward terms of the last actions to `out`
    /// `[N, 16]`, see [`STATE_DETAILS_DIM`]; NaN where no episode runs.
    ///
    /// # Errors
    /// [`EnvError::LengthMismatch`], [`EnvError::NotReset`]; episodes go on.
    pub fn state_details(&mut self, out: &mut [f32]) -> Result<(), EnvError> {
        check_len("details", out.len(), self.settings.num_envs * STATE_DETAILS_DIM)?;
        self.require_running()?;
        self.send_rows(WorkerCommand::Details)?;
        for (rows, worker) in self.rows.iter().zip(&self.workers) {
            let Range { start, end } = worker.envs;
            out[start * STATE_DETAILS_DIM..end * STATE_DETAILS_DIM].copy_from_slice(&rows.details);
        }
        Ok(())
    }

    /// Renders the present states in `view` into `out` `[N, size, size, 3]`, for people. Pictures
    /// that a policy observes are in [`ObservationsMut`].
    ///
    /// # Errors
    /// [`EnvError::LengthMismatch`], [`EnvError::NotReset`], [`EnvError::Render`]; episodes go on.
    pub fn render(&mut self, view: ViewSettings, out: &mut [u8]) -> Result<(), EnvError> {
        let picture = view.size * view.size * RGB_CHANNELS;
        check_len("pictures", out.len(), self.settings.num_envs * picture)?;
        self.require_running()?;
        for (rows, worker) in self.rows.iter_mut().zip(&self.workers) {
            rows.view = Some((view, vec![0; worker.envs.len() * picture]));
        }
        self.send_rows(WorkerCommand::Render)?;
        for (rows, worker) in self.rows.iter_mut().zip(&self.workers) {
            if let Some((_, pictures)) = rows.view.take() {
                let Range { start, end } = worker.envs;
                out[start * picture..end * picture].copy_from_slice(&pictures);
            }
        }
        Ok(())
    }

    /// Returns snapshots of the running episodes, `[N]`; of a shard, of its own environments alone.
    ///
    /// # Errors
    /// [`EnvError::NotReset`], also of a single environment whose simulation failed; episodes go
    /// on.
    pub fn save(&mut self) -> Result<Vec<EnvSnapshot>, EnvError> {
        self.require_running()?;
        self.send_rows(WorkerCommand::Save)?;
        Ok(self.rows.iter_mut().flat_map(|rows| std::mem::take(&mut rows.snapshots)).collect())
    }

    /// Restores the episodes of `snapshots` `[N]`, those of all shards together, which then continue bit for bit as the saved
    /// ones do, and writes their last observations to `out`.
    ///
    /// # Errors
    /// [`EnvError::LengthMismatch`], or [`EnvError::SceneMismatch`] for snapshots with another camera
    /// or randomisation, and episodes go on; [`EnvError::SceneMismatch`] for snapshots of another
    /// task or other settings, or an error of MuJoCo or OpenGL, and [`VecEnv::reset`] must come
    /// next.
    pub fn restore(
        &mut self,
        snapshots: &[EnvSnapshot],
        out: ObservationsMut<'_>,
    ) -> Result<(), EnvError> {
        check_len("snapshots", snapshots.len(), self.settings.num_envs)?;
        self.check_observations(&out)?;
        let own = PictureSettings::new(&self.settings);
        if let Some(other) = snapshots.iter().find(|snapshot| snapshot.pictures != own) {
            let [got, expected] = [other.pictures, own].map(|one| {
                if other.pictures.camera == own.camera {
                    format!("the randomisation {:?}", one.randomisation)
                } else {
                    format!("{:?}", one.camera)
                }
            });
            return Err(EnvError::SceneMismatch { got, expected });
        }
        self.prepare_rows();
        for (rows, worker) in self.rows.iter_mut().zip(&self.workers) {
            rows.snapshots = snapshots[worker.envs.clone()].to_vec();
        }
        self.run(WorkerCommand::Restore)?;
        self.copy_observations(out);
        Ok(())
    }

    /// Returns an error in a forked child, which has no worker threads.
    fn require_own_process(&self) -> Result<(), EnvError> {
        let (made_in, process) = (self.process, std::process::id());
        if made_in == process {
            return Ok(());
        }
        Err(EnvError::UsedAfterFork { made_in, process })
    }

    /// Returns an error if no episodes run, or after a worker thread was lost with its buffers.
    fn require_running(&self) -> Result<(), EnvError> {
        self.require_own_process()?;
        if self.running && self.rows.len() == self.workers.len() {
            return Ok(());
        }
        Err(EnvError::NotReset)
    }

    /// Executes the commands in the workers' buffers and copies the results to `out`.
    fn advance_rows(
        &mut self,
        actions: &[f32],
        out: StepResultsMut<'_>,
    ) -> Result<&[EnvFailure], EnvError> {
        for (rows, worker) in self.rows.iter_mut().zip(&self.workers) {
            rows.actions.copy_from_slice(&actions[action_range(worker)]);
        }
        self.run(WorkerCommand::Advance)?;
        self.copy_finals(out.final_observations);
        for (rows, worker) in self.rows.iter().zip(&self.workers) {
            let envs = worker.envs.clone();
            out.rewards[envs.clone()].copy_from_slice(&rows.batch.rewards);
            out.success[envs.clone()].copy_from_slice(&rows.batch.success);
            out.success_at_end[envs.clone()].copy_from_slice(&rows.batch.success_at_end);
            out.truncated[envs].copy_from_slice(&rows.batch.truncated);
        }
        self.copy_observations(out.observations);
        Ok(&self.failures)
    }

    /// Sends the workers their buffers with `command`, and collects the environments' failures.
    fn run(&mut self, command: fn(WorkerBatch) -> WorkerCommand) -> Result<(), EnvError> {
        self.running = false;
        // after an error episodes count as ended, until a reset succeeds
        self.send_rows(command)?;
        self.running = true;
        self.failures.clear();
        for rows in &mut self.rows {
            self.failures.append(&mut rows.failures);
        }
        Ok(())
    }

    /// Sends every worker its buffers with `command` and waits for them to come back.
    fn send_rows(&mut self, command: fn(WorkerBatch) -> WorkerCommand) -> Result<(), EnvError> {
        self.require_own_process()?;
        for (rows, worker) in self.rows.drain(..).zip(&self.workers) {
            worker.send(command(rows));
        }
        self.receive()
    }

    /// Sends every worker a command without buffers.
    fn broadcast(&mut self, command: impl Fn() -> WorkerCommand) -> Result<(), EnvError> {
        self.require_own_process()?;
        for worker in &self.workers {
            worker.send(command());
        }
        self.receive()
    }

    /// Creates the workers' buffers, at first use and after a worker was lost.
    fn prepare_rows(&mut self) {
        if self.rows.len() != self.workers.len() {
            let rows = |worker: &Worker| {
                WorkerBatch::new(&VecEnvSettings { num_envs: worker.envs.len(), ..self.settings })
            };
            self.rows = self.workers.iter().map(rows).collect();
        }
    }

    /// Waits for the answers of all workers, then returns the first error. All answers are received
    /// even then, so that commands and answers stay paired.
    fn receive(&mut self) -> Result<(), EnvError> {
        let mut first_error = Ok(());
        for worker in &mut self.workers {
            let reply = worker.receive();
            self.rows.extend(reply.rows);
            first_error = first_error.and(reply.result);
        }
        first_error
    }

    fn copy_observations(&self, out: ObservationsMut<'_>) {
        let image = self.settings.image_len();
        for (rows, worker) in self.rows.iter().zip(&self.workers) {
            let (start, end) = (worker.envs.start, worker.envs.end);
            out.images[start * image..end * image].copy_from_slice(&rows.batch.images);
            out.vectors[start * VECTOR_OBSERVATION_DIM..end * VECTOR_OBSERVATION_DIM]
                .copy_from_slice(&rows.batch.vectors);
        }
    }

    fn copy_finals(&self, out: ObservationsMut<'_>) {
        let image = self.settings.image_len();
        for (rows, worker) in self.rows.iter().zip(&self.workers) {
            for (row, env) in worker.envs.clone().enumerate() {
                if rows.auto_resets(row) {
                    copy_row(&rows.batch.final_images, row, out.images, env, image);
                    copy_row(
                        &rows.batch.final_vectors,
                        row,
                        out.vectors,
                        env,
                        VECTOR_OBSERVATION_DIM,
                    );
                }
            }
        }
    }

    fn check_observations(&self, out: &ObservationsMut<'_>) -> Result<(), EnvError> {
        let n = self.settings.num_envs;
        check_len("images", out.images.len(), n * self.settings.image_len())?;
        check_len("vectors", out.vectors.len(), n * VECTOR_OBSERVATION_DIM)
    }

    fn check_step(&self, actions: &[f32], out: &StepResultsMut<'_>) -> Result<(), EnvError> {
        let n = self.settings.num_envs;
        check_len("actions", actions.len(), n * ACTION_DIM)?;
        for (index, action) in actions.chunks_exact(ACTION_DIM).enumerate() {
            check_action(action).map_err(|error| error.in_env(index))?;
        }
        self.check_observations(&out.observations)?;
        self.check_observations(&out.final_observations)?;
        check_len("rewards", out.rewards.len(), n)?;
        check_len("success", out.success.len(), n)?;
        check_len("success_at_end", out.success_at_end.len(), n)?;
        check_len("truncated", out.truncated.len(), n)
    }
}

impl Drop for VecEnv {
    fn drop(&mut self) {
        // joining a thread that a fork did not copy panics, and its channels may be locked forever
        if self.require_own_process().is_err() {
            std::mem::forget(std::mem::take(&mut self.workers));
        }
    }
}

fn action_range(worker: &Worker) -> Range<usize> {
    worker.envs.start * ACTION_DIM..worker.envs.end * ACTION_DIM
}

/// Starts the worker threads, each with a contiguous part of the environments in `share`.
fn spawn(settings: VecEnvSettings, share: Range<usize>) -> Result<Vec<Worker>, EnvError> {
    let (part, end) = (share.len().div_ceil(settings.threads).max(1), share.end);
    let firsts = share.step_by(part).enumerate();
    firsts
        .map(|(index, first)| {
            let envs = first..(first + part).min(end);
            Worker::spawn(index, envs, settings)
        })
        .collect()
}

fn check_len(what: &'static str, got: usize, expected: usize) -> Result<(), EnvError> {
    if got == expected {
        return Ok(());
    }
    Err(EnvError::LengthMismatch { what, got, expected })
}

#[cfg(test)]
mod tests;
