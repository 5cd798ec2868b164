//! Figures of experts and of mirror images; `tests/conformance.rs` holds all variants to bounds.

use std::sync::Arc;

use envs::conformance::{experts, symmetry};
use envs::{Camera, Control, Embodiment, Scene, TaskGroup};
use symmetry::D2;

/// Every variant with `embodiment`.
fn variants(embodiment: Embodiment) -> Vec<(Arc<Scene>, D2)> {
    let scene = |group| Arc::new(Scene::new(group, embodiment, Camera::default()).unwrap());
    let scenes = TaskGroup::STANDARD.map(scene);
    let of = |scene: &Arc<Scene>| D2::ALL.map(|element| (Arc::clone(scene), element));
    scenes.iter().flat_map(of).collect()
}

#[test]
fn an_expert_that_cannot_get_there_does_not_succeed() {
    let crawling = Control {
        displacement: 1e-4,
        horizon: 100,
        ..Control::default()
    };
    for (scene, element) in variants(Embodiment::HAND) {
        let row = experts(&scene, element, crawling, 1).unwrap();
        assert_eq!(row.success_rate(), 0.0, "{row:?}");
    }
}

/// The physics of `hand` mirror to rounding, through contact and under random actions, too, and its
/// pictures bit for bit.
#[test]
fn the_hand_mirrors_exactly() {
    for (scene, element) in variants(Embodiment::HAND) {
        let row = symmetry(&scene, element, 2).unwrap();
        assert!(row.free_deviation <= 1e-12, "{row:?}");
        assert!(row.contact_deviation <= 1e-12, "{row:?}");
        assert!(row.reward_deviation <= 1e-9, "{row:?}");
        assert!((row.return_ratio - 1.0).abs() <= 1e-9, "{row:?}");
        assert_eq!(row.frames_differing, 0, "{row:?}");
    }
}

#[test]
fn no_seeds_are_refused() {
    let (scene, element) = variants(Embodiment::HAND).remove(0);
    let error = experts(&scene, element, Control::default(), 0).unwrap_err();
    assert!(error.to_string().contains("`seeds` is 0"), "{error}");
    assert!(symmetry(&scene, element, 0).is_err());
}
