//! Conversion of a robot to MJCF, for MuJoCo 2.2.2 and 3.
//!
//! Read this before editing. Both read the same text, so it allows for these rules, all of which
//! 2.2.2 has:
//! - rotations are quaternions, because its Euler angles turn with the body and URDF's do not;
//! - joints, controls and forces have no limits unless `limited`, `ctrllimited` and `forcelimited`
//!   say so;
//! - `fullinertia` is ordered ixx iyy izz ixy ixz iyz;
//! - a body that has shapes but no `inertial` gets the mass of its shapes, and several shapes
//!   without mass are rejected;
//! - two bodies that are fixed to each other do not collide, nor do two that one joint moves
//!   against each other, unless one of them is fixed to the world;
//! - a position actuator has no damping;
//! - its XML parser rejects elements in the 100th level.

use std::collections::BTreeMap;

use glam::DQuat;
use serde::Serialize;

use crate::capsule::{PlacedShape, Shape};
use crate::description::{
    Inertia, Joint, JointMotionKind, JointMotionSpec, JointPositionSource, Link, RobotDescription,
};
use crate::error::DescriptionError;
use crate::error::{all, check_numbers, require};
use crate::ik::spread;
use crate::overlap::Solids;
use crate::pose::Pose;

/// Maximum number of nested links. With the document and two elements around them there are 99
/// levels, the most that MuJoCo's parser accepts.
const MAX_NESTED_LINKS: usize = 96;

/// Number of postures in which links are tried for contacts.
const POSTURES: usize = 32;

/// Robot converted to MJCF, MuJoCo's format.
#[derive(Clone, Debug, PartialEq)]
pub struct Mjcf {
    /// MJCF source.
    pub text: String,
    /// Pairs of links whose collisions are switched off in all poses.
    pub excluded_pairs: TouchingLinkPairs,
}

/// Pairs of links, more than one joint apart, that touch at rest or in most postures.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct TouchingLinkPairs {
    /// Pairs that touch at rest ([`RobotDescription::rest_positions`]).
    pub at_rest: Vec<[String; 2]>,
    /// Other pairs, which touch in more than half of 32 postures that are spread over the ranges of
    /// the joints.
    pub in_most_postures: Vec<[String; 2]>,
}

impl TouchingLinkPairs {
    /// Returns all pairs, those that touch at rest first.
    pub fn iter(&self) -> impl Iterator<Item = &[String; 2]> {
        self.at_rest.iter().chain(&self.in_most_postures)
    }
}

/// Settings of the conversion to MJCF: servos, default classes and added elements.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct MjcfSettings {
    /// Servos of the joints; if `None`, the model has no actuators.
    pub servo: Option<JointServoSettings>,
    /// Pairs of a link and the default class (`childclass`) of its geometries and of all links
    /// below it. The scene must declare the classes.
    pub link_classes: Vec<(String, String)>,
    /// Elements that are added to links.
    pub additions: Vec<LinkMjcfAddition>,
}

/// MJCF elements that are added to a link's body, for instance sites and cameras.
///
/// Added geoms contribute mass only to a link that has neither mass nor shapes; added bodies have
/// masses of their own.
#[derive(Clone, Debug, PartialEq)]
pub struct LinkMjcfAddition {
    /// Name of the link.
    pub link: String,
    /// MJCF of the elements, which is not checked.
    pub mjcf: String,
}

/// Servos of the free joints: the force is the position error times the stiffness (effort over
/// `saturation_error`) plus the speed error times the damping (stiffness times `damping_time`), up
/// to the joint's effort.
///
/// An actuator has the name of its joint, and takes [`JointServoSettings::control_signal`] as its
/// control. Its damping needs an implicit integrator (`<option integrator="implicit"/>`); with
/// Euler's it vibrates.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct JointServoSettings {
    /// Position error (radians, metres) at which the servo applies the joint's maximum effort; 1e-6
    /// or more.
    pub saturation_error: f64,
    /// Damping over stiffness (seconds); zero or more.
    pub damping_time: f64,
}

impl Default for JointServoSettings {
    /// Returns settings that give a Kinova Gen3 about the stiffness that others simulate it with:
    /// 1950 and 450 N m/rad.
    fn default() -> Self {
        Self { saturation_error: 0.02, damping_time: 0.03 }
    }
}

