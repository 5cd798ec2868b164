//! Damaged files: none causes a panic, and accepted ones are valid robots.

use mujoco::Model;
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use robots::{JointServoSettings, MjcfSettings, RobotDescription, gen3};

use crate::SIX_JOINT;

/// Numbers, names and words that files should not hold, or not in every place.
const VALUES: [&str; 16] = [
    "nan",
    "inf",
    "-1",
    "0",
    "1e308",
    "1e-308",
    "",
    "0 0",
    "0 0 1e7",
    "world",
    "column",
    "swing",
    "fixed",
    "continuous",
    "1e-7",
    "&lt;&quot;&amp;",
];

/// Damages a file in one of several ways.
fn damage(text: &str, generator: &mut ChaCha8Rng) -> String {
    let lines: Vec<&str> = text.lines().collect();
    let mut any = || generator.random_range(0..lines.len());
    let (first, second) = (any(), any());
    let mut changed: Vec<String> = lines.iter().map(|line| (*line).to_owned()).collect();
    match generator.random_range(0..5) {
        0 => changed.swap(first, second),
        1 => changed.insert(first, lines[second].to_owned()),
        2 => drop(changed.drain(first.min(second)..first.max(second).min(first.min(second) + 4))),
        3 => changed[first] = changed[first].replacen(['<', '"', '/', '='], "", 1),
        _ => {
            let values: Vec<usize> =
                text.match_indices("=\"").map(|(index, _)| index + 2).collect();
            let start = values[generator.random_range(0..values.len())];
            let end = start + text[start..].find('"').unwrap_or(0);
            let value = VALUES[generator.random_range(0..VALUES.len())];
            return format!("{}{value}{}", &text[..start], &text[end..]);
        }
    }
    changed.join("\n")
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 400,
        failure_persistence: None,
        ..ProptestConfig::default()
    })]

    /// A damaged file is rejected, or describes a valid robot: its frames are finite, and MuJoCo
    /// loads its MJCF, if it can have one.
    #[test]
    fn no_damaged_file_is_a_panic(seed in any::<u64>(), ours: bool, times in 1..4_usize) {
        let mut generator = ChaCha8Rng::seed_from_u64(seed);
        let whole = if ours { SIX_JOINT } else { gen3::GEN3_URDF };
        let text = (0..times).fold(whole.to_owned(), |text, _| damage(&text, &mut generator));
        if let Ok(arm) = RobotDescription::from_urdf(&text) {
            let positions = vec![0.3; arm.num_dofs()];
            prop_assert!(arm.link_poses(&positions).iter().all(|pose| pose.position.is_finite()));
            prop_assert!(arm.enclosing_capsules(&positions).iter().all(|(_, c)| c.ends[0].is_finite()));
            let settings = MjcfSettings { servo: Some(JointServoSettings::default()), ..MjcfSettings::default() };
            // limits and masses may be missing
            if let Ok(mjcf) = arm.to_mjcf(&settings) {
                let model = Model::from_xml(&mjcf.text);
                prop_assert!(model.is_ok(), "{:?}\n{text}", model.err());
            }
        }
    }

    #[test]
    fn no_text_is_a_panic(text in ".{0,400}", tail in "[<>/=\" a-e!?-]{0,400}") {
        let _ = RobotDescription::from_urdf(&format!("<robot name=\"a\">{text}{tail}"));
        let _ = RobotDescription::from_urdf(&tail);
    }
}
