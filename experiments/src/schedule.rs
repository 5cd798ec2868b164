//! Schedule of a stream: order and length of the visits of task groups, and their variants.

use envs::{TaskGroup, TaskRegistry};
use learner::overrides::nearest;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use symmetry::D2;

use crate::error::RunError;

/// Largest number of decisions of a training stream, about two hundred times as many as the longest
/// preset has.
pub const MAX_STREAM_DECISIONS: usize = 288_000_000;

/// Plan of the training stream: task groups, cycles, order and clock, which the learner does not
/// see.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct TaskSchedule {
    /// Task groups of one cycle of the stream, each once.
    pub groups: Vec<GroupSchedule>,
    /// Number of cycles through the task groups, at least 1.
    pub cycles: usize,
    /// Order in which the training stream visits the task groups.
    pub order: VisitOrder,
    /// Clock that measures the length of the visits: decisions of the environments, or learner
    /// iterations.
    pub clock: StreamClock,
}

/// Unit in which the stream measures its visits to task groups.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum StreamClock {
    /// Environment time: every decision counts, also those of rollouts that a learner discards. The
    /// group changes at the first end of episodes after its visit, whatever the learner does, so a
    /// rollout may span a task switch. All learners see the same stream.
    #[default]
    #[serde(rename = "world")]
    EnvironmentTime,
    /// Iterations of the learner: each counts as the decisions of one rollout, and groups change
    /// only between iterations.
    #[serde(rename = "turns")]
    LearnerIterations,
}

/// Visits to one task group in the stream: their length and their variants.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GroupSchedule {
    /// Name of the visited task group.
    pub group: String,
    /// Number of decisions of a visit, at least 1; the mean number with [`VisitOrder::Switching`].
    pub decisions: usize,
    /// Variants that training episodes are drawn from; the others are held out for evaluations.
    pub variants: Vec<D2>,
}

/// Order in which the training stream visits the task groups.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum VisitOrder {
    /// Same order in every cycle: that of the schedule's list of task groups.
    Fixed,
    /// New random order in every cycle; no group follows itself.
    Shuffled,
    /// Random switches between groups instead of cycles. After every period the group may give way
    /// to any other group, each equally likely, with a probability that makes visits last
    /// `decisions` on average. The stream is as long as with cycles.
    Switching,
}

impl TaskSchedule {
    /// Creates a shuffled schedule on [`StreamClock::EnvironmentTime`] with all variants of these
    /// groups; each pair holds a group and the decisions of one visit.
    pub fn shuffled(cycles: usize, visits: &[(TaskGroup, usize)]) -> Self {
        let groups = visits.iter().map(|(group, decisions)| GroupSchedule {
            group: group.name().to_owned(),
            decisions: *decisions,
            variants: D2::ALL.to_vec(),
        });
        Self {
            groups: groups.collect(),
            cycles,
            order: VisitOrder::Shuffled,
            clock: StreamClock::default(),
        }
    }

    /// Rejects a plan without groups, cycles, decisions or variants, with a duplicate group or
    /// variant, longer than [`MAX_STREAM_DECISIONS`], or with random switches in a single group.
    ///
    /// # Errors
    /// [`RunError::InvalidSetting`].
    pub fn check(&self) -> Result<(), RunError> {
        if self.groups.is_empty() {
            return refuse("schedule.groups", "empty", "at least one group");
        }
        if self.cycles == 0 {
            return refuse("schedule.cycles", "0", "at least 1");
        }
        for (index, plan) in self.groups.iter().enumerate() {
            plan.check(&self.groups[..index])?;
        }
        if self.checked_decisions().is_none() {
            return refuse("schedule.cycles", &self.cycles.to_string(), "fewer: no run is so long");
        }
        if self.order == VisitOrder::Switching && self.groups.len() == 1 {
            let expected = "at least two groups to switch between";
            return refuse("schedule.order", "switching", expected);
        }
        Ok(())
    }

    /// Returns the number of decisions of the whole stream; [`MAX_STREAM_DECISIONS`] if it has
    /// more, which [`TaskSchedule::check`] rejects.
    pub fn total_decisions(&self) -> usize {
        self.checked_decisions().unwrap_or(MAX_STREAM_DECISIONS)
    }

