//! GPU kernels of convolutions and linear layers: folds, products and their gradients.

use crate::gpu::channels::ChannelLayout;
use crate::gpu::kernel_dispatch::{BufferSlot, DynamicDim, KernelDispatch};
use crate::gpu::kernels::folds::OrbitFolds;
use crate::gpu::kernels::partial::sum_partial_gradients;
use crate::gpu::kernels::pointwise::kernel_per_field;
use crate::gpu::kernels::product::MatrixProduct;
use crate::gpu::kernels::window::{sum_over_taps, windows};
use crate::gpu::plan::{ComputePlan, PlannedFeatureMap, SharedBuffer};
use crate::steerable::dense::OrdinaryConv;
use crate::window::SlidingWindow;

/// Maximum number of partial parameter gradients of a layer, each over a part of the output pixels.
const MAX_SLICES: usize = 256;
/// Target for the number of workgroups of a weight gradient's kernel: several for each processor of
/// a large GPU.
const TARGET_WORKGROUPS: usize = 1024;
/// Window of one pixel, for which a linear map needs no folded patches.
const PIXEL: SlidingWindow = SlidingWindow::new(1, 1, 0);

/// Convolution or linear layer on a GPU with its buffers.
struct Linear<'a> {
    folds: OrbitFolds<'a>,
    window: SlidingWindow,
    x: PlannedFeatureMap,
    y: PlannedFeatureMap,
    order: usize,
    input: ChannelLayout,
    output: ChannelLayout,
    /// Index of the layer's first parameter in the GPU buffer, in fields.
    first_param: usize,
    /// Buffer of the folded patches; `None` if a patch is a single pixel.
    folded: Option<BufferSlot>,
    /// Buffer of bit masks of the components of each output field that the ReLU passes; `None`
    /// without a ReLU.
    masks: Option<BufferSlot>,
}

/// Adds the kernels of a convolution or linear layer, with a ReLU after it if `with_relu`.
pub(super) fn add(
    plan: &mut ComputePlan,
    dense: &OrdinaryConv,
    x: &PlannedFeatureMap,
    y: &PlannedFeatureMap,
    with_relu: bool,
) {
    let linear = Linear::new(plan, dense, x, y, with_relu);
    let fold = linear.folded.map(|folded| linear.fold_kernel(plan, folded));
    let forward = fold.into_iter().chain([linear.forward(plan)]).collect();
    let mut backward = Vec::new();
    if let Some(dy) = y.gradient {
        backward.extend(linear.weight_gradient(plan, dy));
        if let Some(dx) = x.gradient {
            backward.extend(linear.input_gradient(plan, dy, dx));
        }
    }
    plan.add_kernels(forward, backward);
}

