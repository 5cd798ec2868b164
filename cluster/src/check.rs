//! Checks of arguments that several modules share.

use crate::error::{ClusterError, Result};

/// Checks that `values` is a non-empty list of whole rows of `row` finite values; returns the
/// number of rows.
pub(crate) fn check_rows(
    what: &'static str,
    values: &[f32],
    row: usize,
    unit: &'static str,
) -> Result<usize> {
    if values.is_empty() {
        return Err(ClusterError::Empty { what });
    }
    if !values.len().is_multiple_of(row) {
        let len = values.len();
        return Err(ClusterError::Ragged { what, len, row, unit });
    }
    // the whole list, without a way out: such a loop compiles to vector code
    if values.iter().fold(true, |all, v| all & v.is_finite()) {
        return Ok(values.len() / row);
    }
    let index = values.iter().position(|v| !v.is_finite()).unwrap_or(0);
    let value = f64::from(values[index]);
    Err(ClusterError::NonFinite { what, index, value })
}

/// Checks that `value`, the size or number called `name` in the error, is at least 1.
pub(crate) fn check_positive(name: &'static str, value: usize) -> Result<()> {
    check_range(name, value as f64, value >= 1, "at least 1")
}

/// Returns an error about the number `value`, called `name`, unless it is `inside` its range;
/// `expected` says the range in words.
pub(crate) fn check_range(
    name: &'static str,
    value: f64,
    inside: bool,
    expected: &'static str,
) -> Result<()> {
    if inside {
        return Ok(());
    }
    Err(ClusterError::OutOfRange { name, value, expected })
}

/// Checks that a list has the length that the other arguments require.
pub(crate) fn check_len(what: &'static str, got: usize, expected: usize) -> Result<()> {
    if got == expected { Ok(()) } else { Err(ClusterError::Length { what, got, expected }) }
}
