//! Arms of files: three kinds that play all tasks, and what keeps others from it.

use std::path::{Path, PathBuf};
use std::sync::Arc;

use envs::conformance::measure_expert;
use envs::embodiments::Arm;
use envs::robots::{OrientationConstraint, RobotFile};
use envs::{Camera, Control, Embodiment, EnvError, Scene, TableTop, TaskGroup, VecEnvSettings};
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

/// Returns the successes of the expert on all variants of all groups, of `seeds` each.
fn solved(embodiment: Embodiment, seeds: u64) -> Vec<u64> {
    let groups = TaskGroup::STANDARD.into_iter();
    let of_group = groups.flat_map(|group| {
        let scene = Arc::new(Scene::new(group, embodiment, Camera::default()).unwrap());
        let rows = D2::ALL.map(|element| {
            measure_expert(&scene, element, Control::default(), seeds).unwrap().successes
        });
        rows.into_iter()
    });
    of_group.collect()
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
        assert_eq!(solved(arm, 1), [1; 16], "{name}");
    }
}

/// The fingers open at the upper end of their joint's range, as far as the Sawyer arm's.
#[test]
fn fingers_of_a_robot_are_found_and_closed() {
    let embodiment = asset("seven_joint_gripper.urdf");
    let scene = Scene::new(TaskGroup::GOAL_REACH, embodiment, Camera::default()).unwrap();
    let mut table = TableTop::new(Arc::new(scene), Control::default()).unwrap();
    table.reset(D2::Identity, &mut ChaCha8Rng::seed_from_u64(1000)).unwrap();
    let open = table.measurement().unwrap();
    assert!((open.aperture - 1.0).abs() < 1e-3, "{open:?}");
    assert!((open.hand - open.tcp).distance(0.045 * DVec3::Z) < 1e-3, "{open:?}");
    for _ in 0..8 {
        table.step(&[0.0, 0.0, 0.0, 1.0]).unwrap();
    }
    let closed = table.measurement().unwrap();
    assert!((0.3..0.8).contains(&closed.aperture), "{closed:?}");
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
    let mut table = TableTop::new(Arc::new(scene), Control::default()).unwrap();
    table.reset(D2::Identity, &mut ChaCha8Rng::seed_from_u64(1000)).unwrap();
    let direction = |of: &TableTop| {
        let now = of.measurement().unwrap();
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
    assert_eq!(solved(embodiment, 1)[..4], [1; 4]);
}

#[test]
fn an_arm_that_is_too_short_is_refused_with_the_figures() {
    let folder = Folder::new("short-arm");
    let short = replaced(
        HOBBY,
        &[
            (r#"xyz="0.05955 0 0.3""#, r#"xyz="0.03 0 0.12""#),
            (r#"xyz="0.3 0 0""#, r#"xyz="0.14 0 0""#),
        ],
    );
    let message = folder.arm(&short).unwrap_err().to_string();
    for says in ["five_joint_hobby_arm", "of 17", "longer reach", "at most 0.4"] {
        assert!(message.contains(says), "{message}");
    }
}

/// Settings hold the path, so a run can be resumed; links may have names of the scene.
#[test]
fn settings_hold_the_path_of_an_arm_and_its_file_the_rest() {
    let folder = Folder::new("own-arm");
    let names = [("base_link", "hand"), ("shoulder_link", "table"), ("\"elbow\"", "\"slide\"")];
    folder.write("my arm.urdf", &replaced(HOBBY, &names));
    let json = r#"{"urdf": "my arm.urdf", "base_position": [0, -0.33, 0.05], "hand": "wrist_link",
                   "approach_axis": [1, 0, 0]}"#;
    let path = folder.write("my arm.json", json);
    let embodiment: Embodiment = path.to_str().unwrap().parse().unwrap();
    let settings = VecEnvSettings { embodiment, ..VecEnvSettings::default() };
    let text = serde_json::to_string(&settings).unwrap();
    assert!(text.contains("my arm.json"), "{text}");
    assert_eq!(serde_json::from_str::<VecEnvSettings>(&text).unwrap(), settings);
    let arm = embodiment.arm().unwrap();
    assert_eq!(arm.robot().base_pose().position, DVec3::new(0.0, -0.33, 0.05));
    assert_eq!(arm.chain().joints().len(), 4);
    Scene::new(TaskGroup::DRAWER_CLOSE, embodiment, Camera::default()).unwrap();
    let missing = Embodiment::from_file(&folder.0.join("none.urdf")).unwrap();
    let message = missing.arm().unwrap_err().to_string();
    assert!(message.contains("cannot read") && message.contains("none.urdf"), "{message}");
    let without_servos = Embodiment::SAWYER.arm().unwrap_err().to_string();
    assert!(without_servos.contains("`embodiment` is sawyer"), "{without_servos}");
    assert!(Embodiment::from_file(Path::new("arm.xacro")).is_err());
}

#[test]
fn fingers_that_cannot_be_used_are_refused() {
    let folder = Folder::new("fingers");
    let urdf = folder.write("arm.urdf", GRIPPER);
    let refusal = |fingers: [&str; 2], changed: &[(&str, &str)]| {
        std::fs::write(&urdf, replaced(GRIPPER, changed)).unwrap();
        let file = RobotFile {
            urdf: urdf.clone(),
            fingers: Some(fingers.map(str::to_owned)),
            hand: Some("gripper".to_owned()),
            ..RobotFile::default()
        };
        Arm::from_file("arm", &file).unwrap_err().to_string()
    };
    let own = ["finger_1", "finger_2"];
    for (fingers, changed, says) in [
        (["finger_1", "thumb"], &[][..], "no such links"),
        (["finger_1", "flange"], &[], "they have none"),
        (["finger_1", "link_5"], &[], "one joint must move both"),
        (own, &[(r#"<mimic joint="finger_1"/>"#, "")], "one joint must move both"),
    ] {
        let message = refusal(fingers, changed);
        assert!(message.contains(says), "{message}");
    }
}
