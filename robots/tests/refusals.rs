//! Invalid files: each causes a clear error.

use std::fs;
use std::path::{Path, PathBuf};

use robots::{DescriptionError, MAX_URDF_BYTES, RobotDescription, Shape};

use crate::SIX_JOINT;

/// The message about the six-jointed arm with `old` replaced by `new`.
fn refusal(old: &str, new: &str) -> String {
    assert!(SIX_JOINT.contains(old), "{old}");
    let changed = SIX_JOINT.replacen(old, new, 1);
    let message = RobotDescription::from_urdf(&changed).unwrap_err().to_string();
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
    let alone = RobotDescription::from_urdf("<robot name=\"none\"></robot>").unwrap_err();
    assert!(matches!(alone, DescriptionError::CountOutOfRange { count: 0, .. }), "{alone}");
    let links: String = (0..=robots::MAX_LINKS).map(|i| format!("<link name=\"{i}\"/>")).collect();
    let many = RobotDescription::from_urdf(&format!("<robot name=\"many\">{links}</robot>"));
    assert!(matches!(many, Err(DescriptionError::CountOutOfRange { count: 1001, .. })));
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
    let taken = SIX_JOINT.replace("\"world\"", "\"ground\"").replace("\"column\"", "\"world\"");
    let message = RobotDescription::from_urdf(&taken).unwrap_err().to_string();
    assert!(message.contains("simulated world"), "{message}");
    // a frame without shapes that hangs on another link
    let inside = SIX_JOINT.replace("\"world\"", "\"ground\"").replace("\"tip\"", "\"world\"");
    let inside_message = RobotDescription::from_urdf(&inside).unwrap_err().to_string();
    assert!(inside_message.contains("simulated world"), "{inside_message}");
}

#[test]
fn joints_must_be_possible() {
    for kind in ["floating", "planar", "spherical"] {
        refused(
            "name=\"twist\" type=\"revolute\"",
            &format!("name=\"twist\" type=\"{kind}\""),
            &["`twist`", kind],
        );
    }
    all_refused(
        r#"
        type="continuous"                   | type="rubber"        | cannot be parsed; rubber
        lower="-3" upper="3"                | lower="3" upper="-3" | `twist`; from 3 to -3
        lower="-3" upper="3"                |                      | `twist`; from 0 to 0; continuous
        upper="0.3"                         | upper="inf"          | joint `lift`; inf; finite
        velocity="0.4"                      | velocity="0"         | joint `lift`; velocity is 0; positive
        effort="60"                         | effort="NaN"         | joint `turn`; NaN
        effort="60"                         | effort="-60"         | joint `turn`; effort is -60; positive
        <limit effort="60" velocity="1.5"/> |                      | joint `turn`; velocity is 0
        damping="20"                        | damping="-20"        | joint `lift`; -20
        xyz="0 0 2"                         | xyz="0 0 0"          | joint `lift`; axis; direction
        rpy="0 0.4 0"                       | rpy="0 nan 0"        | joint `swing`; rpy
        "#,
    );
}

#[test]
fn followers_must_follow_a_free_joint() {
    for (joint, words) in [("flange", "`flange`"), ("balance", "`balance`"), ("none", "`none`")] {
        refused(
            "<mimic joint=\"swing\"",
            &format!("<mimic joint=\"{joint}\""),
            &["`balance`", words, "follows no other"],
        );
    }
    refused("multiplier=\"-0.5\"", "multiplier=\"1e9\"", &["`balance`", "1000000000"]);
}

/// A hinge without limits keeps its freedom if a follower hardly moves.
#[test]
fn endless_joints_that_hardly_move_their_followers_stay_endless() {
    for multiplier in ["1e-310", "-1e-9"] {
        let mimic = format!("<mimic joint=\"turn\" multiplier=\"{multiplier}\"");
        let urdf = SIX_JOINT.replacen("<mimic joint=\"swing\" multiplier=\"-0.5\"", &mimic, 1);
        assert_ne!(urdf, SIX_JOINT);
        let arm = RobotDescription::from_urdf(&urdf).unwrap();
        let turn = arm.free_joints().find(|(joint, _)| joint.name == "turn");
        assert_eq!(turn.unwrap().1.range, None);
        assert!(arm.restrictions().is_empty());
    }
}

