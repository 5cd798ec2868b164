//! The stream on a clock: it does not wait for the learner.

use envs::TaskRegistry;
use rl::{BoxError, EnvSpec, Observations, Outcome, Transition, VectorEnv};

use crate::error::RunError;
use crate::experiment::{Experiment, Seeds};
use crate::glimpse::Glimpse;
use crate::schedule::{Clock, Timetable, Visit};
use crate::stream::Stream;
use learner::Labels;

/// The stream of one experiment.
///
/// On the world's clock, what comes depends on the number of decisions so far and on nothing else:
/// group, variants and placements are drawn anew from it whenever all episodes end.
pub(crate) struct World {
    stream: Stream,
    tasks: TaskRegistry,
    timetable: Timetable,
    seeds: Seeds,
    clock: Clock,
    /// Decisions of a rollout, by which turns are counted.
    rollout: usize,
    /// Decisions so far.
    now: usize,
    /// Index of the visit that runs.
    running: usize,
    /// What the turn showed so far; nothing before its first step.
    shown: Option<Shown>,
    labels: Labels,
    /// Steps since all episodes began.
    steps: usize,
    /// Whether episodes stand at their beginning, as the clock left them.
    is_begun: bool,
    /// Their first observations, for a learner that asks for a reset then.
    begun: Observations,
    /// Where pictures are left, if somebody looks on.
    glimpse: Option<Glimpse>,
}

/// The visits that one turn showed, by their indices.
#[derive(Clone, Copy, Debug)]
struct Shown {
    first: usize,
    last: usize,
    straddles: bool,
}

impl World {
    /// The stream of `experiment` after `decisions` decisions. It writes the name of the group that
    /// it shows to `labels`.
    ///
    /// # Errors
    /// A group that `tasks` does not hold, or what the environments say.
    pub fn new(
        experiment: &Experiment,
        tasks: &TaskRegistry,
        labels: Labels,
        decisions: usize,
    ) -> Result<Self, RunError> {
        let groups = experiment.schedule.resolve(tasks)?;
        let stream = Stream::new(experiment.envs, &groups)?;
        Ok(Self {
            begun: Observations::new(stream.spec()),
            is_begun: false,
            stream,
            tasks: tasks.clone(),
            timetable: experiment.timetable(),
            seeds: experiment.environment_seeds(),
            clock: experiment.schedule.clock,
            rollout: experiment.learner.rollout_steps(),
            now: decisions,
            running: 0,
            shown: None,
            labels,
            steps: 0,
            glimpse: None,
        })
    }

    /// The environments.
    pub fn stream(&self) -> &Stream {
        &self.stream
    }

    /// Leaves the newest picture there from now on.
    pub fn show_to(&mut self, glimpse: Glimpse) {
        self.glimpse = Some(glimpse);
    }

    /// The index of the visit that the turn of this number begins in; none behind the last.
    pub fn index(&self, turn: usize) -> Option<usize> {
        self.timetable.index_at(match self.clock {
            Clock::World => self.now,
            Clock::Turns => turn * self.rollout,
        })
    }

    /// A visit, and those before it.
    pub fn visit(&self, index: usize) -> (&Visit, &[Visit]) {
        self.timetable.visit(index)
    }

    /// Decisions so far.
    pub fn now(&self) -> usize {
        self.now
    }

    /// The index of the visit that the turn's last step showed; before its first, of the one that
    /// runs.
    pub fn last_shown(&self) -> usize {
        self.shown.map_or(self.running, |shown| shown.last)
    }

    /// Whether the turn showed more than one group.
    pub fn straddles(&self) -> bool {
        self.shown.is_some_and(|shown| shown.straddles)
    }

    /// Books that a step of the running visit is shown.
    fn show(&mut self) {
        let (running, group) = (self.running, |index| &self.timetable.visit(index).0.group);
        let before =
            self.shown.unwrap_or(Shown { first: running, last: running, straddles: false });
        if self.shown.is_none() || before.last != running {
            self.labels.set(group(running));
        }
        self.shown = Some(Shown {
            last: running,
            straddles: before.straddles || group(running) != group(before.first),
            ..before
        });
    }

    /// Begins the turn of this number in the visit of this index.
    ///
    /// # Errors
    /// What the environments say.
    pub fn begin(&mut self, turn: usize, index: usize) -> Result<(), RunError> {
        self.shown = None;
        match self.clock {
            Clock::World => Ok(()),
            Clock::Turns => self.enter(index, self.seeds.nth(turn)),
        }
    }

    fn enter(&mut self, index: usize, seed: u64) -> Result<(), RunError> {
        let (visit, _) = self.timetable.visit(index);
        let group = self.tasks.get(&visit.group)?;
        self.stream.switch_to(group, &visit.variants)?;
        self.stream.reseed(seed)?;
        self.running = index;
        Ok(())
    }

    /// Lets in who is due now; a learner that goes on after the last visit stays in it.
    fn follow_the_clock(&mut self) -> Result<(), RunError> {
        self.steps = 0;
        match self.clock {
            Clock::World => {
                let index = self.timetable.index_at(self.now).unwrap_or(self.running);
                self.enter(index, self.seeds.nth(self.now))
            }
            Clock::Turns => Ok(()),
        }
    }
}

