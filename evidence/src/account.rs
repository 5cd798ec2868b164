//! Summaries of single episodes: a [`Recogniser`](crate::Recogniser) remembers them instead of the
//! episodes.

use std::collections::HashMap;

use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use symmetry::Irrep;

use crate::error::{EvidenceError, Result};
use crate::filters::Filters;
use crate::motion::{motion, slope};

/// Recorded episode, from its first observation on.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Course {
    /// Number of decisions that all environments took before the episode began: its place in time.
    pub began: usize,
    /// First picture of the episode, `[height, width, channels]`.
    pub image: Vec<u8>,
    /// Observation vectors that the policy acted on in the episode, `[T, D]` for T steps and D
    /// components.
    pub vectors: Vec<f32>,
    /// Actions of the episode, `[T, A]` for T steps and A action dimensions.
    pub actions: Vec<f32>,
    /// Rewards of the T steps of the episode.
    pub rewards: Vec<f32>,
    /// `true` if the episode was recorded to its end.
    pub is_whole: bool,
}

/// Summary of one episode: one point for each source of evidence. All four mirror images of an
/// episode have the same summary, to the bit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Account {
    /// Number of decisions that all environments took before the episode began: its place in time.
    pub began: usize,
    /// Features of the first picture, computed by [`Filters`].
    pub picture: Vec<f32>,
    /// First observation vector of the episode, of D components; those that change sign under a
    /// flip are absolute values.
    pub vector: Vec<f32>,
    /// Linear response of the D components of the observation vector to the A action dimensions,
    /// `[D, A]`; `None` if the episode was not recorded to its end.
    pub motion: Option<Vec<f32>>,
    /// Direction in action space in which the reward increases: absolute values, scaled to length
    /// 1, or zeros if actions do not change the reward.
    pub slope: Option<Vec<f32>>,
    /// Undiscounted return of the episode.
    pub earned: Option<f32>,
}

impl Account {
    /// Removes all of the summary that depends on actions, so that only the first picture and the
    /// first observation vector remain.
    pub fn forget_course(&mut self) {
        (self.motion, self.slope, self.earned) = (None, None, None);
    }

    /// Returns the summary of the first picture and vector alone.
    pub(crate) fn without_course(&self) -> Self {
        let mut account = self.clone();
        account.forget_course();
        account
    }
}

type Pictures = HashMap<Vec<u8>, Vec<f32>>;

/// Cache of the features of the episodes' first pictures, since filters take most of the time: a
/// decision and the call of `learn` after it use the same pictures.
#[derive(Clone, Debug, Default)]
pub struct Album(Pictures);

/// Summariser that turns recorded episodes into accounts.
#[derive(Clone, Debug)]
pub struct Accountant {
    filters: Filters,
    vector: Vec<Irrep>,
    action: Vec<Irrep>,
}

impl Accountant {
    /// Creates a summariser for pictures `[height, width, channels]` and for observation vectors
    /// and actions of the given irreps, with `filters` random filters.
    ///
    /// # Errors
    /// Errors of [`Filters::new`], and vectors or actions without components.
    pub fn new(
        image: [usize; 3],
        vector: &[Irrep],
        action: &[Irrep],
        filters: usize,
    ) -> Result<Self> {
        for (what, irreps) in [("vector", vector), ("action", action)] {
            check_len(what, irreps.len().min(1), 1)?;
        }
        Ok(Self {
            filters: Filters::new(image, filters)?,
            vector: vector.to_vec(),
            action: action.to_vec(),
        })
    }

    /// Summarises episodes in parallel, in their order. `album` holds the features of the pictures
    /// of the last call; those of this call replace them.
    ///
    /// # Errors
    /// A picture of another size, or lists of different numbers of steps.
    pub fn accounts(&self, courses: &[Course], album: &mut Album) -> Result<Vec<Account>> {
        let known = &album.0;
        let accounts = courses.par_iter().map(|course| self.account(course, known));
        let accounts = accounts.collect::<Result<Vec<_>>>()?;
        let features = accounts.iter().map(|account| account.picture.clone());
        album.0 = courses.iter().map(|course| course.image.clone()).zip(features).collect();
        Ok(accounts)
    }

    fn account(&self, course: &Course, known: &Pictures) -> Result<Account> {
        let vector = self.first_vector(course)?;
        // an unfinished return cannot be compared, and all sources need the same episodes
        let motion = course.is_whole.then(|| self.motion(course)).transpose()?;
        let slope = motion.is_some().then(|| slope(&course.rewards, &course.actions, &self.action));
        let picture = match known.get(&course.image) {
            Some(known) => known.clone(),
            None => self.filters.describe(&course.image)?,
        };
        let earned = course.is_whole.then(|| course.rewards.iter().sum());
        Ok(Account { began: course.began, picture, vector, motion, slope, earned })
    }

    /// Returns the first observation vector of an episode, with absolute values where a flip
    /// changes the sign, so that all mirror images share it.
    fn first_vector(&self, course: &Course) -> Result<Vec<f32>> {
        let steps = course.rewards.len().max(1);
        check_len("vectors", course.vectors.len(), steps * self.vector.len())?;
        let first = course.vectors.iter().zip(&self.vector);
        let unsigned = first.map(|(&v, irrep)| match irrep {
            Irrep::Trivial => v,
            _ => v.abs(),
        });
        Ok(unsigned.collect())
    }

    fn motion(&self, course: &Course) -> Result<Vec<f32>> {
        let steps = course.rewards.len();
        check_len("actions", course.actions.len(), steps * self.action.len())?;
        Ok(motion(&course.vectors, &self.vector, &course.actions, &self.action))
    }
}

pub(crate) fn check_len(what: &'static str, got: usize, expected: usize) -> Result<()> {
    if got == expected { Ok(()) } else { Err(EvidenceError::Length { what, got, expected }) }
}
