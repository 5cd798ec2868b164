//! Frames and settings that the assigner refuses.

use cluster::{Assigner, AssignerSettings, Calibrated, Frames};

use crate::common::{calibrated, fixed};

#[test]
fn malformed_frames_are_refused() {
    let message =
        |features: &[f32], k, dim| Frames::new(features.to_vec(), k, dim).unwrap_err().to_string();
    assert_eq!(message(&[], 1, 1), "features is empty: expected at least one value");
    assert_eq!(message(&[0.0], 0, 1), "frames_per_episode is 0: expected at least 1");
    assert_eq!(message(&[0.0], 1, 0), "dim is 0: expected at least 1");
    assert_eq!(
        message(&[0.0, f32::INFINITY], 2, 1),
        "features[1] is inf: expected a finite number"
    );
    let ragged = "features has 7 values, which is not a multiple of 6 (the length of one episode)";
    assert_eq!(message(&[0.0; 7], 2, 3), ragged);
    assert!(Frames::new(vec![0.0], usize::MAX, 2).is_err());
}

#[test]
fn settings_outside_their_range_are_refused() {
    let wrong: [fn(&mut Calibrated); 11] = [
        |s| s.permutations = 19,
        |s| s.min_episodes = 3,
        |s| s.rollout_episodes = 7,
        |s| s.buffer_episodes = 7,
        |s| s.doubt = f64::NAN,
        |s| s.doubt = 1.0,
        // 100 splits do not resolve it
        |s| s.doubt = 0.009,
        |s| s.level = 0.0,
        |s| s.level = 0.03,
        |s| s.min_ratio = 0.9,
        |s| s.min_ratio = f64::INFINITY,
    ];
    for (case, change) in wrong.into_iter().enumerate() {
        let mut settings = Calibrated::default();
        change(&mut settings);
        assert!(calibrated(settings).is_err(), "case {case}");
    }
    assert!(fixed(f64::INFINITY).is_err());
    let error = fixed(-0.5).unwrap_err().to_string();
    assert_eq!(error, "threshold is -0.5: expected a finite number, at least 0");
}

#[test]
fn the_default_settings_are_taken() {
    let settings = AssignerSettings::default();
    assert_eq!(*Assigner::new(settings).unwrap().settings(), settings);
}
