//! Lens distortion.

use std::ops::Add;

use crate::error::{InpaintingError, require};

/// Maximum number of steps of Newton's method for an inverse.
const STEPS: usize = 50;
/// Largest error of an inverse (focal lengths).
const PRECISION: f64 = 1e-13;
/// Largest coefficient of a lens that still shows straight lines as nearly straight.
const LARGEST: f64 = 0.5;

/// Radial and tangential distortion (Brown, "Close-Range Camera Calibration", Photogrammetric
/// Engineering 37(8), 1971), with the names and order of coefficients of OpenCV and librealsense.
///
/// Points are in focal lengths from the optical axis, x right and y down.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Distortion {
    /// Coefficients k1 and k2, of the second and fourth power of the distance from the axis.
    pub radial: [f64; 2],
    /// Coefficients p1 and p2, of a lens that is tilted or off the axis.
    pub tangential: [f64; 2],
}

impl Distortion {
    /// No distortion: a pinhole.
    pub const NONE: Self = Self { radial: [0.0; 2], tangential: [0.0; 2] };

    pub(crate) fn check(&self) -> Result<(), InpaintingError> {
        let [k1, k2] = self.radial;
        let [p1, p2] = self.tangential;
        let small = [k1, k2, p1, p2].iter().all(|k| k.abs() <= LARGEST);
        let value = format!("{self:?}");
        require(small, "distortion", &value, "four numbers in -0.5..=0.5")
    }

    /// Distorts `point`: returns the point at which the lens shows what a pinhole shows there.
    pub fn apply(&self, point: [f64; 2]) -> [f64; 2] {
        self.bend(point).0
    }

    /// Undistorts `point`: returns the point at which a pinhole shows what the lens shows there.
    /// `None` if the lens shows nothing there, or beyond a fold of the formula.
    pub fn invert(&self, point: [f64; 2]) -> Option<[f64; 2]> {
        let [mut x, mut y] = point;
        for _ in 0..STEPS {
            let ([u, v], [[ux, uy], [vx, vy]]) = self.bend([x, y]);
            let (du, dv) = (point[0] - u, point[1] - v);
            if du.abs().max(dv.abs()) <= PRECISION {
                return Some([x, y]);
            }
            let determinant = ux * vy - uy * vx;
            // beyond the fold, where the determinant vanishes, the picture is mirrored
            if determinant <= 0.0 {
                return None;
            }
            x += (vy * du - uy * dv) / determinant;
            y += (ux * dv - vx * du) / determinant;
        }
        None
    }

    /// Returns the distorted point, and its derivatives with respect to x and y.
    pub(crate) fn bend(&self, [x, y]: [f64; 2]) -> ([f64; 2], [[f64; 2]; 2]) {
        let ([k1, k2], [p1, p2]) = (self.radial, self.tangential);
        let square = x * x + y * y;
        let radial = 1.0 + square * (k1 + square * k2);
        // the derivative of `radial` with respect to x is 2 x times this
        let slope = k1 + 2.0 * k2 * square;
        let bent = [
            x * radial + 2.0 * p1 * x * y + p2 * (square + 2.0 * x * x),
            y * radial + p1 * (square + 2.0 * y * y) + 2.0 * p2 * x * y,
        ];
        let mixed = 2.0 * (x * y * slope + p1 * x + p2 * y);
        let across = radial + 2.0 * x * x * slope + 2.0 * p1 * y + 6.0 * p2 * x;
        let down = radial + 2.0 * y * y * slope + 6.0 * p1 * y + 2.0 * p2 * x;
        (bent, [[across, mixed], [mixed, down]])
    }
}

impl Add for Distortion {
    type Output = Self;

    /// Adds the coefficients.
    fn add(self, other: Self) -> Self {
        let sum = |a: [f64; 2], b: [f64; 2]| [a[0] + b[0], a[1] + b[1]];
        Self {
            radial: sum(self.radial, other.radial),
            tangential: sum(self.tangential, other.tangential),
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn distortion() -> impl Strategy<Value = Distortion> {
        let radial = prop::array::uniform2(-0.05..0.05);
        let tangential = prop::array::uniform2(-0.005..0.005);
        (radial, tangential).prop_map(|(radial, tangential)| Distortion { radial, tangential })
    }

    proptest! {
        #[test]
        fn bent_points_come_back(
            lens in distortion(),
            point in prop::array::uniform2(-0.6..0.6),
        ) {
            let back = lens.invert(lens.apply(point)).unwrap();
            for axis in 0..2 {
                prop_assert!((back[axis] - point[axis]).abs() < 1e-12, "{back:?}");
            }
        }

        #[test]
        fn derivatives_are_differences(
            lens in distortion(),
            point in prop::array::uniform2(-0.6..0.6),
        ) {
            let (_, derivatives) = lens.bend(point);
            for axis in 0..2 {
                let [mut low, mut high] = [point; 2];
                low[axis] -= 1e-6;
                high[axis] += 1e-6;
                let (low, high) = (lens.apply(low), lens.apply(high));
                for row in 0..2 {
                    let slope = (high[row] - low[row]) / 2e-6;
                    prop_assert!((derivatives[row][axis] - slope).abs() < 1e-8, "{slope}");
                }
            }
        }
    }

    /// cv2.projectPoints([[0.4, -0.3, 1]], 0, 0, eye(3), [0.03, -0.02, 0.001, -0.0005]) by hand.
    #[test]
    fn the_coefficients_are_opencvs() {
        let lens = Distortion { radial: [0.03, -0.02], tangential: [0.001, -0.0005] };
        let radial = 1.0 + 0.03 * 0.25 - 0.02 * 0.0625;
        let u = 0.4 * radial + 2.0 * 0.001 * 0.4 * -0.3 - 0.0005 * (0.25 + 2.0 * 0.16);
        let v = -0.3 * radial + 0.001 * (0.25 + 2.0 * 0.09) - 2.0 * 0.0005 * 0.4 * -0.3;
        let [x, y] = lens.apply([0.4, -0.3]);
        assert!((x - u).abs() < 1e-15 && (y - v).abs() < 1e-15);
        assert_eq!(Distortion::NONE.apply([0.4, -0.3]), [0.4, -0.3]);
    }

    #[test]
    fn a_point_beyond_the_fold_has_no_inverse() {
        let barrel = Distortion { radial: [-0.5, 0.0], ..Distortion::NONE };
        assert!(barrel.invert([0.4, 0.0]).is_some());
        assert!(barrel.invert([0.9, 0.0]).is_none());
    }
}
