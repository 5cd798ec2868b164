//! Solves random hostile inputs and holds every answer to its certificate and, where there is one,
//! to an oracle.

use std::panic::catch_unwind;

use crate::fuzz_case as case;

#[test]
fn hostile_inputs_get_the_verdict_they_deserve() {
    let inputs = std::env::var("COVERS_INPUTS").map_or(20_000, |inputs| inputs.parse().unwrap());
    let mut counts = [0; 4];
    for seed in 0..inputs {
        let outcome = catch_unwind(|| case::run(seed)).unwrap_or(Err("panicked".to_owned()));
        counts[outcome.unwrap_or_else(|wrong| panic!("input {seed}: {wrong}")) as usize] += 1;
    }
    let [solved @ .., imprecise] = counts;
    // each kind of verdict is met often, so none of the three is vacuous
    assert!(solved.iter().all(|&count| 20 * count > inputs), "{counts:?}");
    // a refusal for want of precision is rare even among these
    assert!(imprecise > 0 && 100 * imprecise < inputs, "{counts:?}");
}
