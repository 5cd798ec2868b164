//! Kinds of worlds: the properties in which their task groups differ, and what changes with time.

use rand::RngExt;
use rand::seq::SliceRandom;
use rand_chacha::ChaCha8Rng;

use crate::appearance::{Appearance, Shape, Texture};
use crate::group::{HandDynamics, RewardFunction, TaskGroup};
use crate::scene::{
    Nuisance, change_light, move_object, raise_noise, rescale_rewards, tint_ground, unchanged,
};

/// Property in which the task groups of a world can differ.
#[derive(Clone, Copy, Debug, PartialEq, Eq, PartialOrd, Ord, Hash)]
pub enum TaskGroupProperty {
    /// Colour of the object.
    Colour,
    /// Outline of the object.
    Shape,
    /// Size, texture and number of copies of the object, which vary together.
    Form,
    /// Colour of the ground.
    Ground,
    /// Position of the target of the hand, relative to the object.
    Target,
    /// Radius of the circle of full reward around the target.
    Reward,
    /// Dynamics of the hand: the displacement that an action causes.
    Dynamics,
}

/// Kind of a world: the properties in which its task groups differ, and the nuisance that acts in
/// it. Positions, light, ground and noise change within 250 rounds and return within the next 250.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub enum WorldKind {
    /// Groups that differ in colour, shape, size, texture and number of copies of the object, and
    /// in the position of the target.
    Appearance,
    /// Groups that differ in the shape of the object and the position of the target, with one
    /// colour and size.
    Shape,
    /// Groups that differ in the colour of the object and the position of the target, with one
    /// shape and size.
    Colour,
    /// Groups that differ in the colour of the ground and the position of the target, with one
    /// object.
    Ground,
    /// Groups of [`WorldKind::Appearance`], with objects that appear only after five decisions of
    /// an episode.
    LateObject,
    /// Groups that differ in the position of the target, relative to an object that looks the same
    /// in all groups.
    Target,
    /// Groups that differ in the radius of the circle of full reward around a common target.
    Reward,
    /// Groups that differ in the dynamics of the hand: the displacement that an action causes.
    Dynamics,
    /// Groups that differ in nothing: one group under several indices.
    Identical,
    /// Groups of [`WorldKind::Appearance`], with colours that change a little with time.
    Drift,
    /// Groups of [`WorldKind::Appearance`], with objects that move outwards or inwards.
    MovingObject,
    /// Groups of [`WorldKind::Appearance`], with light that becomes 1.3 or 0.6 times as bright.
    ChangingLight,
    /// Groups of [`WorldKind::Appearance`], with ground whose channels change by at most 35 of 255.
    ChangingGround,
    /// Groups of [`WorldKind::Appearance`], with camera noise that increases to 20 levels.
    RisingNoise,
    /// Groups of [`WorldKind::Appearance`], with rewards scaled by 0.01 to 100 in each visit.
    RescaledReward,
}

/// Definition of a kind of world: name, number of groups, properties and nuisance.
struct Spec {
    name: &'static str,
    /// Least and largest default number of task groups.
    num_groups: [usize; 2],
    properties: &'static [TaskGroupProperty],
    nuisance: Nuisance,
}

impl WorldKind {
    /// All kinds of worlds.
    pub const ALL: [Self; 15] = [
        Self::Appearance,
        Self::Shape,
        Self::Colour,
        Self::Ground,
        Self::LateObject,
        Self::Target,
        Self::Reward,
        Self::Dynamics,
        Self::Identical,
        Self::Drift,
        Self::MovingObject,
        Self::ChangingLight,
        Self::ChangingGround,
        Self::RisingNoise,
        Self::RescaledReward,
    ];