    /// Returns the smallest number of decisions of one group in the stream; with
    /// [`VisitOrder::Switching`], whose visits are random, the whole stream.
    pub(crate) fn min_group_decisions(&self) -> usize {
        let shortest = self.groups.iter().map(|plan| plan.decisions).min().unwrap_or(0);
        match self.order {
            VisitOrder::Switching => self.total_decisions(),
            VisitOrder::Fixed | VisitOrder::Shuffled => shortest.saturating_mul(self.cycles),
        }
    }

    /// Returns the decisions of the whole stream; `None` above [`MAX_STREAM_DECISIONS`].
    fn checked_decisions(&self) -> Option<usize> {
        let mut visits = self.groups.iter().map(|plan| plan.decisions);
        let cycle = visits.try_fold(0, usize::checked_add)?;
        let total = cycle.checked_mul(self.cycles)?;
        (total <= MAX_STREAM_DECISIONS).then_some(total)
    }

    /// Returns the task groups of the schedule, looked up by their names in `tasks`.
    ///
    /// # Errors
    /// A name that `tasks` does not hold.
    pub fn resolve_groups(&self, tasks: &TaskRegistry) -> Result<Vec<TaskGroup>, RunError> {
        self.groups.iter().map(|plan| Ok(tasks.find(&plan.group)?)).collect()
    }

    /// Returns the scheduled task group called `name`, or all of them if `name` is `None`.
    ///
    /// # Errors
    /// [`RunError::UnknownGroup`] for a name that this schedule does not hold; a scheduled group
    /// that `tasks` does not hold.
    pub fn resolve_group_or_all(
        &self,
        name: Option<&str>,
        tasks: &TaskRegistry,
    ) -> Result<Vec<TaskGroup>, RunError> {
        let groups = self.resolve_groups(tasks)?;
        let Some(name) = name else {
            return Ok(groups);
        };
        match tasks.find(name) {
            Ok(chosen) if groups.contains(&chosen) => Ok(vec![chosen]),
            _ => {
                let names = || groups.iter().map(|group| group.name());
                Err(RunError::UnknownGroup {
                    name: name.to_owned(),
                    nearest: nearest(names(), name).map(str::to_owned),
                    groups: names().map(str::to_owned).collect(),
                })
            }
        }
    }

    /// Returns the index of the task group called `group` in the schedule, from which films and
    /// views derive its colour; `None` if it is not scheduled.
    pub fn group_index(&self, group: &str) -> Option<usize> {
        self.groups.iter().position(|plan| plan.group == group)
    }

    /// Returns `true` if training shows this variant of the group; evaluations show all of them.
    pub fn trains_on_variant(&self, group: &str, element: D2) -> bool {
        let plan = self.groups.iter().find(|plan| plan.group == group);
        plan.is_some_and(|plan| plan.variants.contains(&element))
    }

    /// Draws the visits of the whole training stream, in order. [`VisitOrder::Switching`] may
    /// switch groups every `period` decisions. The schedule must have passed
    /// [`TaskSchedule::check`].
    pub fn draw_visits(&self, period: usize, rng: &mut ChaCha8Rng) -> Vec<GroupSchedule> {
        match self.order {
            VisitOrder::Fixed => (0..self.cycles).flat_map(|_| self.groups.clone()).collect(),
            VisitOrder::Shuffled => self.shuffled_visits(rng),
            VisitOrder::Switching => self.switching_visits(period, rng),
        }
    }

    fn shuffled_visits(&self, rng: &mut ChaCha8Rng) -> Vec<GroupSchedule> {
        let mut visits: Vec<GroupSchedule> = Vec::with_capacity(self.groups.len() * self.cycles);
        for _ in 0..self.cycles {
            let mut order: Vec<usize> = (0..self.groups.len()).collect();
            for last in (1..order.len()).rev() {
                order.swap(last, rng.random_range(0..=last));
            }
            // a group that follows itself would be one long visit
            if visits.last().map(|visit| &visit.group) == Some(&self.groups[order[0]].group) {
                order.rotate_left(1);
            }
            visits.extend(order.into_iter().map(|i| self.groups[i].clone()));
        }
        visits
    }

