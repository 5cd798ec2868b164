//! Minibatches of SAC: sampled steps and noise, encoding of their observations, and buffers of the
//! passes.

use std::ops::Range;

use equivariant::Scalar;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use symmetry::D2;

use crate::distributions::standard_normals;
use crate::env::{transform_image, transform_vector};
use crate::replay::{ReplayBuffer, ReplayStep, StepId};
use crate::sac::context::{ContextItems, ContextPass, ContextSteps};
use crate::sac::network::SacNetwork;
use crate::sac::settings::SacSettings;
use crate::trunk::{LayerBuffers, TrunkPass};

/// Returns the number of steps that one thread processes at a time (a chunk) in training: 8 as in
/// PPO, or the `window` of consecutive steps ([`SacSettings::window`]) if that is more, since steps
/// share observations only within a chunk; at most 32, because the memory of a workspace grows with
/// it.
pub(super) fn training_chunk(window: usize) -> usize {
    window.clamp(8, 32)
}

/// Randomly drawn steps, group elements and noise of a minibatch, kept between gradient steps to
/// reuse the allocations.
#[derive(Default)]
pub(super) struct Draws {
    /// Index in the replay buffer of the first step of each window of consecutive steps.
    pub indices: Vec<usize>,
    /// Index of the window's first step, and offset in the window, of each of the minibatch's B
    /// steps, `[B]`.
    pub steps: Vec<(usize, usize)>,
    /// Group element that transforms each step, `[B]`, the same for all steps of a window.
    pub elements: Vec<D2>,
    /// Standard normal noise of the actor at the current, and at the next observations, `[B, A]`
    /// each.
    pub noise: [Vec<f32>; 2],
}

impl Draws {
    /// Draws a minibatch: first the windows of consecutive steps, then their group elements, then
    /// the actor's noise.
    pub fn draw(&mut self, settings: &SacSettings, replay: &ReplayBuffer, rng: &mut ChaCha8Rng) {
        let (batch, window) = (settings.batch, settings.window);
        let windows = batch.div_ceil(window);
        replay.sample_indices(windows, settings.newest_share, rng, &mut self.indices);
        let in_window = |&index: &usize| (0..window).map(move |further| (index, further));
        self.steps.clear();
        self.steps.extend(self.indices.iter().flat_map(in_window).take(batch));
        let group = settings.augmentation.elements();
        self.elements.clear();
        for _ in 0..windows {
            let element = group[rng.random_range(0..group.len())];
            self.elements.extend([element].repeat(window));
        }
        self.elements.truncate(batch);
        for noise in &mut self.noise {
            noise.resize(batch * replay.spec().action_irreps.len(), 0.0);
            standard_normals(rng, noise);
        }
    }

    /// Returns the drawn minibatch, with discount and loss weights from `settings` and temperature
    /// `alpha`.
    pub fn batch<'a>(
        &'a self,
        settings: &SacSettings,
        alpha: f64,
        replay: &'a ReplayBuffer,
    ) -> Batch<'a> {
        Batch {
            replay,
            steps: &self.steps,
            elements: &self.elements,
            noise: [&self.noise[0], &self.noise[1]],
            gamma: settings.gamma.into(),
            alpha,
            cloning: settings.cloning_weight.into(),
        }
    }
}

/// A minibatch of B steps of a replay buffer, with its random draws.
#[derive(Clone, Copy, Debug)]
pub(super) struct Batch<'a> {
    pub replay: &'a ReplayBuffer,
    /// Steps of the minibatch, `[B]`: the index in the replay buffer of the window's first step,
    /// and the offset in the window.
    pub steps: &'a [(usize, usize)],
    /// Group element that transforms each step, `[B]`.
    pub elements: &'a [D2],
    /// Standard normal noise `[B, A]` of the actor at the current, and at the next observations.
    pub noise: [&'a [f32]; 2],
    pub gamma: f64,
    /// Temperature alpha, the weight of the entropy in the actor's objective.
    pub alpha: f64,
    /// Weight of the behavioural cloning loss in the actor's loss.
    pub cloning: f64,
}

impl<'a> Batch<'a> {
    /// Returns the step at a position of the minibatch, and the group element that transforms it.
    pub fn step(&self, position: usize) -> (ReplayStep<'a>, D2) {
        let (index, further) = self.steps[position];
        let step = self.replay.get(index).wrapping_later(further);
        (step, self.elements[position])
    }

    /// Returns the action `[A]` of a step, transformed by the group element `g`.
    pub fn action<T: Scalar>(&self, network: &SacNetwork<T>, step: ReplayStep, g: D2) -> Vec<f32> {
        transform_vector(g, step.action(), &network.spec().action_irreps)
    }

