//! What an actor with a context remembers of the running episodes.

use std::collections::VecDeque;

use crate::error::{RlError, check_len};
use crate::policy::Memory;

/// The last steps of the running episodes of N environments; nothing for an actor without a
/// context.
///
/// It is no part of what is saved: a learner that goes on from a file begins every episode anew, as
/// [`RolloutState::reset`](crate::RolloutState::reset) does.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct History {
    /// Steps remembered at most.
    length: usize,
    /// Length of the fields of an observation.
    pub(super) fields: usize,
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
    /// A memory of `length` steps with `fields` of this length each.
    pub(super) fn new([length, fields]: [usize; 2], envs: usize) -> Self {
        let envs = if length == 0 { 0 } else { envs };
        Self {
            length,
            fields,
            envs: vec![Episode::default(); envs],
        }
    }

    /// Refuses a memory that was made for a network of other sizes, or for another number of
    /// environments.
    pub(super) fn check(&self, [length, fields]: [usize; 2], envs: usize) -> Result<(), RlError> {
        check_len("steps of memory", "[L]", self.length, length)?;
        check_len("fields of memory", "[h]", self.fields, fields)?;
        let envs = if length == 0 { 0 } else { envs };
        check_len("memory", "[N]", self.envs.len(), envs)
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
