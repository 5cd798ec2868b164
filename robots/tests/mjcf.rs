//! Our MJCF against MuJoCo's own reading of the same URDF, and in motion.

use std::f64::consts::PI;
use std::sync::Arc;

use glam::{DQuat, DVec3};
use mujoco::{Data, Model, is_reference_release};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use robots::{
    Chain, JointServoSettings, LinkMjcfAddition, MjcfSettings, Pose, RobotDescription, Twist,
    TwistControlSettings, TwistController, gen3,
};

use crate::SIX_JOINT;

/// Returns the text without every part from `start` to `end`.
fn without(text: &str, start: &str, end: &str) -> String {
    let mut parts = text.split(start);
    let first = parts.next().unwrap().to_owned();
    let rests = parts.map(|part| part.split_once(end).unwrap().1);
    rests.fold(first, |left, rest| left + rest)
}

fn model(xml: &str, name: &str) -> Arc<Model> {
    let model = Model::from_files(name, &[(name, xml.as_bytes())]);
    Arc::new(model.unwrap_or_else(|error| panic!("{error}\n{xml}")))
}

/// Velocities of `joints` 20 steps after they were put at `positions` and let go.
fn fall(model: &Arc<Model>, joints: &[&str], positions: &[f64]) -> Vec<f64> {
    let mut data = Data::new(Arc::clone(model));
    let ids: Vec<_> = joints.iter().map(|joint| model.joint(joint).unwrap()).collect();
    for (&joint, &position) in ids.iter().zip(positions) {
        data.qpos_mut()[model.joint_qpos_address(joint)] = position;
    }
    data.step(20).unwrap();
    ids.iter().map(|&joint| data.qvel()[model.joint_dof_address(joint)]).collect()
}

/// Positions of the free joints, clear of either end of a range by this share of it.
fn drawn(arm: &RobotDescription, generator: &mut ChaCha8Rng, clear: f64) -> Vec<f64> {
    let mut draw = |[low, high]: [f64; 2]| {
        let margin = clear * (high - low);
        generator.random_range(low + margin..high - margin)
    };
    let joints = arm.free_joints();
    joints.map(|(_, motion)| draw(motion.range.unwrap_or([-3.0, 3.0]))).collect()
}

/// Masses, centres, inertias, axes, damping and friction: a difference in any shows in how the arm
/// falls.
#[test]
fn arms_fall_as_mujoco_has_them_fall() {
    let version = mujoco::library_version();
    for urdf in [gen3::GEN3_URDF, SIX_JOINT] {
        // these ignore the `rpy` of inertias, which the second arm has
        if urdf == SIX_JOINT && (version.starts_with("3.2.") || version.starts_with("3.3.")) {
            continue;
        }
        // without shapes and mimics, which MuJoCo's own reading of a URDF treats differently
        let urdf = without(&without(urdf, "<collision>", "</collision>"), "<mimic", "/>");
        let urdf = urdf.replace("effort=\"0\" velocity=\"0\"", "effort=\"1\" velocity=\"1\"");
        let arm = RobotDescription::from_urdf(&urdf).unwrap();
        let rendered = arm
            .to_mjcf(&MjcfSettings::default())
            .unwrap()
            .text
            .replace("\"implicit\"", "\"Euler\"");
        let models = [model(&urdf, "arm.urdf"), model(&rendered, "arm.xml")];
        let joints: Vec<&str> = arm.free_joints().map(|(joint, _)| &joint.name[..]).collect();
        let mut generator = ChaCha8Rng::seed_from_u64(1002);
        for _ in 0..20 {
            let positions = drawn(&arm, &mut generator, 0.0);
            let [theirs, ours] = models.each_ref().map(|model| fall(model, &joints, &positions));
            for (expected, got) in theirs.iter().zip(&ours) {
                assert!((expected - got).abs() < 1e-7 * (1.0 + expected.abs()), "{expected} {got}");
            }
            assert!(ours.iter().any(|velocity| velocity.abs() > 0.1), "{ours:?}");
        }
    }
}

