//! The checks of the crate on a few seeds; `covers check` runs them on many.

#![allow(clippy::unwrap_used, reason = "test code")]

use envs::check::{experts, symmetry};
use envs::{Camera, Dynamics, Embodiment};

#[test]
fn experts_solve_every_variant_of_both_embodiments() {
    for embodiment in Embodiment::ALL {
        let rows = experts(embodiment, Dynamics::default(), 2).unwrap();
        assert_eq!(rows.len(), 16);
        for row in rows {
            assert_eq!(row.successes, row.episodes, "{row:?}");
            assert!((250.0..500.0).contains(&row.mean_return), "{row:?}");
        }
    }
}

#[test]
fn an_expert_that_cannot_get_there_does_not_succeed() {
    let crawling = Dynamics {
        displacement: 1e-4,
        horizon: 100,
        ..Dynamics::default()
    };
    let rows = experts(Embodiment::Hand, crawling, 1).unwrap();
    assert!(rows.iter().all(|row| row.success_rate() == 0.0), "{rows:?}");
}

/// The physics of `hand` mirror to rounding, through contact and under random actions, too, and its pictures bit for bit.
#[test]
fn the_hand_mirrors_exactly() {
    for row in symmetry(Embodiment::Hand, Camera::default(), 2).unwrap() {
        assert!(row.free_deviation <= 1e-12, "{row:?}");
        assert!(row.contact_deviation <= 1e-12, "{row:?}");
        assert!(row.reward_deviation <= 1e-9, "{row:?}");
        assert!((row.return_ratio - 1.0).abs() <= 1e-9, "{row:?}");
        assert_eq!(row.frames_differing, 0, "{row:?}");
    }
}

#[test]
fn experts_of_the_arm_earn_alike_on_all_variants() {
    for row in symmetry(Embodiment::Sawyer, Camera::default(), 2).unwrap() {
        assert!((row.return_ratio - 1.0).abs() <= 0.03, "{row:?}");
    }
}

#[test]
fn no_seeds_are_refused() {
    let error = experts(Embodiment::Hand, Dynamics::default(), 0).unwrap_err();
    assert!(error.to_string().contains("`seeds` is 0"), "{error}");
    assert!(symmetry(Embodiment::Hand, Camera::default(), 0).is_err());
}
