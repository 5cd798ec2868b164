//! Top-down camera: projection, light, and the mark over the gripper.

use std::ops::RangeInclusive;

use glam::{DQuat, DVec3};
use serde::{Deserialize, Serialize};

use crate::error::{EnvError, require};

mod compose;

pub use compose::ObservationPictures;

/// Number of colour channels of one picture: red, green and blue.
pub const RGB_CHANNELS: usize = 3;
/// Largest side of a drawn picture (pixels).
const MAX_SIDE: usize = 4096;
/// Range of the number of drawn pixels along each side of an observed pixel.
pub(crate) const OVERSAMPLING_RANGE: RangeInclusive<usize> = 1..=8;
/// Lowest height of the camera above the table (metres). A camera at or below the hand would
/// project it mirrored.
const MIN_HEIGHT: f64 = 0.6;
/// Largest radius of the mark at the gripper (metres).
const MAX_MARK_RADIUS: f64 = 0.2;
/// Largest shift of a misaligned camera along either axis (mm).
const MAX_SHIFT: f64 = 200.0;
/// Largest tilt of a misaligned camera about either axis (degrees).
const MAX_TILT: f64 = 20.0;

/// Settings of the top-down camera above the table: its pictures, height, light, and the mark over
/// the gripper. A trained policy depends on them, so they serialise.
///
/// A square pinhole camera looks straight down on the table's centre, unless it is misaligned;
/// image up is +y, image right is +x. There are no shadows and no reflections.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Camera {
    /// Number of pixels along either side of an observed picture; even, so that flips map pixels to
    /// pixels.
    pub size: usize,
    /// Number of drawn pixels along each side of an observed pixel, 1 to 8 (1 if a file has no
    /// value). An observed pixel is their mean, so an edge can move by less than a pixel.
    #[serde(default = "one")]
    pub oversampling: usize,
    /// Height of the camera above the table (metres).
    pub height: f64,
    /// Half the side of the visible square of the table (metres). Together with the height it sets
    /// the field of view.
    pub half_extent: f64,
    /// Unlit colour of the floor around the table, RGB in `[0, 1]`.
    pub background: [f64; 3],
    /// Light sources of the scene.
    pub light: Light,
    /// Mark that is drawn over the gripper in the pictures.
    pub mark: GripperMark,
    /// Pictures that an observation holds besides the current one; the first picture if a file has
    /// no value.
    #[serde(default, rename = "beside")]
    pub extra_views: ExtraViews,
    /// Fixed error of the camera's pose; none if a file has no value.
    #[serde(default)]
    pub misalignment: Misalignment,
    /// Share of the episodes of training, 0 to 1, in which objects that the arm hides stay as they
    /// were last seen, as behind a robot's camera; above 0 only with an arm that has servos. The
    /// camera must be aligned then.
    #[serde(default)]
    pub arm_occlusion: f64,
}

/// Fixed error of the camera's pose, which breaks the symmetry of the pictures. Observations do not
/// correct it: the mark and close-ups are placed as if there were none.
#[derive(Clone, Copy, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Misalignment {
    /// Shift of the camera along x and y, each at most 200 either way (mm).
    pub shift_mm: [f64; 2],
    /// Rotation of the camera about x and rotation about y (degrees), each at most 20 either way.
    /// The one about y is done first.
    /// A positive rotation about x turns the view towards +y, one about y towards -x.
    pub tilt_degrees: [f64; 2],
}

/// White light that is symmetric under D2 if the camera is aligned: ambient, from the camera and
/// from straight above. A surface that faces the camera shows its colour times the sum of the
/// three.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Light {
    /// Intensity of the ambient light, in `[0, 1]`.
    pub ambient: f64,
    /// Intensity of the light from the camera, in `[0, 1]`.
    pub camera: f64,
    /// Intensity of the light from straight above, in `[0, 1]`.
    pub overhead: f64,
}

/// Disc or ring that is drawn over the gripper. Its size in the picture is that of one on the
/// table, whatever the gripper's height.
#[derive(Clone, Copy, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GripperMark {
    /// Outer radius of the mark (metres); 0 draws nothing.
    pub radius: f64,
    /// Radius of the hole in the mark (metres); 0 for a filled disc.
    pub hole: f64,
    /// Colour of the mark: red, green and blue, 0 to 255.
    pub color: [u8; 3],
}

impl Default for Camera {
    fn default() -> Self {
        Self {
            size: 48,
            oversampling: 1,
            height: 1.5,
            half_extent: 0.44,
            background: [0.73, 0.74, 0.74],
            light: Light::default(),
            mark: GripperMark::default(),
            extra_views: ExtraViews::default(),
            misalignment: Misalignment::default(),
            arm_occlusion: 0.0,
        }
    }
}