impl JointServoSettings {
    fn check(&self) -> Result<(), DescriptionError> {
        let Self { saturation_error, damping_time } = *self;
        let place = || "the servo".to_owned();
        let values = [saturation_error, damping_time];
        check_numbers(place, "its saturation error or damping time", &values)?;
        let (what, expected) = ("its saturation error", "1e-6 or more");
        require(saturation_error >= 1e-6, place, what, saturation_error, expected)?;
        let (damping, expected_damping) = ("its damping time", "zero or more");
        require(damping_time >= 0.0, place, damping, damping_time, expected_damping)
    }

    /// Returns the offset of a joint's control that adds `force` (newtons, newton metres), for
    /// instance one of [`RobotDescription::gravity_compensation_forces`]. Zero for a joint without
    /// a known effort, which can have no servo.
    pub fn control_offset_for_force(&self, motion: &JointMotionSpec, force: f64) -> f64 {
        motion.max_effort.map_or(0.0, |effort| force * self.saturation_error / effort)
    }

    /// Returns the control with which a joint follows a position (radians, metres) and its velocity
    /// (rad/s, m/s).
    pub fn control_signal(&self, position: f64, velocity: f64) -> f64 {
        // cancels the servo's damping at this velocity
        position + self.damping_time * velocity
    }
}

impl RobotDescription {
    /// Converts the robot to a complete MJCF model.
    ///
    /// It has links with masses and collision shapes, joints with limits and friction, servos in
    /// the order of position vectors, and an equality for each joint that follows another. Bodies
    /// and joints have the names of links and joints; a shape has its link's name with `_0`, `_1`
    /// and so on. A link does not collide with the link that it moves on, nor do links that touch
    /// at rest or in most postures ([`Mjcf::excluded_pairs`]).
    ///
    /// # Errors
    /// [`DescriptionError::NumberOutOfRange`] for a servo out of range,
    /// [`DescriptionError::UnknownLink`] for a class or an addition of an unknown link,
    /// [`DescriptionError::TooManyLinksInRow`] for more than 96 nested links,
    /// [`DescriptionError::InvalidName`] for a link `world` with shapes or mass.
    /// [`DescriptionError::MissingInertia`] and [`DescriptionError::InvalidInertia`] for bodies
    /// that cannot be simulated, [`DescriptionError::MissingShapes`] for shapes that could not be
    /// read, [`DescriptionError::NumberOutOfRange`] for a lower limit above the upper one; with
    /// servos, [`DescriptionError::MissingEffort`].
    pub fn to_mjcf(&self, settings: &MjcfSettings) -> Result<Mjcf, DescriptionError> {
        let name = xml_escaped(&self.name);
        let head = "<compiler angle=\"radian\"/>\n<option integrator=\"implicit\"/>\n";
        let sections = self.sections(settings)?;
        let text = format!("<mujoco model=\"{name}\">\n{head}{}</mujoco>\n", sections.text);
        Ok(Mjcf { text, ..sections })
    }

    /// Converts the robot to an MJCF part (`<mujocoinclude>`) that a scene can include.
    ///
    /// The scene must count angles in radians and, with servos, use an implicit integrator.
    ///
    /// # Errors
    /// Errors of [`RobotDescription::to_mjcf`].
    pub fn to_mjcf_include(&self, settings: &MjcfSettings) -> Result<Mjcf, DescriptionError> {
        let sections = self.sections(settings)?;
        let text = format!("<mujocoinclude>\n{}</mujocoinclude>\n", sections.text);
        Ok(Mjcf { text, ..sections })
    }

    /// Writes the sections of a model, without an element around them.
    fn sections(&self, settings: &MjcfSettings) -> Result<Mjcf, DescriptionError> {
        settings.servo.map_or(Ok(()), |servo| servo.check())?;
        self.check_links(settings)?;
        self.check_nesting()?;
        self.check_world()?;
        let (inertias, findings) = self.simulated_inertias();
        let mut errors: Vec<_> = findings.into_iter().filter_map(|of| of.error).collect();
        if !self.missing_shapes.is_empty() {
            errors.push(DescriptionError::MissingShapes { shapes: self.missing_shapes.clone() });
        }
        errors.extend(self.joints.iter().filter_map(reversed));
        let joints = self.free_joints().filter(|(_, motion)| motion.max_effort.is_none());
        let joints: Vec<String> = joints.map(|(joint, _)| joint.name.clone()).collect();
        if settings.servo.is_some() && !joints.is_empty() {
            errors.push(DescriptionError::MissingEffort { joints });
        }
        all(errors)?;
        let servos = settings.servo.map_or(String::new(), |servo| self.servos(&servo));
        let section = |(name, text): (&str, String)| match &text[..] {
            "" => String::new(),
            text => format!("<{name}>\n{text}</{name}>\n"),
        };
        let touching = self.touching_pairs();
        let sections = [
            ("asset", self.meshes()),
            ("worldbody", self.bodies(settings, &inertias)),
            ("contact", self.excludes(&touching)),
            ("equality", self.equalities()),
            ("actuator", servos),
        ];
        Ok(Mjcf { text: sections.map(section).concat(), excluded_pairs: touching })
    }

