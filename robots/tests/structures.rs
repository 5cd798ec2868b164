//! Random robots of every structure: MuJoCo loads the MJCF of each.

use std::collections::BTreeSet;
use std::fmt::Write as _;
use std::sync::Arc;

use mujoco::{Data, Model};
use proptest::prelude::*;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use robots::{JointServoSettings, MjcfSettings, RobotDescription, UrdfSettings};

use crate::meshes::Folder;

/// Generator of a random tree, with the OBJ files of its meshes.
struct Draw(ChaCha8Rng, Vec<String>);

impl Draw {
    fn new(seed: u64) -> Self {
        Self(ChaCha8Rng::seed_from_u64(seed), Vec::new())
    }

    /// Draws a robot and reads it from a folder with its meshes.
    fn read(seed: u64, most: usize, sizes: [f64; 2]) -> (String, RobotDescription) {
        let mut draw = Self::new(seed);
        let urdf = draw.robot(most, sizes);
        let folder = Folder::new(&format!("structure-{seed}"));
        for (index, mesh) in draw.1.iter().enumerate() {
            folder.write(&format!("arm_description/urdf/{index}.obj"), mesh.as_bytes());
        }
        let robot = folder.read_with(&urdf, &UrdfSettings::default());
        let robot = robot.unwrap_or_else(|error| panic!("{error}\n{urdf}"));
        assert!(robot.missing_shape_reasons().is_empty(), "{:?}", robot.missing_shape_reasons());
        (urdf, robot)
    }

    /// Points of a mesh of this size, some of which are all in a plane or on a line.
    fn mesh(&mut self, size: [f64; 3]) -> String {
        let flat = [0; 3].map(|_| if self.chance(0.1) { 0.0 } else { 1.0 });
        let count = self.0.random_range(1..60);
        let point = |_| {
            let [x, y, z] =
                [0, 1, 2].map(|axis| flat[axis] * self.0.random_range(-size[axis]..size[axis]));
            format!("v {x} {y} {z}\n")
        };
        (0..count).map(point).collect()
    }

    fn chance(&mut self, part: f64) -> bool {
        self.0.random_bool(part)
    }

    /// A number of any order of magnitude between two positive ones.
    fn scale(&mut self, [low, high]: [f64; 2]) -> f64 {
        self.0.random_range(low.ln()..high.ln()).exp()
    }

    fn vector(&mut self, most: f64) -> String {
        let [x, y, z] = [0; 3].map(|_| self.0.random_range(-most..most));
        format!("{x} {y} {z}")
    }

    fn origin(&mut self) -> String {
        let (xyz, rpy) = (self.vector(0.3), self.vector(3.0));
        format!("<origin xyz=\"{xyz}\" rpy=\"{rpy}\"/>")
    }

    /// An inertia of masses along three axes, which is one of a body in any axes.
    fn inertial(&mut self) -> String {
        let mass = self.scale([1e-6, 1e3]);
        let [x, y, z] = [0; 3].map(|_| self.scale([1e-11, 1.0]));
        format!(
            "<inertial>{}<mass value=\"{mass}\"/><inertia ixx=\"{}\" iyy=\"{}\" izz=\"{}\" \
             ixy=\"0\" ixz=\"0\" iyz=\"0\"/></inertial>",
            self.origin(),
            y + z,
            z + x,
            x + y
        )
    }

    /// Up to three shapes of each kind.
    fn shapes(&mut self, sizes: [f64; 2]) -> String {
        let mut shapes = String::new();
        for kind in 0..5 {
            let count = if self.chance(0.5) { 0 } else { self.0.random_range(1..4) };
            for _ in 0..count {
                let [a, b, c] = [0; 3].map(|_| self.scale(sizes));
                let shape = match kind {
                    0 => format!("<sphere radius=\"{a}\"/>"),
                    1 => format!("<capsule radius=\"{a}\" length=\"{b}\"/>"),
                    2 => format!("<cylinder radius=\"{a}\" length=\"{b}\"/>"),
                    3 => {
                        let points = self.mesh([a, b, c]);
                        self.1.push(points);
                        format!("<mesh filename=\"{}.obj\"/>", self.1.len() - 1)
                    }
                    _ => format!("<box size=\"{a} {b} {c}\"/>"),
                };
                let origin = self.origin();
                shapes += &format!("<collision>{origin}<geometry>{shape}</geometry></collision>");
            }
        }
        shapes
    }

