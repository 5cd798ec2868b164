//! Tendons and equality constraints.

use model_check::{ModelSymmetryReport, ModelSymmetrySettings, check_model_symmetry};
use mujoco::{Model, is_reference_release};

fn checked(xml: &str) -> ModelSymmetryReport {
    let model = Model::from_xml(xml).unwrap_or_else(|error| panic!("{error}\n{xml}"));
    check_model_symmetry(&model, &ModelSymmetrySettings::default()).unwrap()
}

/// Side of the biped, with the signs by which coordinates of hips (about x) and of knees and toes
/// (about y) are those of the left side.
#[derive(Clone, Copy)]
struct Side {
    name: &'static str,
    y: f64,
    /// -1 if the frames of the leg are turned by half a turn about z.
    turn: f64,
    hip: f64,
    knee: f64,
}

impl Side {
    /// Returns the left and the right side, whose leg may have turned frames.
    fn both(turned: bool) -> [Self; 2] {
        let left = Self { name: "l", y: 1.0, turn: 1.0, hip: 1.0, knee: 1.0 };
        let (turn, hip, knee) = if turned { (-1.0, 1.0, -1.0) } else { (1.0, -1.0, 1.0) };
        [left, Self { name: "r", y: -1.0, turn, hip, knee }]
    }

    /// Returns a point of the left leg on this side, in the frame of this leg.
    fn place(self, [x, y, z]: [f64; 3]) -> String {
        format!("{} {} {z}", self.turn * x, self.turn * self.y * y)
    }

    fn body(self) -> String {
        let Self { name, y, .. } = self;
        let turn = if self.turn < 0.0 { "quat='0 0 0 1'" } else { "" };
        format!(
            "<site name='start_{name}' pos='0.05 {} -0.02'/>\
             <body name='thigh_{name}' pos='0 {} 0' {turn}>\
             <joint name='hip_{name}' axis='1 0 0' ref='{}'/>\
             <geom name='drum_{name}' type='cylinder' size='0.03 0.02' zaxis='0 1 0' pos='{}' \
             contype='0' conaffinity='0'/><site name='side_{name}' pos='{}'/>\
             <geom type='capsule' fromto='0 0 0 {knee}' size='0.02'/>\
             <body name='shin_{name}' pos='{knee}'><joint name='knee_{name}' axis='0 1 0'/>\
             <geom type='capsule' fromto='0 0 0 0 0 -0.3' size='0.02'/>\
             <site name='end_{name}' pos='{}'/>\
             <body name='toe_{name}' pos='0 0 -0.3'><joint name='toe_{name}' axis='0 1 0'/>\
             <geom type='capsule' fromto='0 0 0 {}' size='0.01'/></body></body></body>\
             <body name='hand_{name}' pos='0.2 {} 0.2'><joint name='hand_{name}' axis='0 1 0'/>\
             <geom type='box' size='0.02 0.01 0.03' pos='0.05 {} 0'/></body>",
            0.11 * y,
            0.1 * y,
            0.2 * self.hip,
            self.place([0.02, 0.0, -0.1]),
            self.place([0.08, 0.0, -0.1]),
            self.place([0.03, 0.01, -0.05]),
            self.place([0.1, 0.01, 0.0]),
            0.1 * y,
            0.01 * y,
            knee = self.place([0.0, 0.02, -0.3]),
        )
    }

    /// Returns a fixed tendon, whose right side is written with the opposite sign, and a spatial one,
    /// whose right side is written from the other end.
    fn tendons(self) -> String {
        let Self { name, y, hip, knee, .. } = self;
        let range = if y > 0.0 { "-0.2 0.6" } else { "-0.6 0.2" };
        let start = format!("<site site='start_{name}'/>");
        let drum = format!("<geom geom='drum_{name}' sidesite='side_{name}'/>");
        let end = format!("<site site='end_{name}'/>");
        let [first, second] = if y > 0.0 {
            [format!("{start}{drum}{end}"), format!("{start}{end}")]
        } else {
            [format!("{end}{drum}{start}"), format!("{end}{start}")]
        };
        format!(
            "<fixed name='sum_{name}' limited='true' range='{range}' stiffness='3' damping='0.1' \
             frictionloss='0.02'><joint joint='hip_{name}' coef='{}'/>\
             <joint joint='knee_{name}' coef='{}'/></fixed>\
             <spatial name='cord_{name}' stiffness='40' springlength='0.4' limited='true' \
             range='0 0.9'>{first}<pulley divisor='2'/>{second}</spatial>",
            y * hip,
            0.5 * y * knee,
        )
    }