    fn check_links(&self, settings: &MjcfSettings) -> Result<(), DescriptionError> {
        let classes = settings.link_classes.iter().map(|(link, _)| link);
        let additions = settings.additions.iter().map(|addition| &addition.link);
        let mut named = classes.chain(additions);
        named.try_for_each(|link| self.link_index(link, "a setting of the MJCF").map(|_| ()))
    }

    /// Rejects a robot with more than [`MAX_NESTED_LINKS`] links in a row.
    fn check_nesting(&self) -> Result<(), DescriptionError> {
        let mut levels = vec![1];
        for joint in &self.joints {
            levels.push(levels[joint.parent] + 1);
        }
        match levels.iter().position(|&level| level > MAX_NESTED_LINKS) {
            None => Ok(()),
            Some(link) => Err(DescriptionError::TooManyLinksInRow {
                link: self.links[link].name.clone(),
                limit: MAX_NESTED_LINKS,
            }),
        }
    }

    /// Rejects a link `world` that is not a bare root: MuJoCo reserves the name for its own body.
    fn check_world(&self) -> Result<(), DescriptionError> {
        let is_bare = |link: &Link| link.shapes.is_empty() && link.inertia.is_none();
        let first = usize::from(is_bare(&self.links[0]));
        if self.links[first..].iter().all(|link| link.name != "world") {
            return Ok(());
        }
        Err(DescriptionError::InvalidName {
            kind: "link",
            name: "world".to_owned(),
            reason: "it is reserved for the simulated world and a root without shapes and mass",
        })
    }

