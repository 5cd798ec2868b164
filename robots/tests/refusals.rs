//! Invalid files: each causes a clear error.

use std::path::Path;
use std::sync::Arc;

use mujoco::{Data, Model};
use robots::{
    Chain, JointMotionSpec, JointPositionSource, JointServoSettings, MAX_URDF_BYTES, MjcfSettings,
    Pose, RobotDescription, Shape, TwistControlSettings, TwistController, UrdfSettings,
};

use crate::SIX_JOINT;
use crate::meshes::Folder;

/// The six-jointed arm with `old` replaced by `new`.
#[track_caller]
fn changed(old: &str, new: &str) -> String {
    assert!(SIX_JOINT.contains(old), "{old}");
    SIX_JOINT.replacen(old, new, 1)
}

#[track_caller]
fn read(urdf: &str) -> RobotDescription {
    RobotDescription::from_urdf(urdf).unwrap()
}

/// The message about an invalid file.
#[track_caller]
fn refusal(urdf: &str) -> String {
    let message = RobotDescription::from_urdf(urdf).unwrap_err().to_string();
    println!("{message}");
    message
}

/// The columns of a table's lines, separated by `|`.
fn rows<const N: usize>(table: &str) -> impl Iterator<Item = [&str; N]> {
    table.trim().lines().map(|line| {
        let columns: Vec<&str> = line.split('|').map(str::trim).collect();
        columns.try_into().unwrap()
    })
}

/// Refuses lines of old text, new text and words of the message.
#[track_caller]
fn all_refused(table: &str) {
    for [old, new, words] in rows(table) {
        let message = refusal(&changed(old, new));
        let missing = words.split("; ").find(|word| !message.contains(word));
        assert!(missing.is_none(), "{missing:?} is not in: {message}");
    }
}

#[test]
fn trees_that_are_none_are_refused() {
    all_refused(
        r#"
        <parent link="forearm"/> | <parent link="wrist"/>                 | `wrist`; hangs on itself
        <parent link="world"/>   | <parent link="column"/>                | hangs on itself
        <parent link="forearm"/> | <parent link="arm"/>                   | `arm`; joint `twist`; carriage
        <child link="wrist"/>    | <child link="forearm"/>                | `forearm`; `swing`; `twist`
        <link name="tip"/>       | <link name="tip"/><link name="spare"/> | world, spare; one root
        "#,
    );
    let links: String = (0..=robots::MAX_LINKS).map(|i| format!("<link name=\"{i}\"/>")).collect();
    assert!(refusal(&format!("<robot>{links}</robot>")).contains("1001 links, expected 1 to 1000"));
    let joint = "<joint type=\"fixed\"><parent link=\"a\"/><child link=\"b\"/></joint>";
    let many = format!("<robot><link name=\"a\"/>{}</robot>", joint.repeat(1001));
    assert!(refusal(&many).contains("1001 joints, expected 0 to 1000"));
}

#[test]
fn names_must_be_unique_and_usable() {
    all_refused(
        r#"
        <link name="tip"/> | <link name="column"/> | two links; `column`
        <joint name="nod"  | <joint name="twist"   | two joints; `twist`
        <link name="tip"/> | <link name=""/>       | link name ""; empty
        "#,
    );
    let long = format!("<link name=\"{}\"/>", "x".repeat(201));
    assert!(refusal(&changed("<link name=\"tip\"/>", &long)).contains("200 bytes"));
    // MuJoCo's own name, for a link with shapes and for a frame that hangs on another link
    for taken in ["\"column\"", "\"tip\""] {
        let urdf = SIX_JOINT.replace("\"world\"", "\"ground\"").replace(taken, "\"world\"");
        assert!(not_simulated(&urdf).contains("simulated world"));
    }
}

#[test]
fn joints_must_be_possible() {
    all_refused(
        r#"
        name="twist" type="revolute"        | name="twist" type="floating" | `twist` is "floating"; continuous
        name="twist" type="revolute"        | name="twist"               | joint `twist` has no `type`
        lower="-3" upper="3"                | lower="inf" upper="inf"    | `lower` of `<limit>`; `twist` is "inf"; within 1e6
        lower="-3" upper="3"                | lower="-2e6" upper="-1e6"  | `upper` of `<limit>`; `twist` is "-1e6"; within 1e6
        upper="0.3"                         | upper="nan"                | `upper` of `<limit>` of the joint `lift`; a number
        lower="-3" upper="3"                | lower="-3,1" upper="3"     | `twist` is "-3,1"; a number
        damping="20"                        | damping="-20"              | joint `lift`; -20
        xyz="0 0 2"                         | xyz="0 0 0"                | `<axis>` of the joint `lift`; direction
        rpy="0 0.4 0"                       | rpy="0 nan 0"              | joint `swing`; rpy
        <parent link="forearm"/>            |                            | the joint `twist` has no `<parent>`
        <limit lower="-3" upper="3" effort="20" velocity="2"/> |         | the joint `twist` has no `<limit>`; continuous
        xyz="0 0 2"                         | xyz="0 oops 0 2"           | `xyz`; three numbers; line
        xyz="0 0 2"                         | xyz="0 0"                  | `xyz`; three numbers; line
        rpy="0 0.4 0"                       | rpy="0 0.4, 0 0"           | `rpy`; three numbers; line
        rpy="0 0.4 0"                       | quat_xyzw="0 0 0 1"        | quat_xyzw; rpy
        <mimic joint="swing"                | <mimic joint="balance"     | `balance`; follows itself
        <mimic joint="swing"                | <mimic joint="none"        | `balance`; no joint of that name
        multiplier="-0.5"                   | multiplier="1e9"           | `balance`; "1e9", expected a finite number
        "#,
    );
}

