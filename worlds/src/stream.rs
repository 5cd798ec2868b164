//! Stream of task groups as a vectorised environment.

use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rl::{BoxedEnvError, EnvSpec, Observations, StepOutcome, Transition, VectorEnv};
use symmetry::{D2, Irrep};

use crate::episode::Episode;
use crate::picture::PICTURE_SIZE;
use crate::world::World;

/// Default number of decisions of an episode of a [`TaskStream`].
pub const DEFAULT_HORIZON: usize = 50;

/// Visit of the stream to one task group for a number of rounds. In a round each environment runs
/// one episode; all begin and end together.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct GroupVisit {
    /// Index of the visited task group in the world, from 0.
    pub group: usize,
    /// Number of rounds of the visit; a round is one episode in each environment.
    pub rounds: usize,
    /// Element of D2 by which all episodes of the visit are mirrored; `None` draws one for each.
    pub variant: Option<D2>,
}

impl GroupVisit {
    /// Returns a visit whose episodes are mirrored at random.
    pub fn new(group: usize, rounds: usize) -> Self {
        Self { group, rounds, variant: None }
    }
}

/// Error of creating or stepping a stream of tasks.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum StreamError {
    /// Stream of tasks without visits or without environments, or visit without rounds.
    #[error("{what} is 0, expected at least 1")]
    ZeroCount {
        /// Name of the number that is 0: that of visits, of environments, or of rounds.
        what: &'static str,
    },
    /// Visit of a group that the world does not have.
    #[error("visit {visit} is of group {group}, expected one of the world's {groups}")]
    UnknownGroup {
        /// Index of the visit in the list of visits, from 0.
        visit: usize,
        /// Index of the requested group.
        group: usize,
        /// Number of task groups that the world has.
        groups: usize,
    },
    /// List of actions that does not hold two numbers for each environment.
    #[error("got {got} actions, expected {expected}: two for each environment")]
    ActionsLength {
        /// Number of values in the list of actions.
        got: usize,
        /// Number of values expected: two for each environment.
        expected: usize,
    },
    /// Action that is NaN or infinite.
    #[error("action {index} is {value}, expected finite numbers")]
    NonFiniteAction {
        /// Index in the list of actions.
        index: usize,
        /// Value of the action.
        value: f32,
    },
    /// Step of a stream before its first reset.
    #[error("the environments were never reset: call `reset` before `step`")]
    NotReset,
}

/// Vectorised environment that visits task groups of a world one after another; the last group
/// stays.
///
/// Pictures are `[48, 48, 6]`: the present one and the episode's first. The vector is the hand's
/// position (x, y) in `[-0.95, 0.95]`, actions are (x, y) in `[-1, 1]` and are clipped. Episodes
/// are drawn from the world's seed and the number of the round, whatever happened before.
#[derive(Clone, Debug)]
pub struct TaskStream {
    world: World,
    visits: Vec<GroupVisit>,
    horizon: usize,
    spec: EnvSpec,
    episodes: Vec<Episode>,
    round: usize,
    step: usize,
}

impl TaskStream {
    /// Creates the environments of `world` that show the task groups of `visits` one after another.
    ///
    /// # Errors
    /// No visit, no environment, or a group that the world does not have.
    pub fn new(
        world: World,
        visits: Vec<GroupVisit>,
        num_envs: usize,
    ) -> Result<Self, StreamError> {
        for (what, size) in [("the number of visits", visits.len()), ("num_envs", num_envs)] {
            if size == 0 {
                return Err(StreamError::ZeroCount { what });
            }
        }
        for (index, visit) in visits.iter().enumerate() {
            check_visit(&world, index, visit)?;
        }
        let spec = EnvSpec {
            num_envs,
            image_shape: [PICTURE_SIZE, PICTURE_SIZE, 6],
            vector_irreps: vec![Irrep::X, Irrep::Y],
            action_irreps: vec![Irrep::X, Irrep::Y],
            choices: vec![],
        };
        Ok(Self {
            world,
            visits,
            horizon: DEFAULT_HORIZON,
            spec,
            episodes: Vec::new(),
            round: 0,
            step: 0,
        })
    }

    /// Mirrors all episodes of the visits given so far by one element of D2; visits that are
    /// inserted later keep their own.
    #[must_use]
    pub fn mirrored_by(mut self, variant: D2) -> Self {
        for visit in &mut self.visits {
            visit.variant = Some(variant);
        }
        self
    }

    /// Sets the length of the stream's episodes in decisions; 0 counts as 1.
    #[must_use]
    pub fn with_horizon(mut self, horizon: usize) -> Self {
        self.horizon = horizon.max(1);
        self
    }

    /// Returns the world whose task groups the stream visits.
    pub fn world(&self) -> &World {
        &self.world
    }

    /// Returns the number of rounds (episodes in each environment) that ended so far, by their
    /// horizon or by a reset.
    pub fn num_rounds_ended(&self) -> usize {
        self.round
    }

    /// Returns the index of the task group that the stream visits in round `round`, from 0.
    pub fn group_in_round(&self, round: usize) -> usize {
        self.group_visit_in_round(round).group
    }

