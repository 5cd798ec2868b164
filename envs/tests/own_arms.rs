//! Arms of files: three kinds that play all tasks, and what keeps others from it.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use envs::conformance::measure_expert;
use envs::embodiments::Arm;
use envs::robots::{OrientationConstraint, RobotFile};
use envs::{
    Camera, ControlSettings, Embodiment, EnvError, Scene, TableTop, TaskGroup, VecEnvSettings,
};
use glam::DVec3;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use symmetry::D2;

const HOBBY: &str = include_str!("../assets/urdf/five_joint_hobby.urdf");
const GRIPPER: &str = include_str!("../assets/urdf/seven_joint_gripper.urdf");

/// Folder that is removed at the end.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let path = std::env::temp_dir().join(format!("covers-{name}-{}", std::process::id()));
        std::fs::create_dir_all(&path).unwrap();
        Self(path)
    }

    fn write(&self, name: &str, text: &str) -> PathBuf {
        let path = self.0.join(name);
        std::fs::write(&path, text).unwrap();
        path
    }

    fn arm(&self, urdf: &str) -> Result<Arm, EnvError> {
        let file = RobotFile::read(&self.write("arm.urdf", urdf))?;
        Arm::from_file("arm", &file)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        std::fs::remove_dir_all(&self.0).unwrap();
    }
}

fn asset(name: &str) -> Embodiment {
    let path = Path::new(env!("CARGO_MANIFEST_DIR")).join("assets/urdf").join(name);
    Embodiment::from_file(&path).unwrap()
}

fn replaced(urdf: &str, changes: &[(&str, &str)]) -> String {
    changes.iter().fold(urdf.to_owned(), |text, (from, to)| {
        assert!(text.contains(from), "{from}");
        text.replace(from, to)
    })
}

/// Asserts that the expert solves this number of episodes of each variant of a group.
fn assert_solves(embodiment: Embodiment, group: TaskGroup, episodes: u64) {
    let scene = Arc::new(Scene::new(group, embodiment, Camera::default()).unwrap());
    for element in D2::ALL {
        let row = measure_expert(&scene, element, ControlSettings::default(), episodes).unwrap();
        assert_eq!(row.failed_seeds, [0; 0], "{:?} with {embodiment:?}", row.variant);
    }
}

/// `covers check experts --robot ARM.urdf` plays more episodes.
#[test]
fn experts_solve_every_variant_with_arms_of_three_kinds() {
    for (name, joints) in [
        ("five_joint_hobby.urdf", 5),
        ("six_joint_industrial.urdf", 6),
        ("seven_joint_gripper.urdf", 7),
    ] {
        let arm = asset(name);
        assert_eq!(arm.arm().unwrap().chain().joints().len(), joints);
        assert_eq!(arm.arm().unwrap().closing_seconds().is_some(), joints == 7);
        for group in TaskGroup::STANDARD {
            assert_solves(arm, group, 1);
        }
    }
}

/// The expert slides the puck by pressing on it, and servos get stiffer with the efforts that a file
/// states.
#[test]
fn an_expert_slides_the_puck_with_a_strong_arm() {
    let folder = Folder::new("strong");
    let industrial = include_str!("../assets/urdf/six_joint_industrial.urdf");
    let strong =
        replaced(industrial, &[("effort=\"150\"", "effort=\"600\""), ("\"28\"", "\"112\"")]);
    let arm = Embodiment::from_file(&folder.write("strong.urdf", &strong)).unwrap();
    assert_solves(arm, TaskGroup::PLATE_SLIDE, 1);
}

/// Efforts of fingers are often placeholders.
#[test]
fn servos_of_the_arm_do_not_depend_on_the_effort_of_a_finger() {
    let folder = Folder::new("placeholder");
    let text = include_str!("../assets/urdf/seven_joint_gripper.urdf");
    let (arm, fingers) = text.split_at(text.find("<joint name=\"finger_1\"").unwrap());
    let turning = [
        ("prismatic", "revolute"),
        ("\"0 1 0\"", "\"-1 0 0\""),
        ("\"0 -1 0\"", "\"1 0 0\""),
        ("upper=\"0.0425\"", "upper=\"0.8\""),
    ];
    let fingers = replaced(fingers, &turning);
    let servo = |effort| {
        let fingers = replaced(&fingers, &[("effort=\"235\"", effort)]);
        let file = folder.write("arm.urdf", &format!("{arm}{fingers}"));
        Embodiment::from_file(&file).unwrap().arm().unwrap().settings().servo
    };
    assert_eq!(servo("effort=\"21\""), servo("effort=\"1000\""));
}