#[test]
fn limits_names_and_servos_are_in_the_model() {
    let settings =
        MjcfSettings { servo: Some(JointServoSettings::default()), ..MjcfSettings::default() };
    for urdf in [gen3::GEN3_URDF, SIX_JOINT] {
        let arm = RobotDescription::from_urdf(urdf).unwrap();
        let model = model(&arm.to_mjcf(&settings).unwrap().text, "arm.xml");
        assert_eq!(model.nu(), arm.num_dofs());
        for (index, (joint, motion)) in arm.free_joints().enumerate() {
            assert_eq!(model.joint_range(model.joint(&joint.name).unwrap()), motion.range);
            assert_eq!(model.actuator(&joint.name).unwrap().index(), index);
        }
        for link in arm.links().iter().filter(|link| link.name != "world") {
            model.body(&link.name).unwrap();
            for shape in 0..link.shapes.len() {
                model.geom(&format!("{}_{shape}", link.name)).unwrap();
            }
        }
    }
}

/// MuJoCo 3 refuses words of hundreds of digits and subnormal numbers, which tiny angles and sizes
/// may have.
#[test]
fn no_number_is_long_or_subnormal() {
    let tiny = SIX_JOINT.replace("rpy=\"0 0.4 0\"", "rpy=\"0 1e-300 0\"");
    assert_ne!(tiny, SIX_JOINT);
    let shapes = "<link name=\"tip\"><collision><origin xyz=\"1e-300 3e-310 0\" rpy=\"0 0 1e-300\"/>\
                  <geometry><capsule radius=\"1.1e-6\" length=\"2.3456789012345678e-6\"/>\
                  </geometry></collision></link>";
    let arm = RobotDescription::from_urdf(&tiny.replace("<link name=\"tip\"/>", shapes)).unwrap();
    let mjcf = arm.to_mjcf(&MjcfSettings::default()).unwrap().text;
    let longest = mjcf.split(['"', ' ', '\n']).max_by_key(|word| word.len()).unwrap();
    assert!(longest.len() <= 25, "{longest}");
    assert!(mjcf.contains("e-301"), "the angles are in the model: {mjcf}");
    assert!(!mjcf.contains("e-310"), "{mjcf}");
    model(&mjcf, "arm.xml");
}

#[test]
fn servos_and_bases_that_make_no_sense_are_refused() {
    let arm = gen3::gen3_description().unwrap();
    for (saturation_error, damping_time, words) in [
        (0.0, 0.03, "its saturation error is 0, expected 1e-6 or more"),
        (-1.0, 0.03, "its saturation error is -1"),
        (f64::NAN, 0.03, "NaN"),
        (0.02, -0.1, "its damping time is -0.1"),
        (0.02, f64::INFINITY, "inf"),
    ] {
        let servo = Some(JointServoSettings { saturation_error, damping_time });
        let settings = MjcfSettings { servo, ..MjcfSettings::default() };
        for refused in [arm.to_mjcf(&settings), arm.to_mjcf_include(&settings)] {
            let message = refused.unwrap_err().to_string();
            assert!(message.contains(words), "{message}");
        }
    }
    for (position, rotation, words) in [
        (DVec3::NAN, DQuat::IDENTITY, "position is NaN"),
        (DVec3::ZERO, DQuat::from_xyzw(0.0, 0.0, 0.0, 0.0), "rotation is 0"),
        (DVec3::ZERO, DQuat::NAN, "rotation is NaN"),
    ] {
        let placed = arm.clone().with_base_pose(Pose { position, rotation });
        let message = placed.unwrap_err().to_string();
        assert!(message.contains(words), "{message}");
    }
}

/// A scene includes the part, whose geoms take what the class says.
#[test]
fn a_scene_includes_the_part() {
    let settings = MjcfSettings {
        servo: None,
        link_classes: vec![("base_link".to_owned(), "arm".to_owned())],
        additions: vec![LinkMjcfAddition {
            link: "tool_link".to_owned(),
            mjcf: "<site name=\"tool\" pos=\"0 0 0.01\"/>".to_owned(),
        }],
    };
    let part = gen3::gen3_description().unwrap().to_mjcf_include(&settings).unwrap().text;
    let scene = r#"<mujoco><compiler angle="radian"/>
        <default><default class="arm"><geom contype="0" conaffinity="0" group="3"/></default></default>
        <include file="arm.xml"/></mujoco>"#;
    let files = [("scene.xml", scene.as_bytes()), ("arm.xml", part.as_bytes())];
    let model = Model::from_files("scene.xml", &files).unwrap();
    let capsule = model.geom("forearm_link_0").unwrap();
    assert_eq!((model.geom_group(capsule), model.geom_collision_masks(capsule)), (3, (0, 0)));
    // inside its link's body, which has no shape of its own
    let tool = model.site("tool").unwrap();
    let mut data = Data::new(Arc::new(model));
    data.forward_kinematics().unwrap();
    let arm = gen3::gen3_description().unwrap();
    let link = arm.links().iter().position(|link| link.name == "tool_link");
    let pose = arm.link_poses(&[0.0; 8])[link.unwrap()];
    let site = DVec3::from_array(data.site_position(tool));
    assert!(site.distance(pose.transform_point(0.01 * DVec3::Z)) < 1e-9, "{site}");
}