    /// Inserts a visit that begins after the current round and shortens the visit that it
    /// interrupts. Later visits stay as they are.
    ///
    /// # Errors
    /// [`StreamError::UnknownGroup`] for a group that the world does not have,
    /// [`StreamError::ZeroCount`] for a visit of no rounds.
    pub fn insert_visit(&mut self, visit: GroupVisit) -> Result<(), StreamError> {
        let next = self.round + usize::from(!self.episodes.is_empty());
        let index = self.visit_index_in_round(next);
        let rounds_before: usize = self.visits[..index].iter().map(|earlier| earlier.rounds).sum();
        // a visit that has not begun comes later as a whole
        let has_begun = next > rounds_before;
        let place = index + usize::from(has_begun);
        check_visit(&self.world, place, &visit)?;
        if has_begun {
            self.visits[index].rounds = next - rounds_before;
        }
        self.visits.insert(place, visit);
        Ok(())
    }

    /// Returns the visit that round `round`, from 0, belongs to.
    pub fn group_visit_in_round(&self, round: usize) -> GroupVisit {
        self.visits[self.visit_index_in_round(round)]
    }

    /// Returns the index of the visit in round `round`, at most that of the last one.
    fn visit_index_in_round(&self, round: usize) -> usize {
        let mut end = 0;
        let visit = self.visits.iter().position(|visit| {
            end = visit.rounds.saturating_add(end);
            round < end
        });
        visit.unwrap_or(self.visits.len() - 1)
    }

    /// Returns the action (x, y) of a scripted expert for task group `group` in environment `env`,
    /// whichever group the environment shows.
    ///
    /// # Panics
    /// If there is no such environment or group, or before the first reset.
    pub fn expert_action(&self, env: usize, group: usize) -> [f32; 2] {
        self.episodes[env].expert_action(&self.world.groups[group])
    }

    /// Begins an episode of the present round in every environment.
    fn begin(&mut self) {
        self.step = 0;
        let (world, round) = (&self.world, self.round);
        let scene = world.scene_in_round(round, self.visit_index_in_round(round));
        let visit = self.group_visit_in_round(round);
        let group = world.groups[visit.group].after(round);
        let episodes = (0..self.spec.num_envs).map(|env| {
            let mut rng = ChaCha8Rng::seed_from_u64(world.seed);
            // stream 0 drew the world itself
            rng.set_stream(1 + (round * self.spec.num_envs + env) as u64);
            Episode::begin(scene, group, visit.variant, rng)
        });
        self.episodes = episodes.collect();
    }

    fn show(&self, out: &mut Observations) {
        let images = out.images.chunks_exact_mut(self.spec.image_len());
        let vectors = out.vectors.chunks_exact_mut(self.spec.vector_irreps.len());
        for (episode, (image, vector)) in self.episodes.iter().zip(images.zip(vectors)) {
            episode.write_observation(image, vector);
        }
    }
}

/// Checks that a visit, which has this index in the list of visits, has rounds and a group of the
/// world.
fn check_visit(world: &World, index: usize, visit: &GroupVisit) -> Result<(), StreamError> {
    let (group, groups) = (visit.group, world.groups.len());
    if visit.rounds == 0 {
        return Err(StreamError::ZeroCount { what: "the number of rounds of a visit" });
    }
    if group < groups {
        Ok(())
    } else {
        Err(StreamError::UnknownGroup { visit: index, group, groups })
    }
}

impl VectorEnv for TaskStream {
    fn spec(&self) -> &EnvSpec {
        &self.spec
    }

    fn horizon(&self) -> Option<usize> {
        Some(self.horizon)
    }

    /// Begins an episode in every environment; running ones are broken off and count as a round.
    fn reset(&mut self, out: &mut Observations) -> Result<(), BoxedEnvError> {
        if self.step > 0 {
            self.round += 1;
        }
        self.begin();
        self.show(out);
        Ok(())
    }

    fn step(&mut self, actions: &[f32], out: &mut Transition) -> Result<(), BoxedEnvError> {
        let expected = 2 * self.spec.num_envs;
        if actions.len() != expected {
            let got = actions.len();
            return Err(StreamError::ActionsLength { got, expected }.into());
        }
        if self.episodes.is_empty() {
            return Err(StreamError::NotReset.into());
        }
        if let Some(index) = actions.iter().position(|action| !action.is_finite()) {
            return Err(StreamError::NonFiniteAction { index, value: actions[index] }.into());
        }
        for (env, episode) in self.episodes.iter_mut().enumerate() {
            let (reward, success) = episode.step([actions[2 * env], actions[2 * env + 1]]);
            out.rewards[env] = reward;
            out.success[env] = success;
            out.success_at_end[env] = success;
        }
        self.step += 1;
        let ends = self.step >= self.horizon;
        out.outcomes.fill(if ends { StepOutcome::Truncated } else { StepOutcome::Running });
        if ends {
            self.show(&mut out.final_observations);
            self.round += 1;
            self.begin();
        }
        self.show(&mut out.observations);
        Ok(())
    }
}