    /// Returns the weight of one step in a mean over the minibatch.
    pub fn scale(&self) -> f64 {
        1.0 / self.steps.len() as f64
    }

    /// Computes the trunk's fields of all observations that the steps at positions `range` need,
    /// each once, and passes the steps before them to the recurrent contexts.
    pub fn load<T: Scalar>(
        &self,
        network: &SacNetwork<T>,
        params: &[T],
        range: &Range<usize>,
        w: &mut SacWorkspace<T>,
    ) {
        let n = range.len();
        w.observed.clear();
        w.sources.clear();
        for (slot, position) in range.clone().enumerate() {
            let (step, g) = self.step(position);
            step.image(&mut w.image);
            load_transformed(network, slot, g, step.vector(), &mut w.image, &mut w.current);
            w.observed.push((step.index(), g));
        }
        for position in range.clone() {
            let (step, g) = self.step(position);
            if let Some(slot) = w.locate((step.next_index(), g), n) {
                step.next_image(&mut w.image);
                let vector = step.next_vector();
                load_transformed(network, slot, g, vector, &mut w.image, &mut w.others);
            }
            for earlier in earlier_steps(network, step) {
                if let Some(slot) = w.locate((earlier.index(), g), n) {
                    earlier.image(&mut w.image);
                    let vector = earlier.vector();
                    load_transformed(network, slot, g, vector, &mut w.image, &mut w.others);
                }
            }
        }
        let params = &params[network.trunk.params()];
        let others = w.observed.len() - n;
        network.trunk.forward(params, n, &mut w.current);
        network.trunk.forward(params, others, &mut w.others);
        self.distribute_fields(network, range, w);
    }

    /// Copies the trunk's fields of the next observations, and writes the GRU inputs (items) of the
    /// steps before each observation.
    fn distribute_fields<T: Scalar>(
        &self,
        network: &SacNetwork<T>,
        range: &Range<usize>,
        w: &mut SacWorkspace<T>,
    ) {
        let (reader, n) = (&network.reader, range.len());
        let width = network.trunk.out_type().dim();
        let [now, next] = &mut w.before;
        now.clear(reader.length(), n);
        next.clear(reader.length(), n);
        reader.clear(w.observed.len(), &mut w.items);
        let (current, others) = (w.current.fields(), w.others.fields());
        let fields_of = |source: usize| match source.checked_sub(n) {
            Some(slot) => &others[slot * width..(slot + 1) * width],
            None => &current[source * width..(source + 1) * width],
        };
        let mut sources = w.sources.iter().copied();
        for (slot, position) in range.clone().enumerate() {
            let own = slot * width..(slot + 1) * width;
            let (step, g) = self.step(position);
            let copied = w.next_fields[own].iter_mut();
            copied.zip(fields_of(sources.next().unwrap_or_default())).for_each(|(to, &x)| *to = x);
            if reader.length() == 0 {
                continue;
            }
            let (action, reward) = (self.action(network, step, g), step.reward());
            reader.write(slot, fields_of(slot), &action, reward, &mut w.items);
            next.prepend(slot, slot);
            for earlier in earlier_steps(network, step) {
                let source = sources.next().unwrap_or_default();
                // steps of this chunk have written their own item already, or will
                if source >= n {
                    let (earlier_action, earlier_reward) =
                        (self.action(network, earlier, g), earlier.reward());
                    reader.write(
                        source,
                        fields_of(source),
                        &earlier_action,
                        earlier_reward,
                        &mut w.items,
                    );
                }
                now.prepend(slot, source);
                next.prepend(slot, source);
            }
        }
    }
}

/// Returns the steps before `step` that a recurrent context may read, the last one first.
fn earlier_steps<'r, T: Scalar>(
    network: &SacNetwork<T>,
    step: ReplayStep<'r>,
) -> impl Iterator<Item = ReplayStep<'r>> + use<'r, T> {
    (1..=network.reader.length()).map_while(move |count| step.earlier(count))
}

/// Loads an observation, transformed by the group element `g`, into a slot of `pass`; `image` holds
/// its pixels.
fn load_transformed<T: Scalar>(
    network: &SacNetwork<T>,
    slot: usize,
    g: D2,
    vector: &[f32],
    image: &mut Vec<u8>,
    pass: &mut TrunkPass<T>,
) {
    let spec = network.spec();
    // no copy for the identity, the only element without augmentation
    if g != D2::Identity {
        *image = transform_image(g, image, spec);
    }
    let vector = transform_vector(g, vector, &spec.vector_irreps);
    network.trunk.load_sample(slot, image, &vector, pass);
}