#[test]
fn neighbours_do_not_collide_and_the_arm_hits_itself() {
    let arm = gen3::gen3_description().unwrap();
    let model = model(&arm.to_mjcf(&MjcfSettings::default()).unwrap().text, "arm.xml");
    let contacts = |joints: &[f64]| {
        let mut data = Data::new(Arc::clone(&model));
        data.qpos_mut()[..7].copy_from_slice(joints);
        data.forward().unwrap();
        data.contact_count()
    };
    for free in [
        gen3::HOME_JOINT_POSITIONS,
        gen3::RETRACT_JOINT_POSITIONS,
        gen3::ZERO_JOINT_POSITIONS,
        gen3::WORK_JOINT_POSITIONS,
    ] {
        assert_eq!(contacts(&free), 0, "{free:?}");
    }
    // the forearm folded onto the upper arm, the hand into the base
    assert!(contacts(&[0.0, 1.5, 0.0, 2.57, 0.0, 2.0, 0.0]) > 0);
}

#[test]
fn additions_to_no_link_are_refused() {
    let settings = MjcfSettings {
        additions: vec![LinkMjcfAddition { link: "elbow".to_owned(), mjcf: String::new() }],
        ..MjcfSettings::default()
    };
    let refused = gen3::gen3_description().unwrap().to_mjcf(&settings);
    let message = refused.unwrap_err().to_string();
    assert!(message.contains("`elbow`, which a setting"), "{message}");
}

/// Servos that apply the holding forces keep an arm still, up to rounding.
#[test]
fn holding_forces_hold() {
    let servo = JointServoSettings::default();
    let settings = MjcfSettings { servo: Some(servo), ..MjcfSettings::default() };
    for urdf in [gen3::GEN3_URDF, SIX_JOINT] {
        // an equality is soft
        let urdf = without(urdf, "<mimic", "/>");
        let urdf = urdf.replace("effort=\"0\" velocity=\"0\"", "effort=\"9\" velocity=\"1\"");
        let arm = RobotDescription::from_urdf(&urdf).unwrap();
        let arm =
            arm.with_base_pose(Pose::from_xyz_rpy([0.1, -0.6, 0.02], [0.4, -0.2, 1.5])).unwrap();
        let model = model(&arm.to_mjcf(&settings).unwrap().text, "arm.xml");
        let mut generator = ChaCha8Rng::seed_from_u64(1005);
        for _ in 0..20 {
            // clear of the ends, which push, too
            let positions = drawn(&arm, &mut generator, 0.2);
            let forces = arm.gravity_compensation_forces(&positions);
            let joints = arm.free_joints().zip(positions.iter().zip(&forces));
            let controls: Vec<f64> = joints
                .map(|((_, motion), (&position, &force))| {
                    assert!(force.abs() < motion.max_effort.unwrap(), "{force}");
                    servo.control_signal(position, 0.0)
                        + servo.control_offset_for_force(motion, force)
                })
                .collect();
            let mut data = Data::new(Arc::clone(&model));
            for ((joint, _), &position) in arm.free_joints().zip(&positions) {
                data.qpos_mut()[model.joint_qpos_address(model.joint(&joint.name).unwrap())] =
                    position;
            }
            data.forward().unwrap();
            if data.contact_count() > 0 {
                continue;
            }
            data.set_all_ctrl(&controls).unwrap();
            data.step(1).unwrap();
            let fastest = data.qvel().iter().fold(0.0_f64, |most, v| most.max(v.abs()));
            assert!(fastest < 1e-9, "{fastest}");
            assert!(forces.iter().any(|force| force.abs() > 1.0), "{forces:?}");
        }
    }
}

