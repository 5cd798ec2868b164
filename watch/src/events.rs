//! What is told of a run, one thing after the other.

use serde::Serialize;
use serde_json::Value;
use symmetry::D2;

use experiments::evaluation::mean;
use experiments::text::{RolloutLine, number};
use experiments::{RolloutRow, RunData, ScoreRow};
use itertools::Itertools;

use super::pace::Pace;

/// Where an event stands in a run: how many rollouts there were, and, of two after the same
/// rollout, the evaluation second.
type Moment = (usize, u8);

/// One thing that a run's tables tell.
#[derive(Clone, Debug, Serialize)]
#[serde(tag = "event", rename_all = "snake_case")]
pub(super) enum Told<'a> {
    /// The learner learnt from a rollout.
    Rollout {
        rollout: usize,
        #[serde(flatten)]
        row: &'a RolloutRow,
        thresholds: Vec<Option<f64>>,
        #[serde(flatten)]
        pace: Pace,
    },
    /// All variants were scored.
    Evaluation { rollouts: usize, decisions: usize, scores: Vec<&'a ScoreRow> },
    /// The run is at its end; these are its figures.
    Finished { summary: Value },
}

impl Told<'_> {
    /// A line that a person reads: of a rollout the one that `covers train` prints.
    pub fn line(&self) -> String {
        match self {
            Self::Rollout { row, .. } => rollout(row).to_string(),
            Self::Evaluation { decisions, scores, .. } => {
                format!("{decisions:>7}  evaluation    {}", successes(scores))
            }
            Self::Finished { summary } => {
                let figure = |name: &str| number(summary[name].as_f64(), 3);
                format!(
                    "finished: {} policies, assignment accuracy {} ({} when groups come back)",
                    summary["policies"],
                    figure("assignment_accuracy"),
                    figure("return_accuracy")
                )
            }
        }
    }

    /// A line that a program reads.
    pub fn json(&self) -> String {
        serde_json::json!(self).to_string()
    }
}

fn rollout(row: &RolloutRow) -> RolloutLine<'_> {
    let scores = row.scores.iter().copied().chain(std::iter::repeat(None));
    RolloutLine {
        decisions: row.decisions,
        group: &row.group,
        policy: row.policy,
        created: row.created,
        second_look: row.looks.is_some_and(|looks| looks > 1.0),
        reward: row.reward,
        success: row.success,
        evidence: row.distances.iter().copied().zip(scores).collect(),
    }
}

/// The mean success of each group's variants, and that of the groups' own policies where other ones
/// played.
fn successes(scores: &[&ScoreRow]) -> String {
    let of = |figure: fn(&ScoreRow) -> Option<f64>| {
        let groups: Vec<&str> = scores.iter().map(|row| row.group.as_str()).unique().collect();
        let success = |group: &str| {
            let rows = scores.iter().filter(|row| row.group == group);
            let figures: Option<Vec<f64>> = rows.map(|row| figure(row)).collect();
            format!("{group} {}", number(figures.map(|own| mean(&own)), 2))
        };
        let successes: Vec<String> = groups.into_iter().map(success).collect();
        format!("[{}]", successes.join(", "))
    };
    let success = format!("success {}", of(|row| Some(row.success)));
    match scores.iter().filter(|row| row.is_mismatch()).count() {
        0 => success,
        mismatches => format!(
            "{success}, {mismatches} of {} variants by another policy than the group's own, own \
             policies {}",
            scores.len(),
            of(|row| row.own_success)
        ),
    }
}

/// Remembers what was told.
#[derive(Debug, Default)]
pub(super) struct Teller {
    last: Option<Moment>,
}

impl Teller {
    /// What was not told yet, in order. A run that went on from an earlier checkpoint tells again
    /// what it does again.
    pub fn news<'a>(&mut self, run: &'a RunData) -> Vec<Told<'a>> {
        let mut all = events(run);
        all.sort_by_key(|(moment, _)| *moment);
        let newest = all.last().map(|(moment, _)| *moment);
        let told = self.last.replace(newest.unwrap_or_default());
        // of a run that was set back there is less than was told
        let told = told.min(newest);
        if newest.is_none() {
            self.last = None;
        }
        all.retain(|(moment, _)| Some(*moment) > told);
        all.into_iter().map(|(_, event)| event).collect()
    }
}

fn events(run: &RunData) -> Vec<(Moment, Told<'_>)> {
    let rollouts = run.rollouts.iter().enumerate().map(|(rollout, row)| {
        let told = Told::Rollout {
            rollout,
            row,
            thresholds: run.thresholds(row),
            pace: Pace::after(run, rollout + 1),
        };
        ((rollout + 1, 0), told)
    });
    // an evaluation that is being written has fewer variants
    let variants = run.experiment.schedule.groups.len() * D2::ALL.len();
    let evaluations = run.evaluated().filter_map(|rollouts| {
        let scores: Vec<&ScoreRow> = run.evaluation(Some(rollouts)).collect();
        let decisions = scores.first()?.decisions;
        let whole = scores.len() >= variants;
        let event = Told::Evaluation { rollouts, decisions, scores };
        whole.then_some(((rollouts, 1), event))
    });
    rollouts.chain(evaluations).collect()
}