/// Servos that are too soft fail with seeds 1 and 4 of the first group and 5 of the second.
#[test]
fn an_expert_presses_and_slides_with_a_long_arm() {
    let arm = asset("seven_joint_gripper.urdf");
    for group in [TaskGroup::BUTTON_PRESS, TaskGroup::PLATE_SLIDE] {
        assert_solves(arm, group, 6);
    }
}

/// The fingers open towards the upper end of their joint's range, as far as the Sawyer arm's: the
/// outside of each, 33.5 mm from the middle when closed, comes to 53 mm.
#[test]
fn fingers_of_a_robot_are_found_and_closed() {
    let embodiment = asset("seven_joint_gripper.urdf");
    let joint = embodiment.arm().unwrap().settings().gripper.joint.clone().unwrap();
    let opening = 0.053 - 0.0335;
    assert_eq!((&joint.name[..], joint.positions[1]), ("robot/finger_1", 0.0));
    assert!((joint.positions[0] - opening).abs() < 1e-9, "{joint:?}");
    let scene = Scene::new(TaskGroup::GOAL_REACH, embodiment, Camera::default()).unwrap();
    let mut table = TableTop::new(Arc::new(scene), ControlSettings::default()).unwrap();
    table.reset(D2::Identity, &mut ChaCha8Rng::seed_from_u64(1000)).unwrap();
    let open = table.task_state().unwrap();
    assert!((open.aperture - 1.0).abs() < 1e-3, "{open:?}");
    assert!((open.hand - open.tcp).distance(0.045 * DVec3::Z) < 1e-3, "{open:?}");
    for _ in 0..8 {
        table.step(&[0.0, 0.0, 0.0, 1.0]).unwrap();
    }
    let closed = table.task_state().unwrap();
    // claws are 0.1 m apart when open, and each comes in by the opening
    let expected = 1.0 - 2.0 * opening / 0.1;
    assert!((closed.aperture - expected).abs() < 0.02, "{closed:?}");
    // the second finger follows the first one closely, not exactly
    let tips = closed.hand - closed.tcp;
    assert!(tips.truncate().length() < 2e-3, "{closed:?}");
}

