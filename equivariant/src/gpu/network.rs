//! Layers and chains of layers on a GPU.

use std::fmt;

use crate::gpu::device::GpuDevice;
use crate::gpu::error::GpuError;
use crate::gpu::kernel_dispatch::BufferSlot;
use crate::gpu::plan::{ComputePlan, PlannedFeatureMap};
use crate::gpu::program::{BatchUniforms, CompiledPlan, PassesToRun};
use crate::layers::layer::Layer;

/// Layer on a GPU, with memory for the passes of a batch. It computes the same as
/// [`Layer::forward`] and [`Layer::backward`], up to rounding.
pub struct GpuLayer {
    program: CompiledPlan,
    plan: ComputePlan,
    /// Description of the layer, for error messages.
    name: String,
    x: PlannedFeatureMap,
    y: PlannedFeatureMap,
    /// Buffers of the gradients with respect to input and output.
    gradients: [BufferSlot; 2],
    /// Number of samples of the last forward pass.
    last_samples: usize,
}

/// Gradients from one backward pass of a [`GpuLayer`], read back to the CPU.
#[derive(Clone, Debug, PartialEq)]
pub struct LayerGradients {
    /// Gradient with respect to the input, `[N, H, W, C]` (samples, height, width, channels).
    pub input: Vec<f32>,
    /// Gradient with respect to the parameters, in the layer's order of parameters.
    pub params: Vec<f32>,
}

impl GpuLayer {
    /// Compiles the kernels of a layer and allocates memory for batches of up to `samples` samples.
    ///
    /// # Errors
    /// [`GpuError::UnsupportedLayer`] for a layer of another crate, [`GpuError::BufferTooLarge`]
    /// before anything is allocated when the batch is too large for the adapter,
    /// [`GpuError::DeviceLost`] and [`GpuError::CommandFailed`].
    ///
    /// # Panics
    /// When `samples` is 0.
    pub fn new(
        device: &GpuDevice,
        layer: &dyn Layer<f32>,
        samples: usize,
    ) -> Result<GpuLayer, GpuError> {
        assert!(samples > 0, "{layer}: got 0 samples, expected at least 1");
        let mut plan = ComputePlan::new();
        let x = plan.add_tensor(layer.in_shape());
        let y = plan.add_layer(layer, x)?;
        let [Some(dx), Some(dy)] = [x.gradient, y.gradient] else {
            unreachable!("both ends have gradients")
        };
        Ok(GpuLayer {
            program: CompiledPlan::new(device, &plan, samples)?,
            plan,
            name: layer.to_string(),
            x,
            y,
            gradients: [dx, dy],
            last_samples: 0,
        })
    }

    /// Returns the maximum number of samples of a batch that the layer has memory for.
    pub fn max_samples(&self) -> usize {
        self.program.max_samples()
    }

    /// Returns the number of parameters of the layer.
    pub fn num_params(&self) -> usize {
        self.plan.num_params()
    }

    /// Returns the number of GPU kernels of a forward pass and of a backward pass.
    pub fn num_kernels_per_pass(&self) -> [usize; 2] {
        self.plan.num_kernels_per_pass()
    }

    /// Copies the layer's parameters, in its own order, to the GPU.
    ///
    /// # Panics
    /// When there are more or fewer than the layer's.
    pub fn set_params(&mut self, params: &[f32]) {
        self.check_len("params", params.len(), self.num_params());
        self.program
            .write_floats(self.plan.params_buffer(), &self.plan.params_to_device_order(params));
    }

    /// Runs the layer on N samples `[N, H, W, C]` and returns its output.
    ///
    /// # Errors
    /// [`GpuError::DeviceLost`] and [`GpuError::CommandFailed`].
    ///
    /// # Panics
    /// When `x` is empty, is not whole samples, or has more samples than
    /// [`max_samples`](GpuLayer::max_samples).
    pub fn forward(&mut self, x: &[f32]) -> Result<Vec<f32>, GpuError> {
        let each = self.x.shape.len();
        let (got, most) = (x.len(), self.max_samples());
        assert!(
            got > 0 && got.is_multiple_of(each) && got / each <= most,
            "{}: got x of {got} values, expected a multiple of {each} above 0 and at most {most} \
             times that",
            self.name
        );
        self.last_samples = got / each;
        self.program.write_floats(self.x.values, x);
        self.submit(PassesToRun::Forward);
        let len = self.last_samples * self.y.shape.len();
        let [y] = self.program.read_floats([(self.y.values, len)])?;
        Ok(y)
    }

    /// Returns the gradients of the layer for `dy`, the gradient with respect to the last output.
    ///
    /// # Errors
    /// [`GpuError::DeviceLost`] and [`GpuError::CommandFailed`].
    ///
    /// # Panics
    /// When `dy` does not hold as many samples as the last forward pass had.
    pub fn backward(&mut self, dy: &[f32]) -> Result<LayerGradients, GpuError> {
        self.check_len("dy", dy.len(), self.last_samples * self.y.shape.len());
        let [into, out_of] = self.gradients;
        self.program.write_floats(out_of, dy);
        self.submit(PassesToRun::Backward);
        let input = (into, self.last_samples * self.x.shape.len());
        let params = (self.plan.params_gradient_buffer(), self.plan.num_device_params());
        let [input, params] = self.program.read_floats([input, params])?;
        let params = self.plan.params_from_device_order(&params);
        Ok(LayerGradients { input, params })
    }

    fn submit(&self, passes: PassesToRun) {
        let batch = BatchUniforms { samples: self.last_samples, ..BatchUniforms::default() };
        self.program.submit_passes(passes, batch);
    }

    fn check_len(&self, slice: &str, got: usize, expected: usize) {
        let name = &self.name;
        assert!(got == expected, "{name}: got {slice} of {got} values, expected {expected}");
    }
}

impl fmt::Debug for GpuLayer {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "GpuLayer({} on {})", self.name, self.program.device().adapter().name)
    }
}
