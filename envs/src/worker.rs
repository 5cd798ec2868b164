//! Worker thread that owns some of a vector environment's environments.

use std::ops::Range;
use std::sync::mpsc::{Receiver, SyncSender, sync_channel};
use std::thread::JoinHandle;

use crate::error::EnvError;
use crate::messages::{WorkerCommand, WorkerReply};
use crate::settings::VecEnvSettings;
use crate::sub_envs::{SubEnvs, panic_message};

/// Handle of one worker thread of a vector environment.
pub(crate) struct Worker {
    /// Range of the environments that this worker owns.
    pub envs: Range<usize>,
    index: usize,
    commands: Option<SyncSender<WorkerCommand>>,
    replies: Receiver<WorkerReply>,
    thread: Option<JoinHandle<()>>,
}

impl Worker {
    pub(crate) fn spawn(
        index: usize,
        envs: Range<usize>,
        settings: VecEnvSettings,
    ) -> Result<Self, EnvError> {
        // bounded channels, because unbounded ones allocate for every message
        let (commands, inbox) = sync_channel(1);
        let (outbox, replies) = sync_channel(1);
        let owned = envs.clone();
        let thread = std::thread::Builder::new()
            .name(format!("envs-{index}"))
            .spawn(move || {
                let mut sub_envs = SubEnvs::new(owned, settings);
                while let Ok(command) = inbox.recv() {
                    // nobody waits for an answer once the vector environment is dropped
                    if outbox.send(sub_envs.handle(command)).is_err() {
                        break;
                    }
                }
            })
            .map_err(|source| EnvError::Spawn { worker: index, source })?;
        Ok(Self { envs, index, commands: Some(commands), replies, thread: Some(thread) })
    }

    /// Sends the worker thread a command. If the thread is gone, [`Worker::receive`] reports it.
    pub(crate) fn send(&self, command: WorkerCommand) {
        if let Some(commands) = &self.commands {
            let _ = commands.send(command);
        }
    }

    /// Waits for the worker thread's answer to the last command.
    pub(crate) fn receive(&mut self) -> WorkerReply {
        self.replies.recv().unwrap_or_else(|_| {
            let worker = self.index;
            let message = self.exit_message();
            WorkerReply { rows: None, result: Err(EnvError::WorkerLost { worker, message }) }
        })
    }

    /// Returns the reason for which the worker thread ended.
    fn exit_message(&mut self) -> String {
        match self.thread.take().map(JoinHandle::join) {
            Some(Err(panic)) => panic_message(&*panic),
            _ => "it had ended before".to_owned(),
        }
    }
}

impl Drop for Worker {
    fn drop(&mut self) {
        // closes the channel, which ends the thread's loop, so that `join` returns
        self.commands = None;
        if let Some(thread) = self.thread.take() {
            let _ = thread.join();
        }
    }
}
