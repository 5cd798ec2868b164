//! Invalid files: each causes a clear error.

use std::fs;
use std::path::{Path, PathBuf};

use mujoco::Model;
use robots::{
    CartesianControl, Chain, ControlSettings, Description, DescriptionError, Drive, MAX_BYTES,
    MjcfSettings, Servo, Shape, UrdfSettings,
};

use crate::SIX_JOINT;

/// The message about the six-jointed arm with `old` replaced by `new`.
fn refusal(old: &str, new: &str) -> String {
    assert!(SIX_JOINT.contains(old), "{old}");
    let changed = SIX_JOINT.replacen(old, new, 1);
    let message = Description::from_urdf(&changed).unwrap_err().to_string();
    println!("{message}");
    message
}

#[track_caller]
fn refused(old: &str, new: &str, words: &[&str]) {
    let message = refusal(old, new);
    for word in words {
        assert!(message.contains(word), "{word:?} is not in: {message}");
    }
}

/// Lines of old text, new text and words of the message, separated by `|`.
#[track_caller]
fn all_refused(lines: &str) {
    for line in lines.trim().lines() {
        let columns: Vec<&str> = line.split('|').map(str::trim).collect();
        let [old, new, words] = columns[..] else {
            panic!("{line}");
        };
        refused(old, new, &words.split("; ").collect::<Vec<_>>());
    }
}

#[test]
fn trees_that_are_none_are_refused() {
    let (forearm, wrist) = ("<parent link=\"forearm\"/>", "<parent link=\"wrist\"/>");
    refused(forearm, wrist, &["`wrist`", "hangs on itself"]);
    refused("<parent link=\"world\"/>", "<parent link=\"column\"/>", &["hangs on itself"]);
    refused(forearm, "<parent link=\"arm\"/>", &["`arm`", "joint `twist`", "carriage"]);
    all_refused(
        r#"
        <child link="wrist"/> | <child link="forearm"/>                | `forearm`; `swing`; `twist`
        <link name="tip"/>    | <link name="tip"/><link name="spare"/> | world, spare; one root
        "#,
    );
    let alone = Description::from_urdf("<robot name=\"none\"></robot>").unwrap_err();
    assert!(matches!(alone, DescriptionError::Count { count: 0, .. }), "{alone}");
    let links: String = (0..=robots::MAX_LINKS).map(|i| format!("<link name=\"{i}\"/>")).collect();
    let many = Description::from_urdf(&format!("<robot name=\"many\">{links}</robot>"));
    assert!(matches!(many, Err(DescriptionError::Count { count: 1001, .. })));
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
    refused(
        "<link name=\"tip\"/>",
        &format!("<link name=\"{}\"/>", "x".repeat(201)),
        &["200 bytes"],
    );
    // MuJoCo's own name, for a link with shapes and for a frame that hangs on another link
    for taken in ["\"column\"", "\"tip\""] {
        let urdf = SIX_JOINT.replace("\"world\"", "\"ground\"").replace(taken, "\"world\"");
        let message = not_simulated(&urdf);
        assert!(message.contains("simulated world"), "{message}");
    }
}

#[test]
fn joints_must_be_possible() {
    all_refused(
        r#"
        name="twist" type="revolute"        | name="twist" type="floating" | `twist` is "floating"; continuous
        name="twist" type="revolute"        | name="twist"               | joint `twist` has no `type`
        lower="-3" upper="3"                | lower="3" upper="-3"       | `twist` is "3"; not above `upper`
        upper="0.3"                         | upper="nan"                | `upper` of `<limit>` of the joint `lift`; a number
        lower="-3" upper="3"                | lower="-3,1" upper="3"     | `twist` is "-3,1"; a number
        damping="20"                        | damping="-20"              | joint `lift`; -20
        xyz="0 0 2"                         | xyz="0 0 0"                | `<axis>` of the joint `lift`; direction
        rpy="0 0.4 0"                       | rpy="0 nan 0"              | joint `swing`; rpy
        <parent link="forearm"/>            |                            | the joint `twist` has no `<parent>`
        "#,
    );
    let limit = "<limit lower=\"-3\" upper=\"3\" effort=\"20\" velocity=\"2\"/>";
    refused(limit, "", &["the joint `twist` has no `<limit>`", "continuous"]);
}

