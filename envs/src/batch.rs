//! Buffers for what N environments show.

use crate::settings::VecEnvSettings;
use crate::tabletop::VECTOR_DIM;

/// Borrowed buffers for the observations of N environments.
#[derive(Debug)]
pub struct ObservationsMut<'a> {
    /// `[N, size, size, C]`: the current RGB picture, then what [`Beside`](crate::Beside) says.
    pub images: &'a mut [u8],
    /// `[N, 7]`, see [`VECTOR_IRREPS`](crate::VECTOR_IRREPS).
    pub vectors: &'a mut [f32],
}

/// Borrowed buffers for the outcome of one step of N environments.
#[derive(Debug)]
pub struct StepMut<'a> {
    /// What the next action should be chosen from: of the next episode where one ended.
    pub observations: ObservationsMut<'a>,
    /// The last observation of an episode; rows are written only where `truncated`.
    pub final_observations: ObservationsMut<'a>,
    /// `[N]`, in `[0, 1]`.
    pub rewards: &'a mut [f32],
    /// `[N]`: the success condition held at any control step of the decision.
    pub success: &'a mut [bool],
    /// `[N]`: the success condition holds after the decision's last control step.
    pub success_at_end: &'a mut [bool],
    /// `[N]`: the episode reached its time limit, or its environment failed; tasks never end
    /// otherwise.
    pub truncated: &'a mut [bool],
}

/// Owned buffers of the shapes that [`VecEnv`](crate::VecEnv) fills; see [`StepMut`] for what they
/// hold.
#[derive(Clone, Debug, PartialEq)]
pub struct Batch {
    /// `[N, size, size, 6]`.
    pub images: Vec<u8>,
    /// `[N, 7]`.
    pub vectors: Vec<f32>,
    /// `[N, size, size, 6]`; of episodes that ended.
    pub final_images: Vec<u8>,
    /// `[N, 7]`; of episodes that ended.
    pub final_vectors: Vec<f32>,
    /// `[N]`.
    pub rewards: Vec<f32>,
    /// `[N]`.
    pub success: Vec<bool>,
    /// `[N]`.
    pub success_at_end: Vec<bool>,
    /// `[N]`.
    pub truncated: Vec<bool>,
}

impl Batch {
    /// Zeros for the environments of `settings`.
    pub fn new(settings: &VecEnvSettings) -> Self {
        let (n, image) = (settings.num_envs, settings.image_len());
        Self {
            images: vec![0; n * image],
            vectors: vec![0.0; n * VECTOR_DIM],
            final_images: vec![0; n * image],
            final_vectors: vec![0.0; n * VECTOR_DIM],
            rewards: vec![0.0; n],
            success: vec![false; n],
            success_at_end: vec![false; n],
            truncated: vec![false; n],
        }
    }

    /// What a reset fills.
    pub fn observations(&mut self) -> ObservationsMut<'_> {
        ObservationsMut { images: &mut self.images, vectors: &mut self.vectors }
    }

    /// What a step fills.
    pub fn step(&mut self) -> StepMut<'_> {
        StepMut {
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