/// Followers that are outside their own ranges wherever the joint is that they follow.
#[test]
fn followers_must_be_able_to_stay_within_their_ranges() {
    all_refused(
        r#"
        lower="-4" upper="4"                        | lower="2" upper="4"                      | `balance` follows `swing`; 2 to 4
        multiplier="-0.5" offset="0.2"              | multiplier="0" offset="5"                | `balance`; from 5 to 5; -4 to 4
        "#,
    );
    // `twist` leaves `swing` the range from 0.4 to its end, in which `balance` is at 0 and below
    let two = SIX_JOINT
        .replacen(
            "<limit lower=\"-3\" upper=\"3\"",
            "<mimic joint=\"swing\"/><limit lower=\"0.4\" upper=\"3\"",
            1,
        )
        .replacen("lower=\"-4\" upper=\"4\"", "lower=\"0.1\" upper=\"4\"", 1);
    let message = RobotDescription::from_urdf(&two).unwrap_err().to_string();
    println!("{message}");
    for words in [
        "`balance` follows `swing`, which moves from 0.4 to ",
        " to keep `twist` in its range",
        "outside its own range, 0.1 to 4",
        "of `balance` or of `twist`",
    ] {
        assert!(message.contains(words), "{words}: {message}");
    }
    let endless = SIX_JOINT.replacen("<mimic joint=\"swing\"", "<mimic joint=\"turn\"", 1);
    let arm = RobotDescription::from_urdf(&endless).unwrap();
    let turn = arm.free_joints().find(|(joint, _)| joint.name == "turn");
    let [low, high] = turn.unwrap().1.range.unwrap();
    assert!((low + 7.6).abs() < 1e-12 && (high - 8.4).abs() < 1e-12, "{low} {high}");
    let still = SIX_JOINT.replacen("multiplier=\"-0.5\"", "multiplier=\"0\"", 1);
    assert!(RobotDescription::from_urdf(&still).unwrap().restrictions().is_empty());
}

#[test]
fn masses_must_be_those_of_bodies() {
    let wrist =
        r#"<mass value="0.5"/><inertia ixx="5e-4" ixy="0" ixz="0" iyy="6e-4" iyz="0" izz="4e-4"/>"#;
    let inertial = format!("<inertial>\n      {wrist}\n    </inertial>");
    refused(&inertial, "", &["`wrist`", "`twist`", "no mass"]);
    all_refused(
        r#"
        <mass value="0.5"/> | <mass value="-0.5"/> | link `wrist`; -0.5
        <mass value="0.5"/> | <mass value="nan"/>  | link `wrist`; NaN
        <mass value="0.5"/> | <mass value="0"/>    | link `wrist`; mass is 0
        ixx="5e-4"          | ixx="11e-4"          | `wrist`; exceeds the sum; 0.0011
        ixx="5e-4"          | ixx="-5e-4"          | `wrist`; below 1e-12
        ixy="1e-4"          | ixy="1"              | `forearm`; below 1e-12
        izz="0.02"          | izz="inf"            | link `column`; inf
        "#,
    );
}

#[test]
fn shapes_must_be_primitive_and_have_a_size() {
    let sphere = "<sphere radius=\"0.05\"/>";
    refused(sphere, "<sphere radius=\"0\"/>", &["link `carriage`", "size is 0"]);
    refused("size=\"0.1 0.12 0.3\"", "size=\"0.1 -0.12 0.3\"", &["link `column`", "-0.12"]);
    refused(
        sphere,
        "<mesh filename=\"meshes/a.stl\"/>",
        &["`carriage`", "`meshes/a.stl`", "without its folder"],
    );
    for file in ["/etc/passwd", "../a.stl", "file:///etc/passwd"] {
        refused(sphere, &format!("<mesh filename=\"{file}\"/>"), &["`carriage`", file, "outside"]);
        let visual = "package://six_joint/meshes/upper_arm.stl";
        refused(visual, file, &["`upper_arm`", file, "outside"]);
    }
}

