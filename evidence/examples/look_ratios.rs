//! By how much pictures of groups differ, in units of what chance makes of it.
//!
//! `cargo run --release -p covers-evidence --example look_ratios -- 1000 24`
//!
//! 40 first pictures of a group are compared with 40 later ones of the same group, with those of a
//! group whose colours strayed meanwhile, and with those of another group of its world: quantiles
//! over the worlds of the seeds that are named (the first, and how many).

use cluster::{Candidate, Frames, Side, Source, joint_test};
use evidence::{Filters, RecogniserSettings};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rl::{BoxError, Observations, Transition, VectorEnv};
use worlds::{Kind, Stream, Visit, World};

const ENVS: usize = 5;
/// Rounds of a visit: 40 episodes.
const ROUNDS: usize = 8;
/// Rounds between the first pictures and later ones; after 250 of them colours are farthest.
const LATER: [usize; 3] = [60, 120, 250];
const SPLITS: usize = 100;
const SHARES: [f64; 5] = [0.01, 0.05, 0.5, 0.95, 0.99];

fn main() -> Result<(), BoxError> {
    let mut words = std::env::args().skip(1).map(|word| word.parse::<u64>());
    let first = words.next().transpose()?.unwrap_or(1000);
    let count = words.next().transpose()?.unwrap_or(24);
    let seeds = first..first + count;
    println!("| | number | 1 % | 5 % | 50 % | 95 % | 99 % |\n|---|---|---|---|---|---|---|");
    let over = |kind, of: &dyn Fn(&World) -> Result<Vec<f64>, BoxError>| {
        let ratios = seeds.clone().map(|seed| of(&World::draw(kind, seed)));
        Ok::<_, BoxError>(ratios.collect::<Result<Vec<_>, _>>()?.concat())
    };
    let same = |world: &World| same(world, LATER[1]);
    println!("{}", row("the same group", over(Kind::Appearance, &same)?));
    for later in LATER {
        let strayed = over(Kind::Drift, &|world| self::same(world, later))?;
        println!("{}", row(&format!("strayed for {later} rounds"), strayed));
    }
    println!("{}", row("another group", over(Kind::Appearance, &others)?));
    Ok(())
}

/// Each group and itself, after so many rounds.
fn same(world: &World, later: usize) -> Result<Vec<f64>, BoxError> {
    let groups = 0..world.groups.len();
    let ratios =
        groups.map(|group| ratio(&pictures(world, group, 0)?, &pictures(world, group, later)?));
    ratios.collect()
}

/// Each group and every one that comes after it.
fn others(world: &World) -> Result<Vec<f64>, BoxError> {
    let groups = 0..world.groups.len();
    let looks: Result<Vec<Frames>, BoxError> = groups.map(|g| pictures(world, g, 0)).collect();
    let looks = looks?;
    let pairs = (0..looks.len()).flat_map(|i| (0..i).map(move |j| (j, i)));
    pairs.map(|(j, i)| ratio(&looks[j], &looks[i])).collect()
}

/// Describes the first pictures of a visit that begins after so many rounds of other groups.
fn pictures(world: &World, group: usize, after: usize) -> Result<Frames, BoxError> {
    let other = (group + 1) % world.groups.len();
    let visits = [(other, after), (group, ROUNDS)].map(|(group, rounds)| Visit { group, rounds });
    let mut stream = Stream::new(world.clone(), visits.to_vec(), ENVS)?.with_horizon(1);
    let spec = stream.spec().clone();
    let filters = Filters::new(spec.image, RecogniserSettings::default().filters)?;
    let mut seen = Transition::new(&spec);
    let mut now = Observations::new(&spec);
    stream.reset(&mut now)?;
    let mut described = Vec::new();
    for round in 0..after + ROUNDS {
        if round >= after {
            for image in now.images.chunks(spec.image_len()) {
                described.extend(filters.describe(image)?);
            }
        }
        stream.step(&[0.0; 2 * ENVS], &mut seen)?;
        now.clone_from(&seen.observations);
    }
    Ok(Frames::new(described, 1, filters.dim())?)
}

fn ratio(buffer: &Frames, rollout: &Frames) -> Result<f64, BoxError> {
    let clouds = Candidate {
        buffer: buffer.clone(),
        rollout: rollout.clone(),
    };
    let side = Side::Both;
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let test = joint_test(&[Source { clouds, side }], SPLITS, &mut rng)?;
    Ok(test.sources[0].map_or(0.0, |source| source.ratio()))
}

fn row(name: &str, mut ratios: Vec<f64>) -> String {
    ratios.sort_by(f64::total_cmp);
    let last = ratios.len().saturating_sub(1) as f64;
    let quantiles = SHARES.map(|share| format!("{:.2}", ratios[(share * last).round() as usize]));
    format!("| {name} | {} | {} |", ratios.len(), quantiles.join(" | "))
}
