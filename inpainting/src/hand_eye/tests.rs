use glam::{DMat3, DQuat, DVec3};
use proptest::prelude::*;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use super::*;
use crate::camera::{Extrinsics, Intrinsics};
use crate::distortion::LensDistortion;
use crate::sensor::standard_normal;

fn camera(position: DVec3, turn: DVec3, distortion: LensDistortion) -> CameraCalibration {
    let turn = DMat3::from_quat(DQuat::from_scaled_axis(turn));
    let rotation = turn * Extrinsics::overhead(0.0).rotation;
    CameraCalibration {
        intrinsics: Intrinsics::REALSENSE_D435,
        distortion,
        extrinsics: Extrinsics { rotation, translation: -(rotation * position) },
    }
}

fn plain() -> CameraCalibration {
    let position = DVec3::new(0.03, -0.05, 1.5);
    camera(position, DVec3::new(0.04, -0.02, 0.1), LensDistortion::NONE)
}

const OFFSET: DVec3 = DVec3::new(0.1, 0.02, -0.15);

/// Returns poses of a hand over a table, at various heights, turned about all axes.
fn hands(count: usize) -> Vec<(DVec3, DQuat)> {
    let hand = |index: usize| {
        let wave = |pace: f64| (pace * index as f64 + pace).sin();
        let position = DVec3::new(0.25 * wave(2.1), 0.2 * wave(3.3), 0.2 + 0.1 * wave(1.7));
        let turn = DVec3::new(0.3 * wave(5.9), 0.3 * wave(4.7), 0.5 * wave(7.1));
        (position, DQuat::from_scaled_axis(turn))
    };
    (0..count).map(hand).collect()
}

fn sightings(
    camera: &CameraCalibration,
    offset: DVec3,
    hands: &[(DVec3, DQuat)],
) -> Vec<BallSighting> {
    let sighting = |(pose, &(position, rotation)): (usize, &(DVec3, DQuat))| BallSighting {
        pose_number: pose,
        hand_position: position,
        hand_rotation: rotation,
        ball_pixel: camera
            .project_world_direction(position + rotation * offset - camera.camera_position())
            .unwrap(),
    };
    hands.iter().enumerate().map(sighting).collect()
}

/// Returns the differences of two cameras: of positions (metres), and of angles about their axes.
fn apart(found: &CameraCalibration, truth: &CameraCalibration) -> [DVec3; 2] {
    let turn = found.extrinsics.rotation * truth.extrinsics.rotation.transpose();
    let angles = DQuat::from_mat3(&turn).to_scaled_axis();
    [found.camera_position() - truth.camera_position(), angles]
}

fn vector(most: f64) -> impl Strategy<Value = DVec3> {
    prop::array::uniform3(-most..most).prop_map(DVec3::from_array)
}

proptest! {
    #![proptest_config(ProptestConfig::with_cases(60))]

    /// The start is 0.1 m, 10 degrees and any number of quarter turns off.
    #[test]
    fn any_camera_is_found_exactly(
        (place, turn) in (vector(0.25), vector(0.2)),
        (off, twist) in (vector(0.06), vector(0.1)),
        quarters in 0_usize..4,
        (radial, tangential) in (-0.03..0.03, -0.002..0.002),
        offset in vector(0.15),
        known in prop::bool::ANY,
    ) {
        let lens = LensDistortion::brown_conrady([radial, -radial], [tangential; 2]);
        let place = place + 1.6 * DVec3::Z;
        let truth = camera(place, turn, lens);
        let start = rotated(&camera(place + off, turn + twist, lens), quarters);
        let seen = sightings(&truth, offset, &hands(12));
        let offset_given = if known { BallOffsetInHand::Known(offset) } else { BallOffsetInHand::Unknown };
        let found = HandEyeCalibration::solve(&start, offset_given, &seen).unwrap();
        let [position, angle] = apart(&found.calibration, &truth);
        prop_assert!(position.length() < 1e-6, "{position}");
        prop_assert!(angle.length() < 1e-6, "{angle}");
        prop_assert!(found.ball_offset.distance(offset) < 1e-6, "{}", found.ball_offset);
        prop_assert!(found.rms_px() < 1e-4, "{}", found.rms_px());
        found.calibration.check().unwrap();
    }
}

