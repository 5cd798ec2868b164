//! Which folds a step of a product is of.

use crate::simd::lanes::{LANES, TILE};
use crate::simd::patches::Patches;

/// One orbit of taps of one block of channels.
pub(super) struct Gather {
    pub orbit: usize,
    pub c: usize,
    pub folds: usize,
    /// The block of a folded patch that the first fold is, and blocks from one fold to the next.
    first: usize,
    step: usize,
}

impl Gather {
    /// They are numbered in the order in which passes take them.
    pub fn new(patches: &Patches, number: usize) -> Option<Gather> {
        let (orbit, c) = (number % patches.orbits(), number / patches.orbits());
        (c < patches.blocks()).then(|| {
            let range = patches.folded_of(orbit);
            Gather {
                orbit,
                c,
                folds: range.len() / patches.blocks(),
                first: range.start + c,
                step: patches.blocks(),
            }
        })
    }

    pub fn all(patches: &Patches) -> impl Iterator<Item = Gather> {
        (0..).map_while(|number| Gather::new(patches, number))
    }

    /// The block of a folded patch that a fold is.
    pub fn block(&self, fold: usize) -> Option<usize> {
        (fold < self.folds).then_some(self.first + fold * self.step)
    }

    /// The groups of a folded patch that the columns of a tile are: channel q of fold f is column
    /// q G + f.
    pub fn columns<const G: usize>(&self) -> [Option<usize>; TILE] {
        std::array::from_fn(|column| Some(self.block(column % G)? * LANES / G + column / G))
    }
}
