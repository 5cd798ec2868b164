//! Steps must allocate nothing in the steady state, on any thread, not even at the end of episodes.
//!
//! This is the only test of its binary, since the allocator counts for the whole process. It counts
//! Rust's allocations, not those of MuJoCo and OpenGL.

#![allow(clippy::unwrap_used, reason = "a test")]

use std::alloc::System;
use std::hint::black_box;

use envs::{
    ACTION_DIM, Camera, ControlSettings, ExtraViews, StepBuffers, TaskGroup, VecEnv,
    VecEnvSettings, VisualDomainRandomisation,
};
use stats_alloc::{INSTRUMENTED_SYSTEM, Region, StatsAlloc};
use symmetry::D2;

#[global_allocator]
static ALLOCATOR: &StatsAlloc<System> = &INSTRUMENTED_SYSTEM;

const N: usize = 3;
/// Allocations that three threads and their four channels may make once.
const ONCE: usize = 8;

fn allocations(run: impl FnOnce()) -> usize {
    let region = Region::new(ALLOCATOR);
    run();
    region.change().allocations + region.change().reallocations
}

#[test]
fn steps_and_automatic_resets_allocate_nothing_and_the_counter_counts() {
    let settings = VecEnvSettings {
        num_envs: N,
        threads: 2,
        control: ControlSettings { horizon: 30, ..ControlSettings::default() },
        ..VecEnvSettings::default()
    };
    // randomised pictures start from perfect ones, so this covers both
    steps_allocate_nothing(VecEnvSettings {
        randomisation: Some(VisualDomainRandomisation::NOMINAL),
        ..settings
    });
    steps_allocate_nothing(VecEnvSettings {
        camera: Camera {
            oversampling: 3,
            extra_views: ExtraViews::FirstAndCloseUp,
            ..settings.camera
        },
        ..settings
    });
    let counted = allocations(|| (0..200).for_each(|_| drop(black_box(vec![0; 3]))));
    assert!(counted >= 200);
}

fn steps_allocate_nothing(settings: VecEnvSettings) {
    let mut env = VecEnv::new(settings, TaskGroup::PLATE_SLIDE, &D2::ALL).unwrap();
    let mut batch = StepBuffers::new(&settings);
    env.reset(batch.observations_mut()).unwrap();
    let mut ends = 0;
    let mut steps = |n| {
        for _ in 0..n {
            env.step(&[0.3; N * ACTION_DIM], batch.step_results_mut()).unwrap();
            ends += usize::from(batch.truncated[0]);
        }
    };
    steps(4);
    let allocated = allocations(|| steps(200));
    // a thread allocates when it first waits in a channel, which may come late but not in each step
    assert!(allocated <= ONCE, "{allocated} allocations");
    assert_eq!(ends, 68);
}
