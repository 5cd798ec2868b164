//! Errors of simulating.

use std::fmt;

/// Why a simulation step, or a value handed to the simulation, was refused.
#[derive(Debug, Clone, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum SimError {
    /// The physics diverged, and this crate has reset the state.
    ///
    /// MuJoCo only counts a warning and goes on: from the initial state after a bad position,
    /// velocity or acceleration, with zeros in place of all controls after a bad control, and with
    /// a changed matrix after a nearly singular inertia matrix.
    #[error(
        "the simulation diverged at time {time} s: bad {what} (element {index}); \
         the state was reset. Use a smaller time step, or less force"
    )]
    Diverged {
        /// The quantity that became NaN, infinite or huge.
        what: Quantity,
        /// Element of that quantity, as MuJoCo reports it.
        index: usize,
        /// Simulation time before the failing step, in seconds.
        time: f64,
    },
    /// A buffer of MuJoCo was too small, so that contacts or constraints were dropped.
    #[error(
        "MuJoCo dropped {what} at time {time} s, over the limit of {limit}; \
         raise `{setting}` in the model's <size>"
    )]
    Overflow {
        /// What was dropped.
        what: &'static str,
        /// How many fit.
        limit: usize,
        /// The XML attribute to raise.
        setting: &'static str,
        /// Simulation time before the failing step, in seconds.
        time: f64,
    },
    /// A value that is NaN or infinite.
    #[error("{what}[{index}] is {value}, which is not finite")]
    NotFinite {
        /// The quantity given.
        what: Quantity,
        /// Element of that quantity.
        index: usize,
        /// The refused value.
        value: f64,
    },
    /// A slice of the wrong length.
    #[error("{what} has {got} elements, expected {expected}")]
    Length {
        /// The quantity given.
        what: Quantity,
        /// Length that the model asks for.
        expected: usize,
        /// Length given.
        got: usize,
    },
    /// A quaternion whose norm is too small to stand for a rotation.
    #[error("quaternion {value:?} has no direction; a rotation needs a norm that is not 0")]
    ZeroQuaternion {
        /// The refused value, (w, x, y, z).
        value: [f64; 4],
    },
}

/// A quantity of the simulation that an error speaks of.
#[derive(Debug, Clone, Copy, PartialEq, Eq)]
#[non_exhaustive]
pub enum Quantity {
    /// Generalised positions.
    Qpos,
    /// Generalised velocities.
    Qvel,
    /// Generalised accelerations.
    Qacc,
    /// Controls.
    Ctrl,
    /// Inertia matrix (nearly singular).
    Inertia,
    /// Position or orientation of a mocap body.
    Mocap,
    /// A saved state.
    State,
}

impl fmt::Display for Quantity {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.write_str(match self {
            Self::Qpos => "qpos",
            Self::Qvel => "qvel",
            Self::Qacc => "qacc",
            Self::Ctrl => "ctrl",
            Self::Inertia => "inertia",
            Self::Mocap => "mocap pose",
            Self::State => "state",
        })
    }
}

/// Refuses a slice whose length is not `expected`.
pub(crate) fn check_length(what: Quantity, expected: usize, got: usize) -> Result<(), SimError> {
    let error = SimError::Length {
        what,
        expected,
        got,
    };
    (got == expected).then_some(()).ok_or(error)
}

/// Refuses infinities and NaN.
pub(crate) fn check_finite(what: Quantity, values: &[f64]) -> Result<(), SimError> {
    match values.iter().position(|value| !value.is_finite()) {
        None => Ok(()),
        Some(index) => Err(SimError::NotFinite {
            what,
            index,
            value: values[index],
        }),
    }
}
