//! What a backward pass of a layer reads and writes.

/// The slices of [`Layer::backward`](crate::Layer::backward), of the right lengths.
///
/// The compiler knows that arguments do not overlap, but not that these fields do not. Loops over
/// them belong into functions that take them as arguments.
#[derive(Debug)]
pub struct BackwardPass<'a, T> {
    /// The parameters.
    pub params: &'a [T],
    /// The input, `[N, H, W, C]`.
    pub x: &'a [T],
    /// The output of the forward pass.
    pub y: &'a [T],
    /// The gradient in the output.
    pub dy: &'a [T],
    /// Where to write the gradient in the input, if anywhere.
    pub dx: Option<&'a mut [T]>,
    /// What the gradient in the parameters is added to.
    pub dparams: &'a mut [T],
    /// The scratch, as the forward pass left it where the layer keeps it.
    pub scratch: &'a mut [T],
}