    const fn spec(self) -> Spec {
        use TaskGroupProperty::{Colour, Dynamics, Form, Ground, Reward, Shape, Target};
        const APPEARANCE: &[TaskGroupProperty] = &[Colour, Shape, Form, Target];
        let values: (_, _, _, Nuisance) = match self {
            Self::Appearance => ("appearance", [8, 8], APPEARANCE, unchanged),
            Self::Shape => ("shape", [8, 8], &[Shape, Target], unchanged),
            Self::Colour => ("colour", [8, 8], &[Colour, Target], unchanged),
            Self::Ground => ("ground", [2, 6], &[Ground, Target], unchanged),
            Self::LateObject => ("late-object", [2, 6], APPEARANCE, unchanged),
            Self::Target => ("target", [2, 6], &[Target], unchanged),
            Self::Reward => ("reward", [2, 4], &[Reward], unchanged),
            Self::Dynamics => ("dynamics", [2, 5], &[Dynamics], unchanged),
            Self::Identical => ("identical", [2, 16], &[], unchanged),
            Self::Drift => ("drift", [2, 6], APPEARANCE, unchanged),
            Self::MovingObject => ("moving-object", [1, 4], APPEARANCE, move_object),
            Self::ChangingLight => ("changing-light", [1, 4], APPEARANCE, change_light),
            Self::ChangingGround => ("changing-ground", [1, 4], APPEARANCE, tint_ground),
            Self::RisingNoise => ("rising-noise", [1, 4], APPEARANCE, raise_noise),
            Self::RescaledReward => ("rescaled-reward", [1, 4], APPEARANCE, rescale_rewards),
        };
        let (name, num_groups, properties, nuisance) = values;
        Spec { name, num_groups, properties, nuisance }
    }

    /// Returns the name of the kind of world in tables, for instance `appearance`.
    pub const fn name(self) -> &'static str {
        self.spec().name
    }

    /// Returns the properties in which the task groups of this kind of world differ.
    pub const fn varying_properties(self) -> &'static [TaskGroupProperty] {
        self.spec().properties
    }

    /// Returns the function that changes the scene in the course of a stream, a change that
    /// requires no new policies.
    pub(crate) const fn nuisance(self) -> Nuisance {
        self.spec().nuisance
    }

    /// Returns a random number of task groups in the default range of this kind of world.
    pub(crate) fn draw_num_groups(self, rng: &mut ChaCha8Rng) -> usize {
        let [least, most] = self.spec().num_groups;
        // a draw would change the worlds of kinds with a fixed number
        if least == most { most } else { rng.random_range(least..=most) }
    }

    /// Returns the largest number of task groups of this kind of world.
    pub(crate) const fn max_num_groups(self) -> usize {
        match self.varying_properties() {
            // values of a property are drawn without repetition
            [property] | [property, TaskGroupProperty::Target] => property.num_values(),
            _ => 16,
        }
    }

    /// Returns `number` random task groups of this kind of world.
    pub(crate) fn draw_groups(self, number: usize, rng: &mut ChaCha8Rng) -> Vec<TaskGroup> {
        let mut groups = match *self.varying_properties() {
            [] => vec![draw_group(draw_appearance(rng), rng); number],
            [property] => {
                let common = draw_group(draw_appearance(rng), rng);
                let values = property.draw(number, rng).into_iter();
                values.map(|value| property.set(common, value)).collect()
            }
            [property, TaskGroupProperty::Target] => {
                let mut common = draw_appearance(rng);
                (common.texture, common.num_copies, common.half_size) = (Texture::Plain, 1, 0.18);
                let values = property.draw(number, rng).into_iter();
                values.map(|value| property.set(draw_group(common, rng), value)).collect()
            }
            _ => draw_distinct_groups(number, rng),
        };
        if self == Self::Drift {
            for group in &mut groups {
                group.colour_drift =
                    [0; 3].map(|_| rng.random_range(-MAX_COLOUR_DRIFT..MAX_COLOUR_DRIFT));
            }
        }
        groups
    }
}

impl TaskGroupProperty {
    /// Returns the number of values that the property can have.
    const fn num_values(self) -> usize {
        match self {
            Self::Colour | Self::Shape | Self::Ground | Self::Target => 8,
            Self::Form => 1,
            Self::Reward => 4,
            Self::Dynamics => HAND_DYNAMICS.len(),
        }
    }

