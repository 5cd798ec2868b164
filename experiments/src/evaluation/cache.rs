//! Cache of evaluation results, for policies that have not changed.

use std::collections::HashMap;
use std::hash::{DefaultHasher, Hash, Hasher};

use envs::TaskVariant;

use learner::{Learner, Performance};

/// Episodes of one policy: a variant, episodes in each environment, and the policy's index.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct Key {
    pub variant: TaskVariant,
    pub rounds: usize,
    pub policy: usize,
}

/// Latest result for each key, with the fingerprint of the parameters that gave it. Evaluations
/// play the same episodes every time, so equal parameters give equal results, to the bit.
#[derive(Debug, Default)]
pub(super) struct EvaluationCache(HashMap<Key, (u64, Performance)>);

impl EvaluationCache {
    /// Returns the result of `play`, from the cache if the policy's parameters are unchanged.
    /// Policies whose learner exposes no parameters are always played.
    pub fn get_or_play<E>(
        &mut self,
        key: Key,
        learner: &mut dyn Learner,
        play: impl FnOnce(&mut dyn Learner) -> Result<Performance, E>,
    ) -> Result<Performance, E> {
        let Some(parameters) = learner.parameters(key.policy).map(fingerprint) else {
            return play(learner);
        };
        if let Some((cached, performance)) = self.0.get(&key)
            && *cached == parameters
        {
            return Ok(performance.clone());
        }
        let performance = play(learner)?;
        self.0.insert(key, (parameters, performance.clone()));
        Ok(performance)
    }
}

/// Returns a 64-bit hash of the bits of all parameters.
fn fingerprint(parameters: &[f32]) -> u64 {
    let mut hasher = DefaultHasher::new();
    // bits tell 0.0 from -0.0, so that a hit means equal bits, but for one collision in 2^64
    let bits = parameters.iter().map(|parameter| parameter.to_bits());
    bits.for_each(|bits| bits.hash(&mut hasher));
    hasher.finish()
}