#[test]
fn what_is_no_urdf_is_refused() {
    for text in ["", "no", "<robot", "<model/>", "<robot name=\"a\"><link/></robot>", "\0\u{feff}"]
    {
        let error = RobotDescription::from_urdf(text).unwrap_err();
        let known = matches!(
            error,
            DescriptionError::InvalidSyntax { .. } | DescriptionError::CountOutOfRange { .. }
        );
        assert!(known, "{text:?}: {error}");
    }
    let deep = format!("<robot>{}{}</robot>", "<a>".repeat(100_000), "</a>".repeat(100_000));
    assert!(matches!(RobotDescription::from_urdf(&deep), Err(DescriptionError::XmlTooDeep { .. })));
    let long = format!("{SIX_JOINT}{}", " ".repeat(MAX_URDF_BYTES));
    assert!(matches!(
        RobotDescription::from_urdf(&long),
        Err(DescriptionError::FileTooLong { .. })
    ));
}

/// Tags that a careless parser takes for comments and instructions, 50 000 deep.
#[test]
fn depth_hides_behind_no_comment_and_no_instruction() {
    let (open, close) = ("<a>".repeat(50_000), "</a>".repeat(50_000));
    for text in [
        format!("<?p '?>{open}<?p '?>{close}"),
        format!("<robot><?p '?>{open}<?p '?>{close}</robot>"),
        format!("<robot>{}</robot>", format!("{open}<!-->{close}-->").repeat(2)),
        format!("<robot>{open}<!-->{close}--></robot>"),
        format!("<robot><a\">{open}<a\">{close}</robot>"),
    ] {
        let error = RobotDescription::from_urdf(&text).unwrap_err();
        let known = matches!(
            error,
            DescriptionError::InvalidSyntax { .. } | DescriptionError::XmlTooDeep { .. }
        );
        assert!(known, "{error}");
    }
}

