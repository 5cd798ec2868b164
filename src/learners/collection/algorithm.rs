//! Algorithm 1 of the paper: collect, assign, update. Read this file from top to bottom.
//!
//! Liu, Xu, Huang, Zhang, Liu, Oguchi, Zhao, "Continual Vision-based Reinforcement Learning with
//! Group Symmetries", CoRL 2023. Where the paper leaves a gap, the setting that closes it says so.

use std::path::Path;
use std::time::Instant;

use cluster::{Assignment, Decision};
use evidence::Course;
use rand_chacha::ChaCha8Rng;
use rl::{
    Activity, Experience, Observations, RlError, RolloutState, RolloutStats, Units, VectorEnv,
    collect,
};

use crate::error::CoversError;
use crate::groupings::{Answer, Episodes, Grouping, Recognised};
use crate::learners::learner::{Extent, Learner, Performance, Seconds, Turn};

use super::courses::courses;
use super::first_frames::{FirstFrames, Rollout as _, first_frames, keep_later};
use super::logged::metrics;
use super::member::{Clouds, Member};
use super::policies::{Collection, Exported};
use super::settings::{CollectionSettings, NewPolicy};
use super::training::Training;

/// Decisions of an episode from one look at the units of a network to the next: a look costs about
/// as much as a decision with its picture.
const BETWEEN_LOOKS: usize = 10;

impl<S: CollectionSettings> Learner for Collection<S> {
    /// One turn of Algorithm 1: roll out, assign, update.
    fn learn(&mut self, env: &mut dyn VectorEnv) -> Result<Turn, CoversError> {
        self.seconds = Seconds::default();
        let collector = self.current;
        let mut stats = self.roll_out(env)?;
        let mut decisions = stats.decisions;
        let mut frames = self.first_frames(0)?;
        let mut courses = courses(&self.rollout, 0);
        let mut assignment = self.assign(&frames, &courses)?;
        let mut first_look = None;
        // the paper opens a policy on a single rollout
        if assignment.decision == Decision::Undecided {
            self.keep_if_cut(0);
            stats = self.roll_out(env)?;
            frames.extend(self.first_frames(decisions)?);
            courses.extend(self::courses(&self.rollout, decisions));
            decisions += stats.decisions;
            first_look = Some(assignment.evidence);
            assignment = self.settle(&frames, &courses)?;
            self.keep_if_cut(1);
        }
        keep_later(&mut frames, self.grouping.cut());
        let mut created = self.adopt(&assignment, frames)?;
        let mut actor = collector;
        // the paper does not say that a rollout that changes hands is off-policy
        if self.current != collector {
            if self.may_reuse() {
                let policy = &mut self.members[self.current].policy;
                S::Training::take_over(policy, &mut self.rollout)?;
            } else {
                let collected = self.hand_over(env, assignment, created)?;
                decisions += collected.decisions;
                (assignment, stats, created) =
                    (collected.assignment, collected.stats, collected.created);
                actor = self.current;
            }
        }
        self.remember(actor)?;
        let update = self.update()?;
        let policy = self.current;
        decisions += self.look_for_twin(env)?;
        let heirs = self.grouping.heirs();
        let looks = 1 + usize::from(first_look.is_some());
        Ok(Turn {
            policy,
            created,
            metrics: metrics(&assignment.evidence, looks, heirs.as_deref(), update),
            evidence: assignment.evidence,
            first_look,
            heirs: heirs.unwrap_or_default(),
            decisions,
            rollout: stats,
            seconds: self.seconds,
        })
    }

    /// Looks at the first frames of the episodes that are asked for, or of as many as the grouping
    /// needs, at least one in each environment.
    fn recognise(
        &mut self,
        env: &mut dyn VectorEnv,
        episodes: Option<usize>,
        rng: &mut ChaCha8Rng,
    ) -> Result<Recognised, CoversError> {
        let (frames, courses) = self.glimpse(env, episodes, rng)?;
        if !self.has_learnt() {
            return Ok(Recognised {
                policy: 0,
                fits: true,
            });
        }
        let mut clouds = Clouds {
            members: &mut self.members,
            rollout: &frames,
            episodes: Episodes {
                spec: &self.spec,
                collector: self.current,
                courses: &courses,
            },
        };
        let recognised = self.grouping.recognise(&mut clouds, rng)?;
        self.check_policy(recognised.policy)?;
        Ok(recognised)
    }