    /// Writes the bodies, each inside its parent.
    ///
    /// Links are in depth-first order, so a link closes the open bodies that it does not hang on.
    fn bodies(&self, settings: &MjcfSettings, inertias: &[Option<Inertia>]) -> String {
        let contents = |link: usize| contents(&self.links[link], inertias[link], settings);
        let mut text = body(&self.links[0], &self.base_pose, settings) + &contents(0);
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
            text += &contents(link);
        }
        text + &"</body>\n".repeat(open.len())
    }

    /// Writes `<exclude>` for the pairs of links that must not collide.
    fn excludes(&self, touching: &TouchingLinkPairs) -> String {
        let links = 0..self.links.len();
        let pairs =
            links.flat_map(|link| self.neighbours(link).into_iter().map(move |n| [n, link]));
        let exclude = |pair: [String; 2]| {
            let [first, second] = pair.map(|name| xml_escaped(&name));
            format!("<exclude body1=\"{first}\" body2=\"{second}\"/>\n")
        };
        let neighbours = pairs.map(|pair| self.link_names(pair));
        neighbours.chain(touching.iter().cloned()).map(exclude).collect()
    }

    fn link_names(&self, pair: [usize; 2]) -> [String; 2] {
        pair.map(|link| self.links[link].name.clone())
    }

    /// Writes the mesh of each hull, with the name of its geom.
    fn meshes(&self) -> String {
        let mut meshes = String::new();
        for link in &self.links {
            for (index, placed) in link.shapes.iter().enumerate() {
                if let Shape::Hull(hull) = &placed.shape {
                    let points: Vec<String> =
                        hull.points().iter().map(|of| numbers(&of.to_array())).collect();
                    let name = xml_escaped(&geom_name(link, index));
                    meshes += &format!("<mesh name=\"{name}\" vertex=\"{}\"/>\n", points.join(" "));
                }
            }
        }
        meshes
    }

    /// Returns the pairs of links that would collide at rest, and the others that would in more
    /// than half of [`POSTURES`] postures.
    pub(crate) fn touching_pairs(&self) -> TouchingLinkPairs {
        let (at_rest, others) = self.split_touching(self.colliding_pairs(), &self.rest_positions());
        let ranges: Vec<_> = self.free_joints().map(|(_, motion)| motion.range).collect();
        let mut counts = BTreeMap::new();
        for number in 1..=POSTURES {
            let positions = spread(&ranges, &self.rest_positions(), number);
            for pair in self.split_touching(others.clone(), &positions).0 {
                *counts.entry(pair).or_insert(0) += 1;
            }
        }
        counts.retain(|_, &mut count| 2 * count > POSTURES);
        TouchingLinkPairs {
            at_rest: at_rest.into_iter().map(|pair| self.link_names(pair)).collect(),
            in_most_postures: counts.into_keys().map(|pair| self.link_names(pair)).collect(),
        }
    }

    /// Returns the pairs of links with shapes that can collide: no joint alone separates them.
    fn colliding_pairs(&self) -> Vec<[usize; 2]> {
        let bodies = self.rigid_bodies();
        let moves_on = |body: usize, other: usize| {
            let joint = body.checked_sub(1);
            other > 0 && joint.is_some_and(|joint| bodies[self.joints[joint].parent] == other)
        };
        let has_shapes = |link: &usize| !self.links[*link].shapes.is_empty();
        let with_shapes: Vec<usize> = (0..self.links.len()).filter(has_shapes).collect();
        let mut pairs = Vec::new();
        for (index, &b) in with_shapes.iter().enumerate() {
            let neighbours = self.neighbours(b);
            let collides = |a: &usize| {
                let [one, other] = [bodies[*a], bodies[b]];
                one != other
                    && !moves_on(one, other)
                    && !moves_on(other, one)
                    && !neighbours.contains(a)
            };
            pairs.extend(with_shapes[..index].iter().copied().filter(collides).map(|a| [a, b]));
        }
        pairs
    }

    /// Splits pairs of links into those that touch in these positions and those that do not.
    fn split_touching(
        &self,
        pairs: Vec<[usize; 2]>,
        positions: &[f64],
    ) -> (Vec<[usize; 2]>, Vec<[usize; 2]>) {
        let poses = self.link_poses(positions);
        let links = self.links.iter().zip(&poses);
        let solids: Vec<Solids> =
            links.map(|(link, pose)| Solids::new(&link.shapes, pose)).collect();
        pairs.into_iter().partition(|&[a, b]| solids[a].touch(&solids[b]))
    }

    /// Returns the links between `link` and the root that at most one joint separates from it, as
    /// far as both have shapes.
    fn neighbours(&self, link: usize) -> Vec<usize> {
        let has_shapes = |index: usize| !self.links[index].shapes.is_empty();
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

    /// Writes an equality for each joint that follows another.
    fn equalities(&self) -> String {
        let names: Vec<&str> = self.free_joints().map(|(joint, _)| &joint.name[..]).collect();
        let equality = |joint: &Joint| match joint.motion?.drive {
            JointPositionSource::Free { .. } => None,
            JointPositionSource::Follows { dof, multiplier, offset } => Some(format!(
                "<joint joint1=\"{}\" joint2=\"{}\" polycoef=\"{} 0 0 0\"/>\n",
                xml_escaped(&joint.name),
                xml_escaped(names[dof]),
                numbers(&[offset, multiplier])
            )),
        };
        self.joints.iter().filter_map(equality).collect()
    }

    /// Writes an actuator for each free joint.
    fn servos(&self, servo: &JointServoSettings) -> String {
        let of_joint = |(joint, motion): (&Joint, &JointMotionSpec)| {
            let name = xml_escaped(&joint.name);
            // no servos are written where an effort is unknown
            let effort = motion.max_effort.unwrap_or_default();
            let stiffness = effort / servo.saturation_error;
            let damping = stiffness * servo.damping_time;
            let [stiffness, damping, effort] = [stiffness, damping, effort].map(short_number);
            format!(
                "<general name=\"{name}\" joint=\"{name}\" biastype=\"affine\" \
                 gainprm=\"{stiffness}\" biasprm=\"0 -{stiffness} -{damping}\" \
                 forcelimited=\"true\" forcerange=\"-{effort} {effort}\"/>\n"
            )
        };
        self.free_joints().map(of_joint).collect()
    }
}

/// Returns an error for a joint whose lower limit is above its upper one.
fn reversed(joint: &Joint) -> Option<DescriptionError> {
    let [low, high] = joint.motion?.range?;
    let place = || format!("the joint `{}`", joint.name);
    let what = "its lower limit";
    let expected = "a position not above its upper limit: exchange them in its `<limit>`";
    require(low <= high, place, what, low, expected).err()
}

