//! The mask and the mark against their definitions, the background's memory, and refusals.
//! `envs/tests/inpainting.rs` has the pipeline on a simulation.

use glam::{DMat3, DVec3};
use proptest::prelude::*;

use crate::camera::{Extrinsics, Intrinsics, PinholeCamera};
use crate::color::ColorCorrection;
use crate::inpainter::{Inpainter, InpainterSettings};
use crate::links::{Capsule, Link};
use crate::mark::Mark;

const MARK: Mark = Mark {
    radius: 0.1,
    hole: 0.0,
    color: [0, 0, 255],
    depth: 1.2,
};

/// A camera that stands askew, whose pictures are not square.
fn camera() -> PinholeCamera {
    let rotation = DMat3::from_rotation_x(2.4) * DMat3::from_rotation_z(0.3);
    PinholeCamera {
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

fn settings() -> InpainterSettings {
    InpainterSettings {
        camera: camera(),
        links: vec![Link {
            joints: [0, 1],
            radius: 0.1,
        }],
        correction: ColorCorrection::None,
        mark: MARK,
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

fn point() -> impl Strategy<Value = DVec3> {
    prop::array::uniform3(-0.6..0.6).prop_map(DVec3::from_array)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    #[test]
    fn masks_are_the_rays_that_meet_a_chain_of_spheres(from in point(), to in point()) {
        let camera = camera();
        let ends = [from, to].map(|point| camera.in_camera(point));
        let capsule = Capsule { ends, radius: 0.08 };
        let mut mask = vec![false; camera.pixels()];
        capsule.mark(&camera, &mut mask);
        for (index, &hidden) in mask.iter().enumerate() {
            let ray = camera.ray(index / 40, index % 40);
            // the chain is a little thinner between its spheres
            prop_assert!(hidden || !slow_meets(&capsule, ray, 0.0), "{index}");
            prop_assert!(!hidden || slow_meets(&capsule, ray, 1e-3), "{index}");
        }
    }

    #[test]
    fn a_mark_is_the_pixels_near_its_projection(
        point in point(),
        radius in 0.0..0.3,
        share in 0.0..1.0,
    ) {
        let (camera, hole) = (camera(), radius * share);
        let mark = Mark { radius, hole, ..MARK };
        let mut rgb = vec![0; 3 * camera.pixels()];
        mark.draw(&camera, point, &mut rgb);
        prop_assert_eq!(rgb, slow_mark(&mark, &camera, point));
    }
}

/// The definition, pixel by pixel over the whole picture.
fn slow_mark(mark: &Mark, camera: &PinholeCamera, point: DVec3) -> Vec<u8> {
    let ([cx, cy], [fx, fy]) = (camera.intrinsics.centre, camera.intrinsics.focal);
    let slopes = [mark.radius, mark.hole].map(|r| r / mark.depth);
    let projected = camera.project(point);
    let pixel = |index: usize| {
        let inside = projected.is_some_and(|[right, down]| {
            let dx = (index % 40) as f64 + 0.5 - cx - right;
            let dy = (index / 40) as f64 + 0.5 - cy - down;
            (slopes[1]..slopes[0]).contains(&(dx / fx).hypot(dy / fy))
        });
        if inside { mark.color } else { [0; 3] }
    };
    (0..camera.pixels()).flat_map(pixel).collect()
}

/// The middle of every pixel, along its ray and back.
#[test]
fn projections_are_where_rays_come_from() {
    let camera = camera();
    let Extrinsics {
        rotation,
        translation,
    } = camera.extrinsics;
    let [cx, cy] = camera.intrinsics.centre;
    for (index, depth) in (0..camera.pixels()).zip([0.01, 0.7, 30.0].into_iter().cycle()) {
        let (row, column) = (index / 40, index % 40);
        let point = rotation.transpose() * (depth * camera.ray(row, column) - translation);
        let [right, down] = camera.project(point).unwrap();
        let off =
            (right + cx - (column as f64 + 0.5)).abs() + (down + cy - (row as f64 + 0.5)).abs();
        assert!(off < 1e-12 * (1.0 + 1.0 / depth), "{index}: {off} pixels");
        let behind = rotation.transpose() * (-depth * camera.ray(row, column) - translation);
        assert_eq!(camera.project(behind), None);
    }
}

/// What stands outside the mask is renewed; what is behind the arm stays as it was last seen.
#[test]
fn the_background_is_refreshed_where_the_arm_is_not() {
    let mark = Mark {
        radius: 0.0,
        ..MARK
    };
    let settings = InpainterSettings { mark, ..settings() };
    let pixels = settings.camera.pixels();
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
    let (camera, pixels) = (settings.camera, settings.camera.pixels());
    let mut inpainter = Inpainter::new(settings, &vec![0; 3 * pixels]).unwrap();
    let gripper = DVec3::new(0.05, 0.1, 0.1);
    let mut out = vec![0; 3 * pixels];
    inpainter
        .inpaint(&vec![0; 3 * pixels], &[gripper; 2], gripper, &mut out)
        .unwrap();
    let [right, down] = camera.project(gripper).unwrap();
    let [cx, cy] = camera.intrinsics.centre;
    let pixel = ((cy + down) as usize * 40 + (cx + right) as usize) * 3;
    assert_eq!(out[pixel..pixel + 3], MARK.color);
    // a disc of 0.1 m at 1.2 m, through focal lengths of 35 and 33 pixels
    let (area, expected) = (
        out.chunks_exact(3).filter(|pixel| pixel[2] == 255).count() as f64,
        std::f64::consts::PI * (0.1 / 1.2_f64).powi(2) * 35.0 * 33.0,
    );
    assert!(
        (area - expected).abs() < 5.0,
        "{area} pixels, not {expected}"
    );
}

#[test]
fn nonsense_is_refused_with_its_value() {
    type Change = fn(&mut InpainterSettings);
    let broken: [(Change, &str); 10] = [
        (|s| s.camera.intrinsics.width = 0, "picture size` is 0 x 30"),
        (
            |s| s.camera.intrinsics.width = usize::MAX / 40,
            "picture size` is 461168601842738790 x 30",
        ),
        (
            |s| s.camera.extrinsics.translation.y = -1e200,
            "translation",
        ),
        (
            |s| s.camera.intrinsics.focal[1] = -3.0,
            "focal length` is [35.0, -3.0]",
        ),
        (|s| s.camera.intrinsics.centre[0] = f64::NAN, "optical axis"),
        (|s| s.camera.extrinsics.rotation = DMat3::ZERO, "rotation"),
        (
            |s| s.camera.extrinsics.translation.x = f64::INFINITY,
            "translation",
        ),
        (|s| s.links[0].radius = -0.1, "link radius` is -0.1"),
        (|s| s.mark.depth = 0.0, "mark depth` is 0"),
        (|s| s.mark.hole = 0.2, "mark hole` is 0.2"),
    ];
    for (change, says) in broken {
        let mut settings = settings();
        change(&mut settings);
        let message = Inpainter::new(settings, &[]).unwrap_err().to_string();
        assert!(message.contains(says), "{message}");
    }
    let short = Inpainter::new(settings(), &[0; 7]).unwrap_err().to_string();
    assert!(short.contains("`background` has 7 elements, expected 3600"));
}

/// After a refusal, the result, the mask and what is remembered are as before.
#[test]
fn what_cannot_be_painted_out_is_refused_and_changes_nothing() {
    let (dark, bright) = (vec![0; 3600], vec![200; 3600]);
    let mut inpainter = Inpainter::new(settings(), &dark).unwrap();
    let (zero, nan) = (DVec3::ZERO, DVec3::NAN);
    let far = DVec3::new(0.0, 1e200, 0.0);
    let cases: [(&[u8], &[DVec3], DVec3, &str); 6] = [
        (&[1, 2], &[zero; 2], zero, "`image` has 2"),
        (&bright, &[zero], zero, "joint of a link` is 1"),
        (
            &bright,
            &[zero, nan],
            zero,
            "joint positions` is [NaN, NaN, NaN] at 1",
        ),
        (&bright, &[zero; 2], nan, "gripper position"),
        (&bright, &[far, zero], zero, "joint positions"),
        (&bright, &[zero; 2], -far, "gripper position"),
    ];
    for (image, joints, gripper, says) in cases {
        let mut out = dark.clone();
        let before = inpainter.clone();
        let refused = inpainter.inpaint(image, joints, gripper, &mut out);
        let message = refused.unwrap_err().to_string();
        assert!(message.contains(says), "{message}");
        assert!(out == dark, "{says}: the result was written");
        assert!(
            inpainter == before,
            "{says}: the refused picture is remembered"
        );
    }
}

#[test]
fn a_result_of_another_size_is_refused() {
    let mut inpainter = Inpainter::new(settings(), &[0; 3600]).unwrap();
    let before = inpainter.clone();
    let refused = inpainter.inpaint(&[9; 3600], &[DVec3::ZERO; 2], DVec3::ZERO, &mut [0; 3597]);
    let message = refused.unwrap_err().to_string();
    assert!(
        message.contains("`out` has 3597 elements, expected 3600"),
        "{message}"
    );
    assert!(inpainter == before);
}