/// Squared errors, over reported variances, have the mean of Student's distribution over many draws
/// of the noise.
#[test]
fn errors_are_as_large_as_the_uncertainty_says() {
    const TRIALS: usize = 300;
    let (truth, noise) = (plain(), 0.3);
    let exact = sightings(&truth, OFFSET, &hands(15));
    let mut rng = ChaCha8Rng::seed_from_u64(1000);
    let mut all_alarms = 0;
    for (offset, free) in [(BallOffsetInHand::Known(OFFSET), 6.0), (BallOffsetInHand::Unknown, 9.0)]
    {
        let (mut squares, mut alarms) = ([DVec3::ZERO; 3], 0);
        for _ in 0..TRIALS {
            let mut seen = exact.clone();
            for sighting in &mut seen {
                sighting.ball_pixel =
                    sighting.ball_pixel.map(|p| p + noise * f64::from(standard_normal(&mut rng)));
            }
            let found = match HandEyeCalibration::solve(&truth, offset, &seen) {
                Ok(found) => found,
                Err(InpaintingError::WrongFocalLength { .. }) => {
                    alarms += 1;
                    continue;
                }
                Err(other) => panic!("{other}"),
            };
            let [position, angle] = apart(&found.calibration, &truth);
            let of = found.uncertainty;
            let offset_ratio =
                (found.ball_offset - OFFSET) / of.ball_offset_sd.max(DVec3::splat(1e-300));
            let ratios = [position / of.position_sd, angle / of.angle_sd, offset_ratio];
            for (sum, ratio) in squares.iter_mut().zip(ratios) {
                *sum += ratio * ratio;
            }
        }
        all_alarms += alarms;
        let solved = (TRIALS - alarms) as f64;
        let expected = (30.0 - free) / (28.0 - free);
        let unknown = free as usize / 3;
        for sum in squares.iter().take(unknown).flat_map(|of| of.to_array()) {
            let mean = sum / solved;
            let off = (mean - expected).abs();
            assert!(off < 0.3, "{offset:?}: {mean}, expected {expected}");
        }
    }
    // right focal lengths that were refused
    assert_eq!(all_alarms, 1);
}

/// Returns poses like those of `covers calibrate`: turned by 12 degrees, at three heights.
fn calibration_poses() -> Vec<(DVec3, DQuat)> {
    let poses: [([f64; 3], [f64; 3]); 14] = [
        ([0.0, 0.0, 0.22], [0.0, 0.0, 0.0]),
        ([-0.18, -0.12, 0.12], [12.0, 0.0, 20.0]),
        ([0.0, -0.14, 0.12], [0.0, -12.0, 0.0]),
        ([0.18, -0.12, 0.12], [-12.0, 0.0, -20.0]),
        ([0.18, 0.12, 0.12], [0.0, 12.0, 20.0]),
        ([0.0, 0.15, 0.12], [12.0, 0.0, 0.0]),
        ([-0.18, 0.12, 0.12], [0.0, -12.0, -20.0]),
        ([-0.2, 0.0, 0.2], [0.0, 12.0, 0.0]),
        ([-0.1, -0.12, 0.28], [-12.0, 0.0, 20.0]),
        ([0.1, -0.12, 0.28], [0.0, 12.0, -20.0]),
        ([0.2, 0.0, 0.2], [0.0, -12.0, 0.0]),
        ([0.12, 0.1, 0.28], [12.0, 0.0, 20.0]),
        ([0.0, 0.08, 0.3], [0.0, 12.0, 0.0]),
        ([-0.12, 0.1, 0.28], [-12.0, 0.0, -20.0]),
    ];
    let pose = |(place, turn): ([f64; 3], [f64; 3])| {
        let turn = DVec3::from_array(turn.map(f64::to_radians));
        (DVec3::from_array(place), DQuat::from_scaled_axis(turn))
    };
    poses.map(pose).to_vec()
}

/// Counts the draws, of 20 with a noise of 0.1 pixels, in which a focal length with a relative
/// error is rejected.
fn refused(part: f64, offset: BallOffsetInHand) -> usize {
    let truth = plain();
    let mut start = truth;
    start.intrinsics.focal_lengths =
        start.intrinsics.focal_lengths.map(|focal| (1.0 + part) * focal);
    let exact = sightings(&truth, BALL, &calibration_poses());
    let draws = (0..20).filter(|&seed| {
        match HandEyeCalibration::solve(&start, offset, &noisy(&exact, 0.1, 0.0, seed)) {
            Ok(found) => {
                let FocalLengthEstimate { ratio_to_given: ratio, ratio_sd: sigma } =
                    found.focal_length.unwrap();
                let off = (1.0 + part) * ratio - 1.0;
                assert!(off.abs() < 4.0 * sigma, "{ratio} {sigma}");
                false
            }
            Err(InpaintingError::WrongFocalLength { given, fitted, sigma }) => {
                let off = fitted[0] - truth.intrinsics.focal_lengths[0];
                assert!(
                    given == start.intrinsics.focal_lengths && off.abs() < 4.0 * sigma,
                    "{fitted:?}"
                );
                true
            }
            Err(other) => panic!("{other}"),
        }
    });
    draws.count()
}

