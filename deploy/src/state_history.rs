//! Where an arm was when a picture was taken that comes later.

use std::collections::VecDeque;
use std::time::Duration;

use robots::RobotState;

/// The states of an arm of the last moments.
#[derive(Clone, Debug)]
pub(super) struct Past {
    /// Oldest first.
    earlier: VecDeque<(Duration, RobotState)>,
    last: (Duration, RobotState),
    /// How long states are kept.
    kept: Duration,
}

impl Past {
    /// Begins with where the arm is at a time.
    pub fn new(start: (Duration, RobotState), kept: Duration) -> Self {
        Self { earlier: VecDeque::new(), last: start, kept }
    }

    /// Takes note of where the arm is at the time `now`, which does not go back.
    pub fn note(&mut self, now: Duration, state: RobotState) {
        self.earlier.push_back(std::mem::replace(&mut self.last, (now, state)));
        // one from before all that count is kept
        let old = self.earlier.partition_point(|(then, _)| *then + self.kept < now);
        self.earlier.drain(..old.saturating_sub(1));
    }

    /// Where the arm was noted last.
    pub fn last(&self) -> &RobotState {
        &self.last.1
    }

    /// Where the arm was at a time: on the straight way between what was noted before and after it,
    /// and at the end that is nearer where nothing was.
    pub fn at(&self, time: Duration) -> RobotState {
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

/// A share of the way from one state to another one soon after.
fn between(from: &RobotState, to: &RobotState, share: f64) -> RobotState {
    let joints = from.joints.iter().zip(&to.joints);
    RobotState {
        joints: joints.map(|(a, b)| a + share * (b - a)).collect(),
        tip: if share < 0.5 { from.tip } else { to.tip },
        closing: from.closing + share * (to.closing - from.closing),
    }
}

#[cfg(test)]
mod tests {
    use robots::Pose;

    use super::*;

    fn millis(t: u64) -> Duration {
        Duration::from_millis(t)
    }

    /// An arm of one joint at this angle.
    fn state(angle: f64) -> RobotState {
        RobotState {
            joints: vec![angle],
            tip: Pose::from_xyz_rpy([angle, 0.0, 0.0], [0.0; 3]),
            closing: angle / 10.0,
        }
    }

    /// Noted every 20 ms, at an angle of the milliseconds over ten.
    fn past(until: u64) -> Past {
        let mut past = Past::new((millis(0), state(0.0)), millis(100));
        for t in (20..=until).step_by(20) {
            past.note(millis(t), state(t as f64 / 10.0));
        }
        past
    }

    #[test]
    fn between_two_notes_the_arm_is_on_the_straight_way() {
        let past = past(60);
        for t in [0, 7, 20, 35, 59, 60] {
            let was = past.at(millis(t));
            let angle = t as f64 / 10.0;
            assert!((was.joints[0] - angle).abs() < 1e-12, "{t}: {was:?}");
            assert!((was.closing - angle / 10.0).abs() < 1e-12, "{t}: {was:?}");
            // the hand is not interpolated: it stands at one of the notes
            let nearest = 2.0 * (t as f64 / 20.0).round();
            assert_eq!(was.tip.position.x, nearest, "{t}");
        }
    }

    #[test]
    fn before_the_first_and_after_the_last_note_it_is_there() {
        let mut past = Past::new((millis(40), state(4.0)), millis(100));
        assert_eq!(past.at(millis(10)), state(4.0));
        past.note(millis(60), state(6.0));
        assert_eq!(past.at(millis(10)), state(4.0));
        assert_eq!(past.at(millis(500)), state(6.0));
        assert_eq!(past.last(), &state(6.0));
    }

    /// What is 100 ms old is still known exactly, and memory does not grow.
    #[test]
    fn as_much_is_kept_as_pictures_may_be_old() {
        let past = past(10_000);
        let angle = past.at(millis(9_907)).joints[0];
        assert!((angle - 990.7).abs() < 1e-9, "{angle}");
        assert!(past.earlier.len() <= 7, "{}", past.earlier.len());
    }

    /// Two notes of one time: the later one counts from then on.
    #[test]
    fn time_may_stand_still() {
        let mut past = past(20);
        past.note(millis(20), state(9.0));
        assert_eq!(past.at(millis(20)), state(9.0));
        past.note(millis(40), state(11.0));
        assert_eq!(past.at(millis(30)).joints, [10.0]);
    }
}