fn body(link: &Link, pose: &Pose, settings: &MjcfSettings) -> String {
    let name = match &link.name[..] {
        // MuJoCo's own name of the world's body; `check_world` allows it for a bare root only
        "world" => String::new(),
        name => format!(" name=\"{}\"", xml_escaped(name)),
    };
    let mut classes = settings.link_classes.iter();
    let class = classes.find(|(of, _)| *of == link.name);
    let class =
        class.map_or(String::new(), |(_, class)| format!(" childclass=\"{}\"", xml_escaped(class)));
    format!("<body{name}{class}{}>\n", placed(pose))
}

/// Inertia of a link with shapes and no mass: MuJoCo rejects several shapes without mass otherwise.
const NO_MASS: &str = "<inertial pos=\"0 0 0\" mass=\"0\" diaginertia=\"0 0 0\"/>\n";

/// Writes the mass, shapes and added elements of a link.
fn contents(link: &Link, inertia: Option<Inertia>, settings: &MjcfSettings) -> String {
    let shapes = link.shapes.iter().enumerate();
    let geoms = shapes.map(|(index, shape)| geom(&geom_name(link, index), shape));
    let additions = settings.additions.iter();
    let additions = additions.filter(|addition| addition.link == link.name);
    let mass = match inertia {
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
        "<inertial pos=\"{}\" mass=\"{}\" fullinertia=\"{}\"/>\n",
        numbers(&inertia.centre_of_mass.to_array()),
        short_number(inertia.mass),
        numbers(&[x.x, y.y, z.z, x.y, x.z, y.z])
    )
}

fn moving(name: &str, motion: &JointMotionSpec) -> String {
    let kind = match motion.kind {
        JointMotionKind::Hinge => "hinge",
        JointMotionKind::Slide => "slide",
    };
    let range = |limits: [f64; 2]| format!(" limited=\"true\" range=\"{}\"", numbers(&limits));
    format!(
        "<joint name=\"{}\" type=\"{kind}\" axis=\"{}\" damping=\"{}\" frictionloss=\"{}\"{}/>\n",
        xml_escaped(name),
        numbers(&motion.axis.to_array()),
        short_number(motion.damping),
        short_number(motion.friction),
        motion.range.map_or(String::new(), range)
    )
}

fn geom_name(link: &Link, index: usize) -> String {
    format!("{}_{index}", link.name)
}

/// Writes a shape, without mass: the link's `<inertial>` states the mass.
fn geom(name: &str, placed_shape: &PlacedShape) -> String {
    let (name, place) = (xml_escaped(name), placed(&placed_shape.pose));
    let of_sizes =
        |kind: &str, sizes: &[f64]| format!("type=\"{kind}\" size=\"{}\"", numbers(sizes));
    let shape = match placed_shape.shape {
        Shape::Sphere { radius } => of_sizes("sphere", &[radius]),
        Shape::Capsule { radius, length } => of_sizes("capsule", &[radius, 0.5 * length]),
        Shape::Cylinder { radius, length } => of_sizes("cylinder", &[radius, 0.5 * length]),
        Shape::Box { half_extents } => of_sizes("box", &half_extents.to_array()),
        Shape::Hull(_) => format!("type=\"mesh\" mesh=\"{name}\""),
    };
    format!("<geom name=\"{name}\" {shape}{place} mass=\"0\"/>\n")
}

fn placed(pose: &Pose) -> String {
    // MuJoCo's quaternions start with the real part
    let DQuat { x, y, z, w } = pose.rotation;
    let position = numbers(&pose.position.to_array());
    format!(" pos=\"{position}\" quat=\"{}\"", numbers(&[w, x, y, z]))
}

/// Returns a number as text that reads back to the same bits, with an exponent where it would be
/// long: MuJoCo 3 refuses words of hundreds of digits. It also refuses subnormal numbers, which
/// become zero.
fn short_number(value: f64) -> String {
    let value = if value.is_subnormal() { 0.0 } else { value };
    let plain = value.to_string();
    if plain.len() > 25 { format!("{value:e}") } else { plain }
}

/// Returns [`short_number`]s with blanks between.
fn numbers(values: &[f64]) -> String {
    values.iter().copied().map(short_number).collect::<Vec<_>>().join(" ")
}

/// Returns a text with `&`, `<`, `>` and `"` escaped, for XML and HTML: for text between tags and
/// for the value of an attribute in double quotes.
pub fn xml_escaped(text: &str) -> String {
    let escape = |character: char| match character {
        '&' => "&amp;".to_owned(),
        '<' => "&lt;".to_owned(),
        '>' => "&gt;".to_owned(),
        '"' => "&quot;".to_owned(),
        plain => plain.to_string(),
    };
    text.chars().map(escape).collect()
}
