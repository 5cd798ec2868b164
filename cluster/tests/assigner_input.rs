//! Frames and settings that the assigner refuses.

use cluster::{Assigner, AssignerSettings, Calibrated, ClusterError, Frames, Rule};

fn calibrated(settings: Calibrated) -> Result<Assigner, ClusterError> {
    Assigner::new(AssignerSettings {
        rule: Rule::Calibrated(settings),
    })
}

fn fixed(threshold: f64) -> Result<Assigner, ClusterError> {
    Assigner::new(AssignerSettings {
        rule: Rule::Fixed { threshold },
    })
}

#[test]
fn malformed_frames_are_refused() {
    let message = |features: &[f32], k, dim| {
        Frames::new(features.to_vec(), k, dim)
            .unwrap_err()
            .to_string()
    };
    assert_eq!(
        message(&[], 1, 1),
        "features is empty: expected at least one value"
    );
    assert_eq!(
        message(&[0.0], 0, 1),
        "frames_per_episode is 0: expected at least 1"
    );
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
    let base = Calibrated::default();
    let cases = [
        Calibrated {
            permutations: 19,
            ..base
        },
        Calibrated {
            min_episodes: 3,
            ..base
        },
        Calibrated {
            rollout_episodes: 7,
            ..base
        },
        Calibrated {
            buffer_episodes: 7,
            ..base
        },
        Calibrated {
            doubt: f64::NAN,
            ..base
        },
        Calibrated { doubt: 1.0, ..base },
        // 100 splits do not resolve it
        Calibrated {
            doubt: 0.009,
            ..base
        },
        Calibrated { level: 0.0, ..base },
        Calibrated {
            level: 0.03,
            ..base
        },
        Calibrated {
            min_ratio: 0.9,
            ..base
        },
        Calibrated {
            min_ratio: f64::INFINITY,
            ..base
        },
    ];
    assert!(
        cases
            .into_iter()
            .all(|settings| calibrated(settings).is_err())
    );
    assert!(fixed(f64::INFINITY).is_err());
    let error = fixed(-0.5).unwrap_err().to_string();
    assert_eq!(
        error,
        "threshold is -0.5: expected a finite number, at least 0"
    );
    assert_eq!(
        *Assigner::new(AssignerSettings::default())
            .unwrap()
            .settings(),
        AssignerSettings::default()
    );
}
