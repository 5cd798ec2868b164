//! Ranks: processes that compute one run together, each a share of the work.

use std::fmt;
use std::ops::Range;
use std::sync::Arc;

use bytemuck::{Pod, cast_slice, cast_slice_mut};
use equivariant::ParallelChunks;

/// Exchange of bytes between the processes that compute one run, such as MPI's world.
pub trait ProcessCommunicator: Send + Sync {
    /// Returns the index of this process among all, from 0.
    fn rank(&self) -> usize;

    /// Returns the number of processes.
    fn size(&self) -> usize;

    /// Sends `own` to all processes; returns what each of them sent, in the order of ranks. The
    /// call returns once every process has made it.
    fn all_gather(&self, own: &[u8]) -> Vec<u8>;
}

/// Processes (ranks) that compute one run together; one process alone by default.
///
/// Every rank executes the whole program from the same seeds, so all have the same state. They
/// share only what takes long, steps of environments and gradients: each computes a contiguous
/// share and receives the rest. So results have the bits of one process. Ranks are no part of
/// settings: all compare as equal.
#[derive(Clone, Default)]
pub struct ProcessRanks(Option<Arc<dyn ProcessCommunicator>>);

impl ProcessRanks {
    /// Creates the ranks, the processes of one run, that `communicator` connects.
    pub fn new(communicator: Arc<dyn ProcessCommunicator>) -> Self {
        Self(Some(communicator))
    }

    /// Returns the index of this process, and the number of processes.
    fn rank_and_size(&self) -> (usize, usize) {
        self.0.as_ref().map_or((0, 1), |all| (all.rank(), all.size()))
    }

    /// Returns `true` on rank 0, which alone writes files and prints.
    pub fn is_first(&self) -> bool {
        self.rank_and_size().0 == 0
    }

    /// Returns the range of this process's share of `count` items; share sizes differ by at most
    /// one.
    pub fn local_range(&self, count: usize) -> Range<usize> {
        let (rank, size) = self.rank_and_size();
        rank * count / size..(rank + 1) * count / size
    }

    /// Completes an array of `count` rows, of which this process computed those of its share, with
    /// the rows that the other processes computed.
    ///
    /// # Panics
    /// If `rows` cannot be divided into `count` rows, or ranks call it with different arrays.
    pub fn all_gather_rows<T: Pod>(&self, count: usize, rows: &mut [T]) {
        let Some(all) = &self.0 else { return };
        assert!(rows.len().is_multiple_of(count.max(1)), "{} values, {count} rows", rows.len());
        let (width, own) = (rows.len() / count.max(1), self.local_range(count));
        let gathered = all.all_gather(cast_slice(&rows[own.start * width..own.end * width]));
        cast_slice_mut(rows).copy_from_slice(&gathered);
    }

    /// Sends the number `own` to all processes; returns the numbers of all in the order of ranks.
    pub fn all_gather_numbers(&self, own: u64) -> Vec<u64> {
        let (rank, size) = self.rank_and_size();
        let mut numbers = vec![0; size];
        numbers[rank] = own;
        self.all_gather_rows(size, &mut numbers);
        numbers
    }

    /// Adds the gradients of all chunks of a batch to `gradient`, each process computing its share
    /// of the chunks by `f`, and returns the results of `f` in chunk order
    /// ([`ParallelChunks::accumulate_gradients`]).
    pub(crate) fn accumulate_gradients<W: Send, const K: usize>(
        &self,
        chunks: &mut ParallelChunks<f32, W>,
        num_samples: usize,
        gradient: &mut [f32],
        f: impl Fn(Range<usize>, &mut W, &mut [f32]) -> [f64; K] + Sync,
    ) -> Vec<[f64; K]> {
        let num_params = gradient.len().max(1);
        let complete = |gradients: &mut [f32], own: Vec<[f64; K]>| {
            let count = gradients.len() / num_params;
            self.all_gather_rows(count, gradients);
            let mut results = vec![[0.0; K]; count];
            results[self.local_range(count)].copy_from_slice(&own);
            self.all_gather_rows(count, results.as_flattened_mut());
            results
        };
        let share = |count| self.local_range(count);
        chunks.accumulate_gradients_across_processes(num_samples, gradient, share, complete, f)
    }
}

impl PartialEq for ProcessRanks {
    fn eq(&self, _: &Self) -> bool {
        true
    }
}

impl fmt::Debug for ProcessRanks {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (rank, size) = self.rank_and_size();
        write!(f, "rank {rank} of {size}")
    }
}
