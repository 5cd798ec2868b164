//! Tendons and equality constraints.

use model_check::{ModelSymmetryReport, ModelSymmetrySettings, check_model_symmetry};
use mujoco::Model;

fn checked(xml: &str) -> ModelSymmetryReport {
    let model = Model::from_xml(xml).unwrap_or_else(|error| panic!("{error}\n{xml}"));
    check_model_symmetry(&model, &ModelSymmetrySettings::default()).unwrap()
}

/// A floating trunk with two legs. Each has a tendon of joints, one of space that bends around the
/// thigh, a motor and sensors of both, and toes that follow the knee; the shins are connected with
/// each other, and the hands welded.
///
/// Hips turn about x, so their coordinates change signs in the mirror; those of knees and toes, about
/// y, stay. The right tendon of joints is written with the opposite sign.
fn biped() -> String {
    let leg = |side: &str, y: f64| {
        let s = y.signum();
        format!(
            "<site name='start_{side}' pos='0.05 {a} -0.02'/>\
             <body name='thigh_{side}' pos='0 {y} 0'><joint name='hip_{side}' axis='1 0 0'/>\
             <geom name='drum_{side}' type='cylinder' size='0.03 0.02' zaxis='0 1 0' \
             pos='0.02 0 -0.1' contype='0' conaffinity='0'/>\
             <geom type='capsule' fromto='0 0 0 0 {b} -0.3' size='0.02'/>\
             <site name='side_{side}' pos='0.08 0 -0.1'/>\
             <body name='shin_{side}' pos='0 {b} -0.3'><joint name='knee_{side}' axis='0 1 0'/>\
             <geom type='capsule' fromto='0 0 0 0 0 -0.3' size='0.02'/>\
             <site name='end_{side}' pos='0.03 {c} -0.05'/>\
             <body name='toe_{side}' pos='0 0 -0.3'><joint name='toe_{side}' axis='0 1 0'/>\
             <geom type='capsule' fromto='0 0 0 0.1 {c} 0' size='0.01'/></body></body></body>\
             <body name='hand_{side}' pos='0.2 {y} 0.2'><joint name='hand_{side}' axis='0 1 0'/>\
             <geom type='box' size='0.02 0.01 0.03' pos='0.05 {c} 0'/></body>",
            a = y + 0.01 * s,
            b = 0.02 * s,
            c = 0.01 * s,
        )
    };
    let tendons = |side: &str, sign: f64, range: &str| {
        format!(
            "<fixed name='sum_{side}' limited='true' range='{range}' stiffness='3' damping='0.1' \
             frictionloss='0.02'><joint joint='hip_{side}' coef='1'/>\
             <joint joint='knee_{side}' coef='{coef}'/></fixed>\
             <spatial name='cord_{side}' stiffness='40' springlength='0.4' limited='true' \
             range='0 0.9'>\
             <site site='start_{side}'/><geom geom='drum_{side}' sidesite='side_{side}'/>\
             <site site='end_{side}'/><pulley divisor='2'/><site site='start_{side}'/>\
             <site site='end_{side}'/></spatial>",
            coef = 0.5 * sign,
        )
    };
    let motors = |side: &str| {
        format!(
            "<motor name='sum_{side}' tendon='sum_{side}' gear='2'/>\
             <motor name='cord_{side}' tendon='cord_{side}' gear='5'/>"
        )
    };
    let sensors =
        |side: &str| format!("<tendonpos tendon='sum_{side}'/><tendonvel tendon='cord_{side}'/>");
    let toes = |side: &str| {
        format!(
            "<joint name='toes_{side}' joint1='toe_{side}' joint2='hip_{side}' \
                 polycoef='0.1 {} 0.3 0 0'/>",
            if side == "l" { 0.4 } else { -0.4 }
        )
    };
    let both = |part: &dyn Fn(&str) -> String| part("l") + &part("r");
    format!(
        "<mujoco><compiler angle='radian'/><option gravity='0 0 -1'/><worldbody>\
         <body name='trunk' pos='0 0 1'><freejoint/>\
         <geom type='box' size='0.1 0.05 0.1'/>{}{}</body></worldbody>\
         <tendon>{}{}</tendon><equality>{}\
         <connect name='shins' body1='shin_l' body2='shin_r' anchor='0 -0.12 -0.2'/>\
         <weld name='hands' body1='hand_l' body2='hand_r' anchor='0 0.1 0'/></equality>\
         <actuator>{}</actuator><sensor>{}</sensor></mujoco>",
        leg("l", 0.1),
        leg("r", -0.1),
        tendons("l", 1.0, "-0.2 0.6"),
        tendons("r", -1.0, "-0.6 0.2"),
        both(&toes),
        both(&motors),
        both(&sensors),
    )
}

