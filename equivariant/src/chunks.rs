//! Parallel minibatches in fixed chunks, with the same bits for any number of threads.

use std::cell::Cell;
use std::ops::Range;
use std::sync::{Mutex, PoisonError};

use rayon::prelude::*;

use crate::real::Real;

/// Maximum number of chunk gradients held in memory at once; batches may be larger.
const MAX_CHUNK_GRADIENTS: usize = 64;
/// Number of parameters whose chunk gradients one task adds up; a part of this size stays in the
/// first-level cache.
const PARAMS_PER_TASK: usize = 2048;

thread_local! {
    /// `true` while this thread runs one of several chunks of a minibatch. A chunk that panics
    /// leaves the flag set, which only costs speed.
    static RUNS_ONE_OF_MANY_CHUNKS: Cell<bool> = const { Cell::new(false) };
}

/// Returns `true` while this thread runs one of several chunks of a minibatch, in which case
/// splitting the work of one chunk over threads does not pay.
pub(crate) fn runs_one_of_many_chunks() -> bool {
    RUNS_ONE_OF_MANY_CHUNKS.get()
}

/// Engine that runs a minibatch in chunks of samples on the threads of the current rayon pool.
///
/// Every chunk writes its own gradient buffer and the buffers are added in chunk order, so the
/// result does not depend on the number of threads. Buffers and workspaces are reused: after the
/// first call the only allocation is the vector of results, which needs no memory if a chunk
/// returns `()`. A workspace (activations, scratch) belongs to one chunk at a time; the result of a
/// chunk must not depend on values that an earlier one left in it.
///
/// ```
/// use equivariant::ParallelChunks;
///
/// // the gradient of the sum of (w s)^2 / 2 over the samples s
/// let samples: Vec<f64> = (0..10).map(f64::from).collect();
/// let w = 2.0;
/// let mut chunks = ParallelChunks::new(1, 4, || ());
/// let mut gradient = [0.0];
/// let losses = chunks.accumulate_gradients(samples.len(), &mut gradient, |range, _, grad| {
///     let mut loss = 0.0;
///     for s in &samples[range] {
///         loss += (w * s).powi(2) / 2.0;
///         grad[0] += w * s * s;
///     }
///     loss
/// });
/// assert_eq!(losses.len(), 3);
/// assert_eq!(losses.iter().sum::<f64>(), 570.0);
/// assert_eq!(gradient, [570.0]);
/// ```
pub struct ParallelChunks<T, W> {
    num_params: usize,
    chunk_size: usize,
    new_workspace: Box<dyn Fn() -> W + Send + Sync>,
    workspaces: Mutex<Vec<W>>,
    /// Gradients of up to [`MAX_CHUNK_GRADIENTS`] chunks, one after another.
    gradients: Vec<T>,
}

impl<T: Real, W: Send> ParallelChunks<T, W> {
    /// Creates an engine for gradients of `num_params` parameters and chunks of `chunk_size`
    /// samples.
    ///
    /// `new_workspace` is called once for each thread of the pool, or for each chunk if there are
    /// fewer.
    ///
    /// # Panics
    /// When `chunk_size` is 0.
    pub fn new(
        num_params: usize,
        chunk_size: usize,
        new_workspace: impl Fn() -> W + Send + Sync + 'static,
    ) -> ParallelChunks<T, W> {
        assert!(chunk_size > 0, "got a chunk size of 0, expected at least 1");
        ParallelChunks {
            num_params,
            chunk_size,
            new_workspace: Box::new(new_workspace),
            workspaces: Mutex::new(Vec::new()),
            gradients: Vec::new(),
        }
    }

    /// Adds the gradients of all chunks of the samples `0..num_samples` to `gradient`
    /// `[num_params]`, and returns the results of `f` for the chunks, in order.
    ///
    /// `f(samples, workspace, chunk_gradient)` adds the gradient of its samples to
    /// `chunk_gradient`, which starts at zero. Returns what `f` returned, in chunk order.
    ///
    /// # Panics
    /// When `gradient` does not hold `num_params` values, or there are no parameters.
    pub fn accumulate_gradients<S: Send>(
        &mut self,
        num_samples: usize,
        gradient: &mut [T],
        f: impl Fn(Range<usize>, &mut W, &mut [T]) -> S + Sync,
    ) -> Vec<S> {
        let all = |chunks| 0..chunks;
        self.accumulate_gradients_across_processes(
            num_samples,
            gradient,
            all,
            |_, results| results,
            f,
        )
    }