#[cfg(test)]
mod tests {
    use super::*;
    use experiments::presets::{Budget, Method};

    /// A run of one group with so many rollouts.
    fn run(rollouts: usize) -> RunData {
        let mut run = RunData::empty("run", Budget::Smoke.experiment(Method::Covers));
        run.experiment.schedule.groups.truncate(1);
        run.rollouts = (1..=rollouts)
            .map(|turn| RolloutRow {
                decisions: 500 * turn,
                group: "goal-reach".to_owned(),
                created: turn == 1,
                looks: Some(2.0),
                distances: vec![Some(0.5), None],
                scores: vec![Some(2.0)],
                reward: Some(f64::NAN),
                ..RolloutRow::default()
            })
            .collect();
        run
    }

    #[test]
    fn a_group_is_told_once_wherever_its_variants_stand() {
        let mut run = run(1);
        evaluate(&mut run, 1, 4);
        run.scores[1].group = "drawer-close".to_owned();
        run.scores[1].success = 0.25;
        let scores: Vec<&ScoreRow> = run.scores.iter().collect();
        let told = "success [goal-reach 0.50, drawer-close 0.25]";
        assert_eq!(successes(&scores), told);
    }

    fn evaluate(run: &mut RunData, rollouts: usize, variants: usize) {
        for element in &D2::ALL[..variants] {
            run.scores.push(ScoreRow {
                rollouts,
                decisions: 500 * rollouts,
                group: "goal-reach".to_owned(),
                element: element.to_string(),
                seen: true,
                episodes: 5,
                success: 0.5,
                success_at_end: 0.5,
                reward: 100.0,
                ..ScoreRow::default()
            });
        }
    }

    fn moments(teller: &mut Teller, run: &RunData) -> Vec<String> {
        let news = teller.news(run);
        news.iter().map(|told| told.line()[..19].trim().to_owned()).collect()
    }

    #[test]
    fn all_is_told_once_and_in_order() {
        let (mut teller, mut growing) = (Teller::default(), run(0));
        assert!(teller.news(&growing).is_empty());
        evaluate(&mut growing, 0, 4);
        assert_eq!(moments(&mut teller, &growing), ["0  evaluation"]);
        growing.rollouts = run(2).rollouts;
        evaluate(&mut growing, 1, 4);
        let expected = ["500  goal-reach", "500  evaluation", "1000  goal-reach"];
        assert_eq!(moments(&mut teller, &growing), expected);
        evaluate(&mut growing, 2, 3);
        assert!(teller.news(&growing).is_empty(), "a variant is to come");
        assert!(moments(&mut Teller::default(), &run(1)) == ["500  goal-reach"]);
    }

    #[test]
    fn a_run_that_was_set_back_tells_again_what_it_does_again() {
        let mut teller = Teller::default();
        assert_eq!(teller.news(&run(3)).len(), 3);
        assert!(teller.news(&run(1)).is_empty());
        assert_eq!(teller.news(&run(2)).len(), 1);
        assert!(teller.news(&run(0)).is_empty());
        assert_eq!(teller.news(&run(2)).len(), 2);
    }

    /// One of four variants is played by another policy than the group's own.
    #[test]
    fn both_scores_are_told_where_another_policy_played() {
        let mut run = run(1);
        evaluate(&mut run, 1, 4);
        for (variant, row) in run.scores.iter_mut().enumerate() {
            row.policy = Some(usize::from(variant == 2));
            row.own_policy = Some(0);
            row.own_success = Some(if variant == 2 { 0.9 } else { row.success });
        }
        let line = Teller::default().news(&run)[1].line();
        let expected = "success [goal-reach 0.50], 1 of 4 variants by another policy than the \
            group's own, own policies [goal-reach 0.60]";
        assert!(line.ends_with(expected), "{line}");
        run.scores[2].policy = Some(0);
        let line = Teller::default().news(&run)[1].line();
        assert!(line.ends_with("success [goal-reach 0.50]"), "{line}");
    }

    #[test]
    fn what_is_no_number_is_a_dash_and_no_value() {
        let run = run(2);
        let news = Teller::default().news(&run);
        let line = news[1].line();
        assert!(line.contains("policy 0 2nd  reward     -"), "{line}");
        assert!(line.ends_with("W1 [0.50 (z 2.0), -]"), "{line}");
        assert!(news[0].line().contains("policy 0 new"));
        let json: Value = serde_json::from_str(&news[1].json()).unwrap();
        assert_eq!((&json["event"], &json["rollout"]), (&"rollout".into(), &1.into()));
        assert_eq!(json["reward"], Value::Null);
        assert_eq!(json["distances"][0], 0.5);
        assert!(json["stream"].as_u64() > Some(0) && json["seconds_left"].is_null());
    }

    #[test]
    fn the_end_has_figures() {
        let summary = serde_json::json!({"policies": 4, "assignment_accuracy": 1.0});
        let line = Told::Finished { summary }.line();
        let expected = "finished: 4 policies, assignment accuracy 1.000 (- when groups come back)";
        assert_eq!(line, expected);
    }
}
