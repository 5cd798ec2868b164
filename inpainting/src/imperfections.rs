//! What is wrong with a real camera, as figures.

use crate::distortion::Distortion;
use crate::error::{InpaintingError, require, require_positive};

/// How far a simulated camera is from a perfect one whose calibration is exact.
///
/// Lengths are in metres, times in seconds, angles in radians. Light is linear, with 1 for white.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Imperfections {
    /// Distortion that the calibration does not know of.
    pub distortion: Distortion,
    /// How far the camera is from where the calibration has it, in a random direction.
    pub position_error: f64,
    /// How far it is turned from how the calibration has it, about a random axis.
    pub angle_error: f64,
    /// Standard deviation of the logarithm of the exposure, which wanders.
    pub exposure_drift: f64,
    /// Standard deviation of the logarithms of the gains of red and of blue, which wander.
    pub balance_drift: f64,
    /// Time in which what wanders forgets where it was.
    pub drift_time: f64,
    /// Variance of a pixel's light over the light: the light comes in quanta.
    pub shot_noise: f64,
    /// Standard deviation that a pixel's light has in the dark.
    pub read_noise: f64,
    /// How long light is collected: what moves is blurred.
    pub exposure_time: f64,
    /// From the end of that time until the picture can be read.
    pub latency: f64,
}

impl Imperfections {
    /// None: the camera shows the present as its calibration has it.
    pub const OFF: Self = Self {
        distortion: Distortion::NONE,
        position_error: 0.0,
        angle_error: 0.0,
        exposure_drift: 0.0,
        balance_drift: 0.0,
        drift_time: 5.0,
        shot_noise: 0.0,
        read_noise: 0.0,
        exposure_time: 0.0,
        latency: 0.0,
    };

    /// A RealSense D435 that was calibrated with care: 5 mm and half a degree are what tools for
    /// hand-eye calibration commonly reach. Its driver states no distortion, and some is left. The
    /// noise at a middle grey is 3 levels of 255. The exposure is the sensor's default, rounded.
    pub const NOMINAL: Self = Self {
        distortion: Distortion { radial: [0.01, -0.01], tangential: [0.0005, -0.0005] },
        position_error: 0.005,
        angle_error: 0.5_f64.to_radians(),
        exposure_drift: 0.1,
        balance_drift: 0.03,
        drift_time: 5.0,
        shot_noise: 5e-4,
        read_noise: 1.5e-3,
        exposure_time: 0.0125,
        latency: 0.06,
    };

    /// Refuses figures out of range.
    ///
    /// # Errors
    /// [`InpaintingError::Value`].
    pub fn check(&self) -> Result<(), InpaintingError> {
        self.distortion.check()?;
        let ranges = [
            ("position_error", self.position_error, 0.1, "0 to 0.1 m"),
            ("angle_error", self.angle_error, 0.2, "0 to 0.2 rad"),
            ("exposure_drift", self.exposure_drift, 1.0, "0 to 1"),
            ("balance_drift", self.balance_drift, 1.0, "0 to 1"),
            ("shot_noise", self.shot_noise, 1.0, "0 to 1"),
            ("read_noise", self.read_noise, 1.0, "0 to 1"),
            ("exposure_time", self.exposure_time, 1.0, "0 to 1 s"),
            ("latency", self.latency, 1.0, "0 to 1 s"),
        ];
        for (name, value, most, expected) in ranges {
            require((0.0..=most).contains(&value), name, &value, expected)?;
        }
        let expected = "a positive time in seconds";
        require_positive("drift_time", self.drift_time, expected)
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn figures_out_of_range_are_named() {
        Imperfections::OFF.check().unwrap();
        Imperfections::NOMINAL.check().unwrap();
        type Change = fn(&mut Imperfections);
        let changes: [(Change, &str); 5] = [
            (|of| of.latency = -0.1, "`latency` is -0.1"),
            (|of| of.angle_error = 0.5, "`angle_error` is 0.5"),
            (|of| of.shot_noise = f64::NAN, "`shot_noise` is NaN"),
            (|of| of.drift_time = 0.0, "`drift_time` is 0"),
            (|of| of.distortion.radial[1] = 2.0, "`distortion`"),
        ];
        for (change, says) in changes {
            let mut imperfections = Imperfections::NOMINAL;
            change(&mut imperfections);
            let message = imperfections.check().unwrap_err().to_string();
            assert!(message.contains(says), "{message}");
        }
    }
}
