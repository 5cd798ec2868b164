//! A short run of the fuzz example.

#[path = "../examples/fuzz/case.rs"]
mod case;
#[path = "../examples/fuzz/oracle.rs"]
mod oracle;

#[test]
fn twenty_thousand_hostile_inputs_get_the_verdict_they_deserve() {
    let mut workspaces = case::Workspaces::default();
    let mut counts = [0; 3];
    for seed in 0..20_000 {
        let outcome = case::run(seed, &mut workspaces);
        counts[outcome.unwrap_or_else(|wrong| panic!("input {seed}: {wrong}")) as usize] += 1;
    }
    // each kind of verdict is met often, so none of the three is vacuous
    assert!(counts.iter().all(|count| *count > 1000), "{counts:?}");
}
