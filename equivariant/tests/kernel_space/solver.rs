//! General solver of the kernel constraint, the oracle of the closed form.

use equivariant::{FieldType, Group, hadamard_transform};
use faer::Mat;
use symmetry::D2;

/// Threshold relative to the largest possible singular value, below which one counts as zero.
const TOLERANCE: f64 = 1e-9;

/// Real representation of a group in any basis, as matrices.
#[derive(Clone, Debug, PartialEq)]
pub struct Representation {
    group: Group,
    dim: usize,
    /// Row-major matrices `[dim, dim]`, in the order of the group's elements.
    matrices: Vec<Vec<f64>>,
}

impl Representation {
    /// Creates the representation with these row-major `[dim, dim]` matrices, in the order of
    /// [`Group::elements`].
    pub fn new(group: Group, dim: usize, matrices: Vec<Vec<f64>>) -> Representation {
        let rho = Representation { group, dim, matrices };
        let equal = |a: Mat<f64>, b: Mat<f64>| (a - b).norm_max() <= TOLERANCE;
        assert!(equal(rho.mat(D2::Identity), Mat::identity(dim, dim)));
        for &g in group.elements() {
            for &h in group.elements() {
                let homomorphic = equal(rho.mat(g) * rho.mat(h), rho.mat(g * h));
                assert!(homomorphic, "rho({g}) rho({h}) is not rho({})", g * h);
            }
        }
        rho
    }

    /// Creates the representation of a type in the irrep basis: signs on the diagonal.
    pub fn irreps(fields: FieldType) -> Representation {
        Representation::from_action(fields, |_| ())
    }

    /// Creates the representation of regular fields in the regular basis, in the layout of
    /// `hadamard_transform`: permutations.
    pub fn regular(group: Group, fields: usize) -> Representation {
        Representation::from_action(group.regular_type(fields), |v| hadamard_transform(group, v))
    }

    /// Returns the action of a type after a change of basis that is its own inverse.
    fn from_action(fields: FieldType, change: impl Fn(&mut [f64])) -> Representation {
        let (group, dim) = (fields.group(), fields.dim());
        let matrix = |&g: &D2| {
            let mut matrix = vec![0.0; dim * dim];
            for column in 0..dim {
                let mut v = vec![0.0; dim];
                v[column] = 1.0;
                change(&mut v);
                fields.transform_channels(g, &mut v);
                change(&mut v);
                for (row, value) in v.into_iter().enumerate() {
                    matrix[row * dim + column] = value;
                }
            }
            matrix
        };
        Representation { group, dim, matrices: group.elements().iter().map(matrix).collect() }
    }

    fn entry(&self, g: D2, row: usize, col: usize) -> f64 {
        let place = self.group.elements().iter().position(|&e| e == g).unwrap();
        self.matrices[place][row * self.dim + col]
    }

    fn mat(&self, g: D2) -> Mat<f64> {
        Mat::from_fn(self.dim, self.dim, |row, col| self.entry(g, row, col))
    }
}

/// Returns an orthonormal basis of the kernels `[C_out, C_in, size, size]` with k(g t) = rho_out(g)
/// k(t) rho_in(g)^-1 for all g.
///
/// The constraint is a homogeneous linear system in the entries of the kernel, and its null space
/// comes from a singular value decomposition (Weiler and Cesa, "General E(2)-equivariant steerable
/// CNNs", NeurIPS 2019, equation 2; here on a pixel grid). It takes any representation in any
/// basis, and cubic time in the entries.
pub fn kernel_space(
    rho_in: &Representation,
    rho_out: &Representation,
    size: usize,
) -> Vec<Vec<f64>> {
    assert_eq!(rho_in.group, rho_out.group);
    let unknowns = rho_out.dim * rho_in.dim * size * size;
    if unknowns == 0 {
        return Vec::new();
    }
    let svd = constraint(rho_in, rho_out, size).svd().unwrap();
    // at most: k(g t) and an orthogonal image of k(t) for every g
    let threshold = TOLERANCE * 2.0 * rho_in.group.order() as f64;
    let (values, vectors) = (svd.S().column_vector(), svd.V());
    (0..unknowns)
        .filter(|&j| values[j] <= threshold)
        .map(|j| (0..unknowns).map(|i| vectors[(i, j)]).collect())
        .collect()
}

/// Returns the matrix of k -> (k(g t) rho_in(g) - rho_out(g) k(t)) for all g, t, on flattened
/// kernels.
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
