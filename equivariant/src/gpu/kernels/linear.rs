//! Kernels of convolutions and linear layers: folds, products and their gradients.

use crate::gpu::channels::Channels;
use crate::gpu::kernels::folds::Folds;
use crate::gpu::kernels::partial::sum;
use crate::gpu::kernels::pointwise::each_field;
use crate::gpu::kernels::product::Product;
use crate::gpu::kernels::window::{sum_over_taps, windows};
use crate::gpu::plan::{Plan, Shared, Tensor};
use crate::gpu::step::{Rows, Slot, Step};
use crate::steerable::dense::Dense;
use crate::window::Kernel;

/// Maximum number of partial gradients of the parameters, each over a part of the output pixels.
const MAX_SLICES: usize = 256;
/// Target for the number of workgroups of a weight gradient: several for each processor of a large
/// GPU.
const TARGET_GROUPS: usize = 1024;
/// Window of a map that needs no fold.
const PIXEL: Kernel = Kernel::new(1, 1, 0);

/// Linear map with its buffers.
struct Linear<'a> {
    folds: Folds<'a>,
    window: Kernel,
    x: Tensor,
    y: Tensor,
    order: usize,
    input: Channels,
    output: Channels,
    /// Index of the first parameter, in fields.
    base: usize,
    /// Folded patches; `None` if a patch is a single pixel.
    folded: Option<Slot>,
    /// Bit masks of the numbers of each output field that the ReLU passes; `None` without a ReLU.
    masks: Option<Slot>,
}

/// Adds the kernels of a linear map, with a ReLU after it if `rectified`.
pub(super) fn add(plan: &mut Plan, dense: &Dense, x: &Tensor, y: &Tensor, rectified: bool) {
    let linear = Linear::new(plan, dense, x, y, rectified);
    let fold = linear.folded.map(|folded| linear.fold(plan, folded));
    let forward = fold.into_iter().chain([linear.forward(plan)]).collect();
    let mut backward = Vec::new();
    if let Some(dy) = y.gradient {
        backward.extend(linear.weight_gradient(plan, dy));
        if let Some(dx) = x.gradient {
            backward.extend(linear.input_gradient(plan, dy, dx));
        }
    }
    plan.push(forward, backward);
}

impl<'a> Linear<'a> {
    fn new(
        plan: &mut Plan,
        dense: &'a Dense<'a>,
        x: &Tensor,
        y: &Tensor,
        rectified: bool,
    ) -> Linear<'a> {
        let direct = dense.window == PIXEL;
        let folds = Folds::new(dense, direct);
        let [input, output] = [x, y].map(|map| Channels::of(map.shape.fields));
        let (order, pixels) = (input.order(), y.shape.pixels());
        // the bias is one more entry
        let params = (folds.entries + 1) * output.fields() * order;
        Linear {
            base: plan.reserve(params, folds.places()) / order,
            folded: (!direct).then(|| plan.buffer(0, pixels * folds.entries * order)),
            masks: rectified.then(|| plan.buffer(0, pixels * output.fields())),
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
        self.y.shape.pixels()
    }

    /// Returns a kernel on windows with a thread for each of `places` places and each input field.
    fn windowed(&self, label: &'static str, places: usize) -> Step {
        let step = each_field(label, &self.input, places);
        let step = step.constants([("ENTRIES", self.folds.entries)]);
        windows(step, self.window, [self.x.shape, self.y.shape])
    }

    /// Returns the kernel that folds the patches: signed sums of the input over each orbit of taps.
    fn fold(&self, plan: &mut Plan, folded: Slot) -> Step {
        let orbits = self.folds.orbits();
        let step = self
            .windowed("fold", self.out_pixels() * orbits)
            .constants([("ORBITS", orbits)])
            .read("orbits", "Orbit", plan.table(self.folds.orbit_table()))
            .write("folded", "Field", folded)
            .text(include_str!("../wgsl/each_orbit.wgsl"));
        if self.folds.trivial {
            step.read("x", "f32", self.x.values)
                .text(&seen("f32", "x[u32(pixel) * FIELDS + field]"))
                .text(include_str!("../wgsl/fold_trivial.wgsl"))
        } else {
            self.input
                .read(step, "x", self.x.values)
                .text(&seen("Field", "load_x(u32(pixel), field)"))
                .text(include_str!("../wgsl/fold.wgsl"))
        }
    }

    fn product(&self, rows: Rows, cols: usize, depth: Rows) -> Product {
        Product { order: self.order, rows, cols, depth, slices: 1, rows_are_neighbours: false }
    }

    /// Adds the folded patches, or the pixels if they need no fold, as `input_at(row, entry)`.
    fn patches(&self, step: Step) -> Step {
        let function =
            |body| format!("fn input_at(row: u32, entry: u32) -> Field {{ return {body}; }}");
        match self.folded {
            Some(folded) => step
                .read("folded", "Field", folded)
                .text(&function("folded[row * ENTRIES + entry]")),
            None => self.input.read(step, "x", self.x.values).text(&function("load_x(row, entry)")),
        }
        .constants([("ENTRIES", self.folds.entries)])
    }

    fn weights(&self, step: Step, plan: &Plan) -> Step {
        step.read("weights", "Field", plan.params()).constants([("BASE", self.base)])
    }