/// Offset of the simulated arm's ball in a hand with the axes of the world (metres).
const BALL: DVec3 = DVec3::new(0.0, 0.13, 0.17);

/// Wrong focal lengths would leave the camera centimetres off, with residuals that look like noise.
#[test]
fn focal_lengths_that_the_poses_contradict_are_refused() {
    for offset in [BallOffsetInHand::Known(BALL), BallOffsetInHand::Unknown] {
        assert_eq!(refused(0.0, offset), 0, "{offset:?}");
        for part in [-0.03, 0.03] {
            assert_eq!(refused(part, offset), 20, "{offset:?} {part}");
        }
    }
}

#[test]
fn residuals_are_told_in_pixels_and_on_the_table() {
    let mut seen = sightings(&plain(), OFFSET, &hands(200));
    seen[7].ball_pixel[0] += 0.6;
    let found =
        HandEyeCalibration::solve(&plain(), BallOffsetInHand::Known(OFFSET), &seen).unwrap();
    let worst = found.largest_residual().unwrap();
    assert_eq!(worst.pose_number, 7);
    assert!((worst.distance_px - 0.6).abs() < 0.02, "{worst:?}");
    // a pixel is 1.5 m / 615 on the table
    let expected = worst.distance_px * 1.5 / 615.0;
    let on_table = worst.table_distance_m.unwrap();
    assert!((on_table / expected - 1.0).abs() < 0.05, "{worst:?}");
    let (pixels, table) = (found.rms_px(), found.rms_on_table_m().unwrap());
    assert!(pixels > 0.02 && pixels < 0.06);
    assert!((table / pixels * 615.0 / 1.5 - 1.0).abs() < 0.05);
}

/// A camera that looks along the table sees some balls above its own height.
#[test]
fn lines_of_sight_that_miss_the_table_are_left_out_of_its_mean() {
    let rotation = DMat3::from_cols(DVec3::X, DVec3::Z, -DVec3::Y);
    let level = CameraCalibration {
        extrinsics: Extrinsics { rotation, translation: -(rotation * DVec3::new(0.0, -1.5, 0.1)) },
        ..plain()
    };
    let mut seen = sightings(&level, OFFSET, &hands(40));
    seen[7].ball_pixel[0] += 1.0;
    let found = HandEyeCalibration::solve(&level, BallOffsetInHand::Known(OFFSET), &seen).unwrap();
    let meet = found.residuals.iter().filter(|of| of.table_distance_m.is_some());
    let meet = meet.count();
    assert!(meet > 0 && meet < 40, "{meet}");
    assert!(found.rms_on_table_m().is_some_and(f64::is_finite));
    let finite = |of: &BallResidual| of.table_distance_m.is_none_or(f64::is_finite);
    assert!(found.residuals.iter().all(finite));
}

fn refusal(start: &CameraCalibration, offset: BallOffsetInHand, seen: &[BallSighting]) -> String {
    HandEyeCalibration::solve(start, offset, seen).unwrap_err().to_string()
}

#[test]
fn too_few_poses_misfits_and_cameras_that_look_away_are_refused() {
    let (known, exact) = (BallOffsetInHand::Known(OFFSET), sightings(&plain(), OFFSET, &hands(12)));
    let message = refusal(&plain(), known, &exact[..9]);
    assert!(message.contains("9 poses, expected at least 10"), "{message}");
    let mut seen = exact[..10].to_vec();
    seen[5].ball_pixel[1] += 40.0;
    let outlier_message = refusal(&plain(), known, &seen);
    assert!(
        outlier_message.contains("pose 5") && outlier_message.contains("at most 4.1"),
        "{outlier_message}"
    );
    let away = camera(DVec3::new(0.0, 0.0, -3.0), DVec3::ZERO, LensDistortion::NONE);
    let away_message = refusal(&away, known, &exact);
    assert!(away_message.contains("pose 0"), "{away_message}");
}

/// Returns sightings with noise in pixels, and in the position of the hand (metres).
fn noisy(exact: &[BallSighting], pixels: f64, metres: f64, seed: u64) -> Vec<BallSighting> {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let mut draw = |sigma: f64| sigma * f64::from(standard_normal(&mut rng));
    let mut seen = exact.to_vec();
    for sighting in &mut seen {
        sighting.ball_pixel = sighting.ball_pixel.map(|p| p + draw(pixels));
        sighting.hand_position += DVec3::new(draw(metres), draw(metres), draw(metres));
    }
    seen
}

