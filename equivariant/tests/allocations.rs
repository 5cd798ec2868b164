//! In the steady state nothing is allocated, on any thread.
//!
//! A program of its own, because the allocator counts for the whole process and the thread of a
//! test harness allocates, too.

#![allow(clippy::unwrap_used, reason = "a test")]

mod common;

use std::alloc::System;
use std::hint::black_box;

use common::{network, normal, params};
use equivariant::{Group, Layer, LayerSignature, ParallelChunks, Scratch, Sequential};
use stats_alloc::{INSTRUMENTED_SYSTEM, Region, StatsAlloc};

#[global_allocator]
static ALLOCATOR: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

const SAMPLES: usize = 40;
const CHUNK: usize = 4;

/// Returns the number of allocations of ten runs, after two runs that are not counted.
fn allocations(mut run: impl FnMut()) -> usize {
    (0..2).for_each(|_| run());
    let region = Region::new(ALLOCATOR);
    (0..10).for_each(|_| run());
    region.change().allocations + region.change().reallocations
}

fn check(net: &Sequential<f32>) {
    let params = params(net, 1);
    let (in_len, out_len) = (net.in_shape().len(), net.out_shape().len());
    let x = normal::<f32>(SAMPLES * in_len, 2);
    let (mut gradient, mut y) = (vec![0.0; params.len()], vec![0.0; SAMPLES * out_len]);
    let scratch = net.allocate_scratch(CHUNK);
    let of_chunk = scratch.clone();
    let mut chunks: ParallelChunks<f32, (Vec<f32>, Scratch<f32>)> =
        ParallelChunks::new(params.len(), CHUNK, move || {
            (vec![0.0; CHUNK * out_len], of_chunk.clone())
        });
    // the matrix products of `Linear` keep buffers per thread, so every thread must have run once
    rayon::broadcast(|_| {
        let (mut chunk_y, mut chunk_gradient) =
            (vec![0.0; CHUNK * out_len], vec![0.0; params.len()]);
        let (mut scratch, x) = (scratch.clone(), &x[..CHUNK * in_len]);
        net.forward(&params, x, &mut chunk_y, &mut scratch);
        let dy = chunk_y.clone();
        net.backward(&params, x, &chunk_y, &dy, None, &mut chunk_gradient, &mut scratch);
    });
    let training = allocations(|| {
        chunks.accumulate_gradients(
            SAMPLES,
            &mut gradient,
            |range, (chunk_y, chunk_scratch), gradient| {
                let x = &x[range.start * in_len..range.end * in_len];
                let chunk_y = &mut chunk_y[..range.len() * out_len];
                net.forward(&params, x, chunk_y, chunk_scratch);
                net.backward(&params, x, chunk_y, chunk_y, None, gradient, chunk_scratch);
            },
        );
    });
    assert_eq!(training, 0, "{net}");
    let inference = allocations(|| {
        chunks.map_rows(&mut y, out_len, |range, (_, chunk_scratch), y| {
            let x = &x[range.start * in_len..range.end * in_len];
            net.forward(&params, x, y, chunk_scratch);
        });
    });
    assert_eq!(inference, 0, "{net}");
}

fn main() {
    let pool = rayon::ThreadPoolBuilder::new().num_threads(2).build().unwrap();
    // inside the pool, because submitting work from outside allocates now and then
    pool.install(|| {
        for group in Group::ALL {
            check(&network(group));
        }
    });
    assert!(allocations(|| drop(black_box(vec![0; 3]))) >= 10);
}
