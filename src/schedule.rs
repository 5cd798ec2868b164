//! Which groups come when, and in which variants.

use envs::TaskGroup;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use serde::{Deserialize, Serialize};
use symmetry::D2;

use crate::CoversError;

/// The stream's plan: nothing of it is told to the learner.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Schedule {
    /// The groups of one cycle, each once.
    pub groups: Vec<GroupPlan>,
    /// Number of cycles, at least 1.
    pub cycles: usize,
    /// Who comes after whom.
    pub order: Order,
}

/// How one group appears in the stream.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct GroupPlan {
    /// The group.
    pub group: TaskGroup,
    /// Rollouts of a visit, at least 1; the mean number with [`Order::Switching`].
    pub rollouts: usize,
    /// Variants that episodes are drawn from; the others are held out and appear in evaluations alone.
    pub variants: Vec<D2>,
}

/// Who comes after whom.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Serialize, Deserialize)]
#[serde(rename_all = "lowercase")]
pub enum Order {
    /// Every cycle in the order of the list.
    Fixed,
    /// Every cycle in an order of its own; no group follows itself.
    Shuffled,
    /// No cycles: after each rollout the group gives way with a probability of 1 in `rollouts`, to any other with equal probability. The stream is
    /// as long as it would be with cycles.
    Switching,
}

/// One stay of a group.
#[derive(Clone, Debug, PartialEq)]
pub struct Visit {
    /// The group; known to the stream and to reports, never to the learner.
    pub group: TaskGroup,
    /// Variants that episodes are drawn from.
    pub variants: Vec<D2>,
    /// Rollouts until the next visit.
    pub rollouts: usize,
}

impl Schedule {
    /// All variants of the four groups, shuffled; `rollouts[i]` is the length of a visit of `TaskGroup::ALL[i]`.
    pub fn shuffled(cycles: usize, rollouts: [usize; 4]) -> Self {
        let groups = TaskGroup::ALL.into_iter().zip(rollouts);
        let groups = groups.map(|(group, rollouts)| GroupPlan {
            group,
            rollouts,
            variants: D2::ALL.to_vec(),
        });
        Self {
            groups: groups.collect(),
            cycles,
            order: Order::Shuffled,
        }
    }

    /// Refuses a plan without groups, cycles, rollouts or variants, and one that names a group twice.
    ///
    /// # Errors
    /// [`CoversError::Setting`].
    pub fn check(&self) -> Result<(), CoversError> {
        let setting = |name, value: String, expected| {
            Err(CoversError::Setting {
                name,
                value,
                expected,
            })
        };
        if self.groups.is_empty() {
            return setting("schedule.groups", "empty".to_owned(), "at least one group");
        }
        if self.cycles == 0 {
            return setting("schedule.cycles", "0".to_owned(), "at least 1");
        }
        for (index, plan) in self.groups.iter().enumerate() {
            let group = plan.group;
            if self.groups[..index]
                .iter()
                .any(|other| other.group == group)
            {
                let expected = "every group at most once";
                return setting("schedule.groups", format!("{group} twice"), expected);
            }
            if plan.rollouts == 0 {
                let expected = "at least 1 rollout of every group";
                return setting("schedule.groups", format!("0 of {group}"), expected);
            }
            if plan.variants.is_empty() {
                let expected = "at least one variant of every group";
                return setting("schedule.groups", format!("none of {group}"), expected);
            }
        }
        if self.order == Order::Switching && self.groups.len() == 1 {
            let expected = "at least two groups to switch between";
            return setting("schedule.order", "switching".to_owned(), expected);
        }
        Ok(())
    }

    /// Rollouts of the whole stream.
    pub fn total_rollouts(&self) -> usize {
        self.cycles * self.groups.iter().map(|plan| plan.rollouts).sum::<usize>()
    }

    /// Whether the learner meets this variant; evaluations show it all of them.
    pub fn shows(&self, group: TaskGroup, element: D2) -> bool {
        let plan = self.groups.iter().find(|plan| plan.group == group);
        plan.is_some_and(|plan| plan.variants.contains(&element))
    }

    /// Draws the visits of a stream; [`Schedule::check`] it first.
    pub fn visits(&self, rng: &mut ChaCha8Rng) -> Vec<Visit> {
        match self.order {
            Order::Fixed => (0..self.cycles)
                .flat_map(|_| self.groups.iter().map(GroupPlan::visit))
                .collect(),
            Order::Shuffled => self.shuffled_visits(rng),
            Order::Switching => self.switching_visits(rng),
        }
    }

    fn shuffled_visits(&self, rng: &mut ChaCha8Rng) -> Vec<Visit> {
        let mut visits: Vec<Visit> = Vec::with_capacity(self.groups.len() * self.cycles);
        for _ in 0..self.cycles {
            let mut order: Vec<usize> = (0..self.groups.len()).collect();
            for last in (1..order.len()).rev() {
                order.swap(last, rng.random_range(0..=last));
            }
            if visits.last().map(|visit| visit.group) == Some(self.groups[order[0]].group) {
                order.rotate_left(1);
            }
            visits.extend(order.into_iter().map(|i| self.groups[i].visit()));
        }
        visits
    }

