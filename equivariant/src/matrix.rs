//! Matrix products on columns of wider matrices, through faer.

use faer::linalg::matmul::matmul;
use faer::traits::RealField;
use faer::{Accum, MatMut, MatRef, Par};

/// Row-major view of `rows` x `cols` numbers: row `r` starts at `r * stride`.
#[derive(Clone, Copy, Debug)]
pub struct StridedMatrix<'a, T> {
    pub(crate) data: &'a [T],
    pub(crate) rows: usize,
    pub(crate) cols: usize,
    pub(crate) stride: usize,
    /// `true` if the view stands for its transpose.
    pub(crate) transposed: bool,
}

/// Row-major mutable view of a matrix.
#[derive(Debug)]
pub struct StridedMatrixMut<'a, T> {
    pub(crate) data: &'a mut [T],
    pub(crate) rows: usize,
    pub(crate) cols: usize,
    pub(crate) stride: usize,
}

impl<'a, T> StridedMatrix<'a, T> {
    pub(crate) fn new(data: &'a [T], [rows, cols]: [usize; 2], stride: usize) -> Self {
        StridedMatrix { data, rows, cols, stride, transposed: false }
    }

    pub(crate) fn transpose(self) -> Self {
        StridedMatrix { transposed: !self.transposed, ..self }
    }

    fn view(self) -> MatRef<'a, T> {
        let StridedMatrix { data, rows, cols, stride, transposed } = self;
        let view = MatRef::from_row_major_slice_with_stride(data, rows, cols, stride);
        if transposed { view.transpose() } else { view }
    }
}

impl<'a, T> StridedMatrixMut<'a, T> {
    pub(crate) fn new(data: &'a mut [T], [rows, cols]: [usize; 2], stride: usize) -> Self {
        StridedMatrixMut { data, rows, cols, stride }
    }

    fn view(self) -> MatMut<'a, T> {
        // The transpose of a column-major view: faer 0.24.4 confuses the strides in
        // `from_row_major_slice_with_stride_mut` and then writes outside the slice.
        let (data, stride) = (self.data, self.stride);
        MatMut::from_column_major_slice_with_stride_mut(data, self.cols, self.rows, stride)
            .transpose_mut()
    }
}

/// Writes the product a b into `to`, or adds it to the values there.
pub(crate) fn matrix_product<T: RealField + Copy>(
    to: StridedMatrixMut<T>,
    add: bool,
    a: StridedMatrix<T>,
    b: StridedMatrix<T>,
) {
    // Par::Seq: minibatches already occupy all threads, and one thread gives a fixed order of sums
    let accumulate = if add { Accum::Add } else { Accum::Replace };
    matmul(to.view(), accumulate, a.view(), b.view(), T::one_impl(), Par::Seq);
    clear_upper_halves();
}

/// Executes a few wide instructions, after which the compiler clears the upper register halves.
///
/// The kernels of faer 0.24.4 do not clear them. Until that happens the CPU pays for every
/// switch between AVX and legacy SSE instructions: C's `expf` takes 175 ns instead of 3, and it
/// runs right after the products of a recurrent unit. `benches/layers.rs` of the workspace measures
/// it.
fn clear_upper_halves() {
    #[cfg(target_arch = "x86_64")]
    if let Some(simd) = pulp::x86::V3::try_new() {
        simd.vectorize(Wide(simd));
    }
}

/// Addition of eight numbers.
#[cfg(target_arch = "x86_64")]
struct Wide(pulp::x86::V3);

#[cfg(target_arch = "x86_64")]
impl pulp::NullaryFnOnce for Wide {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        // black_box keeps the compiler from removing an addition whose result nobody reads
        let x = std::hint::black_box(pulp::f32x8(0., 0., 0., 0., 0., 0., 0., 0.));
        std::hint::black_box(self.0.add_f32x8(x, x));
    }
}
