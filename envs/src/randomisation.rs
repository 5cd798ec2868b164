//! Settings of domain randomisation.

use serde::{Deserialize, Serialize};

use crate::camera::Camera;
use crate::error::{EnvError, require};

/// Largest standard deviation of the blur (pixels). The number of passes over a picture grows with
/// its square, up to 32.
const MAX_BLUR: f64 = 4.0;

/// Amounts of domain randomisation of pictures, so that a policy learns to tolerate the errors of a
/// real camera and of in-painting.
///
/// Camera pose, exposure, white balance and blur are drawn once per episode and also hold for its
/// first picture. Patches and noise are drawn for every picture. The gripper's mark is drawn last
/// and in its true place, because real pictures get it in the same way.
///
/// All distributions are symmetric under D2, so pictures of all variants are equally hard.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(default, deny_unknown_fields)]
pub struct VisualDomainRandomisation {
    /// Largest distance of the camera from its nominal position (mm, 0 to 100). The distance is
    /// uniform up to it, in a uniform direction.
    pub max_position_error_mm: f64,
    /// Largest angle by which the camera is rotated (degrees, 0 to 10): uniform up to it, about a
    /// uniform axis.
    pub max_angle_error_deg: f64,
    /// Standard deviation of the logarithm of the exposure (%, 0 to 100).
    pub exposure_sd: f64,
    /// Standard deviation of the logarithms of the red and the blue gain (%, 0 to 100).
    pub white_balance_sd: f64,
    /// Largest standard deviation of the blur (mm on the table, 0 to 4 pixels): uniform up to it.
    pub max_blur_mm: f64,
    /// Standard deviation of the noise of each pixel (levels of 255, 0 to 64).
    pub noise_sd: f64,
    /// Largest number of off-colour patches in a picture (0 to 100): uniform up to it. Patches are
    /// discs around the gripper, like the remains of an arm that was painted out.
    pub max_patches: usize,
    /// Largest radius of an off-colour patch (mm, 0 to 200): uniform up to it.
    pub max_patch_radius_mm: f64,
    /// Standard deviation of the colour error of a patch in each channel (levels of 255, 0 to 255).
    pub patch_color_sd: f64,
}

impl VisualDomainRandomisation {
    /// Amounts for pictures without any randomisation: all zero.
    pub const OFF: Self = Self {
        max_position_error_mm: 0.0,
        max_angle_error_deg: 0.0,
        exposure_sd: 0.0,
        white_balance_sd: 0.0,
        max_blur_mm: 0.0,
        noise_sd: 0.0,
        max_patches: 0,
        max_patch_radius_mm: 0.0,
        patch_color_sd: 0.0,
    };

    /// Amounts near those that `covers deploy` assumes: its mean error of the camera pose, its
    /// drift of exposure and white balance before correction, and the noise of a middle grey before
    /// a median reduces it.
    pub const NOMINAL: Self = Self {
        max_position_error_mm: 10.0,
        max_angle_error_deg: 1.0,
        exposure_sd: 10.0,
        white_balance_sd: 3.0,
        max_blur_mm: 8.0,
        noise_sd: 3.0,
        max_patches: 2,
        max_patch_radius_mm: 40.0,
        patch_color_sd: 40.0,
    };

    /// Rejects amounts of randomisation that are out of range for pictures of `camera`.
    ///
    /// # Errors
    /// [`EnvError::InvalidSetting`].
    pub fn check(&self, camera: &Camera) -> Result<(), EnvError> {
        let ranges = [
            (self.max_position_error_mm, 100.0, "max_position_error_mm", "0 to 100 mm"),
            (self.max_angle_error_deg, 10.0, "max_angle_error_deg", "0 to 10 degrees"),
            (self.exposure_sd, 100.0, "exposure_sd", "0 to 100 %"),
            (self.white_balance_sd, 100.0, "white_balance_sd", "0 to 100 %"),
            (self.noise_sd, 64.0, "noise_sd", "0 to 64 levels of 255"),
            (self.max_patch_radius_mm, 200.0, "max_patch_radius_mm", "0 to 200 mm"),
            (self.patch_color_sd, 255.0, "patch_color_sd", "0 to 255 levels"),
        ];
        for (amount, most, name, expected) in ranges {
            require((0.0..=most).contains(&amount), name, &amount, expected)?;
        }
        // in pixels, since the cost of a blur depends on them
        let blurred = (0.0..=MAX_BLUR).contains(&camera.millimetres_to_pixels(self.max_blur_mm));
        require(blurred, "max_blur_mm", &self.max_blur_mm, BLUR)?;
        require(
            self.sees_the_table(camera),
            "max_angle_error_deg",
            &self.max_angle_error_deg,
            SEEN,
        )?;
        let few = self.max_patches <= 100;
        require(few, "max_patches", &self.max_patches, "0 to 100")
    }
}