    fn switching_visits(&self, period: usize, rng: &mut ChaCha8Rng) -> Vec<GroupSchedule> {
        let empty_visit =
            |group: usize| GroupSchedule { decisions: 0, ..self.groups[group].clone() };
        let others = self.groups.len() - 1;
        let mut current = rng.random_range(0..=others);
        let mut visits = vec![empty_visit(current)];
        for nth in 0..self.total_decisions().div_ceil(period) {
            let mean = self.groups[current].decisions.div_ceil(period);
            // leaving with probability 1 / mean gives visits of `mean` periods on average
            let leaves = rng.random_range(0..mean) == 0;
            if nth > 0 && leaves {
                current = (current + 1 + rng.random_range(0..others)) % self.groups.len();
                visits.push(empty_visit(current));
            }
            if let Some(visit) = visits.last_mut() {
                visit.decisions += period;
            }
        }
        visits
    }
}

fn refuse(name: &'static str, value: &str, expected: &'static str) -> Result<(), RunError> {
    Err(RunError::invalid(name, value, expected))
}

impl GroupSchedule {
    fn check(&self, before: &[Self]) -> Result<(), RunError> {
        let group = &self.group;
        let refuse = |value: String, expected| refuse("schedule.groups", &value, expected);
        if before.iter().any(|other| other.group == *group) {
            return refuse(format!("{group} twice"), "every group at most once");
        }
        if self.decisions == 0 {
            return refuse(format!("0 of {group}"), "at least 1 decision of every group");
        }
        if self.variants.is_empty() {
            let expected = "at least one variant of every group";
            return refuse(format!("none of {group}"), expected);
        }
        for (index, variant) in self.variants.iter().enumerate() {
            if self.variants[..index].contains(variant) {
                let value = format!("{variant} of {group} twice");
                return refuse(value, "every variant at most once");
            }
        }
        Ok(())
    }
}

/// Visits of a training stream to task groups, with the decisions at which they end.
#[derive(Clone, Debug)]
pub(crate) struct Timetable {
    visits: Vec<GroupSchedule>,
    /// Number of decisions from the start of the stream to the end of each visit.
    ends: Vec<usize>,
}

impl Timetable {
    pub fn new(visits: Vec<GroupSchedule>) -> Self {
        let mut end = 0;
        let ends = visits.iter().map(|visit| {
            end += visit.decisions;
            end
        });
        Self { ends: ends.collect(), visits }
    }

    /// Returns the index of the visit to which decision number `decision`, from 0, belongs; `None`
    /// after the last visit.
    pub fn visit_index_at(&self, decision: usize) -> Option<usize> {
        let index = self.ends.partition_point(|&end| end <= decision);
        (index < self.visits.len()).then_some(index)
    }

