//! Simulated camera with the imperfections of a real one.

use glam::{DMat3, DVec3};
use rand_chacha::ChaCha8Rng;

use crate::calibration::CameraCalibration;
use crate::camera::{Extrinsics, Intrinsics, PinholeCamera};
use crate::drift::GainDrift;
use crate::error::{InpaintingError, check_picture_size, require_that};
use crate::imperfections::CameraImperfections;
use crate::sensor::Sensor;
use crate::sensor::random_direction;
use crate::warp::Warp;

/// Margin (pixels) of the ideal picture around the area that the lens needs.
const BORDER: f64 = 1.0;

/// Camera that turns a perfect camera's pictures into those of a real one.
///
/// A simulation renders the pictures of the pinhole camera [`SimulatedCamera::ideal_camera`]. The
/// reported calibration is wrong by [`CameraImperfections::position_error`] and
/// [`CameraImperfections::angle_error`]. The simulation itself must delay pictures by
/// [`CameraImperfections::latency`], and render one at the beginning and one at the end of
/// [`CameraImperfections::exposure_time`].
#[derive(Clone, Debug, PartialEq)]
pub struct SimulatedCamera {
    imperfections: CameraImperfections,
    calibration: CameraCalibration,
    ideal: PinholeCamera,
    lens: Warp,
    sensor: Sensor,
    drift: GainDrift,
    /// Buffer of a distorted picture, `[height, width, 3]`.
    distorted: Vec<u8>,
    rng: ChaCha8Rng,
}

impl SimulatedCamera {
    /// Creates a simulated camera with the calibration `truth`, to whose distortion
    /// [`CameraImperfections::distortion`] is added. All random numbers are drawn from `rng`.
    ///
    /// # Errors
    /// [`InpaintingError::InvalidValue`], also for a distortion without inverse in the picture.
    pub fn new(
        truth: CameraCalibration,
        imperfections: CameraImperfections,
        mut rng: ChaCha8Rng,
    ) -> Result<Self, InpaintingError> {
        truth.check()?;
        imperfections.check()?;
        let distortion = truth.distortion + imperfections.distortion;
        let bent = CameraCalibration { distortion, ..truth };
        bent.check()?;
        let (ideal, lens) = lens(&bent)?;
        let Intrinsics { width, height, .. } = truth.intrinsics;
        let calibration = CameraCalibration {
            extrinsics: perturbed(&truth.extrinsics, &imperfections, &mut rng),
            ..truth
        };
        Ok(Self {
            imperfections,
            calibration,
            ideal,
            lens,
            sensor: Sensor::new(width * height),
            drift: GainDrift::default(),
            distorted: vec![0; 3 * width * height],
            rng,
        })
    }

    /// Returns the reported calibration, which deviates from the true one.
    pub fn reported_calibration(&self) -> &CameraCalibration {
        &self.calibration
    }

    /// Returns the perfect camera whose pictures the simulated camera takes as input: square, with
    /// the optical axis in the middle.
    pub fn ideal_camera(&self) -> &PinholeCamera {
        &self.ideal
    }

    /// Returns the imperfections of the camera.
    pub fn imperfections(&self) -> &CameraImperfections {
        &self.imperfections
    }

    /// Takes a picture `[height, width, 3]` into `out` at the time `now` (seconds), which must not
    /// decrease from call to call.
    ///
    /// `ideal` are the pictures of [`SimulatedCamera::ideal_camera`] during the exposure.
    ///
    /// # Errors
    /// [`InpaintingError::WrongLength`] for a picture of another size,
    /// [`InpaintingError::InvalidValue`] if `ideal` is empty.
    pub fn take_picture(
        &mut self,
        ideal: &[&[u8]],
        now: f64,
        out: &mut [u8],
    ) -> Result<(), InpaintingError> {
        require_that(!ideal.is_empty(), "pictures", &0, "at least one")?;
        check_picture_size("out", out, self.distorted.len() / 3)?;
        // all checks come before any light is collected, so an error changes nothing
        for picture in ideal {
            check_picture_size("picture", picture, self.ideal.num_pixels())?;
        }
        for picture in ideal {
            self.lens.apply(picture, &mut self.distorted)?;
            self.sensor.collect_light(&self.distorted);
        }
        let gains = self.drift.sample_gains(&self.imperfections, now, &mut self.rng);
        let noise = [self.imperfections.shot_noise_variance, self.imperfections.read_noise_sd];
        self.sensor.read_out(gains, noise, &mut self.rng, out);
        Ok(())
    }
}

/// Returns the pinhole camera whose picture contains all that the lens shows, and the warp from its
/// pictures to those of the lens.
fn lens(camera: &CameraCalibration) -> Result<(PinholeCamera, Warp), InpaintingError> {
    let places = places(camera)?;
    let ideal = pinhole(camera, &places);
    ideal.check()?;
    let Intrinsics { width, focal_lengths: focal, principal_point: centre, .. } = ideal.intrinsics;
    let pixel = |place: [f64; 2]| [0, 1].map(|axis| centre[axis] + focal[axis] * place[axis]);
    let places = places.into_iter().map(|place| Some(pixel(place)));
    let warp = Warp::new([width; 2], places)?;
    Ok((ideal, warp))
}