    /// Returns the indices of `number` different random values of the property.
    fn draw(self, number: usize, rng: &mut ChaCha8Rng) -> Vec<usize> {
        let mut values: Vec<usize> = (0..self.num_values()).collect();
        values.shuffle(rng);
        values.truncate(number);
        values
    }

    /// Returns a copy of `group` whose property has the value of index `value`.
    fn set(self, mut group: TaskGroup, value: usize) -> TaskGroup {
        match self {
            Self::Colour => group.appearance.colour = COLOURS[value],
            Self::Shape => group.appearance.shape = Shape::ALL[value],
            // drawn with the whole appearance alone
            Self::Form => {}
            Self::Ground => {
                // each bit makes a channel lighter or darker
                let tint = |bit| if value & bit == 0 { -35.0 } else { 35.0 };
                group.ground_tint = [1, 2, 4].map(tint);
            }
            Self::Target => {
                let (sin, cos) = (value as f32 * std::f32::consts::TAU / 8.0).sin_cos();
                group.reward = RewardFunction { offset: [0.4 * cos, 0.4 * sin], radius: 0.0 };
            }
            Self::Reward => {
                group.reward = RewardFunction { offset: [0.0; 2], radius: 0.25 * value as f32 };
            }
            Self::Dynamics => group.dynamics = HAND_DYNAMICS[value],
        }
        group
    }
}

/// Largest amplitude of a colour's drift, in 0..=255: about a tenth of the range.
const MAX_COLOUR_DRIFT: f32 = 25.0;

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

/// Sizes that objects can have, as half of their extent, in units of half the picture's side.
const SIZES: [f32; 2] = [0.12, 0.18];

/// Dynamics of the hand in all kinds of worlds but [`WorldKind::Dynamics`].
const ORDINARY: HandDynamics = HandDynamics { gain: 0.08, rotation_rad: 0.0 };

/// Dynamics of the hand that groups of [`WorldKind::Dynamics`] can have: ordinary, half the speed,
/// reversed, and turned to either side.
const HAND_DYNAMICS: [HandDynamics; 5] = [
    ORDINARY,
    HandDynamics { gain: 0.04, ..ORDINARY },
    HandDynamics { gain: -0.08, ..ORDINARY },
    // about a right angle: an expert of the ordinary group makes no progress
    HandDynamics { rotation_rad: 1.6, ..ORDINARY },
    HandDynamics { rotation_rad: -1.6, ..ORDINARY },
];

fn draw_appearance(rng: &mut ChaCha8Rng) -> Appearance {
    Appearance {
        colour: COLOURS[rng.random_range(0..COLOURS.len())],
        shape: Shape::ALL[rng.random_range(0..Shape::ALL.len())],
        half_size: SIZES[rng.random_range(0..SIZES.len())],
        texture: Texture::ALL[rng.random_range(0..Texture::ALL.len())],
        num_copies: rng.random_range(1..=3),
    }
}

fn draw_group(appearance: Appearance, rng: &mut ChaCha8Rng) -> TaskGroup {
    let around = rng.random_range(0.0..std::f32::consts::TAU);
    let (sin, cos) = around.sin_cos();
    TaskGroup {
        appearance,
        reward: RewardFunction { offset: [0.3 * cos, 0.3 * sin], radius: 0.0 },
        dynamics: ORDINARY,
        ground_tint: [0.0; 3],
        colour_drift: [0.0; 3],
    }
}

/// Returns random task groups whose objects differ in at least one property of their appearance.
fn draw_distinct_groups(number: usize, rng: &mut ChaCha8Rng) -> Vec<TaskGroup> {
    let mut groups: Vec<TaskGroup> = Vec::with_capacity(number);
    while groups.len() < number {
        let appearance = draw_appearance(rng);
        if groups.iter().all(|other| other.appearance != appearance) {
            groups.push(draw_group(appearance, rng));
        }
    }
    groups
}
