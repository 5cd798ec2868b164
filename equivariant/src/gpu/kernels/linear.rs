//! Convolutions and linear layers: folds, products, and their gradients.

use std::collections::BTreeSet;

use symmetry::Irrep;

use crate::gpu::channels::Channels;
use crate::gpu::kernels::partial::sum;
use crate::gpu::kernels::product::Product;
use crate::gpu::kernels::window::windows;
use crate::gpu::plan::{Plan, Shared, Tensor};
use crate::gpu::step::{Rows, Slot, Step, Work};
use crate::steerable::dense::Dense;
use crate::window::Kernel;

/// Partial gradients in the parameters at most, each of a part of the output pixels.
const MOST_SLICES: usize = 64;

/// The taps that the group moves to one another, folded together.
#[derive(Clone, Copy, Debug)]
struct Orbit {
    /// Row and column of its first tap.
    tap: [usize; 2],
    /// Its taps, and as many parities.
    len: usize,
    /// A bit for each parity, by its position in the group's list of irreps.
    parities: u32,
    /// The first of its entries in a folded patch.
    first: usize,
}

/// A linear map as kernels see it.
struct Linear<'a> {
    dense: &'a Dense<'a>,
    x: Tensor,
    y: Tensor,
    order: usize,
    input: Channels,
    output: Channels,
    /// Whether the input has trivial channels only, whose folds of one orbit are one field.
    trivial: bool,
    /// Whether a patch is a pixel, which needs no fold.
    direct: bool,
    /// Input fields, or channels where they are trivial.
    fields: usize,
    orbits: Vec<Orbit>,
    /// Fields of a folded patch.
    entries: usize,
    /// Where the parameters start, in fields.
    base: usize,
    /// Which numbers of each output field a ReLU lets pass, where one follows.
    masks: Option<Slot>,
}

/// Adds a linear map, with a ReLU after it if it is `rectified`.
pub(super) fn add(plan: &mut Plan, dense: &Dense, (x, y): (&Tensor, &Tensor), rectified: bool) {
    let mut linear = Linear::new(dense, x, y);
    let fields = y.shape.pixels() * linear.output.fields();
    linear.masks = rectified.then(|| plan.buffer(0, fields));
    let len = (linear.entries + 1) * linear.output.fields() * linear.order;
    linear.base = plan.reserve(len, linear.places()) / linear.order;
    let folded = match linear.direct {
        true => None,
        false => Some(plan.buffer(0, linear.out_pixels() * linear.entries * linear.order)),
    };
    let mut forward = Vec::new();
    if let Some(folded) = folded {
        forward.push(linear.fold(plan, folded));
    }
    forward.push(linear.forward(plan, folded));
    let mut backward = Vec::new();
    if let Some(dy) = y.gradient {
        backward.extend(linear.weight_gradient(plan, folded, dy));
        if let Some(dx) = x.gradient {
            backward.extend(linear.input_gradient(plan, dy, dx));
        }
    }
    plan.push(forward, backward);
}

