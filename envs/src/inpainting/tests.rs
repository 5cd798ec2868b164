//! The mask against its definition, the background's memory, and refusals. `tests/inpainting.rs` has the pipeline on the simulation.

use glam::{DMat3, DVec3};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::Camera;

/// A camera that stands askew.
fn view() -> View {
    let rotation = DMat3::from_rotation_x(2.4) * DMat3::from_rotation_z(0.3);
    View {
        intrinsics: Intrinsics {
            width: 40,
            height: 30,
            focal: [35.0, 33.0],
            centre: [21.0, 14.5],
        },
        extrinsics: Extrinsics {
            rotation,
            translation: DVec3::new(0.1, -0.05, 1.2),
        },
    }
}

fn settings() -> Inpainting {
    Inpainting {
        view: view(),
        limbs: vec![Limb {
            joints: [0, 1],
            radius: 0.1,
        }],
        correction: Correction::None,
        mark: Mark {
            radius: 0.1,
            ..Mark::default()
        },
        mark_depth: 1.2,
    }
}

/// Whether the ray passes through one of many spheres along the capsule's axis.
fn slow_meets(capsule: &Capsule, ray: DVec3, slack: f64) -> bool {
    let [from, to] = capsule.ends;
    (0..=400).any(|i| {
        let centre = from.lerp(to, f64::from(i) / 400.0);
        let depth = centre.dot(ray);
        depth > 0.0 && centre.distance(depth * ray) <= capsule.radius + slack
    })
}

#[test]
fn masks_are_the_rays_that_meet_a_chain_of_spheres() {
    let (view, mut rng) = (view(), ChaCha8Rng::seed_from_u64(3));
    let mut point = || DVec3::from_array(std::array::from_fn(|_| rng.random_range(-0.6..0.6)));
    for case in 0..60 {
        let ends = [point(), point()].map(|point| view.in_camera(point));
        let capsule = Capsule { ends, radius: 0.08 };
        let mut mask = vec![false; view.pixels()];
        capsule.mark(&view, &mut mask);
        for (index, &hidden) in mask.iter().enumerate() {
            let ray = view.ray(index / 40, index % 40);
            // the chain is a little thinner between its spheres
            assert!(hidden || !slow_meets(&capsule, ray, 0.0), "{case} {index}");
            assert!(!hidden || slow_meets(&capsule, ray, 1e-3), "{case} {index}");
        }
    }
}

#[test]
fn projections_are_where_rays_come_from() {
    let view = view();
    let point = DVec3::new(0.12, 0.2, 0.1);
    let [right, down] = view.project(point).unwrap();
    let [cx, cy] = view.intrinsics.centre;
    let (row, column) = ((cy + down) as usize, (cx + right) as usize);
    let off = view.ray(row, column).angle_between(view.in_camera(point));
    assert!(off < 0.03, "{off} rad");
    assert_eq!(
        view.project(point + DVec3::Z * 5.0).is_none(),
        view.in_camera(point + DVec3::Z * 5.0).z <= 0.0
    );
}

#[test]
fn the_view_of_the_table_camera_projects_as_it_does() {
    let camera = Camera::default();
    let view = View::from(&camera);
    view.check().unwrap();
    for point in [[0.1, -0.2, 0.3], [-0.4, 0.3, 0.0]].map(DVec3::from_array) {
        let [u, v] = camera.project(point);
        let [right, down] = view.project(point).unwrap();
        assert!((right - u).abs() < 1e-9 && (down + v).abs() < 1e-9);
    }
}

