//! `covers robot`: what a robot's description contains, and its MJCF.

use std::fmt::Write as _;
use std::io::Write;
use std::path::PathBuf;

use clap::{Args, Subcommand};
use envs::EnvError;
use envs::embodiments::Arm;
use envs::robots::{
    JointServoSettings, JointSummary, MjcfSettings, OrientationConstraint, RobotCheckReport,
    RobotFile, TouchingLinkPairs,
};
use glam::DVec3;

use experiments::RunError;
use experiments::cli::print_escaped;
use learner::disk::{LocalDisk, write_atomically};

/// Subcommands of `covers robot`.
#[derive(Clone, Debug, Subcommand)]
pub enum RobotCommand {
    /// Prints what was read of a robot, and fails if it cannot be simulated or looks wrong.
    #[command(after_help = "Example: covers robot check arm.urdf")]
    Check(RobotCheckOptions),
    /// Writes the MJCF with which MuJoCo simulates a robot.
    #[command(after_help = "Example: covers robot mjcf arm.urdf --out arm.xml")]
    Mjcf(RobotMjcfOptions),
}

/// Options of `covers robot check`.
#[derive(Clone, Debug, Args)]
pub struct RobotCheckOptions {
    /// URDF, or a JSON file of settings that names one.
    #[arg(value_name = "ARM")]
    pub robot: PathBuf,
    /// Print one JSON object instead of a text.
    #[arg(long)]
    pub json: bool,
}

/// Options of `covers robot mjcf`.
#[derive(Clone, Debug, Args)]
pub struct RobotMjcfOptions {
    /// URDF, or a JSON file of settings that names one.
    #[arg(value_name = "ARM")]
    pub robot: PathBuf,
    /// File to write (default: standard output).
    #[arg(long, value_name = "FILE")]
    pub out: Option<PathBuf>,
    /// Add a position servo for each joint.
    #[arg(long)]
    pub servos: bool,
    /// Print one JSON object with the MJCF and the pairs of links that never collide.
    #[arg(long, conflicts_with = "out")]
    pub json: bool,
}

impl RobotCommand {
    /// Runs the command, prints to `out`, and returns `false` if a check found a problem.
    ///
    /// # Errors
    /// A robot that cannot be read or simulated, and files that cannot be written to.
    pub fn run(&self, out: &mut impl Write) -> Result<bool, RunError> {
        match self {
            Self::Check(options) => options.run(out),
            Self::Mjcf(options) => options.run(out).map(|()| true),
        }
    }
}

impl RobotCheckOptions {
    fn run(&self, out: &mut impl Write) -> Result<bool, RunError> {
        let file = RobotFile::read(&self.robot).map_err(EnvError::from)?;
        let mut check = file.check_report().map_err(EnvError::from)?;
        let table = table_text(&file, &mut check);
        let printed = if self.json {
            let mut object = serde_json::json!(check);
            object["table"] = table.into();
            object.to_string()
        } else if check.problems.contains(&table) {
            check_text(&check)
        } else {
            check_text(&check) + &table
        };
        print_escaped(out, printed.trim_end())?;
        Ok(check.passes())
    }
}

impl RobotMjcfOptions {
    fn run(&self, out: &mut impl Write) -> Result<(), RunError> {
        let file = RobotFile::read(&self.robot).map_err(EnvError::from)?;
        let robot = file.read_description().map_err(EnvError::from)?;
        let mjcf = robot.to_mjcf(&servo_settings(self.servos)).map_err(EnvError::from)?;
        if let Some(path) = &self.out {
            write_atomically(&LocalDisk, path, mjcf.text.as_bytes())?;
            return print_escaped(out, &format!("{}", path.display()));
        }
        if self.json {
            let object =
                serde_json::json!({"mjcf": mjcf.text, "excluded_pairs": &mjcf.excluded_pairs});
            return print_escaped(out, &object.to_string());
        }
        print_escaped(out, mjcf.text.trim_end())
    }
}

