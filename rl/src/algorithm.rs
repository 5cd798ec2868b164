//! Algorithms, which improve a policy from experience.

use rand_chacha::ChaCha8Rng;

use crate::error::{RlError, require_saved};

/// Largest value allowed for a counter in an algorithm's saved state: f64 represents every integer
/// up to 2^53 exactly.
const MAX_COUNTER: u64 = 1 << 53;

/// A training algorithm: improves a policy from experience and owns the state of its optimisers.
///
/// A checkpoint of this state, the policy's parameters and the random generator determines the
/// next update, given the experience.
pub trait Algorithm {
    /// Type of the policy that the algorithm trains.
    type Policy;
    /// Type of the experience that a training update reads: a
    /// [`RolloutBuffer`](crate::RolloutBuffer) for on-policy algorithms, a replay buffer for
    /// others.
    type Experience;
    /// Type of the statistics that a training update returns.
    type Stats: Metrics;

    /// Trains `policy` on `experience` by one update; random numbers come from `rng`.
    ///
    /// # Errors
    /// [`RlError::SpecMismatch`] or [`RlError::ParameterCountMismatch`] for experience or a policy
    /// of another environment or network. [`RlError::NotFinite`] when a quantity diverges; `policy`
    /// then has the parameters from before the offending step. An exception is a step that itself
    /// makes parameters infinite, at learning rates near the limit of f32: they stay infinite.
    fn update(
        &mut self,
        policy: &mut Self::Policy,
        experience: &Self::Experience,
        rng: &mut ChaCha8Rng,
    ) -> Result<Self::Stats, RlError>;

    /// Returns the complete state of the algorithm, as named arrays and counters for a checkpoint.
    /// Names, lengths and order never change.
    fn save(&self) -> AlgorithmState<'_>;

    /// Restores the state of the algorithm that [`Algorithm::save`] returned. After an error,
    /// nothing has changed.
    ///
    /// # Errors
    /// [`RlError::StateMismatch`] for a state of another algorithm or network,
    /// [`RlError::InvalidStateNumber`] for numbers that cannot be right.
    fn restore(&mut self, state: &AlgorithmState<'_>) -> Result<(), RlError>;
}

/// Statistics of a training update as named values, so that different algorithms can write to one
/// log table.
pub trait Metrics {
    /// Returns the name and value of each statistic; names and order are the same after every
    /// update of an algorithm.
    fn metrics(&self) -> Vec<(String, f64)>;
}

/// The state of an [`Algorithm`] between two updates, as named arrays and counters.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct AlgorithmState<'a> {
    /// Arrays of the algorithm's state, such as an optimiser's moments, and their names.
    pub tensors: Vec<(&'a str, &'a [f32])>,
    /// Counters of the algorithm's state and their names, each at most 2^53.
    pub counters: Vec<(&'a str, u64)>,
}

impl AlgorithmState<'_> {
    /// Checks that a state read from a file has arrays and counters with the names and lengths of
    /// those in `own`, in the same order, only finite numbers, and no counter above 2^53.
    ///
    /// # Errors
    /// [`RlError::StateMismatch`] or [`RlError::InvalidStateNumber`].
    pub fn check_same_layout(&self, own: &AlgorithmState<'_>) -> Result<(), RlError> {
        if self.layout() != own.layout() {
            let (got, expected) = (self.describe(), own.describe());
            return Err(RlError::StateMismatch { got, expected });
        }
        self.require_all("finite numbers", |_, value| value.is_finite())?;
        self.counters.iter().try_for_each(|&(name, count)| {
            let expected = "a count of at most 2^53";
            require_saved(name, count as f64, expected, count <= MAX_COUNTER)
        })
    }

    /// Rejects the state if a number of its arrays is not `allowed`, which gets the name of the
    /// array and the number.
    fn require_all(
        &self,
        expected: &'static str,
        allowed: impl Fn(&str, f32) -> bool,
    ) -> Result<(), RlError> {
        for &(name, values) in &self.tensors {
            for &value in values {
                require_saved(name, value.into(), expected, allowed(name, value))?;
            }
        }
        Ok(())
    }

    /// Returns names and lengths of the arrays in the state, and names of its counters.
    fn layout(&self) -> (Vec<(&str, usize)>, Vec<&str>) {
        let tensors = self.tensors.iter();
        let counters = self.counters.iter();
        (
            tensors.map(|(name, values)| (*name, values.len())).collect(),
            counters.map(|(name, _)| *name).collect(),
        )
    }

    /// Formats names and lengths of the state's arrays and names of its counters for an error
    /// message.
    fn describe(&self) -> String {
        let (tensors, counters) = self.layout();
        let tensors = tensors.iter().map(|(name, len)| format!("{name:?} [{len}]"));
        let counters = counters.iter().map(|name| format!("{name:?}"));
        tensors.chain(counters).collect::<Vec<_>>().join(", ")
    }
}

/// Rejects a saved state with negative numbers in the arrays called `names`. These hold second
/// moments of Adam: the root of a negative one would be NaN at the next step.
pub(crate) fn check_not_negative(state: &AlgorithmState, names: &[&str]) -> Result<(), RlError> {
    state.require_all("no negative number", |name, value| !names.contains(&name) || value >= 0.0)
}

/// Declares a struct of `f64` sums with a method `add` that adds another such struct field by
/// field, and methods that convert it to an array and back.
macro_rules! sums {
    ($(#[$doc:meta])* $name:ident: $($sum:ident),+) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, Default, PartialEq)]
        pub(crate) struct $name {
            $(pub $sum: f64,)+
        }

        impl $name {
            /// Adds `other`, the same sums over other samples, field by field.
            pub fn add_sums(&mut self, other: &Self) {
                $(self.$sum += other.$sum;)+
            }

            const COUNT: usize = [$(stringify!($sum)),+].len();

            /// Returns the sums as an array, in the order of the fields.
            pub fn sums_to_array(self) -> [f64; Self::COUNT] {
                [$(self.$sum),+]
            }

            /// Creates the sums from an array of them, in the order of the fields.
            pub fn sums_from_array([$($sum),+]: [f64; Self::COUNT]) -> Self {
                Self { $($sum),+ }
            }
        }
    };
}

/// Lists the given fields of a statistics struct as pairs of name and value, as [`Metrics`] returns
/// them.
macro_rules! named {
    ($stats:ident: $($field:ident),+) => {
        vec![$((stringify!($field).to_owned(), $stats.$field as f64)),+]
    };
}

pub(crate) use {named, sums};