    fn perform(
        &mut self,
        index: usize,
        env: &mut dyn VectorEnv,
        rounds: usize,
    ) -> Result<Performance, CoversError> {
        let index = self.check_policy(index)?;
        let mut activity = Activity::default();
        let policy = &mut self.members[index].policy;
        let stats = rl::watch(env, policy, rounds, |policy, state| {
            let steps = state.episodes.first().map_or(0, |episode| episode.length);
            if steps.is_multiple_of(BETWEEN_LOOKS) {
                activity.add(&policy.activity(&state.observations, &state.memory)?);
            }
            Ok(())
        })?;
        Ok(Performance { stats, activity })
    }

    fn export(&mut self, index: usize, observations: &Observations) -> Exported {
        self.plain(index, observations)
    }

    fn parameters(&self, index: usize) -> Option<&[f32]> {
        let member = self.members.get(index)?;
        Some(S::params(&member.policy))
    }

    fn policies(&self) -> usize {
        self.members.len()
    }

    fn encode(&self, path: &Path, extent: Extent, note: &str) -> Result<Vec<u8>, CoversError> {
        self.to_bytes(path, extent, note)
    }
}

impl<S: CollectionSettings> Collection<S> {
    /// Collects `N_s` decisions with the current policy.
    pub(super) fn roll_out(
        &mut self,
        env: &mut dyn VectorEnv,
    ) -> Result<RolloutStats, CoversError> {
        let clock = Instant::now();
        self.check_horizon(env)?;
        let Member {
            policy, training, ..
        } = &mut self.members[self.current];
        training.prepare(&mut self.rollout);
        let mut state = RolloutState::reset(env, policy)?;
        let (buffer, rng) = (&mut self.rollout, &mut self.generators.actions);
        let stats = collect(env, policy, buffer, &mut state, rng)?;
        self.seconds.collection += clock.elapsed().as_secs_f64();
        Ok(stats)
    }

    /// The first frames of new episodes, and the episodes as far as they ran: exactly this many, or
    /// at least as many as the grouping needs.
    fn glimpse(
        &mut self,
        env: &mut dyn VectorEnv,
        episodes: Option<usize>,
        rng: &mut ChaCha8Rng,
    ) -> Result<(Vec<FirstFrames>, Vec<Course>), CoversError> {
        let (k, needed) = (self.settings.first_frames(), self.grouping.min_episodes());
        let mut glimpse = self.settings.rollout(env.spec(), k)?;
        let (mut frames, mut courses) = (Vec::new(), Vec::new());
        while frames.len() < episodes.unwrap_or(needed) {
            let policy = &mut self.members[self.current].policy;
            let mut state = RolloutState::reset(env, policy)?;
            collect(env, policy, &mut glimpse, &mut state, rng)?;
            let seen = first_frames(&glimpse, 0, k);
            if seen.is_empty() {
                self.check_episodes(0)?;
            }
            frames.extend(seen);
            courses.extend(self::courses(&glimpse, 0));
        }
        if let Some(episodes) = episodes {
            frames.truncate(episodes);
            courses.truncate(episodes);
        }
        Ok((frames, courses))
    }

    /// Refuses rollouts that end before an episode does: nothing would be learnt of late states.
    fn check_horizon(&self, env: &dyn VectorEnv) -> Result<(), RlError> {
        let steps = self.rollout.steps();
        match env.horizon() {
            Some(horizon) if steps < horizon => Err(RlError::ShortRollout { steps, horizon }),
            Some(_) | None => Ok(()),
        }
    }

    /// The first frames of the rollout's episodes, which `before` decisions came before.
    pub(super) fn first_frames(&self, before: usize) -> Result<Vec<FirstFrames>, CoversError> {
        let frames = first_frames(&self.rollout, before, self.settings.first_frames());
        self.check_episodes(frames.len())?;
        Ok(frames)
    }

    /// Refuses a rollout that shows too few first frames to be assigned.
    fn check_episodes(&self, got: usize) -> Result<(), CoversError> {
        let needed = self.grouping.min_episodes();
        if got >= needed {
            return Ok(());
        }
        Err(CoversError::TooFewEpisodes {
            got,
            needed,
            first_frames: self.settings.first_frames(),
        })
    }

