//! MJCF of a robot, for MuJoCo 2.2.2.
//!
//! Read this before editing. These points of MuJoCo 2.2.2 matter here:
//! - rotations are quaternions, because its Euler angles turn with the body and URDF's do not;
//! - nothing is limited unless `limited`, `ctrllimited` and `forcelimited` say so;
//! - `fullinertia` is ordered ixx iyy izz ixy ixz iyz;
//! - a body that has shapes but no `inertial` gets the mass of its shapes, and several shapes
//!   without mass are refused;
//! - two bodies that are fixed to each other do not collide, nor do two that one joint moves
//!   against each other, unless one of them is fixed to the world;
//! - a position actuator has no damping;
//! - its parser of XML refuses elements in the 100th level.

use glam::{DQuat, DVec3};

use crate::capsule::{PlacedShape, Shape};
use crate::description::{Description, Drive, Inertia, Joint, Link, Motion, MotionKind};
use crate::error::DescriptionError;
use crate::error::{finite, require};
use crate::overlap::Solids;
use crate::pose::Pose;

/// Most links that hang on each other in a row. With the document and two elements around them
/// there are 99 levels.
const MAX_ROW: usize = 96;

/// MJCF of a robot.
#[derive(Clone, Debug, PartialEq)]
pub struct Mjcf {
    /// The MJCF.
    pub text: String,
    /// Pairs of links that touch at rest ([`Description::rest`]) and that nothing else keeps from
    /// colliding. They do not collide in any pose.
    pub excluded: Vec<[String; 2]>,
}

/// What MJCF holds beside the robot itself.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MjcfSettings {
    /// How joints are driven; without it, the model has no actuators.
    pub servo: Option<Servo>,
    /// Links, and the default class (`childclass`) of each with everything that hangs on it. The
    /// scene must declare the classes.
    pub classes: Vec<(String, String)>,
    /// What links hold beside their own masses and shapes.
    pub additions: Vec<Addition>,
}

/// Elements of MJCF inside a link's body, for instance sites and cameras. Geoms that are added
/// contribute mass only to a link that has neither mass nor shapes; bodies that are added have
/// masses of their own.
#[derive(Clone, Debug, PartialEq)]
pub struct Addition {
    /// Name of the link.
    pub link: String,
    /// The elements, which are not checked.
    pub mjcf: String,
}

/// Servos of the free joints: the force is `stiffness` times the position error plus `damping`
/// times the speed error, up to the joint's effort.
///
/// An actuator has the name of its joint, and [`Servo::control`] is its control. Its damping needs
/// an implicit integrator (`<option integrator="implicit"/>`); with Euler's it vibrates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Servo {
    /// Position error (radians, metres) at which a joint's whole effort is spent; 1e-6 or more.
    pub saturation: f64,
    /// Damping over stiffness (seconds); zero or more.
    pub damping_time: f64,
}

impl Default for Servo {
    /// For a Kinova Gen3 about the stiffness that others simulate it with: 1950 and 450 N m/rad.
    fn default() -> Self {
        Self { saturation: 0.02, damping_time: 0.03 }
    }
}

impl Servo {
    fn check(&self) -> Result<(), DescriptionError> {
        let Self { saturation, damping_time } = *self;
        let place = || "the servo".to_owned();
        let values = [saturation, damping_time];
        finite(place, "its saturation or damping time", &values)?;
        let (what, expected) = ("its saturation", "1e-6 or more");
        require(saturation >= 1e-6, place, what, saturation, expected)?;
        let (what, expected) = ("its damping time", "zero or more");
        require(damping_time >= 0.0, place, what, damping_time, expected)
    }

    /// What a joint's control needs on top to spend `force` (newtons, newton metres), for instance
    /// one of [`Description::holding_forces`].
    pub fn feed_forward(&self, motion: &Motion, force: f64) -> f64 {
        force * self.saturation / motion.effort
    }

    /// The control that makes a joint follow a position and its velocity (radians, metres; 1/s).
    pub fn control(&self, position: f64, velocity: f64) -> f64 {
        position + self.damping_time * velocity
    }
}