    /// Returns the visit to a task group with index `index`, and all earlier visits.
    pub fn visit_and_earlier(&self, index: usize) -> (&GroupSchedule, &[GroupSchedule]) {
        (&self.visits[index], &self.visits[..index])
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use rand::SeedableRng;
    use std::collections::HashSet;

    fn shuffled(cycles: usize, decisions: [usize; 4]) -> TaskSchedule {
        let visits: Vec<_> = TaskGroup::STANDARD.into_iter().zip(decisions).collect();
        TaskSchedule::shuffled(cycles, &visits)
    }

    fn visits(schedule: &TaskSchedule, seed: u64) -> Vec<GroupSchedule> {
        schedule.draw_visits(1, &mut ChaCha8Rng::seed_from_u64(seed))
    }

    fn never_twice_running(visits: &[GroupSchedule]) -> bool {
        visits.windows(2).all(|pair| pair[0].group != pair[1].group)
    }

    #[test]
    fn a_shuffled_stream_visits_every_group_each_cycle_and_never_twice_running() {
        let schedule = shuffled(3, [1, 2, 3, 4]);
        for seed in 0..50 {
            let visits = visits(&schedule, seed);
            assert!(visits.len() == 12 && never_twice_running(&visits));
            for cycle in visits.chunks(4) {
                let groups: HashSet<_> = cycle.iter().map(|visit| &visit.group).collect();
                assert_eq!(groups.len(), 4);
                assert_eq!(cycle.iter().map(|v| v.decisions).sum::<usize>(), 10);
            }
        }
    }

    #[test]
    fn a_fixed_stream_repeats_its_list() {
        let schedule = TaskSchedule { order: VisitOrder::Fixed, ..shuffled(2, [1; 4]) };
        let groups = visits(&schedule, 0).into_iter().map(|visit| visit.group);
        let groups: Vec<String> = groups.collect();
        let names = TaskGroup::STANDARD.map(|group| group.name().to_owned());
        assert_eq!(groups, [names.clone(), names].concat());
    }

    #[test]
    fn a_switching_stream_is_as_long_and_its_visits_have_the_mean_length() {
        let schedule = TaskSchedule { order: VisitOrder::Switching, ..shuffled(500, [2, 8, 4, 2]) };
        let visits = visits(&schedule, 1);
        assert!(never_twice_running(&visits));
        let total: usize = visits.iter().map(|visit| visit.decisions).sum();
        assert_eq!(total, schedule.total_decisions());
        for plan in &schedule.groups {
            let of_group = visits.iter().filter(|visit| visit.group == plan.group);
            let lengths: Vec<usize> = of_group.map(|visit| visit.decisions).collect();
            let mean = lengths.iter().sum::<usize>() as f64 / lengths.len() as f64;
            let expected = plan.decisions as f64;
            assert!((mean / expected - 1.0).abs() < 0.15, "{mean} {expected}");
        }
    }

    #[test]
    fn held_out_variants_are_not_shown() {
        let mut schedule = shuffled(1, [1; 4]);
        schedule.groups[0].variants = vec![D2::Identity];
        schedule.groups.truncate(3);
        assert!(schedule.trains_on_variant("goal-reach", D2::Identity));
        assert!(!schedule.trains_on_variant("goal-reach", D2::FlipX));
        assert!(schedule.trains_on_variant("button-press", D2::FlipX));
        assert!(!schedule.trains_on_variant("plate-slide", D2::Identity));
    }

    #[test]
    fn plans_that_make_no_stream_are_refused_by_name() {
        type Spoil = fn(&mut TaskSchedule);
        let cases: [(Spoil, &str); 8] = [
            (|s| s.groups.clear(), "at least one group"),
            (|s| s.cycles = 0, "`schedule.cycles` is 0"),
            (|s| s.cycles = usize::MAX, "no run is so long"),
            (|s| s.groups[1].decisions = 0, "0 of button-press"),
            (|s| s.groups[2].variants.clear(), "none of drawer-close"),
            (|s| s.groups[2].variants.push(D2::FlipX), "flip x of drawer-close twice"),
            (|s| s.groups[3].group = "goal-reach".to_owned(), "goal-reach twice"),
            (
                |s| {
                    s.order = VisitOrder::Switching;
                    s.groups.truncate(1);
                },
                "at least two groups",
            ),
        ];
        for (spoil, expected) in cases {
            let mut schedule = shuffled(1, [1; 4]);
            assert!(schedule.check().is_ok());
            spoil(&mut schedule);
            let message = schedule.check().unwrap_err().to_string();
            assert!(message.contains(expected), "{message}");
        }
    }

    #[test]
    fn names_are_resolved_and_unknown_ones_refused_with_the_known() {
        let mut schedule = shuffled(1, [1; 4]);
        let tasks = TaskRegistry::with_standard();
        let groups = schedule.resolve_groups(&tasks).unwrap();
        assert_eq!(groups, TaskGroup::STANDARD);
        schedule.groups[1].group = "peg-insert".to_owned();
        let message = schedule.resolve_groups(&tasks).unwrap_err().to_string();
        assert!(message.contains("peg-insert") && message.contains("drawer-close"));
    }

    #[test]
    fn a_visit_ends_where_the_next_begins() {
        let visit = |decisions: usize| GroupSchedule {
            group: decisions.to_string(),
            variants: Vec::new(),
            decisions,
        };
        let timetable = Timetable::new(vec![visit(3), visit(2)]);
        let indices: Vec<_> = (0..6).map(|at| timetable.visit_index_at(at)).collect();
        let expected = [Some(0), Some(0), Some(0), Some(1), Some(1), None];
        assert_eq!(indices, expected);
        let (second, before) = timetable.visit_and_earlier(1);
        assert_eq!((second.decisions, before.len()), (2, 1));
    }
}