    /// Asks the grouping whose rollout it was.
    fn assign(&mut self, frames: &[FirstFrames], courses: &[Course]) -> Answer {
        // the paper starts with an empty `B`, for which no distance exists
        if !self.has_learnt() {
            return Ok(Assignment {
                decision: Decision::Existing(0),
                evidence: Vec::new(),
            });
        }
        self.ask(frames, courses, |grouping, clouds, rng| {
            grouping.assign(clouds, rng)
        })
    }

    /// Asks it again, for good, with the frames of two rollouts.
    fn settle(&mut self, frames: &[FirstFrames], courses: &[Course]) -> Answer {
        self.ask(frames, courses, |grouping, clouds, rng| {
            grouping.settle(clouds, rng)
        })
    }

    pub(super) fn ask<A>(
        &mut self,
        rollout: &[FirstFrames],
        courses: &[Course],
        mut question: impl FnMut(
            &dyn Grouping,
            &mut Clouds<S>,
            &mut ChaCha8Rng,
        ) -> Result<A, CoversError>,
    ) -> Result<A, CoversError> {
        let clock = Instant::now();
        let mut clouds = Clouds {
            members: &mut self.members,
            rollout,
            episodes: Episodes {
                spec: &self.spec,
                collector: self.current,
                courses,
            },
        };
        let rng = &mut self.generators.assignment;
        let answer = question(&*self.grouping, &mut clouds, rng);
        self.seconds.assignment += clock.elapsed().as_secs_f64();
        answer
    }

    /// Shows the grouping the last rollout, which the current policy is about to learn from, and
    /// forgets what shows another group at its end.
    fn remember(&mut self, collector: usize) -> Result<(), CoversError> {
        let clock = Instant::now();
        let episodes = Episodes {
            spec: &self.spec,
            collector,
            courses: &courses(&self.rollout, 0),
        };
        let rng = &mut self.generators.assignment;
        if let Some(end) = self.grouping.remember(self.current, episodes, rng)? {
            self.rollout.truncate(end / self.spec.num_envs)?;
        }
        self.seconds.assignment += clock.elapsed().as_secs_f64();
        Ok(())
    }

    /// Makes the assigned policy current and gives it the frames; returns whether it is new.
    pub(super) fn adopt(
        &mut self,
        assignment: &Assignment,
        frames: Vec<FirstFrames>,
    ) -> Result<bool, CoversError> {
        let policies = self.members.len();
        self.current = match assignment.decision {
            Decision::Existing(index) => self.check_policy(index)?,
            Decision::New | Decision::Undecided => {
                let parent = self.parent(assignment)?;
                self.open_policy(parent)?
            }
        };
        self.grouping.adopt(self.current);
        let member = &mut self.members[self.current];
        for episode in frames {
            member
                .buffer
                .offer(episode, &mut self.generators.assignment);
        }
        Ok(self.current == policies)
    }

    /// The policy that a new one is copied from, if it is.
    fn parent(&self, assignment: &Assignment) -> Result<Option<usize>, CoversError> {
        match (self.settings.new_policy(), assignment.nearest()) {
            (NewPolicy::Random, _) => Ok(None),
            (NewPolicy::Copy, Some(nearest)) => Ok(Some(nearest)),
            (NewPolicy::Copy, None) => Err(CoversError::Setting {
                name: "new_policy",
                value: "copy".to_owned(),
                expected: "random with a grouping that measures no distances: none is nearest",
            }),
        }
    }

    /// Whether policy 0 has taken the first rollout of all.
    fn has_learnt(&self) -> bool {
        self.members[0].buffer.seen() > 0
    }

    /// Refuses a policy that a grouping made up.
    pub(super) fn check_policy(&self, index: usize) -> Result<usize, CoversError> {
        if index < self.members.len() {
            return Ok(index);
        }
        Err(CoversError::Setting {
            name: "policy",
            value: index.to_string(),
            expected: "the index of a policy that was created",
        })
    }

    /// Improves the current policy by the rollout.
    fn update(&mut self) -> Result<Vec<(String, f64)>, CoversError> {
        let clock = Instant::now();
        let Member {
            policy, training, ..
        } = &mut self.members[self.current];
        let rng = &mut self.generators.updates;
        let logged = training.learn(policy, &mut self.rollout, rng)?;
        self.seconds.update += clock.elapsed().as_secs_f64();
        Ok(logged)
    }
}
