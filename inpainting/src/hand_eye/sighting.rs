//! What is seen of a ball, what is known of it, and what is left over.

use glam::{DQuat, DVec3};

/// Largest residual of a pose (pixels) that is taken for noise: 10 mm on a table 1.5 m away.
pub const LARGEST_RESIDUAL: f64 = 4.0;

/// A ball that a hand carries, as it was seen once.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Sighting {
    /// Number of the pose, for messages.
    pub pose: usize,
    /// Where the hand was by its joints (metres, world).
    pub position: DVec3,
    /// How it was turned: from its axes to the world's.
    pub rotation: DQuat,
    /// Column and row of the ball (pixels; the middle of the first one is at one half).
    pub pixel: [f64; 2],
}

/// Where the ball is in the frame of the hand (metres).
#[derive(Clone, Copy, Debug, PartialEq)]
pub enum Offset {
    /// It was measured.
    Known(DVec3),
    /// It is solved for, which takes a hand that turns about two axes.
    Unknown,
}

/// How far the ball of a pose is from where it is expected.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Residual {
    /// Number of the pose.
    pub pose: usize,
    /// In the picture (pixels).
    pub pixels: f64,
    /// On the table, the plane z = 0, along the two lines of sight (metres); none where one of them
    /// does not meet it.
    pub on_table: Option<f64>,
}
