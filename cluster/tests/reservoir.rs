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
fn a_restored_reservoir_goes_on_alike() {
    // saved while empty, while there is room, when it is just full, and long after
    for saved_at in [0, 3, CAPACITY, STREAM] {
        let mut rng = ChaCha8Rng::seed_from_u64(4);
        let mut original = Reservoir::new(CAPACITY).unwrap();
        (0..saved_at).for_each(|episode| original.offer(episode, &mut rng));
        let all: Vec<usize> = (0..saved_at).collect();
        assert!(original.episodes() == all || saved_at > CAPACITY, "there is room for all");
        let (capacity, seen) = (original.capacity(), original.num_offered());
        let mut restored =
            Reservoir::from_parts(capacity, seen, original.episodes().to_vec()).unwrap();
        let mut other = rng.clone();
        for episode in saved_at..4 * STREAM {
            original.offer(episode, &mut rng);
            restored.offer(episode, &mut other);
            assert_eq!(original, restored);
        }
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