impl Description {
    /// A model of the robot alone: links with masses and collision shapes, joints with limits and
    /// friction, servos in the order of position vectors, an equality for each joint that follows
    /// another. Bodies and joints have the names of links and joints; a shape has its link's name
    /// with `_0`, `_1` and so on. A link does not collide with the link that it moves on, nor do
    /// links that touch at rest ([`Mjcf::excluded`]).
    ///
    /// # Errors
    /// [`DescriptionError::Number`] for a servo out of range, [`DescriptionError::UnknownLink`] for
    /// an addition to no link, [`DescriptionError::LongRow`] for more than 96 links that hang on
    /// each other in a row.
    pub fn to_mjcf(&self, settings: &MjcfSettings) -> Result<Mjcf, DescriptionError> {
        let name = escaped(&self.name);
        let head = "<compiler angle=\"radian\"/>\n<option integrator=\"implicit\"/>\n";
        let sections = self.sections(settings)?;
        let text = format!("<mujoco model=\"{name}\">\n{head}{}</mujoco>\n", sections.text);
        Ok(Mjcf { text, ..sections })
    }

    /// Model of the robot as a part for a scene to include. The scene must count angles in radians
    /// and, with servos, use an implicit integrator.
    ///
    /// # Errors
    /// As [`Description::to_mjcf`].
    pub fn to_mjcf_part(&self, settings: &MjcfSettings) -> Result<Mjcf, DescriptionError> {
        let sections = self.sections(settings)?;
        let text = format!("<mujocoinclude>\n{}</mujocoinclude>\n", sections.text);
        Ok(Mjcf { text, ..sections })
    }

    /// The sections of a model, without an element around them.
    fn sections(&self, settings: &MjcfSettings) -> Result<Mjcf, DescriptionError> {
        settings.servo.map_or(Ok(()), |servo| servo.check())?;
        self.check_links(settings)?;
        self.check_rows()?;
        let servos = settings.servo.map_or(String::new(), |servo| self.servos(&servo));
        let section = |(name, text): (&str, String)| match &text[..] {
            "" => String::new(),
            text => format!("<{name}>\n{text}</{name}>\n"),
        };
        let touching = self.touching_at_rest();
        let sections = [
            ("worldbody", self.bodies(settings)),
            ("contact", self.excludes(&touching)),
            ("equality", self.equalities()),
            ("actuator", servos),
        ];
        let names = |pair: [usize; 2]| pair.map(|link| self.links[link].name.clone());
        Ok(Mjcf {
            text: sections.map(section).concat(),
            excluded: touching.into_iter().map(names).collect(),
        })
    }

    fn check_links(&self, settings: &MjcfSettings) -> Result<(), DescriptionError> {
        let classes = settings.classes.iter().map(|(link, _)| link);
        let additions = settings.additions.iter().map(|addition| &addition.link);
        let mut named = classes.chain(additions);
        named.try_for_each(|link| self.link_index(link, "a setting of the MJCF").map(|_| ()))
    }

    fn check_rows(&self) -> Result<(), DescriptionError> {
        let mut rows = vec![1];
        for joint in &self.joints {
            rows.push(rows[joint.parent] + 1);
        }
        match rows.iter().position(|&row| row > MAX_ROW) {
            None => Ok(()),
            Some(link) => Err(DescriptionError::LongRow {
                link: self.links[link].name.clone(),
                limit: MAX_ROW,
            }),
        }
    }

    /// Bodies inside their parents. Links come parents first, each followed by all that hangs on
    /// it, so a link closes those that it does not hang on.
    fn bodies(&self, settings: &MjcfSettings) -> String {
        let mut text =
            body(&self.links[0], &self.base, settings) + &contents(&self.links[0], settings);
        let mut open = vec![0];
        for (index, joint) in self.joints.iter().enumerate() {
            while open.last().is_some_and(|&link| link != joint.parent) {
                open.pop();
                text += "</body>\n";
            }
            let link = index + 1;
            open.push(link);
            text += &body(&self.links[link], &joint.origin, settings);
            text += &joint.motion.map_or(String::new(), |motion| moving(&joint.name, &motion));
            text += &contents(&self.links[link], settings);
        }
        text + &"</body>\n".repeat(open.len())
    }

