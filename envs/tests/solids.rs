//! Solids for programs that draw a table themselves.

use std::collections::BTreeSet;
use std::sync::Arc;

use envs::mujoco::GeomShape;
use envs::{Camera, ControlSettings, Embodiment, Scene, TableTop, TaskGroup, VisibleGeom};
use glam::{DMat3, DVec3};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use symmetry::D2;

fn started(group: TaskGroup, embodiment: Embodiment, element: D2) -> TableTop {
    let scene = Scene::new(group, embodiment, Camera::default()).unwrap();
    let mut table = TableTop::new(Arc::new(scene), ControlSettings::default()).unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(1000);
    table.reset(element, &mut rng).unwrap();
    table
}

fn named<'a>(table: &'a TableTop, name: &str) -> VisibleGeom<'a> {
    let mut solids = table.visible_geoms();
    solids.find(|solid| solid.name == Some(name)).unwrap()
}

#[test]
fn every_scene_has_solids_of_its_table_and_its_arm() {
    for group in TaskGroup::STANDARD {
        for embodiment in [Embodiment::SAWYER, Embodiment::FLOATING_HAND, Embodiment::KINOVA_GEN3] {
            let table = started(group, embodiment, D2::Identity);
            let names: BTreeSet<_> =
                table.visible_geoms().map(|solid| solid.name.unwrap()).collect();
            assert_eq!(names.len(), table.visible_geoms().count(), "{names:?}");
            assert!(names.contains("table_top"), "{names:?}");
            assert!(!names.contains("table_collision") && !names.contains("hand_target"));
            let arm = table.visible_geoms().filter(|solid| solid.is_arm).count();
            assert!(arm > 0 && arm < names.len(), "{arm} of {}", names.len());
            for solid in table.visible_geoms() {
                let off = solid.axes.transpose() * solid.axes - DMat3::IDENTITY;
                assert!(off.to_cols_array().iter().all(|part| part.abs() < 1e-9));
                assert!((solid.axes.determinant() - 1.0).abs() < 1e-9, "{solid:?}");
            }
        }
    }
}

/// A step of the arm must move the arm alone.
#[test]
fn solids_are_where_the_simulation_has_them() {
    let mut table = started(TaskGroup::GOAL_REACH, Embodiment::FLOATING_HAND, D2::FlipX);
    let before: Vec<(bool, DVec3)> =
        table.visible_geoms().map(|s| (s.is_arm, s.position)).collect();
    let hand = table.hand_position();
    table.step(&[1.0, 0.0, 0.0, 0.0]).unwrap();
    let moved = table.hand_position() - hand;
    assert!(moved.x > 0.01, "{moved}");
    for (solid, (is_arm, position)) in table.visible_geoms().zip(before) {
        let own = solid.position - position;
        if is_arm {
            // fingers settle by a fraction of a millimetre
            assert!((own - moved).length() < 1e-3, "{own} {solid:?}");
        } else {
            assert_eq!(own, DVec3::ZERO, "{solid:?}");
        }
    }
}

/// Values of `arena.xml` and `plate_slide.xml`.
#[test]
fn shapes_have_the_sizes_and_axes_of_the_scene() {
    let table = started(TaskGroup::PLATE_SLIDE, Embodiment::FLOATING_HAND, D2::Identity);
    let top = named(&table, "table_top");
    let half = [0.7, 0.4, 0.027];
    assert_eq!(top.shape, GeomShape::Box { half });
    assert_eq!((top.position, top.rgba), (DVec3::new(0.0, 0.0, -0.027), [0.44, 0.34, 0.28, 1.0]));
    assert!(!top.is_arm);
    let puck = named(&table, "puck_visual").shape;
    let (radius, half_length) = (0.05, 0.015);
    assert_eq!(puck, GeomShape::Cylinder { radius, half_length });
    // the net's back leans about x
    let net = named(&table, "net_back").axes;
    let (sine, cosine) = 0.2406_f64.sin_cos();
    let off = net.z_axis.distance(DVec3::new(0.0, -sine, cosine));
    assert!(net.x_axis.distance(DVec3::X) < 1e-9 && off < 1e-6, "{net}");
}
