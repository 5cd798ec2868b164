//! Parameters of a convolution in the order in which the kernels read them.

use std::ops::Range;
use std::sync::Arc;

use symmetry::{FieldType, Irrep};

use crate::conv::maps::Arena;
use crate::real::Real;
use crate::simd::lanes::{Block, LANES};
use crate::simd::patches::PatchGeometry;
use crate::steerable::irrep_weights::IrrepWeights;
use crate::steerable::taps::TapBasis;

/// Layout of a convolution's weights among its parameters: `[lane group of a folded patch][output
/// field][irrep]`.
///
/// The packed layout of the CPU kernels differs from it only by lanes and groups without a weight.
/// If all fields are regular and fill whole blocks there are none, and packing is a copy.
#[derive(Clone, Debug)]
pub(crate) struct WeightLayout {
    /// Order of the symmetry group, the number of its elements.
    pub group_order: usize,
    /// Number of lane groups of a folded patch (a patch as signed sums over orbits of taps); a
    /// group has one lane for each irrep.
    num_lane_groups: usize,
    /// Number of blocks of [`LANES`] values that an output pixel fills.
    pub blocks_per_pixel: usize,
    /// Ranges of weights that are contiguous both among the parameters and in the packed order of
    /// the CPU kernels.
    ranges: Arc<[ContiguousRange]>,
    /// Index of the parameter of every entry of the four irreps' weight matrices, `[out, columns]`
    /// for each irrep in turn.
    pub param_indices: Arc<[usize]>,
}

/// Range of weights that is contiguous both among the parameters and in the packed order of the CPU
/// kernels.
#[derive(Clone, Debug)]
struct ContiguousRange {
    params: Range<usize>,
    packed: Range<usize>,
}

impl WeightLayout {
    pub fn new(
        taps: &TapBasis,
        patches: &PatchGeometry,
        irrep_weights: &IrrepWeights,
        out: FieldType,
    ) -> WeightLayout {
        let irreps = out.group().irreps();
        let fields = irreps.iter().map(|&b| out.multiplicity(b)).max();
        let num_lane_groups = patches.blocks_per_folded_patch * LANES / irreps.len();
        let width = (fields.unwrap_or(0) * irreps.len()).div_ceil(LANES);
        let mut entries = vec![NO_PARAM; num_lane_groups * width * LANES];
        // lane b of a group computes output irrep b, from the fold whose parity leads to b
        for (lane, &b) in irreps.iter().enumerate() {
            for (i, function) in taps.basis_functions.iter().enumerate() {
                let group =
                    patches.first_lane_group(function.parity, function.tap_coefficients[0].0);
                let input = taps.input_irrep_for_parity(b, function.parity);
                let first = irrep_weights.weight_range(b).start + taps.first_weight_column(b, i);
                for output in 0..out.multiplicity(b) {
                    for channel in 0..taps.in_type.multiplicity(input) {
                        let to = (group + channel) * width * LANES + output * irreps.len() + lane;
                        entries[to] = first + output * irrep_weights.num_inputs(b) + channel;
                    }
                }
            }
        }
        let mut places = vec![0; irrep_weights.weight_range(Irrep::XY).end];
        let ranges = contiguous_ranges(&entries, &mut places);
        WeightLayout {
            group_order: irreps.len(),
            num_lane_groups,
            blocks_per_pixel: width,
            ranges: ranges.into(),
            param_indices: places.into(),
        }
    }

    /// Returns the number of blocks of the weights in the packed order of the CPU kernels.
    pub fn num_packed_blocks(&self) -> usize {
        self.num_lane_groups * self.blocks_per_pixel
    }

    /// Returns `true` if the parameters are in packed order already, without gaps.
    pub fn is_packed_already(&self) -> bool {
        let all = 0..self.num_packed_blocks() * LANES;
        matches!(&self.ranges[..], [range] if range.params == all && range.packed == all)
    }

