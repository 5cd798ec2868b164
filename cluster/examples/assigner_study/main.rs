//! Error rates of the assigner's rule and of rules it was chosen over, on synthetic episodes.
//!
//! `cargo run --release -p covers-cluster --example assigner_study`

mod population;
mod rules;

use cluster::{Calibrated, ClusterError};
use population::Scenario;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use rules::{Answer, NAMES, answers};

/// The first one is what a stream of tasks looks like to the learner: one frame an episode.
const SCENARIOS: [(Scenario, usize); 6] = {
    let main = Scenario {
        name: "one frame an episode",
        frames: 1,
        drift: 0.0,
        apart: 1.0,
        clusters: 1,
        rollouts: (1, 5),
    };
    [
        (main, 10_000),
        (
            Scenario {
                name: "drift",
                drift: 0.2,
                ..main
            },
            2_000,
        ),
        (
            Scenario {
                name: "close groups",
                apart: 0.7,
                ..main
            },
            2_000,
        ),
        (
            Scenario {
                name: "four clusters",
                clusters: 4,
                ..main
            },
            2_000,
        ),
        (
            Scenario {
                name: "one rollout in the buffer",
                rollouts: (1, 1),
                ..main
            },
            2_000,
        ),
        (
            Scenario {
                name: "four frames an episode",
                frames: 4,
                ..main
            },
            200,
        ),
    ]
};

fn main() -> Result<(), ClusterError> {
    let settings = Calibrated::default();
    println!(
        "nominal: second looks {} and false alarms at most {} of known groups",
        settings.doubt, settings.level
    );
    for (scenario, decisions) in &SCENARIOS {
        print_rates(scenario, *decisions)?;
    }
    Ok(())
}

fn print_rates(scenario: &Scenario, decisions: usize) -> Result<(), ClusterError> {
    let same = decide(scenario, true, decisions)?;
    let other = decide(scenario, false, decisions)?;
    println!("\n{}: {decisions} decisions each", scenario.name);
    println!(
        "{:38} {:>12} {:>12} {:>8} {:>8}",
        "rule", "false alarms", "misses", "known", "new"
    );
    for (rule, name) in NAMES.iter().enumerate() {
        let count = |all: &[[Answer; 8]], what: fn(&Answer) -> bool| {
            all.iter().filter(|answers| what(&answers[rule])).count()
        };
        println!(
            "{name:38} {:>12} {:>12} {:>8} {:>8}",
            count(&same, |a| a.refused),
            count(&other, |a| !a.refused),
            count(&same, |a| a.looked_twice),
            count(&other, |a| a.looked_twice),
        );
    }
    Ok(())
}

/// Each decision has a random stream of its own, so that threads do not matter.
fn decide(
    scenario: &Scenario,
    same: bool,
    decisions: usize,
) -> Result<Vec<[Answer; 8]>, ClusterError> {
    let one = |index: usize| {
        let mut rng = ChaCha8Rng::seed_from_u64(u64::from(same));
        rng.set_stream(index as u64);
        answers(&scenario.draw(same, &mut rng)?, &mut rng)
    };
    (0..decisions).into_par_iter().map(one).collect()
}