    /// Returns a hip that follows a toe, a loop of thigh and toe, and a weld of trunk and toe.
    fn equalities(self) -> String {
        let Self { name, hip, knee, .. } = self;
        let relative = if self.y > 0.0 {
            "0.9 0.1 0.2 0.3"
        } else if self.turn > 0.0 {
            "0.9 -0.1 0.2 -0.3"
        } else {
            // times half a turn about z
            "0.3 0.2 0.1 0.9"
        };
        format!(
            "<joint name='hips_{name}' joint1='hip_{name}' joint2='toe_{name}' \
             polycoef='{} {} {} 0 0'/>\
             <connect name='bar_{name}' body1='thigh_{name}' body2='toe_{name}' anchor='{}'/>\
             <weld name='stay_{name}' body1='trunk' body2='toe_{name}' anchor='{}' \
             relpose='0.01 {} -0.6 {relative}' torquescale='0.5'/>",
            0.1 * hip,
            0.4 * hip * knee,
            0.3 * hip,
            self.place([0.03, 0.02, -0.5]),
            self.place([0.02, 0.03, 0.01]),
            0.12 * self.y,
        )
    }

    fn motors(self) -> String {
        let name = self.name;
        format!(
            "<motor name='sum_{name}' tendon='sum_{name}' gear='2'/>\
             <motor name='cord_{name}' tendon='cord_{name}' gear='5'/>"
        )
    }

    fn sensors(self) -> String {
        let name = self.name;
        format!("<tendonpos tendon='sum_{name}'/><tendonvel tendon='cord_{name}'/>")
    }
}

/// A floating trunk with two legs and two hands. The hands follow each other and are welded, the
/// shins are connected, and the neck is locked.
fn biped(turned: bool) -> String {
    let sides = Side::both(turned);
    let both = |part: fn(Side) -> String| sides.map(part).concat();
    format!(
        "<mujoco><compiler angle='radian'/><option gravity='0 0 -1'/><worldbody>\
         <body name='trunk' pos='0 0 1'><freejoint/>\
         <geom type='box' size='0.1 0.05 0.1'/>{}\
         <body name='head' pos='0 0 0.2'><joint name='neck' axis='0 0 1'/>\
         <geom type='box' size='0.05 0.04 0.05'/></body></body></worldbody>\
         <tendon>{}</tendon><equality>{}\
         <connect name='shins' body1='shin_l' body2='shin_r' anchor='0 -0.12 -0.2'/>\
         <weld name='hands' body1='hand_l' body2='hand_r' anchor='0 0.1 0'/>\
         <joint name='grip' joint1='hand_l' joint2='hand_r'/><joint name='lock' joint1='neck'/>\
         </equality><actuator>{}</actuator><sensor>{}</sensor></mujoco>",
        both(Side::body),
        both(Side::tendons),
        both(Side::equalities),
        both(Side::motors),
        both(Side::sensors),
    )
}

/// Returns a model with the last occurrence of `from`, which is on the right side, replaced.
fn with_last_replaced(model: &str, from: &str, to: &str) -> String {
    let at = model.rfind(from).unwrap_or_else(|| panic!("{from} is not in the model"));
    format!("{}{to}{}", &model[..at], &model[at + from.len()..])
}

#[test]
fn a_model_with_tendons_and_equality_constraints_is_its_own_mirror_image() {
    for turned in [false, true] {
        let found = checked(&biped(turned));
        assert!(found.differences.is_empty(), "{turned}: {}", found.text());
        let twins = found.twin_divergence.unwrap();
        assert!(twins < 1e-6, "{turned}: {twins}");
        let maps = found.maps.unwrap();
        // the right tendon of joints is written with the opposite sign
        assert_eq!(maps.ctrl.signs, [-1, 1, -1, 1]);
        assert_eq!(maps.ctrl.sources, [2, 3, 0, 1]);
        let sensors = maps.sensordata.unwrap();
        assert_eq!((sensors.signs, sensors.sources), (vec![-1, 1, -1, 1], vec![2, 3, 0, 1]));
    }
}

