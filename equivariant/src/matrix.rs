//! Matrix products on columns of wider matrices, through faer.

use faer::linalg::matmul::matmul;
use faer::traits::RealField;
use faer::{Accum, MatMut, MatRef, Par};

/// Operands of a matrix product a b, and the matrix that receives it.
#[derive(Debug)]
pub struct MatrixProductOperands<'a, T> {
    /// Matrix that the product a b is written into.
    pub(crate) to: MatMut<'a, T>,
    /// `true` if the product is added to the values of `to`.
    pub(crate) add: bool,
    pub(crate) a: MatRef<'a, T>,
    pub(crate) b: MatRef<'a, T>,
}

impl<T: RealField + Copy> MatrixProductOperands<'_, T> {
    /// Computes the product a b and writes it into `to`, or adds it to the values there.
    pub(crate) fn run(self) {
        // Par::Seq: minibatches already occupy all threads, and one thread gives a fixed order of
        // sums
        let accumulate = if self.add { Accum::Add } else { Accum::Replace };
        matmul(self.to, accumulate, self.a, self.b, T::one_impl(), Par::Seq);
        clear_upper_halves();
    }
}

/// Returns a matrix view of `rows` x `cols` numbers: row `r` starts at `r * stride`.
pub(crate) fn row_major<T>(data: &[T], [rows, cols]: [usize; 2], stride: usize) -> MatRef<'_, T> {
    MatRef::from_row_major_slice_with_stride(data, rows, cols, stride)
}

/// Returns a mutable matrix view of `rows` x `cols` numbers: row `r` starts at `r * stride`.
pub(crate) fn row_major_mut<T>(
    data: &mut [T],
    [rows, cols]: [usize; 2],
    stride: usize,
) -> MatMut<'_, T> {
    // The transpose of a column-major view: faer 0.24.4 confuses the strides in
    // `from_row_major_slice_with_stride_mut` and then writes outside the slice.
    MatMut::from_column_major_slice_with_stride_mut(data, cols, rows, stride).transpose_mut()
}

/// Executes a few wide instructions, after which the compiler clears the upper register halves.
///
/// The kernels of faer 0.24.4 do not clear them. Until that happens the CPU pays for every
/// switch between AVX and legacy SSE instructions: C's `expf` takes 175 ns instead of 3, and it
/// runs right after the products of a recurrent unit.
fn clear_upper_halves() {
    #[cfg(target_arch = "x86_64")]
    if let Some(simd) = pulp::x86::V3::try_new() {
        simd.vectorize(AvxAddition(simd));
    }
}

/// Addition of eight numbers by one AVX instruction; the sum is not used.
#[cfg(target_arch = "x86_64")]
struct AvxAddition(pulp::x86::V3);

#[cfg(target_arch = "x86_64")]
impl pulp::NullaryFnOnce for AvxAddition {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        // black_box keeps the compiler from removing an addition whose result nobody reads
        let x = std::hint::black_box(pulp::f32x8(0., 0., 0., 0., 0., 0., 0., 0.));
        std::hint::black_box(self.0.add_f32x8(x, x));
    }
}
