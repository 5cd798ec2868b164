//! What an actor with a context remembers of the running episodes.

use std::collections::VecDeque;

use crate::policy::Memory;

/// The last steps of the running episodes of N environments; nothing for an actor without a
/// context.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct History {
    /// Steps remembered at most.
    pub(super) length: usize,
    pub(super) envs: Vec<Episode>,
}

/// One running episode.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Episode {
    /// The last steps, the oldest first.
    pub past: VecDeque<Past>,
    /// Fields of the observation that was decided on, until its step is known.
    pub seen: Vec<f32>,
}

/// A step: the fields of its observation, its action and its reward.
#[derive(Clone, Debug, Default, PartialEq)]
pub(super) struct Past {
    pub fields: Vec<f32>,
    pub action: Vec<f32>,
    pub reward: f32,
}

impl History {
    pub(super) fn new(length: usize, envs: usize) -> Self {
        let envs = if length == 0 { 0 } else { envs };
        Self {
            length,
            envs: vec![Episode::default(); envs],
        }
    }
}

impl Memory for History {
    fn forget(&mut self, env: usize) {
        if let Some(episode) = self.envs.get_mut(env) {
            *episode = Episode::default();
        }
    }

    fn remember(&mut self, env: usize, action: &[f32], reward: f32) {
        let Some(episode) = self.envs.get_mut(env) else {
            return;
        };
        if episode.seen.is_empty() {
            return;
        }
        if episode.past.len() == self.length {
            episode.past.pop_front();
        }
        episode.past.push_back(Past {
            fields: std::mem::take(&mut episode.seen),
            action: action.to_vec(),
            reward,
        });
    }
}
