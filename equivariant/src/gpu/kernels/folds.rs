//! Folds of im2col patches on a GPU: the orbits of the taps and the layout of the parameters.

use std::collections::BTreeSet;

use symmetry::{FieldType, Irrep};

use crate::gpu::channels::ChannelLayout;
use crate::steerable::dense::OrdinaryConv;

/// Folds of a convolution's patches (signed sums over orbits of taps), in the order in which GPU
/// kernels read them.
pub(super) struct OrbitFolds<'a> {
    dense: &'a OrdinaryConv<'a>,
    in_type: FieldType,
    order: usize,
    /// `true` if the input has trivial channels only; all folds of an orbit then form one field.
    pub is_input_trivial: bool,
    /// Number of input fields, or of input channels if these are trivial.
    pub num_input_fields: usize,
    orbits: Vec<Orbit>,
    /// Number of fields of a folded patch.
    pub fields_per_patch: usize,
}

/// Orbit of taps of a kernel, which the group maps to one another.
#[derive(Clone, Copy, Debug)]
struct Orbit {
    /// Row and column of the orbit's first tap.
    tap: [usize; 2],
    /// Number of the orbit's taps, and of its parities.
    len: usize,
    /// Bit mask of the orbit's parities, by their positions in the group's list of irreps.
    parities: u32,
    /// Index of the orbit's first entry in a folded patch.
    first: usize,
}

impl<'a> OrbitFolds<'a> {
    /// Creates the folds of a linear map; `direct` is `true` if a patch is a single pixel.
    pub fn new(dense: &'a OrdinaryConv<'a>, direct: bool) -> OrbitFolds<'a> {
        let in_type = dense.in_shape.fields;
        let order = in_type.group().order();
        let mut folds = OrbitFolds {
            dense,
            in_type,
            order,
            is_input_trivial: in_type.is_trivial() && order > 1 && !direct,
            num_input_fields: ChannelLayout::for_type(in_type).num_fields(),
            orbits: Vec::new(),
            fields_per_patch: 0,
        };
        folds.add_orbits();
        folds
    }

    /// Returns the number of orbits of the window's taps.
    pub fn num_orbits(&self) -> usize {
        self.orbits.len()
    }

    /// Adds the orbits of all taps of the window, in the order of their first taps.
    fn add_orbits(&mut self) {
        let functions = &self.dense.taps.basis_functions;
        let starts: BTreeSet<[usize; 2]> =
            functions.iter().map(|f| f.tap_coefficients[0].0).collect();
        for tap in starts {
            let own = functions.iter().filter(|f| f.tap_coefficients[0].0 == tap);
            let parities = own.fold(0u32, |mask, f| mask | 1 << self.irrep_index(f.parity));
            let len = parities.count_ones() as usize;
            self.orbits.push(Orbit { tap, len, parities, first: self.fields_per_patch });
            self.fields_per_patch +=
                self.num_input_fields * if self.is_input_trivial { 1 } else { len };
        }
    }

    /// Returns the position of an irrep in its group's list of irreps.
    fn irrep_index(&self, irrep: Irrep) -> usize {
        let irreps = self.in_type.group().irreps();
        irreps.iter().position(|&a| a == irrep).unwrap_or(0)
    }

    /// Returns the entry of a folded patch that holds the first channel of the basis function of
    /// parity `parity` on the orbit of `tap`.
    fn patch_entry(&self, tap: [usize; 2], parity: Irrep) -> usize {
        let Some(orbit) = self.orbits.iter().find(|orbit| orbit.tap == tap) else {
            unreachable!("every function starts with the first tap of an orbit")
        };
        let before = orbit.parities & ((1 << self.irrep_index(parity)) - 1);
        let skipped = if self.is_input_trivial { 0 } else { before.count_ones() as usize };
        orbit.first + skipped * self.num_input_fields
    }

    /// Returns the position of every parameter of the layer in the GPU's layout `[entry of a folded
    /// patch, output field, irrep]`; the bias has an entry of its own at the end.
    pub fn param_positions(&self) -> Vec<usize> {
        let OrdinaryConv { taps, irrep_weights, .. } = self.dense;
        let (out_type, in_type) = (self.dense.out_shape.fields, self.in_type);
        let cols = ChannelLayout::for_type(out_type).num_fields();
        let mut positions = vec![0; irrep_weights.num_params()];
        for (lane, &b) in out_type.group().irreps().iter().enumerate() {
            for (i, function) in taps.basis_functions.iter().enumerate() {
                let entry = self.patch_entry(function.tap_coefficients[0].0, function.parity);
                let first = irrep_weights.weight_range(b).start + taps.first_weight_column(b, i);
                let channels =
                    in_type.multiplicity(taps.input_irrep_for_parity(b, function.parity));
                for output in 0..out_type.multiplicity(b) {
                    for channel in 0..channels {
                        let weight = first + output * irrep_weights.num_inputs(b) + channel;
                        let param = self.dense.param_indices.map_or(weight, |moved| moved[weight]);
                        positions[param] = ((entry + channel) * cols + output) * self.order + lane;
                    }
                }
            }
        }
        for (output, param) in irrep_weights.bias_range().enumerate() {
            positions[param] = (self.fields_per_patch * cols + output) * self.order;
        }
        positions
    }

    /// Returns the table of all orbits, each as a struct `Orbit` of `window.wgsl`, with the factor
    /// that makes the fold orthonormal.
    pub fn orbit_table(&self) -> Vec<u32> {
        let rows = self.orbits.iter().map(|orbit| {
            let scale = (orbit.len as f64).sqrt() / self.order as f64;
            let [row, col] = orbit.tap.map(|at| at as u32);
            let first = orbit.first as u32;
            // padding: a struct with a `vec2` is aligned to 8 bytes
            [row, col, first, orbit.parities, (scale as f32).to_bits(), 0]
        });
        rows.flatten().collect()
    }

    /// Returns the table of all taps of the window, row-major, each as a struct `Tap` of
    /// `window.wgsl`.
    pub fn tap_table(&self) -> Vec<u32> {
        let size = self.dense.window.size;
        let elements = self.in_type.group().elements();
        let taps = (0..size * size).map(|tap| [tap / size, tap % size]);
        let rows = taps.map(|tap| {
            let moved = |orbit: &Orbit| {
                let [row, col] = orbit.tap;
                elements
                    .iter()
                    .position(|g| g.apply_pixel(row, col, size, size) == (tap[0], tap[1]))
            };
            let found = self.orbits.iter().find_map(|orbit| Some((orbit, moved(orbit)?)));
            let Some((orbit, element)) = found else { unreachable!("every tap is in an orbit") };
            let scale = (orbit.len as f64).sqrt().recip() as f32;
            [orbit.first as u32, orbit.parities, element as u32, scale.to_bits()]
        });
        rows.flatten().collect()
    }
}
