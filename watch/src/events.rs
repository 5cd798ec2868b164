//! Events of a run, rollouts and evaluations, in the order in which they happened.

use serde::Serialize;
use serde_json::Value;
use symmetry::D2;

use experiments::evaluation::mean;
use experiments::text::{RolloutLine, format_number};
use experiments::{RolloutRow, RunData, ScoreRow};
use itertools::Itertools;

use super::progress::StreamProgress;

/// Position of an event in a run: the number of rollouts before its end, then 0 for a rollout and 1
/// for an evaluation, which comes after the rollout.
type Moment = (usize, u8);

/// Event of a run that `covers watch` prints: a rollout, an evaluation, or the end of the run.
#[derive(Clone, Debug, Serialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub(super) enum RunEvent<'a> {
    /// Training iteration of the learner with one rollout.
    Rollout {
        /// Index of the rollout in the run, from 0.
        rollout: usize,
        #[serde(flatten)]
        row: &'a RolloutRow,
        /// Thresholds of the rollout's distances from stored frames, one for each policy.
        thresholds: Vec<Option<f64>>,
        #[serde(flatten)]
        progress: StreamProgress,
    },
    /// Evaluation of the learner on all task variants.
    Evaluation { rollouts: usize, decisions: usize, scores: Vec<&'a ScoreRow> },
    /// End of the run, with the contents of its summary.
    Finished { summary: Value },
}

impl RunEvent<'_> {
    /// Returns the event as a line of text; for a rollout, the line that `covers train` prints.
    pub fn text_line(&self) -> String {
        match self {
            Self::Rollout { row, .. } => rollout(row).to_string(),
            Self::Evaluation { decisions, scores, .. } => {
                format!("{decisions:>9}  evaluation    {}", successes(scores))
            }
            Self::Finished { summary } => {
                let figure = |name: &str| format_number(summary[name].as_f64(), 3);
                format!(
                    "finished: {} policies, assignment accuracy {} ({} when groups come back)",
                    summary["policies"],
                    figure("assignment_accuracy"),
                    figure("return_accuracy")
                )
            }
        }
    }

    /// Returns the event as a line of JSON.
    pub fn json_line(&self) -> String {
        serde_json::json!(self).to_string()
    }
}

fn rollout(row: &RolloutRow) -> RolloutLine<'_> {
    let scores = row.permutation_z_scores.iter().copied().chain(std::iter::repeat(None));
    RolloutLine {
        decisions: row.decisions,
        group: &row.group,
        policy: row.policy,
        policy_created: row.created_policy,
        needed_second_rollout: row.compared_rollouts.is_some_and(|looks| looks > 1.0),
        reward: row.reward,
        success: row.success,
        distances_and_z_scores: row.distances.iter().copied().zip(scores).collect(),
    }
}

/// Formats the mean success of each group's variants. If other policies than the groups' own
/// played, the success of their own policies follows.
fn successes(scores: &[&ScoreRow]) -> String {
    let of = |figure: fn(&ScoreRow) -> Option<f64>| {
        let groups: Vec<&str> = scores.iter().map(|row| row.group.as_str()).unique().collect();
        let success = |group: &str| {
            let rows = scores.iter().filter(|row| row.group == group);
            let figures: Option<Vec<f64>> = rows.map(|row| figure(row)).collect();
            format!("{group} {}", format_number(figures.map(|own| mean(&own)), 2))
        };
        let successes: Vec<String> = groups.into_iter().map(success).collect();
        format!("[{}]", successes.join(", "))
    };
    let success = format!("success {}", of(|row| Some(row.success)));
    match scores.iter().filter(|row| row.is_policy_mismatch()).count() {
        0 => success,
        mismatches => format!(
            "{success}, {mismatches} of {} variants by another policy than the group's own, own \
             policies {}",
            scores.len(),
            of(|row| row.own_success)
        ),
    }
}

/// Feed of a run's events that returns each event once.
#[derive(Debug, Default)]
pub(super) struct EventFeed {
    /// Position of the last event that was returned.
    last: Option<Moment>,
}

impl EventFeed {
    /// Returns the events since the last call, in order. A run that was resumed from an earlier
    /// checkpoint repeats the events of the rollouts that it repeats.
    pub fn new_events<'a>(&mut self, run: &'a RunData) -> Vec<RunEvent<'a>> {
        let mut all = events(run);
        all.sort_by_key(|(moment, _)| *moment);
        let newest = all.last().map(|(moment, _)| *moment);
        let returned = self.last.replace(newest.unwrap_or_default());
        // after a resume from an earlier checkpoint, the run may have fewer events than were
        // returned
        let returned = returned.min(newest);
        if newest.is_none() {
            self.last = None;
        }
        all.retain(|(moment, _)| Some(*moment) > returned);
        all.into_iter().map(|(_, event)| event).collect()
    }
}