impl Default for Light {
    fn default() -> Self {
        Self { ambient: 0.4, camera: 0.4, overhead: 0.3 }
    }
}

impl Default for GripperMark {
    fn default() -> Self {
        Self { radius: 0.03, hole: 0.0, color: [0, 0, 255] }
    }
}

impl Camera {
    /// Rejects a camera with an odd picture size or a value out of range.
    ///
    /// # Errors
    /// [`EnvError::InvalidSetting`].
    pub fn check(&self) -> Result<(), EnvError> {
        let even = (2..=MAX_SIDE).contains(&self.size) && self.size.is_multiple_of(2);
        require(even, "image size", &self.size, SIZE)?;
        let samples = OVERSAMPLING_RANGE.contains(&self.oversampling);
        require(samples, "oversampling", &self.oversampling, SAMPLES)?;
        let drawn = self.rendered_size();
        require(drawn <= MAX_SIDE, "image size times oversampling", &drawn, DRAWN)?;
        let high = self.height >= MIN_HEIGHT && self.height.is_finite();
        require(high, "camera height", &self.height, HEIGHT)?;
        let wide = self.half_extent > 0.0 && self.half_extent.is_finite();
        require(wide, "camera half extent", &self.half_extent, LENGTH)?;
        self.light.check()?;
        for value in self.background {
            require((0.0..=1.0).contains(&value), "background", &value, SHARE)?;
        }
        self.misalignment.check()?;
        let occlusion = self.arm_occlusion;
        require((0.0..=1.0).contains(&occlusion), "camera.arm_occlusion", &occlusion, SHARE)?;
        // the arm is masked where an aligned camera sees it
        let masked = occlusion == 0.0 || self.is_aligned();
        require(masked, "camera.arm_occlusion", &occlusion, ALIGNED)?;
        self.mark.check()
    }

    /// Returns `true` if the camera looks straight down on the table's centre.
    pub fn is_aligned(&self) -> bool {
        self.misalignment == Misalignment::default()
    }

    /// Returns the last part of a scene's MJCF: the camera, its light, the floor's material and the
    /// camera `perspective` for viewers.
    pub(crate) fn to_mjcf(self, name: &str) -> String {
        let fovy = 2.0 * (self.half_extent / self.height).atan().to_degrees();
        let height = self.height;
        let [x, y] = self.misalignment.shift_mm.map(|shift| shift / 1e3);
        let DQuat { x: i, y: j, z: k, w } = self.misalignment.rotation();
        let [r, g, b] = self.background;
        let Light { ambient, camera, overhead } = self.light;
        format!(
            r#"<asset><material name="floor" rgba="{r} {g} {b} 1"/></asset>
            <visual><headlight ambient="{ambient} {ambient} {ambient}" diffuse="{camera} {camera} {camera}" specular="0 0 0"/></visual>
            <worldbody>
              <light name="overhead" directional="true" castshadow="true" pos="0 0 3" dir="0 0 -1"
                     diffuse="{overhead} {overhead} {overhead}" specular="0 0 0"/>
              <camera name="{name}" pos="{x} {y} {height}" quat="{w} {i} {j} {k}" fovy="{fovy}"/>
              <camera name="perspective" pos="0.95 0.75 0.85" fovy="40"
                      xyaxes="-0.6441 0.7649 0 -0.4142 -0.3488 0.8407"/>
            </worldbody>"#
        )
    }

    /// Projects a world point (metres) to the image of the aligned camera: pixels right of and above
    /// the image's centre.
    ///
    /// Mirroring the point negates the result exactly.
    pub fn project(&self, point: DVec3) -> [f64; 2] {
        let scale = self.pixels_per_metre() * self.height / (self.height - point.z);
        [point.x * scale, point.y * scale]
    }

    fn pixels_per_metre(&self) -> f64 {
        self.size as f64 / (2.0 * self.half_extent)
    }

    /// Converts a length on the table from millimetres to pixels.
    pub(crate) fn millimetres_to_pixels(&self, millimetres: f64) -> f64 {
        millimetres / 1e3 * self.pixels_per_metre()
    }

    /// Draws `mark` over `rgb` `[size, size, 3]`, centred on the projection of `point` (metres).
    pub fn draw_gripper_mark(&self, mark: &GripperMark, point: DVec3, rgb: &mut [u8]) {
        let [u, v] = self.project(point);
        let radii = [mark.radius, mark.hole].map(|r| r * self.pixels_per_metre());
        for_each_ring_pixel([u, -v], radii, self.size, |pixel| {
            rgb[pixel * 3..][..3].copy_from_slice(&mark.color);
        });
    }
}

