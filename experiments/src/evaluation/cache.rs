//! Cache of evaluation results, for policies that have not changed.

use std::collections::HashMap;
use std::hash::{DefaultHasher, Hash, Hasher};

use envs::TaskVariant;

use learner::{Learner, PolicyEvaluationResult};

/// Key of a cached evaluation: task variant, episodes in each environment, and policy index.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub(super) struct CacheKey {
    pub variant: TaskVariant,
    pub episodes_per_env: usize,
    pub policy: usize,
}

/// Cache of the latest evaluation for each key, with the fingerprint of the policy's parameters.
/// Evaluations play the same episodes every time, so equal parameters give equal results, to the
/// bit.
#[derive(Debug, Default)]
pub(super) struct EvaluationCache(HashMap<CacheKey, (u64, PolicyEvaluationResult)>);

impl EvaluationCache {
    /// Returns the result of `play`, from the cache if the policy's parameters are unchanged.
    /// Policies whose learner exposes no parameters are always played.
    pub fn get_or_play<E>(
        &mut self,
        key: CacheKey,
        learner: &mut dyn Learner,
        play: impl FnOnce(&mut dyn Learner) -> Result<PolicyEvaluationResult, E>,
    ) -> Result<PolicyEvaluationResult, E> {
        let Some(parameters) = learner.policy_parameters(key.policy).map(fingerprint) else {
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