fn check_text(check: &RobotCheckReport) -> String {
    let RobotCheckReport { name, links, joints, mass_kg, hand, .. } = check;
    let mut text =
        format!("{name}: {links} links, {} joints that move, {mass_kg:.3} kg\n", joints.len());
    // writing to a String cannot fail
    let _ = match check.approach_axis {
        Some(axis) => writeln!(text, "hand {hand}, which points down along its axis {axis:?}"),
        None => writeln!(text, "hand {hand}"),
    };
    if let Some([one, other]) = &check.fingers {
        let _ = writeln!(text, "fingers {one}, {other}");
    } else if check.has_fixed_claws {
        text += "nothing moves on the hand: two fixed claws, 0.1 m apart, are added to it\n";
    }
    if !check.chain.is_empty() {
        let _ = writeln!(text, "joints to the hand: {}", check.chain.join(", "));
    }
    if let Some(reach) = check.reach_m {
        let _ = writeln!(text, "reach: the hand is at most {reach:.3} m from the first joint");
    }
    if check.ik_targets > 0 {
        let RobotCheckReport { ik_found, ik_targets, ik_median_and_max_ms, .. } = check;
        let [median, most] = ik_median_and_max_ms;
        let _ = writeln!(
            text,
            "inverse kinematics finds {ik_found} of {ik_targets} poses, in {median:.2} ms (median), \
             {most:.2} ms at most"
        );
        let left = RobotCheckReport::MAX_IK_TARGETS - ik_targets;
        if left > 0 {
            let _ = writeln!(text, "its time ran out: {left} more poses were not tried");
        }
    }
    if !joints.is_empty() {
        text += "joint                      lowest    highest      speed     effort\n";
    }
    joints.iter().for_each(|joint| text += &joint_line(joint));
    let pairs = |pairs: &[[String; 2]]| -> Vec<String> {
        pairs.iter().map(|[one, other]| format!("{one} and {other}")).collect()
    };
    let TouchingLinkPairs { at_rest, in_most_postures } = &check.touching;
    let lists = [
        ("links that touch at rest and do not collide", pairs(at_rest)),
        ("links that touch in most postures and do not collide", pairs(in_most_postures)),
        ("notes", check.notes.clone()),
        ("collision shapes that are missing", check.missing_shapes.clone()),
        ("units that look wrong", check.unit_warnings.clone()),
        ("problems", check.problems.clone()),
    ];
    for (title, lines) in lists.iter().filter(|(_, lines)| !lines.is_empty()) {
        let _ = writeln!(text, "{title}:\n  {}", lines.join("\n").replace('\n', "\n  "));
    }
    text
}

/// Returns where the arm stands to do the tasks, or why it cannot do them; adds that to the problems
/// unless the arm is only too far away at every place where the search put it.
fn table_text(file: &RobotFile, check: &mut RobotCheckReport) -> String {
    if !check.problems.is_empty() {
        // the attempt would end with one of them
        return "the arm cannot do the tasks while it has problems".to_owned();
    }
    let arm = match Arm::from_file("arm", file) {
        Ok(arm) => arm,
        Err(error) => {
            let placed = placement(file);
            // a scene has links and joints with a prefix
            let reason = error.to_string().replace("robot/", "");
            let with = if placed.is_empty() { placed.clone() } else { format!(" with {placed}") };
            let problem = format!("the arm cannot do the tasks{with}: {reason}");
            if !placed.is_empty() || !matches!(error, EnvError::OutOfReach(_)) {
                check.problems.push(problem.clone());
            }
            return problem;
        }
    };
    let DVec3 { x, y, z } = arm.robot_description().base_pose().position;
    let kept = match arm.settings().control.orientation {
        OrientationConstraint::Full => "the hand does not turn",
        _ => "the hand turns about the vertical",
    };
    format!("at the table of the tasks its base stands at {x}, {y}, {z} m; {kept}")
}

/// Returns the settings that place the arm at the table, with their values.
fn placement(file: &RobotFile) -> String {
    let settings = [
        file.base_position.map(|position| format!("`base_position` {position:?}")),
        file.base_yaw_degrees.map(|yaw| format!("`base_yaw_degrees` {yaw}")),
        file.approach_axis.map(|axis| format!("`approach_axis` {axis:?}")),
    ];
    settings.into_iter().flatten().collect::<Vec<_>>().join(", ")
}

