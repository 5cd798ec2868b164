//! The check of symmetry finds and names one fault in each of 40 environments, and flags none of 40
//! without a fault.

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rl::{EnvSpec, Observations, RlError, SymmetryViolation, VectorEnv, check_env_symmetry};
use symmetry::{Group, Irrep};

use crate::common::toy::{Toy, Toys};

const AXES: [Irrep; 2] = [Irrep::X, Irrep::Y];
const ENVS: usize = 100;
/// Episodes of each environment in a check.
const EPISODES: usize = 5;

/// A fault along one axis.
#[derive(Clone, Copy, Debug, PartialEq)]
enum Fault {
    None,
    /// A component that changes its sign is declared not to.
    Sign,
    SwappedComponents,
    WrongCentre,
    JointRange,
    /// Pushes move the point less on one side.
    Inertia,
    /// The camera sees everything moved to one side.
    TiltedCamera,
    OneSidedReward,
    /// A drift that grows with the time since the episode began.
    Clock,
    ImageRows,
    /// Pushes in one direction move the point less.
    ActionScale,
}

const FAULTS: [Fault; 10] = [
    Fault::Sign,
    Fault::SwappedComponents,
    Fault::WrongCentre,
    Fault::JointRange,
    Fault::Inertia,
    Fault::TiltedCamera,
    Fault::OneSidedReward,
    Fault::Clock,
    Fault::ImageRows,
    Fault::ActionScale,
];

/// Position, velocity and goal of a point (x, y each), and the age of its episode.
type PointState = ([f32; 2], [f32; 2], [f32; 2], f32);

/// N points that are pushed towards a goal: position, velocity, goal and age of the episode.
struct Points {
    fault: Fault,
    /// Index of the axis of the fault.
    axis: usize,
    /// Share of its velocity that a point keeps.
    inertia: f32,
    image: [usize; 3],
    states: Vec<PointState>,
    rng: ChaCha8Rng,
}

/// Environments of kind 0 to 3: with or without inertia, with square images or others, and with
/// faults along x or y.
fn envs(fault: Fault, kind: usize, seed: u64) -> Toys<Points> {
    let mut vector_irreps = [AXES, AXES].concat();
    if fault == Fault::Sign {
        vector_irreps[kind % 2] = Irrep::Trivial;
    }
    let image = [[12, 12, 2], [8, 14, 2]][kind / 2];
    let spec = EnvSpec {
        num_envs: ENVS,
        image_shape: image,
        vector_irreps,
        action_irreps: AXES.to_vec(),
        choices: vec![],
    };
    let points = Points {
        fault,
        axis: kind % 2,
        inertia: [0.0, 0.7][kind / 2],
        image,
        states: vec![Default::default(); ENVS],
        rng: ChaCha8Rng::seed_from_u64(seed),
    };
    Toys::of(points, spec)
}

impl Toy for Points {
    const EPISODE: usize = 15;

    fn restart(&mut self, n: usize) {
        let mut draw = || std::array::from_fn(|_| self.rng.random_range(-0.8..0.8));
        self.states[n] = (draw(), [0.0; 2], draw(), 0.0);
    }

    fn observe(&self, n: usize, out: &mut Observations) {
        let (mut point, velocity, goal, _) = self.states[n];
        let [height, width, channels] = self.image;
        let image = &mut out.images[n * height * width * channels..][..height * width * channels];
        image.fill(20);
        for (channel, place) in [point, goal].into_iter().enumerate() {
            let mut place = place;
            if self.fault == Fault::TiltedCamera {
                place[self.axis] = 0.9 * place[self.axis] + 0.1;
            }
            let pixel = |at: f32, size: usize| ((at + 1.0) / 2.0 * size as f32) as usize;
            let column = pixel(place[0], width).min(width - 1);
            let mut row = pixel(-place[1], height).min(height - 1);
            if self.fault == Fault::ImageRows {
                row = (row + 1) % height;
            }
            image[(row * width + column) * channels + channel] = 220;
        }
        if self.fault == Fault::WrongCentre {
            point[self.axis] += 0.15;
        }
        if self.fault == Fault::SwappedComponents {
            point.swap(0, 1);
        }
        out.vectors[4 * n..4 * n + 4].copy_from_slice(&[point, velocity].concat());
    }

    fn act(&mut self, n: usize, action: &[f32]) -> (f32, bool) {
        let (point, velocity, goal, age) = &mut self.states[n];
        *age += 1.0;
        for (axis, component) in action.iter().enumerate() {
            let mut push = 0.2 * component.clamp(-1.0, 1.0);
            let mut range = [-1.0, 1.0];
            if axis == self.axis {
                push *= match self.fault {
                    Fault::Inertia if point[axis] > 0.0 => 0.5,
                    Fault::ActionScale if push > 0.0 => 0.7,
                    _ => 1.0,
                };
                push += if self.fault == Fault::Clock { 0.003 * *age } else { 0.0 };
                range[1] = if self.fault == Fault::JointRange { 0.6 } else { 1.0 };
            }
            velocity[axis] = self.inertia * velocity[axis] + push;
            let [low, high] = range;
            point[axis] = (point[axis] + velocity[axis]).clamp(low, high);
        }
        let distance = (point[0] - goal[0]).abs() + (point[1] - goal[1]).abs();
        let is_paid = self.fault == Fault::OneSidedReward && point[self.axis] > 0.0;
        (1.0 - distance / 4.0 + if is_paid { 0.2 } else { 0.0 }, distance < 0.1)
    }
}

fn violations(fault: Fault, kind: usize, seed: u64) -> Vec<SymmetryViolation> {
    let mut env = envs(fault, kind, seed);
    let steps = EPISODES * env.horizon().unwrap();
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    match check_env_symmetry(&mut env, Group::D2, steps, &mut rng) {
        Ok(()) => Vec::new(),
        Err(RlError::SymmetryViolated { violations }) => violations,
        Err(error) => panic!("{error}"),
    }
}

/// Returns `true` if the violations name the part of the environment with the fault.
fn name(fault: Fault, axis: usize, violations: &[SymmetryViolation]) -> bool {
    let component = format!("vector component {axis} ");
    let all = |part: &str| violations.iter().all(|v| v.what.contains(part));
    let any = |part: &str| violations.iter().any(|v| v.what.contains(part));
    let starts = |part: &str| violations.iter().any(|v| v.what.starts_with(part));
    match fault {
        Fault::None => false,
        Fault::Sign | Fault::SwappedComponents | Fault::JointRange => any(&component),
        Fault::WrongCentre => starts(&component),
        Fault::TiltedCamera | Fault::ImageRows => all("image"),
        Fault::OneSidedReward => all("the reward"),
        // the response of position or velocity
        Fault::Inertia | Fault::Clock | Fault::ActionScale => {
            [axis, axis + 2].iter().any(|i| any(&format!("the change of vector component {i} ")))
        }
    }
}

#[test]
fn faults_of_ten_kinds_are_found_and_named_and_none_is_seen_where_there_is_none() {
    let mut found = 0;
    for (i, fault) in FAULTS.into_iter().enumerate() {
        for kind in 0..4 {
            let seed = (4 * i + kind) as u64;
            let violated = violations(fault, kind, seed);
            let named = !violated.is_empty() && name(fault, kind % 2, &violated);
            found += usize::from(named);
            if !named {
                println!("{fault:?} {kind}: {violated:#?}");
            }
            assert_eq!(violations(Fault::None, kind, seed), [], "without a fault: {kind} {seed}");
        }
    }
    assert!(found >= 38, "{found} of 40");
}
