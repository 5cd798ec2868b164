//! What a layer does, as data that other hardware can be told.

use crate::steerable::dense::Dense;
use crate::window::Kernel;

/// The map of a layer; its shapes say the rest.
#[derive(Clone, Debug)]
pub enum Operation<'a> {
    /// A convolution with weights.
    Linear(Box<Dense<'a>>),
    /// ReLU in the regular basis.
    Relu,
    /// The largest value of a window in the regular basis.
    MaxPool(Kernel),
    /// The average of a window.
    AveragePool(Kernel),
    /// The largest value of a regular field.
    GroupMaxPool,
    /// The mean of a regular field.
    GroupMeanPool,
    /// Normalised fields.
    FieldNorm(Moments<'a>),
    /// The expected positions of the maxima of fields.
    SoftArgmax {
        /// What values are divided by.
        temperature: f64,
    },
}

/// Whose mean and variance fields are normalised with.
#[derive(Clone, Copy, Debug)]
pub enum Moments<'a> {
    /// Those of each sample.
    Sample,
    /// Those of the batch.
    Batch,
    /// These, `[mean, variance]` for each field.
    Fixed(&'a [[f64; 2]]),
}
