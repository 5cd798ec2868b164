//! Recording of the stream from a run's tables: groups, policies, success, distances.

use re_sdk_types::archetypes::{Scalars, SeriesLines, StateChange, StateConfiguration};
use re_sdk_types::components::Color;

use covers::RunError;
use covers::experiments::colours::curve_rgb;
use covers::experiments::{RolloutRow, RunData};

use crate::recording::{ROLLOUTS, Recording, STREAM};

/// Records every rollout and evaluation in a run's tables.
pub(crate) fn record(run: &RunData, recording: &Recording) -> Result<(), RunError> {
    let (groups, policies) = (groups(run), policies(run));
    recording.log_static("stream/group", &lane(&groups))?;
    recording.log_static("stream/policy", &lane(&policies))?;
    for (group, colour) in &groups {
        line(&format!("stream/evaluation/{group}"), *colour, 2.0, recording)?;
    }
    for (policy, (_, colour)) in policies.iter().enumerate() {
        line(&format!("stream/distance/{policy}"), *colour, 2.0, recording)?;
        line(&format!("stream/threshold/{policy}"), *colour, 0.5, recording)?;
    }
    let mut begin = 0;
    for (rollout, row) in run.rollouts.iter().enumerate() {
        // group and policy hold from a rollout's beginning on, its values are known at its end
        recording.set_time(&[(ROLLOUTS, rollout), (STREAM, begin)]);
        recording.log("stream/group", &StateChange::single(&*row.group))?;
        let policy = StateChange::single(policy_name(row.policy));
        recording.log("stream/policy", &policy)?;
        recording.set_time(&[(ROLLOUTS, rollout + 1), (STREAM, row.decisions)]);
        figures(run, row, recording)?;
        begin = row.decisions;
    }
    for rollouts in run.rollouts_before_evaluations() {
        for (group, _) in &groups {
            let scored = run.mean_group_score_after(rollouts, group, |row| row.success);
            if let Some((decisions, success)) = scored {
                recording.set_time(&[(ROLLOUTS, rollouts), (STREAM, decisions)]);
                let success = Scalars::single(success);
                recording.log(&format!("stream/evaluation/{group}"), &success)?;
            }
        }
    }
    Ok(())
}

/// Records the values of a rollout, at its end. Values that are missing or not finite are left out.
fn figures(run: &RunData, row: &RolloutRow, recording: &Recording) -> Result<(), RunError> {
    let log = |place: &str, value: Option<f64>| match value.filter(|value| value.is_finite()) {
        Some(value) => recording.log(place, &Scalars::single(value)),
        None => Ok(()),
    };
    log("stream/reward", row.reward)?;
    log("stream/success", row.success)?;
    for (policy, distance) in row.distances.iter().enumerate() {
        log(&format!("stream/distance/{policy}"), *distance)?;
    }
    for (policy, threshold) in run.policy_distance_thresholds(row).into_iter().enumerate() {
        log(&format!("stream/threshold/{policy}"), threshold)?;
    }
    Ok(())
}

type Value = (String, [u8; 3]);

/// Colour of a policy that was not trained on any rollout of one group alone.
const GREY: [u8; 3] = [0x80; 3];

/// Returns the groups of the run with the colours that reports use.
fn groups(run: &RunData) -> Vec<Value> {
    let plans = run.experiment.schedule.groups.iter().enumerate();
    let named = plans.map(|(number, plan)| (plan.group.clone(), curve_rgb(number)));
    named.collect()
}

/// Returns the policies, each in the colour of the group that it was opened for.
fn policies(run: &RunData) -> Vec<Value> {
    let coloured = |policy| {
        let schedule = &run.experiment.schedule;
        let number = run.group_of_policy(policy).and_then(|group| schedule.group_index(group));
        (policy_name(policy), number.map_or(GREY, curve_rgb))
    };
    (0..run.policy_count()).map(coloured).collect()
}

fn policy_name(policy: usize) -> String {
    format!("policy {policy}")
}

/// Sets the style of the curve at an entity path: a line of this colour and width (points).
fn line(
    place: &str,
    [r, g, b]: [u8; 3],
    width: f32,
    recording: &Recording,
) -> Result<(), RunError> {
    let style = SeriesLines::new().with_colors([Color::from_rgb(r, g, b)]);
    recording.log_static(place, &style.with_widths([width]))
}

/// Returns the names and colours of the states of a lane.
fn lane(values: &[Value]) -> StateConfiguration {
    let names = values.iter().map(|(name, _)| name.as_str());
    let colours = values.iter().map(|&(_, [r, g, b])| Color::from_rgb(r, g, b));
    StateConfiguration::new().with_values(names).with_colors(colours)
}