/// All errors are reported at once, in the order of the file.
#[test]
fn every_error_is_reported_with_its_line() {
    let spoilt = SIX_JOINT
        .replacen("xyz=\"0 0 2\"", "xyz=\"0 0\"", 1)
        .replacen("radius=\"0.05\"", "radius=\"x\"", 1)
        .replacen("<child link=\"wrist\"/>", "<child link=\"none\"/>", 1)
        .replacen("joint=\"swing\"", "", 1);
    let message = Description::from_urdf(&spoilt).unwrap_err().to_string();
    println!("{message}");
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
    let settings = MjcfSettings { servo: Some(Servo::default()), ..MjcfSettings::default() };
    let arm = Description::from_urdf(urdf).unwrap();
    let message = arm.to_mjcf(&settings).unwrap_err().to_string();
    println!("{message}");
    message
}

/// Limits that a file lacks are missed where they are used.
#[test]
fn limits_are_needed_where_they_are_used() {
    let folder = Folder::new("limits");
    for limit in
        ["", "<limit effort=\"inf\" velocity=\"1e16\"/>", "<limit effort=\"0\" velocity=\"-1\"/>"]
    {
        let urdf = SIX_JOINT.replacen("<limit effort=\"60\" velocity=\"1.5\"/>", limit, 1);
        assert!(not_simulated(&urdf).contains("efforts of the joints turn, "));
        let chain = Chain::new(&Description::from_urdf(&urdf).unwrap(), "tip").unwrap();
        let control = CartesianControl::new(chain, &[0.0; 6], ControlSettings::default());
        let message = control.unwrap_err().to_string();
        assert!(message.contains("speeds of the joints turn, "), "{message}");
        let mut settings = UrdfSettings::forgiving();
        let arm = folder.read_with(&urdf, &settings).unwrap();
        let (_, turn) = arm.free_joints().find(|(joint, _)| joint.name == "turn").unwrap();
        assert_eq!((turn.speed, turn.effort), (Some(0.5), Some(50.0)));
        let [speed, _] = arm.notes() else { panic!("{:?}", arm.notes()) };
        assert!(speed.contains("joint `turn`: it has no limit of velocity, so 0.5"), "{speed}");
        settings.speed = Some(0.0);
        let message = folder.read_with(&urdf, &settings).unwrap_err().to_string();
        assert!(message.contains("the speed is 0, expected a positive number"), "{message}");
    }
}

/// A joint whose range is one position is fixed there, and so is one that follows it.
#[test]
fn locked_joints_are_fixed() {
    let locked =
        SIX_JOINT.replacen("lower=\"-2.5\" upper=\"2.5\"", "lower=\"0.4\" upper=\"0.4\"", 1);
    let [arm, whole] = [&locked, SIX_JOINT].map(|urdf| Description::from_urdf(urdf).unwrap());
    assert_eq!((arm.dofs(), whole.dofs()), (5, 6));
    assert_eq!(arm.notes().len(), 2, "{:?}", arm.notes());
    let still = arm.poses(&[0.1, 0.2, 0.3, 0.5, 0.6]);
    let moved = whole.poses(&[0.1, 0.2, 0.3, 0.4, 0.5, 0.6]);
    for (still, moved) in still.iter().zip(&moved) {
        assert!(still.position.distance(moved.position) < 1e-12, "{still:?} {moved:?}");
        assert!(still.rotation.dot(moved.rotation).abs() > 1.0 - 1e-12, "{still:?} {moved:?}");
    }
    // a range that ends on one side, or on none
    for (lower, upper, range) in
        [("-2.5", "1e16", Some([-2.5, 1e6])), ("-inf", "inf", None), ("-1e7", "1e6", None)]
    {
        let limits = format!("lower=\"{lower}\" upper=\"{upper}\"");
        let urdf = SIX_JOINT.replacen("lower=\"-2.5\" upper=\"2.5\"", &limits, 1);
        let urdf = urdf.replacen("multiplier=\"-0.5\"", "multiplier=\"0\"", 1);
        let arm = Description::from_urdf(&urdf).unwrap();
        let (_, swing) = arm.free_joints().find(|(joint, _)| joint.name == "swing").unwrap();
        assert_eq!(swing.range, range);
    }
}

