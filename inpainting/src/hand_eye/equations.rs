//! Normal equations of a least-squares problem with up to ten unknowns.

/// Maximum number of unknowns of a hand-eye calibration: the camera's rotation (3) and position
/// (3), the ball's offset in the hand (3), and the focal length.
pub(super) const UNKNOWNS: usize = 10;

pub(super) type Vector = [f64; UNKNOWNS];
type Matrix = [[f64; UNKNOWNS]; UNKNOWNS];

/// Largest variance inflation: the factor by which the variance of an unknown grows because the
/// others are unknown, too. Beyond it, the result is mostly rounding.
const MAX_INFLATION: f64 = 1e12;

/// Normal equations of a hand-eye calibration's least squares: matrix and right-hand side. Only the
/// first `free` unknowns take part.
#[derive(Clone, Debug)]
pub(super) struct NormalEquations {
    matrix: Matrix,
    right: Vector,
    free: usize,
}

impl NormalEquations {
    /// Creates empty normal equations for the first `free` unknowns; the others are held at 0.
    pub fn new(free: usize) -> Self {
        Self { matrix: [[0.0; UNKNOWNS]; UNKNOWNS], right: [0.0; UNKNOWNS], free }
    }

    /// Adds an equation of the least-squares problem: `row` times the unknowns is `value`.
    pub fn add_equation(&mut self, row: &Vector, value: f64) {
        for (i, left) in row.iter().enumerate().take(self.free) {
            self.right[i] += left * value;
            for (sum, right) in self.matrix[i].iter_mut().zip(row) {
                *sum += left * right;
            }
        }
    }

    /// Solves for the unknowns, with the diagonal multiplied by 1 + `damping`; unknowns that are
    /// held are 0. `None` if the equations do not determine the others.
    pub fn solve(&self, damping: f64) -> Option<Vector> {
        let scale = self.scale()?;
        let factor = self.factor(&scale, damping)?;
        let mut unknowns = [0.0; UNKNOWNS];
        for i in 0..self.free {
            unknowns[i] = self.right[i] * scale[i];
        }
        substitute(&factor, &mut unknowns, self.free);
        for i in 0..self.free {
            unknowns[i] *= scale[i];
        }
        Some(unknowns)
    }

    /// Returns the variances of the unknowns if the equations' values have variance 1; unknowns
    /// that are held have 0. `None` if the equations do not determine all unknowns.
    pub fn variances(&self) -> Option<Vector> {
        let scale = self.scale()?;
        let factor = self.factor(&scale, 0.0)?;
        let mut variances = [0.0; UNKNOWNS];
        for i in 0..self.free {
            let mut column = [0.0; UNKNOWNS];
            column[i] = 1.0;
            substitute(&factor, &mut column, self.free);
            // the matrix is scaled to a diagonal of 1, so this is the variance inflation
            let inflation = column[i];
            if inflation > MAX_INFLATION || inflation.is_nan() {
                return None;
            }
            variances[i] = inflation * scale[i] * scale[i];
        }
        Some(variances)
    }

    /// Returns the factors, one for each unknown, that scale the matrix to a diagonal of 1. `None`
    /// if an unknown occurs in no equation.
    fn scale(&self) -> Option<Vector> {
        let mut scale = [0.0; UNKNOWNS];
        for (i, factor) in scale.iter_mut().enumerate().take(self.free) {
            *factor = self.matrix[i][i].sqrt().recip();
            if !factor.is_finite() {
                return None;
            }
        }
        Some(scale)
    }

    /// Returns the lower Cholesky factor of the scaled matrix. `None` if that is not positive
    /// definite.
    fn factor(&self, scale: &Vector, damping: f64) -> Option<Matrix> {
        let mut factor = [[0.0; UNKNOWNS]; UNKNOWNS];
        for row in 0..self.free {
            for column in 0..=row {
                let known: f64 = (0..column).map(|k| factor[row][k] * factor[column][k]).sum();
                let scaled = self.matrix[row][column] * scale[row] * scale[column];
                factor[row][column] = if row == column {
                    let rest = scaled + damping - known;
                    if rest <= 0.0 || rest.is_nan() {
                        return None;
                    }
                    rest.sqrt()
                } else {
                    (scaled - known) / factor[column][column]
                };
            }
        }
        Some(factor)
    }
}

/// Solves for `x` in place by forward and backward substitution with a lower Cholesky factor.
fn substitute(factor: &Matrix, x: &mut Vector, count: usize) {
    for row in 0..count {
        let known: f64 = (0..row).map(|k| factor[row][k] * x[k]).sum();
        x[row] = (x[row] - known) / factor[row][row];
    }
    for row in (0..count).rev() {
        let known: f64 = (row + 1..count).map(|k| factor[k][row] * x[k]).sum();
        x[row] = (x[row] - known) / factor[row][row];
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Rows without structure.
    fn rows() -> Vec<Vector> {
        let entry = |i: usize, j: usize| (1.7 * (i * i * (j + 1)) as f64 + j as f64).sin();
        (0..20).map(|i| std::array::from_fn(|j| entry(i, j))).collect()
    }

    fn dot(a: &Vector, b: &Vector, count: usize) -> f64 {
        a.iter().zip(b).take(count).map(|(a, b)| a * b).sum()
    }

    #[test]
    fn consistent_equations_are_solved_and_held_unknowns_stay_zero() {
        let known: Vector = std::array::from_fn(|i| i as f64 - 3.5);
        for free in [6, 9, 10] {
            let mut equations = NormalEquations::new(free);
            for row in rows() {
                equations.add_equation(&row, dot(&row, &known, free));
            }
            let solved = equations.solve(0.0).unwrap();
            for (i, (value, wanted)) in solved.into_iter().zip(known).enumerate() {
                let expected = if i < free { wanted } else { 0.0 };
                assert!((value - expected).abs() < 1e-9, "{free} {i}: {value}");
            }
        }
    }

    /// The i-th variance is component i of the solution for the i-th unit vector.
    #[test]
    fn variances_are_the_inverse_of_the_matrix() {
        let mut equations = NormalEquations::new(6);
        for row in rows() {
            equations.add_equation(&row, 0.0);
        }
        let variances = equations.variances().unwrap();
        for (i, variance) in variances.into_iter().enumerate() {
            let mut unit = equations.clone();
            if i < 6 {
                unit.right[i] = 1.0;
            }
            let solved = unit.solve(0.0).unwrap()[i];
            assert!((solved - variance).abs() <= 1e-12 * variance, "{i}");
        }
        assert_eq!(variances[6..], [0.0; 4]);
    }

    #[test]
    fn unknowns_that_no_equation_tells_apart_are_refused() {
        let mut equations = NormalEquations::new(6);
        for mut row in rows() {
            row[1] = 2.0 * row[0];
            equations.add_equation(&row, 1.0);
        }
        assert_eq!(equations.variances(), None);
        assert_eq!(NormalEquations::new(6).solve(1.0), None);
        assert!(equations.solve(1e-3).is_some(), "damping decides");
    }
}