/// Returns a model with the last occurrence of `from`, which is on the right side, replaced.
fn with_last_replaced(model: &str, from: &str, to: &str) -> String {
    let at = model.rfind(from).unwrap_or_else(|| panic!("{from} is not in the model"));
    format!("{}{to}{}", &model[..at], &model[at + from.len()..])
}

#[test]
fn a_model_with_tendons_and_equality_constraints_is_its_own_mirror_image() {
    let found = checked(&biped());
    assert!(found.differences.is_empty(), "{}", found.text());
    let twins = found.twin_divergence.unwrap();
    assert!(twins < 1e-6, "{twins}");
    let maps = found.maps.unwrap();
    // the right tendon of joints is written with the opposite sign
    assert_eq!(maps.ctrl.signs, [-1, 1, -1, 1]);
    assert_eq!(maps.ctrl.sources, [2, 3, 0, 1]);
    let sensors = maps.sensordata.unwrap();
    assert_eq!((sensors.signs, sensors.sources), (vec![-1, 1, -1, 1], vec![2, 3, 0, 1]));
}

#[test]
fn every_difference_of_a_tendon_or_an_equality_constraint_is_named() {
    let sound = biped();
    let last = |from: &str, to: &str| with_last_replaced(&sound, from, to);
    let site = |y| format!("<site site='end_r'/><pulley divisor='{y}'/>");
    for (faulty, expected) in [
        (last("coef='-0.5'", "coef='-0.6'"), "tendon sum_l | sum_r: coefficients"),
        (last("coef='-0.5'", "coef='0.5'"), "tendon sum_l | sum_r: coefficients"),
        (last("range='-0.6 0.2'", "range='-0.2 0.6'"), "tendon sum_l | sum_r: range"),
        (last("stiffness='3'", "stiffness='4'"), "tendon sum_l | sum_r: stiffness"),
        (
            last("frictionloss='0.02'", "frictionloss='0.02' springlength='0.1'"),
            "tendon sum_l | sum_r: spring length",
        ),
        (last("frictionloss='0.02'", "frictionloss='0.03'"), "tendon sum_l | sum_r: friction loss"),
        (last("sidesite='side_r'", ""), "tendon cord_l | cord_r: path"),
        (last(&site(2), &site(3)), "tendon cord_l | cord_r: coefficients"),
        (last("range='0 0.9'", "range='0 0.8'"), "tendon cord_l | cord_r: range"),
        (last("gear='5'", "gear='6'"), "actuator cord_l | cord_r: gear"),
        (
            last("polycoef='0.1 -0.4", "polycoef='0.1 0.4"),
            "equality constraint toes_l | toes_r: coefficients",
        ),
        (last("joint2='hip_r'", "joint2='knee_r'"), "equality constraint toes_l | toes_r: objects"),
        (
            last("name='toes_r'", "name='toes_r' active='false'"),
            "equality constraint toes_l | toes_r: active",
        ),
        (
            last("name='toes_r'", "name='toes_r' solref='0.05 1'"),
            "equality constraint toes_l | toes_r: solref",
        ),
        (
            last("anchor='0 -0.12 -0.2'", "anchor='0 -0.1 -0.2'"),
            "equality constraint shins and its mirror image: anchor",
        ),
        // a weld turns both bodies about its anchor, which lies in the right hand by default
        (last("anchor='0 0.1 0'", ""), "equality constraint hands and its mirror image: anchor"),
        (
            last("body2='hand_r'", "body2='hand_r' relpose='0 -0.1 0 1 0 0.1 0'"),
            "equality constraint hands and its mirror image: orientation",
        ),
        (
            last("<connect name='shins' body1='shin_l'", "<connect name='shins' body1='toe_l'"),
            "equality constraint shins has no counterpart",
        ),
    ] {
        let found = checked(&faulty);
        let text = found.text();
        assert!(text.contains(expected), "{expected}: {text}");
        assert_eq!(found.differences.len(), 1, "{expected}: {text}");
    }
}

#[test]
fn changes_of_tendons_and_equality_constraints_have_an_effect() {
    let sound = biped();
    for (from, to) in [
        ("coef='-0.5'", "coef='-0.6'"),
        ("stiffness='3'", "stiffness='4'"),
        ("polycoef='0.1 -0.4", "polycoef='0.1 -0.5"),
        ("anchor='0 -0.12 -0.2'", "anchor='0 -0.1 -0.2'"),
    ] {
        let found = checked(&with_last_replaced(&sound, from, to));
        let twins = found.twin_divergence.unwrap();
        let effect = found.differences[0].effect.unwrap();
        assert!(twins < 1e-6 && effect > 1e3 * twins, "{from}: {effect}, {twins}");
    }
}