fn servo_settings(servos: bool) -> MjcfSettings {
    MjcfSettings { servo: servos.then(JointServoSettings::default), ..MjcfSettings::default() }
}

fn joint_line(joint: &JointSummary) -> String {
    let number = |value: Option<f64>| value.map_or("-".to_owned(), |value| format!("{value:.4}"));
    let [low, high] = [0, 1].map(|end| number(joint.range.map(|range| range[end])));
    let [speed, effort] = [joint.max_speed, joint.max_effort].map(number);
    let units = if joint.slides { "m, m/s, N" } else { "rad, rad/s, N m" };
    let follows = if joint.follows { ", follows another one" } else { "" };
    let name = &joint.name;
    format!("{name:<22} {low:>10} {high:>10} {speed:>10} {effort:>10}  {units}{follows}\n")
}

#[cfg(test)]
mod tests {
    use clap::Parser;

    use crate::program::CoversCli;

    /// Returns the exit code and the output of `covers robot` with these arguments.
    fn printed(words: &[&str]) -> (u8, String) {
        let mut out = Vec::new();
        let program = CoversCli::try_parse_from([&["covers", "robot"], words].concat()).unwrap();
        (program.run(&mut out).unwrap(), String::from_utf8(out).unwrap())
    }

    #[test]
    fn a_check_prints_the_figures_and_fails_where_something_is_wrong() {
        let gen3 = concat!(env!("CARGO_MANIFEST_DIR"), "/assets/urdf/kinova_gen3.urdf");
        let (code, text) = printed(&["check", gen3]);
        assert_eq!(code, 0, "{text}");
        for expected in
            ["hand gripper_link", "finger_l_link", "joint_7", " ms at most", "base stands"]
        {
            assert!(text.contains(expected), "{expected}: {text}");
        }
        let (_, json) = printed(&["check", gen3, "--json"]);
        let json: serde_json::Value = serde_json::from_str(&json).unwrap();
        assert_eq!(json["chain"].as_array().unwrap().len(), 7);
        let degrees = std::fs::read_to_string(gen3).unwrap().replace("2.24", "128");
        let path = std::env::temp_dir().join(format!("covers-robot-{}.urdf", std::process::id()));
        std::fs::write(&path, degrees).unwrap();
        let (failed, wrong) = printed(&["check", path.to_str().unwrap()]);
        assert!(failed == 1 && wrong.contains("128 rad: is the file in degrees"), "{wrong}");
        std::fs::remove_file(path).unwrap();
    }

    #[test]
    fn a_check_takes_hand_axis_and_fingers_from_a_file_of_settings() {
        let gen3 = concat!(env!("CARGO_MANIFEST_DIR"), "/assets/urdf/kinova_gen3.urdf");
        let path = std::env::temp_dir().join(format!("covers-robot-{}.json", std::process::id()));
        let settings = serde_json::json!({
            "urdf": gen3, "hand": "gripper_link", "approach_axis": [3, 0, 0],
            "fingers": ["finger_r_link", "finger_l_link"],
        });
        std::fs::write(&path, settings.to_string()).unwrap();
        let (_, json) = printed(&["check", path.to_str().unwrap(), "--json"]);
        std::fs::remove_file(path).unwrap();
        let json: serde_json::Value = serde_json::from_str(&json).unwrap();
        assert_eq!(json["approach_axis"], serde_json::json!([1.0, 0.0, 0.0]));
        assert_eq!(json["fingers"], settings["fingers"]);
    }

