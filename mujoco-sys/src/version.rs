//! Text of a release, also for the build script.

/// Returns a release as text, for instance `2.2.2` for 222 and `3.17.0` for 3017000, as
/// `mj_version()` counts them.
pub fn release_name(version: i32) -> String {
    let base = if version < 100_000 { 10 } else { 1000 };
    format!("{}.{}.{}", version / (base * base), version / base % base, version % base)
}

#[test]
fn releases_are_written_with_points() {
    for (number, text) in [(222, "2.2.2"), (327, "3.2.7"), (3_017_000, "3.17.0")] {
        assert_eq!(release_name(number), text);
    }
}
