//! Uniformity, bounds and restoration of the reservoir.

use cluster::{ClusterError, Reservoir};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

const CAPACITY: usize = 5;
const STREAM: usize = 40;

fn filled(rng: &mut ChaCha8Rng) -> Reservoir<usize> {
    let mut reservoir = Reservoir::new(CAPACITY).expect("a positive capacity");
    for episode in 0..STREAM {
        reservoir.offer(episode, rng);
    }
    reservoir
}

#[test]
fn each_episode_is_kept_equally_often() {
    let runs = 8000;
    let mut rng = ChaCha8Rng::seed_from_u64(1);
    let mut kept = [0u32; STREAM];
    for _ in 0..runs {
        filled(&mut rng).episodes().iter().for_each(|&episode| kept[episode] += 1);
    }
    let share = CAPACITY as f64 / STREAM as f64;
    let expected = f64::from(runs) * share;
    let deviation =
        |&count: &u32| (f64::from(count) - expected).powi(2) / (expected * (1.0 - share));
    // about chi-squared with 39 degrees of freedom: mean 39, sd 8.8
    let statistic: f64 = kept.iter().map(deviation).sum();
    assert!((15.0..75.0).contains(&statistic), "{statistic}: {kept:?}");
}

#[test]
fn holds_every_episode_while_there_is_room() {
    let mut rng = ChaCha8Rng::seed_from_u64(2);
    let mut reservoir = Reservoir::new(3).unwrap();
    assert!((0..3).all(|episode| reservoir.offer(episode, &mut rng).is_none()));
    assert_eq!(
        (reservoir.episodes(), reservoir.seen(), reservoir.capacity()),
        (&[0, 1, 2][..], 3, 3)
    );
}

#[test]
fn each_episode_is_held_or_returned() {
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    let mut reservoir = Reservoir::new(4).unwrap();
    let mut all: Vec<u32> =
        (0..100).filter_map(|episode| reservoir.offer(episode, &mut rng)).collect();
    all.extend(reservoir.episodes());
    all.sort_unstable();
    assert_eq!(all, (0..100).collect::<Vec<_>>());
}

#[test]
fn a_restored_reservoir_goes_on_alike() {
    // saved while empty, while there is room, when it is just full, and long after
    for saved_at in [0, 3, CAPACITY, STREAM] {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let mut original = Reservoir::new(CAPACITY).unwrap();
        for episode in 0..saved_at {
            original.offer(episode, &mut rng);
        }
        let (capacity, seen) = (original.capacity(), original.seen());
        let mut restored =
            Reservoir::from_parts(capacity, seen, original.episodes().to_vec()).unwrap();
        let mut other = rng.clone();
        for episode in saved_at..4 * STREAM {
            assert_eq!(original.offer(episode, &mut rng), restored.offer(episode, &mut other));
        }
        assert_eq!(original, restored);
    }
}

#[test]
fn impossible_parts_are_refused() {
    let zero = Reservoir::<u8>::new(0).unwrap_err().to_string();
    assert_eq!(zero, "capacity is 0: expected at least 1");
    for (seen, held) in [(0, 1), (2, 1), (9, 2), (9, 4)] {
        let error = Reservoir::from_parts(3, seen, vec![0u8; held]).unwrap_err();
        assert_eq!(error, ClusterError::ReservoirParts { capacity: 3, seen, held });
    }
}