#[test]
fn poses_that_the_others_contradict_are_left_out_while_ten_are_left() {
    let exact = sightings(&plain(), BALL, &calibration_poses());
    for offset in [BallOffsetInHand::Known(BALL), BallOffsetInHand::Unknown] {
        for seed in 0..20 {
            for bad in [&[][..], &[(3, 8.0)], &[(0, 10.0), (12, -40.0)], &[(1, 9.0), (6, 300.0)]] {
                let mut seen = noisy(&exact, 0.3, 0.0, seed);
                for &(pose, pixels) in bad {
                    seen[pose].ball_pixel[0] += pixels;
                }
                let found = HandEyeCalibration::solve(&plain(), offset, &seen).unwrap();
                let mut left_out: Vec<_> = found.outliers.iter().map(|of| of.pose_number).collect();
                left_out.sort_unstable();
                assert!(left_out.iter().eq(bad.iter().map(|(pose, _)| pose)), "{left_out:?}");
                assert!(
                    found.outliers.iter().all(|of| of.distance_px > 5.0),
                    "{:?}",
                    found.outliers
                );
                let [position, _] = apart(&found.calibration, &plain());
                let sigmas = position / found.uncertainty.position_sd;
                assert!(sigmas.abs().max_element() < 6.0, "{sigmas}");
            }
        }
        let mut seen = exact.clone();
        (0..5).for_each(|pose| seen[pose].ball_pixel[pose % 2] += 60.0);
        let message = refusal(&plain(), offset, &seen);
        assert!(message.contains("expected at most"), "{message}");
    }
}

/// Wrong units or axes make all poses contradict each other, and no single one is to blame.
#[test]
fn poses_that_contradict_each_other_name_the_offset_and_units() {
    let exact = sightings(&plain(), BALL, &calibration_poses());
    type Spoil = fn(&mut BallSighting);
    let spoils: [(Spoil, BallOffsetInHand, &str); 4] = [
        // given in metres where millimetres were expected, and along other axes
        (|_| {}, BallOffsetInHand::Known(1e-3 * BALL), "130.0, 170.0] mm in the hand"),
        (|_| {}, BallOffsetInHand::Known(-BALL), "130.0, 170.0] mm in the hand"),
        (|s| s.ball_pixel.swap(0, 1), BallOffsetInHand::Unknown, "columns and rows"),
        (
            |s| s.hand_rotation = s.hand_rotation.conjugate(),
            BallOffsetInHand::Known(BALL),
            "axes of the hand",
        ),
    ];
    for (spoil, offset, says) in spoils {
        let mut seen = exact.clone();
        seen.iter_mut().for_each(spoil);
        let message = refusal(&plain(), offset, &seen);
        for words in [says, "whichever one is left out", "`--offset`", "millimetres"] {
            assert!(message.contains(words), "{words}: {message}");
        }
    }
}

/// The bound of residuals follows the focal length and the accuracy of the arm.
#[test]
fn cheap_arms_and_fine_cameras_are_calibrated() {
    let mut fine = plain();
    fine.intrinsics = Intrinsics {
        width: 3840,
        height: 2160,
        focal_lengths: [2800.0; 2],
        principal_point: [1910.0, 1085.0],
    };
    for (camera, noise, arm_accuracy, solved) in [
        (plain(), 0.001, 0.0025, 20),
        (fine, 0.001, 0.0025, 20),
        (plain(), 0.005, 0.005, 20),
        (fine, 0.005, 0.005, 20),
        (plain(), 0.02, 0.0025, 0),
        (fine, 0.02, 0.0025, 0),
    ] {
        let exact = sightings(&camera, BALL, &calibration_poses());
        let found = (0..20).filter(|&seed| {
            let settings = HandEyeSettings {
                arm_position_sd: arm_accuracy,
                ..BallOffsetInHand::Known(BALL).into()
            };
            let seen = noisy(&exact, 0.1, noise, seed);
            HandEyeCalibration::solve(&camera, settings, &seen).is_ok_and(|found| {
                let [position, _] = apart(&found.calibration, &camera);
                assert!((position / found.uncertainty.position_sd).abs().max_element() < 6.0);
                found.outliers.is_empty()
            })
        });
        assert_eq!(found.count(), solved, "{noise} {arm_accuracy}");
    }
    for accuracy in [0.0, -1.0, f64::NAN, 2.5] {
        let settings =
            HandEyeSettings { arm_position_sd: accuracy, ..BallOffsetInHand::Unknown.into() };
        let message = HandEyeCalibration::solve(&plain(), settings, &[]).unwrap_err().to_string();
        assert!(message.contains("accuracy of the arm"), "{message}");
    }
}