    fn switching_visits(&self, rng: &mut ChaCha8Rng) -> Vec<Visit> {
        let others = self.groups.len() - 1;
        let mut current = rng.random_range(0..=others);
        let mut visits = vec![self.groups[current].empty_visit()];
        for rollout in 0..self.total_rollouts() {
            let leaves = rng.random_range(0..self.groups[current].rollouts) == 0;
            if rollout > 0 && leaves {
                current = (current + 1 + rng.random_range(0..others)) % self.groups.len();
                visits.push(self.groups[current].empty_visit());
            }
            if let Some(visit) = visits.last_mut() {
                visit.rollouts += 1;
            }
        }
        visits
    }
}

impl GroupPlan {
    fn visit(&self) -> Visit {
        Visit {
            rollouts: self.rollouts,
            ..self.empty_visit()
        }
    }

    fn empty_visit(&self) -> Visit {
        Visit {
            group: self.group,
            variants: self.variants.clone(),
            rollouts: 0,
        }
    }
}

#[cfg(test)]
mod tests {
    use std::collections::HashSet;

    use super::*;
    use rand::SeedableRng;

    fn visits(schedule: &Schedule, seed: u64) -> Vec<Visit> {
        schedule.visits(&mut ChaCha8Rng::seed_from_u64(seed))
    }

    fn never_twice_running(visits: &[Visit]) -> bool {
        visits.windows(2).all(|pair| pair[0].group != pair[1].group)
    }

    #[test]
    fn a_shuffled_stream_visits_every_group_each_cycle_and_never_twice_running() {
        let schedule = Schedule::shuffled(3, [1, 2, 3, 4]);
        for seed in 0..50 {
            let visits = visits(&schedule, seed);
            assert!(visits.len() == 12 && never_twice_running(&visits));
            for cycle in visits.chunks(4) {
                let groups: HashSet<_> = cycle.iter().map(|visit| visit.group).collect();
                assert_eq!(groups.len(), 4);
                assert_eq!(cycle.iter().map(|v| v.rollouts).sum::<usize>(), 10);
            }
        }
    }

    #[test]
    fn a_fixed_stream_repeats_its_list() {
        let schedule = Schedule {
            order: Order::Fixed,
            ..Schedule::shuffled(2, [1; 4])
        };
        let groups: Vec<_> = visits(&schedule, 0).iter().map(|v| v.group).collect();
        assert_eq!(groups, [TaskGroup::ALL, TaskGroup::ALL].concat());
    }

    #[test]
    fn a_switching_stream_is_as_long_and_its_visits_have_the_mean_length() {
        let schedule = Schedule {
            order: Order::Switching,
            ..Schedule::shuffled(500, [2, 8, 4, 2])
        };
        let visits = visits(&schedule, 1);
        assert!(never_twice_running(&visits));
        let lengths = |group| {
            let of_group = visits.iter().filter(move |visit| visit.group == group);
            of_group.map(|visit| visit.rollouts)
        };
        let total: usize = TaskGroup::ALL.into_iter().flat_map(lengths).sum();
        assert_eq!(total, schedule.total_rollouts());
        for plan in &schedule.groups {
            let count = lengths(plan.group).count() as f64;
            let mean = lengths(plan.group).sum::<usize>() as f64 / count;
            let expected = plan.rollouts as f64;
            assert!((mean / expected - 1.0).abs() < 0.15, "{mean} {expected}");
        }
    }

    #[test]
    fn held_out_variants_are_not_shown() {
        let mut schedule = Schedule::shuffled(1, [1; 4]);
        schedule.groups[0].variants = vec![D2::Identity];
        schedule.groups.truncate(3);
        assert!(schedule.shows(TaskGroup::GoalReach, D2::Identity));
        assert!(!schedule.shows(TaskGroup::GoalReach, D2::FlipX));
        assert!(schedule.shows(TaskGroup::ButtonPress, D2::FlipX));
        assert!(!schedule.shows(TaskGroup::PlateSlide, D2::Identity));
    }

    #[test]
    fn plans_that_make_no_stream_are_refused_by_name() {
        type Spoil = fn(&mut Schedule);
        let cases: [(Spoil, &str); 6] = [
            (|s| s.groups.clear(), "at least one group"),
            (|s| s.cycles = 0, "`schedule.cycles` is 0"),
            (|s| s.groups[1].rollouts = 0, "0 of button-press"),
            (|s| s.groups[2].variants.clear(), "none of drawer-close"),
            (
                |s| s.groups[3].group = TaskGroup::GoalReach,
                "goal-reach twice",
            ),
            (
                |s| {
                    s.order = Order::Switching;
                    s.groups.truncate(1);
                },
                "at least two groups",
            ),
        ];
        for (spoil, expected) in cases {
            let mut schedule = Schedule::shuffled(1, [1; 4]);
            assert!(schedule.check().is_ok());
            spoil(&mut schedule);
            let message = schedule.check().unwrap_err().to_string();
            assert!(message.contains(expected), "{message}");
        }
    }
}
