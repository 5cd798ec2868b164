//! The study of `examples/assigner_study` with fewer decisions.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::population::MAIN;
use crate::rules;

fn stream(seed: u64, index: u64) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(index);
    rng
}

#[test]
fn a_known_group_opens_no_policy_and_seldom_asks_for_a_second_rollout() {
    let mut twice = 0;
    for index in 0..300 {
        let mut rng = stream(1, index);
        let answer = rules::default(&MAIN.draw(true, &mut rng).unwrap(), &mut rng).unwrap();
        assert!(!answer.refused, "decision {index}");
        twice += usize::from(answer.looked_twice);
    }
    // 6 expected, with a standard deviation of 2.4
    assert!((1..=16).contains(&twice), "{twice} second looks");
}

#[test]
fn the_default_misses_no_more_new_groups_than_any_other_rule() {
    let mut misses = [0; 8];
    for index in 0..60 {
        let mut rng = stream(0, index);
        let case = MAIN.draw(false, &mut rng).unwrap();
        let answers = rules::answers(&case, &mut rng).unwrap();
        for (count, answer) in misses.iter_mut().zip(answers) {
            *count += usize::from(!answer.refused);
        }
    }
    let (default, others) = misses.split_last().unwrap();
    assert!(*default <= 3, "{misses:?}");
    assert!(others.iter().all(|other| default <= other), "{misses:?}");
    // the harder rules do miss groups: the scenario can tell rules apart
    assert!(misses[0] > 10, "{misses:?}");
}