/// Returns the point at which a pinhole of focal length 1 shows what each pixel shows.
fn places(camera: &CameraCalibration) -> Result<Vec<[f64; 2]>, InpaintingError> {
    let Intrinsics { width, height, .. } = camera.intrinsics;
    let middles = (0..width * height).map(|i| [(i % width) as f64 + 0.5, (i / width) as f64 + 0.5]);
    let places: Option<Vec<_>> = middles.map(|middle| camera.undistort_pixel(middle)).collect();
    places.ok_or_else(|| InpaintingError::InvalidValue {
        name: "distortion",
        value: format!("{:?}", camera.distortion),
        expected: "one that shows each thing once in the picture",
    })
}

/// Returns the pinhole camera with a square picture that contains all points of `places`.
fn pinhole(camera: &CameraCalibration, places: &[[f64; 2]]) -> PinholeCamera {
    let focal = camera.intrinsics.focal_lengths[0];
    let coordinates = places.iter().flatten();
    let reach = focal * coordinates.fold(0.0, |most: f64, part| most.max(part.abs()));
    let half = (reach + BORDER).ceil();
    let side = 2 * half as usize;
    PinholeCamera {
        intrinsics: Intrinsics {
            width: side,
            height: side,
            focal_lengths: [focal; 2],
            principal_point: [half; 2],
        },
        extrinsics: camera.extrinsics,
    }
}

