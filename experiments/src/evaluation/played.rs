//! Episodes that need not be played again.

use std::collections::HashMap;
use std::hash::{DefaultHasher, Hash, Hasher};

use envs::TaskVariant;

use learner::{Learner, Performance};

/// What policies did in the episodes of an evaluation, which are the same every time: a policy that
/// has not changed since would do the same again, to the bit.
#[derive(Debug, Default)]
pub(super) struct Played(HashMap<(TaskVariant, usize, usize), (u64, Performance)>);

impl Played {
    /// What `play` returns for `rounds` rounds of a variant with policy `index`; it is not called
    /// where the policy's parameters are those with which it was called last.
    pub fn recall<E>(
        &mut self,
        (variant, rounds): (TaskVariant, usize),
        learner: &mut dyn Learner,
        index: usize,
        play: impl FnOnce(&mut dyn Learner) -> Result<Performance, E>,
    ) -> Result<Performance, E> {
        let Some(actor) = learner.parameters(index).map(fingerprint) else {
            return play(learner);
        };
        let of = (variant, rounds, index);
        if let Some((played, performance)) = self.0.get(&of)
            && *played == actor
        {
            return Ok(performance.clone());
        }
        let performance = play(learner)?;
        self.0.insert(of, (actor, performance.clone()));
        Ok(performance)
    }
}

/// A number that differs, but for one case in 2^64, where parameters differ.
fn fingerprint(parameters: &[f32]) -> u64 {
    let mut hasher = DefaultHasher::new();
    let bits = parameters.iter().map(|parameter| parameter.to_bits());
    bits.for_each(|bits| bits.hash(&mut hasher));
    hasher.finish()
}