/// Calls `visit` with the index of every pixel of a picture `[size, size]` whose centre is nearer
/// than `radii[0]`, but not nearer than `radii[1]`, to the point `offset` (right, down) from the
/// picture's centre. All lengths are in pixels. Mirroring the offset mirrors the ring exactly.
pub(crate) fn for_each_ring_pixel(
    offset: [f64; 2],
    radii: [f64; 2],
    size: usize,
    mut visit: impl FnMut(usize),
) {
    let middle = size as f64 / 2.0;
    // pixels outside of this box cannot be reached; the test below decides the rest
    let reach = |axis: usize| {
        let [low, high] = [-1.0, 1.0].map(|side| middle + offset[axis] + side * (radii[0] + 1.0));
        let pixel = |value: f64| value.clamp(0.0, size as f64) as usize;
        pixel(low)..pixel(high)
    };
    // squared once, as every pixel compares squares
    let squares = radii.map(|radius| radius * radius);
    for row in reach(1) {
        // in this order, since (row + 0.5) - middle is exact and negates exactly under a flip
        let dy = ((row as f64 + 0.5) - middle) - offset[1];
        for column in reach(0) {
            let dx = ((column as f64 + 0.5) - middle) - offset[0];
            let distance = dx * dx + dy * dy;
            if distance < squares[0] && distance >= squares[1] {
                visit(row * size + column);
            }
        }
    }
}

impl Misalignment {
    fn check(&self) -> Result<(), EnvError> {
        for shift in self.shift_mm {
            require(shift.abs() <= MAX_SHIFT, "misalignment shift_mm", &shift, SHIFT)?;
        }
        for tilt in self.tilt_degrees {
            require(tilt.abs() <= MAX_TILT, "misalignment tilt_degrees", &tilt, TILT)?;
        }
        Ok(())
    }

    fn rotation(&self) -> DQuat {
        let [x, y] = self.tilt_degrees.map(f64::to_radians);
        DQuat::from_rotation_x(x) * DQuat::from_rotation_y(y)
    }
}

impl Light {
    fn check(&self) -> Result<(), EnvError> {
        let named = [
            ("ambient light", self.ambient),
            ("camera light", self.camera),
            ("overhead light", self.overhead),
        ];
        let share = |(name, value)| require((0.0..=1.0).contains(&value), name, &value, SHARE);
        named.into_iter().try_for_each(share)
    }
}

impl GripperMark {
    fn check(&self) -> Result<(), EnvError> {
        let drawn = (0.0..=MAX_MARK_RADIUS).contains(&self.radius);
        require(drawn, "mark radius", &self.radius, RADIUS)?;
        let inside = (0.0..=self.radius).contains(&self.hole);
        require(inside, "mark hole", &self.hole, HOLE)
    }
}

fn one() -> usize {
    1
}

const SIZE: &str = "an even number of pixels in 2..=4096, so that the centre lies between pixels";
const SAMPLES: &str = "a number in 1..=8";
const DRAWN: &str = "at most 4096 pixels, the largest picture that is drawn";
const HEIGHT: &str = "at least 0.6 m, above everything that the hand can reach";
const LENGTH: &str = "a positive length in metres";
const ALIGNED: &str = "0 with a misaligned camera (`camera.misalignment`)";
const SHARE: &str = "a number in 0..=1";
const RADIUS: &str = "0 for no mark, or at most 0.2 m: a larger one hides the table";
const SHIFT: &str = "at most 200 mm either way";
const TILT: &str = "at most 20 degrees either way";
const HOLE: &str = "a length in metres from 0 (a disc) to the mark's radius";

/// Pictures that follow the current one in an observation's image, three channels each.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "snake_case", deny_unknown_fields)]
pub enum ExtraViews {
    /// First picture of the episode, which makes 6 channels with the current one.
    #[default]
    First,
    /// Close-up of the table below the hand, without the gripper's mark, which shows objects
    /// relative to the hand. It is cut out of the rendered picture, so the table is
    /// [`Camera::oversampling`](crate::Camera::oversampling) times as large as in the whole
    /// picture. The area beyond the picture is grey.
    CloseUp,
    /// First picture of the episode, then the close-up; 9 channels with the current picture.
    FirstAndCloseUp,
}

impl ExtraViews {
    /// Returns the number of channels of an observation's image: 6 or 9.
    pub const fn num_total_channels(self) -> usize {
        match self {
            Self::First | Self::CloseUp => 2 * RGB_CHANNELS,
            Self::FirstAndCloseUp => 3 * RGB_CHANNELS,
        }
    }

    /// Returns the number of an image's last channels that are constant during an episode, so that
    /// they need to be stored only once: 3 or 0.
    pub const fn num_constant_channels(self) -> usize {
        match self {
            Self::First => RGB_CHANNELS,
            Self::CloseUp | Self::FirstAndCloseUp => 0,
        }
    }
}

#[cfg(test)]
mod tests;
