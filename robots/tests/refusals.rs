//! Invalid files: each causes a clear error.

use std::fs;
use std::path::{Path, PathBuf};

use mujoco::Model;
use robots::{
    CartesianControl, Chain, ControlSettings, JointMotion, MAX_URDF_BYTES, MjcfSettings,
    PlacedShape, PositionSource, RobotDescription, Servo, Shape, UrdfSettings,
};

use crate::SIX_JOINT;

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
        lower="-3" upper="3"                | lower=" 3" upper="-3"      | `twist` is " 3"; not above `upper`
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
    let settings = MjcfSettings { servo: Some(Servo::default()), ..MjcfSettings::default() };
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
        assert!(not_simulated(&urdf).contains("efforts of the joints turn, "));
        let chain = Chain::new(&read(&urdf), "tip").unwrap();
        let control = CartesianControl::new(chain, &[0.0; 6], ControlSettings::default());
        assert!(control.unwrap_err().to_string().contains("speeds of the joints turn, "));
        for (speed, known) in [(0.5, Some(0.5)), (0.0, None)] {
            let default_speed = Some(speed);
            let settings = UrdfSettings { default_speed, ..UrdfSettings::default() };
            let arm = Folder::new("limits").read_with(&urdf, &settings);
            assert_eq!(motion_of(&arm, "turn").max_speed, known);
            let note = "joint `turn` has no limit of velocity, so 0.5 is assumed";
            assert_eq!(arm.notes().iter().any(|told| told.contains(note)), known.is_some());
        }
    }
}

/// The motion of a joint.
#[track_caller]
fn motion_of(arm: &RobotDescription, joint: &str) -> JointMotion {
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
    assert_eq!(arm.notes().len(), 2, "{:?}", arm.notes());
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
    let PositionSource::Follows { dof: 3, multiplier, offset } = nod.drive else {
        panic!("{nod:?}");
    };
    assert!((multiplier + 1.5).abs() < 1e-12 && (offset - 1.6).abs() < 1e-12, "{nod:?}");
    let still = read(&changed("<mimic joint=\"swing\"", "<mimic joint=\"flange\""));
    assert!(still.notes()[0].contains("`balance`: it follows a joint that does not move"));
    assert_eq!(still.num_dofs(), 6);
}

/// A hinge without limits keeps its freedom if a follower hardly moves.
#[test]
fn endless_joints_that_hardly_move_their_followers_stay_endless() {
    for multiplier in ["1e-310", "-1e-9"] {
        let mimic = format!("<mimic joint=\"turn\" multiplier=\"{multiplier}\"");
        let arm = read(&changed("<mimic joint=\"swing\" multiplier=\"-0.5\"", &mimic));
        assert_eq!(motion_of(&arm, "turn").range, None);
        assert!(arm.restrictions().is_empty());
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
        assert!(arm.restrictions().is_empty() && arm.notes().len() == 1, "{:?}", arm.notes());
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
        "#,
    );
    // old text, new text, words of the error of simulating it, note on a repair
    let table = r#"
        <mass value="0.5"/> | <mass value="0"/>    | `twist` moves the link `wrist`, which has no mass | 0.001 kg
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
        let arm = Folder::new("masses").read_with(&urdf, &settings);
        assert!(arm.notes()[0].contains(note), "{:?}", arm.notes());
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
    let arm = read(&format!(
        r#"<robot>{links}<joint name="fix" type="fixed"><parent link="tip"/><child link="gun"/>
        <axis xyz="0 0 0"/></joint><joint name="spin" type="continuous"><parent link="floor"/>
        <child link="tip"/></joint></robot>"#
    ));
    let mjcf = arm.to_mjcf(&MjcfSettings::default()).unwrap().text;
    Model::from_xml(&mjcf).unwrap();
    let masses: Vec<&str> = mjcf.split(" mass=").skip(1).collect();
    assert!(masses.len() == 1 && masses[0].starts_with("\"0.7\""), "{mjcf}");
}

#[test]
fn shapes_must_be_primitive() {
    all_refused(
        r#"
        <sphere radius="0.05"/> | <sphere radius="-1"/>   | link `carriage`; "-1"; zero or more metres
        <sphere radius="0.05"/> | <plane/>                | `<geometry>` of the link `carriage` has no `<sphere>`, `<box>`
        <sphere radius="0.05"/> | <mesh/>                 | `<mesh>` of the link `carriage` has no `filename`
        <sphere radius="0.05"/> | <mesh scale="1 1 1 a"/> | `scale`; three numbers; line
        size="0.1 0.12 0.3"     | size="0.1 -0.12 0.3"    | link `column`; -0.12
        size="0.1 0.12 0.3"     | size="0.1 x 0.12 0.3"   | `size`; three numbers; line
        "#,
    );
}

/// Shapes without size are left out, and flat ones stay.
#[test]
fn shapes_without_size_are_left_out() {
    let flat = ["<sphere radius=\"0\"/>", "<box size=\"0 0 0\"/>", "<box size=\"1 1 0\"/>"];
    for (shape, shapes) in flat.into_iter().zip([0, 0, 1]) {
        let arm = read(&changed("<sphere radius=\"0.05\"/>", shape));
        assert_eq!((arm.links()[2].shapes.len(), arm.notes().len()), (shapes, 1 - shapes));
        arm.to_mjcf(&MjcfSettings::default()).unwrap();
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
        ("<robot>\n<a b=\"<\"/></robot>", "at 2:7"),
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

    fn read_with(&self, urdf: &str, settings: &UrdfSettings) -> RobotDescription {
        let file = "arm_description/urdf/arm.urdf";
        self.write(file, urdf.as_bytes());
        RobotDescription::from_urdf_file_with(&self.0.join(file), settings).unwrap()
    }

    /// The six-jointed arm whose carriage collides as the mesh `file`.
    fn with_mesh(&self, file: &str, settings: &UrdfSettings) -> RobotDescription {
        let mesh = format!("<mesh filename=\"{file}\" scale=\"0.001 0.001 0.001\"/>");
        let urdf = SIX_JOINT.replace("<sphere radius=\"0.05\"/>", &mesh);
        self.read_with(&urdf, settings)
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
        UrdfSettings { packages, mesh_root: Some(folder.0.clone()), ..UrdfSettings::default() };
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
        let shapes = &arm.links()[2].shapes[..];
        let &[PlacedShape { shape: Shape::Sphere { radius }, pose }] = shapes else {
            panic!("{name}: {shapes:?} {:?}", arm.unread_meshes());
        };
        assert!((radius - 0.05).abs() < 1e-5 && pose.position.x == 0.1, "{shapes:?}");
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
    let settings = UrdfSettings { mesh_root: Some(folder.0.clone()), ..UrdfSettings::default() };
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
        assert!(arm.links()[2].shapes.is_empty());
        assert!(message.contains(words) && message.contains("ignore_meshes"), "{message}");
        assert!(message.contains(&format!("link `carriage` collides as the mesh `{file}`")));
        let ignored = UrdfSettings { ignore_meshes: true, ..settings.clone() };
        folder.with_mesh(file, &ignored).to_mjcf(&MjcfSettings::default()).unwrap();
    }
    let text = SIX_JOINT.replace("<sphere radius=\"0.05\"/>", "<mesh filename=\"a.stl\"/>");
    assert!(not_simulated(&text).contains("without its folder"));
}
