//! A layer or a chain of layers on a device.

use std::fmt;

use crate::gpu::device::Device;
use crate::gpu::error::GpuError;
use crate::gpu::plan::{Plan, Tensor};
use crate::gpu::program::{Batch, Passes, Program};
use crate::gpu::step::Slot;
use crate::layers::layer::Layer;

/// A layer on a device, with memory for the passes of a batch. What it computes is what
/// [`Layer::forward`] and [`Layer::backward`] do, but for rounding.
pub struct Network {
    program: Program,
    plan: Plan,
    /// What the layer prints.
    name: String,
    x: Tensor,
    y: Tensor,
    /// Gradients in input and output.
    gradients: [Slot; 2],
    /// Samples of the last forward pass.
    seen: usize,
}

/// What a backward pass computes.
#[derive(Clone, Debug, PartialEq)]
pub struct Gradients {
    /// The gradient in the input, `[N, H, W, C]`.
    pub input: Vec<f32>,
    /// The gradient in the parameters, in the order of the layer.
    pub params: Vec<f32>,
}

impl Network {
    /// Compiles the kernels of a layer and allocates memory for batches of up to `samples` samples.
    ///
    /// # Errors
    /// [`GpuError::Layer`] for a layer of another crate, [`GpuError::Limit`] before anything is
    /// allocated when the batch is too large for the adapter, [`GpuError::Lost`] and
    /// [`GpuError::Failed`].
    ///
    /// # Panics
    /// For no samples.
    pub fn new(
        device: &Device,
        layer: &dyn Layer<f32>,
        samples: usize,
    ) -> Result<Network, GpuError> {
        assert!(samples > 0, "{layer}: got 0 samples, expected at least 1");
        let mut plan = Plan::new();
        let x = plan.tensor(layer.in_shape());
        let y = plan.layer(layer, x)?;
        let [Some(dx), Some(dy)] = [x.gradient, y.gradient] else {
            unreachable!("both ends have gradients")
        };
        Ok(Network {
            program: Program::new(device, &plan, samples)?,
            plan,
            name: layer.to_string(),
            x,
            y,
            gradients: [dx, dy],
            seen: 0,
        })
    }

    /// The largest number of samples of a batch.
    pub fn samples(&self) -> usize {
        self.program.samples()
    }

    /// The number of parameters, as the layer has them.
    pub fn num_params(&self) -> usize {
        self.plan.num_params()
    }

    /// Kernels of one forward and one backward pass.
    pub fn dispatches(&self) -> [usize; 2] {
        self.plan.dispatches()
    }

    /// Sets the parameters, in the order of the layer.
    ///
    /// # Panics
    /// When there are more or fewer than the layer's.
    pub fn set_params(&mut self, params: &[f32]) {
        self.check_len("params", params.len(), self.num_params());
        self.program.write(self.plan.params(), &self.plan.placed(params));
    }

    /// f(x) of N samples `[N, H, W, C]`.
    ///
    /// # Errors
    /// [`GpuError::Lost`] and [`GpuError::Failed`].
    ///
    /// # Panics
    /// When `x` is not whole samples, none, or more than there is memory for.
    pub fn forward(&mut self, x: &[f32]) -> Result<Vec<f32>, GpuError> {
        let each = self.x.shape.len();
        let (got, most) = (x.len(), self.samples());
        assert!(
            got > 0 && got.is_multiple_of(each) && got / each <= most,
            "{}: got x of {got} values, expected a multiple of {each} above 0 and at most {most} \
             times that",
            self.name
        );
        self.seen = got / each;
        self.program.write(self.x.values, x);
        self.submit(Passes::Forward);
        let len = self.seen * self.y.shape.len();
        let [y] = self.program.read([(self.y.values, len)])?;
        Ok(y)
    }

    /// The gradients, given that in the output of the last forward pass.
    ///
    /// # Errors
    /// [`GpuError::Lost`] and [`GpuError::Failed`].
    ///
    /// # Panics
    /// When `dy` does not hold as many samples as the last forward pass had.
    pub fn backward(&mut self, dy: &[f32]) -> Result<Gradients, GpuError> {
        self.check_len("dy", dy.len(), self.seen * self.y.shape.len());
        let [into, out_of] = self.gradients;
        self.program.write(out_of, dy);
        self.submit(Passes::Backward);
        let input = (into, self.seen * self.x.shape.len());
        let params = (self.plan.gradient(), self.plan.device_params());
        let [input, params] = self.program.read([input, params])?;
        let params = self.plan.unplaced(&params);
        Ok(Gradients { input, params })
    }

    fn submit(&self, passes: Passes) {
        let batch = Batch { samples: self.seen, ..Batch::default() };
        self.program.submit(passes, batch);
    }

    fn check_len(&self, slice: &str, got: usize, expected: usize) {
        let name = &self.name;
        assert!(got == expected, "{name}: got {slice} of {got} values, expected {expected}");
    }
}

impl fmt::Debug for Network {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "Network({} on {})", self.name, self.program.device().adapter().name)
    }
}
