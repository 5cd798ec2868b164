//! Reservoir sampling: a bounded, uniform sample of the episodes seen so far.

use rand::{Rng, RngExt};

use crate::check::check_positive;
use crate::error::{ClusterError, Result};

/// Uniform sample, without replacement, of at most `capacity` of the episodes offered so far.
///
/// Algorithm R of J. S. Vitter, "Random sampling with a reservoir", ACM Transactions on
/// Mathematical Software 11 (1985): the episode of rank `t > capacity` is kept with probability
/// `capacity / t`, in place of one held at random. What an episode is, is up to the caller; one
/// that stores raw frames can embed them afresh at each use.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Reservoir<E> {
    capacity: usize,
    num_offered: u64,
    episodes: Vec<E>,
}

impl<E> Reservoir<E> {
    /// Creates an empty reservoir for at most `capacity` episodes, at least 1.
    ///
    /// # Errors
    /// A capacity of zero.
    pub fn new(capacity: usize) -> Result<Self> {
        Self::from_parts(capacity, 0, Vec::new())
    }

    /// Restores a reservoir from the values of [`capacity`](Self::capacity),
    /// [`num_offered`](Self::num_offered) and [`episodes`](Self::episodes), with the episodes in
    /// the same order. They are all of its state: with the same generator it continues in the same
    /// way.
    ///
    /// # Errors
    /// A capacity of zero, or a number of episodes other than `min(capacity, num_offered)`.
    pub fn from_parts(capacity: usize, num_offered: u64, episodes: Vec<E>) -> Result<Self> {
        check_positive("capacity", capacity)?;
        if episodes.len() as u64 != num_offered.min(capacity as u64) {
            let held = episodes.len();
            return Err(ClusterError::ReservoirParts { capacity, seen: num_offered, held });
        }
        Ok(Self { capacity, num_offered, episodes })
    }

    /// Offers an episode to the reservoir, which stores it while it is not full; later, with
    /// probability `capacity` / episodes offered with this one, it replaces a random stored one,
    /// and is dropped otherwise.
    pub fn offer(&mut self, episode: E, rng: &mut impl Rng) {
        self.num_offered += 1;
        if self.episodes.len() < self.capacity {
            self.episodes.push(episode);
            return;
        }
        let place = usize::try_from(rng.random_range(0..self.num_offered)).ok();
        if let Some(held) = place.and_then(|place| self.episodes.get_mut(place)) {
            *held = episode;
        }
    }

    /// Returns the episodes that the reservoir stores. Their order has no meaning, but is part of
    /// the state.
    pub fn episodes(&self) -> &[E] {
        &self.episodes
    }

    /// Returns the number of episodes offered to the reservoir so far.
    pub fn num_offered(&self) -> u64 {
        self.num_offered
    }

    /// Returns the largest number of episodes that the reservoir stores.
    pub fn capacity(&self) -> usize {
        self.capacity
    }
}
