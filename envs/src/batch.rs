//! Buffers for observations and step outcomes of N environments.

use crate::settings::VecEnvSettings;
use crate::tabletop::VECTOR_OBSERVATION_DIM;

/// Borrowed buffers for the observations of N environments.
#[derive(Debug)]
pub struct ObservationsMut<'a> {
    /// Images `[N, size, size, C]` of the observations, with C channels: the current RGB picture,
    /// then those of [`ExtraViews`](crate::ExtraViews).
    pub images: &'a mut [u8],
    /// Observation vectors `[N, 10]`: hand, aperture, goal and lead, see
    /// [`VECTOR_OBSERVATION_IRREPS`](crate::VECTOR_OBSERVATION_IRREPS).
    pub vectors: &'a mut [f32],
}

/// Borrowed buffers for the outcome of one step of N environments.
#[derive(Debug)]
pub struct StepResultsMut<'a> {
    /// Observations to choose the next actions from: where an episode ended, the first of the next
    /// episode.
    pub observations: ObservationsMut<'a>,
    /// Last observations of episodes that ended, where the environment began the next episode by
    /// itself; others are not written. After
    /// [`EnvCommand::StepNoAutoReset`](crate::EnvCommand::StepNoAutoReset) they are in
    /// `observations`.
    pub final_observations: ObservationsMut<'a>,
    /// Rewards of the N environments for the decision, in `[0, 1]`.
    pub rewards: &'a mut [f32],
    /// Flags of N environments: `true` if the success condition held at any control step of the
    /// decision.
    pub success: &'a mut [bool],
    /// Flags of N environments: `true` if the success condition holds after the decision's last
    /// control step.
    pub success_at_end: &'a mut [bool],
    /// Flags of N environments: `true` if the episode reached its time limit, or its environment
    /// failed. Tasks have no other end.
    pub truncated: &'a mut [bool],
}

/// Owned buffers for the results of [`VecEnv`](crate::VecEnv); [`StepResultsMut`] documents their
/// contents.
#[derive(Clone, Debug, PartialEq)]
pub struct StepBuffers {
    /// Images `[N, size, size, C]` of the current observations of N environments, with C channels,
    /// 6 by default.
    pub images: Vec<u8>,
    /// Observation vectors `[N, 10]` of N environments now: hand, aperture, goal and lead.
    pub vectors: Vec<f32>,
    /// Last images `[N, size, size, C]` of episodes that ended.
    pub final_images: Vec<u8>,
    /// Last observation vectors `[N, 10]` of episodes that ended.
    pub final_vectors: Vec<f32>,
    /// Rewards of the N environments for the last decision, in `[0, 1]`.
    pub rewards: Vec<f32>,
    /// Flags of N environments: `true` if the success condition held at any control step of the
    /// decision.
    pub success: Vec<bool>,
    /// Flags of N environments: `true` if the success condition holds after the decision's last
    /// control step.
    pub success_at_end: Vec<bool>,
    /// Flags of N environments: `true` where an episode reached its time limit, or its environment
    /// failed.
    pub truncated: Vec<bool>,
}

impl StepBuffers {
    /// Creates zeroed buffers for the environments of `settings`.
    pub fn new(settings: &VecEnvSettings) -> Self {
        let (n, image) = (settings.num_envs, settings.image_len());
        Self {
            images: vec![0; n * image],
            vectors: vec![0.0; n * VECTOR_OBSERVATION_DIM],
            final_images: vec![0; n * image],
            final_vectors: vec![0.0; n * VECTOR_OBSERVATION_DIM],
            rewards: vec![0.0; n],
            success: vec![false; n],
            success_at_end: vec![false; n],
            truncated: vec![false; n],
        }
    }

    /// Returns the buffers of current observations, for [`VecEnv::reset`](crate::VecEnv::reset) to
    /// fill.
    pub fn observations_mut(&mut self) -> ObservationsMut<'_> {
        ObservationsMut { images: &mut self.images, vectors: &mut self.vectors }
    }

    /// Returns the buffers of a step's outcome, for [`VecEnv::step`](crate::VecEnv::step) to fill.
    pub fn step_results_mut(&mut self) -> StepResultsMut<'_> {
        StepResultsMut {
            observations: ObservationsMut { images: &mut self.images, vectors: &mut self.vectors },
            final_observations: ObservationsMut {
                images: &mut self.final_images,
                vectors: &mut self.final_vectors,
            },
            rewards: &mut self.rewards,
            success: &mut self.success,
            success_at_end: &mut self.success_at_end,
            truncated: &mut self.truncated,
        }
    }
}
