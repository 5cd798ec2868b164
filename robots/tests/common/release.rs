//! Release of MuJoCo that tests run with.

/// Returns `true` with MuJoCo 2.2.2, whose figures the tests state. MuJoCo 3 differs in contacts
/// and equalities, so some tests allow more there, or skip a case.
pub fn is_reference_release() -> bool {
    let release = mujoco::library_version();
    // no other release, nor 2.2.2 in another spelling, may loosen a test
    assert!(release == "2.2.2" || release.starts_with("3."), "{release}");
    release == "2.2.2"
}
