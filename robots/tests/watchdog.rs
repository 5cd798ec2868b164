//! The watchdog, with a clock that the test moves.

use std::cell::{Cell, RefCell};
use std::panic::{AssertUnwindSafe, catch_unwind};
use std::time::Duration;

use glam::DVec3;
use robots::{
    ArmCommand, Chain, ControlError, KinematicArm, Pose, Robot, RobotState, Twist,
    TwistControlSettings, TwistController, Watchdog, gen3,
};

/// Record of the calls to a robot that may fail to stop.
#[derive(Default)]
struct Tape {
    calls: RefCell<Vec<&'static str>>,
    stuck: Cell<bool>,
}

struct Recorded<'a>(&'a Tape);

impl Robot for Recorded<'_> {
    fn state(&mut self) -> Result<RobotState, ControlError> {
        let (joints, tip) = (Vec::new(), Pose::IDENTITY);
        Ok(RobotState { joints, tip, gripper_closure: 0.0 })
    }

    fn command(&mut self, command: &ArmCommand) -> Result<(), ControlError> {
        self.0.calls.borrow_mut().push("command");
        assert!(command.twist.linear.z > -2.0, "the driver panics after the command was sent");
        if command.twist.linear.z > 0.0 {
            let source = "the cable is out".into();
            return Err(ControlError::Driver { source });
        }
        Ok(())
    }

    fn stop(&mut self) -> Result<(), ControlError> {
        self.0.calls.borrow_mut().push("stop");
        if self.0.stuck.get() {
            let source = "no answer".into();
            return Err(ControlError::Driver { source });
        }
        Ok(())
    }
}

const UP: ArmCommand =
    ArmCommand { twist: Twist { linear: DVec3::Z, angular: DVec3::ZERO }, gripper_closure: 0.0 };

fn ms(milliseconds: u64) -> Duration {
    Duration::from_millis(milliseconds)
}

#[test]
fn a_driver_that_panics_after_a_command_is_stopped() {
    let (tape, now) = (Tape::default(), Cell::new(ms(0)));
    let mut watched = Watchdog::new(Recorded(&tape), || now.get());
    let mut down = UP;
    down.twist.linear.z = -3.0;
    let sent = catch_unwind(AssertUnwindSafe(|| watched.command(&down)));
    assert!(sent.is_err());
    now.set(ms(200));
    assert!(watched.stop_if_timed_out().unwrap());
    assert_eq!(*tape.calls.borrow(), ["command", "stop"]);
}

#[test]
fn it_stops_once_after_two_hundred_milliseconds_without_a_command() {
    let (tape, now) = (Tape::default(), Cell::new(ms(5000)));
    let mut watched = Watchdog::new(Recorded(&tape), || now.get());
    assert!(!watched.stop_if_timed_out().unwrap(), "nobody commanded it yet");
    for at in [5000, 5150, 5300] {
        now.set(ms(at));
        watched.command(&ArmCommand::default()).unwrap();
    }
    now.set(ms(5499));
    assert!(!watched.stop_if_timed_out().unwrap());
    now.set(ms(5500));
    assert!(watched.stop_if_timed_out().unwrap());
    now.set(ms(9000));
    watched.state().unwrap();
    assert_eq!(*tape.calls.borrow(), ["command", "command", "command", "stop"]);
    // a new command starts it again
    watched.command(&ArmCommand::default()).unwrap();
    now.set(ms(9200));
    watched.state().unwrap();
    assert_eq!(tape.calls.borrow()[4..], ["command", "stop"]);
}

#[test]
fn it_stops_where_a_command_is_refused() {
    let tape = Tape::default();
    let mut watched = Watchdog::new(Recorded(&tape), || Duration::ZERO);
    let lost = ArmCommand { twist: Twist::from_linear(DVec3::NAN), gripper_closure: 0.0 };
    assert!(matches!(watched.command(&lost), Err(ControlError::NotFinite { .. })));
    let wide = ArmCommand { gripper_closure: 1.5, ..ArmCommand::default() };
    let message = watched.command(&wide).unwrap_err().to_string();
    assert!(message.contains("gripper_closure is 1.5"), "{message}");
    // neither has reached the robot, which refuses this one itself
    assert!(matches!(watched.command(&UP), Err(ControlError::Driver { .. })));
    assert_eq!(*tape.calls.borrow(), ["stop", "stop", "command", "stop"]);
}