/// All errors are reported at once, in the order of the file.
#[test]
fn every_error_is_reported_with_its_line() {
    let spoilt = SIX_JOINT
        .replacen("xyz=\"0 0 2\"", "xyz=\"0 0\"", 1)
        .replacen("radius=\"0.05\"", "radius=\"x\"", 1)
        .replacen("<child link=\"wrist\"/>", "<child link=\"none\"/>", 1)
        .replacen("joint=\"swing\"", "", 1);
    let message = refusal(&spoilt);
    let lines: Vec<&str> = message.lines().collect();
    assert_eq!(lines[0], "4 errors:");
    for (line, (mark, words)) in lines[1..].iter().zip([
        ("radius=\"x\"", "`radius` of `<sphere>` of the link `carriage` is \"x\""),
        ("xyz=\"0 0\"", "`xyz` of `<axis>` of the joint `lift` is \"0 0\""),
        ("<joint name=\"twist\"", "no link `none`, which the joint `twist` names"),
        ("<mimic", "`<mimic>` of the joint `balance` has no `joint`"),
    ]) {
        let number = spoilt[..spoilt.find(mark).unwrap()].matches('\n').count() + 1;
        assert!(line.starts_with(&format!("line {number}: ")) && line.contains(words), "{line}");
    }
}

/// Returns the error of converting a robot to MJCF with servos.
#[track_caller]
fn not_simulated(urdf: &str) -> String {
    let settings =
        MjcfSettings { servo: Some(JointServoSettings::default()), ..MjcfSettings::default() };
    let message = read(urdf).to_mjcf(&settings).unwrap_err().to_string();
    println!("{message}");
    message
}