impl VisualDomainRandomisation {
    /// Returns `true` if the corners of a picture stay well below the horizon, whatever the
    /// rotation.
    fn sees_the_table(&self, camera: &Camera) -> bool {
        let corner = (2_f64.sqrt() * camera.half_extent / camera.height).atan();
        corner + self.max_angle_error_deg.to_radians() < 80_f64.to_radians()
    }
}

impl Default for VisualDomainRandomisation {
    fn default() -> Self {
        Self::NOMINAL
    }
}

const SEEN: &str = "degrees that leave the picture's corners 10 degrees below the horizon";
const BLUR: &str = "0 mm to 4 pixels of the picture";

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn amounts_out_of_range_are_refused_by_name() {
        let camera = Camera::default();
        VisualDomainRandomisation::OFF.check(&camera).unwrap();
        VisualDomainRandomisation::NOMINAL.check(&camera).unwrap();
        type Change = fn(&mut VisualDomainRandomisation);
        let changes: [(Change, &str); 9] = [
            (|of| of.max_position_error_mm = 101.0, "`max_position_error_mm` is 101"),
            (|of| of.max_angle_error_deg = -1.0, "`max_angle_error_deg` is -1"),
            (|of| of.exposure_sd = f64::NAN, "`exposure_sd` is NaN"),
            (|of| of.white_balance_sd = f64::INFINITY, "`white_balance_sd` is inf"),
            (|of| of.max_blur_mm = 80.0, "`max_blur_mm` is 80"),
            (|of| of.noise_sd = 65.0, "`noise_sd` is 65"),
            (|of| of.max_patches = 101, "`max_patches` is 101"),
            (|of| of.max_patch_radius_mm = 201.0, "`max_patch_radius_mm` is 201"),
            (|of| of.patch_color_sd = 256.0, "`patch_color_sd` is 256"),
        ];
        for (change, says) in changes {
            let mut amounts = VisualDomainRandomisation::NOMINAL;
            change(&mut amounts);
            let message = amounts.check(&camera).unwrap_err().to_string();
            assert!(message.contains(says), "{message}");
        }
    }

    #[test]
    fn a_wide_camera_may_turn_by_less() {
        let turned = VisualDomainRandomisation {
            max_angle_error_deg: 10.0,
            ..VisualDomainRandomisation::NOMINAL
        };
        turned.check(&Camera::default()).unwrap();
        let wide = Camera { height: 0.6, half_extent: 2.0, ..Camera::default() };
        let message = turned.check(&wide).unwrap_err().to_string();
        assert!(message.contains("below the horizon"), "{message}");
        VisualDomainRandomisation::NOMINAL.check(&wide).unwrap();
    }

    #[test]
    fn what_is_missing_in_a_file_is_nominal_and_what_is_unknown_is_refused() {
        let read = serde_json::from_str::<VisualDomainRandomisation>;
        assert_eq!(read("{}").unwrap(), VisualDomainRandomisation::NOMINAL);
        let little = read(r#"{"noise_sd": 0.5}"#).unwrap();
        let expected =
            VisualDomainRandomisation { noise_sd: 0.5, ..VisualDomainRandomisation::NOMINAL };
        assert_eq!(little, expected);
        let message = read(r#"{"nois": 1}"#).unwrap_err().to_string();
        assert!(message.contains("nois"), "{message}");
    }
}