impl VectorEnv for World {
    fn spec(&self) -> &EnvSpec {
        self.stream.spec()
    }

    fn horizon(&self) -> Option<usize> {
        self.stream.horizon()
    }

    fn reset(&mut self, out: &mut Observations) -> Result<(), BoxError> {
        if self.is_begun {
            out.clone_from(&self.begun);
            return Ok(());
        }
        self.follow_the_clock()?;
        self.stream.reset(out)
    }

    fn step(&mut self, actions: &[f32], out: &mut Transition) -> Result<(), BoxError> {
        self.show();
        self.is_begun = false;
        self.stream.step(actions, out)?;
        self.now += self.spec().num_envs;
        self.steps += 1;
        let over = Some(self.steps) == self.horizon();
        if over && self.clock == Clock::World {
            cut(self.spec().image_len(), out);
            self.follow_the_clock()?;
            self.stream.reset(&mut out.observations)?;
            self.begun.clone_from(&out.observations);
            self.is_begun = true;
        }
        if let Some(glimpse) = &self.glimpse {
            glimpse.leave(self.spec(), &out.observations);
        }
        Ok(())
    }
}

/// Cuts the episodes that still run because a failure made them begin later than the others.
fn cut(image: usize, out: &mut Transition) {
    let vector = out.observations.vectors.len() / out.outcomes.len();
    let (from, to) = (&out.observations, &mut out.final_observations);
    for (n, outcome) in out.outcomes.iter_mut().enumerate() {
        if *outcome == Outcome::Running {
            *outcome = Outcome::Truncated;
            let (images, vectors) = (n * image..(n + 1) * image, n * vector..(n + 1) * vector);
            to.images[images.clone()].copy_from_slice(&from.images[images]);
            to.vectors[vectors.clone()].copy_from_slice(&from.vectors[vectors]);
        }
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::presets::{Budget, Method};

    /// 80 decisions of one group, 120 of the next, and so on: eight environments, episodes of ten
    /// decisions.
    fn world(decisions: usize) -> World {
        let mut experiment = Budget::Smoke.experiment(Method::Covers).with_threads(1);
        experiment.schedule.order = crate::schedule::Order::Fixed;
        experiment.schedule.groups.truncate(2);
        experiment.schedule.groups[0].decisions = 80;
        experiment.schedule.groups[1].decisions = 120;
        World::new(&experiment, &TaskRegistry::standard(), Labels::default(), decisions).unwrap()
    }

    /// The visit that runs after each step, and the last observation.
    fn walk(world: &mut World, steps: usize, reset_every: usize) -> (Vec<usize>, Observations) {
        let spec = world.spec().clone();
        let mut observations = Observations::new(&spec);
        let mut transition = Transition::new(&spec);
        let mut running = Vec::new();
        for step in 0..steps {
            if step.is_multiple_of(reset_every) {
                world.reset(&mut observations).unwrap();
            }
            world.step(&[0.0; 8 * 4], &mut transition).unwrap();
            running.push(world.running);
            observations.clone_from(&transition.observations);
        }
        (running, observations)
    }

    #[test]
    fn groups_change_at_the_end_of_episodes_whatever_the_learner_resets() {
        let (often, last) = walk(&mut world(0), 26, 10);
        let (once, same) = walk(&mut world(0), 26, usize::MAX);
        assert_eq!(often, once);
        assert!(last == same, "the same pictures at the same time");
        let switch = often.iter().position(|&index| index == 1);
        assert_eq!(switch, Some(9), "after ten steps of eight decisions");
        assert!(world(0).index(0) == Some(0) && world(200).index(3).is_none());
    }

    #[test]
    fn a_turn_straddles_where_it_showed_two_groups_and_not_where_the_next_is_due() {
        let mut world = world(0);
        let turn = |world: &mut World, steps| {
            world.begin(0, 0).unwrap();
            walk(world, steps, usize::MAX);
            (world.straddles(), world.last_shown())
        };
        assert_eq!(turn(&mut world, 10), (false, 0), "the next group is due");
        assert_eq!(world.running, 1);
        let mut world = self::world(0);
        assert_eq!(turn(&mut world, 11), (true, 1));
    }

    #[test]
    fn a_stream_that_goes_on_later_shows_the_same() {
        let (_, whole) = walk(&mut world(0), 20, usize::MAX);
        let (_, second_half) = walk(&mut world(80), 10, usize::MAX);
        assert!(whole == second_half);
    }

    #[test]
    fn episodes_that_run_late_are_cut() {
        let mut out = Transition::new(world(0).spec());
        out.outcomes.fill(Outcome::Truncated);
        out.outcomes[1] = Outcome::Running;
        out.observations.images.fill(7);
        let image = world(0).spec().image_len();
        cut(image, &mut out);
        assert!(out.outcomes.iter().all(|&outcome| outcome == Outcome::Truncated));
        let row = |n: usize| out.final_observations.images[n * image];
        assert_eq!((row(0), row(1)), (0, 7));
    }
}
