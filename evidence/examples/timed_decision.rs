//! Times one decision against 16 policies that look different.
//!
//! `cargo run --release -p covers-evidence --example timed_decision`

use std::error::Error;
use std::time::{Duration, Instant};

use evidence::{Account, Accountant, Course, Recogniser, RecogniserSettings};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rl::{Observations, VectorEnv};
use symmetry::Irrep;
use worlds::{Kind, Stream, Visit, World};

const POLICIES: usize = 16;
const REPETITIONS: usize = 21;

fn main() -> Result<(), Box<dyn Error + Send + Sync>> {
    let settings = RecogniserSettings::default();
    let world = World::with_groups(Kind::Appearance, 1000, POLICIES);
    let axes = [Irrep::X, Irrep::Y];
    let accountant = Accountant::new([48, 48, 6], &axes, &axes, settings.filters)?;
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let mut recogniser = Recogniser::new(settings)?;
    for group in 0..POLICIES {
        let accounts = accountant.accounts(&courses(&world, group, settings.memory)?)?;
        recogniser.learn(group, &accounts, &mut rng)?;
    }
    let rollout = courses(&world, 0, 20)?;
    let accounts = accountant.accounts(&rollout)?;
    let both: Vec<Account> = [accounts.clone(), accounts.clone()].concat();
    let described = median(|| accountant.accounts(&rollout).map(|_| ()))?;
    let first = median(|| recogniser.assign(&accounts, 0, &mut rng).map(|_| ()))?;
    let second = median(|| recogniser.settle(&both, 0, &mut rng).map(|_| ()))?;
    println!("accounts of 20 episodes: {described:.1?}");
    println!("first look at 20 episodes, {POLICIES} policies: {first:.1?}");
    println!("second look at 40 episodes, {POLICIES} policies: {second:.1?}");
    Ok(())
}

fn median<E>(mut timed: impl FnMut() -> Result<(), E>) -> Result<Duration, E> {
    let mut times = Vec::with_capacity(REPETITIONS);
    for _ in 0..REPETITIONS {
        let clock = Instant::now();
        timed()?;
        times.push(clock.elapsed());
    }
    times.sort_unstable();
    Ok(times[REPETITIONS / 2])
}

/// Episodes of two steps: what takes time is not their length.
fn courses(
    world: &World,
    group: usize,
    episodes: usize,
) -> Result<Vec<Course>, Box<dyn Error + Send + Sync>> {
    let visits = vec![Visit { group, rounds: 1 }];
    let mut stream = Stream::new(world.clone(), visits, episodes)?;
    let spec = stream.spec().clone();
    let mut seen = Observations::new(&spec);
    stream.reset(&mut seen)?;
    let images = seen.images.chunks(spec.image_len());
    let course = |(episode, image): (usize, &[u8])| Course {
        began: episode / 10,
        image: image.to_vec(),
        vectors: vec![0.0, 0.0, 0.05 + 0.001 * episode as f32, 0.05],
        actions: vec![1.0; 4],
        rewards: vec![0.0, episode as f32],
        is_whole: true,
    };
    Ok(images.enumerate().map(course).collect())
}
