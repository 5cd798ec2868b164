//! What is kept of one episode.

use rayon::prelude::*;
use serde::{Deserialize, Serialize};
use symmetry::Irrep;

use crate::error::EvidenceError;
use crate::filters::{Album, Filters};
use crate::motion::{motion, slope};

/// One episode as it ran, from its first observation on.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Course {
    /// Decisions, of all environments together, before the episode began: its place in time.
    pub began: usize,
    /// The first picture `[H, W, C]`.
    pub image: Vec<u8>,
    /// The vectors `[T, D]` that were acted on.
    pub vectors: Vec<f32>,
    /// Actions `[T, A]`.
    pub actions: Vec<f32>,
    /// Rewards `[T]`.
    pub rewards: Vec<f32>,
    /// Whether it was seen to its end.
    pub is_whole: bool,
}

/// The account of one episode: a point for each source of evidence, the same for all mirror images
/// of the episode, to the bit.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Account {
    /// Decisions before the episode began.
    pub began: usize,
    /// The first picture, as [`Filters`] describe it.
    pub picture: Vec<f32>,
    /// The first vector: components that a flip turns have lost their sign.
    pub vector: Vec<f32>,
    /// How vectors answered to actions. Nothing, as are earnings, of an episode that was not seen
    /// to its end.
    pub motion: Option<Vec<f32>>,
    /// Which way pays: how rewards answered to actions, of length 1.
    pub slope: Option<Vec<f32>>,
    /// The sum of rewards.
    pub earned: Option<f32>,
}

impl Account {
    /// Leaves what was there before anybody acted.
    pub fn forget_course(&mut self) {
        (self.motion, self.slope, self.earned) = (None, None, None);
    }
}

/// Draws up accounts.
#[derive(Clone, Debug)]
pub struct Accountant {
    filters: Filters,
    vector: Vec<Irrep>,
    action: Vec<Irrep>,
}

impl Accountant {
    /// For pictures `[H, W, C]`, vectors and actions of these irreps, with `filters` filters.
    ///
    /// # Errors
    /// Those of [`Filters::new`], or vectors or actions without components.
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

    /// The account of a course.
    ///
    /// # Errors
    /// A picture of another size, or lists that do not fit each other.
    pub fn account(&self, course: &Course) -> Result<Account, EvidenceError> {
        self.account_of(course, None)
    }

    /// The account of a course whose picture may have been described before.
    fn account_of(
        &self,
        course: &Course,
        described: Option<&[f32]>,
    ) -> Result<Account, EvidenceError> {
        let vector = self.first_vector(course)?;
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

    /// Accounts of several courses.
    ///
    /// # Errors
    /// Those of [`Accountant::account`].
    pub fn accounts(&self, courses: &[Course]) -> Result<Vec<Account>, EvidenceError> {
        courses.par_iter().map(|course| self.account(course)).collect()
    }

    /// Accounts of several courses, whose pictures are looked up in `album` and kept there: what is
    /// slow is done once for each picture.
    ///
    /// # Errors
    /// Those of [`Accountant::account`].
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

    /// The first vector, the same for all mirror images.
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
        Ok(motion((&course.vectors, &self.vector), (&course.actions, &self.action)))
    }
}

pub(crate) fn check_len(
    what: &'static str,
    got: usize,
    expected: usize,
) -> Result<(), EvidenceError> {
    if got == expected { Ok(()) } else { Err(EvidenceError::Length { what, got, expected }) }
}