impl<'a> Linear<'a> {
    fn new(
        plan: &mut ComputePlan,
        dense: &'a OrdinaryConv<'a>,
        x: &PlannedFeatureMap,
        y: &PlannedFeatureMap,
        with_relu: bool,
    ) -> Linear<'a> {
        let direct = dense.window == PIXEL;
        let folds = OrbitFolds::new(dense, direct);
        let [input, output] = [x, y].map(|map| ChannelLayout::for_type(map.shape.fields));
        let (order, pixels) = (input.components_per_field(), y.shape.num_pixels());
        // the bias is one more entry
        let params = (folds.fields_per_patch + 1) * output.num_fields() * order;
        Linear {
            first_param: plan.reserve_params(params, folds.param_positions()) / order,
            folded: (!direct).then(|| plan.add_buffer(0, pixels * folds.fields_per_patch * order)),
            masks: with_relu.then(|| plan.add_buffer(0, pixels * output.num_fields())),
            folds,
            window: dense.window,
            x: *x,
            y: *y,
            order,
            input,
            output,
        }
    }

    fn out_pixels(&self) -> usize {
        self.y.shape.num_pixels()
    }

    /// Returns a kernel on the convolution's windows, with a thread for each of `places` places of
    /// a sample and each input field.
    fn kernel_on_windows(&self, label: &'static str, places: usize) -> KernelDispatch {
        let kernel = kernel_per_field(label, &self.input, places);
        let kernel = kernel.add_u32_constants([("ENTRIES", self.folds.fields_per_patch)]);
        windows(kernel, self.window, [self.x.shape, self.y.shape])
    }

    /// Returns the kernel that folds the patches: signed sums of the input over each orbit of taps.
    fn fold_kernel(&self, plan: &mut ComputePlan, folded: BufferSlot) -> KernelDispatch {
        let orbits = self.folds.num_orbits();
        let kernel = self
            .kernel_on_windows("fold", self.out_pixels() * orbits)
            .add_u32_constants([("ORBITS", orbits)])
            .add_input_buffer("orbits", "Orbit", plan.add_constant_table(self.folds.orbit_table()))
            .add_output_buffer("folded", "Field", folded)
            .add_wgsl(include_str!("../wgsl/each_orbit.wgsl"));
        if self.folds.is_input_trivial {
            kernel
                .add_input_buffer("x", "f32", self.x.values)
                .add_wgsl(&tap_reader("f32", "x[u32(pixel) * FIELDS + field]"))
                .add_wgsl(include_str!("../wgsl/fold_trivial.wgsl"))
        } else {
            self.input
                .add_input_to_kernel(kernel, "x", self.x.values)
                .add_wgsl(&tap_reader("Field", "load_x(u32(pixel), field)"))
                .add_wgsl(include_str!("../wgsl/fold.wgsl"))
        }
    }

    fn product(&self, rows: DynamicDim, cols: usize, depth: DynamicDim) -> MatrixProduct {
        MatrixProduct {
            order: self.order,
            rows,
            cols,
            depth,
            num_slices: 1,
            left_is_column_major: false,
        }
    }

    /// Adds the WGSL function `input_at(row, entry)`, which reads the folded patch of an output
    /// pixel, or the pixel if it needs no fold.
    fn add_patch_reader(&self, kernel: KernelDispatch) -> KernelDispatch {
        let function =
            |body| format!("fn input_at(row: u32, entry: u32) -> Field {{ return {body}; }}");
        match self.folded {
            Some(folded) => kernel
                .add_input_buffer("folded", "Field", folded)
                .add_wgsl(&function("folded[row * ENTRIES + entry]")),
            None => self
                .input
                .add_input_to_kernel(kernel, "x", self.x.values)
                .add_wgsl(&function("load_x(row, entry)")),
        }
        .add_u32_constants([("ENTRIES", self.folds.fields_per_patch)])
    }

    fn add_weights(&self, kernel: KernelDispatch, plan: &ComputePlan) -> KernelDispatch {
        kernel
            .add_input_buffer("weights", "Field", plan.params_buffer())
            .add_u32_constants([("BASE", self.first_param)])
    }

    fn forward(&self, plan: &ComputePlan) -> KernelDispatch {
        let (rows, cols) = (DynamicDim::PerSample(self.out_pixels()), self.output.num_fields());
        let product = self.product(rows, cols, DynamicDim::Fixed(self.folds.fields_per_patch));
        let kernel = self.add_patch_reader(product.kernel_dispatch("forward"));
        let kernel =
            self.output.add_output_to_kernel(self.add_weights(kernel, plan), "y", self.y.values);
        let kernel = kernel.add_wgsl(
            "fn left_at(r: u32, d: u32) -> Field { return input_at(r, d); }
             fn right_at(d: u32, c: u32) -> Field { return weights[BASE + d * COLS + c]; }
             fn put(slice: u32, r: u32, c: u32, v: Field) {
                 finish(r, c, v + weights[BASE + ENTRIES * COLS + c]);
             }",
        );
        match self.masks {
            None => kernel.add_wgsl("fn finish(r: u32, c: u32, v: Field) { store_y(r, c, v); }"),
            Some(masks) => kernel.add_output_buffer("masks", "u32", masks).add_wgsl(
                "fn finish(r: u32, c: u32, v: Field) {
                     let regular = transform(v);
                     let mask = passing(regular);
                     masks[r * COLS + c] = mask;
                     store_y(r, c, transform(masked(regular, mask)));
                 }",
            ),
        }
    }

    /// Adds the WGSL function `d_output(row, field)`, which reads the output gradient, back through
    /// the ReLU.
    fn add_gradient_reader(&self, kernel: KernelDispatch, dy: BufferSlot) -> KernelDispatch {
        let kernel = self.output.add_input_to_kernel(kernel, "dy", dy);
        match self.masks {
            None => {
                kernel.add_wgsl("fn d_output(r: u32, c: u32) -> Field { return load_dy(r, c); }")
            }
            Some(masks) => kernel
                .add_input_buffer("masks", "u32", masks)
                .add_u32_constants([("OUTPUTS", self.output.num_fields())])
                .add_wgsl(
                    "fn d_output(r: u32, c: u32) -> Field {
                         let d = transform(load_dy(r, c));
                         return transform(masked(d, masks[r * OUTPUTS + c]));
                     }",
                ),
        }
    }

    fn weight_gradient(&self, plan: &mut ComputePlan, dy: BufferSlot) -> Vec<KernelDispatch> {
        let cols = self.output.num_fields();
        let mut product = self.product(
            DynamicDim::Fixed(self.folds.fields_per_patch + 1),
            cols,
            DynamicDim::PerSample(self.out_pixels()),
        );
        product.left_is_column_major = true;
        let slices = TARGET_WORKGROUPS.div_ceil(product.workgroups_per_slice()).min(MAX_SLICES);
        let slices = slices.min(self.out_pixels());
        // The product over pixels is cut into slices, because it has few rows and columns, which
        // alone would occupy a fraction of a GPU.
        product.num_slices = slices;
        let len = (self.folds.fields_per_patch + 1) * cols * self.order;
        let kernel = self.add_patch_reader(product.kernel_dispatch("weight gradient"));
        let kernel = self.add_gradient_reader(kernel, dy).add_wgsl(
            // the bias is a weight whose input is 1
            "fn left_at(r: u32, d: u32) -> Field {
                 if r == ENTRIES { return first(1.0); }
                 return input_at(d, r);
             }
             fn right_at(d: u32, c: u32) -> Field { return d_output(d, c); }",
        );
        let put = |to: &str| {
            let place = "START + slice * LEN + r * COLS + c";
            format!("fn put(slice: u32, r: u32, c: u32, v: Field) {{ {to}[{place}] = v; }}")
        };
        let sizes = |start| [("START", start), ("LEN", len / self.order)];
        if slices == 1 {
            let kernel =
                kernel.add_output_buffer("gradient", "Field", plan.params_gradient_buffer());
            return vec![
                kernel.add_wgsl(&put("gradient")).add_u32_constants(sizes(self.first_param)),
            ];
        }
        let partial = plan.shared_buffer(SharedBuffer::PartialGradients, slices * len, 0);
        let kernel = kernel.add_output_buffer("partial", "Field", partial);
        let kernel = kernel.add_wgsl(&put("partial")).add_u32_constants(sizes(0));
        let at = self.first_param * self.order;
        vec![kernel, sum_partial_gradients(plan, partial, DynamicDim::Fixed(slices), at..at + len)]
    }

    fn input_gradient(
        &self,
        plan: &mut ComputePlan,
        dy: BufferSlot,
        dx: BufferSlot,
    ) -> Vec<KernelDispatch> {
        let (rows, cols) = (DynamicDim::PerSample(self.out_pixels()), self.output.num_fields());
        let product = self.product(rows, self.folds.fields_per_patch, DynamicDim::Fixed(cols));
        let kernel = self.add_weights(product.kernel_dispatch("input gradient"), plan);
        let kernel =
            self.add_gradient_reader(kernel, dy).add_u32_constants([("DEPTH", cols)]).add_wgsl(
                "fn left_at(r: u32, d: u32) -> Field { return d_output(r, d); }
             fn right_at(d: u32, c: u32) -> Field { return weights[BASE + c * DEPTH + d]; }",
            );
        let put = |to| format!("fn put(slice: u32, r: u32, c: u32, v: Field) {{ {to}; }}");
        if self.folded.is_none() {
            let kernel = self.input.add_output_to_kernel(kernel, "dx", dx);
            return vec![kernel.add_wgsl(&put("store_dx(r, c, v)"))];
        }
        let folded = self.out_pixels() * self.folds.fields_per_patch * self.order;
        let folded = plan.shared_buffer(SharedBuffer::FoldedGradient, 0, folded);
        let kernel = kernel.add_output_buffer("d_folded", "Field", folded);
        vec![
            kernel.add_wgsl(&put("d_folded[r * COLS + c] = v")),
            self.unfold_kernel(plan, folded, dx),
        ]
    }

    /// Returns the kernel that sums the gradients of the folded patches into `dx`.
    fn unfold_kernel(
        &self,
        plan: &mut ComputePlan,
        folded: BufferSlot,
        dx: BufferSlot,
    ) -> KernelDispatch {
        let kernel = self.kernel_on_windows("unfold", self.x.shape.num_pixels());
        let kernel = sum_over_taps(kernel, "window_at")
            .add_input_buffer("taps", "Tap", plan.add_constant_table(self.folds.tap_table()))
            .add_input_buffer("d_folded", "Field", folded);
        if self.folds.is_input_trivial {
            kernel
                .add_output_buffer("dx", "f32", dx)
                .add_wgsl(include_str!("../wgsl/unfold_trivial.wgsl"))
        } else {
            self.input
                .add_output_to_kernel(kernel, "sum", dx)
                .add_wgsl(include_str!("../wgsl/unfold.wgsl"))
        }
    }
}

/// Returns the text of a WGSL function that reads the input at a tap of a window; zero in the
/// padding.
fn tap_reader(element: &str, value: &str) -> String {
    format!(
        "fn seen(row: u32, tap: vec2<u32>, field: u32) -> {element} {{
             let pixel = pixel_at(row, tap);
             if pixel < 0 {{ return {element}(); }}
             return {value};
         }}"
    )
}
