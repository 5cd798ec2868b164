//! An actor that observes nothing.

use rand_chacha::ChaCha8Rng;
use rl::{Actor, Observations, RlError};

/// Does the same everywhere; the second field is what a test lets it learn.
#[derive(Clone, Debug, PartialEq)]
pub struct Constant<W = ()>(pub f32, pub W);

impl<W> Actor for Constant<W> {
    type Memory = ();

    fn memory(&self, _: usize) {}

    fn mean_actions(
        &mut self,
        _: &Observations,
        (): &mut (),
        out: &mut [f32],
    ) -> Result<(), RlError> {
        out.fill(self.0);
        Ok(())
    }

    fn act(
        &mut self,
        seen: &Observations,
        (): &mut (),
        _: &mut ChaCha8Rng,
        out: &mut [f32],
    ) -> Result<(), RlError> {
        self.mean_actions(seen, &mut (), out)
    }
}
