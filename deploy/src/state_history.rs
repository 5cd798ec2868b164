//! Recent states of an arm, to look up its pose at the time of a picture that arrives later.

use std::collections::VecDeque;
use std::f64::consts::TAU;
use std::time::Duration;

use robots::RobotState;

/// History of an arm's states with their times.
#[derive(Clone, Debug)]
pub(super) struct StateHistory {
    /// States of the arm before the last one, with their times, oldest first.
    earlier: VecDeque<(Duration, RobotState)>,
    last: (Duration, RobotState),
    /// Time for which the arm's states are kept.
    kept: Duration,
}

impl StateHistory {
    /// Creates a history that begins with a time and a state, and keeps the states of at least the
    /// time `kept` before the last one.
    pub fn new(start: (Duration, RobotState), kept: Duration) -> Self {
        Self { earlier: VecDeque::new(), last: start, kept }
    }

    /// Records the arm's state at the time `now`, which must not be before that of the last record.
    pub fn record(&mut self, now: Duration, state: RobotState) {
        self.earlier.push_back(std::mem::replace(&mut self.last, (now, state)));
        // keep one older state, to interpolate from it
        let old = self.earlier.partition_point(|(then, _)| *then + self.kept < now);
        self.earlier.drain(..old.saturating_sub(1));
    }

    /// Returns the arm's last recorded state.
    pub fn last(&self) -> &RobotState {
        &self.last.1
    }

    /// Returns the state at a time, interpolated linearly between the records before and after it.
    /// A time outside of the records gives the nearest record.
    pub fn state_at(&self, time: Duration) -> RobotState {
        let states = || self.earlier.iter().chain([&self.last]);
        let after = states().find(|(then, _)| *then > time);
        let before = states().take_while(|(then, _)| *then <= time).last();
        match (before, after) {
            (Some((t0, before)), Some((t1, after))) => {
                let share = (time - *t0).as_secs_f64() / (*t1 - *t0).as_secs_f64();
                between(before, after, share)
            }
            (None, Some((_, first))) => first.clone(),
            (_, None) => self.last.1.clone(),
        }
    }
}

/// Interpolates between two states of the arm; the pose of the hand is that of the nearer one.
/// Joints go the shorter way round, since an arm may report continuous ones modulo one turn.
fn between(from: &RobotState, to: &RobotState, share: f64) -> RobotState {
    let joints = from.joints.iter().zip(&to.joints);
    RobotState {
        joints: joints.map(|(a, b)| a + share * (b - a - TAU * ((b - a) / TAU).round())).collect(),
        tip: if share < 0.5 { from.tip } else { to.tip },
        gripper_closure: from.gripper_closure + share * (to.gripper_closure - from.gripper_closure),
    }
}

#[cfg(test)]
mod tests {
    use robots::Pose;

    use super::*;

    fn millis(t: u64) -> Duration {
        Duration::from_millis(t)
    }

    fn state(angle: f64) -> RobotState {
        RobotState {
            joints: vec![angle],
            tip: Pose::from_xyz_rpy([angle, 0.0, 0.0], [0.0; 3]),
            gripper_closure: angle / 10.0,
        }
    }

    /// Records a state every 20 ms; the angle is a tenth of the milliseconds.
    fn history(until: u64) -> StateHistory {
        let mut history = StateHistory::new((millis(0), state(0.0)), millis(100));
        for t in (20..=until).step_by(20) {
            history.record(millis(t), state(t as f64 / 10.0));
        }
        history
    }

    #[test]
    fn between_two_records_the_arm_is_on_the_straight_way() {
        let history = history(60);
        for t in [0, 7, 20, 35, 59, 60] {
            let was = history.state_at(millis(t));
            let angle = t as f64 / 10.0;
            assert!((was.joints[0] - angle).abs() < 1e-12, "{t}: {was:?}");
            assert!((was.gripper_closure - angle / 10.0).abs() < 1e-12, "{t}: {was:?}");
            // the hand is not interpolated: it stands at one of the records
            let nearest = 2.0 * (t as f64 / 20.0).round();
            assert_eq!(was.tip.position.x, nearest, "{t}");
        }
    }

    #[test]
    fn a_joint_that_is_reported_modulo_one_turn_goes_the_shorter_way() {
        let mut history = StateHistory::new((millis(0), state(TAU - 0.02)), millis(100));
        history.record(millis(20), state(0.02));
        let angle = history.state_at(millis(15)).joints[0];
        assert!((angle - (TAU + 0.01)).abs() < 1e-12, "{angle}");
    }

    #[test]
    fn before_the_first_and_after_the_last_record_it_is_there() {
        let mut history = StateHistory::new((millis(40), state(4.0)), millis(100));
        assert_eq!(history.state_at(millis(10)), state(4.0));
        history.record(millis(60), state(6.0));
        assert_eq!(history.state_at(millis(10)), state(4.0));
        assert_eq!(history.state_at(millis(500)), state(6.0));
        assert_eq!(history.last(), &state(6.0));
    }

    /// Checks that a state of 100 ms ago is exact, and that memory does not grow.
    #[test]
    fn as_much_is_kept_as_pictures_may_be_old() {
        let history = history(10_000);
        let angle = history.state_at(millis(9_907)).joints[0];
        assert!((angle - 990.7).abs() < 1e-9, "{angle}");
        assert!(history.earlier.len() <= 7, "{}", history.earlier.len());
    }

    /// Checks that the later one of two records of the same time counts.
    #[test]
    fn time_may_stand_still() {
        let mut history = history(20);
        history.record(millis(20), state(9.0));
        assert_eq!(history.state_at(millis(20)), state(9.0));
        history.record(millis(40), state(11.0));
        assert_eq!(history.state_at(millis(30)).joints, [10.0]);
    }
}