/// The simulated arm draws a square with its servos, under gravity.
#[test]
fn the_simulated_arm_follows_its_control() {
    let arm = gen3::gen3_description().unwrap();
    let servo = JointServoSettings::default();
    let settings = MjcfSettings { servo: Some(servo), ..MjcfSettings::default() };
    let model = model(&arm.to_mjcf(&settings).unwrap().text, "arm.xml");
    let chain = Chain::new(&arm, "pinch_link").unwrap();
    let mut control =
        TwistController::new(chain, &gen3::WORK_JOINT_POSITIONS, TwistControlSettings::default())
            .unwrap();
    let mut data = Data::new(Arc::clone(&model));
    data.qpos_mut()[..7].copy_from_slice(&gen3::WORK_JOINT_POSITIONS);
    let pinch = model.body("pinch_link").unwrap();
    let mut furthest: f64 = 0.0;
    let speed = 0.2;
    for way in [DVec3::X, DVec3::Y, -DVec3::X, -DVec3::Y] {
        control.command_twist(Twist::from_linear(speed * way)).unwrap();
        // 0.75 s in ticks of 12.5 ms
        for _ in 0..60 {
            control.tick(0.0125).unwrap();
            let targets = control.joint_positions().iter().zip(control.joint_velocities());
            let mut controls: Vec<f64> =
                targets.map(|(&joint, &velocity)| servo.control_signal(joint, velocity)).collect();
            controls.push(0.0);
            data.set_all_ctrl(&controls).unwrap();
            data.step((0.0125 / model.timestep()).round() as usize).unwrap();
            data.forward_kinematics().unwrap();
            let tip = DVec3::from_array(data.body_position(pinch));
            furthest = furthest.max(tip.distance(control.tip_pose().position));
        }
    }
    println!("furthest {furthest}");
    assert!(furthest < 0.01, "{furthest}");
}

#[test]
fn followers_follow_and_efforts_hold_in_motion() {
    let arm = RobotDescription::from_urdf(SIX_JOINT).unwrap();
    let servo = Some(JointServoSettings::default());
    let mjcf = arm.to_mjcf(&MjcfSettings { servo, ..MjcfSettings::default() }).unwrap();
    let model = model(&mjcf.text, "arm.xml");
    let address = |joint: &str| model.joint_qpos_address(model.joint(joint).unwrap());
    let (swing, balance) = (address("swing"), address("balance"));
    let mut data = Data::new(Arc::clone(&model));
    let (mut travelled, mut furthest, mut spent) = (0.0_f64, 0.0_f64, 0.0_f64);
    for step in 0..2000 {
        // two seconds a swing; the start is sudden, which spends all efforts
        let phase = PI * model.timestep() * f64::from(step);
        let way = 0.5 * phase.cos();
        data.set_all_ctrl(&[0.2, 0.1, way, way, -way, way]).unwrap();
        data.step(1).unwrap();
        let [swing, balance] = [swing, balance].map(|joint| data.qpos()[joint]);
        travelled = travelled.max(swing.abs());
        if step > 200 {
            furthest = furthest.max((balance - (0.2 - 0.5 * swing)).abs());
        }
        for ((_, motion), force) in arm.free_joints().zip(data.actuator_force()) {
            let effort = motion.max_effort.unwrap();
            assert!(force.abs() <= effort, "{force} {effort}");
            spent = spent.max(force.abs() / effort);
        }
    }
    println!("travelled {travelled}, furthest {furthest}, spent {spent}");
    assert!(travelled > 0.4 && spent == 1.0, "{travelled} {spent}");
    // MuJoCo 3 holds the follower less stiffly
    let most = if is_reference_release() { 0.01 } else { 0.02 };
    assert!(furthest < most, "{furthest}");
}

