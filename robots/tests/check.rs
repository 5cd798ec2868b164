//! Checks of robots, guesses of their hands, files of settings, and additions.

use glam::{DMat3, DQuat, DVec3};
use mujoco::Model;
use robots::{
    Chain, DescriptionError, Inertia, Link, MAX_LINKS, MjcfSettings, OrientationConstraint,
    PlacedShape, Pose, RobotDescription, RobotFile, Shape, gen3,
};

use crate::SIX_JOINT;

fn six_joint(from: &str, to: &str) -> RobotDescription {
    let text = SIX_JOINT.replace(from, to);
    assert!(from == to || text != SIX_JOINT, "{from}");
    RobotDescription::from_urdf(&text).unwrap()
}

#[test]
fn the_check_of_a_whole_robot_finds_its_hand_and_nothing_wrong() {
    let check = gen3::gen3_description().unwrap().check_report(None).unwrap();
    assert!(check.passes(), "{check:#?}");
    assert_eq!((&check.hand[..], check.chain.len(), check.joints.len()), ("gripper_link", 7, 9));
    assert_eq!(check.approach_axis, Some([0.0, 0.0, 1.0]));
    let fingers = check.fingers.unwrap();
    assert!(fingers.iter().all(|finger| finger.starts_with("finger_")), "{fingers:?}");
    // Kinova: an arm of 8.2 kg with a reach of 902 mm, and a gripper of 0.9 kg
    assert!((check.mass_kg - 9.1).abs() < 0.2, "{}", check.mass_kg);
    let reach = check.reach_m.unwrap();
    assert!((0.902..1.2).contains(&reach), "{reach}");
    let (found, tried) = (check.ik_found, check.ik_targets);
    assert!(tried > 0 && 100 * found >= 97 * tried, "{found} of {tried}");
    let [median, most] = check.ik_median_and_max_ms;
    assert!(0.0 < median && median <= most, "{median} {most}");
    let tool = gen3::gen3_description().unwrap().check_report(Some("tool_link")).unwrap();
    assert!(tool.reach_m.unwrap() > reach);
    let message =
        gen3::gen3_description().unwrap().check_report(Some("claw")).unwrap_err().to_string();
    assert!(message.contains("`claw`"), "{message}");
}

#[test]
fn values_in_other_units_are_named() {
    for (from, to, says) in [
        (
            "<mass value=\"4\"/>",
            "<mass value=\"4000\"/>",
            "4005.700 kg together: is the file in grams",
        ),
        ("xyz=\"0 0 0.25\"", "xyz=\"0 0 250\"", "m long: is the file in millimetres"),
        ("size=\"0.1 0.12 0.3\"", "size=\"100 120 300\"", "link `column` are"),
        ("lower=\"-3\"", "lower=\"-172\"", "`twist` turns as far as 172 rad: is the file in deg"),
        (
            "velocity=\"1.5\"",
            "velocity=\"86\"",
            "`turn` turns at up to 86 rad/s: is the file in deg",
        ),
        ("ixx=\"0.05\"", "ixx=\"50\"", "the link `column` of 4 kg has 47.5"),
        ("rpy=\"0 0.2 0\"", "rpy=\"0 11.5 0\"", "is \"0 11.5 0\": is the file in degrees"),
        (
            "<origin xyz=\"0 0 0.1\" rpy=\"0.3",
            "<origin xyz=\"0 0 60\" rpy=\"0.3",
            "centre of mass of the link `column` is 60.0 m from it",
        ),
        ("lower=\"-0.1\"", "lower=\"-100\"", "`lift` slides as far as 100 m: is the file in mill"),
    ] {
        let check = six_joint(from, to).check_report(Some("tip")).unwrap();
        assert!(!check.passes());
        let found = check.unit_warnings.iter().any(|warning| warning.contains(says));
        assert!(found, "{says}: {:?}", check.unit_warnings);
    }
    let check = six_joint("", "").check_report(Some("tip")).unwrap();
    assert_eq!(check.unit_warnings, [""; 0]);
}

