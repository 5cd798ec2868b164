//! A layer or a chain of layers on a device.

use std::fmt;

use crate::gpu::device::{Command, Device};
use crate::gpu::error::GpuError;
use crate::gpu::kernels;
use crate::gpu::plan::{Plan, Tensor};
use crate::layers::layer::Layer;

/// A layer on a device, with memory for the passes of a batch. What it computes is what
/// [`Layer::forward`] and [`Layer::backward`] do, but for rounding.
pub struct Network {
    device: Device,
    /// What the layer prints.
    name: String,
    samples: usize,
    plan: Plan,
    x: Tensor,
    y: Tensor,
    uniform: wgpu::Buffer,
    buffers: Vec<wgpu::Buffer>,
    forward: Vec<Command>,
    backward: Vec<Command>,
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
        let y = kernels::add(&mut plan, layer, x)?;
        plan.check(device.adapter(), samples)?;
        let extents = plan.extents().iter();
        let buffers = extents.map(|extent| device.buffer(extent.bytes(samples)));
        let buffers: Vec<wgpu::Buffer> = buffers.collect();
        for (slot, words) in &plan.tables {
            device.write(&buffers[slot.0], words);
        }
        let uniform = device.uniform();
        let command = |step| device.command(step, &uniform, &buffers);
        let network = Network {
            device: device.clone(),
            name: layer.to_string(),
            samples,
            x,
            y,
            forward: plan.forward.iter().map(command).collect(),
            backward: plan.backward().map(command).collect(),
            plan,
            uniform,
            buffers,
            seen: 0,
        };
        device.check()?;
        Ok(network)
    }

    /// The largest number of samples of a batch.
    pub fn samples(&self) -> usize {
        self.samples
    }

    /// The number of parameters, as the layer has them.
    pub fn num_params(&self) -> usize {
        self.plan.places.len()
    }

    /// Kernels of one forward and one backward pass.
    pub fn dispatches(&self) -> [usize; 2] {
        [self.forward.len(), self.backward.len()]
    }

    /// Sets the parameters, in the order of the layer.
    ///
    /// # Panics
    /// When there are more or fewer than the layer's.
    pub fn set_params(&mut self, params: &[f32]) {
        self.check_len("params", params.len(), self.num_params());
        let mut placed = vec![0.0f32; self.plan.device_params()];
        for (&place, &param) in self.plan.places.iter().zip(params) {
            placed[place as usize] = param;
        }
        self.device
            .write(&self.buffers[self.plan.params.0], &placed);
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
        let (got, most) = (x.len(), self.samples);
        assert!(
            got > 0 && got.is_multiple_of(each) && got / each <= most,
            "{}: got x of {got} values, expected a multiple of {each} above 0 and at most {most} \
             times that",
            self.name
        );
        self.seen = got / each;
        self.device.write(&self.buffers[self.x.values.0], x);
        self.device
            .write(&self.uniform, &[self.seen as u32, 0, 0, 0]);
        let y = (
            &self.buffers[self.y.values.0],
            self.seen * self.y.shape.len(),
        );
        let [y] = self.device.run(&self.forward, self.seen, [y])?;
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
        let buffer = |tensor: &Tensor| tensor.gradient.map(|slot| &self.buffers[slot.0]);
        let (Some(into), Some(input)) = (buffer(&self.y), buffer(&self.x)) else {
            unreachable!("both ends of a network have gradients")
        };
        self.device.write(into, dy);
        let input = (input, self.seen * self.x.shape.len());
        let params = (
            &self.buffers[self.plan.gradient.0],
            self.plan.device_params(),
        );
        let [input, placed] = self
            .device
            .run(&self.backward, self.seen, [input, params])?;
        let params = self.plan.places.iter().map(|&place| placed[place as usize]);
        let params = params.collect();
        Ok(Gradients { input, params })
    }

    fn check_len(&self, slice: &str, got: usize, expected: usize) {
        let name = &self.name;
        assert!(
            got == expected,
            "{name}: got {slice} of {got} values, expected {expected}"
        );
    }
}

impl fmt::Debug for Network {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(
            f,
            "Network({} on {})",
            self.name,
            self.device.adapter().name
        )
    }
}