/// Returns the true pose of the camera with errors of calibration, of the given sizes in random
/// directions.
fn perturbed(
    truth: &Extrinsics,
    imperfections: &CameraImperfections,
    rng: &mut ChaCha8Rng,
) -> Extrinsics {
    let (axis, offset) = (random_direction(rng), random_direction(rng));
    let position: DVec3 = truth.camera_position() + imperfections.position_error * offset;
    let rotation = DMat3::from_axis_angle(axis, imperfections.angle_error) * truth.rotation;
    Extrinsics { rotation, translation: -(rotation * position) }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::*;
    use crate::calibration::tests::overhead;
    use crate::distortion::LensDistortion;

    fn rng(seed: u64) -> ChaCha8Rng {
        ChaCha8Rng::seed_from_u64(seed)
    }

    fn small() -> CameraCalibration {
        CameraCalibration {
            intrinsics: Intrinsics {
                width: 64,
                height: 48,
                focal_lengths: [61.5; 2],
                principal_point: [31.5, 24.0],
            },
            ..overhead()
        }
    }

    fn made(imperfections: CameraImperfections) -> SimulatedCamera {
        SimulatedCamera::new(small(), imperfections, rng(1000)).unwrap()
    }

    /// A picture of the ideal camera in which every pixel differs from its neighbours.
    fn scene(camera: &SimulatedCamera) -> Vec<u8> {
        (0..3 * camera.ideal_camera().num_pixels()).map(|i| (60 + i * 37 % 120) as u8).collect()
    }

    fn shot(camera: &mut SimulatedCamera, scene: &[u8]) -> Vec<u8> {
        let mut out = vec![0; 3 * 64 * 48];
        camera.take_picture(&[scene], 0.0, &mut out).unwrap();
        out
    }

    #[test]
    fn without_imperfections_a_picture_is_a_part_of_the_ideal_one_to_the_bit() {
        let mut camera = SimulatedCamera::new(
            CameraCalibration {
                intrinsics: Intrinsics { principal_point: [31.0, 24.0], ..small().intrinsics },
                ..small()
            },
            CameraImperfections::NO_IMPERFECTIONS,
            rng(1000),
        )
        .unwrap();
        assert_eq!(camera.reported_calibration().extrinsics, small().extrinsics);
        let scene = scene(&camera);
        let out = shot(&mut camera, &scene);
        let half = camera.ideal_camera().intrinsics.width / 2;
        for (row, line) in out.chunks_exact(3 * 64).enumerate() {
            let from = ((half - 24 + row) * 2 * half + half - 31) * 3;
            assert!(line == &scene[from..][..3 * 64], "row {row}");
        }
    }

    #[test]
    fn calibrations_are_wrong_by_as_much_as_they_should_be() {
        let imperfections = CameraImperfections {
            position_error: 0.01,
            angle_error: 0.02,
            ..CameraImperfections::NO_IMPERFECTIONS
        };
        for seed in 1000..1010 {
            let camera = SimulatedCamera::new(small(), imperfections, rng(seed)).unwrap();
            let (known, truth) = (camera.reported_calibration(), small());
            let off = known.camera_position().distance(truth.camera_position());
            assert!((off - 0.01).abs() < 1e-12, "{off}");
            let turn = known.extrinsics.rotation * truth.extrinsics.rotation.transpose();
            let trace = turn.x_axis.x + turn.y_axis.y + turn.z_axis.z;
            let angle = ((trace - 1.0) / 2.0).acos();
            assert!((angle - 0.02).abs() < 1e-9, "{angle}");
            known.check().unwrap();
            assert_eq!(camera.ideal_camera().extrinsics, truth.extrinsics);
        }
    }

    /// A dot of the ideal picture appears at its distorted position.
    #[test]
    fn the_lens_bends_what_is_seen() {
        let distortion = LensDistortion::brown_conrady([0.3, 0.0], [0.0, 0.02]);
        let mut camera =
            made(CameraImperfections { distortion, ..CameraImperfections::NO_IMPERFECTIONS });
        let side = camera.ideal_camera().intrinsics.width;
        let (column, row) = (side / 2 + 20, side / 2 - 14);
        let mut scene = vec![0; 3 * side * side];
        for (right, below) in [(0, 0), (0, 1), (1, 0), (1, 1)] {
            scene[3 * ((row + below) * side + column + right)..][..3].fill(255);
        }
        let out = shot(&mut camera, &scene);
        let mut sums = [0.0; 3];
        for (index, pixel) in out.chunks_exact(3).enumerate() {
            let weight = f64::from(pixel[0]);
            sums[0] += weight;
            sums[1] += weight * ((index % 64) as f64 + 0.5);
            sums[2] += weight * ((index / 64) as f64 + 0.5);
        }
        let bent = distortion.distort([21.0 / 61.5, -13.0 / 61.5]);
        for (axis, centre) in [31.5, 24.0].into_iter().enumerate() {
            let found = sums[1 + axis] / sums[0];
            let expected = 61.5 * bent[axis] + centre;
            assert!((found - expected).abs() < 0.3, "{axis}: {found} {expected}");
            let unbent = [21.0, -13.0][axis] + centre;
            assert!((expected - unbent).abs() > 0.5, "{axis}: too little to be seen");
        }
    }

    #[test]
    fn two_instants_are_blurred_and_colours_drift() {
        let mut camera = made(CameraImperfections::NO_IMPERFECTIONS);
        let (mut black, white) =
            (scene(&camera), vec![255; 3 * camera.ideal_camera().num_pixels()]);
        black.fill(0);
        let mut out = vec![0; 3 * 64 * 48];
        camera.take_picture(&[&black, &white], 0.0, &mut out).unwrap();
        assert!(out.iter().all(|&level| level == 188), "half of the light");
        let mut drifting = made(CameraImperfections {
            exposure_drift_sd: 0.1,
            ..CameraImperfections::NO_IMPERFECTIONS
        });
        let grey = vec![120; white.len()];
        let mut levels: Vec<u8> = Vec::new();
        for second in 0..20 {
            drifting.take_picture(&[&grey], f64::from(second), &mut out).unwrap();
            assert!(out.iter().all(|level| *level == out[0]));
            levels.push(out[0]);
        }
        levels.sort_unstable();
        assert!(levels[19] - levels[0] > 5, "{levels:?}");
    }

    #[test]
    fn equal_seeds_take_equal_pictures() {
        let [mut one, mut again] = [(); 2].map(|()| made(CameraImperfections::REALSENSE_D435));
        let scene = scene(&one);
        let first = shot(&mut one, &scene);
        assert_eq!(first, shot(&mut again, &scene));
        assert_ne!(first, shot(&mut one, &scene), "noise is fresh");
        let mut other =
            SimulatedCamera::new(small(), CameraImperfections::REALSENSE_D435, rng(1001)).unwrap();
        assert_ne!(first, shot(&mut other, &scene));
    }

    #[test]
    fn pictures_of_the_wrong_size_and_folding_lenses_are_refused() {
        let mut camera = made(CameraImperfections::NO_IMPERFECTIONS);
        let scene = scene(&camera);
        let mut out = vec![0; 3 * 64 * 48];
        assert!(camera.take_picture(&[&scene[3..]], 0.0, &mut out).is_err());
        assert!(camera.take_picture(&[&scene], 0.0, &mut out[3..]).is_err());
        let message = camera.take_picture(&[], 0.0, &mut out).unwrap_err().to_string();
        assert!(message.contains("at least one"), "{message}");
        let wide = CameraCalibration {
            intrinsics: Intrinsics { focal_lengths: [20.0; 2], ..small().intrinsics },
            distortion: LensDistortion::brown_conrady([-0.4, 0.0], [0.0; 2]),
            ..small()
        };
        let refused = SimulatedCamera::new(wide, CameraImperfections::NO_IMPERFECTIONS, rng(1000));
        let distortion_message = refused.unwrap_err().to_string();
        assert!(distortion_message.contains("`distortion`"), "{distortion_message}");
    }
}