    fn forward(&self, plan: &Plan) -> Step {
        let (rows, cols) = (Rows::Each(self.out_pixels()), self.output.fields());
        let product = self.product(rows, cols, Rows::Fixed(self.folds.entries));
        let step = self.patches(product.step("forward"));
        let step = self.output.write(self.weights(step, plan), "y", self.y.values);
        let step = step.text(
            "fn left_at(r: u32, d: u32) -> Field { return input_at(r, d); }
             fn right_at(d: u32, c: u32) -> Field { return weights[BASE + d * COLS + c]; }
             fn put(slice: u32, r: u32, c: u32, v: Field) {
                 finish(r, c, v + weights[BASE + ENTRIES * COLS + c]);
             }",
        );
        match self.masks {
            None => step.text("fn finish(r: u32, c: u32, v: Field) { store_y(r, c, v); }"),
            Some(masks) => step.write("masks", "u32", masks).text(
                "fn finish(r: u32, c: u32, v: Field) {
                     let regular = transform(v);
                     let mask = passing(regular);
                     masks[r * COLS + c] = mask;
                     store_y(r, c, transform(masked(regular, mask)));
                 }",
            ),
        }
    }

    /// Adds the output gradient, back through the ReLU, as `d_output(row, field)`.
    fn output_gradient(&self, step: Step, dy: Slot) -> Step {
        let step = self.output.read(step, "dy", dy);
        match self.masks {
            None => step.text("fn d_output(r: u32, c: u32) -> Field { return load_dy(r, c); }"),
            Some(masks) => step
                .read("masks", "u32", masks)
                .constants([("OUTPUTS", self.output.fields())])
                .text(
                    "fn d_output(r: u32, c: u32) -> Field {
                         let d = transform(load_dy(r, c));
                         return transform(masked(d, masks[r * OUTPUTS + c]));
                     }",
                ),
        }
    }

    fn weight_gradient(&self, plan: &mut Plan, dy: Slot) -> Vec<Step> {
        let cols = self.output.fields();
        let mut product =
            self.product(Rows::Fixed(self.folds.entries + 1), cols, Rows::Each(self.out_pixels()));
        product.rows_are_neighbours = true;
        let slices = TARGET_GROUPS.div_ceil(product.tiles()).min(MAX_SLICES);
        let slices = slices.min(self.out_pixels());
        // The product over pixels is cut into slices, because it has few rows and columns, which
        // alone would occupy a fraction of a GPU.
        product.slices = slices;
        let len = (self.folds.entries + 1) * cols * self.order;
        let step = self.patches(product.step("weight gradient"));
        let step = self.output_gradient(step, dy).text(
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
            let step = step.write("gradient", "Field", plan.gradient());
            return vec![step.text(&put("gradient")).constants(sizes(self.base))];
        }
        let partial = plan.shared(Shared::Partial, slices * len, 0);
        let step = step.write("partial", "Field", partial);
        let step = step.text(&put("partial")).constants(sizes(0));
        let at = self.base * self.order;
        vec![step, sum(plan, partial, Rows::Fixed(slices), at..at + len)]
    }

    fn input_gradient(&self, plan: &mut Plan, dy: Slot, dx: Slot) -> Vec<Step> {
        let (rows, cols) = (Rows::Each(self.out_pixels()), self.output.fields());
        let product = self.product(rows, self.folds.entries, Rows::Fixed(cols));
        let step = self.weights(product.step("input gradient"), plan);
        let step = self.output_gradient(step, dy).constants([("DEPTH", cols)]).text(
            "fn left_at(r: u32, d: u32) -> Field { return d_output(r, d); }
             fn right_at(d: u32, c: u32) -> Field { return weights[BASE + c * DEPTH + d]; }",
        );
        let put = |to| format!("fn put(slice: u32, r: u32, c: u32, v: Field) {{ {to}; }}");
        if self.folded.is_none() {
            let step = self.input.write(step, "dx", dx);
            return vec![step.text(&put("store_dx(r, c, v)"))];
        }
        let folded = self.out_pixels() * self.folds.entries * self.order;
        let folded = plan.shared(Shared::Folded, 0, folded);
        let step = step.write("d_folded", "Field", folded);
        vec![step.text(&put("d_folded[r * COLS + c] = v")), self.unfold(plan, folded, dx)]
    }

    /// Returns the kernel that sums the gradients of the folded patches into `dx`.
    fn unfold(&self, plan: &mut Plan, folded: Slot, dx: Slot) -> Step {
        let step = self.windowed("unfold", self.x.shape.pixels());
        let step = sum_over_taps(step, "window_at")
            .read("taps", "Tap", plan.table(self.folds.tap_table()))
            .read("d_folded", "Field", folded);
        if self.folds.trivial {
            step.write("dx", "f32", dx).text(include_str!("../wgsl/unfold_trivial.wgsl"))
        } else {
            self.input.write(step, "sum", dx).text(include_str!("../wgsl/unfold.wgsl"))
        }
    }
}

/// Returns the WGSL function that reads the input at a tap of a window; zero in the padding.
fn seen(element: &str, value: &str) -> String {
    format!(
        "fn seen(row: u32, tap: vec2<u32>, field: u32) -> {element} {{
             let pixel = pixel_at(row, tap);
             if pixel < 0 {{ return {element}(); }}
             return {value};
         }}"
    )
}
