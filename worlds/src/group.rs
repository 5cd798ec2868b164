//! What the tasks of one group have in common.

use crate::look::Look;

/// One group of tasks: all variants of D2 and all placements of one object.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Group {
    /// How its object looks at the beginning of the stream.
    pub look: Look,
    /// What it pays.
    pub pay: Pay,
    /// How the hand moves.
    pub motion: Motion,
    /// How far each colour strays from the beginning of the stream, in 0..=255, once in a thousand
    /// rounds there and back; zero where nothing
    /// drifts.
    pub drift: [f32; 3],
}

/// What a group pays at a step: `exp(-decay d)`, where d is the distance of the hand from a circle
/// around a target.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Pay {
    /// From the object to the target, in units of half the picture's side.
    pub offset: [f32; 2],
    /// Radius of the circle; zero pays at the target itself.
    pub radius: f32,
}

/// How fast pay falls with distance.
const DECAY: f32 = 10.0;

impl Pay {
    /// The pay for a hand at this place relative to the object, in (0, 1].
    pub fn at(&self, [x, y]: [f32; 2]) -> f32 {
        (-DECAY * self.distance([x, y])).exp()
    }

    /// How far from full pay such a hand is.
    pub fn distance(&self, [x, y]: [f32; 2]) -> f32 {
        ((x - self.offset[0]).hypot(y - self.offset[1]) - self.radius).abs()
    }

    /// The way to the nearest place of full pay.
    pub(crate) fn way(&self, [x, y]: [f32; 2]) -> [f32; 2] {
        let (dx, dy) = (self.offset[0] - x, self.offset[1] - y);
        let distance = dx.hypot(dy).max(1e-6);
        let share = 1.0 - self.radius / distance;
        [dx * share, dy * share]
    }
}

/// How an action in `[-1, 1]^2` moves the hand.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Motion {
    /// Way at full action, in units of half the picture's side.
    pub gain: f32,
    /// Angle between action and motion (radians).
    pub turn: f32,
}

impl Motion {
    /// The hand's motion under an action.
    pub(crate) fn forward(&self, [x, y]: [f32; 2]) -> [f32; 2] {
        let (sin, cos) = self.turn.sin_cos();
        [self.gain * (cos * x - sin * y), self.gain * (sin * x + cos * y)]
    }

    /// The action that moves the hand so.
    pub(crate) fn inverse(&self, [x, y]: [f32; 2]) -> [f32; 2] {
        let (sin, cos) = self.turn.sin_cos();
        [(cos * x + sin * y) / self.gain, (cos * y - sin * x) / self.gain]
    }
}

/// Rounds in which a drifting colour strays and returns.
const PERIOD: f32 = 1000.0;

impl Group {
    /// How the object looks after `rounds` rounds of the stream.
    pub(crate) fn look_after(&self, rounds: usize) -> Look {
        let share = (std::f32::consts::TAU * rounds as f32 / PERIOD).sin();
        let mut look = self.look;
        for (colour, drift) in look.colour.iter_mut().zip(self.drift) {
            *colour += share * drift;
        }
        look
    }
}
