//! Times one decision against 16 policies that look different, on two threads.
//!
//! `cargo run --release -p covers-evidence --example timed_decision`

use std::error::Error;
use std::time::{Duration, Instant};

use evidence::{Account, Accountant, Course, Look, Recogniser, RecogniserSettings};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rl::{Observations, Transition, VectorEnv};
use symmetry::Irrep;
use worlds::{Kind, Stream, Visit, World};

const POLICIES: usize = 16;
const REPETITIONS: usize = 51;
const THREADS: usize = 2;
/// Steps of an episode: what takes time is not its length.
const HORIZON: usize = 2;

type Answer<T> = Result<T, Box<dyn Error + Send + Sync>>;

fn main() -> Answer<()> {
    let threads = rayon::ThreadPoolBuilder::new().num_threads(THREADS);
    threads.build()?.install(measure)
}

fn measure() -> Answer<()> {
    let settings = RecogniserSettings::default();
    let world = World::with_groups(Kind::Appearance, 1000, POLICIES);
    let axes = [Irrep::X, Irrep::Y];
    let accountant = Accountant::new([48, 48, 6], &axes, &axes, settings.filters)?;
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let mut recogniser = Recogniser::new(settings)?;
    for group in 0..POLICIES {
        let accounts = accountant.accounts(&courses(&world, group, 0, settings.memory)?)?;
        recogniser.learn(group, &accounts, &mut rng)?;
    }
    let rollout = courses(&world, 0, 1, 20)?;
    let accounts = accountant.accounts(&rollout)?;
    let later = accountant.accounts(&courses(&world, 0, 2, 20)?)?;
    let both: Vec<Account> = [accounts.clone(), later].concat();
    let described = timed(|| accountant.accounts(&rollout).map(|_| ()))?;
    let first = timed(|| {
        recogniser
            .assign(&accounts, 0, Look::First, &mut rng)
            .map(|_| ())
    })?;
    let second = timed(|| {
        recogniser
            .assign(&both, 0, Look::Second, &mut rng)
            .map(|_| ())
    })?;
    println!("accounts of 20 episodes: {described}");
    println!("first look at 20 episodes, {POLICIES} policies: {first}");
    println!("second look at 40 episodes, {POLICIES} policies: {second}");
    Ok(())
}

/// The median and the shortest time, and the processors' time of one repetition, which other work
/// on the machine hardly changes.
fn timed<E>(mut work: impl FnMut() -> Result<(), E>) -> Result<String, E> {
    let mut times = Vec::with_capacity(REPETITIONS);
    let before = processor_time();
    for _ in 0..REPETITIONS {
        let clock = Instant::now();
        work()?;
        times.push(clock.elapsed());
    }
    times.sort_unstable();
    let used = processor_time().zip(before);
    let used = used.map_or("unknown".to_owned(), |(after, before)| {
        format!("{:.1?}", (after - before) / REPETITIONS as u32)
    });
    let (median, shortest) = (times[REPETITIONS / 2], times[0]);
    Ok(format!(
        "median {median:.1?}, shortest {shortest:.1?}, processors {used}"
    ))
}

/// What this process took of all processors so far, where Linux says it, in its ticks of 10 ms.
fn processor_time() -> Option<Duration> {
    let text = std::fs::read_to_string("/proc/self/stat").ok()?;
    let mut fields = text.rsplit_once(')')?.1.split_whitespace().skip(11);
    let user: u64 = fields.next()?.parse().ok()?;
    let system: u64 = fields.next()?.parse().ok()?;
    Some(Duration::from_millis(10 * (user + system)))
}

/// Episodes that began one after the other, with the first pictures of one round of a stream.
fn courses(world: &World, group: usize, round: usize, episodes: usize) -> Answer<Vec<Course>> {
    let visits = vec![Visit {
        group,
        rounds: round + 1,
    }];
    let stream = Stream::new(world.clone(), visits, episodes)?;
    let mut stream = stream.with_horizon(HORIZON);
    let spec = stream.spec().clone();
    let mut seen = Observations::new(&spec);
    stream.reset(&mut seen)?;
    let mut transition = Transition::new(&spec);
    for _ in 0..round * HORIZON {
        stream.step(&vec![0.0; 2 * episodes], &mut transition)?;
        seen.clone_from(&transition.observations);
    }
    let images = seen.images.chunks(spec.image_len());
    let course = |(episode, image): (usize, &[u8])| Course {
        began: 1000 * round + episode,
        image: image.to_vec(),
        vectors: vec![0.0, 0.0, 0.05 + 0.001 * episode as f32, 0.05],
        actions: vec![1.0; 4],
        rewards: vec![0.0, episode as f32],
        is_whole: true,
    };
    Ok(images.enumerate().map(course).collect())
}
