//! Appearance of objects.

/// Appearance of an object: two objects with equal values differ only in their position.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Appearance {
    /// Colour of the object: red, green and blue in 0..=255.
    pub colour: [f32; 3],
    /// Outline of each copy of the object.
    pub shape: Shape,
    /// Half of the extent of each copy, in units of half the picture's side.
    pub half_size: f32,
    /// Pattern of each copy of the object.
    pub texture: Texture,
    /// Number of copies of the object side by side, 1 to 3.
    pub num_copies: usize,
}

/// Outline of an object, inside the square `[-1, 1]^2`.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Shape {
    /// Round shape: a disc.
    Disc,
    /// Square with sides along x and y.
    Square,
    /// Triangle that points to larger y.
    Triangle,
    /// Bar along x.
    Bar,
    /// Ring: a disc with a round hole.
    Ring,
    /// Cross of two bars.
    Cross,
    /// Square that stands on its corner.
    Diamond,
    /// Shape of a letter L.
    LetterL,
}

impl Shape {
    /// All outlines of objects.
    pub const ALL: [Self; 8] = [
        Self::Disc,
        Self::Square,
        Self::Triangle,
        Self::Bar,
        Self::Ring,
        Self::Cross,
        Self::Diamond,
        Self::LetterL,
    ];

    /// Returns `true` if the point (u, v), in units of the object's half size, is inside the
    /// outline.
    pub fn contains(self, u: f32, v: f32) -> bool {
        let (squared, inside) = (u * u + v * v, u.abs() <= 1.0 && v.abs() <= 1.0);
        match self {
            Self::Disc => squared <= 1.0,
            Self::Square => inside,
            Self::Triangle => inside && 2.0 * u.abs() + v <= 1.0,
            Self::Bar => inside && v.abs() <= 0.4,
            Self::Ring => (0.36..=1.0).contains(&squared),
            Self::Cross => inside && (u.abs() <= 0.35 || v.abs() <= 0.35),
            Self::Diamond => u.abs() + v.abs() <= 1.0,
            Self::LetterL => inside && (u <= -0.3 || v <= -0.3),
        }
    }
}

/// Pattern of an object: one colour all over, or with darker parts.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub enum Texture {
    /// One colour all over the object.
    Plain,
    /// Four stripes parallel to x, dark and bright in turn.
    Stripes,
    /// Two by two squares, dark and bright in turn, as on a chessboard.
    Checks,
}

impl Texture {
    /// All patterns of objects.
    pub const ALL: [Self; 3] = [Self::Plain, Self::Stripes, Self::Checks];

    /// Returns the factor on the object's colour at the point (u, v) in `[-1, 1]^2`: 1, or 0.35 in
    /// dark parts.
    pub fn brightness(self, u: f32, v: f32) -> f32 {
        let dark = match self {
            Self::Plain => false,
            Self::Stripes => ((v + 1.0) * 2.0).rem_euclid(2.0) < 1.0,
            Self::Checks => (u < 0.0) != (v < 0.0),
        };
        if dark { 0.35 } else { 1.0 }
    }
}

impl Appearance {
    /// Returns the centres of the object's copies, relative to that of the first one, in units of
    /// half the picture's side.
    pub(crate) fn copy_centres(&self) -> impl Iterator<Item = [f32; 2]> {
        // a copy is 2 sizes wide, so a gap of 0.3 sizes remains
        let apart = 2.3 * self.half_size;
        let places = [[0.0, 0.0], [apart, 0.0], [0.0, apart]];
        places.into_iter().take(self.num_copies)
    }
}
