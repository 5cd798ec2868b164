//! Lens distortion.

use std::fmt;
use std::ops::Add;

use crate::error::{InpaintingError, require_that};

/// Maximum number of steps of Newton's method for the inverse of a distortion.
const STEPS: usize = 50;
/// Largest error of the inverse of a distortion (focal lengths).
const PRECISION: f64 = 1e-13;

/// Radial and tangential distortion (Brown, "Close-Range Camera Calibration", Photogrammetric
/// Engineering 37(8), 1971), with the names of coefficients of OpenCV and its rational model.
///
/// Points are in focal lengths from the optical axis, x right and y down.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct LensDistortion {
    /// Coefficients k1 to k6. At the distance r from the axis the lens magnifies by
    /// (1 + k1 r^2 + k2 r^4 + k3 r^6) / (1 + k4 r^2 + k5 r^4 + k6 r^6).
    pub radial: [f64; 6],
    /// Coefficients p1 and p2, of a lens that is tilted or off the axis.
    pub tangential: [f64; 2],
}

impl LensDistortion {
    /// Distortion of a pinhole camera: none.
    pub const NONE: Self = Self { radial: [0.0; 6], tangential: [0.0; 2] };

    /// Returns the distortion with the radial coefficients k1 and k2 and the tangential ones p1 and
    /// p2.
    pub const fn brown_conrady([k1, k2]: [f64; 2], tangential: [f64; 2]) -> Self {
        Self { radial: [k1, k2, 0.0, 0.0, 0.0, 0.0], tangential }
    }

    /// Returns the distortion with coefficients in the order of OpenCV and ROS: k1, k2, p1, p2, k3,
    /// k4, k5, k6, of which k3 to k6 may be left out.
    ///
    /// # Errors
    /// [`InpaintingError::InvalidValue`] for another number of coefficients, and for a thin prism
    /// or a tilted sensor, the ninth coefficient and those after it.
    pub fn from_opencv(coefficients: &[f64]) -> Result<Self, InpaintingError> {
        let at = |index: usize| coefficients.get(index).copied().unwrap_or(0.0);
        let count = matches!(coefficients.len(), 4 | 5 | 8 | 12 | 14);
        let holds = count && coefficients.iter().skip(8).all(|&prism| prism == 0.0);
        let expected = "4, 5 or 8 numbers, k1, k2, p1, p2, k3, k4, k5, k6, and no thin prism or \
                        tilted sensor after them";
        require_that(holds, "distortion", &format!("{coefficients:?}"), expected)?;
        Ok(Self { radial: [0, 1, 4, 5, 6, 7].map(at), tangential: [2, 3].map(at) })
    }

    pub(crate) fn check(&self) -> Result<(), InpaintingError> {
        let finite = self.radial.iter().chain(&self.tangential).all(|k| k.is_finite());
        require_that(finite, "distortion", self, "finite numbers")
    }

    /// Distorts `point`: returns the point at which the lens shows what a pinhole shows at `point`.
    pub fn distort(&self, point: [f64; 2]) -> [f64; 2] {
        self.distort_with_jacobian(point).0
    }

