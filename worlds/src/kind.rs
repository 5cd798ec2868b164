//! Kinds of worlds, by the property in which their groups differ.

use rand::RngExt;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

use crate::group::{HandDynamics, RewardFunction, TaskGroup};
use crate::look::{Appearance, Shape, Texture};

/// Kind of a world: the properties in which its task groups differ.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum WorldKind {
    /// Colour, shape, size, texture and number of copies; positions of targets differ as well.
    Appearance,
    /// Shape, with one colour and size; positions of targets differ as well.
    Shape,
    /// Position of the target relative to an object that looks the same in all groups.
    Target,
    /// Reward around a common target: the radius of the circle of full reward.
    Reward,
    /// Dynamics of the hand: the displacement that an action causes.
    Dynamics,
    /// No property: one group under several indices.
    Identical,
    /// As [`WorldKind::Appearance`], with colours that change a little from rollout to rollout.
    Drift,
}

impl WorldKind {
    /// All kinds of worlds.
    pub const ALL: [Self; 7] = [
        Self::Appearance,
        Self::Shape,
        Self::Target,
        Self::Reward,
        Self::Dynamics,
        Self::Identical,
        Self::Drift,
    ];

    /// Returns the kind's name in tables, for instance `appearance`.
    pub const fn name(self) -> &'static str {
        match self {
            Self::Appearance => "appearance",
            Self::Shape => "shape",
            Self::Target => "target",
            Self::Reward => "reward",
            Self::Dynamics => "dynamics",
            Self::Identical => "identical",
            Self::Drift => "drift",
        }
    }

    /// Draws the default number of groups, which is fixed for some kinds.
    pub(crate) fn draw_num_groups(self, rng: &mut ChaCha8Rng) -> usize {
        match self {
            Self::Appearance | Self::Shape => 8,
            Self::Target | Self::Drift => rng.random_range(2..=6),
            Self::Reward => rng.random_range(2..=4),
            Self::Dynamics => rng.random_range(2..=5),
            Self::Identical => rng.random_range(2..=16),
        }
    }

    /// Returns the largest number of groups.
    pub(crate) const fn max_num_groups(self) -> usize {
        match self {
            Self::Appearance | Self::Identical | Self::Drift => 16,
            // sizes of the lists that groups are drawn from without repetition
            Self::Shape | Self::Target => 8,
            Self::Reward => 4,
            Self::Dynamics => 5,
        }
    }

    /// Draws `number` groups.
    pub(crate) fn draw_groups(self, number: usize, rng: &mut ChaCha8Rng) -> Vec<TaskGroup> {
        let groups = match self {
            Self::Appearance => appearance(number, rng),
            Self::Shape => shapes(number, rng),
            Self::Target => vary(number, rng, &targets(), |group, &pay| group.reward = pay),
            Self::Reward => vary(number, rng, &rings(), |group, &pay| group.reward = pay),
            Self::Dynamics => vary(number, rng, &HAND_DYNAMICS, |group, &m| group.dynamics = m),
            Self::Identical => vec![group(look(rng), rng); number],
            Self::Drift => appearance(number, rng),
        };
        let stray = |group: TaskGroup, draws: &mut ChaCha8Rng| TaskGroup {
            colour_drift: [0; 3].map(|_| draws.random_range(-STRAY..STRAY)),
            ..group
        };
        match self {
            Self::Drift => groups.into_iter().map(|group| stray(group, rng)).collect(),
            _ => groups,
        }
    }
}

/// Largest amplitude of a colour's drift, in 0..=255: about a tenth of the range.
const STRAY: f32 = 25.0;

/// Colours of objects.
const COLOURS: [[f32; 3]; 8] = [
    [210.0, 50.0, 45.0],
    [50.0, 165.0, 65.0],
    [55.0, 85.0, 205.0],
    [215.0, 185.0, 50.0],
    [150.0, 60.0, 170.0],
    [60.0, 180.0, 185.0],
    [225.0, 225.0, 225.0],
    [40.0, 40.0, 45.0],
];

