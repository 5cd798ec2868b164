//! Solves random hostile inputs and holds every answer to its certificate and, where there is one,
//! to an oracle.

use std::panic::catch_unwind;

use crate::fuzz_case as case;
use crate::oracle;

/// `COVERS_INPUTS` asks for more inputs.
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

#[test]
fn the_verdicts_can_be_wrong() {
    let plan = cluster::TransportPlan::default();
    let malformed = cluster::ClusterError::Empty { what: "x" };
    let imprecise = cluster::ClusterError::Imprecise { cost: 1.0, excess: 0.1, tolerance: 1e-9 };
    for hard in [false, true] {
        assert_eq!(case::expected(true, hard, Ok(&plan)), Ok(Ok(&plan)));
        let refused = case::expected(false, hard, Err(malformed.clone()));
        assert_eq!(refused, Ok(Err(case::Outcome::Refused)));
        assert!(case::expected(false, hard, Ok(&plan)).is_err());
        assert!(case::expected(true, hard, Err(malformed.clone())).is_err());
    }
    let open = case::expected(true, true, Err(imprecise.clone()));
    assert_eq!(open, Ok(Err(case::Outcome::Imprecise)));
    assert!(case::expected(true, false, Err(imprecise)).is_err());
    assert!(case::agree(1.0, Some(1.0), 1e-12).is_ok());
    assert!(case::agree(1.0, Some(1.001), 1e-12).is_err());
    assert!(case::agree(f64::NAN, Some(1.0), 1e-12).is_err());
}

#[test]
fn the_oracles_agree_with_one_another() {
    let cost = [9.0, 2.0, 5.0, 4.0, 1.0, 7.0];
    // source 1 serves sink 1 and a part of sink 2, source 0 the rest; worked by hand
    let (a, b) = ([0.5, 0.5], [0.25, 0.25, 0.5]);
    let value = 0.5 * 5.0 + 0.25 * 4.0 + 0.25 * 1.0;
    assert_eq!(oracle::transport(&cost, &a, &b), Some(value));
    let transposed = [9.0, 4.0, 2.0, 1.0, 5.0, 7.0];
    assert_eq!(oracle::transport(&transposed, &b, &a), Some(value));
    // two points of weight a half each are four of a quarter
    let doubled: Vec<f64> = (0..16).map(|k| [9.0, 2.0, 4.0, 1.0][k / 8 * 2 + k % 4 / 2]).collect();
    let quarters = [0.25; 4];
    assert_eq!(oracle::transport(&doubled, &quarters, &quarters), Some(3.0));
    assert_eq!(oracle::transport(&[9.0, 2.0, 4.0, 1.0], &a, &[0.5, 0.5]), Some(3.0));
    assert_eq!(oracle::transport(&[0.0; 81], &[1.0 / 9.0; 9], &[1.0 / 9.0; 9]), None);
}