    /// Adds the gradients of all chunks of the samples `0..num_samples` to `gradient`, but computes
    /// only a share of them; others come from elsewhere, such as another process.
    ///
    /// A call processes up to 64 chunks at a time. Of C chunks, it computes those that `share(C)`
    /// returns. `complete(gradients, results)` gets the results of the share and the gradients
    /// `[C, num_params]`, writes those outside the share, and returns the results of all C chunks.
    ///
    /// # Panics
    /// As [`ParallelChunks::accumulate_gradients`], and for a share outside of `0..C`.
    pub fn accumulate_gradients_across_processes<S: Send>(
        &mut self,
        num_samples: usize,
        gradient: &mut [T],
        share: impl Fn(usize) -> Range<usize>,
        complete: impl Fn(&mut [T], Vec<S>) -> Vec<S>,
        f: impl Fn(Range<usize>, &mut W, &mut [T]) -> S + Sync,
    ) -> Vec<S> {
        assert_eq!(gradient.len(), self.num_params, "wrong number of parameters");
        assert!(self.num_params > 0, "there are no parameters, and so no gradient");
        let (count, width) = (self.prepare(num_samples), self.num_params);
        let mut buffers = std::mem::take(&mut self.gradients);
        buffers.resize(buffers.len().max(count.min(MAX_CHUNK_GRADIENTS) * width), T::ZERO);
        let mut results = Vec::with_capacity(count);
        // waves bound the memory of gradients, and adding one after another keeps the chunks' order
        for first in (0..count).step_by(MAX_CHUNK_GRADIENTS) {
            let wave = count.min(first + MAX_CHUNK_GRADIENTS) - first;
            let (own, buffers) = (share(wave), &mut buffers[..wave * width]);
            let run_chunk = |(chunk, buffer): (usize, &mut [T])| {
                buffer.fill(T::ZERO);
                let range = self.range(first + chunk, num_samples);
                self.run(count, |workspace| f(range, workspace, buffer))
            };
            let own_buffers = &mut buffers[own.start * width..own.end * width];
            let chunks = own.into_par_iter().zip(own_buffers.par_chunks_mut(width));
            let own_results = chunks.map(run_chunk).collect();
            results.extend(complete(buffers, own_results));
            add_gradients_in_order(gradient, buffers);
        }
        self.gradients = buffers;
        results
    }

    /// Runs `f(samples, workspace, rows)` on every chunk, where `rows` are the chunk's rows of
    /// `out`, and returns the results in chunk order.
    ///
    /// `out` holds `width` values per sample. Inference returns a network's outputs this way.
    ///
    /// # Panics
    /// When the length of `out` is not a multiple of `width`, or `width` is 0.
    pub fn map_rows<V: Send, S: Send>(
        &self,
        out: &mut [V],
        width: usize,
        f: impl Fn(Range<usize>, &mut W, &mut [V]) -> S + Sync,
    ) -> Vec<S> {
        assert!(
            width > 0 && out.len().is_multiple_of(width),
            "got {} values, expected a multiple of the width {width}",
            out.len()
        );
        let num_samples = out.len() / width;
        let range = |chunk| self.range(chunk, num_samples);
        let count = self.prepare(num_samples);
        (0..count)
            .into_par_iter()
            .zip(out.par_chunks_mut(width * self.chunk_size))
            .map(|(chunk, rows)| self.run(count, |workspace| f(range(chunk), workspace, rows)))
            .collect()
    }

    /// Creates the workspaces that `num_samples` samples can use and returns the number of chunks.
    fn prepare(&self, num_samples: usize) -> usize {
        let chunks = num_samples.div_ceil(self.chunk_size);
        let mut idle = self.lock();
        while idle.len() < chunks.min(rayon::current_num_threads()) {
            idle.push((self.new_workspace)());
        }
        chunks
    }

    /// Returns the range of the samples of chunk `chunk`.
    fn range(&self, chunk: usize, num_samples: usize) -> Range<usize> {
        let start = chunk * self.chunk_size;
        start..num_samples.min(start + self.chunk_size)
    }

    /// Runs `f` on one of `count` chunks with a free workspace.
    fn run<S>(&self, count: usize, f: impl FnOnce(&mut W) -> S) -> S {
        let idle = self.lock().pop();
        let mut workspace = idle.unwrap_or_else(|| (self.new_workspace)());
        // chunks may run inside a chunk of another engine, whose flag comes back afterwards
        let outer = RUNS_ONE_OF_MANY_CHUNKS.replace(count > 1);
        let result = f(&mut workspace);
        RUNS_ONE_OF_MANY_CHUNKS.set(outer);
        self.lock().push(workspace);
        result
    }

    fn lock(&self) -> std::sync::MutexGuard<'_, Vec<W>> {
        // the list stays consistent if a chunk panics: only its workspace is lost
        self.workspaces.lock().unwrap_or_else(PoisonError::into_inner)
    }
}

/// Adds the chunk gradients `buffers`, one after another, to `sum`, entry by entry and in their
/// order.
fn add_gradients_in_order<T: Real>(sum: &mut [T], buffers: &[T]) {
    let width = sum.len().max(1);
    // Parallel over parameters, sequential over buffers: every sum has the order of the chunks.
    let pieces = sum.par_chunks_mut(PARAMS_PER_TASK).enumerate();
    pieces.for_each(|(i, piece)| {
        for buffer in buffers.chunks_exact(width) {
            for (total, &value) in piece.iter_mut().zip(&buffer[i * PARAMS_PER_TASK..]) {
                *total += value;
            }
        }
    });
}
