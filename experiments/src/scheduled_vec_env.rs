//! Task stream on a clock: groups change on schedule, whatever the learner does.

use envs::TaskRegistry;
use rl::{BoxedEnvError, EnvSpec, Observations, StepOutcome, Transition, VectorEnv};

use crate::error::RunError;
use crate::experiment::{Experiment, SeedSequence};
use crate::latest_frame::LatestFrame;
use crate::schedule::{GroupSchedule, StreamClock, Timetable};
use crate::stream::SwitchableVecEnv;
use learner::TaskLabel;

/// Vectorised environment of one run, which changes its task group as the schedule says.
///
/// On [`StreamClock::EnvironmentTime`], group, variants and placements depend only on the seed and
/// the number of decisions so far: they are drawn again from these whenever all episodes end.
pub(crate) struct ScheduledVecEnv {
    stream: SwitchableVecEnv,
    tasks: TaskRegistry,
    timetable: Timetable,
    seeds: SeedSequence,
    clock: StreamClock,
    /// Number of decisions of a rollout, the length of one iteration on
    /// [`StreamClock::LearnerIterations`].
    rollout: usize,
    /// Number of decisions taken in the stream so far, summed over all environments.
    now: usize,
    /// Index of the visit to a task group that runs now.
    running: usize,
    /// Visits to task groups shown in the current iteration; `None` before its first step.
    shown: Option<Shown>,
    labels: TaskLabel,
    /// Number of steps since all episodes started.
    steps: usize,
    /// `true` if all episodes have just started and no step was taken since.
    is_begun: bool,
    /// First observations of episodes that have just started, for a learner that resets them then.
    begun: Observations,
    /// Slot for the latest camera image, if there is a viewer.
    latest_frame: Option<LatestFrame>,
}

/// Indices of the first and the last visit to a task group that a training iteration showed.
#[derive(Clone, Copy, Debug)]
struct Shown {
    first: usize,
    last: usize,
    spans_switch: bool,
}

impl ScheduledVecEnv {
    /// Creates the stream of `experiment` after `decisions` decisions. It writes the name of the
    /// current group to `labels`.
    ///
    /// # Errors
    /// A group that `tasks` does not hold, or errors of the environments.
    pub fn new(
        experiment: &Experiment,
        tasks: &TaskRegistry,
        labels: TaskLabel,
        decisions: usize,
    ) -> Result<Self, RunError> {
        let groups = experiment.schedule.resolve_groups(tasks)?;
        let ranks = experiment.learner.process_ranks().clone();
        let stream = SwitchableVecEnv::on_ranks(experiment.envs, &groups, ranks)?;
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
            latest_frame: None,
        })
    }

    /// Returns the wrapped environments, whose task group this stream changes.
    pub fn environments(&self) -> &SwitchableVecEnv {
        &self.stream
    }

    /// Returns [`SwitchableVecEnv::take_failure_causes`] of the wrapped environments.
    pub fn take_failure_causes(&mut self) -> Vec<String> {
        self.stream.take_failure_causes()
    }

    /// Sets the slot to which the first environment's image is written after every step.
    pub fn publish_frames_to(&mut self, latest_frame: LatestFrame) {
        self.latest_frame = Some(latest_frame);
    }

    /// Returns the index of the visit to a task group in which the next training iteration, number
    /// `iteration` from 0, starts; `None` after the last visit.
    pub fn visit_index(&self, iteration: usize) -> Option<usize> {
        self.timetable.visit_index_at(match self.clock {
            StreamClock::EnvironmentTime => self.now,
            StreamClock::LearnerIterations => iteration * self.rollout,
        })
    }

    /// Returns the visit to a task group with index `index`, and all earlier visits.
    pub fn visit_and_earlier(&self, index: usize) -> (&GroupSchedule, &[GroupSchedule]) {
        self.timetable.visit_and_earlier(index)
    }

    /// Returns the number of decisions taken in the stream so far, summed over all environments.
    pub fn decisions_so_far(&self) -> usize {
        self.now
    }

    /// Returns the index of the visit to a task group that the current iteration's last step
    /// showed; before the iteration's first step, that of the running visit.
    pub fn last_shown_visit_index(&self) -> usize {
        self.shown.map_or(self.running, |shown| shown.last)
    }

    /// Returns `true` if the current iteration showed more than one task group.
    pub fn spans_switch(&self) -> bool {
        self.shown.is_some_and(|shown| shown.spans_switch)
    }

    /// Records that the next step shows the current visit, and sets the label to the visit's group.
    fn show(&mut self) {
        let (running, group) =
            (self.running, |index| &self.timetable.visit_and_earlier(index).0.group);
        let before =
            self.shown.unwrap_or(Shown { first: running, last: running, spans_switch: false });
        if self.shown.is_none() || before.last != running {
            self.labels.set(group(running));
        }
        self.shown = Some(Shown {
            last: running,
            spans_switch: before.spans_switch || group(running) != group(before.first),
            ..before
        });
    }

    /// Forgets what the last training iteration showed; on [`StreamClock::LearnerIterations`], also
    /// switches the environments to visit `index` with the seed of iteration `iteration`.
    ///
    /// # Errors
    /// Errors of the environments.
    pub fn begin_iteration(&mut self, iteration: usize, index: usize) -> Result<(), RunError> {
        self.shown = None;
        match self.clock {
            StreamClock::EnvironmentTime => Ok(()),
            StreamClock::LearnerIterations => self.enter(index, self.seeds.nth_seed(iteration)),
        }
    }

    fn enter(&mut self, index: usize, seed: u64) -> Result<(), RunError> {
        let (visit, _) = self.timetable.visit_and_earlier(index);
        let group = self.tasks.find(&visit.group)?;
        self.stream.switch_task_group(group, &visit.variants)?;
        self.stream.reseed(seed)?;
        self.running = index;
        Ok(())
    }

    /// Switches to the task group that is due by the number of decisions so far.
    fn follow_the_clock(&mut self) -> Result<(), RunError> {
        self.steps = 0;
        match self.clock {
            StreamClock::EnvironmentTime => {
                // a rollout that lasts beyond the last visit stays in it
                let index = self.timetable.visit_index_at(self.now).unwrap_or(self.running);
                self.enter(index, self.seeds.nth_seed(self.now))
            }
            StreamClock::LearnerIterations => Ok(()),
        }
    }
}

