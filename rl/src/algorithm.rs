//! What improves a policy from experience.

use rand_chacha::ChaCha8Rng;

use crate::error::RlError;

/// Improves a policy from experience and owns the state of its optimisers.
///
/// What it saves, with the policy's parameters and the generator, is everything that its next
/// update depends on besides the experience.
pub trait Algorithm {
    /// What it improves.
    type Policy;
    /// What it learns from: [`RolloutBuffer`](crate::RolloutBuffer) for on-policy algorithms, a
    /// replay for others.
    type Experience;
    /// What it reports.
    type Stats: Metrics;

    /// Improves `policy` once; random draws come from `rng`.
    ///
    /// # Errors
    /// [`RlError::NotFinite`] when a quantity diverges; `policy` then has the parameters from
    /// before the offending step. Other errors where policy and experience do not fit.
    fn update(
        &mut self,
        policy: &mut Self::Policy,
        experience: &Self::Experience,
        rng: &mut ChaCha8Rng,
    ) -> Result<Self::Stats, RlError>;

    /// All state by name, for a checkpoint. Names, lengths and their order never change.
    fn save(&self) -> AlgorithmState<'_>;

    /// Continues from a state that [`Algorithm::save`] gave. After an error, nothing has changed.
    ///
    /// # Errors
    /// [`RlError::State`] for a state of another algorithm or network, [`RlError::Damaged`] for
    /// numbers that cannot be right.
    fn restore(&mut self, state: &AlgorithmState<'_>) -> Result<(), RlError>;
}

/// What can be logged by name, so that learners of different kinds write into one table.
pub trait Metrics {
    /// Names and values. Names and their order are the same after every update of one algorithm.
    fn metrics(&self) -> Vec<(String, f64)>;
}

/// The state of an [`Algorithm`] between two updates, as named arrays and counters.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AlgorithmState<'a> {
    /// Arrays and their names.
    pub tensors: Vec<(&'a str, &'a [f32])>,
    /// Counters and their names.
    pub counters: Vec<(&'a str, u64)>,
}

impl AlgorithmState<'_> {
    /// Checks a state that was read from a file: it has the names and lengths of `own`, in the same
    /// order, and every number is finite.
    ///
    /// # Errors
    /// [`RlError::State`] or [`RlError::Damaged`].
    pub fn check_like(&self, own: &AlgorithmState<'_>) -> Result<(), RlError> {
        let (got, expected) = (self.layout(), own.layout());
        if got != expected {
            return Err(RlError::State { got, expected });
        }
        self.tensors
            .iter()
            .try_for_each(|(name, values)| check_saved(name, values))
    }

    /// Names and lengths in words.
    fn layout(&self) -> String {
        let tensors = self.tensors.iter();
        let tensors = tensors.map(|(name, values)| format!("{name} [{}]", values.len()));
        let counters = self.counters.iter().map(|(name, _)| (*name).to_owned());
        tensors.chain(counters).collect::<Vec<_>>().join(", ")
    }
}

fn check_saved(name: &str, values: &[f32]) -> Result<(), RlError> {
    match values.iter().find(|value| !value.is_finite()) {
        Some(&value) => Err(RlError::Damaged {
            name: name.to_owned(),
            value: value.into(),
            expected: "finite numbers",
        }),
        None => Ok(()),
    }
}
