//! Settings of domain randomisation.

use serde::{Deserialize, Serialize};

use crate::camera::Camera;
use crate::error::{EnvError, require};

/// Largest blur (pixels). The number of passes over a picture grows with its square, up to 32.
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
pub struct Randomisation {
    /// Largest distance of the camera from its nominal position (mm, 0 to 100). The distance is
    /// uniform up to it, in a uniform direction.
    pub position_error: f64,
    /// Largest rotation of the camera (degrees, 0 to 10): uniform up to it, about a uniform axis.
    pub angle_error: f64,
    /// Standard deviation of the logarithm of the exposure (%, 0 to 100).
    pub exposure: f64,
    /// Standard deviation of the logarithms of the red and the blue gain (%, 0 to 100).
    pub balance: f64,
    /// Largest standard deviation of the blur (mm on the table, 0 to 4 pixels): uniform up to it.
    pub blur: f64,
    /// Standard deviation of the noise (levels of 255, 0 to 64).
    pub noise: f64,
    /// Largest number of off-colour patches in a picture (0 to 100): uniform up to it. Patches are
    /// discs around the gripper, like the remains of an arm that was painted out.
    pub patches: usize,
    /// Largest radius of a patch (mm, 0 to 200): uniform up to it.
    pub patch_radius: f64,
    /// Standard deviation of a patch's error in each channel (levels of 255, 0 to 255).
    pub patch_color: f64,
}

impl Randomisation {
    /// Amounts for pictures without any randomisation: all zero.
    pub const OFF: Self = Self {
        position_error: 0.0,
        angle_error: 0.0,
        exposure: 0.0,
        balance: 0.0,
        blur: 0.0,
        noise: 0.0,
        patches: 0,
        patch_radius: 0.0,
        patch_color: 0.0,
    };

    /// Amounts near those that `covers deploy` assumes: its mean error of the camera pose, its
    /// drift of exposure and white balance before correction, and the noise of a middle grey before
    /// a median reduces it.
    pub const NOMINAL: Self = Self {
        position_error: 10.0,
        angle_error: 1.0,
        exposure: 10.0,
        balance: 3.0,
        blur: 8.0,
        noise: 3.0,
        patches: 2,
        patch_radius: 40.0,
        patch_color: 40.0,
    };

    /// Rejects amounts out of range for pictures of `camera`.
    ///
    /// # Errors
    /// [`EnvError::Setting`].
    pub fn check(&self, camera: &Camera) -> Result<(), EnvError> {
        let ranges = [
            (self.position_error, 100.0, "position_error", "0 to 100 mm"),
            (self.angle_error, 10.0, "angle_error", "0 to 10 degrees"),
            (self.exposure, 100.0, "exposure", "0 to 100 %"),
            (self.balance, 100.0, "balance", "0 to 100 %"),
            (self.noise, 64.0, "noise", "0 to 64 levels of 255"),
            (self.patch_radius, 200.0, "patch_radius", "0 to 200 mm"),
            (self.patch_color, 255.0, "patch_color", "0 to 255 levels"),
        ];
        for (amount, most, name, expected) in ranges {
            require((0.0..=most).contains(&amount), name, &amount, expected)?;
        }
        // in pixels, since the cost of a blur depends on them
        let blurred = (0.0..=MAX_BLUR).contains(&camera.pixels(self.blur));
        require(blurred, "blur", &self.blur, BLUR)?;
        require(self.sees_the_table(camera), "angle_error", &self.angle_error, SEEN)?;
        let few = self.patches <= 100;
        require(few, "patches", &self.patches, "0 to 100")
    }
}

impl Randomisation {
    /// Returns `true` if the corners of a picture stay well below the horizon, whatever the
    /// rotation.
    fn sees_the_table(&self, camera: &Camera) -> bool {
        let corner = (2_f64.sqrt() * camera.half_extent / camera.height).atan();
        corner + self.angle_error.to_radians() < 80_f64.to_radians()
    }
}

impl Default for Randomisation {
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
        Randomisation::OFF.check(&camera).unwrap();
        Randomisation::NOMINAL.check(&camera).unwrap();
        type Change = fn(&mut Randomisation);
        let changes: [(Change, &str); 9] = [
            (|of| of.position_error = 101.0, "`position_error` is 101"),
            (|of| of.angle_error = -1.0, "`angle_error` is -1"),
            (|of| of.exposure = f64::NAN, "`exposure` is NaN"),
            (|of| of.balance = f64::INFINITY, "`balance` is inf"),
            (|of| of.blur = 80.0, "`blur` is 80"),
            (|of| of.noise = 65.0, "`noise` is 65"),
            (|of| of.patches = 101, "`patches` is 101"),
            (|of| of.patch_radius = 201.0, "`patch_radius` is 201"),
            (|of| of.patch_color = 256.0, "`patch_color` is 256"),
        ];
        for (change, says) in changes {
            let mut amounts = Randomisation::NOMINAL;
            change(&mut amounts);
            let message = amounts.check(&camera).unwrap_err().to_string();
            assert!(message.contains(says), "{message}");
        }
    }

    #[test]
    fn a_wide_camera_may_turn_by_less() {
        let turned = Randomisation { angle_error: 10.0, ..Randomisation::NOMINAL };
        turned.check(&Camera::default()).unwrap();
        let wide = Camera { height: 0.6, half_extent: 2.0, ..Camera::default() };
        let message = turned.check(&wide).unwrap_err().to_string();
        assert!(message.contains("below the horizon"), "{message}");
        Randomisation::NOMINAL.check(&wide).unwrap();
    }

    #[test]
    fn what_is_missing_in_a_file_is_nominal_and_what_is_unknown_is_refused() {
        let read = serde_json::from_str::<Randomisation>;
        assert_eq!(read("{}").unwrap(), Randomisation::NOMINAL);
        let little = read(r#"{"noise": 0.5}"#).unwrap();
        let expected = Randomisation { noise: 0.5, ..Randomisation::NOMINAL };
        assert_eq!(little, expected);
        let message = read(r#"{"nois": 1}"#).unwrap_err().to_string();
        assert!(message.contains("nois"), "{message}");
    }
}