    /// A link with the mass `inertial` that is fixed to a link, at times by frames without mass.
    fn load(&mut self, link: usize, mut inertial: String) -> String {
        let (mut load, mut parent) = (String::new(), name(link));
        for depth in (0..self.0.random_range(1..4)).rev() {
            let child = format!("load {link} {depth}");
            let own = if depth == 0 { std::mem::take(&mut inertial) } else { String::new() };
            let _ = write!(
                load,
                "<link name=\"{child}\">{own}</link><joint name=\"hold {child}\" \
                 type=\"fixed\">{}<parent link=\"{parent}\"/><child link=\"{child}\"/></joint>",
                self.origin()
            );
            parent = child;
        }
        load
    }

    /// A robot of up to `most` links, all but the root of which hang on a joint of any kind.
    fn robot(&mut self, most: usize, sizes: [f64; 2]) -> String {
        let count = self.0.random_range(1..=most);
        let mut urdf = "<robot name=\"\">".to_owned();
        let mut leaders = Vec::new();
        for link in 0..count {
            let kinds = ["fixed", "fixed", "revolute", "continuous", "prismatic"];
            let kind = kinds[self.0.random_range(0..kinds.len())];
            let moves = link > 0 && kind != "fixed";
            let massive = moves || self.chance(0.3);
            let mut inertial = if massive { self.inertial() } else { String::new() };
            // some links that move have their mass on a link that is fixed to them
            let load = if moves && self.chance(0.2) {
                self.load(link, std::mem::take(&mut inertial))
            } else {
                String::new()
            };
            let shapes = if self.chance(0.7) { self.shapes(sizes) } else { String::new() };
            let _ = write!(urdf, "<link name=\"{}\">{inertial}{shapes}</link>{load}", name(link));
            if link == 0 {
                continue;
            }
            // long arms are as likely as bushes
            let parent = if self.chance(0.7) { link - 1 } else { self.0.random_range(0..link) };
            let [low, high] = self.range();
            let middle = if kind == "continuous" { 0.0 } else { 0.5 * (low + high) };
            let follows = moves && !leaders.is_empty() && self.chance(0.3);
            let mimic = if follows {
                let leader = leaders[self.0.random_range(0..leaders.len())];
                self.mimic(leader, middle)
            } else {
                String::new()
            };
            if moves && !follows {
                leaders.push((link, middle));
            }
            let (effort, speed) = (self.scale([1e-3, 1e5]), self.scale([1e-3, 1e3]));
            let _ = write!(
                urdf,
                "<joint name=\"joint {link}\" type=\"{kind}\">{}<parent link=\"{}\"/>\
                 <child link=\"{}\"/><axis xyz=\"{}\"/><limit lower=\"{low}\" upper=\"{high}\" \
                 effort=\"{effort}\" velocity=\"{speed}\"/>{mimic}</joint>",
                self.origin(),
                name(parent),
                name(link),
                self.vector(1.0),
            );
        }
        urdf + "</robot>"
    }

    fn range(&mut self) -> [f64; 2] {
        let low = self.0.random_range(-3.0..3.0);
        [low, low + self.scale([1e-3, 6.0])]
    }

    /// A joint whose range has its middle at `middle` follows one to whose middle that belongs.
    fn mimic(&mut self, (leader, its_middle): (usize, f64), middle: f64) -> String {
        let multiplier = match self.0.random_range(0..4) {
            0 => self.scale([1e-310, 1e-3]),
            1 => -self.scale([1e-310, 1e-3]),
            _ => self.0.random_range(-2.0..2.0),
        };
        let offset = middle - multiplier * its_middle;
        format!("<mimic joint=\"joint {leader}\" multiplier=\"{multiplier}\" offset=\"{offset}\"/>")
    }
}

/// Names that look like those of shapes, with characters that XML escapes.
fn name(link: usize) -> String {
    match link % 3 {
        0 => format!("link_{link}"),
        1 => format!("link_0_{link}"),
        _ => format!("&quot;{link} &lt;&amp;&gt;"),
    }
}

fn with_servo() -> MjcfSettings {
    MjcfSettings { servo: Some(JointServoSettings::default()), ..MjcfSettings::default() }
}