#[test]
fn followers_must_follow_another_joint() {
    for (old, new, words) in [
        ("<mimic joint=\"swing\"", "<mimic joint=\"balance\"", "follows itself"),
        ("<mimic joint=\"swing\"", "<mimic joint=\"none\"", "no joint of that name"),
        ("multiplier=\"-0.5\"", "multiplier=\"1e9\"", "\"1e9\", expected a finite number"),
    ] {
        refused(old, new, &["`balance`", words]);
    }
}

/// A joint that follows a follower follows the free joint, and a fixed one keeps it still.
#[test]
fn followers_are_followed_to_the_free_joint() {
    let chain = SIX_JOINT.replacen(
        "<axis xyz=\"0 -1 0.5\"/>",
        "<mimic joint=\"balance\" multiplier=\"3\" offset=\"1\"/>",
        1,
    );
    let arm = Description::from_urdf(&chain.replacen(
        "lower=\"-2\" upper=\"2\"",
        "lower=\"-9\" upper=\"9\"",
        1,
    ))
    .unwrap();
    let nod = arm.joints().iter().find(|joint| joint.name == "nod").unwrap();
    let Some(Drive::Follows { dof: 3, multiplier, offset }) = nod.motion.map(|nod| nod.drive)
    else {
        panic!("{nod:?}");
    };
    assert!((multiplier + 1.5).abs() < 1e-12 && (offset - 1.6).abs() < 1e-12, "{nod:?}");
    let fixed = SIX_JOINT.replacen("<mimic joint=\"swing\"", "<mimic joint=\"flange\"", 1);
    let arm = Description::from_urdf(&fixed).unwrap();
    assert!(arm.notes()[0].contains("`balance`: it follows a joint that does not move"));
    assert_eq!(arm.dofs(), 6);
}

/// A hinge without limits keeps its freedom if a follower hardly moves.
#[test]
fn endless_joints_that_hardly_move_their_followers_stay_endless() {
    for multiplier in ["1e-310", "-1e-9"] {
        let mimic = format!("<mimic joint=\"turn\" multiplier=\"{multiplier}\"");
        let urdf = SIX_JOINT.replacen("<mimic joint=\"swing\" multiplier=\"-0.5\"", &mimic, 1);
        assert_ne!(urdf, SIX_JOINT);
        let arm = Description::from_urdf(&urdf).unwrap();
        let turn = arm.free_joints().find(|(joint, _)| joint.name == "turn");
        assert_eq!(turn.unwrap().1.range, None);
        assert!(arm.restrictions().is_empty());
    }
}

/// A follower that is outside its own range wherever its leader is follows, and loses its range.
#[test]
fn followers_that_cannot_stay_within_their_ranges_lose_them() {
    for (old, new) in [
        ("lower=\"-4\" upper=\"4\"", "lower=\"2\" upper=\"4\""),
        ("lower=\"-4\" upper=\"4\"", "lower=\"0\" upper=\"0\""),
        ("multiplier=\"-0.5\" offset=\"0.2\"", "multiplier=\"0\" offset=\"5\""),
    ] {
        let arm = Description::from_urdf(&SIX_JOINT.replacen(old, new, 1)).unwrap();
        let balance = arm.joints().iter().find(|joint| joint.name == "balance");
        assert_eq!(balance.unwrap().motion.unwrap().range, None, "{new}");
        assert!(arm.restrictions().is_empty() && arm.notes().len() == 1, "{:?}", arm.notes());
    }
    let endless = SIX_JOINT.replacen("<mimic joint=\"swing\"", "<mimic joint=\"turn\"", 1);
    let arm = Description::from_urdf(&endless).unwrap();
    let (_, turn) = arm.free_joints().find(|(joint, _)| joint.name == "turn").unwrap();
    let [low, high] = turn.range.unwrap();
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
        "#,
    );
    // old text, new text, words of the error of simulating it, note on a repair
    for line in r#"
        <mass value="0.5"/> | <mass value="0"/>    | `twist` moves the link `wrist`, which has no mass | 0.001 kg
        <mass value="1"/>   | <mass value="0"/>    | `swing` moves the link `forearm`, which has no mass | 0.540 kg
        ixx="5e-4"          | ixx="11e-4"          | `wrist`; exceeds the sum; 0.0011 | 7.000e-4 kg m^2
        ixx="5e-4"          | ixx="-5e-4"          | `wrist`; below 1e-12 | 1.667e-4 kg m^2
        ixy="1e-4"          | ixy="1"              | `forearm`; below 1e-12 | 4.333e-3 kg m^2
        "#
    .trim()
    .lines()
    {
        let columns: Vec<&str> = line.split('|').map(str::trim).collect();
        let urdf = SIX_JOINT.replacen(columns[0], columns[1], 1);
        assert_ne!(urdf, SIX_JOINT, "{line}");
        let message = not_simulated(&urdf);
        assert!(columns[2].split("; ").all(|word| message.contains(word)), "{message}");
        let settings = UrdfSettings { repair: true, ..UrdfSettings::default() };
        let arm = Folder::new("masses").read_with(&urdf, &settings).unwrap();
        assert!(arm.notes()[0].contains(columns[3]), "{:?}", arm.notes());
        Model::from_xml(&arm.to_mjcf(&MjcfSettings::default()).unwrap().text).unwrap();
    }
}