#[test]
fn a_robot_that_does_not_stop_is_told_again() {
    let (tape, now) = (Tape::default(), Cell::new(ms(0)));
    let mut watched = Watchdog::new(Recorded(&tape), || now.get());
    tape.stuck.set(true);
    let message = watched.command(&UP).unwrap_err().to_string();
    assert!(message.contains("cable") && message.contains("COULD NOT BE STOPPED"), "{message}");
    assert!(matches!(watched.state(), Err(ControlError::NotStopped { .. })));
    tape.stuck.set(false);
    assert!(watched.stop_if_timed_out().unwrap());
    assert!(!watched.stop_if_timed_out().unwrap());
    assert_eq!(*tape.calls.borrow(), ["command", "stop", "stop", "stop"]);
}

#[test]
fn a_clock_that_goes_back_stops_the_robot() {
    let (tape, now) = (Tape::default(), Cell::new(ms(5000)));
    let mut watched = Watchdog::new(Recorded(&tape), || now.get());
    watched.command(&ArmCommand::default()).unwrap();
    now.set(ms(0));
    assert!(watched.stop_if_timed_out().unwrap());
    assert!(!watched.stop_if_timed_out().unwrap());
}

#[test]
fn a_command_does_not_skip_a_stop_that_is_due() {
    let (tape, now) = (Tape::default(), Cell::new(ms(0)));
    let mut watched = Watchdog::new(Recorded(&tape), || now.get());
    tape.stuck.set(true);
    watched.command(&UP).unwrap_err();
    let error = watched.command(&ArmCommand::default()).unwrap_err();
    assert!(matches!(error, ControlError::NotStopped { .. }), "{error}");
    assert!(error.to_string().contains("earlier stop failed"), "{error}");
    tape.stuck.set(false);
    watched.command(&ArmCommand::default()).unwrap();
    // five seconds late
    now.set(ms(5000));
    watched.command(&ArmCommand::default()).unwrap();
    assert_eq!(
        *tape.calls.borrow(),
        ["command", "stop", "stop", "stop", "command", "stop", "command"]
    );
}

#[test]
fn dropping_it_stops_the_robot() {
    let tape = Tape::default();
    drop(Watchdog::new(Recorded(&tape), || Duration::ZERO));
    assert_eq!(*tape.calls.borrow(), ["stop"]);
}

#[test]
fn a_kinematic_arm_moves_until_nobody_commands_it() {
    let chain = Chain::new(&gen3::gen3_description().unwrap(), "tool_link").unwrap();
    let control =
        TwistController::new(chain, &gen3::WORK_JOINT_POSITIONS, TwistControlSettings::default())
            .unwrap();
    let now = Cell::new(ms(0));
    let mut watched = Watchdog::new(KinematicArm::new(control), || now.get());
    let command = ArmCommand { twist: Twist::from_linear(0.1 * DVec3::Y), gripper_closure: 1.0 };
    watched.command(&command).unwrap();
    let start = watched.state().unwrap();
    let mut places = Vec::new();
    for tick in 1..=40 {
        now.set(ms(25 * tick));
        watched.robot_mut().advance(0.025).unwrap();
        places.push(watched.state().unwrap());
    }
    let still = &places[8];
    assert!(still.tip.position.y > start.tip.position.y + 5e-3, "{still:?}");
    assert!(
        still.gripper_closure > 0.3 && still.gripper_closure < 0.5,
        "{}",
        still.gripper_closure
    );
    assert!(places[8..].iter().all(|place| place == still));
}

#[test]
fn a_kinematic_arm_that_refuses_a_command_stands_still() {
    let chain = Chain::new(&gen3::gen3_description().unwrap(), "tool_link").unwrap();
    let control =
        TwistController::new(chain, &gen3::WORK_JOINT_POSITIONS, TwistControlSettings::default())
            .unwrap();
    let mut arm = KinematicArm::new(control);
    let closing = |speed: f64| ArmCommand {
        twist: Twist::from_linear(speed * DVec3::Y),
        gripper_closure: 1.0,
    };
    arm.command(&closing(0.1)).unwrap();
    arm.advance(0.1).unwrap();
    assert!(arm.command(&closing(f64::NAN)).is_err());
    let stood = arm.state().unwrap();
    arm.advance(0.1).unwrap();
    assert_eq!(arm.state().unwrap(), stood);
    assert!(stood.gripper_closure > 0.0 && stood.tip.position.y > 0.0);
}
