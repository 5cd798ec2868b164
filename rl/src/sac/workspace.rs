//! The buffers of a gradient of soft actor-critic.

use equivariant::Scalar;
use symmetry::D2;

use crate::replay::recorded::Place;
use crate::sac::network::SacNetwork;
use crate::sac::reader::{Items, ReaderPass, Steps};
use crate::stage::Stage;
use crate::trunk::TrunkPass;

/// An observation of the replay, moved by an element.
pub(crate) type Shown = (Place, D2);

/// Everything that the gradient of up to K steps needs, allocated once.
pub(crate) struct SacWorkspace<T> {
    /// Observations acted on.
    pub here: TrunkPass<T>,
    /// Other observations: those after the steps and those of the steps before.
    pub there: TrunkPass<T>,
    /// Which observations both hold, one pass after the other.
    pub shown: Vec<Shown>,
    /// Where the fields are of the observation after each step, and of those of the steps before.
    pub sources: Vec<usize>,
    /// Fields of the observations after the steps, `[K, h]`.
    pub next_fields: Vec<T>,
    /// What contexts read: the step of each observation that is held, in their order.
    pub items: Items<T>,
    /// The steps before, and those before the next observation.
    pub before: [Steps; 2],
    pub actor_reader: ReaderPass<T>,
    pub critic_reader: ReaderPass<T>,
    pub actor: Stage<T>,
    pub critics: [Stage<T>; 2],
    /// Mean and log_std `[K, 2 A]` in natural order, and the gradient in them.
    pub output: Vec<f64>,
    pub d_output: Vec<f64>,
    /// Actions `[K, A]` in natural order and their log-probabilities `[K]`.
    pub actions: Vec<f64>,
    pub log_probs: Vec<f64>,
    pub d_actions: Vec<f64>,
    /// Actions in irrep-major order, and the gradient in what a critic reads.
    pub irreps: Vec<T>,
    pub d_state: Vec<T>,
    /// Targets of the critics, `[K]`.
    pub targets: Vec<f64>,
    /// Where gradients go that nobody asks for.
    pub discarded: Vec<T>,
    /// One picture.
    pub image: Vec<u8>,
}

impl<T: Scalar> SacNetwork<T> {
    /// A workspace for up to `capacity` steps.
    pub(crate) fn workspace(&self, capacity: usize) -> SacWorkspace<T> {
        let width = self.action_order.len();
        let zeros = |len: usize| vec![0.0; capacity * len];
        let reals = |len: usize| vec![T::ZERO; capacity * len];
        SacWorkspace {
            here: self.trunk.pass(capacity),
            there: self.trunk.pass(capacity * (1 + self.reader.length())),
            shown: Vec::new(),
            sources: Vec::new(),
            next_fields: reals(self.trunk.out_type().dim()),
            items: Items::default(),
            before: <[Steps; 2]>::default(),
            actor_reader: self.reader.pass(capacity),
            critic_reader: self.reader.pass(capacity),
            actor: Stage::new(&self.actor, capacity),
            critics: [(); 2].map(|()| Stage::new(&self.critic, capacity)),
            output: zeros(2 * width),
            d_output: zeros(2 * width),
            actions: zeros(width),
            log_probs: zeros(1),
            d_actions: zeros(width),
            irreps: reals(width),
            d_state: reals(self.reader.out_type().dim()),
            targets: zeros(1),
            discarded: vec![T::ZERO; self.num_params()],
            image: vec![0; self.spec().image_len()],
        }
    }
}

impl<T> SacWorkspace<T> {
    /// Notes where the fields of an observation will be; returns its slot among those that are not
    /// acted on if it has to be shown there, since no earlier one is the same.
    pub fn source(&mut self, shown: Shown, n: usize) -> Option<usize> {
        let known = self.shown.iter().position(|&other| other == shown);
        let source = known.unwrap_or(self.shown.len());
        self.sources.push(source);
        if known.is_some() {
            return None;
        }
        self.shown.push(shown);
        Some(source - n)
    }
}