impl<'a> Linear<'a> {
    fn new(dense: &'a Dense<'a>, x: &Tensor, y: &Tensor) -> Linear<'a> {
        let (in_type, order) = (x.shape.fields, x.shape.fields.group().order());
        let Kernel {
            size,
            stride,
            padding,
        } = dense.window;
        let direct = [size, stride, padding] == [1, 1, 0];
        let trivial = in_type.is_trivial() && order > 1 && !direct;
        let input = Channels::of(in_type);
        let fields = input.fields();
        let mut linear = Linear {
            dense,
            x: *x,
            y: *y,
            order,
            output: Channels::of(y.shape.fields),
            input,
            trivial,
            direct,
            fields,
            orbits: Vec::new(),
            entries: 0,
            base: 0,
            masks: None,
        };
        linear.add_orbits();
        linear
    }

    fn add_orbits(&mut self) {
        let functions = self.dense.taps.functions();
        let starts: BTreeSet<[usize; 2]> = functions.iter().map(|f| f.parts[0].0).collect();
        for tap in starts {
            let own = functions.iter().filter(|f| f.parts[0].0 == tap);
            let parities = own.fold(0u32, |mask, f| mask | 1 << self.position(f.parity));
            let len = parities.count_ones() as usize;
            self.orbits.push(Orbit {
                tap,
                len,
                parities,
                first: self.entries,
            });
            self.entries += self.fields * if self.trivial { 1 } else { len };
        }
    }

    /// The position of an irrep in its group's list.
    fn position(&self, irrep: Irrep) -> usize {
        let irreps = self.x.shape.fields.group().irreps();
        irreps.iter().position(|&a| a == irrep).unwrap_or(0)
    }

    fn out_pixels(&self) -> usize {
        self.y.shape.pixels()
    }

    /// The entry of a folded patch with the first channel of a function on the taps.
    fn entry(&self, tap: [usize; 2], parity: Irrep) -> usize {
        let Some(orbit) = self.orbits.iter().find(|orbit| orbit.tap == tap) else {
            unreachable!("every function starts with the first tap of an orbit")
        };
        let before = orbit.parities & ((1 << self.position(parity)) - 1);
        let skipped = if self.trivial {
            0
        } else {
            before.count_ones() as usize
        };
        orbit.first + skipped * self.fields
    }

    /// For every parameter of the layer, its place among `[entry, output field, irrep]`; the bias
    /// is one entry more.
    fn places(&self) -> Vec<usize> {
        let Dense { taps, blocks, .. } = self.dense;
        let (out_type, in_type) = (self.y.shape.fields, self.x.shape.fields);
        let cols = self.output.fields();
        let mut places = vec![0; blocks.num_params()];
        for (lane, &b) in out_type.group().irreps().iter().enumerate() {
            for (i, function) in taps.functions().iter().enumerate() {
                let entry = self.entry(function.parts[0].0, function.parity);
                let first = blocks.weights(b).start + taps.column(b, i);
                let channels = in_type.multiplicity(taps.input(b, function.parity));
                for output in 0..out_type.multiplicity(b) {
                    for channel in 0..channels {
                        let weight = first + output * blocks.cols(b) + channel;
                        let param = self.dense.places.map_or(weight, |places| places[weight]);
                        places[param] = ((entry + channel) * cols + output) * self.order + lane;
                    }
                }
            }
        }
        for (output, param) in blocks.bias().enumerate() {
            places[param] = (self.entries * cols + output) * self.order;
        }
        places
    }

    /// Folds the patches.
    fn fold(&self, plan: &mut Plan, folded: Slot) -> Step {
        let orbits = plan.table(self.orbit_table());
        let work = Work::threads(self.out_pixels() * self.orbits.len() * self.fields);
        let step = Step::new("fold", self.order, work).constants([
            ("FIELDS", self.fields),
            ("ORBITS", self.orbits.len()),
            ("ENTRIES", self.entries),
        ]);
        let step = windows(step, self.dense.window, [self.x.shape, self.y.shape]);
        let step = step
            .read("orbits", "Orbit", orbits)
            .write("folded", "Field", folded);
        if self.trivial {
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

    /// `Orbit` of `window.wgsl`, with the factor that makes the fold of all elements orthonormal.
    fn orbit_table(&self) -> Vec<u32> {
        let rows = self.orbits.iter().map(|orbit| {
            let scale = (orbit.len as f64).sqrt() / self.order as f64;
            let [row, col] = orbit.tap.map(|at| at as u32);
            let first = orbit.first as u32;
            // the last number fills up what the alignment of the first two asks for
            [row, col, first, orbit.parities, (scale as f32).to_bits(), 0]
        });
        rows.flatten().collect()
    }

    /// `Tap` of `window.wgsl`, row-major.
    fn tap_table(&self) -> Vec<u32> {
        let size = self.dense.window.size;
        let elements = self.x.shape.fields.group().elements();
        let taps = (0..size * size).map(|tap| [tap / size, tap % size]);
        let rows = taps.map(|tap| {
            let moved = |orbit: &Orbit| {
                let [row, col] = orbit.tap;
                elements
                    .iter()
                    .position(|g| g.apply_pixel(row, col, size, size) == (tap[0], tap[1]))
            };
            let found = self
                .orbits
                .iter()
                .find_map(|orbit| Some((orbit, moved(orbit)?)));
            let Some((orbit, element)) = found else {
                unreachable!("every tap is in an orbit")
            };
            let scale = (orbit.len as f64).sqrt().recip() as f32;
            [
                orbit.first as u32,
                orbit.parities,
                element as u32,
                scale.to_bits(),
            ]
        });
        rows.flatten().collect()
    }

    fn product(&self, rows: Rows, cols: usize, depth: Rows) -> Product {
        Product {
            order: self.order,
            rows,
            cols,
            depth,
            slices: 1,
            rows_are_neighbours: false,
        }
    }

    /// Adds the folded patches, or the pixels that they are, as `input_at(row, entry)`.
    fn patches(&self, step: Step, folded: Option<Slot>) -> Step {
        let function =
            |body| format!("fn input_at(row: u32, entry: u32) -> Field {{ return {body}; }}");
        match folded {
            Some(folded) => step
                .read("folded", "Field", folded)
                .text(&function("folded[row * ENTRIES + entry]")),
            None => self
                .input
                .read(step, "x", self.x.values)
                .text(&function("load_x(row, entry)")),
        }
        .constants([("ENTRIES", self.entries)])
    }

    fn weights(&self, step: Step, plan: &Plan) -> Step {
        step.read("weights", "Field", plan.params())
            .constants([("BASE", self.base)])
    }

    fn forward(&self, plan: &Plan, folded: Option<Slot>) -> Step {
        let (rows, cols) = (Rows::Each(self.out_pixels()), self.output.fields());
        let product = self.product(rows, cols, Rows::Fixed(self.entries));
        let step = self.patches(product.step("forward"), folded);
        let step = self
            .output
            .write(self.weights(step, plan), "y", self.y.values);
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

    /// Adds the gradient in the output, before its ReLU, as `d_output(row, field)`.
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

    fn weight_gradient(&self, plan: &mut Plan, folded: Option<Slot>, dy: Slot) -> Vec<Step> {
        let cols = self.output.fields();
        let slices = self.out_pixels().min(MOST_SLICES);
        let product = Product {
            slices,
            rows_are_neighbours: true,
            ..self.product(
                Rows::Fixed(self.entries + 1),
                cols,
                Rows::Each(self.out_pixels()),
            )
        };
        let len = (self.entries + 1) * cols * self.order;
        let step = self.patches(product.step("weight gradient"), folded);
        let step = self.output_gradient(step, dy).text(
            // the bias has an input of one
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
        vec![step, sum(plan, partial, Rows::Fixed(slices), (at, len))]
    }

    fn input_gradient(&self, plan: &mut Plan, dy: Slot, dx: Slot) -> Vec<Step> {
        let (rows, cols) = (Rows::Each(self.out_pixels()), self.output.fields());
        let product = self.product(rows, self.entries, Rows::Fixed(cols));
        let step = self.weights(product.step("input gradient"), plan);
        let step = self
            .output_gradient(step, dy)
            .constants([("DEPTH", cols)])
            .text(
                "fn left_at(r: u32, d: u32) -> Field { return d_output(r, d); }
             fn right_at(d: u32, c: u32) -> Field { return weights[BASE + c * DEPTH + d]; }",
            );
        let put = |to| format!("fn put(slice: u32, r: u32, c: u32, v: Field) {{ {to}; }}");
        if self.direct {
            let step = self.input.write(step, "dx", dx);
            return vec![step.text(&put("store_dx(r, c, v)"))];
        }
        let folded = self.out_pixels() * self.entries * self.order;
        let folded = plan.shared(Shared::Folded, 0, folded);
        let step = step.write("d_folded", "Field", folded);
        vec![
            step.text(&put("d_folded[r * COLS + c] = v")),
            self.unfold(plan, folded, dx),
        ]
    }

    fn unfold(&self, plan: &mut Plan, folded: Slot, dx: Slot) -> Step {
        let taps = plan.table(self.tap_table());
        let work = Work::threads(self.x.shape.pixels() * self.fields);
        let step = Step::new("unfold", self.order, work)
            .constants([("FIELDS", self.fields), ("ENTRIES", self.entries)]);
        let step = windows(step, self.dense.window, [self.x.shape, self.y.shape]);
        let step = step
            .read("taps", "Tap", taps)
            .read("d_folded", "Field", folded);
        if self.trivial {
            step.write("dx", "f32", dx)
                .text(include_str!("../wgsl/unfold_trivial.wgsl"))
        } else {
            self.input
                .write(step, "dx", dx)
                .text(include_str!("../wgsl/unfold.wgsl"))
        }
    }
}

/// The function that reads what a window sees at a tap: zero in the padding.
fn seen(element: &str, value: &str) -> String {
    format!(
        "fn seen(row: u32, tap: vec2<u32>, field: u32) -> {element} {{
             let pixel = pixel_at(row, tap);
             if pixel < 0 {{ return {element}(); }}
             return {value};
         }}"
    )
}