/// Limits that a file lacks are missed where they are used.
#[test]
fn limits_are_needed_where_they_are_used() {
    for limit in
        ["", r#"<limit effort="inf" velocity="1e16"/>"#, r#"<limit effort="0" velocity="-1"/>"#]
    {
        let urdf = changed(r#"<limit effort="60" velocity="1.5"/>"#, limit);
        assert!(not_simulated(&urdf).contains("efforts of the joints turn: "));
        let chain = Chain::new(&read(&urdf), "tip").unwrap();
        let control = TwistController::new(chain, &[0.0; 6], TwistControlSettings::default());
        assert!(control.unwrap_err().to_string().contains("speeds of the joints turn: "));
        let settings = UrdfSettings { default_speed: Some(0.5), ..UrdfSettings::default() };
        let arm = Folder::new("limits").read_with(&urdf, &settings).unwrap();
        assert_eq!(motion_of(&arm, "turn").max_speed, Some(0.5));
        let note = "joint `turn` has no limit of velocity, so 0.5 is assumed";
        assert!(
            arm.import_notes().iter().any(|told| told.contains(note)),
            "{:?}",
            arm.import_notes()
        );
    }
    // a joint without ends may state any
    let endless = r#"<limit effort="60" velocity="1.5" lower="pi" upper=""/>"#;
    let arm = read(&changed(r#"<limit effort="60" velocity="1.5"/>"#, endless));
    assert_eq!(motion_of(&arm, "turn").range, None);
}

#[test]
fn default_limits_must_be_limits() {
    for value in [0.0, -1.0, 1e-308, 9.9e-7, 1e6, f64::NAN, f64::INFINITY] {
        for (default_speed, default_effort) in [(Some(value), None), (None, Some(value))] {
            let settings =
                UrdfSettings { default_speed, default_effort, ..UrdfSettings::default() };
            let error = Folder::new("defaults").read_with(SIX_JOINT, &settings).unwrap_err();
            assert!(error.to_string().contains("expected at least 1e-6 and below 1e6"), "{error}");
        }
    }
}

/// MuJoCo refuses the force range of such a servo.
#[test]
fn an_effort_that_rounds_to_zero_is_none() {
    let tiny = changed("effort=\"80\"", "effort=\"1e-308\"");
    let settings =
        MjcfSettings { servo: Some(JointServoSettings::default()), ..MjcfSettings::default() };
    let arm = read(&tiny);
    assert!(arm.import_notes().iter().any(|note| note.contains("too small to be used")));
    let error = arm.to_mjcf(&settings).unwrap_err();
    assert!(error.to_string().contains("servos need the efforts of the joints pan"), "{error}");
}

/// MuJoCo refuses the range of such a joint.
#[test]
fn ends_that_round_to_one_number_fix_a_joint() {
    let arm = read(&changed(r#"lower="-1.5" upper="2""#, r#"lower="0" upper="1e-308""#));
    assert_eq!(arm.num_dofs(), 5);
    assert!(arm.import_notes().iter().any(|note| note.contains("fixed at 0")));
}

/// A misspelt name would leave a default value in its place.
#[test]
fn names_that_are_not_read_are_notes() {
    let with = |joint: &str, shape: &str| {
        let urdf = format!(
            r#"<robot name="r"><link name="base"/><link name="arm"><collision name="c"><geometry>
            <box size="1 1 1"/></geometry>{shape}</collision></link><joint name="turn"
            type="continuous"><parent link="base"/><child link="arm"/><safety_controller/>
            <s:mark xmlns:s="urn:s"/>{joint}</joint></robot>"#
        );
        read(&urdf).import_notes().join("; ")
    };
    let silent = with(r#"<origin xyz="1 0 0"/><axis xyz="0 0 1"/>"#, "");
    assert!(!silent.contains("is not read"), "{silent}");
    let outside = |inside: &str| {
        let urdf = format!(r#"<robot name="r"><link name="a">{inside}</link>{inside}</robot>"#);
        read(&urdf).import_notes().join("; ")
    };
    assert_eq!(outside(r#"<gazebo/><s:mark xmlns:s="urn:s"/>"#), "");
    for (inside, places) in [
        ("<colision/>", "line 1: `<colision>` is not read; line 1: `<colision>` of the link `a`"),
        ("<group><link name='b'/></group>", "line 1: `<group>` is not read; line 1: `<group>` of"),
    ] {
        assert!(outside(inside).starts_with(places), "{}", outside(inside));
    }
    let foreign = outside(r#"<s:collision xmlns:s="urn:s"/>"#);
    assert!(foreign.contains("`<collision>` of the link `a` is not read"), "{foreign}");
    for (joint, shape, note) in [
        (r#"<axis xzy="0 0 1"/>"#, "", "`xzy` of `<axis>` of the joint `turn` is not read"),
        (r#"<origin rpw="0 0 1"/>"#, "", "`rpw` of `<origin>` of the joint `turn` is not read"),
        (r#"<orgin xyz="1 0 0"/>"#, "", "`<orgin>` of the joint `turn` is not read"),
        (r#"<mimick joint="turn"/>"#, "", "`<mimick>` of the joint `turn` is not read"),
        ("", r#"<orgin xyz="1 0 0"/>"#, "`<orgin>` of the link `arm` is not read"),
    ] {
        let notes = with(joint, shape);
        assert_eq!(notes.matches("is not read").count(), 1, "{notes}");
        assert!(notes.contains(note), "{notes}");
    }
}

/// A range that is reversed is a note, and an error where it is used.
#[test]
fn reversed_ranges_are_refused_where_they_are_used() {
    let urdf = changed(r#"lower="-3" upper="3""#, r#"lower=" 3" upper="-3""#);
    let arm = read(&urdf);
    assert_eq!(motion_of(&arm, "twist").range, Some([3.0, -3.0]));
    let line = urdf[..urdf.find("lower=\" 3\"").unwrap()].matches('\n').count() + 1;
    let note = "`lower` of `<limit>` of the joint `twist` is above `upper`: 3 to -3";
    assert_eq!(arm.import_notes(), [format!("line {line}: {note}")]);
    assert_eq!(arm.link_poses(&[0.1; 6]), read(SIX_JOINT).link_poses(&[0.1; 6]));
    assert_eq!(arm.rest_positions().len(), 6);
    let message = not_simulated(&urdf);
    assert!(message.contains("`twist`: its lower limit is 3, expected a position"), "{message}");
    let chain = Chain::new(&arm, "tip").unwrap();
    let [ik, control] = [
        chain.solve_ik(&Pose::IDENTITY, &[0.0; 6]).unwrap_err(),
        TwistController::new(chain, &[0.0; 6], TwistControlSettings::default()).unwrap_err(),
    ];
    for error in [ik, control] {
        assert!(error.to_string().contains("`twist` has the limits 3 to -3"), "{error}");
    }
    // a follower loses such a range
    let follower = read(&changed(r#"lower="-4" upper="4""#, r#"lower="4" upper="-4""#));
    assert_eq!(motion_of(&follower, "balance").range, None);
    assert_eq!(follower.import_notes().len(), 2, "{:?}", follower.import_notes());
}

#[track_caller]
fn motion_of(arm: &RobotDescription, joint: &str) -> JointMotionSpec {
    let joint = arm.joints().iter().find(|other| other.name == joint).unwrap();
    joint.motion.unwrap()
}

/// A joint whose range is one position is fixed there, and so is one that follows it.
#[test]
fn locked_joints_are_fixed() {
    let limits = r#"lower="-2.5" upper="2.5""#;
    let locked = changed(limits, r#"lower="0.4" upper="0.4""#);
    let [arm, whole] = [&locked, SIX_JOINT].map(read);
    assert_eq!((arm.num_dofs(), whole.num_dofs()), (5, 6));
    assert_eq!(arm.import_notes().len(), 2, "{:?}", arm.import_notes());
    let poses = whole.link_poses(&[0.1, 0.2, 0.3, 0.4, 0.5, 0.6]);
    for (still, moved) in arm.link_poses(&[0.1, 0.2, 0.3, 0.5, 0.6]).iter().zip(&poses) {
        assert!(still.position.distance(moved.position) < 1e-12, "{still:?} {moved:?}");
        assert!(still.rotation.dot(moved.rotation).abs() > 1.0 - 1e-12, "{still:?} {moved:?}");
    }
    // a range that ends on one side, or on none
    for (ends, range) in [
        (r#"lower="-2.5" upper="1e16""#, Some([-2.5, 1e6])),
        (r#"lower="-inf" upper="inf""#, None),
        (r#"lower="-1e7" upper="1e6""#, None),
    ] {
        let urdf = changed(limits, ends).replacen("multiplier=\"-0.5\"", "multiplier=\"0\"", 1);
        assert_eq!(motion_of(&read(&urdf), "swing").range, range);
    }
}

/// A joint that follows a follower follows the free joint, and a fixed one keeps it still.
#[test]
fn followers_are_followed_to_the_free_joint() {
    let mimic = r#"<mimic joint="balance" multiplier="3" offset="1"/>"#;
    let chain = changed(r#"<axis xyz="0 -1 0.5"/>"#, mimic);
    let arm = read(&chain.replacen(r#"lower="-2" upper="2""#, r#"lower="-9" upper="9""#, 1));
    let nod = motion_of(&arm, "nod");
    let JointPositionSource::Follows { dof: 3, multiplier, offset } = nod.drive else {
        panic!("{nod:?}");
    };
    assert!((multiplier + 1.5).abs() < 1e-12 && (offset - 1.6).abs() < 1e-12, "{nod:?}");
    let still = read(&changed("<mimic joint=\"swing\"", "<mimic joint=\"flange\""));
    assert!(still.import_notes()[0].contains("`balance`: it follows a joint that does not move"));
    assert_eq!(still.num_dofs(), 6);
}

/// A hinge without limits keeps its freedom if a follower hardly moves.
#[test]
fn endless_joints_that_hardly_move_their_followers_stay_endless() {
    for multiplier in ["1e-310", "-1e-9"] {
        let mimic = format!("<mimic joint=\"turn\" multiplier=\"{multiplier}\"");
        let arm = read(&changed("<mimic joint=\"swing\" multiplier=\"-0.5\"", &mimic));
        assert_eq!(motion_of(&arm, "turn").range, None);
        assert!(arm.range_restrictions().is_empty());
    }
}

/// A follower that is outside its own range wherever its leader is follows, and loses its range.
#[test]
fn followers_that_cannot_stay_within_their_ranges_lose_them() {
    let table = r#"
        lower="-4" upper="4"           | lower="2" upper="4"
        lower="-4" upper="4"           | lower="0" upper="0"
        multiplier="-0.5" offset="0.2" | multiplier="0" offset="5"
        "#;
    for [old, new] in rows(table) {
        let arm = read(&changed(old, new));
        assert_eq!(motion_of(&arm, "balance").range, None, "{new}");
        assert!(
            arm.range_restrictions().is_empty() && arm.import_notes().len() == 1,
            "{:?}",
            arm.import_notes()
        );
    }
    let arm = read(&changed("<mimic joint=\"swing\"", "<mimic joint=\"turn\""));
    let [low, high] = motion_of(&arm, "turn").range.unwrap();
    assert!((low + 7.6).abs() < 1e-12 && (high - 8.4).abs() < 1e-12, "{low} {high}");
}

#[test]
fn masses_must_be_those_of_bodies() {
    all_refused(
        r#"
        <mass value="0.5"/> | <mass value="-0.5"/> | link `wrist`; -0.5
        <mass value="0.5"/> | <mass value="nan"/>  | link `wrist`; nan
        <mass value="0.5"/> |                      | `<inertial>` of the link `wrist` has no `<mass>`
        izz="0.02"          | izz="inf"            | link `column`; inf
        izz="0.02"          |                      | `<inertia>` of the link `column` has no `izz`
        "#,
    );
    // old text, new text, words of the error of simulating it, note on a repair
    let table = r#"
        <mass value="0.5"/> | <mass value="0"/>    | `twist` moves the link `wrist`, which has no mass | `wrist`: no mass, so 0.001 kg
        <mass value="1"/>   | <mass value="0"/>    | `swing` moves the link `forearm`, which has no mass | 0.537 kg
        ixx="5e-4"          | ixx="11e-4"          | `wrist`; exceeds the sum; 0.0011 | 7.000e-4 kg m^2
        ixx="5e-4"          | ixx="-5e-4"          | `wrist`; below 1e-12 | 1.667e-4 kg m^2
        ixy="1e-4"          | ixy="1"              | `forearm`; below 1e-12 | 4.333e-3 kg m^2
        "#;
    for [old, new, words, note] in rows(table) {
        let urdf = changed(old, new);
        let message = not_simulated(&urdf);
        assert!(words.split("; ").all(|word| message.contains(word)), "{message}");
        let settings = UrdfSettings { repair: true, ..UrdfSettings::default() };
        let arm = Folder::new("masses").read_with(&urdf, &settings).unwrap();
        let start = arm.import_notes()[0].split_once(": `<inertial>` of the link ");
        assert!(
            start.is_some_and(|(line, _)| line.starts_with("line ")),
            "{:?}",
            arm.import_notes()
        );
        assert!(arm.import_notes()[0].contains(note), "{:?}", arm.import_notes());
        Model::from_xml(&arm.to_mjcf(&MjcfSettings::default()).unwrap().text).unwrap();
    }
}

/// A frame that moves needs only the mass of what is fixed to it, a base no possible inertia, and
/// a fixed joint no axis.
#[test]
fn frames_need_no_mass() {
    let link = |name: &str, mass: &str, ixx: &str| {
        let inertia = format!("<inertia ixx=\"{ixx}\" iyy=\"1e-3\" izz=\"1e-3\"/>");
        format!(
            "<link name=\"{name}\"><inertial><mass value=\"{mass}\"/>{inertia}</inertial></link>"
        )
    };
    let links = link("floor", "1", "9") + &link("tip", "1e-9", "9") + &link("gun", "0.7", "1e-3");
    let urdf = format!(
        r#"<robot>{links}<joint name="fix" type="fixed"><parent link="tip"/><child link="gun"/>
        <axis xyz="0 0 0"/></joint><joint name="spin" type="continuous"><parent link="floor"/>
        <child link="tip"/></joint></robot>"#
    );
    let arm = read(&urdf);
    // a repair leaves inertias alone that play no part
    let settings = UrdfSettings { repair: true, ..UrdfSettings::default() };
    let repaired = Folder::new("frames").read_with(&urdf, &settings).unwrap();
    assert_eq!((repaired.links(), repaired.import_notes()), (arm.links(), arm.import_notes()));
    let ignored =
        |name: &str| format!("line 1: `<inertial>` of the link `{name}`: ignored, because ");
    assert_eq!(
        arm.import_notes(),
        [
            ignored("floor")
                + "a principal inertia exceeds the sum of the others; the link does not \
                                move",
            ignored("tip") + "its mass is below a milligram",
        ]
    );
    let mjcf = arm.to_mjcf(&MjcfSettings::default()).unwrap().text;
    Model::from_xml(&mjcf).unwrap();
    let masses: Vec<&str> = mjcf.split(" mass=").skip(1).collect();
    assert!(masses.len() == 1 && masses[0].starts_with("\"0.7\""), "{mjcf}");
}

/// MuJoCo looks for the mass of a moving link in it and in links fixed to it directly. With a
/// milligram between, it finds a mass further out where it is, and the arm falls alike.
#[test]
fn a_mass_behind_a_frame_moves_as_where_it_is() {
    let arm = |flange: &str| {
        read(&format!(
            r#"<robot><link name="floor"/><link name="tip"/><link name="flange">{flange}</link>
            <link name="gun"><inertial><origin xyz="0.1 0.2 0.3" rpy="0.1 0.2 0.3"/>
            <mass value="0.7"/><inertia ixx="0.01" iyy="0.02" izz="0.025" ixy="1e-3" ixz="0"
            iyz="0"/></inertial></link>
            <joint name="spin" type="continuous"><parent link="floor"/><child link="tip"/>
            <axis xyz="0 1 0"/></joint>
            <joint name="fix" type="fixed"><origin xyz="0.3 0 0.1" rpy="0.4 1 -2"/>
            <parent link="tip"/><child link="flange"/></joint>
            <joint name="hold" type="fixed"><origin xyz="0 0.2 0" rpy="1 0.3 0.2"/>
            <parent link="flange"/><child link="gun"/></joint></robot>"#
        ))
    };
    let fall = |robot: &RobotDescription| {
        let mjcf = robot.to_mjcf(&MjcfSettings::default()).unwrap();
        let mut data = Data::new(Arc::new(Model::from_xml(&mjcf.text).unwrap()));
        data.step(200).unwrap();
        data.qpos()[0]
    };
    let inertia = r#"<inertia ixx="1e-9" iyy="1e-9" izz="1e-9" ixy="0" ixz="0" iyz="0"/>"#;
    let near = arm(&format!(r#"<inertial><mass value="1e-6"/>{inertia}</inertial>"#));
    let far = arm("");
    assert_eq!(near.import_notes(), &[] as &[String]);
    let [note] = far.import_notes() else { panic!("{:?}", far.import_notes()) };
    assert!(note.contains("of the link `gun`: simulated as part of the link `tip`"), "{note}");
    let (got, expected) = (fall(&far), fall(&near));
    assert!(expected.abs() > 0.5 && (got - expected).abs() < 1e-4, "{got} {expected}");
}

#[test]
fn shapes_must_be_primitive() {
    all_refused(
        r#"
        <sphere radius="0.05"/> | <sphere radius="-1"/>   | `radius` of `<sphere>` of the link `carriage` is "-1"; 1e-6
        <sphere radius="0.05"/> | <sphere/>               | line; `<sphere>` of the link `carriage` has no `radius`
        <sphere radius="0.05"/> | <box/>                  | line; `<box>` of the link `carriage` has no `size`
        <sphere radius="0.05"/> | <cylinder length="1"/>  | line; `<cylinder>` of the link `carriage` has no `radius`
        <sphere radius="0.05"/> | <capsule radius="1"/>   | line; `<capsule>` of the link `carriage` has no `length`
        <sphere radius="0.05"/> | <mesh filename="a.stl" scale="1 0 1"/> | `scale`; none of them zero
        <sphere radius="0.05"/> | <plane/>                | `<geometry>` of the link `carriage` has no `<sphere>`, `<box>`
        <sphere radius="0.05"/> | <mesh/>                 | `<mesh>` of the link `carriage` has no `filename`
        <sphere radius="0.05"/> | <mesh scale="1 1 1 a"/> | `scale`; three numbers; line
        size="0.1 0.12 0.3"     | size="0.1 -0.12 0.3"    | link `column`; -0.12
        size="0.1 0.12 0.3"     | size="0.1 x 0.12 0.3"   | `size`; three numbers; line
        "#,
    );
}

/// Shapes without size are missed where shapes are needed. A repair gives them a size.
#[test]
fn shapes_without_size_are_missed_or_repaired() {
    for (shape, place) in [
        ("<sphere radius=\"0\"/>", "`radius` of `<sphere>` of the link `carriage` is \"0\""),
        ("<box size=\"0 0 0\"/>", "`size` of `<box>` of the link `carriage` is \"0 0 0\""),
        ("<box size=\"1 1 1e-7\"/>", "`size` of `<box>` of the link `carriage` is \"1 1 1e-7\""),
        ("<cylinder radius=\"1\" length=\"0\"/>", "`length` of `<cylinder>`"),
    ] {
        let urdf = changed("<sphere radius=\"0.05\"/>", shape);
        let arm = read(&urdf);
        assert!(
            arm.links()[2].shapes.is_empty() && arm.import_notes().is_empty(),
            "{:?}",
            arm.import_notes()
        );
        let line = urdf[..urdf.find(shape).unwrap()].matches('\n').count() + 1;
        let start = format!("line {line}: {place}");
        assert!(
            arm.missing_shape_reasons()[0].starts_with(&start),
            "{:?}",
            arm.missing_shape_reasons()
        );
        let message = not_simulated(&urdf);
        assert!(message.contains(&start) && message.contains("`repair`"), "{message}");
        let settings = UrdfSettings { repair: true, ..UrdfSettings::default() };
        let repaired = Folder::new("sizes").read_with(&urdf, &settings).unwrap();
        assert!(repaired.import_notes()[0].starts_with(&start), "{:?}", repaired.import_notes());
        assert!(repaired.missing_shape_reasons().is_empty());
        assert_eq!(repaired.links()[2].shapes.len(), 1);
        Model::from_xml(&repaired.to_mjcf(&MjcfSettings::default()).unwrap().text).unwrap();
    }
}

/// Of elements that a link or joint has twice, the first one is read, with a note.
#[test]
fn elements_that_are_ignored_are_noted() {
    let twice = "<sphere radius=\"0.05\"/><box size=\"1 1 1\"/>";
    let arm = read(&changed("<sphere radius=\"0.05\"/>", twice));
    assert_eq!(arm.links()[2].shapes[0].shape, Shape::Sphere { radius: 0.05 });
    assert!(arm.import_notes()[0].contains("`<box>` of the link `carriage` is ignored"));
    let axis =
        read(&changed("<axis xyz=\"0 0 2\"/>", "<axis xyz=\"0 0 2\"/><axis xyz=\"1 0 0\"/>"));
    assert!(axis.import_notes()[0].contains("`<axis>` of the joint `lift` is ignored"));
    assert_eq!(axis.joints(), read(SIX_JOINT).joints());
}

/// Entities inside entities would expand to gigabytes.
#[test]
fn entities_are_refused() {
    let entities: String = (1..20)
        .map(|level| format!("<!ENTITY e{level} \"{}\">\n", format!("&e{};", level - 1).repeat(9)))
        .collect();
    let bomb = format!(
        "<!DOCTYPE robot [\n<!ENTITY e0 \"0\">\n{entities}]>\n<robot name=\"&e19;\">\
         <link name=\"a\"/></robot>"
    );
    for text in [bomb, format!("<!DOCTYPE r [\n<!ENTITY % e \"1\">]>\n{SIX_JOINT}")] {
        assert!(refusal(&text).contains("line 2: `<!ENTITY` declares an entity"));
    }
    let without = ["<!DOCTYPE robot>", "<!DOCTYPE robot SYSTEM \"urdf.dtd\" [<!ELEMENT a ANY>]>"];
    for head in without.into_iter().chain(["<!-- <!ENTITY a \"b\"> -->"]) {
        assert_eq!(read(&format!("{head}\n{SIX_JOINT}")).links(), read(SIX_JOINT).links());
    }
}

/// Texts of all kinds, such as 50 000 nested elements that a careless parser takes for comments.
#[test]
fn what_is_no_urdf_is_refused() {
    let (open, close) = ("<a>".repeat(50_000), "</a>".repeat(50_000));
    let short = ["", "no", "<robot", "<model/>", "<robot name=\"a\"/>", "\0\u{feff}"];
    let deep = [
        format!("<robot>{open}{close}</robot>"),
        format!("<?p '?>{open}<?p '?>{close}"),
        format!("<robot><?p '?>{open}<?p '?>{close}</robot>"),
        format!("<robot>{}</robot>", format!("{open}<!-->{close}-->").repeat(2)),
        format!("<robot>{open}<!-->{close}--></robot>"),
        format!("<robot><a\">{open}<a\">{close}</robot>"),
    ];
    for text in short.into_iter().chain(deep.iter().map(|text| &text[..])) {
        let message = refusal(text);
        assert!(message.contains("cannot be parsed") || message.contains("0 links"), "{message}");
    }
    let broken = "<|<a|< a/>|<a/ >|<a b/>|<a b=1/>|<a b='1\"/>|<a=\"1\"/>|</a>|<a></b>|<a:b:c/>|<!-- |\
                  <a: b='1'/>|<a></a b='1'>|<a></a/>|<a<!-- -->b/>|<link name='a<!--x-->b'/>|\
                  <a <!-- x --> b='1'/>";
    for inside in broken.split('|') {
        assert!(refusal(&format!("<robot>{inside}</robot>")).contains("cannot be parsed"));
    }
    let long = format!("{SIX_JOINT}{}", " ".repeat(MAX_URDF_BYTES));
    assert!(refusal(&long).contains("more than 2097152 bytes"));
}

/// Some parsers panic on each of these.
#[test]
fn xml_that_no_urdf_needs_is_refused_or_skipped() {
    let brackets = "]".repeat(256);
    for (text, word) in [
        (r#"<robot name="a" xmlns:xmlns="foo"/>"#, "0 links"),
        (r#"<robot xmlns="foo" :a="b"/>"#, "0 links"),
        (&format!("<robot><![CDATA[{brackets}]]></robot>"), "0 links"),
        ("<!DOCTYPE robot><robot/>", "0 links"),
        ("<robot><a:b c:d='1'/></robot>", "0 links"),
        ("<robot><?p ?></robot>", "0 links"),
        ("<robot>\n<a b=\"<\"/></robot>", "at 2:7); correct the tag"),
        ("<robot>\n<<<<<<< HEAD\n</robot>", "unresolved conflicts of Git"),
        ("<robot><xacro:arm/></robot>", "line 1: `<xacro:arm>` is xacro"),
    ] {
        let message = refusal(text);
        assert!(message.contains(word), "{word:?} is not in: {message}");
    }
}

#[test]
fn namespaces_and_attributes_are_few() {
    let urdf = |count: usize, elements: usize| {
        let spaces: String = (0..count).map(|i| format!(" xmlns:a{i}='{i}'")).collect();
        let many = "<a/>".repeat(elements);
        format!("<robot{spaces}><link name='l'/><material name='m'>{many}</material></robot>")
    };
    read(&urdf(32, 10));
    assert!(refusal(&urdf(1000, 10_000)).contains("32 namespaces"));
    let attributes: String = (0..1001).map(|i| format!(" a{i}='{i}'")).collect();
    assert!(refusal(&format!("<robot{attributes}/>")).contains("1000 attributes"));
    let elements = refusal(&format!("<robot>{}</robot>", "<a/>".repeat(1 << 18)));
    assert!(elements.contains("more than 262144 elements, texts"), "{elements}");
}

#[test]
fn a_file_holds_one_robot_and_nothing_else() {
    let model = SIX_JOINT.replace("<robot ", "<model ").replace("</robot>", "</model>");
    let second = format!("{SIX_JOINT}<robot name=\"b\"/>");
    let [more, end] = ["and more", "</robot>"].map(|after| format!("{SIX_JOINT}{after}"));
    for text in [model, second, more, end, changed("<robot", "so <robot")] {
        assert!(refusal(&text).contains("`<robot>`"));
    }
    read(&format!("\u{feff}{SIX_JOINT}\n<!-- the end -->\n"));
}

/// A robot that is read from a template lacks all that xacro would have added.
#[test]
fn templates_that_were_not_expanded_are_refused() {
    let declared = changed("<robot ", "<robot xmlns:xacro=\"http://ros.org/xacro\" ");
    assert_eq!(read(&declared), read(SIX_JOINT));
    // old text of the file, new text, and the text that the message quotes
    let cases = r#"
        </robot>           | <xacro:hand parent="tip"/>\n</robot>                             | `<xacro:hand>`
        </robot>           | <xacro:if value="1">\n<link name="c"/></xacro:if></robot>        | `<xacro:if>`
        </robot>           | <x:hand xmlns:x="http://www.ros.org/wiki/xacro"/></robot>        | `<x:hand>`
        </robot>           | <hand xmlns="http://www.ros.org/wiki/xacro"/></robot>            | `<hand>`
        </robot>           | <include filename="hand.xacro"/></robot>                         | `<include>`
        </robot>           | <macro name="hand"/></robot>                                     | `<macro>`
        </robot>           | <if value="1"><link name="c"/></if></robot>                      | `<if>`
        </robot>           | <unless value="1"><link name="c"/></unless></robot>              | `<unless>`
        </robot>           | <!--\n-->\n<xacro:hand\n  parent="tip"\n/>\n</robot>            | `<xacro:hand>`
        xyz="0 0 2"        | xyz="0 0 ${2 * L}"                                               | `xyz` of `<axis>`, "0 0 ${2 * L}"
        <link name="tip"/> | <link name="$(arg tip)"/>                                        | `name` of `<link>`
        <link name="tip"/> | <link name="tip" xacro:off="1"/>                                 | `xacro:off` of `<link>`
        "#;
    for [old, new, found] in rows(cases) {
        let new = new.replace("\\n", "\n");
        let whole = declared.replacen(old, &new, 1);
        assert_ne!(whole, declared, "{old}");
        let message = refusal(&whole);
        // of the tag, not of the comment before it
        let at = whole.find(&new).unwrap() + new.find("<xacro:hand\n").unwrap_or(0);
        let line = whole[..at].matches('\n').count() + 1;
        assert!(message.starts_with(&format!("line {line}: {found}")), "{line} {found}: {message}");
        assert!(message.contains("run `xacro FILE > arm.urdf`"), "{message}");
    }
    // of a long value, what would have been expanded
    let long = format!("xyz=\"{} 0 ${{2 * L}}\"", "0".repeat(90));
    let long = refusal(&changed("xyz=\"0 0 2\"", &long));
    assert!(long.contains("`xyz` of `<axis>`, \"${2 * L}\""), "{long}");
    // a namespace of another tool, whose address only names xacro
    let other = "<x:note xmlns:x=\"http://example.org/xacro-editor\"/></robot>";
    read(&changed("</robot>", other));
    let constant = read(&changed("</robot>", "<xacro:property name=\"w\" value=\"1\"/></robot>"));
    let notes = constant.import_notes().join("; ");
    assert!(notes.contains("`<xacro:property>` is xacro; nothing that is read"), "{notes}");
    // nothing but templates, whose robot would have no links
    let all = "<robot xmlns:xacro=\"http://ros.org/xacro\"><xacro:arm prefix=\"\"/></robot>";
    assert!(refusal(all).starts_with("line 1: `<xacro:arm>` is xacro"));
}

#[test]
fn links_have_a_thousand_shapes_at_most() {
    let sphere = "<collision><geometry><sphere radius=\"1\"/></geometry></collision>";
    let link = |count| format!("<robot><link name=\"l\">{}</link></robot>", sphere.repeat(count));
    read(&link(1000));
    assert_eq!(refusal(&link(1001)), "the link `l` has 1001 collision shapes, expected 0 to 1000");
}

#[test]
fn files_that_cannot_be_read_are_named() {
    // one that is not there, and one that never ends
    for (path, words) in [("/none/arm.urdf", "/none/arm.urdf"), ("/dev/zero", "more than 2097152")]
    {
        let error = RobotDescription::from_urdf_file(Path::new(path)).unwrap_err();
        assert!(error.to_string().contains(words), "{error}");
    }
    let arm = RobotDescription::from_urdf_file(Path::new("assets/urdf/six_joint.urdf")).unwrap();
    assert_eq!((arm.name(), arm.num_dofs(), arm.links().len()), ("six_joint", 6, 9));
}