    fn excludes(&self, touching: &[[usize; 2]]) -> String {
        let links = 0..self.links.len();
        let pairs =
            links.flat_map(|link| self.neighbours(link).into_iter().map(move |n| [n, link]));
        let exclude = |pair: [usize; 2]| {
            let [first, second] = pair.map(|link| escaped(&self.links[link].name));
            format!("<exclude body1=\"{first}\" body2=\"{second}\"/>\n")
        };
        pairs.chain(touching.iter().copied()).map(exclude).collect()
    }

    /// Pairs of links that would collide at rest.
    fn touching_at_rest(&self) -> Vec<[usize; 2]> {
        let poses = self.poses(&self.rest());
        let bodies = self.rigid_bodies();
        let moves_on = |body: usize, other: usize| {
            let joint = body.checked_sub(1);
            other > 0 && joint.is_some_and(|joint| bodies[self.joints[joint].parent] == other)
        };
        let never_collide = |[a, b]: [usize; 2]| {
            let [one, other] = [bodies[a], bodies[b]];
            one == other
                || moves_on(one, other)
                || moves_on(other, one)
                || self.neighbours(b).contains(&a)
        };
        let links = self.links.iter().zip(&poses);
        let solids: Vec<Solids> =
            links.map(|(link, pose)| Solids::new(&link.shapes, pose)).collect();
        let touch = |[a, b]: [usize; 2]| solids[a].touch(&solids[b]);
        let pairs = (0..self.links.len()).flat_map(|b| (0..b).map(move |a| [a, b]));
        pairs.filter(|&pair| touch(pair) && !never_collide(pair)).collect()
    }

    /// First of the links that are fixed to each other, for each link.
    fn rigid_bodies(&self) -> Vec<usize> {
        let mut bodies = vec![0];
        for (index, joint) in self.joints.iter().enumerate() {
            let fixed_to = bodies[joint.parent];
            bodies.push(joint.motion.map_or(fixed_to, |_| index + 1));
        }
        bodies
    }

    /// The links below `link` that it moves on or is fixed to, as far as both have shapes.
    fn neighbours(&self, link: usize) -> Vec<usize> {
        let has_shapes = |link: usize| !self.links[link].shapes.is_empty();
        let mut found = Vec::new();
        let mut below = link.checked_sub(1).filter(|_| has_shapes(link));
        let mut moves = 0;
        while let Some(joint) = below {
            let Joint { parent, motion, .. } = &self.joints[joint];
            moves += usize::from(motion.is_some());
            if moves > 1 {
                break;
            }
            found.extend(has_shapes(*parent).then_some(*parent));
            below = parent.checked_sub(1);
        }
        found
    }

    fn equalities(&self) -> String {
        let names: Vec<&str> = self.free_joints().map(|(joint, _)| &joint.name[..]).collect();
        let equality = |joint: &Joint| match joint.motion?.drive {
            Drive::Free { .. } => None,
            Drive::Follows { dof, multiplier, offset } => Some(format!(
                "<joint joint1=\"{}\" joint2=\"{}\" polycoef=\"{offset} {multiplier} 0 0 0\"/>\n",
                escaped(&joint.name),
                escaped(names[dof]),
            )),
        };
        self.joints.iter().filter_map(equality).collect()
    }

    fn servos(&self, servo: &Servo) -> String {
        let of_joint = |(joint, motion): (&Joint, &Motion)| {
            let name = escaped(&joint.name);
            let (stiffness, effort) = (motion.effort / servo.saturation, motion.effort);
            let damping = stiffness * servo.damping_time;
            format!(
                "<general name=\"{name}\" joint=\"{name}\" biastype=\"affine\" \
                 gainprm=\"{stiffness}\" biasprm=\"0 -{stiffness} -{damping}\" \
                 forcelimited=\"true\" forcerange=\"-{effort} {effort}\"/>\n"
            )
        };
        self.free_joints().map(of_joint).collect()
    }
}