    /// Returns the weights in the packed order of the CPU kernels: the parameters themselves if
    /// they have this order and `may_read_in_place` is `true`, otherwise a copy in the arena.
    pub fn packed_weights<'a, T: Real>(
        &self,
        params: &'a [T],
        arena: &mut Arena<'a, T>,
        may_read_in_place: bool,
    ) -> &'a [Block<T>] {
        if may_read_in_place && self.is_packed_already() {
            return &params.as_chunks().0[..self.num_packed_blocks()];
        }
        let packed = arena.take_blocks(self.num_packed_blocks());
        self.pack_weights(params, packed);
        packed
    }

    /// Writes the weights in the packed order of the CPU kernels, `[lane group of a folded
    /// patch][block of outputs]`; a lane group of a block is an output field.
    pub fn pack_weights<T: Real>(&self, params: &[T], packed: &mut [Block<T>]) {
        let packed = packed.as_flattened_mut();
        let mut end = 0;
        for range in self.ranges.iter() {
            packed[end..range.packed.start].fill(T::ZERO);
            packed[range.packed.clone()].copy_from_slice(&params[range.params.clone()]);
            end = range.packed.end;
        }
        packed[end..].fill(T::ZERO);
    }

    /// Adds the gradient with respect to the packed weights to the gradient with respect to the
    /// parameters.
    pub fn add_unpacked_gradient<T: Real>(&self, packed: &[Block<T>], dparams: &mut [T]) {
        let packed = packed.as_flattened();
        for range in self.ranges.iter() {
            let dparams = &mut dparams[range.params.clone()];
            for (d, &sum) in dparams.iter_mut().zip(&packed[range.packed.clone()]) {
                *d += sum;
            }
        }
    }

    /// Transposes packed weights to `[block of inputs][output field][fold]`, one orbit of taps
    /// after the other.
    ///
    /// The lanes of a block are (input field, output irrep).
    #[inline(always)]
    pub fn transpose_packed_weights<T: Real, const G: usize>(
        &self,
        patches: &PatchGeometry,
        packed: &[Block<T>],
        transposed: &mut [Block<T>],
    ) {
        let per_block = LANES / G;
        let fields = self.blocks_per_pixel * per_block;
        let packed = packed.as_flattened().as_chunks::<G>().0;
        for orbit in 0..patches.orbits.len() {
            let range = patches.orbit_blocks(orbit);
            let folds = range.len() / patches.blocks_per_pixel.max(1);
            let mut to = transposed[range.start * fields..range.end * fields].iter_mut();
            for c in 0..patches.blocks_per_pixel {
                for field in 0..fields {
                    for (fold, block) in (0..folds).zip(&mut to) {
                        let group = (range.start + fold * patches.blocks_per_pixel + c) * per_block;
                        for (q, value) in block.as_chunks_mut::<G>().0.iter_mut().enumerate() {
                            *value = packed[(group + q) * fields + field];
                        }
                    }
                }
            }
        }
    }
}

/// Marker of an entry of the packed weights without a parameter.
const NO_PARAM: usize = usize::MAX;

/// Writes the parameter index of every weight into `places`, and returns the contiguous ranges of
/// packed weights.
fn contiguous_ranges(entries: &[usize], places: &mut [usize]) -> Vec<ContiguousRange> {
    let mut ranges: Vec<ContiguousRange> = Vec::new();
    let used = entries.iter().enumerate().filter(|(_, entry)| **entry != NO_PARAM);
    for (next, (packed, &entry)) in used.enumerate() {
        places[entry] = next;
        match ranges.last_mut().filter(|range| range.packed.end == packed) {
            Some(range) => {
                range.params.end += 1;
                range.packed.end += 1;
            }
            None => {
                ranges.push(ContiguousRange { params: next..next + 1, packed: packed..packed + 1 })
            }
        }
    }
    ranges
}