/// What stands outside the mask is renewed; what is behind the arm stays as it was last seen.
#[test]
fn the_background_is_refreshed_where_the_arm_is_not() {
    let settings = Inpainting {
        mark: Mark {
            radius: 0.0,
            ..Mark::default()
        },
        ..settings()
    };
    let pixels = settings.view.pixels();
    let mut inpainter = Inpainter::new(settings, &vec![10; 3 * pixels]).unwrap();
    let left = [DVec3::new(-0.3, -0.3, 0.0), DVec3::new(-0.3, 0.3, 0.0)];
    let right = left.map(|joint| DVec3::new(0.3, joint.y, joint.z));
    let mut out = vec![0; 3 * pixels];
    inpainter
        .inpaint(&vec![20; 3 * pixels], &left, DVec3::ZERO, &mut out)
        .unwrap();
    let first = inpainter.mask().to_vec();
    let hidden = first.iter().filter(|&&hidden| hidden).count();
    assert!(hidden > 50 && hidden < pixels / 2, "{hidden}");
    for (pixel, &hidden) in out.chunks_exact(3).zip(&first) {
        assert_eq!(pixel, if hidden { [10; 3] } else { [20; 3] });
    }
    inpainter
        .inpaint(&vec![30; 3 * pixels], &right, DVec3::ZERO, &mut out)
        .unwrap();
    assert_ne!(inpainter.mask(), first);
    for ((pixel, &now), &before) in out.chunks_exact(3).zip(inpainter.mask()).zip(&first) {
        let seen = match (now, before) {
            (false, _) => 30,
            (true, false) => 20,
            (true, true) => 10,
        };
        assert_eq!(pixel, [seen; 3]);
    }
}

#[test]
fn the_mark_stands_at_the_gripper() {
    let settings = settings();
    let (view, pixels) = (settings.view, settings.view.pixels());
    let mut inpainter = Inpainter::new(settings, &vec![0; 3 * pixels]).unwrap();
    let gripper = DVec3::new(0.05, 0.1, 0.1);
    let mut out = vec![0; 3 * pixels];
    inpainter
        .inpaint(&vec![0; 3 * pixels], &[gripper; 2], gripper, &mut out)
        .unwrap();
    let [right, down] = view.project(gripper).unwrap();
    let [cx, cy] = view.intrinsics.centre;
    let pixel = ((cy + down) as usize * 40 + (cx + right) as usize) * 3;
    assert_eq!(out[pixel..pixel + 3], Mark::default().color);
    // a disc of 0.1 m at 1.2 m, through a focal length of 35 pixels
    let (area, expected) = (
        out.chunks_exact(3).filter(|pixel| pixel[2] == 255).count() as f64,
        std::f64::consts::PI * (0.1 * 35.0 / 1.2_f64).powi(2),
    );
    assert!(
        (area - expected).abs() < 5.0,
        "{area} pixels, not {expected}"
    );
}

#[test]
fn nonsense_is_refused_with_its_value() {
    type Change = fn(&mut Inpainting);
    let broken: [(Change, &str); 7] = [
        (|s| s.view.intrinsics.width = 0, "picture size` is 0 x 30"),
        (
            |s| s.view.intrinsics.focal[1] = -3.0,
            "focal length` is [35.0, -3.0]",
        ),
        (|s| s.view.intrinsics.centre[0] = f64::NAN, "optical axis"),
        (|s| s.view.extrinsics.rotation = DMat3::ZERO, "rotation"),
        (
            |s| s.view.extrinsics.translation.x = f64::INFINITY,
            "translation",
        ),
        (|s| s.limbs[0].radius = -0.1, "limb radius` is -0.1"),
        (|s| s.mark_depth = 0.0, "mark depth` is 0"),
    ];
    for (change, says) in broken {
        let mut settings = settings();
        change(&mut settings);
        let message = Inpainter::new(settings, &[]).unwrap_err().to_string();
        assert!(message.contains(says), "{message}");
    }
    let short = Inpainter::new(settings(), &[0; 7]).unwrap_err().to_string();
    assert!(short.contains("`background` has 7 elements, expected 3600"));

    let picture = vec![0; 3600];
    let mut inpainter = Inpainter::new(settings(), &picture).unwrap();
    let mut refuse = |image: &[u8], joints: &[DVec3], gripper, says: &str| {
        let mut out = picture.clone();
        let refused = inpainter.inpaint(image, joints, gripper, &mut out);
        let message = refused.unwrap_err().to_string();
        assert!(message.contains(says), "{message}");
    };
    refuse(&[1, 2], &[DVec3::ZERO; 2], DVec3::ZERO, "`image` has 2");
    refuse(
        &picture,
        &[DVec3::ZERO],
        DVec3::ZERO,
        "joint of a limb` is 1",
    );
    refuse(&picture, &[DVec3::NAN; 2], DVec3::ZERO, "joint positions");
    refuse(&picture, &[DVec3::ZERO; 2], DVec3::NAN, "gripper position");
}
