//! What an update works on, whatever computes it.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;

use crate::actor_critic_policy::ActorCriticPolicy;
use crate::adam::{Adam, ParamGroup};
use crate::buffer::RolloutBuffer;
use crate::error::{RlError, check_all_finite};
use crate::ppo_settings::PpoSettings;
use crate::symmetry_loss::Moved;

/// An update that is to be run.
pub(super) struct Task<'a> {
    pub settings: &'a PpoSettings,
    pub optimiser: &'a mut Adam,
    pub rollout: &'a mut Rollout,
    pub policy: &'a mut ActorCriticPolicy,
    pub buffer: &'a RolloutBuffer,
    pub rng: &'a mut ChaCha8Rng,
}

impl Task<'_> {
    /// The encoder is trained at a rate of its own: its drift under the critic's loss moves the
    /// actor, too.
    pub fn groups(&self) -> [ParamGroup; 2] {
        let group = |range, learning_rate| ParamGroup {
            range,
            learning_rate,
        };
        let (network, settings) = (self.policy.network(), self.settings);
        [
            group(network.encoder(), settings.encoder_learning_rate),
            group(network.heads(), settings.head_learning_rate),
        ]
    }
}

/// What an update derives from its rollout, `[T, N]` each; kept for its memory.
#[derive(Default)]
pub(super) struct Rollout {
    pub advantages: Vec<f32>,
    pub returns: Vec<f32>,
    pub actions: Vec<f64>,
    /// Its decisions moved, for the loss of [`SymmetryLoss`](crate::SymmetryLoss); not kept.
    pub moved: Option<Moved>,
}

impl Rollout {
    /// Computes advantages and returns, and moves decisions by what `rng` draws.
    pub fn prepare(
        &mut self,
        settings: &PpoSettings,
        buffer: &RolloutBuffer,
        rng: &mut ChaCha8Rng,
    ) -> Result<(), RlError> {
        self.advantages.resize(buffer.samples(), 0.0);
        self.returns.resize(buffer.samples(), 0.0);
        buffer.advantages(
            settings.gamma,
            settings.lambda,
            &mut self.advantages,
            &mut self.returns,
        )?;
        check_all_finite("a return", &self.returns)?;
        self.actions.clear();
        self.actions
            .extend(buffer.decisions().actions.iter().map(|&a| f64::from(a)));
        self.moved = settings.symmetry.map(|symmetry| symmetry.draw(buffer, rng));
        Ok(())
    }
}

/// Fisher and Yates' shuffle, in Durstenfeld's form (Comm. ACM 7, 1964, algorithm 235).
pub(super) fn shuffle(order: &mut [usize], rng: &mut ChaCha8Rng) {
    for i in (1..order.len()).rev() {
        order.swap(i, rng.random_range(0..=i));
    }
}