    /// The hand points up, or the base is out of reach.
    #[test]
    fn a_check_fails_where_the_arm_is_placed_so_that_it_cannot_do_the_tasks() {
        let gen3 = concat!(env!("CARGO_MANIFEST_DIR"), "/assets/urdf/kinova_gen3.urdf");
        let path = std::env::temp_dir().join(format!("covers-placed-{}.json", std::process::id()));
        for (setting, value, says) in [
            ("base_position", serde_json::json!([0, -2, 0]), "2.00 m from the first joint"),
            ("approach_axis", serde_json::json!([0, 0, -1]), "`approach_axis` [0.0, 0.0, -1.0]"),
        ] {
            let settings = serde_json::json!({"urdf": gen3, setting: value});
            std::fs::write(&path, settings.to_string()).unwrap();
            let (code, text) = printed(&["check", path.to_str().unwrap()]);
            let times = text.matches("the arm cannot do the tasks with").count();
            assert!(code == 1 && times == 1 && text.contains(says), "{text}");
        }
        std::fs::remove_file(path).unwrap();
    }

    /// A gripper that cannot be driven is a problem, and one that is found is none.
    #[test]
    fn a_check_fails_where_the_gripper_cannot_be_used() {
        let arm = include_str!("../assets/urdf/seven_joint_gripper.urdf");
        let path = std::env::temp_dir().join(format!("covers-finger-{}.urdf", std::process::id()));
        let (arms, finger) = arm.split_at(arm.find("<joint name=\"finger_1\"").unwrap());
        let limp = finger.replace("velocity=\"0.075\"", "velocity=\"0\"");
        assert_ne!(limp, finger);
        for (fingers, expected) in [(finger, 0), (&limp, 1)] {
            std::fs::write(&path, format!("{arms}{fingers}")).unwrap();
            let (code, text) = printed(&["check", path.to_str().unwrap()]);
            assert_eq!(code, expected, "{text}");
            assert_eq!(text.contains("the arm cannot do the tasks"), expected == 1, "{text}");
            assert!(!text.contains("robot/"), "{text}");
        }
        std::fs::remove_file(path).unwrap();
    }

    /// A scene has links and joints with prefixes, and links of its own.
    #[test]
    fn messages_have_the_names_of_the_file() {
        let gen3 = include_str!("../assets/urdf/kinova_gen3.urdf");
        let path = std::env::temp_dir().join(format!("covers-names-{}.urdf", std::process::id()));
        let swapped =
            gen3.replace("lower=\"-2.24\" upper=\"2.24\"", "lower=\"2.24\" upper=\"-2.24\"");
        assert_ne!(swapped, gen3);
        std::fs::write(&path, swapped).unwrap();
        let (_, checked) = printed(&["check", path.to_str().unwrap()]);
        let refused = |words: &[&str]| {
            let line = [&["covers"], words, &["--robot", path.to_str().unwrap()]].concat();
            let program = CoversCli::try_parse_from(line).unwrap();
            program.run(&mut Vec::new()).unwrap_err().to_string()
        };
        let played = refused(&["check", "experts"]);
        let run = concat!(env!("CARGO_MANIFEST_DIR"), "/assets/pretrained");
        let evaluated = refused(&["eval", run]);
        std::fs::remove_file(&path).unwrap();
        for text in [checked, played, evaluated] {
            let is_internal = text.contains("robot/") || text.contains("gripper_hand");
            assert!(text.contains("`joint_2`") && !is_internal, "{text}");
        }
    }

    #[test]
    fn mjcf_goes_to_a_file_or_to_the_output() {
        let gen3 = concat!(env!("CARGO_MANIFEST_DIR"), "/assets/urdf/kinova_gen3.urdf");
        let (_, bare) = printed(&["mjcf", gen3]);
        assert!(bare.starts_with("<mujoco") && !bare.contains("<actuator>"), "{bare}");
        let path = std::env::temp_dir().join(format!("covers-robot-{}.xml", std::process::id()));
        printed(&["mjcf", gen3, "--servos", "--out", path.to_str().unwrap()]);
        let driven = std::fs::read_to_string(&path).unwrap();
        assert!(driven.contains("<actuator>"), "{driven}");
        std::fs::remove_file(path).unwrap();
        let (_, json) = printed(&["mjcf", gen3, "--json"]);
        let json: serde_json::Value = serde_json::from_str(&json).unwrap();
        assert_eq!(json["mjcf"].as_str().unwrap().trim_end(), bare.trim_end());
    }
}