/// Start of a link's body. The name `world` is MuJoCo's own; only a root without shapes may have
/// it.
fn body(link: &Link, pose: &Pose, settings: &MjcfSettings) -> String {
    let name = match &link.name[..] {
        "world" => String::new(),
        name => format!(" name=\"{}\"", escaped(name)),
    };
    let mut classes = settings.classes.iter();
    let class = classes.find(|(of, _)| *of == link.name);
    let class =
        class.map_or(String::new(), |(_, class)| format!(" childclass=\"{}\"", escaped(class)));
    format!("<body{name}{class}{}>\n", placed(pose))
}

/// The inertia of a link that has shapes and no mass.
const NO_MASS: &str = "<inertial pos=\"0 0 0\" mass=\"0\" diaginertia=\"0 0 0\"/>\n";

/// Mass and shapes of a link, and what is added to it.
fn contents(link: &Link, settings: &MjcfSettings) -> String {
    let shapes = link.shapes.iter().enumerate();
    let geoms = shapes.map(|(index, shape)| geom(&format!("{}_{index}", link.name), shape));
    let additions = settings.additions.iter();
    let additions = additions.filter(|addition| addition.link == link.name);
    let mass = match link.inertia {
        Some(inertia) => inertial(&inertia),
        None if link.shapes.is_empty() => String::new(),
        None => NO_MASS.to_owned(),
    };
    mass + &geoms.collect::<String>()
        + &additions.map(|addition| &addition.mjcf[..]).collect::<String>()
}

fn inertial(inertia: &Inertia) -> String {
    let [x, y, z] = [inertia.tensor.x_axis, inertia.tensor.y_axis, inertia.tensor.z_axis];
    format!(
        "<inertial pos=\"{}\" mass=\"{}\" fullinertia=\"{} {} {} {} {} {}\"/>\n",
        numbers(inertia.centre),
        inertia.mass,
        x.x,
        y.y,
        z.z,
        x.y,
        x.z,
        y.z
    )
}

fn moving(name: &str, motion: &Motion) -> String {
    let kind = match motion.kind {
        MotionKind::Hinge => "hinge",
        MotionKind::Slide => "slide",
    };
    let range = |[low, high]: [f64; 2]| format!(" limited=\"true\" range=\"{low} {high}\"");
    format!(
        "<joint name=\"{}\" type=\"{kind}\" axis=\"{}\" damping=\"{}\" frictionloss=\"{}\"{}/>\n",
        escaped(name),
        numbers(motion.axis),
        motion.damping,
        motion.friction,
        motion.range.map_or(String::new(), range)
    )
}

/// A shape, which has no mass of its own.
fn geom(name: &str, placed_shape: &PlacedShape) -> String {
    let (kind, size) = match placed_shape.shape {
        Shape::Sphere { radius } => ("sphere", format!("{radius}")),
        Shape::Capsule { radius, length } => ("capsule", format!("{radius} {}", 0.5 * length)),
        Shape::Cylinder { radius, length } => ("cylinder", format!("{radius} {}", 0.5 * length)),
        Shape::Box { half } => ("box", numbers(half)),
    };
    let (name, place) = (escaped(name), placed(&placed_shape.pose));
    format!("<geom name=\"{name}\" type=\"{kind}\" size=\"{size}\"{place} mass=\"0\"/>\n")
}

/// Attributes of a pose; a quaternion starts with its real part.
fn placed(pose: &Pose) -> String {
    let DQuat { x, y, z, w } = pose.rotation;
    format!(" pos=\"{}\" quat=\"{w} {x} {y} {z}\"", numbers(pose.position))
}

fn numbers(DVec3 { x, y, z }: DVec3) -> String {
    format!("{x} {y} {z}")
}

/// A text as the value of an attribute.
pub(crate) fn escaped(name: &str) -> String {
    let escape = |character: char| match character {
        '&' => "&amp;".to_owned(),
        '<' => "&lt;".to_owned(),
        '>' => "&gt;".to_owned(),
        '"' => "&quot;".to_owned(),
        plain => plain.to_string(),
    };
    name.chars().map(escape).collect()
}