#[test]
fn what_keeps_a_robot_from_moving_is_a_problem() {
    for (from, to, says) in [
        ("<mass value=\"1.5\"/>", "<mass value=\"0\"/>", "`upper_arm`, which has no mass"),
        ("velocity=\"0.4\"", "", "the speeds of the joints lift"),
        ("effort=\"60\"", "", "the efforts of the joints turn"),
        ("lower=\"-3\" upper=\"3\"", "lower=\"3\" upper=\"-3\"", "its lower limit is 3"),
    ] {
        let check = six_joint(from, to).check_report(Some("tip")).unwrap();
        assert!(check.problems.iter().any(|of| of.contains(says)), "{:?}", check.problems);
    }
    let reversed = six_joint("lower=\"-3\" upper=\"3\"", "lower=\"3\" upper=\"-3\"");
    let once = reversed.check_report(Some("tip")).unwrap();
    assert_eq!(once.problems.len(), 1, "{:?}", once.problems);
    let check = six_joint("", "").check_report(Some("counterweight")).unwrap();
    assert!(check.problems[0].contains("`balance` on it follows"), "{:?}", check.problems);
    assert_eq!((check.ik_targets, check.reach_m), (0, None));
}

/// Returns a robot of links without masses; each has a name, a parent, and moves or not.
fn tree(links: &[(&str, &str, &str)]) -> RobotDescription {
    let part = |(name, parent, kind): &(&str, &str, &str)| {
        format!(
            "<link name=\"{name}\"/><joint name=\"{name}\" type=\"{kind}\"><origin xyz=\"0 -1 0\"/>\
             <parent link=\"{parent}\"/><child link=\"{name}\"/></joint>"
        )
    };
    let parts: String = links.iter().map(part).collect();
    RobotDescription::from_urdf(&format!("<robot name=\"r\"><link name=\"base\"/>{parts}</robot>"))
        .unwrap()
}

#[test]
fn the_hand_is_the_last_link_before_the_fingers() {
    let arm = [("stand", "base", "fixed"), ("arm", "base", "continuous")];
    let flange = [("flange", "arm", "fixed"), ("tool", "flange", "fixed")];
    let fingers = [("one", "tool", "continuous"), ("two", "tool", "continuous")];
    let frames = [("camera", "tool", "fixed"), ("tip", "tool", "fixed")];
    assert_eq!(tree(&arm).default_hand_link(), "arm");
    for end in [&[][..], &fingers, &frames, &[fingers, frames].concat()] {
        let robot = tree(&[&arm[..], &flange, end].concat());
        assert_eq!(robot.default_hand_link(), "tool", "{end:?}");
        assert_eq!(robot.default_approach_axis("tool").unwrap(), DVec3::NEG_Y);
        let moves = end.iter().any(|(_, _, kind)| *kind == "continuous");
        let check = robot.check_report(None).unwrap();
        assert_eq!((check.fingers, check.has_fixed_claws), (None, !moves));
        // fingers that move on their own are no gripper
        let says = |of: &String| of.contains("links one, two move") && of.contains("set `fingers`");
        assert_eq!(check.problems.iter().any(says), moves, "{:?}", check.problems);
    }
}

/// The tip of this arm is turned by 0.6 radians against the link that carries it.
#[test]
fn an_approach_axis_that_is_no_axis_of_the_hand_is_refused() {
    let robot = six_joint("rpy=\"0 0.2 0\"", "rpy=\"0 0.6 0\"");
    let refused = robot.default_approach_axis("tip").unwrap_err().to_string();
    assert!(refused.contains("`tip`") && refused.contains("set `approach_axis`"), "{refused}");
    let problems = robot.check_report(Some("tip")).unwrap().problems;
    assert_eq!(problems, [refused]);
}