/// An arm of four joints turns its hand with its base, and keeps it pointing down.
#[test]
fn the_rotation_about_the_vertical_is_free_where_an_arm_cannot_hold_it() {
    let locked = replaced(
        HOBBY,
        &[(r#"<joint name="wrist_rotate" type="revolute">"#, r#"<joint name="w" type="fixed">"#)],
    );
    let folder = Folder::new("four-joints");
    let embodiment = Embodiment::from_file(&folder.write("four_joint.urdf", &locked)).unwrap();
    let arm = embodiment.arm().unwrap();
    let orientation = arm.settings().control.orientation;
    assert_eq!(orientation, OrientationConstraint::Axis(DVec3::Z));
    let five = asset("five_joint_hobby.urdf").arm().unwrap();
    assert_eq!(five.settings().control.orientation, OrientationConstraint::Full);
    let scene = Scene::new(TaskGroup::GOAL_REACH, embodiment, Camera::default()).unwrap();
    let mut table = TableTop::new(Arc::new(scene), ControlSettings::default()).unwrap();
    table.reset(D2::Identity, &mut ChaCha8Rng::seed_from_u64(1000)).unwrap();
    let direction = |of: &TableTop| {
        let now = of.task_state().unwrap();
        now.hand - now.tcp
    };
    let mut success = false;
    while !success {
        let action = table.expert_action().unwrap();
        let step = table.step(&action).unwrap();
        success = step.success;
        assert!(!step.truncated && direction(&table).distance(0.045 * DVec3::Z) < 1e-3);
    }
    // and to a corner, where its base is turned by half a radian
    for _ in 0..6 {
        table.step(&[1.0, 0.0, 0.0, 0.0]).unwrap();
    }
    assert!(table.hand_position().x > 0.2, "{}", table.hand_position());
    assert!(direction(&table).distance(0.045 * DVec3::Z) < 2e-3);
    assert_solves(embodiment, TaskGroup::GOAL_REACH, 1);
}

/// The first joint of this arm is 0.079 m above its base, and the second one on its axis. From a
/// base beside the table it reaches the near places.
#[test]
fn an_arm_that_is_too_short_is_refused_with_the_figures() {
    let folder = Folder::new("short-arm");
    let shorter = [
        (r#"xyz="0.05955 0 0.3""#, r#"xyz="0.03 0 0.2""#),
        (r#"xyz="0.3 0 0""#, r#"xyz="0.2 0 0""#),
    ];
    let EnvError::OutOfReach(shortfall) = folder.arm(&replaced(HOBBY, &shorter)).unwrap_err()
    else {
        panic!("another error");
    };
    // those at the near edge at least, which come after those at the far one
    assert!((4..17).contains(&shortfall.reached), "{shortfall:?}");
    assert!(shortfall.missed.y > 0.0, "{shortfall:?}");
    let foot = shortfall.base + (0.079 + 0.04805) * DVec3::Z;
    assert!((shortfall.distance - foot.distance(shortfall.missed)).abs() < 1e-9, "{shortfall:?}");
    // the links, and from the wrist to the fixed claws
    let links = 0.03_f64.hypot(0.2) + 0.2 + 0.069744;
    assert!((shortfall.reach - links - 0.09).abs() < 1e-9, "{shortfall:?}");
    let message = shortfall.to_string();
    for says in ["five_joint_hobby_arm", "of 17", "longer reach", "the first joint"] {
        assert!(message.contains(says), "{message}");
    }
}

/// A gantry whose slides move by 10 mm holds its hand over the centre, turned by 30 degrees.
#[test]
fn an_arm_that_reaches_the_start_alone_is_refused_for_the_first_place_of_the_tasks() {
    let slide = |index: usize, origin: &str, axis: &str| {
        let next = index + 1;
        format!(
            "<link name=\"l{next}\"><inertial><mass value=\"1\"/><inertia ixx=\"1\" ixy=\"0\" \
             ixz=\"0\" iyy=\"1\" iyz=\"0\" izz=\"1\"/></inertial></link>\
             <joint name=\"j{next}\" type=\"prismatic\"><origin {origin}/>\
             <parent link=\"l{index}\"/><child link=\"l{next}\"/><axis xyz=\"{axis}\"/>\
             <limit lower=\"-0.01\" upper=\"0.01\" effort=\"50\" velocity=\"1\"/></joint>"
        )
    };
    let slides = [
        slide(0, "xyz=\"0 0 0.31\"", "1 0 0"),
        slide(1, "", "0 1 0"),
        slide(2, "rpy=\"3.14159265 0 0.5236\"", "0 0 1"),
    ];
    let folder = Folder::new("gantry");
    let urdf = format!("<robot name=\"gantry\"><link name=\"l0\"/>{}</robot>", slides.concat());
    let file = RobotFile {
        urdf: folder.write("gantry.urdf", &urdf),
        approach_axis: Some([0.0, 0.0, 1.0]),
        base_position: Some([0.0; 3]),
        ..RobotFile::default()
    };
    let EnvError::OutOfReach(shortfall) = Arm::from_file("arm", &file).unwrap_err() else {
        panic!("another error");
    };
    assert_eq!(shortfall.reached, 0, "{shortfall:?}");
    assert!(shortfall.missed.x > 0.1, "{shortfall:?}");
}

/// Settings hold the path, so a run can be resumed; links may have names of the scene.
#[test]
fn settings_hold_the_path_of_an_arm_and_its_file_the_rest() {
    let folder = Folder::new("own-arm");
    let names = [("base_link", "hand"), ("shoulder_link", "table"), ("\"elbow\"", "\"slide\"")];
    folder.write("my arm.urdf", &replaced(HOBBY, &names));
    let json = r#"{"urdf": "my arm.urdf", "base_position": [0, -0.33, 0.05], "hand": "gripper_link",
                   "approach_axis": [1, 0, 0]}"#;
    let path = folder.write("my arm.json", json);
    let embodiment: Embodiment = path.to_str().unwrap().parse().unwrap();
    let settings = VecEnvSettings { embodiment, ..VecEnvSettings::default() };
    let text = serde_json::to_string(&settings).unwrap();
    assert!(text.contains("my arm.json"), "{text}");
    assert_eq!(serde_json::from_str::<VecEnvSettings>(&text).unwrap(), settings);
    let arm = embodiment.arm().unwrap();
    assert_eq!(arm.robot_description().base_pose().position, DVec3::new(0.0, -0.33, 0.05));
    assert_eq!(arm.chain().joints().len(), 5);
    Scene::new(TaskGroup::DRAWER_CLOSE, embodiment, Camera::default()).unwrap();
    let missing = Embodiment::from_file(&folder.0.join("none.urdf")).unwrap();
    let message = missing.arm().unwrap_err().to_string();
    assert!(message.contains("cannot read") && message.contains("none.urdf"), "{message}");
    let without_servos = Embodiment::SAWYER.arm().unwrap_err().to_string();
    assert!(without_servos.contains("`embodiment` is sawyer"), "{without_servos}");
    assert!(Embodiment::from_file(Path::new("arm.xacro")).is_err());
    // has no absolute path
    let empty = Embodiment::from_file(Path::new("")).unwrap_err();
    assert!(matches!(&empty, EnvError::Robot(_)), "{empty}");
    for degrees in [-361.0, f64::NAN] {
        let base_yaw_degrees = Some(degrees);
        let turned = RobotFile { base_yaw_degrees, ..RobotFile::read(&path).unwrap() };
        let refused = Arm::from_file("arm", &turned).unwrap_err().to_string();
        assert!(refused.contains("`base_yaw_degrees` is"), "{refused}");
    }
}

#[test]
fn fingers_that_cannot_be_used_are_refused() {
    let folder = Folder::new("fingers");
    let urdf = folder.write("arm.urdf", GRIPPER);
    let refusal = |hand: &str, fingers: Option<[&str; 2]>, changed: &[(&str, &str)]| {
        std::fs::write(&urdf, replaced(GRIPPER, changed)).unwrap();
        let file = RobotFile {
            urdf: urdf.clone(),
            fingers: fingers.map(|names| names.map(str::to_owned)),
            hand: Some(hand.to_owned()),
            ..RobotFile::default()
        };
        Arm::from_file("arm", &file).map(|_| "no error").unwrap_err().to_string()
    };
    let own = Some(["finger_1", "finger_2"]);
    let follows = r#"<mimic joint="finger_1"/>"#;
    let second = "<child link=\"finger_2\"/>\n    <axis xyz=\"0 -1 0\"/>";
    let first = "<child link=\"finger_1\"/>\n    <axis xyz=\"0 1 0\"/>";
    let tool = "<link name=\"tool\"/><joint name=\"tool\" type=\"fixed\">\
                <parent link=\"flange\"/><child link=\"tool\"/></joint></robot>";
    for (hand, fingers, changed, says) in [
        ("gripper", Some(["finger_1", "thumb"]), &[][..], "the hand has no such links"),
        ("gripper", Some(["finger_1", "flange"]), &[], "the hand has no such links"),
        ("tool", own, &[("</robot>", tool)], "the hand has no such links"),
        ("grip", own, &[], "no link `grip`"),
        ("link_6", Some(["finger_1", "flange"]), &[], "they have none"),
        ("link_5", Some(["finger_1", "link_7"]), &[], "one joint must move both"),
        ("gripper", own, &[(follows, "")], "one joint must move both"),
        (
            "gripper",
            own,
            &[
                (follows, r#"<mimic joint="joint_7"/>"#),
                (first, &first.replace("<axis", "<mimic joint=\"joint_7\"/><axis")),
            ],
            "a joint between the base and the hand",
        ),
        ("gripper", None, &[(follows, "")], "set `fingers`"),
        (
            "gripper",
            None,
            &[("0 0.02 -0.03", "0 0.04 -0.03"), ("0 -0.02 -0.03", "0 -0.04 -0.03")],
            "106 mm wide",
        ),
        (
            "gripper",
            None,
            &[
                (first, &first.replace("0 1 0", "0 0 1")),
                (second, &second.replace("0 -1 0", "0 0 1")),
            ],
            "do not move outwards",
        ),
    ] {
        let message = refusal(hand, fingers, changed);
        assert!(message.contains(says), "{says}, not {message}");
    }
}