#[test]
fn every_difference_of_a_tendon_or_an_equality_constraint_is_named() {
    let sound = biped(false);
    for (from, to, expected) in [
        ("coef='-0.5'", "coef='-0.6'", "tendon sum_l | sum_r: coefficients"),
        ("coef='-0.5'", "coef='0.5'", "tendon sum_l | sum_r: coefficients"),
        ("range='-0.6 0.2'", "range='-0.2 0.6'", "tendon sum_l | sum_r: range"),
        ("stiffness='3'", "stiffness='4'", "tendon sum_l | sum_r: stiffness"),
        ("springlength='0.4'", "springlength='0.3'", "tendon cord_l | cord_r: spring length"),
        ("frictionloss='0.02'", "frictionloss='0.03'", "tendon sum_l | sum_r: friction loss"),
        (" sidesite='side_r'", "", "tendon cord_l | cord_r: path differs"),
        (
            "<site site='end_r'/><geom",
            "<pulley divisor='2'/><site site='end_r'/><geom",
            "cord_r: path differs",
        ),
        ("divisor='2'", "divisor='3'", "tendon cord_l | cord_r: coefficients"),
        ("range='0 0.9'", "range='0 0.8'", "tendon cord_l | cord_r: range"),
        ("gear='5'", "gear='6'", "actuator cord_l | cord_r: gear"),
        ("polycoef='-0.1 -0.4", "polycoef='-0.1 0.4", "equality hips_l | hips_r: coefficients"),
        ("polycoef='-0.1", "polycoef='0.1", "equality hips_l | hips_r: coefficients"),
        ("joint2='toe_r'", "joint2='knee_r'", "equality hips_l | hips_r: objects differs"),
        ("name='hips_r'", "name='hips_r' active='false'", "equality hips_l | hips_r: active"),
        ("name='hips_r'", "name='hips_r' solref='0.05 1'", "equality hips_l | hips_r: solref"),
        ("anchor='0.03 -0.02 -0.5'", "anchor='0.03 0.02 -0.5'", "bar_l | bar_r: anchor"),
        ("anchor='0.02 -0.03 0.01'", "anchor='0.02 0.03 0.01'", "stay_l | stay_r: anchor"),
        ("0.9 -0.1 0.2 -0.3", "0.9 0.1 0.2 -0.3", "stay_l | stay_r: orientation"),
        ("torquescale='0.5'", "torquescale='0.6'", "stay_l | stay_r: torque scale"),
        ("anchor='0 -0.12 -0.2'", "anchor='0 -0.1 -0.2'", "shins and its mirror image: anchor"),
        // a weld has its anchor in the right hand by default
        (" anchor='0 0.1 0'", "", "hands and its mirror image: anchor"),
        (
            "body2='hand_r'",
            "body2='hand_r' relpose='0 -0.1 0 1 0 0.1 0'",
            "equality hands and its mirror image: orientation",
        ),
        (
            "joint2='hand_r'",
            "joint2='hand_r' polycoef='0 0.8 0 0 0'",
            "equality grip and its mirror image: coefficients",
        ),
        (
            "joint1='neck'",
            "joint1='neck' polycoef='0.2 1 0 0 0'",
            "equality lock and its mirror image: coefficients",
        ),
        (
            "body1='shin_l' body2='shin_r'",
            "body1='toe_l' body2='shin_r'",
            "shins has no counterpart",
        ),
    ] {
        let found = checked(&with_last_replaced(&sound, from, to));
        let text = found.text();
        assert!(text.contains(expected), "{expected}: {text}");
        assert_eq!(found.differences.len(), 1, "{expected}: {text}");
    }
}

#[test]
fn changes_of_tendons_and_equality_constraints_have_an_effect() {
    let sound = biped(true);
    for (from, to) in [
        ("coef='0.5'", "coef='0.6'"),
        ("stiffness='3'", "stiffness='4'"),
        ("polycoef='0.1 -0.4", "polycoef='0.1 -0.5"),
        ("anchor='0 -0.12 -0.2'", "anchor='0 -0.1 -0.2'"),
        ("joint2='hand_r'", "joint2='hand_r' polycoef='0 0.8 0 0 0'"),
    ] {
        let found = checked(&with_last_replaced(&sound, from, to));
        let twins = found.twin_divergence.unwrap();
        let effect = found.differences[0].effect.unwrap();
        assert!(twins < 1e-6 && effect > 1e3 * twins, "{from}: {effect}, {twins}");
    }
}

/// Sites that are welded, which releases before MuJoCo 3 refuse.
#[test]
fn welds_of_sites_hold_mirrored_poses() {
    let model = |turn: &str| {
        let side = |name: &str, y: f64, end: &str| {
            format!(
                "<site name='a_{name}' pos='0 {y} 0'/><body name='arm_{name}' pos='0.1 {y} 0'>\
                 <joint name='j_{name}' axis='0 1 0'/><geom size='0.02' pos='0.05 0 0'/>\
                 <site name='b_{name}' pos='-0.1 0 0' {end}/></body>"
            )
        };
        format!(
            "<mujoco><worldbody><body name='trunk'><freejoint/><geom size='0.05'/>{}{}</body>\
             </worldbody><equality><weld name='w_l' site1='a_l' site2='b_l'/>\
             <weld name='w_r' site1='a_r' site2='b_r'/></equality></mujoco>",
            side("l", 0.1, ""),
            side("r", -0.1, turn)
        )
    };
    let [sound, turned] = ["", "quat='0 0 0 1'"].map(model);
    if is_reference_release() {
        assert!(Model::from_xml(&sound).is_err());
        return;
    }
    assert!(checked(&sound).differences.is_empty(), "{}", checked(&sound).text());
    let text = checked(&turned).text();
    assert!(text.contains("equality w_l | w_r: orientation differs"), "{text}");
}