/// An arm of three joints whose capsules are as fat as those around meshes: `base` and `forearm`,
/// two joints apart, overlap while it rests.
const FAT: &str = r#"<robot name="fat">
  <link name="base">
    <collision><origin xyz="0 0 0.1"/><geometry><capsule radius="0.12" length="0.2"/></geometry></collision>
  </link>
  <link name="upper_arm">
    <inertial><origin xyz="0 0 0.05"/><mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><origin xyz="0 0 0.05"/><geometry><capsule radius="0.1" length="0.1"/></geometry></collision>
  </link>
  <link name="forearm">
    <inertial><origin xyz="0.2 0 0"/><mass value="1"/><inertia ixx="0.01" iyy="0.01" izz="0.01" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><origin xyz="0.2 0 0" rpy="0 1.5707963 0"/><geometry><capsule radius="0.1" length="0.3"/></geometry></collision>
  </link>
  <link name="hand">
    <inertial><mass value="0.5"/><inertia ixx="0.001" iyy="0.001" izz="0.001" ixy="0" ixz="0" iyz="0"/></inertial>
    <collision><geometry><sphere radius="0.05"/></geometry></collision>
  </link>
  <joint name="pan" type="revolute">
    <parent link="base"/><child link="upper_arm"/><origin xyz="0 0 0.2"/><axis xyz="0 0 1"/>
    <limit lower="-3" upper="3" effort="200" velocity="2"/>
  </joint>
  <joint name="lift" type="revolute">
    <parent link="upper_arm"/><child link="forearm"/><origin xyz="0 0 0.2"/><axis xyz="0 1 0"/>
    <limit lower="0.1" upper="3" effort="200" velocity="2"/>
  </joint>
  <joint name="turn" type="continuous">
    <parent link="forearm"/><child link="hand"/><origin xyz="0.4 0 0"/><axis xyz="1 0 0"/>
    <limit effort="50" velocity="2"/>
  </joint>
</robot>"#;

/// An arm that touches only itself stays at its commanded position.
#[test]
fn capsules_that_overlap_at_rest_do_not_push_the_arm_away() {
    let arm = RobotDescription::from_urdf(FAT).unwrap();
    let mjcf = arm
        .to_mjcf(&MjcfSettings {
            servo: Some(JointServoSettings::default()),
            ..MjcfSettings::default()
        })
        .unwrap();
    let pair = ["base", "forearm"].map(str::to_owned);
    assert_eq!(mjcf.excluded_pairs.at_rest, [pair]);
    let exclude = "<exclude body1=\"base\" body2=\"forearm\"/>\n";
    let drift = |text: &str| {
        let model = model(text, "arm.xml");
        let mut data = Data::new(Arc::clone(&model));
        data.qpos_mut().copy_from_slice(&arm.rest_positions());
        data.set_all_ctrl(&arm.rest_positions()).unwrap();
        data.step(500).unwrap();
        let off = data.qpos().iter().zip(arm.rest_positions());
        off.fold(0.0_f64, |most, (is, rest)| most.max((is - rest).abs()))
    };
    assert_eq!(arm.rest_positions(), [0.0, 0.1, 0.0]);
    let left = drift(&mjcf.text);
    assert!(left < 1e-3, "{left}");
    // the test can fail
    assert!(mjcf.text.contains(exclude));
    let pushed = drift(&mjcf.text.replace(exclude, ""));
    assert!(pushed > 0.01, "{pushed}");
}

/// The base and a tool, which no joint moves, have several shapes and no mass.
#[test]
fn links_without_mass_have_as_many_shapes_as_they_like() {
    let tool = r#"<link name="tip">
        <collision><geometry><box size="0.1 0.1 0.1"/></geometry></collision>
        <collision><geometry><sphere radius="0.1"/></geometry></collision>
      </link>"#;
    let several = SIX_JOINT.replacen("<link name=\"tip\"/>", tool, 1);
    assert_ne!(several, SIX_JOINT);
    let arm = RobotDescription::from_urdf(&several).unwrap();
    let settings = MjcfSettings::default();
    let model = model(&arm.to_mjcf(&settings).unwrap().text, "arm.xml");
    model.geom("tip_1").unwrap();
    // it falls as the arm without these shapes does, so they have no mass
    let bare = RobotDescription::from_urdf(SIX_JOINT).unwrap();
    let bare = self::model(&bare.to_mjcf(&settings).unwrap().text, "arm.xml");
    let names = arm.free_joints().map(|(joint, _)| &joint.name[..]);
    let names: Vec<&str> = names.collect();
    let falls = [&model, &bare].map(|model| fall(model, &names, &[0.1; 6]));
    assert_eq!(falls[0], falls[1]);
}

