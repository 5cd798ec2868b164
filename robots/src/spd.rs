//! Symmetric positive definite systems of six equations.

/// Solves `a x = b` by Cholesky's factorisation `a = l l^T`. Only the lower triangle of `a`, which
/// must be symmetric and positive definite, is read.
pub(crate) fn solve(a: &[[f64; 6]; 6], b: [f64; 6]) -> [f64; 6] {
    let l = factor(a);
    let mut x = b;
    for row in 0..6 {
        let known: f64 = (0..row).map(|column| l[row][column] * x[column]).sum();
        x[row] = (x[row] - known) / l[row][row];
    }
    for row in (0..6).rev() {
        let known: f64 = (row + 1..6).map(|column| l[column][row] * x[column]).sum();
        x[row] = (x[row] - known) / l[row][row];
    }
    x
}

fn factor(a: &[[f64; 6]; 6]) -> [[f64; 6]; 6] {
    let mut l = [[0.0; 6]; 6];
    for row in 0..6 {
        for column in 0..=row {
            let known: f64 = (0..column).map(|k| l[row][k] * l[column][k]).sum();
            let rest = a[row][column] - known;
            l[row][column] = if row == column {
                rest.sqrt()
            } else {
                rest / l[column][column]
            };
        }
    }
    l
}

#[cfg(test)]
mod tests {
    use super::solve;

    #[test]
    fn the_solution_solves() {
        // m m^T + 0.1 of a matrix without structure
        let m: [[f64; 6]; 6] = std::array::from_fn(|i| {
            std::array::from_fn(|j| (1.7 * i as f64 + 2.3 * j as f64).sin())
        });
        let a: [[f64; 6]; 6] = std::array::from_fn(|i| {
            std::array::from_fn(|j| {
                let product: f64 = (0..6).map(|k| m[i][k] * m[j][k]).sum();
                product + if i == j { 0.1 } else { 0.0 }
            })
        });
        let b = [1.0, -2.0, 3.0, -4.0, 5.0, -6.0];
        let x = solve(&a, b);
        for (row, expected) in a.iter().zip(b) {
            let got: f64 = row.iter().zip(x).map(|(a, x)| a * x).sum();
            assert!((got - expected).abs() < 1e-11, "{got} {expected}");
        }
    }
}
