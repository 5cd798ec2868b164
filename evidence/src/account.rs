//! Summaries of single episodes, which are all that the recogniser remembers of them.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use symmetry::Irrep;

use crate::error::EvidenceError;
use crate::filters::{Album, Filters};
use crate::motion::{motion, slope};

/// Recorded episode, from its first observation on.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Course {
    /// Number of decisions that all environments took before the episode began: its place in time.
    pub began: usize,
    /// First picture of the episode `[H, W, C]`.
    pub image: Vec<u8>,
    /// Observation vectors `[T, D]` that the policy acted on in the episode.
    pub vectors: Vec<f32>,
    /// Actions of the episode `[T, A]`.
    pub actions: Vec<f32>,
    /// Rewards of the episode `[T]`.
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
    /// First observation vector `[D]` of the episode; components that change sign under a flip are
    /// absolute values.
    pub vector: Vec<f32>,
    /// Linear response of the observation vector to actions, `[D, A]`; `None`, like the next two
    /// fields, if the episode was not recorded to its end.
    pub motion: Option<Vec<f32>>,
    /// Direction in action space in which the reward increases: absolute values `[A]`, of length 1,
    /// or zeros if actions do not change it.
    pub slope: Option<Vec<f32>>,
    /// Undiscounted return of the episode.
    pub earned: Option<f32>,
}

impl Account {
    /// Removes all of the summary that depends on actions, so that only the first picture and
    /// vector remain.
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

/// Summariser that turns recorded episodes into accounts.
#[derive(Clone, Debug)]
pub struct Accountant {
    filters: Filters,
    vector: Vec<Irrep>,
    action: Vec<Irrep>,
}

impl Accountant {
    /// Creates a summariser for pictures `[H, W, C]` and vectors and actions of these irreps, with
    /// `filters` random filters.
    ///
    /// # Errors
    /// Errors of [`Filters::new`], and vectors or actions without components.
    pub fn new(
        image: [usize; 3],
        vector: &[Irrep],
        action: &[Irrep],
        filters: usize,
    ) -> Result<Self, EvidenceError> {
        for (what, irreps) in [("vector", vector), ("action", action)] {
            check_len(what, irreps.len().min(1), 1)?;
        }
        Ok(Self {
            filters: Filters::new(image, filters)?,
            vector: vector.to_vec(),
            action: action.to_vec(),
        })
    }

    /// Summarises one episode.
    ///
    /// # Errors
    /// A picture of another size, or lists of different numbers of steps.
    pub fn account(&self, course: &Course) -> Result<Account, EvidenceError> {
        self.account_of(course, None)
    }

    /// Summarises one episode; `described` holds its picture's features if they are cached.
    fn account_of(
        &self,
        course: &Course,
        described: Option<&[f32]>,
    ) -> Result<Account, EvidenceError> {
        let vector = self.first_vector(course)?;
        // an unfinished return cannot be compared, and all sources need the same episodes
        let motion = course.is_whole.then(|| self.motion(course)).transpose()?;
        let slope = motion.is_some().then(|| {
            let (rewards, actions) = (&course.rewards, &course.actions);
            slope(rewards, actions, &self.action)
        });
        Ok(Account {
            began: course.began,
            picture: match described {
                Some(described) => described.to_vec(),
                None => self.filters.describe(&course.image)?,
            },
            vector,
            motion,
            slope,
            earned: course.is_whole.then(|| course.rewards.iter().sum()),
        })
    }

    /// Summarises several episodes in parallel, in their order.
    ///
    /// # Errors
    /// Errors of [`Accountant::account`].
    pub fn accounts(&self, courses: &[Course]) -> Result<Vec<Account>, EvidenceError> {
        courses.par_iter().map(|course| self.account(course)).collect()
    }

    /// Summarises several episodes in parallel with a cache of picture features, because the
    /// filters take most of the time.
    ///
    /// # Errors
    /// Errors of [`Accountant::account`].
    pub fn accounts_with(
        &self,
        courses: &[Course],
        album: &mut Album,
    ) -> Result<Vec<Account>, EvidenceError> {
        let known: &Album = album;
        let accounts = courses.par_iter();
        let accounts = accounts.map(|course| self.account_of(course, known.find(&course.image)));
        let accounts = accounts.collect::<Result<Vec<_>, _>>()?;
        for (course, account) in courses.iter().zip(&accounts) {
            album.keep(&course.image, &account.picture);
        }
        Ok(accounts)
    }

    /// Returns the first vector `[D]` in the form that all mirror images share.
    fn first_vector(&self, course: &Course) -> Result<Vec<f32>, EvidenceError> {
        let steps = course.rewards.len().max(1);
        check_len("vectors", course.vectors.len(), steps * self.vector.len())?;
        let first = course.vectors.iter().zip(&self.vector);
        let unsigned = first.map(|(&v, irrep)| match irrep {
            Irrep::Trivial => v,
            _ => v.abs(),
        });
        Ok(unsigned.collect())
    }

    fn motion(&self, course: &Course) -> Result<Vec<f32>, EvidenceError> {
        let steps = course.rewards.len();
        check_len("actions", course.actions.len(), steps * self.action.len())?;
        Ok(motion(&course.vectors, &self.vector, &course.actions, &self.action))
    }
}

pub(crate) fn check_len(
    what: &'static str,
    got: usize,
    expected: usize,
) -> Result<(), EvidenceError> {
    if got == expected { Ok(()) } else { Err(EvidenceError::Length { what, got, expected }) }
}