    /// Undistorts `point`: returns the point at which a pinhole shows what the lens shows at
    /// `point`. `None` if the lens shows nothing there, or beyond a fold of the formula.
    pub fn undistort(&self, point: [f64; 2]) -> Option<[f64; 2]> {
        let [mut x, mut y] = point;
        for _ in 0..STEPS {
            let ([u, v], [[ux, uy], [vx, vy]]) = self.distort_with_jacobian([x, y]);
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
    pub(crate) fn distort_with_jacobian(&self, [x, y]: [f64; 2]) -> ([f64; 2], [[f64; 2]; 2]) {
        let ([k1, k2, k3, k4, k5, k6], [p1, p2]) = (self.radial, self.tangential);
        let square = x * x + y * y;
        // polynomials of the square, and their derivatives
        let above = 1.0 + square * (k1 + square * (k2 + square * k3));
        let below = 1.0 + square * (k4 + square * (k5 + square * k6));
        let above_slope = k1 + square * (2.0 * k2 + 3.0 * square * k3);
        let below_slope = k4 + square * (2.0 * k5 + 3.0 * square * k6);
        let radial = above / below;
        // the derivative of `radial` with respect to x is 2 x times this
        let slope = (above_slope - radial * below_slope) / below;
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

impl fmt::Display for LensDistortion {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "radial {:?}, tangential {:?}", self.radial, self.tangential)
    }
}

impl Add for LensDistortion {
    type Output = Self;

    /// Adds the coefficients of two distortions.
    fn add(self, other: Self) -> Self {
        Self {
            radial: std::array::from_fn(|k| self.radial[k] + other.radial[k]),
            tangential: std::array::from_fn(|p| self.tangential[p] + other.tangential[p]),
        }
    }
}

#[cfg(test)]
mod tests {
    use proptest::prelude::*;

    use super::*;

    fn distortion() -> impl Strategy<Value = LensDistortion> {
        let radial = prop::array::uniform6(-0.05..0.05);
        let tangential = prop::array::uniform2(-0.005..0.005);
        (radial, tangential).prop_map(|(radial, tangential)| LensDistortion { radial, tangential })
    }

    proptest! {
        #[test]
        fn bent_points_come_back(
            lens in distortion(),
            point in prop::array::uniform2(-0.6..0.6),
        ) {
            let back = lens.undistort(lens.distort(point)).unwrap();
            for axis in 0..2 {
                prop_assert!((back[axis] - point[axis]).abs() < 1e-12, "{back:?}");
            }
        }

        #[test]
        fn derivatives_are_differences(
            lens in distortion(),
            point in prop::array::uniform2(-0.6..0.6),
        ) {
            let (_, derivatives) = lens.distort_with_jacobian(point);
            for axis in 0..2 {
                let [mut low, mut high] = [point; 2];
                low[axis] -= 1e-6;
                high[axis] += 1e-6;
                let (low, high) = (lens.distort(low), lens.distort(high));
                for row in 0..2 {
                    let slope = (high[row] - low[row]) / 2e-6;
                    prop_assert!((derivatives[row][axis] - slope).abs() < 1e-8, "{slope}");
                }
            }
        }
    }

    /// cv2.projectPoints([[0.4, -0.3, 1], [1.1, 0.7, 1]], zeros(3), zeros(3), eye(3), d) of OpenCV
    /// 5.0.0 with d = [0.3, -0.2, 0.001, -0.0005, 0.05, 0.25, -0.15, 0.02]; for the first four
    /// numbers of d at (0.4, -0.3), the formula by hand.
    #[test]
    fn the_coefficients_are_opencvs() {
        let all = [0.3, -0.2, 0.001, -0.0005, 0.05, 0.25, -0.15, 0.02];
        let lens = LensDistortion::from_opencv(&all).unwrap();
        for (point, expected) in [
            ([0.4, -0.3], [0.40321276327499256, -0.3022533224562444]),
            ([1.1, 0.7], [1.1881958640434591, 0.7583655498458374]),
        ] {
            let [x, y] = lens.distort(point);
            assert!((x - expected[0]).abs() < 1e-15 && (y - expected[1]).abs() < 1e-15, "{x} {y}");
        }
        let short = LensDistortion::from_opencv(&all[..4]).unwrap();
        let radial = 1.0 + 0.3 * 0.25 - 0.2 * 0.0625;
        let u = 0.4 * radial + 2.0 * 0.001 * 0.4 * -0.3 - 0.0005 * (0.25 + 2.0 * 0.16);
        let v = -0.3 * radial + 0.001 * (0.25 + 2.0 * 0.09) - 2.0 * 0.0005 * 0.4 * -0.3;
        let [x, y] = short.distort([0.4, -0.3]);
        assert!((x - u).abs() < 1e-15 && (y - v).abs() < 1e-15);
        assert_eq!(LensDistortion::NONE.distort([0.4, -0.3]), [0.4, -0.3]);
        let padded = [&all[..], &[0.0; 6]].concat();
        assert_eq!(LensDistortion::from_opencv(&padded), LensDistortion::from_opencv(&all));
        for bad in [&all[..3], &all[..6], &[&all[..], &[0.0, 0.1, 0.0, 0.0]].concat()] {
            let message = LensDistortion::from_opencv(bad).unwrap_err().to_string();
            assert!(message.contains("4, 5 or 8 numbers"), "{message}");
        }
    }

    #[test]
    fn a_point_beyond_the_fold_has_no_inverse() {
        let barrel = LensDistortion::brown_conrady([-0.5, 0.0], [0.0; 2]);
        assert!(barrel.undistort([0.4, 0.0]).is_some());
        assert!(barrel.undistort([0.9, 0.0]).is_none());
    }
}