/// Returns a robot of this many links, each of which moves on the one before it.
fn long(links: usize) -> RobotDescription {
    let inertial = "<inertial><mass value=\"1\"/><inertia ixx=\"1\" iyy=\"1\" izz=\"1\" ixy=\"0\" \
                    ixz=\"0\" iyz=\"0\"/></inertial>";
    let link = |index: usize| format!("<link name=\"{index}\">{inertial}</link>");
    let joint = |index: usize| {
        format!(
            "<joint name=\"{index}\" type=\"continuous\"><parent link=\"{}\"/><child link=\"{index}\"/>\
             <axis xyz=\"0 0 1\"/><limit effort=\"1\" velocity=\"1\"/></joint>",
            index - 1
        )
    };
    let links_text: String = (0..links).map(link).collect();
    let joints: String = (1..links).map(joint).collect();
    RobotDescription::from_urdf(&format!("<robot name=\"long\">{links_text}{joints}</robot>"))
        .unwrap()
}

#[test]
fn rows_that_mujoco_does_not_read_are_refused() {
    let settings = MjcfSettings::default();
    let mjcf = long(96).to_mjcf(&settings).unwrap();
    Model::from_xml(&mjcf.text).unwrap();
    let refused = long(97).to_mjcf(&settings).unwrap_err().to_string();
    assert!(refused.contains("`96` hangs on 96 others"), "{refused}");
}

/// Names of links whose shapes MuJoCo finds in contact while the robot rests.
fn contacts(arm: &RobotDescription, mjcf: &str) -> BTreeSet<[String; 2]> {
    let model = Arc::new(Model::from_xml(mjcf).unwrap());
    let mut data = Data::new(Arc::clone(&model));
    let rest = arm.rest_positions();
    for joint in arm.joints() {
        if let Some(motion) = joint.motion {
            let address = model.joint_qpos_address(model.joint(&joint.name).unwrap());
            data.qpos_mut()[address] = motion.position_from_dofs(&rest);
        }
    }
    data.forward().unwrap();
    let order = |name: &str| arm.links().iter().position(|link| link.name == name);
    let pairs = data.contacts().map(|contact| {
        let mut links = contact.geoms.map(|geom| {
            let body = model.name_of(model.geom_body(geom)).unwrap();
            body.to_owned()
        });
        links.sort_by_key(|link| order(link));
        links
    });
    pairs.collect()
}

proptest! {
    #![proptest_config(ProptestConfig {
        cases: 100,
        failure_persistence: None,
        ..ProptestConfig::default()
    })]

    #[test]
    fn mujoco_takes_the_mjcf_of_every_robot(seed in any::<u64>()) {
        let (urdf, arm) = Draw::read(seed, 12, [1e-6, 1.0]);
        let mjcf = arm.to_mjcf(&with_servo()).unwrap();
        let model = Model::from_xml(&mjcf.text);
        prop_assert!(model.is_ok(), "{:?}\n{urdf}\n{}", model.err(), mjcf.text);
    }

    /// The excluded pairs are those that MuJoCo finds in contact, its own convex collisions being
    /// the slow twin. Shapes that are a millimetre apart are excluded, too.
    #[test]
    fn links_that_touch_at_rest_are_excluded_and_named(seed in any::<u64>()) {
        let (urdf, arm) = Draw::read(seed, 6, [0.02, 0.2]);
        let mjcf = arm.to_mjcf(&MjcfSettings::default()).unwrap();
        let named: BTreeSet<_> = mjcf.excluded_pairs.at_rest.iter().cloned().collect();
        let left = contacts(&arm, &mjcf.text);
        prop_assert!(left.is_empty(), "{left:?}\n{urdf}");
        let escape = |name: &String| {
            name.replace('&', "&amp;").replace('<', "&lt;").replace('>', "&gt;").replace('"', "&quot;")
        };
        let colliding = mjcf.excluded_pairs.at_rest.iter().fold(mjcf.text.clone(), |text, pair| {
            let [first, second] = pair.each_ref().map(escape);
            let line = format!("<exclude body1=\"{first}\" body2=\"{second}\"/>\n");
            let without = text.replacen(&line, "", 1);
            assert_ne!(without, text, "{line}");
            without
        });
        let wide = "<default><geom margin=\"0.002\"/></default>\n<worldbody>";
        let near = contacts(&arm, &colliding.replacen("<worldbody>", wide, 1));
        prop_assert!(named.is_subset(&near), "{named:?} {near:?}\n{urdf}");
        let touching = contacts(&arm, &colliding);
        prop_assert!(touching.is_subset(&named), "{touching:?} {named:?}\n{urdf}");
    }
}
