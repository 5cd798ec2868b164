//! Parameters of the imperfections of a simulated camera.

use crate::distortion::LensDistortion;
use crate::error::{InpaintingError, require_positive, require_that};

/// Deviations of a simulated camera from a perfect one with an exact calibration.
///
/// Lengths are in metres, times in seconds, angles in radians. Light is linear, with 1 for white.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct CameraImperfections {
    /// Lens distortion that is missing in the calibration.
    pub distortion: LensDistortion,
    /// Distance between the camera's true and calibrated positions, in a random direction (metres).
    pub position_error: f64,
    /// Angle between the camera's true and calibrated orientations, about a random axis (radians).
    pub angle_error: f64,
    /// Standard deviation of the logarithm of the exposure, which drifts.
    pub exposure_drift_sd: f64,
    /// Standard deviation of the logarithms of the gains of red and of blue, which drift.
    pub white_balance_drift_sd: f64,
    /// Correlation time of the drift of gains (seconds): after it, the correlation has fallen to 1
    /// / e.
    pub drift_correlation_time: f64,
    /// Variance of a pixel's light divided by the light, from the quanta of the light.
    pub shot_noise_variance: f64,
    /// Standard deviation of a pixel's light in the dark.
    pub read_noise_sd: f64,
    /// Time over which light is collected (seconds), which causes motion blur.
    pub exposure_time: f64,
    /// Delay from the end of the exposure until the picture can be read (seconds).
    pub latency: f64,
}

impl CameraImperfections {
    /// Imperfections of a perfect camera: the calibration is exact, and pictures have no delay.
    pub const NO_IMPERFECTIONS: Self = Self {
        distortion: LensDistortion::NONE,
        position_error: 0.0,
        angle_error: 0.0,
        exposure_drift_sd: 0.0,
        white_balance_drift_sd: 0.0,
        drift_correlation_time: 5.0,
        shot_noise_variance: 0.0,
        read_noise_sd: 0.0,
        exposure_time: 0.0,
        latency: 0.0,
    };

    /// Imperfections of a carefully calibrated RealSense D435.
    ///
    /// Tools for hand-eye calibration commonly reach 5 mm and half a degree. The driver states no
    /// distortion, but some is left. The noise at a middle grey is 3 levels of 255. The exposure is
    /// the sensor's default, rounded.
    pub const REALSENSE_D435: Self = Self {
        distortion: LensDistortion::brown_conrady([0.01, -0.01], [0.0005, -0.0005]),
        position_error: 0.005,
        angle_error: 0.5_f64.to_radians(),
        exposure_drift_sd: 0.1,
        white_balance_drift_sd: 0.03,
        drift_correlation_time: 5.0,
        shot_noise_variance: 5e-4,
        read_noise_sd: 1.5e-3,
        exposure_time: 0.0125,
        latency: 0.06,
    };

    /// Rejects camera imperfections that are out of range.
    ///
    /// # Errors
    /// [`InpaintingError::InvalidValue`].
    pub fn check(&self) -> Result<(), InpaintingError> {
        self.distortion.check()?;
        let ranges = [
            ("position_error", self.position_error, 0.1, "0 to 0.1 m"),
            ("angle_error", self.angle_error, 0.2, "0 to 0.2 rad"),
            ("exposure_drift_sd", self.exposure_drift_sd, 1.0, "0 to 1"),
            ("white_balance_drift_sd", self.white_balance_drift_sd, 1.0, "0 to 1"),
            ("shot_noise_variance", self.shot_noise_variance, 1.0, "0 to 1"),
            ("read_noise_sd", self.read_noise_sd, 1.0, "0 to 1"),
            ("exposure_time", self.exposure_time, 1.0, "0 to 1 s"),
            ("latency", self.latency, 1.0, "0 to 1 s"),
        ];
        for (name, value, limit, expected) in ranges {
            require_that((0.0..=limit).contains(&value), name, &value, expected)?;
        }
        require_positive(
            "drift_correlation_time",
            self.drift_correlation_time,
            "a positive time in seconds",
        )
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_out_of_range_are_named() {
        CameraImperfections::NO_IMPERFECTIONS.check().unwrap();
        CameraImperfections::REALSENSE_D435.check().unwrap();
        type Change = fn(&mut CameraImperfections);
        let changes: [(Change, &str); 5] = [
            (|of| of.latency = -0.1, "`latency` is -0.1"),
            (|of| of.angle_error = 0.5, "`angle_error` is 0.5"),
            (|of| of.shot_noise_variance = f64::NAN, "`shot_noise_variance` is NaN"),
            (|of| of.drift_correlation_time = 0.0, "`drift_correlation_time` is 0"),
            (|of| of.distortion.radial[1] = f64::NAN, "`distortion`"),
        ];
        for (change, says) in changes {
            let mut imperfections = CameraImperfections::REALSENSE_D435;
            change(&mut imperfections);
            let message = imperfections.check().unwrap_err().to_string();
            assert!(message.contains(says), "{message}");
        }
    }
}