#[test]
fn a_file_of_settings_names_the_urdf_beside_it() {
    let folder = std::env::temp_dir().join(format!("covers-robot-file-{}", std::process::id()));
    std::fs::create_dir_all(&folder).unwrap();
    std::fs::write(folder.join("arm.urdf"), SIX_JOINT.replace("velocity=\"0.4\"", "")).unwrap();
    let read = |text: &str| {
        std::fs::write(folder.join("arm.json"), text).unwrap();
        RobotFile::read(&folder.join("arm.json"))
    };
    let file = read(
        r#"{"urdf": "arm.urdf", "hand": "tip", "approach_axis": [0, 2, 0], "default_speed": 0.3}"#,
    );
    let file = file.unwrap();
    let robot = file.read_description().unwrap();
    assert_eq!((file.hand_link(&robot), file.approach_axis(&robot).unwrap()), ("tip", DVec3::Y));
    assert!(robot.check_report(Some("tip")).unwrap().problems.is_empty());
    let finger = read(r#"{"urdf": "arm.urdf", "fingers": ["tip", "thumb"]}"#).unwrap();
    let problems = finger.check_report().unwrap().problems;
    assert!(problems.iter().any(|of| of.contains("`thumb`")), "{problems:?}");
    let axis = read(r#"{"urdf": "arm.urdf", "approach_axis": [0, 0, 0]}"#).unwrap();
    let refused = axis.approach_axis(&robot).unwrap_err().to_string();
    assert!(refused.contains("`approach_axis` is 0"), "{refused}");
    let unknown = read(r#"{"urdf": "arm.urdf", "hnad": "tip"}"#).unwrap_err().to_string();
    assert!(unknown.contains("arm.json") && unknown.contains("`hnad`"), "{unknown}");
    let plain = RobotFile::read(&folder.join("arm.urdf")).unwrap();
    assert_eq!(plain.urdf, folder.join("arm.urdf"));
    let rooted = read(r#"{"urdf": "arm.urdf", "mesh_root": "none"}"#).unwrap();
    let no_folder = rooted.read_description().unwrap_err().to_string();
    assert!(no_folder.contains("arm.urdf`: ") && no_folder.contains("mesh_root"), "{no_folder}");
    assert!(matches!(
        RobotFile::read(&folder.join("none.json")),
        Err(robots::DescriptionError::Read { .. })
    ));
    std::fs::remove_dir_all(folder).unwrap();
}

/// Messages name line, setting, value and what is expected, in no words of a parser.
#[test]
fn settings_that_cannot_be_read_are_explained() {
    let path = std::env::temp_dir().join(format!("covers-settings-{}.json", std::process::id()));
    for (text, says) in [
        (
            "{\n 'urdf': 'a',\n 'default_speed': 'fast'}",
            "line 3: `default_speed` is 'fast', expected a number",
        ),
        (
            "{'urdf': 'a', 'base_position': [0, 1]}",
            "`base_position` is [0,1], expected three numbers",
        ),
        ("{'urdf': 'a', 'base_position': [0, 1, 2, 3]}", "is [0,1,2,3], expected three numbers"),
        (
            "{'urdf': 'a',\n'base_yaw_degrees': NaN}",
            "line 2 is not valid JSON near `'base_yaw_degrees': NaN}`",
        ),
        ("{'urdf': 'a', 'base_yaw_degrees': 1e999}", "infinite or NaN"),
        (
            "{'urdf': 'a',\n\n'fingers': ['b'],\n'repair': 1}",
            "line 3: `fingers` is ['b'], expected the names of two links\nline 4: `repair` is 1, expected true",
        ),
        ("{'urdf': 'a',\n'repair': 1,\n'hand' 'b'}", "line 3 is not valid JSON near"),
        ("{'urdf': 'a',", "line 1: the file ends early"),
        ("", "the file ends early"),
        ("[1]", "expected an object, such as {'urdf'"),
        ("{'hand': 'b'}", "`urdf` is missing"),
        ("{'urdf': 'a',\n'urdf': 'b'}", "line 2: `urdf` is given twice"),
        (
            "{'urdf': 'hnad',\n'hnad': 'b'}",
            "line 2: there is no setting `hnad`; there are `urdf`, `hand`",
        ),
    ] {
        std::fs::write(&path, text.replace('\'', "\"")).unwrap();
        let message = RobotFile::read(&path).unwrap_err().to_string().replace('"', "'");
        let is_raw = ["f64", "EOF", "invalid"].iter().any(|word| message.contains(word));
        assert!(
            message.contains(says) && message.contains("covers-settings-") && !is_raw,
            "{message}"
        );
    }
    std::fs::remove_file(path).unwrap();
}

#[test]
fn a_base_that_is_not_at_the_table_is_a_problem() {
    let urdf = std::path::PathBuf::from("assets/urdf/six_joint.urdf");
    let plain = RobotFile { urdf, hand: Some("tip".to_owned()), ..RobotFile::default() };
    let at = |place| RobotFile { base_position: Some(place), ..plain.clone() };
    let turned = |degrees| RobotFile { base_yaw_degrees: Some(degrees), ..plain.clone() };
    for (file, says) in [
        (
            at([0.0, -500.0, 0.0]),
            "`base_position` from the centre of the table is 500, expected at",
        ),
        (at([f64::NAN, 0.0, 0.0]), "the table is NaN, expected at most 5 metres"),
        (turned(720.0), "`base_yaw_degrees` is 720, expected degrees from -360 to 360"),
        (turned(f64::NAN), "`base_yaw_degrees` is NaN"),
    ] {
        let problems = file.check_report().unwrap().problems;
        assert!(problems.len() == 1 && problems[0].contains(says), "{problems:?}");
    }
    assert_eq!(at([0.0, -0.5, 0.1]).check_report().unwrap().problems, [""; 0]);
}

/// GBK and the like, whose names would otherwise be garbage without a word.
#[test]
fn a_guessed_encoding_is_noted() {
    let path = std::env::temp_dir().join(format!("covers-encoding-{}.urdf", std::process::id()));
    let notes = |head: &str, name: &[u8]| {
        let text = [head.as_bytes(), b"<robot name='r'><link name='", name, b"'/></robot>"];
        std::fs::write(&path, text.concat()).unwrap();
        RobotDescription::from_urdf_file(&path).unwrap().import_notes().join("; ")
    };
    let gbk = b"\xb1\xdb";
    for head in ["", "<?xml version='1.0'?>", "<?xml version='1.0' encoding='GBK'?>"] {
        let note = notes(head, gbk);
        assert!(note.contains("read as Latin-1") && note.contains("save it as UTF-8"), "{note}");
        assert_eq!(notes(head, "\u{81c2}".as_bytes()) + &notes(head, b"arm"), "");
    }
    assert_eq!(notes("<?xml version='1.0' encoding='ISO-8859-1'?>", gbk), "");
    std::fs::remove_file(path).unwrap();
}

#[test]
fn an_added_link_moves_with_its_parent_and_nothing_else_moves() {
    let bare = six_joint("", "");
    let origin = Pose::from_xyz_rpy([0.1, 0.2, 0.3], [0.4, 0.5, 0.6]);
    let added = || Link { name: "added".to_owned(), inertia: None, shapes: Vec::new() };
    let positions = [0.3, 0.1, 0.7, -0.3, -0.6, 1.1];
    for parent in ["world", "upper_arm", "tip"] {
        let robot = bare.clone().with_fixed_link(parent, origin, added()).unwrap();
        let named = |of: &RobotDescription, name: &str| {
            let at = of.links().iter().position(|link| link.name == name).unwrap();
            of.link_poses(&positions)[at]
        };
        for link in bare.links() {
            assert_eq!(named(&robot, &link.name), named(&bare, &link.name), "{}", link.name);
        }
        let way = named(&robot, "added").displacement_to(&(named(&bare, parent) * origin));
        assert!(way.iter().all(|part| part.length() < 1e-12), "{way:?}");
        let taken = robot.with_fixed_link("tip", origin, added()).unwrap_err().to_string();
        assert!(taken.contains("called `added`"), "{taken}");
        let nameless = Link { name: String::new(), ..added() };
        let refused = bare.clone().with_fixed_link(parent, origin, nameless).unwrap_err();
        assert!(refused.to_string().contains("it is empty"), "{refused}");
        let tilted = Pose { rotation: origin.rotation * 2.0, ..origin };
        let crooked = bare.clone().with_fixed_link(parent, tilted, added()).unwrap_err();
        assert!(crooked.to_string().contains("the length of its rotation is"), "{crooked}");
    }
    let prefixed = bare.clone().with_prefix("robot/").unwrap();
    assert_eq!(prefixed.links()[1].name, "robot/column");
    assert_eq!(prefixed.joints()[1].name, "robot/lift");
    assert_eq!(prefixed.link_poses(&positions), bare.link_poses(&positions));
}

/// Returns a link that may be added, with this change.
fn added_link(change: impl FnOnce(&mut Link)) -> Link {
    let inertia = Inertia {
        mass: 0.2,
        centre_of_mass: DVec3::ZERO,
        tensor: DMat3::from_diagonal(DVec3::new(1e-3, 2e-3, 2.5e-3)),
    };
    let shape = Shape::Box { half_extents: DVec3::splat(0.05) };
    let shapes = vec![PlacedShape { pose: Pose::IDENTITY, shape }];
    let mut link = Link { name: "added".to_owned(), inertia: Some(inertia), shapes };
    change(&mut link);
    link
}

fn add(link: Link) -> Result<RobotDescription, DescriptionError> {
    six_joint("", "").with_fixed_link("tip", Pose::IDENTITY, link)
}

#[test]
fn an_added_link_is_held_to_the_rules_of_a_urdf() {
    let of_inertia =
        |change: fn(&mut Inertia)| added_link(|link| change(link.inertia.as_mut().unwrap()));
    let of_shape = |shape| added_link(|link| link.shapes[0].shape = shape);
    let turned = Pose { rotation: DQuat::from_xyzw(0.0, 0.0, 0.0, 2.0), ..Pose::IDENTITY };
    for (link, words) in [
        (
            of_inertia(|own| own.mass = -0.2),
            "link `added`: its mass is -0.2, expected zero or more",
        ),
        (of_inertia(|own| own.mass = f64::NAN), "its mass is NaN"),
        (of_inertia(|own| own.centre_of_mass.x = f64::INFINITY), "its centre of mass is inf"),
        (of_inertia(|own| own.tensor.y_axis.x = f64::NAN), "its inertia is NaN"),
        (of_inertia(|own| own.tensor.x_axis.x = -1e-3), "a principal inertia is below 1e-12"),
        (of_inertia(|own| own.tensor.z_axis.z = 4e-3), "exceeds the sum of the others"),
        (of_inertia(|own| own.tensor.y_axis.x = 1e-4), "its matrix is not symmetric"),
        (of_shape(Shape::Sphere { radius: -0.1 }), "shape 0 of the link `added`: its size is -0.1"),
        (of_shape(Shape::Capsule { radius: 0.1, length: 0.0 }), "its size is 0, expected 1e-6"),
        (of_shape(Shape::Cylinder { radius: f64::NAN, length: 1.0 }), "its size is NaN"),
        (of_shape(Shape::Box { half_extents: DVec3::new(0.1, 0.1, 1e6) }), "its size is 2000000"),
        (added_link(|link| link.shapes[0].pose = turned), "the length of its rotation is 2"),
        (
            added_link(|link| link.shapes = vec![link.shapes[0].clone(); 1001]),
            "1001 collision shapes",
        ),
    ] {
        let message = add(link).unwrap_err().to_string();
        assert!(message.contains(words), "{words}: {message}");
    }
    let light = of_inertia(|own| (own.mass, own.tensor) = (1e-9, DMat3::ZERO));
    for link in [added_link(|_| ()), light] {
        let mjcf = add(link).unwrap().to_mjcf(&MjcfSettings::default()).unwrap();
        Model::from_xml(&mjcf.text).unwrap();
    }
}

#[test]
fn added_links_and_prefixes_keep_to_the_limits() {
    let mut robot = RobotDescription::from_urdf("<robot><link name=\"base\"/></robot>").unwrap();
    let link = |index: usize| Link { name: index.to_string(), inertia: None, shapes: Vec::new() };
    for index in 1..MAX_LINKS {
        robot = robot.with_fixed_link("base", Pose::IDENTITY, link(index)).unwrap();
    }
    assert_eq!(robot.links().len(), MAX_LINKS);
    let full = robot.clone().with_fixed_link("base", Pose::IDENTITY, link(MAX_LINKS)).unwrap_err();
    assert_eq!(full.to_string(), "the robot `` has 1001 links, expected 1 to 1000");
    assert_eq!(robot.clone().with_prefix(&"p".repeat(196)).unwrap().links()[0].name.len(), 200);
    for (prefix, words) in [("p".repeat(197), "200 bytes"), ("a\n".to_owned(), "control character")]
    {
        let message = robot.clone().with_prefix(&prefix).unwrap_err().to_string();
        assert!(message.contains(words), "{message}");
    }
}

/// Three slides move the tip as fast as the slowest of them, and two move it in a plane alone.
#[test]
fn a_tip_is_as_fast_as_along_its_slowest_axis() {
    let slides = |axes: &[(&str, f64)]| {
        let mut parts = "<link name=\"l0\"/>".to_owned();
        for (index, (axis, speed)) in axes.iter().enumerate() {
            let next = index + 1;
            parts += &format!(
                "<link name=\"l{next}\"/><joint name=\"j{next}\" type=\"prismatic\">\
                 <parent link=\"l{index}\"/><child link=\"l{next}\"/><axis xyz=\"{axis}\"/>\
                 <limit lower=\"-1\" upper=\"1\" effort=\"1\" velocity=\"{speed}\"/></joint>"
            );
        }
        let robot = RobotDescription::from_urdf(&format!("<robot name=\"r\">{parts}</robot>"));
        let tip = format!("l{}", axes.len());
        let chain = Chain::new(&robot.unwrap(), &tip).unwrap();
        chain.slowest_axis_tip_speed(&vec![0.0; axes.len()], OrientationConstraint::Full)
    };
    let speed = slides(&[("1 0 0", 0.7), ("0 1 0", 0.5), ("0 0 1", 0.9)]);
    assert!((speed - 0.5).abs() < 1e-5, "{speed}");
    assert_eq!(slides(&[("1 0 0", 0.7), ("0 1 0", 0.5)]), 0.0);
}