/// A frame that moves has the mass of what is fixed to it, and a base needs no possible inertia.
#[test]
fn links_that_are_fixed_to_each_other_are_one_body() {
    let hand = SIX_JOINT.replacen("<link name=\"tip\"/>", r#"<link name="tip"><inertial><origin xyz="0.1 0 0"/>
        <mass value="1e-9"/><inertia ixx="1e-6" iyy="1e-12" izz="1e-12" ixy="1e-6" ixz="0" iyz="0"/></inertial></link>
        <link name="nest"/><link name="gun"><inertial><mass value="0.7"/>
        <inertia ixx="1e-3" iyy="1e-3" izz="1e-3" ixy="0" ixz="0" iyz="0"/></inertial></link>
        <joint name="fix" type="fixed"><parent link="nest"/><child link="gun"/><origin xyz="0 0 1"/></joint>
        <joint name="spin" type="continuous"><parent link="tip"/><child link="nest"/></joint>"#, 1);
    let urdf = hand.replacen(
        "<link name=\"world\"/>",
        r#"<link name="world"/><link name="floor"><inertial><mass value="1"/>
        <inertia ixx="1" iyy="0" izz="0" ixy="0" ixz="0" iyz="0"/></inertial></link>
        <joint name="lie" type="fixed"><parent link="world"/><child link="floor"/></joint>"#,
        1,
    );
    let arm = Description::from_urdf(&urdf).unwrap();
    let mjcf = arm.to_mjcf(&MjcfSettings::default()).unwrap().text;
    Model::from_xml(&mjcf).unwrap();
    for (link, mass) in
        [("nest", Some(0.7)), ("gun", None), ("hand &amp; tool", Some(0.4 + 1e-9)), ("floor", None)]
    {
        let body = mjcf.split("<body ").find(|body| body.starts_with(&format!("name=\"{link}\"")));
        let stated =
            body.unwrap().split_once(" mass=\"").filter(|(before, _)| !before.contains("<geom"));
        let stated =
            stated.map(|(_, mass)| mass.split('"').next().unwrap().parse::<f64>().unwrap());
        assert_eq!(stated, mass, "{link}");
    }
}

#[test]
fn shapes_must_be_primitive() {
    let sphere = "<sphere radius=\"0.05\"/>";
    refused(
        sphere,
        "<sphere radius=\"-1\"/>",
        &["link `carriage`", "\"-1\"", "zero or more metres"],
    );
    refused("size=\"0.1 0.12 0.3\"", "size=\"0.1 -0.12 0.3\"", &["link `column`", "-0.12"]);
    refused(sphere, "<plane/>", &["`<geometry>` of the link `carriage` has no box"]);
    refused(sphere, "<mesh/>", &["`<mesh>` of the link `carriage` has no `filename`"]);
}

/// Shapes without size are left out, and flat ones stay.
#[test]
fn shapes_without_size_are_left_out() {
    for (shape, shapes) in
        [("<sphere radius=\"0\"/>", 0), ("<box size=\"0 0 0\"/>", 0), ("<box size=\"1 1 0\"/>", 1)]
    {
        let arm =
            Description::from_urdf(&SIX_JOINT.replacen("<sphere radius=\"0.05\"/>", shape, 1));
        let arm = arm.unwrap();
        assert_eq!((arm.links()[2].shapes.len(), arm.notes().len()), (shapes, 1 - shapes));
        arm.to_mjcf(&MjcfSettings::default()).unwrap();
    }
}

#[test]
fn what_is_no_urdf_is_refused() {
    for text in ["", "no", "<robot", "<model/>", "<robot name=\"a\"/>", "\0\u{feff}"] {
        let error = Description::from_urdf(text).unwrap_err();
        let known =
            matches!(error, DescriptionError::Syntax { .. } | DescriptionError::Count { .. });
        assert!(known, "{text:?}: {error}");
    }
    let long = format!("{SIX_JOINT}{}", " ".repeat(MAX_BYTES));
    assert!(matches!(Description::from_urdf(&long), Err(DescriptionError::TooLong { .. })));
}

/// Elements 50 000 deep, some of which a careless parser takes for comments and instructions.
#[test]
fn depth_is_harmless() {
    let (open, close) = ("<a>".repeat(50_000), "</a>".repeat(50_000));
    for text in [
        format!("<robot>{open}{close}</robot>"),
        format!("<?p '?>{open}<?p '?>{close}"),
        format!("<robot><?p '?>{open}<?p '?>{close}</robot>"),
        format!("<robot>{}</robot>", format!("{open}<!-->{close}-->").repeat(2)),
        format!("<robot>{open}<!-->{close}--></robot>"),
        format!("<robot><a\">{open}<a\">{close}</robot>"),
    ] {
        let error = Description::from_urdf(&text).unwrap_err();
        let known =
            matches!(error, DescriptionError::Syntax { .. } | DescriptionError::Count { .. });
        assert!(known, "{error}");
    }
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
        ("<robot>\n<a b=\"<\"/></robot>", "at 2:7"),
        ("<robot><xacro:arm/></robot>", "the prefix `xacro` is xacro"),
    ] {
        let message = Description::from_urdf(text).unwrap_err().to_string();
        println!("{message}");
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
    Description::from_urdf(&urdf(32, 10)).unwrap();
    let message = Description::from_urdf(&urdf(1000, 10_000)).unwrap_err().to_string();
    assert!(message.contains("32 namespaces"), "{message}");
    let attributes: String = (0..1001).map(|i| format!(" a{i}='{i}'")).collect();
    let message = Description::from_urdf(&format!("<robot{attributes}/>")).unwrap_err();
    assert!(message.to_string().contains("1000 attributes"), "{message}");
}

#[test]
fn a_file_holds_one_robot_and_nothing_else() {
    let second = "<robot name=\"b\"/>";
    for text in [
        SIX_JOINT.replace("<robot ", "<model ").replace("</robot>", "</model>"),
        format!("{SIX_JOINT}{second}"),
        format!("{SIX_JOINT} and more"),
        SIX_JOINT.replacen("<robot", "so <robot", 1),
        format!("{SIX_JOINT}</robot>"),
    ] {
        let message = Description::from_urdf(&text).unwrap_err().to_string();
        assert!(message.contains("`<robot>`"), "{message}");
    }
    let framed = format!("\u{feff}{SIX_JOINT}\n<!-- the end -->\n");
    Description::from_urdf(&framed).unwrap();
}

/// A robot that is read from a template lacks all that xacro would have added.
#[test]
fn templates_that_were_not_expanded_are_refused() {
    let declared = SIX_JOINT.replacen("<robot ", "<robot xmlns:xacro=\"http://ros.org/xacro\" ", 1);
    let arm = Description::from_urdf(&declared).unwrap();
    assert_eq!(arm, Description::from_urdf(SIX_JOINT).unwrap());
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
    for case in cases.trim().lines() {
        let columns: Vec<&str> = case.split('|').map(str::trim).collect();
        let [old, new, found] = columns[..] else {
            panic!("{case}");
        };
        let new = new.replace("\\n", "\n");
        let whole = declared.replacen(old, &new, 1);
        assert_ne!(whole, declared, "{old}");
        let message = Description::from_urdf(&whole).unwrap_err().to_string();
        // of the tag, not of the comment before it
        let at = whole.find(&new).unwrap() + new.find("<xacro:hand\n").unwrap_or(0);
        let line = whole[..at].matches('\n').count() + 1;
        let expected = format!("line {line}: {found}");
        assert!(message.starts_with(&expected), "{expected}: {message}");
        assert!(message.contains("run `xacro FILE > arm.urdf`"), "{message}");
    }
    // of a long value, what would have been expanded
    let long = format!("xyz=\"{} 0 ${{2 * L}}\"", "0".repeat(90));
    refused("xyz=\"0 0 2\"", &long, &["`xyz` of `<axis>`, \"${2 * L}\""]);
    // a namespace of another tool, whose address only names xacro
    let other = "<x:note xmlns:x=\"http://example.org/xacro-editor\"/></robot>";
    Description::from_urdf(&SIX_JOINT.replacen("</robot>", other, 1)).unwrap();
    // nothing but templates, whose robot would have no links
    let all =
        "<robot name=\"r\" xmlns:xacro=\"http://ros.org/xacro\"><xacro:arm prefix=\"\"/></robot>";
    let error = Description::from_urdf(all).unwrap_err();
    assert!(matches!(error, DescriptionError::Xacro { line: 1, .. }), "{error}");
}

#[test]
fn vectors_hold_three_numbers_and_nothing_else() {
    for (old, new, name) in [
        ("xyz=\"0 0 2\"", "xyz=\"0 oops 0 2\"", "`xyz`"),
        ("xyz=\"0 0 2\"", "xyz=\"0 0\"", "`xyz`"),
        ("rpy=\"0 0.4 0\"", "rpy=\"0 0.4, 0 0\"", "`rpy`"),
        ("size=\"0.1 0.12 0.3\"", "size=\"0.1 x 0.12 0.3\"", "`size`"),
        ("<sphere radius=\"0.05\"/>", "<mesh scale=\"1 1 1 a\" filename=\"a.stl\"/>", "`scale`"),
    ] {
        refused(old, new, &[name, "three numbers", "line "]);
    }
    refused("rpy=\"0 0.4 0\"", "quat_xyzw=\"0 0 0 1\"", &["quat_xyzw", "rpy"]);
}

#[test]
fn links_have_a_thousand_shapes_at_most() {
    let sphere = "<collision><geometry><sphere radius=\"1\"/></geometry></collision>";
    let link = |count| format!("<robot><link name=\"l\">{}</link></robot>", sphere.repeat(count));
    assert!(Description::from_urdf(&link(1000)).is_ok());
    let message = Description::from_urdf(&link(1001)).unwrap_err().to_string();
    assert_eq!(message, "the link `l` has 1001 collision shapes, expected 0 to 1000");
}

#[test]
fn files_that_cannot_be_read_are_named() {
    let missing = Description::read(Path::new("/none/arm.urdf")).unwrap_err().to_string();
    assert!(missing.contains("/none/arm.urdf"), "{missing}");
    // it never ends
    let endless = Description::read(Path::new("/dev/zero")).unwrap_err();
    assert!(matches!(endless, DescriptionError::TooLong { .. }), "{endless}");
    let arm = Description::read(Path::new("assets/urdf/six_joint.urdf")).unwrap();
    assert_eq!((arm.name(), arm.dofs(), arm.links().len()), ("six_joint", 6, 9));
}

/// Temporary folder that is removed when the test ends.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let folder = std::env::temp_dir().join(format!("covers-{name}-{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        Self(folder.canonicalize().unwrap())
    }

    fn write(&self, file: &str, text: &[u8]) {
        let path = self.0.join(file);
        fs::create_dir_all(path.parent().unwrap()).unwrap();
        fs::write(path, text).unwrap();
    }

    fn read_with(
        &self,
        urdf: &str,
        settings: &UrdfSettings,
    ) -> Result<Description, DescriptionError> {
        self.write("arm_description/urdf/arm.urdf", urdf.as_bytes());
        Description::read_with(&self.0.join("arm_description/urdf/arm.urdf"), settings)
    }

    /// The six-jointed arm whose carriage collides as the mesh `file`.
    fn with_mesh(&self, file: &str, settings: &UrdfSettings) -> Description {
        let mesh = format!("<mesh filename=\"{file}\" scale=\"0.001 0.001 0.001\"/>");
        let urdf = SIX_JOINT.replace("<sphere radius=\"0.05\"/>", &mesh);
        self.read_with(&urdf, settings).unwrap()
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

#[test]
fn meshes_are_found_in_their_packages() {
    let (folder, other) = (Folder::new("meshes"), Folder::new("elsewhere"));
    let octahedron = b"v 50 0 0\nv -50 0 0\nv 0 50 0\nv 0 -50 0\nv 0 0 50\nv 0 0 -50\n";
    for file in ["arm_description/meshes/ball.obj", "hand_description/ball.OBJ"] {
        folder.write(file, octahedron);
    }
    other.write("far/ball.obj", octahedron);
    let packages = vec![("far_description".to_owned(), other.0.join("far"))];
    let settings =
        UrdfSettings { packages, root: Some(folder.0.clone()), ..UrdfSettings::default() };
    let absolute = format!("file://{}/arm_description/meshes/ball.obj", folder.0.display());
    for name in [
        "package://arm_description/meshes/ball.obj",
        "package://renamed_description/meshes/ball.obj",
        "package://hand_description/ball.OBJ",
        "package://far_description/ball.obj",
        "model://arm_description/meshes/ball.obj",
        "../meshes/ball.obj",
        "..\\meshes\\ball.obj",
        &absolute,
    ] {
        let arm = folder.with_mesh(name, &settings);
        let [shape] = arm.links()[2].shapes[..] else {
            panic!("{name}: {:?}", arm.unread_meshes());
        };
        let Shape::Sphere { radius } = shape.shape else {
            panic!("{shape:?}");
        };
        assert!((radius - 0.05).abs() < 1e-5 && shape.pose.position.x == 0.1, "{shape:?}");
    }
}

/// A mesh that cannot be read is reported with every path that was tried, and missed where shapes
/// are needed.
#[test]
fn meshes_that_cannot_be_read_are_named() {
    let (folder, other) = (Folder::new("unread"), Folder::new("outside"));
    other.write("ball.obj", b"v 1 2 3");
    folder.write("arm_description/far.obj", b"v 1 2 1e300");
    folder.write("arm_description/ball.ply", b"ply");
    let link = folder.0.join("link.obj");
    std::os::unix::fs::symlink(other.0.join("ball.obj"), link).unwrap();
    let settings = UrdfSettings { root: Some(folder.0.clone()), ..UrdfSettings::default() };
    let outside = format!("file://{}/ball.obj", other.0.display());
    for (file, words) in [
        ("none.obj", "urdf/none.obj`; give the folder of its package"),
        ("package://arm_description/none.obj", "arm_description/arm_description/none.obj`, `"),
        ("../far.obj", "beyond 1e6"),
        ("../ball.ply", "only STL, OBJ and DAE"),
        ("https://host/a.stl", "`https://` is not read"),
        ("../../link.obj", "no file outside of"),
        (&outside, "no file outside of"),
    ] {
        let arm = folder.with_mesh(file, &settings);
        let message = arm.to_mjcf(&MjcfSettings::default()).unwrap_err().to_string();
        println!("{message}");
        assert!(arm.links()[2].shapes.is_empty());
        assert!(message.contains(words) && message.contains("ignore_meshes"), "{message}");
        assert!(message.contains(&format!("link `carriage` collides as the mesh `{file}`")));
        let ignored = UrdfSettings { ignore_meshes: true, ..settings.clone() };
        folder.with_mesh(file, &ignored).to_mjcf(&MjcfSettings::default()).unwrap();
    }
    let text = SIX_JOINT.replace("<sphere radius=\"0.05\"/>", "<mesh filename=\"a.stl\"/>");
    assert!(not_simulated(&text).contains("without its folder"));
}