/// Returns all events of a run: the rollouts, then the evaluations.
fn events(run: &RunData) -> Vec<(Moment, RunEvent<'_>)> {
    let rollout_events = run.rollouts.iter().enumerate().map(|(rollout, row)| {
        let event = RunEvent::Rollout {
            rollout,
            row,
            thresholds: run.policy_distance_thresholds(row),
            progress: StreamProgress::after_rollouts(run, rollout + 1),
        };
        ((rollout + 1, 0), event)
    });
    // skip an evaluation that is still being written: it has fewer rows than there are variants
    let variants = run.experiment.schedule.groups.len() * D2::ALL.len();
    let evaluations = run.rollouts_before_evaluations().filter_map(|rollouts| {
        let scores: Vec<&ScoreRow> = run.scores_after(Some(rollouts)).collect();
        let decisions = scores.first()?.decisions;
        let whole = scores.len() >= variants;
        let event = RunEvent::Evaluation { rollouts, decisions, scores };
        whole.then_some(((rollouts, 1), event))
    });
    rollout_events.chain(evaluations).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use experiments::presets::{Budget, Method};

    fn run(rollouts: usize) -> RunData {
        let mut run = RunData::empty("run", Budget::Smoke.preset_experiment(Method::Covers));
        run.experiment.schedule.groups.truncate(1);
        run.rollouts = (1..=rollouts)
            .map(|turn| RolloutRow {
                decisions: 500 * turn,
                group: "goal-reach".to_owned(),
                created_policy: turn == 1,
                compared_rollouts: Some(2.0),
                distances: vec![Some(0.5), None],
                permutation_z_scores: vec![Some(2.0)],
                reward: Some(f64::NAN),
                ..RolloutRow::default()
            })
            .collect();
        run
    }

    #[test]
    fn a_group_is_printed_once_wherever_its_variants_stand() {
        let mut run = run(1);
        evaluate(&mut run, 1, 4);
        run.scores[1].group = "drawer-close".to_owned();
        run.scores[1].success = 0.25;
        let scores: Vec<&ScoreRow> = run.scores.iter().collect();
        let expected = "success [goal-reach 0.50, drawer-close 0.25]";
        assert_eq!(successes(&scores), expected);
    }

    fn evaluate(run: &mut RunData, rollouts: usize, variants: usize) {
        for element in &D2::ALL[..variants] {
            run.scores.push(ScoreRow {
                rollouts,
                decisions: 500 * rollouts,
                group: "goal-reach".to_owned(),
                element: element.to_string(),
                success: 0.5,
                ..ScoreRow::default()
            });
        }
    }

    fn moments(feed: &mut EventFeed, run: &RunData) -> Vec<String> {
        let events = feed.new_events(run);
        events.iter().map(|event| event.text_line()[..21].trim().to_owned()).collect()
    }

    #[test]
    fn all_events_are_returned_once_and_in_order() {
        let (mut feed, mut growing) = (EventFeed::default(), run(0));
        assert!(feed.new_events(&growing).is_empty());
        evaluate(&mut growing, 0, 4);
        assert_eq!(moments(&mut feed, &growing), ["0  evaluation"]);
        growing.rollouts = run(2).rollouts;
        evaluate(&mut growing, 1, 4);
        let expected = ["500  goal-reach", "500  evaluation", "1000  goal-reach"];
        assert_eq!(moments(&mut feed, &growing), expected);
        evaluate(&mut growing, 2, 3);
        assert!(feed.new_events(&growing).is_empty(), "a variant is to come");
        assert!(moments(&mut EventFeed::default(), &run(1)) == ["500  goal-reach"]);
    }

    #[test]
    fn a_run_that_was_resumed_from_an_earlier_checkpoint_repeats_events() {
        let mut feed = EventFeed::default();
        assert_eq!(feed.new_events(&run(3)).len(), 3);
        assert!(feed.new_events(&run(1)).is_empty());
        assert_eq!(feed.new_events(&run(2)).len(), 1);
        assert!(feed.new_events(&run(0)).is_empty());
        assert_eq!(feed.new_events(&run(2)).len(), 2);
    }

    /// Checks a run in which one of four variants is played by another group's policy.
    #[test]
    fn both_scores_are_printed_if_another_policy_played() {
        let mut run = run(1);
        evaluate(&mut run, 1, 4);
        for (variant, row) in run.scores.iter_mut().enumerate() {
            row.policy = Some(usize::from(variant == 2));
            row.own_policy = Some(0);
            row.own_success = Some(if variant == 2 { 0.9 } else { row.success });
        }
        let line = EventFeed::default().new_events(&run)[1].text_line();
        let expected = "success [goal-reach 0.50], 1 of 4 variants by another policy than the \
            group's own, own policies [goal-reach 0.60]";
        assert!(line.ends_with(expected), "{line}");
        run.scores[2].policy = Some(0);
        let own_line = EventFeed::default().new_events(&run)[1].text_line();
        assert!(own_line.ends_with("success [goal-reach 0.50]"), "{own_line}");
    }

    #[test]
    fn what_is_no_number_is_a_dash_and_no_value() {
        let run = run(2);
        let events = EventFeed::default().new_events(&run);
        let line = events[1].text_line();
        assert!(line.contains("     0 2nd       -"), "{line}");
        assert!(line.ends_with("  0.50 (2.0), -"), "{line}");
        assert!(events[0].text_line().contains("     0 new "));
        let json: Value = serde_json::from_str(&events[1].json_line()).unwrap();
        assert_eq!((&json["event"], &json["rollout"]), (&"rollout".into(), &1.into()));
        assert_eq!(json["reward"], Value::Null);
        assert_eq!(json["distances"][0], 0.5);
        assert!(json["stream"].as_u64() > Some(0) && json["seconds_left"].is_null());
    }

    #[test]
    fn the_end_has_figures() {
        let summary = serde_json::json!({"policies": 4, "assignment_accuracy": 1.0});
        let line = RunEvent::Finished { summary }.text_line();
        let expected = "finished: 4 policies, assignment accuracy 1.000 (- when groups come back)";
        assert_eq!(line, expected);
    }
}
