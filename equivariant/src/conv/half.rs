//! The passes of a convolution with products of bfloat16: what they round, and where sums go.
//!
//! Maps, parameters, gradients and sums stay in single precision. What a product reads is rounded
//! when it is packed: folds, not pixels, so a mirror changes signs and nothing else.

mod backward;
mod forward;
mod gather;

use pulp::NullaryFnOnce;

use crate::conv::half::backward::BackwardProducts;
use crate::conv::half::forward::ForwardProduct;
use crate::conv::pass::{Backward, Forward};
use crate::half::Half;
use crate::order::with_order;

impl Half {
    pub(crate) fn forward(self, pass: Forward<f32>) {
        self.simd.vectorize(Work { on: self, pass });
    }

    pub(crate) fn backward(self, pass: Backward<f32>) {
        self.simd.vectorize(Work { on: self, pass });
    }
}

struct Work<P> {
    on: Half,
    pass: P,
}

impl NullaryFnOnce for Work<Forward<'_, f32>> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Work { on, pass } = self;
        if let Some(lines) = pass.conv.patches.lines() {
            return pass.run_lines(on.simd, lines);
        }
        with_order!(
            G = pass.conv.weights.order(),
            pass.run_products::<_, _, G>(on.simd, |conv, params, pieces| {
                ForwardProduct::<G>::new(on.amx, conv, params, pieces)
            })
        );
    }
}

impl NullaryFnOnce for Work<Backward<'_, f32>> {
    type Output = ();

    #[inline(always)]
    fn call(self) {
        let Work { on, pass } = self;
        if let (Some(lines), None) = (pass.conv.patches.lines(), &pass.dx) {
            return pass.run_lines(on.simd, lines);
        }
        with_order!(
            G = pass.conv.weights.order(),
            pass.run_products::<_, _, G>(on.simd, |pass, pieces| {
                BackwardProducts::<G>::new(on, pass, pieces)
            })
        );
    }
}
