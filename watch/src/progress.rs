//! Progress and speed of a run.

use serde::Serialize;

use experiments::RunData;
use experiments::schedule::StreamClock;

/// Number of latest rollouts whose times give the current speed.
const RECENT: usize = 20;

/// Progress of a run and its speed, evaluations not included.
#[derive(Clone, Copy, Debug, PartialEq, Serialize)]
pub(super) struct StreamProgress {
    /// Number of decisions of the whole stream.
    #[serde(rename = "stream")]
    pub total_decisions: usize,
    /// Number of completed decisions, at most `total_decisions`. If the stream's clock counts
    /// turns, rollouts that a learner discarded do not count.
    #[serde(rename = "done")]
    pub completed_decisions: usize,
    /// Decisions per second in the latest rollouts; `None` if their times are not known.
    pub decisions_per_second: Option<f64>,
    /// Seconds until the stream ends at the current speed; `None` if it is not known.
    pub seconds_left: Option<f64>,
}

impl StreamProgress {
    /// Returns the progress and the speed of a run after its first `rollouts` rollouts.
    pub fn after_rollouts(run: &RunData, rollouts: usize) -> Self {
        let timed = &run.timings[..rollouts.min(run.timings.len())];
        let recent = &timed[timed.len().saturating_sub(RECENT)..];
        let seconds: f64 = recent.iter().map(|row| row.total).sum();
        let decisions: f64 = recent.iter().map(|row| row.decisions as f64).sum();
        let rate = |amount: f64| {
            let rate = Some(amount / seconds);
            rate.filter(|rate| rate.is_finite() && *rate > 0.0)
        };
        let (schedule, turn) = (&run.experiment.schedule, run.experiment.learner.rollout_steps());
        let newest = rollouts.checked_sub(1).and_then(|newest| run.rollouts.get(newest));
        // a discarded rollout takes time but does not advance a clock that counts turns
        let (done, advanced) = match schedule.clock {
            StreamClock::EnvironmentTime => (newest.map_or(0, |row| row.decisions), decisions),
            StreamClock::LearnerIterations => {
                (rollouts.saturating_mul(turn), (recent.len() * turn) as f64)
            }
        };
        let stream = schedule.total_decisions();
        let left = stream.saturating_sub(done) as f64;
        Self {
            total_decisions: stream,
            completed_decisions: done.min(stream),
            decisions_per_second: rate(decisions),
            seconds_left: rate(advanced).map(|rate| left / rate),
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use experiments::presets::{Budget, Method};
    use experiments::{RolloutRow, TimingRow};

    #[test]
    fn the_last_rollouts_say_how_long_the_rest_takes() {
        let mut run = RunData::empty("run", Budget::Smoke.preset_experiment(Method::Covers));
        let stream = run.experiment.schedule.total_decisions();
        let nothing = StreamProgress::after_rollouts(&run, 0);
        assert_eq!((nothing.total_decisions, nothing.seconds_left), (stream, None));
        for turn in 1..=40 {
            run.rollouts
                .push(RolloutRow { decisions: turn * stream / 80, ..RolloutRow::default() });
            // the first ones were slow
            let total = if turn > 20 { 0.5 } else { 50.0 };
            run.timings.push(TimingRow { decisions: 100, total, ..TimingRow::default() });
        }
        let now = StreamProgress::after_rollouts(&run, 40);
        assert_eq!(now.decisions_per_second, Some(200.0));
        assert_eq!(now.seconds_left, Some((stream - stream / 2) as f64 / 200.0));
        assert_eq!(StreamProgress::after_rollouts(&run, 20).decisions_per_second, Some(2.0));
        assert_eq!(
            (now.completed_decisions, StreamProgress::after_rollouts(&run, 0).completed_decisions),
            (stream / 2, 0)
        );
        // second looks do not bring the end nearer where the stream counts turns
        run.experiment.schedule.clock = StreamClock::LearnerIterations;
        let turn = run.experiment.learner.rollout_steps();
        let after_turns = StreamProgress::after_rollouts(&run, 2);
        assert_eq!(
            (after_turns.completed_decisions, after_turns.decisions_per_second),
            (2 * turn, Some(2.0))
        );
        let left = (stream - 2 * turn) as f64 / (turn as f64 / 50.0);
        assert!((after_turns.seconds_left.unwrap() / left - 1.0).abs() < 1e-12);
    }
}