/// Sizes of objects, as half of their extent, in units of half the picture's side.
const SIZES: [f32; 2] = [0.12, 0.18];

/// Dynamics of all kinds but [`WorldKind::Dynamics`].
const ORDINARY: HandDynamics = HandDynamics { gain: 0.08, rotation_rad: 0.0 };

/// Dynamics of [`WorldKind::Dynamics`]: ordinary, half the speed, reversed, and turned to either
/// side.
const HAND_DYNAMICS: [HandDynamics; 5] = [
    ORDINARY,
    HandDynamics { gain: 0.04, ..ORDINARY },
    HandDynamics { gain: -0.08, ..ORDINARY },
    // about a right angle: an expert of the ordinary group makes no progress
    HandDynamics { rotation_rad: 1.6, ..ORDINARY },
    HandDynamics { rotation_rad: -1.6, ..ORDINARY },
];

fn look(rng: &mut ChaCha8Rng) -> Appearance {
    Appearance {
        colour: COLOURS[rng.random_range(0..COLOURS.len())],
        shape: Shape::ALL[rng.random_range(0..Shape::ALL.len())],
        half_size: SIZES[rng.random_range(0..SIZES.len())],
        texture: Texture::ALL[rng.random_range(0..Texture::ALL.len())],
        num_copies: rng.random_range(1..=3),
    }
}

fn group(appearance: Appearance, rng: &mut ChaCha8Rng) -> TaskGroup {
    let around = rng.random_range(0.0..std::f32::consts::TAU);
    let (sin, cos) = around.sin_cos();
    TaskGroup {
        appearance,
        reward: RewardFunction { offset: [0.3 * cos, 0.3 * sin], radius: 0.0 },
        dynamics: ORDINARY,
        colour_drift: [0.0; 3],
    }
}

/// Draws groups with distinct appearances, which differ in at least one property.
fn appearance(number: usize, rng: &mut ChaCha8Rng) -> Vec<TaskGroup> {
    let mut groups: Vec<TaskGroup> = Vec::with_capacity(number);
    while groups.len() < number {
        let look = look(rng);
        if groups.iter().all(|other| other.appearance != look) {
            groups.push(group(look, rng));
        }
    }
    groups
}

fn shapes(number: usize, rng: &mut ChaCha8Rng) -> Vec<TaskGroup> {
    let common =
        Appearance { texture: Texture::Plain, num_copies: 1, half_size: 0.18, ..look(rng) };
    let mut shapes = Shape::ALL;
    shapes.shuffle(rng);
    let shapes = shapes.into_iter().take(number);
    let looks = shapes.map(|shape| Appearance { shape, ..common });
    looks.map(|look| group(look, rng)).collect()
}

/// Draws groups with one appearance that differ in one property, whose values come from `values`
/// without repetition.
fn vary<T: Copy>(
    number: usize,
    rng: &mut ChaCha8Rng,
    values: &[T],
    set: impl Fn(&mut TaskGroup, &T),
) -> Vec<TaskGroup> {
    let common = group(look(rng), rng);
    let mut values = values.to_vec();
    values.shuffle(rng);
    let different = values.iter().take(number).map(|value| {
        let mut group = common;
        set(&mut group, value);
        group
    });
    different.collect()
}

/// Returns eight targets around the object.
fn targets() -> [RewardFunction; 8] {
    std::array::from_fn(|i| {
        let (sin, cos) = (i as f32 * std::f32::consts::TAU / 8.0).sin_cos();
        RewardFunction { offset: [0.4 * cos, 0.4 * sin], radius: 0.0 }
    })
}

/// Returns four circles around the object, the first of radius zero.
fn rings() -> [RewardFunction; 4] {
    [0.0, 0.25, 0.5, 0.75].map(|radius| RewardFunction { offset: [0.0, 0.0], radius })
}
