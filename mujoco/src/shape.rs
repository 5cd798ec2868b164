//! Shapes that a few figures describe.

/// Shape of a geom, in its own frame, in metres.
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Shape {
    /// A ball.
    Sphere {
        /// Its radius.
        radius: f64,
    },
    /// A cylinder along z with half a ball on either end.
    Capsule {
        /// Radius of cylinder and balls.
        radius: f64,
        /// Half the length of the cylinder, without the balls.
        half_length: f64,
    },
    /// A cylinder along z.
    Cylinder {
        /// Its radius.
        radius: f64,
        /// Half its length.
        half_length: f64,
    },
    /// A box.
    Box {
        /// Half its extent along x, y and z.
        half: [f64; 3],
    },
}
