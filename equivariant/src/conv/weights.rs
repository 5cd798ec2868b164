//! The parameters of a convolution in the order in which the kernels read them.

use std::ops::Range;
use std::sync::Arc;

use symmetry::{FieldType, Irrep};

use crate::conv::maps::Pieces;
use crate::real::Real;
use crate::simd::lanes::{Block, LANES};
use crate::simd::patches::Patches;
use crate::steerable::blocks::Blocks;
use crate::steerable::taps::Taps;

/// The order of the weights among the parameters: `[group of a folded patch][output field][irrep]`.
///
/// That is the order of the kernels but for lanes and groups that have no weight: regular fields in
/// multiples of a block lack none, and packing is a copy.
#[derive(Clone, Debug)]
pub(crate) struct Weights {
    order: usize,
    /// Groups of a folded patch.
    groups: usize,
    /// Blocks of an output pixel.
    width: usize,
    /// Parameters that are neighbours in packed order too.
    runs: Arc<[Run]>,
    /// The parameter of every entry of the four blocks of the linear map.
    places: Arc<[usize]>,
}

/// Parameters that are neighbours in both orders.
#[derive(Clone, Debug)]
struct Run {
    params: Range<usize>,
    packed: Range<usize>,
}

impl Weights {
    pub fn new(taps: &Taps, patches: &Patches, blocks: &Blocks, out: FieldType) -> Weights {
        let irreps = out.group().irreps();
        let fields = irreps.iter().map(|&b| out.multiplicity(b)).max();
        let groups = patches.folded() * LANES / irreps.len();
        let width = (fields.unwrap_or(0) * irreps.len()).div_ceil(LANES);
        let mut entries = vec![GAP; groups * width * LANES];
        for (lane, &b) in irreps.iter().enumerate() {
            for (i, function) in taps.functions().iter().enumerate() {
                let group = patches.first_group(function.parity, function.parts[0].0);
                let input = taps.input(b, function.parity);
                let first = blocks.weights(b).start + taps.column(b, i);
                for output in 0..out.multiplicity(b) {
                    for channel in 0..taps.in_type().multiplicity(input) {
                        let to = (group + channel) * width * LANES + output * irreps.len() + lane;
                        entries[to] = first + output * blocks.cols(b) + channel;
                    }
                }
            }
        }
        let mut places = vec![0; blocks.weights(Irrep::XY).end];
        let runs = runs(&entries, &mut places);
        Weights { order: irreps.len(), groups, width, runs: runs.into(), places: places.into() }
    }

    /// The parameter of every entry of the blocks of the linear map, `[out, columns]` one after the
    /// other.
    pub fn places(&self) -> &[usize] {
        &self.places
    }

    /// Blocks of an output pixel.
    pub fn width(&self) -> usize {
        self.width
    }

    /// The number of blocks of the packed weights.
    pub fn blocks(&self) -> usize {
        self.groups * self.width
    }

    /// `true` if the parameters are in packed order already, without gaps.
    pub fn in_place(&self) -> bool {
        let all = 0..self.blocks() * LANES;
        matches!(&self.runs[..], [run] if run.params == all && run.packed == all)
    }

    /// The packed weights: the parameters themselves where they can be read in place.
    pub fn packed<'a, T: Real>(
        &self,
        params: &'a [T],
        pieces: &mut Pieces<'a, T>,
        may_read_in_place: bool,
    ) -> &'a [Block<T>] {
        if may_read_in_place && self.in_place() {
            return &params.as_chunks().0[..self.blocks()];
        }
        let packed = pieces.take(self.blocks());
        self.pack(params, packed);
        packed
    }

    /// Writes `[group of a folded patch][block of outputs]`; a group of lanes is an output field.
    pub fn pack<T: Real>(&self, params: &[T], packed: &mut [Block<T>]) {
        let packed = packed.as_flattened_mut();
        let mut end = 0;
        for run in self.runs.iter() {
            packed[end..run.packed.start].fill(T::ZERO);
            packed[run.packed.clone()].copy_from_slice(&params[run.params.clone()]);
            end = run.packed.end;
        }
        packed[end..].fill(T::ZERO);
    }

    /// Adds packed gradients to those of the parameters.
    pub fn add_unpacked<T: Real>(&self, packed: &[Block<T>], dparams: &mut [T]) {
        let packed = packed.as_flattened();
        for run in self.runs.iter() {
            let dparams = &mut dparams[run.params.clone()];
            for (d, &sum) in dparams.iter_mut().zip(&packed[run.packed.clone()]) {
                *d += sum;
            }
        }
    }

    /// Transposes packed weights to `[block of inputs][output field][fold]`, orbit by orbit.
    ///
    /// The lanes of a block are (input field, output irrep).
    #[inline(always)]
    pub fn transpose<T: Real, const G: usize>(
        &self,
        patches: &Patches,
        packed: &[Block<T>],
        transposed: &mut [Block<T>],
    ) {
        let per_block = LANES / G;
        let fields = self.width * per_block;
        let packed = packed.as_flattened().as_chunks::<G>().0;
        for orbit in 0..patches.orbits() {
            let range = patches.folded_of(orbit);
            let folds = range.len() / patches.blocks().max(1);
            let mut to = transposed[range.start * fields..range.end * fields].iter_mut();
            for c in 0..patches.blocks() {
                for field in 0..fields {
                    for (fold, block) in (0..folds).zip(&mut to) {
                        let group = (range.start + fold * patches.blocks() + c) * per_block;
                        for (q, to) in block.as_chunks_mut::<G>().0.iter_mut().enumerate() {
                            *to = packed[(group + q) * fields + field];
                        }
                    }
                }
            }
        }
    }

    /// The order of the group.
    pub fn order(&self) -> usize {
        self.order
    }
}

/// An entry of the packed weights without a parameter.
const GAP: usize = usize::MAX;

/// Numbers the entries in their order and lists those without a gap between them.
fn runs(entries: &[usize], places: &mut [usize]) -> Vec<Run> {
    let mut runs: Vec<Run> = Vec::new();
    let entries = entries.iter().enumerate();
    let entries = entries.filter(|(_, entry)| **entry != GAP);
    for (next, (packed, &entry)) in entries.enumerate() {
        places[entry] = next;
        match runs.last_mut().filter(|run| run.packed.end == packed) {
            Some(run) => {
                run.params.end += 1;
                run.packed.end += 1;
            }
            None => runs.push(Run { params: next..next + 1, packed: packed..packed + 1 }),
        }
    }
    runs
}