#[test]
fn focal_lengths_are_estimated_on_request() {
    let exact = sightings(&plain(), BALL, &calibration_poses());
    let mut start = plain();
    start.intrinsics.focal_lengths = start.intrinsics.focal_lengths.map(|focal| 1.1 * focal);
    for offset in [BallOffsetInHand::Known(BALL), BallOffsetInHand::Unknown] {
        let settings = HandEyeSettings { estimate_focal_length: true, ..offset.into() };
        for seed in 0..20 {
            let found = HandEyeCalibration::solve(&start, settings, &noisy(&exact, 0.1, 0.0, seed))
                .unwrap();
            let FocalLengthEstimate { ratio_to_given: ratio, ratio_sd: sigma } =
                found.focal_length.unwrap();
            assert!((1.1 * ratio - 1.0).abs() < 5.0 * sigma && sigma < 0.01, "{ratio} {sigma}");
            let off = found.calibration.intrinsics.focal_lengths[1]
                / start.intrinsics.focal_lengths[1]
                / ratio
                - 1.0;
            assert!(off.abs() < 1e-9, "{off}");
            let [position, _] = apart(&found.calibration, &plain());
            assert!((position / found.uncertainty.position_sd).abs().max_element() < 5.0);
        }
    }
}

/// Poses on a line do not determine the rotation about it; a hand that does not turn, or turns
/// about one axis, does not determine the offset.
#[test]
fn poses_that_do_not_tell_the_camera_are_refused() {
    let known = BallOffsetInHand::Known(OFFSET);
    let line = |index: usize| (0.04 * index as f64 * DVec3::new(1.0, 0.3, 0.2), DQuat::IDENTITY);
    let line: Vec<_> = (0..12).map(line).collect();
    let message = refusal(&plain(), known, &sightings(&plain(), OFFSET, &line));
    assert!(message.contains("one line"), "{message}");
    for axis in [DVec3::ZERO, DVec3::Z] {
        let turning = |(i, (place, _))| (place, DQuat::from_scaled_axis(0.1 * i as f64 * axis));
        let still: Vec<_> = hands(12).into_iter().enumerate().map(turning).collect();
        let seen = sightings(&plain(), OFFSET, &still);
        let axis_message = refusal(&plain(), BallOffsetInHand::Unknown, &seen);
        assert!(axis_message.contains("turn it about two axes"), "{axis_message}");
        HandEyeCalibration::solve(&plain(), known, &seen).unwrap();
    }
    // a plane determines the camera, less well
    let flat = |(place, turn): (DVec3, DQuat)| (DVec3 { z: 0.1, ..place }, turn);
    let flat: Vec<_> = hands(12).into_iter().map(flat).collect();
    let in_plane = |(place, _): &(DVec3, DQuat)| (*place, DQuat::IDENTITY);
    let flat: Vec<_> = flat.iter().map(in_plane).collect();
    let spread =
        HandEyeCalibration::solve(&plain(), known, &sightings(&plain(), OFFSET, &hands(12)));
    let flat =
        HandEyeCalibration::solve(&plain(), known, &sightings(&plain(), OFFSET, &flat)).unwrap();
    let [flat, spread] =
        [flat, spread.unwrap()].map(|found| found.uncertainty_per_pixel.angle_sd.length());
    assert!(flat > 1.5 * spread, "{flat} {spread}");
}

#[test]
fn numbers_out_of_range_are_refused() {
    let exact = sightings(&plain(), OFFSET, &hands(12));
    type Spoil = fn(&mut BallSighting);
    let spoils: [(Spoil, &str); 4] = [
        (|s| s.hand_position.y = f64::NAN, "position of the hand"),
        (|s| s.hand_position.y = 1e200, "position of the hand"),
        (|s| s.hand_rotation.w = 3.0, "rotation of the hand"),
        (|s| s.ball_pixel[1] = f64::INFINITY, "pixel of the ball"),
    ];
    for (spoil, says) in spoils {
        let mut seen = exact.clone();
        spoil(&mut seen[3]);
        let message = refusal(&plain(), BallOffsetInHand::Unknown, &seen);
        assert!(message.contains(says) && message.contains("pose 3"), "{message}");
    }
    let far = BallOffsetInHand::Known(DVec3::splat(1e200));
    assert!(refusal(&plain(), far, &exact).contains("offset of the ball"));
    let mut blind = plain();
    blind.intrinsics.focal_lengths[0] = 0.0;
    assert!(refusal(&blind, BallOffsetInHand::Unknown, &exact).contains("focal length"));
}