/// `RustyXML` panics on each of these.
#[test]
fn xml_that_no_urdf_needs_is_refused_or_skipped() {
    let brackets = "]".repeat(256);
    for (text, word) in [
        (r#"<robot name="a" xmlns:xmlns="foo"/>"#, "0 links"),
        (r#"<robot xmlns="foo" :a="b"/>"#, "0 links"),
        (&format!("<robot><![CDATA[{brackets}]]></robot>"), "0 links"),
        ("<!DOCTYPE robot><robot/>", "DTD"),
        ("<robot><?p ?></robot>", "0 links"),
        ("<robot>\n<a b=\"<\"/></robot>", "at 2:7"),
        ("<robot><xacro:arm/></robot>", "the prefix `xacro` is xacro"),
    ] {
        let message = RobotDescription::from_urdf(text).unwrap_err().to_string();
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
    RobotDescription::from_urdf(&urdf(32, 10)).unwrap();
    let message = RobotDescription::from_urdf(&urdf(1000, 10_000)).unwrap_err().to_string();
    assert!(message.contains("32 namespaces"), "{message}");
    let attributes: String = (0..1001).map(|i| format!(" a{i}='{i}'")).collect();
    let attribute_message =
        RobotDescription::from_urdf(&format!("<robot{attributes}/>")).unwrap_err();
    assert!(attribute_message.to_string().contains("1000 attributes"), "{attribute_message}");
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
        let message = RobotDescription::from_urdf(&text).unwrap_err().to_string();
        assert!(message.contains("`<robot>`"), "{message}");
    }
    let framed = format!("\u{feff}{SIX_JOINT}\n<!-- the end -->\n");
    RobotDescription::from_urdf(&framed).unwrap();
}

/// A robot that is read from a template lacks all that xacro would have added.
#[test]
fn templates_that_were_not_expanded_are_refused() {
    let declared = SIX_JOINT.replacen("<robot ", "<robot xmlns:xacro=\"http://ros.org/xacro\" ", 1);
    let arm = RobotDescription::from_urdf(&declared).unwrap();
    assert_eq!(arm, RobotDescription::from_urdf(SIX_JOINT).unwrap());
    // old text of the file, new text, and the text that the message quotes
    let cases = r#"
        </robot>           | <xacro:hand parent="tip"/>\n</robot>                             | `<xacro:hand>`
        </robot>           | <xacro:if value="1">\n<link name="c"/></xacro:if></robot>        | `<xacro:if>`
        </robot>           | <gazebo><xacro:grey/></gazebo></robot>                           | `<xacro:grey>`
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
        let message = RobotDescription::from_urdf(&whole).unwrap_err().to_string();
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
    RobotDescription::from_urdf(&SIX_JOINT.replacen("</robot>", other, 1)).unwrap();
    // nothing but templates, whose robot would have no links
    let all =
        "<robot name=\"r\" xmlns:xacro=\"http://ros.org/xacro\"><xacro:arm prefix=\"\"/></robot>";
    let error = RobotDescription::from_urdf(all).unwrap_err();
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
    assert!(RobotDescription::from_urdf(&link(1000)).is_ok());
    let message = RobotDescription::from_urdf(&link(1001)).unwrap_err().to_string();
    assert_eq!(message, "the link `l` has 1001 collision shapes, expected 0 to 1000");
}

#[test]
fn files_that_cannot_be_read_are_named() {
    let missing =
        RobotDescription::from_urdf_file(Path::new("/none/arm.urdf")).unwrap_err().to_string();
    assert!(missing.contains("/none/arm.urdf"), "{missing}");
    // it never ends
    let endless = RobotDescription::from_urdf_file(Path::new("/dev/zero")).unwrap_err();
    assert!(matches!(endless, DescriptionError::FileTooLong { .. }), "{endless}");
    let arm = RobotDescription::from_urdf_file(Path::new("assets/urdf/six_joint.urdf")).unwrap();
    assert_eq!((arm.name(), arm.num_dofs(), arm.links().len()), ("six_joint", 6, 9));
}

/// Temporary folder that is removed when the test ends.
struct Folder(PathBuf);

impl Folder {
    fn new(name: &str) -> Self {
        let folder = std::env::temp_dir().join(format!("covers-{name}-{}", std::process::id()));
        fs::create_dir_all(&folder).unwrap();
        Self(folder)
    }

    /// The six-jointed arm whose carriage collides as the mesh `file`.
    fn read(&self, file: &str) -> Result<RobotDescription, DescriptionError> {
        let mesh = format!("<mesh filename=\"{file}\" scale=\"0.001 0.001 0.001\"/>");
        let path = self.0.join("arm.urdf");
        fs::write(&path, SIX_JOINT.replace("<sphere radius=\"0.05\"/>", &mesh)).unwrap();
        RobotDescription::from_urdf_file(&path)
    }
}

impl Drop for Folder {
    fn drop(&mut self) {
        let _ = fs::remove_dir_all(&self.0);
    }
}

#[test]
fn meshes_are_read_from_the_folder_and_from_nowhere_else() {
    let (folder, other) = (Folder::new("meshes"), Folder::new("elsewhere"));
    let octahedron = "v 50 0 0\nv -50 0 0\nv 0 50 0\nv 0 -50 0\nv 0 0 50\nv 0 0 -50\n";
    fs::write(folder.0.join("ball.obj"), octahedron).unwrap();
    fs::write(other.0.join("ball.obj"), octahedron).unwrap();
    for name in ["ball.obj", "package://six_joint/ball.obj"] {
        let arm = folder.read(name).unwrap();
        let [shape] = arm.links()[2].shapes[..] else {
            panic!("{:?}", arm.links()[2]);
        };
        let Shape::Sphere { radius } = shape.shape else {
            panic!("{shape:?}");
        };
        assert!((radius - 0.05).abs() < 1e-5 && shape.pose.position.x == 0.1, "{shape:?}");
    }
    let message = |file: &str| folder.read(file).unwrap_err().to_string();
    assert!(message("none.obj").contains("`none.obj`"));
    fs::write(folder.0.join("far.obj"), "v 1 2 1e300").unwrap();
    assert!(message("far.obj").contains("beyond 1e6"));
    std::os::unix::fs::symlink(other.0.join("ball.obj"), folder.0.join("link.obj")).unwrap();
    assert!(message("link.obj").contains("outside"));
}