impl VectorEnv for ScheduledVecEnv {
    fn spec(&self) -> &EnvSpec {
        self.stream.spec()
    }

    fn horizon(&self) -> Option<usize> {
        self.stream.horizon()
    }

    fn reset(&mut self, out: &mut Observations) -> Result<(), BoxedEnvError> {
        // a reset right after the clock's own must not draw other episodes, so that learners see
        // the same stream whether they reset or not
        if self.is_begun {
            out.clone_from(&self.begun);
            return Ok(());
        }
        self.follow_the_clock()?;
        self.stream.reset(out)
    }

    fn step(&mut self, actions: &[f32], out: &mut Transition) -> Result<(), BoxedEnvError> {
        self.show();
        self.is_begun = false;
        self.stream.step(actions, out)?;
        self.now += self.spec().num_envs;
        self.steps += 1;
        let over = Some(self.steps) == self.horizon();
        if over && self.clock == StreamClock::EnvironmentTime {
            truncate(self.spec().image_len(), out);
            self.follow_the_clock()?;
            self.stream.reset(&mut out.observations)?;
            self.begun.clone_from(&out.observations);
            self.is_begun = true;
        }
        if let Some(latest_frame) = &self.latest_frame {
            latest_frame.update(self.spec(), &out.observations);
        }
        Ok(())
    }
}

/// Truncates episodes that are still running because a failure made them start later than the
/// others; `image` is the number of bytes of an image.
fn truncate(image: usize, out: &mut Transition) {
    let vector = out.observations.vectors.len() / out.outcomes.len();
    let (from, to) = (&out.observations, &mut out.final_observations);
    for (n, outcome) in out.outcomes.iter_mut().enumerate() {
        if *outcome == StepOutcome::Running {
            *outcome = StepOutcome::Truncated;
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

    /// Returns a stream of eight environments with episodes of ten decisions: 80 decisions of one
    /// group, then 120 of another.
    fn world(decisions: usize) -> ScheduledVecEnv {
        let mut experiment = Budget::Smoke.preset_experiment(Method::Covers).with_threads(1);
        experiment.schedule.order = crate::schedule::VisitOrder::Fixed;
        experiment.schedule.groups.truncate(2);
        experiment.schedule.groups[0].decisions = 80;
        experiment.schedule.groups[1].decisions = 120;
        let (tasks, labels) = (TaskRegistry::with_standard(), TaskLabel::default());
        ScheduledVecEnv::new(&experiment, &tasks, labels, decisions).unwrap()
    }

    /// Takes steps, and returns the current visit after each one and the last observations.
    fn walk(
        world: &mut ScheduledVecEnv,
        steps: usize,
        reset_every: usize,
    ) -> (Vec<usize>, Observations) {
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
        assert!(world(0).visit_index(0) == Some(0) && world(200).visit_index(3).is_none());
    }

    #[test]
    fn an_iteration_spans_a_switch_where_it_showed_two_groups_and_not_where_the_next_is_due() {
        let mut world = world(0);
        let iteration = |stream: &mut ScheduledVecEnv, steps| {
            stream.begin_iteration(0, 0).unwrap();
            walk(stream, steps, usize::MAX);
            (stream.spans_switch(), stream.last_shown_visit_index())
        };
        assert_eq!(iteration(&mut world, 10), (false, 0), "the next group is due");
        assert_eq!(world.running, 1);
        assert_eq!(iteration(&mut self::world(0), 11), (true, 1));
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
        out.outcomes.fill(StepOutcome::Truncated);
        out.outcomes[1] = StepOutcome::Running;
        out.observations.images.fill(7);
        let image = world(0).spec().image_len();
        truncate(image, &mut out);
        assert!(out.outcomes.iter().all(|&outcome| outcome == StepOutcome::Truncated));
        let row = |n: usize| out.final_observations.images[n * image];
        assert_eq!((row(0), row(1)), (0, 7));
    }
}
