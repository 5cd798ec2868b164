//! Figures by name.

/// What can be logged by name, so that learners of different kinds write into one table.
pub trait Metrics {
    /// Names and values. Names and their order are the same after every update of one algorithm.
    fn metrics(&self) -> Vec<(String, f64)>;
}
