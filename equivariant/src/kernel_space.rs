//! A general solver of the kernel constraint: the oracle of the closed form.

use faer::Mat;
use symmetry::{D2, FieldType, Group};
use thiserror::Error;

use crate::hadamard;

/// Singular values below this, relative to the largest possible one, count as zero.
const TOLERANCE: f64 = 1e-9;

/// Matrices of a group: any real representation, in any basis.
#[derive(Clone, Debug, PartialEq)]
pub struct Representation {
    group: Group,
    dim: usize,
    /// Row-major `[dim, dim]`, in the order of the group's elements.
    matrices: Vec<Vec<f64>>,
}

/// Why matrices are not a representation, or the solver failed.
#[derive(Clone, Debug, PartialEq, Error)]
pub enum KernelSpaceError {
    /// The number of matrices or of their entries is wrong.
    #[error("got {got} matrices of {len} entries, expected {} of {dim} x {dim} for {group}", group.order())]
    Matrices {
        /// The group.
        group: Group,
        /// The dimension asked for.
        dim: usize,
        /// How many matrices were given.
        got: usize,
        /// The length of the first that does not fit, or of the first.
        len: usize,
    },
    /// The identity has another matrix.
    #[error("rho(identity) is not the identity matrix, expected a representation")]
    Identity,
    /// The matrices of two elements do not multiply to that of their product.
    #[error("rho({g}) rho({h}) is not rho({}), expected a representation", *g * *h)]
    Product {
        /// One element.
        g: D2,
        /// The other.
        h: D2,
    },
    /// Input and output belong to different groups.
    #[error("got representations of {first} and {second}, expected one group")]
    Groups {
        /// One group.
        first: Group,
        /// The other.
        second: Group,
    },
    /// The singular value decomposition did not converge.
    #[error("the singular value decomposition of the constraint did not converge")]
    NoConvergence,
}

impl Representation {
    /// The representation with these row-major `[dim, dim]` matrices, in the order of [`Group::elements`].
    ///
    /// # Errors
    /// When there are not as many as elements, or rho(g) rho(h) = rho(g h) fails by more than 1e-9.
    pub fn new(
        group: Group,
        dim: usize,
        matrices: Vec<Vec<f64>>,
    ) -> Result<Representation, KernelSpaceError> {
        let wrong = matrices.iter().find(|m| m.len() != dim * dim);
        if matrices.len() != group.order() || wrong.is_some() {
            return Err(KernelSpaceError::Matrices {
                group,
                dim,
                got: matrices.len(),
                len: wrong.or(matrices.first()).map_or(0, Vec::len),
            });
        }
        let rho = Representation {
            group,
            dim,
            matrices,
        };
        let equal = |a: Mat<f64>, b: Mat<f64>| (a - b).norm_max() <= TOLERANCE;
        if !equal(rho.mat(D2::Identity), Mat::identity(dim, dim)) {
            return Err(KernelSpaceError::Identity);
        }
        for &g in group.elements() {
            for &h in group.elements() {
                if !equal(rho.mat(g) * rho.mat(h), rho.mat(g * h)) {
                    return Err(KernelSpaceError::Product { g, h });
                }
            }
        }
        Ok(rho)
    }

    /// A type in the irrep basis: signs on the diagonal.
    pub fn irreps(fields: FieldType) -> Representation {
        Representation::from_action(fields, |_| ())
    }

    /// A type of regular fields in the regular basis, in the layout of [`hadamard`](crate::hadamard()): permutations.
    pub fn regular(group: Group, fields: usize) -> Representation {
        Representation::from_action(group.regular(fields), |v| hadamard(group, v))
    }

    /// The action of a type, seen through a change of basis that is its own inverse.
    fn from_action(fields: FieldType, change: impl Fn(&mut [f64])) -> Representation {
        let (group, dim) = (fields.group(), fields.dim());
        let matrix = |&g: &D2| {
            let mut matrix = vec![0.0; dim * dim];
            for column in 0..dim {
                let mut v = vec![0.0; dim];
                v[column] = 1.0;
                change(&mut v);
                fields.act(g, &mut v);
                change(&mut v);
                for (row, v) in v.into_iter().enumerate() {
                    matrix[row * dim + column] = v;
                }
            }
            matrix
        };
        Representation {
            group,
            dim,
            matrices: group.elements().iter().map(matrix).collect(),
        }
    }

    fn entry(&self, g: D2, row: usize, col: usize) -> f64 {
        let place = self.group.elements().iter().position(|&e| e == g);
        place.map_or(f64::NAN, |i| self.matrices[i][row * self.dim + col])
    }

    fn mat(&self, g: D2) -> Mat<f64> {
        Mat::from_fn(self.dim, self.dim, |row, col| self.entry(g, row, col))
    }
}

/// An orthonormal basis of the kernels `[C_out, C_in, size, size]` with k(g t) = rho_out(g) k(t) rho_in(g)^-1 for all g.
///
/// The constraint is a homogeneous linear system in the entries of the kernel, and its null space comes from a
/// singular value decomposition (Weiler and Cesa, "General E(2)-equivariant steerable CNNs", NeurIPS 2019, equation 2;
/// here on a pixel grid). That takes cubic time in the number of entries: it is meant for checking
/// small cases, and no layer uses it. [`Dense::kernel`](crate::Dense::kernel) has the closed form.
///
/// # Errors
/// When the groups differ, or the decomposition does not converge.
pub fn kernel_space(
    rho_in: &Representation,
    rho_out: &Representation,
    size: usize,
) -> Result<Vec<Vec<f64>>, KernelSpaceError> {
    if rho_in.group != rho_out.group {
        return Err(KernelSpaceError::Groups {
            first: rho_in.group,
            second: rho_out.group,
        });
    }
    let unknowns = rho_out.dim * rho_in.dim * size * size;
    if unknowns == 0 {
        return Ok(Vec::new());
    }
    let svd = constraint(rho_in, rho_out, size).svd();
    let svd = svd.map_err(|_| KernelSpaceError::NoConvergence)?;
    // at most: k(g t) and an orthogonal image of k(t) for every g
    let threshold = TOLERANCE * 2.0 * rho_in.group.order() as f64;
    let (values, vectors) = (svd.S().column_vector(), svd.V());
    Ok((0..unknowns)
        .filter(|&j| values[j] <= threshold)
        .map(|j| (0..unknowns).map(|i| vectors[(i, j)]).collect())
        .collect())
}

/// The matrix of k -> (k(g t) rho_in(g) - rho_out(g) k(t)) for all g, t, on flattened kernels.
fn constraint(rho_in: &Representation, rho_out: &Representation, size: usize) -> Mat<f64> {
    let taps = size * size;
    let at = |out: usize, input: usize, tap: usize| (out * rho_in.dim + input) * taps + tap;
    let unknowns = rho_out.dim * rho_in.dim * taps;
    let mut rows = Mat::zeros(rho_in.group.order() * unknowns, unknowns);
    for (i, &g) in rho_in.group.elements().iter().enumerate() {
        for tap in 0..taps {
            let (row, col) = g.apply_pixel(tap / size, tap % size, size, size);
            for out in 0..rho_out.dim {
                for input in 0..rho_in.dim {
                    let equation = i * unknowns + at(out, input, tap);
                    for a in 0..rho_in.dim {
                        let moved = at(out, a, row * size + col);
                        rows[(equation, moved)] += rho_in.entry(g, a, input);
                    }
                    for b in 0..rho_out.dim {
                        rows[(equation, at(b, input, tap))] -= rho_out.entry(g, out, b);
                    }
                }
            }
        }
    }
    rows
}
