//! Study of the error rates of the assigner's rule and of alternatives, on synthetic episodes.
//!
//! `cargo run --release -p covers-benches --example assigner_study`

mod population;
mod rules;

use cluster::{Calibrated, ClusterError};
use population::{MAIN, Scenario};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use rules::{Answer, NAMES, answers, p_values};

/// Number of tests whose p-values are compared with their levels.
const LEVEL_TESTS: usize = 10_000;

/// Scenarios, each with its number of decisions about known groups; as many are about new ones.
const SCENARIOS: [(&str, Scenario, usize); 6] = [
    ("one frame an episode", MAIN, 10_000),
    ("drift", Scenario { drift: 0.2, ..MAIN }, 2_000),
    ("close groups", Scenario { apart: 0.7, ..MAIN }, 2_000),
    ("four clusters", Scenario { clusters: 4, ..MAIN }, 2_000),
    ("one rollout in the buffer", Scenario { rollouts: (1, 1), ..MAIN }, 2_000),
    ("four frames an episode", Scenario { frames: 4, ..MAIN }, 200),
];

fn main() -> Result<(), ClusterError> {
    let settings = Calibrated::default();
    println!(
        "nominal: second looks {} and false alarms at most {} of known groups",
        settings.doubt, settings.level
    );
    print_levels("one cluster", &MAIN)?;
    print_levels("four clusters", &Scenario { clusters: 4, ..MAIN })?;
    for (name, scenario, decisions) in &SCENARIOS {
        print_rates(name, scenario, *decisions)?;
    }
    Ok(())
}

/// Prints the shares of tests of known groups whose p-values are at most a level.
fn print_levels(title: &str, scenario: &Scenario) -> Result<(), ClusterError> {
    let one = |index: usize| {
        let mut rng = stream(2, index as u64);
        p_values(&scenario.draw(true, &mut rng)?, &mut rng)
    };
    let values: Result<Vec<_>, _> = (0..LEVEL_TESTS).into_par_iter().map(one).collect();
    let values = values?;
    println!("\n{title}: {LEVEL_TESTS} tests of known groups\nlevel    exact p   fitted p");
    for level in [0.1, 0.02, 0.01, 0.001, 0.0001] {
        let rate = |which: usize| {
            let below = values.iter().filter(|p| p[which] <= level).count();
            below as f64 / LEVEL_TESTS as f64
        };
        println!("{level:<8} {:.5}   {:.5}", rate(0), rate(1));
    }
    Ok(())
}

fn print_rates(title: &str, scenario: &Scenario, decisions: usize) -> Result<(), ClusterError> {
    let same = decide(scenario, true, decisions)?;
    let other = decide(scenario, false, decisions)?;
    println!("\n{title}: {decisions} decisions each");
    println!(
        "{:38} {:>12} {:>12} {:>9} {:>8}",
        "rule", "false alarms", "misses", "2nd known", "2nd new"
    );
    for (rule, name) in NAMES.iter().enumerate() {
        let count = |all: &[[Answer; 8]], what: fn(&Answer) -> bool| {
            all.iter().filter(|answers| what(&answers[rule])).count()
        };
        println!(
            "{name:38} {:>12} {:>12} {:>9} {:>8}",
            count(&same, |a| a.refused),
            count(&other, |a| !a.refused),
            count(&same, |a| a.looked_twice),
            count(&other, |a| a.looked_twice),
        );
    }
    Ok(())
}

/// Returns the answers of all rules to many cases. Each case has a random stream of its own, so the
/// number of threads does not matter.
fn decide(
    scenario: &Scenario,
    same: bool,
    decisions: usize,
) -> Result<Vec<[Answer; 8]>, ClusterError> {
    let one = |index: usize| {
        let mut rng = stream(u64::from(same), index as u64);
        answers(&scenario.draw(same, &mut rng)?, &mut rng)
    };
    (0..decisions).into_par_iter().map(one).collect()
}

fn stream(seed: u64, index: u64) -> ChaCha8Rng {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    rng.set_stream(index);
    rng
}

#[cfg(test)]
mod tests {
    #![allow(clippy::unwrap_used)]

    use super::*;

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
}