/// The range of a joint that another one follows is what both allow, for frames, chains and MuJoCo
/// alike.
#[test]
fn a_follower_stays_within_its_own_range() {
    let urdf = SIX_JOINT.replacen("lower=\"-4\" upper=\"4\"", "lower=\"0\" upper=\"0.3\"", 1);
    let arm = RobotDescription::from_urdf(&urdf).unwrap();
    let [restriction] = arm.range_restrictions() else {
        panic!("{:?}", arm.range_restrictions());
    };
    let whole = RobotDescription::from_urdf(SIX_JOINT).unwrap();
    assert!(whole.range_restrictions().is_empty());
    let stated = whole.free_joints().find(|(joint, _)| joint.name == "swing");
    let stated = stated.unwrap().1.range;
    // it is at 0.2 less half of the other's position
    let range = [-0.2, 0.4];
    assert_eq!((&restriction.joint[..], &restriction.follower[..]), ("swing", "balance"));
    assert_eq!(restriction.file_range, stated);
    for (end, expected) in restriction.range.iter().zip(range) {
        assert!((end - expected).abs() < 1e-12, "{restriction:?}");
    }
    let chain = Chain::new(&arm, "tip").unwrap();
    let of_chain = chain.joints().iter().find(|joint| joint.name == "swing");
    assert_eq!(of_chain.unwrap().motion.range, Some(restriction.range));
    // servos push both ways, and neither joint leaves its range by more than a limit's softness
    let settings =
        MjcfSettings { servo: Some(JointServoSettings::default()), ..MjcfSettings::default() };
    let model = model(&arm.to_mjcf(&settings).unwrap().text, "arm.xml");
    let at = |joint: &str| model.joint_qpos_address(model.joint(joint).unwrap());
    let index = arm.free_joints().position(|(joint, _)| joint.name == "swing");
    for side in [0, 1] {
        let mut data = Data::new(Arc::clone(&model));
        let mut controls = arm.rest_positions();
        controls[index.unwrap()] = restriction.range[side];
        data.set_all_ctrl(&controls).unwrap();
        data.step(1500).unwrap();
        let (swing, balance) = (data.qpos()[at("swing")], data.qpos()[at("balance")]);
        assert!((swing - restriction.range[side]).abs() < 0.01, "{swing}");
        assert!((-0.01..0.31).contains(&balance), "{balance}");
    }
}

/// A ball on an arm of two joints, and a ring of balls around the base with a gap before the rest.
#[test]
fn links_that_touch_in_most_postures_do_not_collide() {
    for (gap_degrees, expected) in [(40, 1), (120, 0)] {
        let inertial = "<inertial><mass value=\"1\"/><inertia ixx=\"1\" iyy=\"1\" izz=\"1\" \
                        ixy=\"0\" ixz=\"0\" iyz=\"0\"/></inertial>";
        let ball = |x: f64, y: f64| {
            format!(
                "<collision><origin xyz=\"{x} {y} 0\"/><geometry><sphere radius=\"0.03\"/>\
                 </geometry></collision>"
            )
        };
        let angles =
            (gap_degrees..=360 - gap_degrees).step_by(5).map(|of| f64::from(of).to_radians());
        let ring: String = angles.map(|angle| ball(0.3 * angle.cos(), 0.3 * angle.sin())).collect();
        let joint = |name: &str, parent: &str, child: &str, x: f64| {
            format!(
                "<joint name=\"{name}\" type=\"revolute\"><origin xyz=\"{x} 0 0\"/>\
                 <parent link=\"{parent}\"/><child link=\"{child}\"/><axis xyz=\"0 0 1\"/>\
                 <limit lower=\"-3.1\" upper=\"3.1\" effort=\"1\" velocity=\"1\"/></joint>"
            )
        };
        let arm = RobotDescription::from_urdf(&format!(
            "<robot name=\"r\"><link name=\"base\">{ring}</link><link name=\"arm\">{inertial}</link>\
             <link name=\"hand\">{inertial}{}</link>{}{}</robot>",
            ball(0.0, 0.0),
            joint("pan", "base", "arm", 0.0),
            joint("turn", "arm", "hand", 0.3),
        ));
        let mjcf = arm.unwrap().to_mjcf(&MjcfSettings::default()).unwrap();
        let pairs = &mjcf.excluded_pairs;
        assert!(pairs.at_rest.is_empty(), "{pairs:?}");
        assert_eq!(pairs.in_most_postures.len(), expected, "{pairs:?}");
        let exclude = "<exclude body1=\"base\" body2=\"hand\"/>";
        assert_eq!(mjcf.text.matches(exclude).count(), expected);
    }
}
