//! Summaries of single episodes, which a [`Recogniser`](crate::Recogniser) remembers instead of the
//! episodes.

use std::collections::HashMap;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use symmetry::Irrep;

use crate::error::{Result, check_len};
use crate::filters::RandomFilters;
use crate::motion::{motion, reward_gradient};

/// Trajectory of one episode: its first image, and the vectors, actions and rewards of its T steps.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Trajectory {
    /// Number of decisions that all environments took before the episode began: its place in time.
    pub began: usize,
    /// First image of the episode, `[height, width, channels]`.
    pub image: Vec<u8>,
    /// Observation vectors that the policy acted on, `[T, D]` for D components.
    pub vectors: Vec<f32>,
    /// Actions of the T steps, `[T, A]` for A action dimensions.
    pub actions: Vec<f32>,
    /// Rewards of the T steps.
    pub rewards: Vec<f32>,
    /// `true` if the episode was recorded to its end.
    pub is_whole: bool,
}

/// Summary of one episode, with one point for each source of evidence. Mirror images of an episode
/// have the same summary, to the bit.
// Files keep the names that the fields had when checkpoints of format 5 began.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct EpisodeSummary {
    /// Number of decisions that all environments took before the episode began: its place in time.
    pub began: usize,
    /// Features of the episode's first image, computed by [`RandomFilters`].
    #[serde(rename = "picture")]
    pub image_features: Vec<f32>,
    /// First observation vector of the episode, of D components, which should be scaled to about 1:
    /// vectors within 0.02 of each other count as equal. Components that change sign under a flip
    /// are absolute values.
    #[serde(rename = "vector")]
    pub first_vector: Vec<f32>,
    /// Linear response of the D vector components to the A action dimensions, `[D, A]`; `None` if
    /// the episode was not recorded to its end.
    pub motion: Option<Vec<f32>>,
    /// Direction in action space in which the reward increases: absolute values, scaled to length
    /// 1, or zeros if actions do not change the reward.
    #[serde(rename = "slope")]
    pub reward_gradient: Option<Vec<f32>>,
    /// Undiscounted return of the episode; `None` if it was not recorded to its end.
    #[serde(rename = "earned")]
    pub episode_return: Option<f32>,
}

impl EpisodeSummary {
    /// Removes motion, reward gradient and return, which depend on the policy that acted, so that
    /// only the first observation remains.
    pub fn keep_only_first_observation(&mut self) {
        (self.motion, self.reward_gradient, self.episode_return) = (None, None, None);
    }
}

/// Cache of the image features of the last call of [`EpisodeSummariser::summarise`], by image. The
/// filters take most of the time, and a decision and the training after it use the same images.
#[derive(Clone, Debug, Default)]
pub struct ImageFeatureCache {
    /// Shape of the images, and number of filters.
    made_for: ([usize; 3], usize),
    features: HashMap<Vec<u8>, Vec<f32>>,
}

/// Converter of trajectories into [`EpisodeSummary`] values.
#[derive(Clone, Debug)]
pub struct EpisodeSummariser {
    filters: RandomFilters,
    vector: Vec<Irrep>,
    action: Vec<Irrep>,
}

impl EpisodeSummariser {
    /// Creates a summariser for images `[height, width, channels]`, for observation vectors and
    /// actions of the given irreps, and with `filters` random filters.
    ///
    /// # Errors
    /// Errors of [`RandomFilters::new`], and vectors or actions without components.
    pub fn new(
        image: [usize; 3],
        vector: &[Irrep],
        action: &[Irrep],
        filters: usize,
    ) -> Result<Self> {
        for (what, irreps) in [("vector", vector), ("action", action)] {
            check_len(what, irreps.len().min(1), 1)?;
        }
        let filters = RandomFilters::new(image, filters)?;
        Ok(Self { filters, vector: vector.to_vec(), action: action.to_vec() })
    }

    /// Summarises trajectories in parallel and returns the summaries in the same order. `cache`
    /// holds the image features of the last call; those of this call replace them.
    ///
    /// # Errors
    /// An image of another size, or lists of different numbers of steps.
    pub fn summarise(
        &self,
        trajectories: &[Trajectory],
        cache: &mut ImageFeatureCache,
    ) -> Result<Vec<EpisodeSummary>> {
        let own = self.filters.shape_and_count();
        if cache.made_for != own {
            *cache = ImageFeatureCache { made_for: own, ..ImageFeatureCache::default() };
        }
        let summaries = trajectories.par_iter().map(|trajectory| self.summary(trajectory, cache));
        let summaries = summaries.collect::<Result<Vec<_>>>()?;
        let features = summaries.iter().map(|summary| summary.image_features.clone());
        cache.features = trajectories.iter().map(|t| t.image.clone()).zip(features).collect();
        Ok(summaries)
    }

    fn summary(
        &self,
        trajectory: &Trajectory,
        cache: &ImageFeatureCache,
    ) -> Result<EpisodeSummary> {
        let Trajectory { began, image, vectors, actions, rewards, is_whole } = trajectory;
        let steps = rewards.len();
        check_len("vectors", vectors.len(), steps.max(1) * self.vector.len())?;
        // absolute values where a flip changes the sign, so that all mirror images share them
        let first_vector = vectors.iter().zip(&self.vector).map(|(&v, irrep)| match irrep {
            Irrep::Trivial => v,
            _ => v.abs(),
        });
        let image_features = match cache.features.get(image) {
            Some(known) => known.clone(),
            None => self.filters.features(image)?,
        };
        let mut summary = EpisodeSummary {
            began: *began,
            image_features,
            first_vector: first_vector.collect(),
            motion: None,
            reward_gradient: None,
            episode_return: None,
        };
        // an unfinished return cannot be compared, and all sources need the same episodes
        if *is_whole {
            check_len("actions", actions.len(), steps * self.action.len())?;
            summary.motion = Some(motion(vectors, &self.vector, actions, &self.action));
            summary.reward_gradient = Some(reward_gradient(rewards, actions, &self.action));
            summary.episode_return = Some(rewards.iter().sum());
        }
        Ok(summary)
    }
}