/// Key of an encoded observation: its identifier in the replay buffer and the group element that
/// transforms it.
pub(crate) type ObservationKey = (StepId, D2);

/// Activations, gradients and scratch memory of a [`SacNetwork`]'s passes over up to K steps,
/// allocated once.
pub(crate) struct SacWorkspace<T> {
    /// Buffers of the trunk's pass over the observations acted on.
    pub current: TrunkPass<T>,
    /// Buffers of the trunk's pass over all other observations: the next ones, and those of the
    /// steps before.
    pub others: TrunkPass<T>,
    /// Keys of the observations of `current`, then of `others`.
    pub observed: Vec<ObservationKey>,
    /// Positions in `observed` of each step's next observation and of the observations of the steps
    /// before it.
    pub sources: Vec<usize>,
    /// Fields of the trunk for the next observations, `[K, h]`.
    pub next_fields: Vec<T>,
    /// GRU input (item) of the step at each observation in `observed`.
    pub items: ContextItems<T>,
    /// Steps before the current, and before the next observations, that the GRUs read.
    pub before: [ContextSteps; 2],
    pub actor_reader: ContextPass<T>,
    pub critic_reader: ContextPass<T>,
    pub actor: LayerBuffers<T>,
    pub critics: [LayerBuffers<T>; 2],
    /// Actor outputs (mean, raw log_std) `[K, 2 A]` in natural order, and their gradient.
    pub output: Vec<f64>,
    pub d_output: Vec<f64>,
    /// Actions `[K, A]` in natural order, their log-probabilities `[K]`, and the actions' gradient.
    pub actions: Vec<f64>,
    pub log_pi: Vec<f64>,
    pub d_actions: Vec<f64>,
    /// Actions in irrep-major order, and the gradient with respect to a critic's state input.
    pub irreps: Vec<T>,
    pub d_state: Vec<T>,
    /// Targets y of the critics' loss, `[K]`.
    pub next_q_values: Vec<f64>,
    /// Gradient of the actor's loss with respect to the critics' parameters, which must not train
    /// the critics.
    pub discarded: Vec<T>,
    /// Scratch memory for one image.
    pub image: Vec<u8>,
}

impl<T: Scalar> SacNetwork<T> {
    /// Allocates a workspace for up to `capacity` steps (K).
    pub(crate) fn workspace(&self, capacity: usize) -> SacWorkspace<T> {
        let width = self.action_order.len();
        let zeros = |len: usize| vec![0.0; capacity * len];
        let reals = |len: usize| vec![T::ZERO; capacity * len];
        SacWorkspace {
            current: self.trunk.new_pass(capacity),
            others: self.trunk.new_pass(capacity * (1 + self.reader.length())),
            observed: Vec::new(),
            sources: Vec::new(),
            next_fields: reals(self.trunk.out_type().dim()),
            items: ContextItems::default(),
            before: <[ContextSteps; 2]>::default(),
            actor_reader: self.reader.new_pass(capacity),
            critic_reader: self.reader.new_pass(capacity),
            actor: LayerBuffers::new(&self.actor, capacity),
            critics: [(); 2].map(|()| LayerBuffers::new(&self.critic, capacity)),
            output: zeros(2 * width),
            d_output: zeros(2 * width),
            actions: zeros(width),
            log_pi: zeros(1),
            d_actions: zeros(width),
            irreps: reals(width),
            d_state: reals(self.reader.out_type().dim()),
            next_q_values: zeros(1),
            discarded: vec![T::ZERO; self.num_params()],
            image: vec![0; self.spec().image_len()],
        }
    }
}

impl<T: Scalar> SacWorkspace<T> {
    /// Returns the index and value of the critic with the smaller Q-value for the action in `slot`.
    pub fn min_qf(&self, slot: usize) -> (usize, f64) {
        let [qf1, qf2] = [0, 1].map(|qf: usize| self.critics[qf].y[slot].to_f64());
        if qf2 < qf1 { (1, qf2) } else { (0, qf1) }
    }

    /// Records the position of an observation in `observed`; returns its slot in `others` if the
    /// observation is new and must be loaded there. `n` is the number of current observations.
    pub fn locate(&mut self, observed: ObservationKey, n: usize) -> Option<usize> {
        let known = self.observed.iter().position(|&other| other == observed);
        let source = known.unwrap_or(self.observed.len());
        self.sources.push(source);
        if known.is_some() {
            return None;
        }
        self.observed.push(observed);
        Some(source - n)
    }
}
