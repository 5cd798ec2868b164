//! Random robots with a left and a right side, of which one may have a fault.
//!
//! Sides are mirrored here by signs that are written out: nothing is shared with the checker.

use std::fmt::Write;

use rand::seq::IndexedRandom;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Faults: each is named by the property that a check must report.
pub const FAULTS: [&str; 10] = [
    "mass",
    "centre of mass",
    "inertia",
    "sign",
    "range",
    "damping",
    "friction",
    "size",
    "gain",
    "position",
];

/// Fault of one link on one side.
#[derive(Clone, Copy, Debug)]
pub struct Fault {
    pub property: &'static str,
    limb: usize,
    link: usize,
    /// Sign of y on the side of the fault.
    side: f64,
    size: f64,
}

/// Robot as MJCF, with the name of the faulty object.
pub struct Robot {
    pub mjcf: String,
    pub faulty: Option<(&'static str, String)>,
}

struct Link {
    offset: [f64; 3],
    mass: f64,
    centre: [f64; 3],
    /// Moments xx, yy, zz and products xy, xz, yz.
    inertia: [f64; 6],
    axis: [f64; 3],
    range: [f64; 2],
    damping: f64,
    friction: f64,
    radius: f64,
    gain: f64,
    rest: f64,
}

/// Conventions in which models of public robots differ.
struct Style {
    /// Names of the limbs, [left, right]; without names of sides, geometry alone tells them.
    limbs: Vec<[String; 2]>,
    /// `true` if the right joint's coordinate has the sign of the left one's.
    mirrored_axes: bool,
    /// `true` if frames on the right are turned by half a turn about z.
    turned_frames: bool,
    /// `true` if the robot looks along y.
    looks_along_y: bool,
    floats: bool,
    floor: bool,
}

impl Link {
    fn random(rng: &mut ChaCha8Rng) -> Self {
        let mut draw = |low: f64, high: f64| (rng.random_range(low..high) * 1e6).round() / 1e6;
        let moments = [draw(1.2e-3, 1.6e-3), draw(1.2e-3, 1.6e-3), draw(1.2e-3, 1.6e-3)];
        let products = [draw(5e-5, 1e-4), draw(-1e-4, 1e-4), draw(5e-5, 1e-4)];
        let axis = [[1.0, 0.0, 0.0], [0.0, 1.0, 0.0], [0.0, 0.6, 0.8], [0.8, 0.6, 0.0]];
        let at = draw(0.0, 4.0) as usize;
        Self {
            offset: [draw(-0.02, 0.02), draw(0.01, 0.05), draw(-0.2, -0.12)],
            mass: draw(0.3, 2.0),
            centre: [draw(-0.02, 0.02), draw(0.005, 0.02), draw(-0.1, -0.05)],
            inertia: [moments[0], moments[1], moments[2], products[0], products[1], products[2]],
            axis: axis[at.min(3)],
            range: [draw(-0.9, -0.4), draw(1.0, 1.6)],
            damping: draw(0.2, 1.0),
            friction: draw(0.5, 1.0),
            radius: draw(0.015, 0.03),
            gain: draw(10.0, 40.0),
            rest: draw(0.1, 0.3),
        }
    }
}

/// Draws a robot: the seed decides the kind, the conventions and all numbers.
pub fn random(seed: u64, property: Option<&'static str>) -> Robot {
    let mut rng = ChaCha8Rng::seed_from_u64(seed);
    let named = |limbs: &[[&str; 2]]| limbs.iter().map(|pair| pair.map(str::to_owned)).collect();
    let (limbs, links) = match seed % 3 {
        0 => {
            let styles: [Vec<[String; 2]>; 4] = [
                named(&[["FL", "FR"], ["RL", "RR"]]),
                named(&[["LF", "RF"], ["LH", "RH"]]),
                named(&[["front_left", "front_right"], ["hind_left", "hind_right"]]),
                named(&[["leg1", "leg2"], ["leg3", "leg4"]]),
            ];
            (styles.choose(&mut rng).unwrap().clone(), 3)
        }
        1 => (named(&[["left_leg", "right_leg"], ["l_arm", "r_arm"]]), 6),
        _ => (named(&[["arm_L", "arm_R"]]), 7),
    };
    let style = Style {
        limbs,
        mirrored_axes: rng.random(),
        turned_frames: rng.random(),
        looks_along_y: rng.random(),
        floats: seed % 3 < 2,
        floor: rng.random(),
    };
    let all: Vec<Vec<Link>> =
        style.limbs.iter().map(|_| (0..links).map(|_| Link::random(&mut rng)).collect()).collect();
    let fault = property.map(|property| Fault {
        property,
        limb: rng.random_range(0..style.limbs.len()),
        link: rng.random_range(0..links),
        side: if rng.random() { 1.0 } else { -1.0 },
        size: rng.random_range(0.02..0.3),
    });
    let faulty = fault.map(|fault| {
        let name = &style.limbs[fault.limb][usize::from(fault.side < 0.0)];
        let ending = match fault.property {
            "friction" | "size" => "_geom",
            _ => "",
        };
        (fault.property, format!("{name}_{}{ending}", fault.link))
    });
    Robot { mjcf: mjcf(&style, &all, fault), faulty }
}

fn mjcf(style: &Style, limbs: &[Vec<Link>], fault: Option<Fault>) -> String {
    let [mut bodies, mut actuators, mut sensors] = [const { String::new() }; 3];
    let [mut rest, mut controls] = [const { Vec::new() }; 2];
    for (limb, links) in limbs.iter().enumerate() {
        for (names, side) in style.limbs[limb].iter().zip([1.0, -1.0]) {
            let fault = fault.filter(|fault| fault.limb == limb && fault.side == side);
            let x = 0.25 - 0.5 * limb as f64;
            let shoulder = [x, 0.1 * side, 0.0];
            let positions = write_limb(&mut bodies, style, shoulder, names, links, fault);
            controls.extend(positions.iter().map(f64::to_string));
            let moved = |(index, position): (usize, &f64)| match fault {
                Some(fault) if fault.link == index && fault.property == "position" => {
                    position + 0.1
                }
                _ => *position,
            };
            rest.extend(positions.iter().enumerate().map(moved).map(|value| value.to_string()));
            for (index, link) in links.iter().enumerate() {
                let off = fault.filter(|f| f.link == index && f.property == "gain");
                let gain = link.gain * (1.0 + off.map_or(0.0, |off| off.size));
                let joint = format!("{names}_{index}");
                let _ = write!(
                    actuators,
                    "<general name='{joint}' joint='{joint}' gainprm='{gain}' biastype='affine' \
                     biasprm='0 -{} 0'/>",
                    link.gain
                );
                let _ = write!(sensors, "<jointpos joint='{joint}'/>");
            }
        }
    }
    let turn = if style.looks_along_y { "quat='1 0 0 1'" } else { "" };
    let (free, base) = match (style.floats, style.looks_along_y) {
        (true, true) => ("<freejoint/>", "0 0 1 1 0 0 1 "),
        (true, false) => ("<freejoint/>", "0 0 1 1 0 0 0 "),
        (false, _) => ("", ""),
    };
    let floor = if style.floor { "<geom name='floor' type='plane' size='5 5 1'/>" } else { "" };
    let [rest, controls] = [rest, controls].map(|values| values.join(" "));
    format!(
        "<mujoco><compiler angle='radian' autolimits='true'/><worldbody>{floor}\
         <body name='trunk' pos='0 0 1' {turn}>{free}\
         <inertial pos='0.01 0 0.02' mass='8' fullinertia='0.2 0.3 0.35 0 0.01 0'/>\
         <geom name='trunk' type='box' size='0.2 0.06 0.05'/><site name='imu' pos='0.1 0 0'/>\
         {bodies}</body></worldbody><actuator>{actuators}</actuator>\
         <sensor><gyro site='imu'/><accelerometer site='imu'/>{sensors}</sensor>\
         <keyframe><key name='home' qpos='{base}{rest}' ctrl='{controls}'/></keyframe></mujoco>"
    )
}

/// An axis of rotation on a side, which is mirrored with the opposite sign of a direction.
fn mirrored_axis([x, y, z]: [f64; 3], sign: f64, side: f64, turned: bool) -> [f64; 3] {
    let half = if turned { -1.0 } else { 1.0 };
    [half * sign * side * x, half * sign * y, sign * side * z]
}

/// Returns an inertia (xx, yy, zz, xy, xz, yz) on the side `flip` (1 left, -1 right), in a frame that
/// is turned by half a turn about z if `half` is -1, which changes the signs of xz and yz.
fn mirrored_inertia([xx, yy, zz, xy, xz, yz]: [f64; 6], flip: f64, half: f64) -> [f64; 6] {
    [xx, yy, zz, flip * xy, half * xz, half * flip * yz]
}

/// Writes a limb, and returns the positions of its joints at rest.
fn write_limb(
    text: &mut String,
    style: &Style,
    shoulder: [f64; 3],
    name: &str,
    links: &[Link],
    fault: Option<Fault>,
) -> Vec<f64> {
    let side = shoulder[1].signum();
    let turned = style.turned_frames && side < 0.0;
    let numbers = |values: &[f64]| values.iter().map(f64::to_string).collect::<Vec<_>>().join(" ");
    // coordinates on this side, in the frames of this side
    let half = if turned { -1.0 } else { 1.0 };
    let place = |[x, y, z]: [f64; 3]| numbers(&[half * x, half * side * y, z]);
    let mut rest = Vec::new();
    for (index, link) in links.iter().enumerate() {
        let fault = fault.filter(|fault| fault.link == index);
        let has = |property| fault.is_some_and(|fault| fault.property == property);
        let grown = |property, value: f64| match fault {
            Some(fault) if fault.property == property => value * (1.0 + fault.size),
            _ => value,
        };
        let (position, quat) = match index {
            0 => (numbers(&shoulder), if turned { "quat='0 0 0 1'" } else { "" }),
            _ => (place(link.offset), ""),
        };
        let _ = write!(text, "<body name='{name}_{index}' pos='{position}' {quat}>");
        let [x, y, z] = link.centre;
        let centre = place(if has("centre of mass") { [x, -y, z] } else { [x, y, z] });
        let flip = if has("inertia") { -side } else { side };
        let inertia = numbers(&mirrored_inertia(link.inertia, flip, half));
        let mass = grown("mass", link.mass);
        let _ = write!(text, "<inertial pos='{centre}' mass='{mass}' fullinertia='{inertia}'/>");
        let sign = if style.mirrored_axes || side > 0.0 { 1.0 } else { -1.0 };
        let mut axis = mirrored_axis(link.axis, sign, side, turned);
        if has("sign") {
            axis = axis.map(|part| -part);
        }
        let [low, high] = [link.range[0], grown("range", link.range[1])];
        let range = if sign < 0.0 { [-high, -low] } else { [low, high] };
        let _ = write!(
            text,
            "<joint name='{name}_{index}' axis='{}' range='{}' damping='{}'/>",
            numbers(&axis),
            numbers(&range),
            grown("damping", link.damping)
        );
        let end = place(links.get(index + 1).map_or([0.0, 0.0, -0.15], |next| next.offset));
        let _ = write!(
            text,
            "<geom name='{name}_{index}_geom' type='capsule' fromto='0 0 0 {end}' size='{}' \
             friction='{} 0.005 0.0001'/>",
            grown("size", link.radius),
            grown("friction", link.friction)
        );
        rest.push(sign * link.rest);
    }
    *text += &"</body>".repeat(links.len());
    rest
}
