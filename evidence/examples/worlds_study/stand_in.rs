//! A policy that needs no training: an expert who learns by turns.

use rand::{Rng, RngExt};
use worlds::Stream;

/// Turns after which a policy has learnt all but a third of its group.
const TURNS: f32 = 3.0;
/// Spread of exploration.
const EXPLORATION: f32 = 0.3;
/// Turns that a policy remembers.
const MEMORY: usize = 8;

/// Acts for the group that it learnt on most of late, the better the longer it learnt on it.
#[derive(Clone, Debug, Default)]
pub struct StandIn {
    learnt: Vec<usize>,
}

impl StandIn {
    /// Learns one turn on tasks of `group`.
    pub fn learn(&mut self, group: usize) {
        self.learnt.push(group);
        if self.learnt.len() > MEMORY {
            self.learnt.remove(0);
        }
    }

    /// The group that it acts for, and how well, in [0, 1).
    fn skill(&self) -> Option<(usize, f32)> {
        let turns = |group| {
            self.learnt
                .iter()
                .filter(|&&learnt| learnt == group)
                .count()
        };
        let most = self
            .learnt
            .iter()
            .copied()
            .max_by_key(|&group| turns(group))?;
        Some((most, 1.0 - (-(turns(most) as f32) / TURNS).exp()))
    }

    /// An action in environment `env`.
    pub fn act<R: Rng>(&self, stream: &Stream, env: usize, rng: &mut R) -> [f32; 2] {
        let (group, skill) = self.skill().unwrap_or((0, 0.0));
        stream.expert(env, group).map(|action| {
            let noise: f32 = rng.random_range(-1.0..1.0);
            skill * (action + EXPLORATION * noise) + (1.0 - skill) * noise
        })
    }
}
