//! Minibatches of steps: what is drawn for them, the fields of all that they need to see, and the
//! buffers of their gradients.

use std::ops::Range;

use equivariant::Scalar;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use symmetry::D2;

use crate::distributions::standard_normals;
use crate::env::{transform_image, transform_vector};
use crate::replay::{Replay, ReplayStep, StepIndex};
use crate::sac::context::{ContextItems, ContextPass, ContextSteps};
use crate::sac::network::SacNetwork;
use crate::sac::settings::SacSettings;
use crate::trunk::{LayerBuffers, TrunkPass};

/// Steps of one training chunk, as in PPO, or those of one window where they are more: observations
/// are shared within a chunk. A workspace holds a chunk, so there is a limit.
pub(super) fn training_chunk(window: usize) -> usize {
    window.clamp(8, 32)
}

/// Random draws for a minibatch; kept for their memory.
#[derive(Default)]
pub(super) struct Draws {
    /// The first step of each window.
    pub indices: Vec<usize>,
    pub steps: Vec<(usize, usize)>,
    pub elements: Vec<D2>,
    pub noise: [Vec<f32>; 2],
}

impl Draws {
    /// Draws a minibatch: first the windows, then their elements, then both noises.
    pub fn draw(&mut self, settings: &SacSettings, replay: &Replay, rng: &mut ChaCha8Rng) {
        let (batch, window) = (settings.batch, settings.window);
        let windows = batch.div_ceil(window);
        replay.sample(windows, settings.newest_share, rng, &mut self.indices);
        let steps = self.indices.iter();
        let steps = steps.flat_map(|&index| (0..window).map(move |further| (index, further)));
        self.steps.clear();
        self.steps.extend(steps.take(batch));
        let group = settings.augmentation.elements();
        self.elements.clear();
        for _ in 0..windows {
            let element = group[rng.random_range(0..group.len())];
            self.elements.extend([element].repeat(window));
        }
        self.elements.truncate(batch);
        for noise in &mut self.noise {
            noise.resize(batch * replay.spec().action.len(), 0.0);
            standard_normals(rng, noise);
        }
    }

    /// The minibatch that was drawn.
    pub fn batch<'a>(
        &'a self,
        settings: &SacSettings,
        alpha: f64,
        replay: &'a Replay,
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

/// A minibatch of B steps of a replay, with all that was drawn for it.
#[derive(Clone, Copy, Debug)]
pub(super) struct Batch<'a> {
    pub replay: &'a Replay,
    /// Which steps belong to it, `[B]`: an index of the replay, and how many steps further.
    pub steps: &'a [(usize, usize)],
    /// By what each is moved, `[B]`.
    pub elements: &'a [D2],
    /// Standard normal numbers `[B, A]` for the actor at the observations acted on, and at those
    /// after the steps.
    pub noise: [&'a [f32]; 2],
    pub gamma: f64,
    /// The worth of a nat of entropy.
    pub alpha: f64,
    pub cloning: f64,
}

impl<'a> Batch<'a> {
    /// The step at a position of the minibatch, and by what it is moved.
    pub fn step(&self, position: usize) -> (ReplayStep<'a>, D2) {
        let (index, further) = self.steps[position];
        let step = self.replay.get(index).wrapping_later(further);
        (step, self.elements[position])
    }

    /// The action `[A]` of a step, moved by g.
    pub fn action<T: Scalar>(&self, network: &SacNetwork<T>, step: ReplayStep, g: D2) -> Vec<f32> {
        transform_vector(g, step.action(), &network.spec().action)
    }

    /// The weight of one step in a mean over the minibatch.
    pub fn scale(&self) -> f64 {
        1.0 / self.steps.len() as f64
    }

    /// Computes the fields of all observations that the steps at positions `range` need, each of
    /// them once, and hands the steps before them to the contexts.
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

    /// Copies the fields of the next observations, and those of the steps before each observation
    /// with their actions and rewards.
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
            for step in earlier_steps(network, step) {
                let source = sources.next().unwrap_or_default();
                // what is acted on here writes its own item
                if source >= n {
                    let (action, reward) = (self.action(network, step, g), step.reward());
                    reader.write(source, fields_of(source), &action, reward, &mut w.items);
                }
                now.prepend(slot, source);
                next.prepend(slot, source);
            }
        }
    }
}

/// The steps before a step that a context may read, the last one first.
fn earlier_steps<'r, T: Scalar>(
    network: &SacNetwork<T>,
    step: ReplayStep<'r>,
) -> impl Iterator<Item = ReplayStep<'r>> + use<'r, T> {
    (1..=network.reader.length()).map_while(move |count| step.earlier(count))
}

/// Puts an observation into a slot, moved by g.
fn load_transformed<T: Scalar>(
    network: &SacNetwork<T>,
    slot: usize,
    g: D2,
    vector: &[f32],
    image: &mut Vec<u8>,
    pass: &mut TrunkPass<T>,
) {
    let spec = network.spec();
    if g != D2::Identity {
        *image = transform_image(g, image, spec);
    }
    let vector = transform_vector(g, vector, &spec.vector);
    network.trunk.load(slot, image, &vector, pass);
}

/// An observation of the replay, moved by an element.
pub(crate) type Observed = (StepIndex, D2);

/// Everything that the gradient of up to K steps needs, allocated once.
pub(crate) struct SacWorkspace<T> {
    /// Observations acted on.
    pub current: TrunkPass<T>,
    /// Other observations: those after the steps and those of the steps before.
    pub others: TrunkPass<T>,
    /// Which observations both hold, one pass after the other.
    pub observed: Vec<Observed>,
    /// Places of the fields of the observation after each step, and of those of the steps before.
    pub sources: Vec<usize>,
    /// Fields of the observations after the steps, `[K, h]`.
    pub next_fields: Vec<T>,
    /// ContextItems that contexts read: the step of each observation that is held, in their order.
    pub items: ContextItems<T>,
    /// The steps before, and those before the next observation.
    pub before: [ContextSteps; 2],
    pub actor_reader: ContextPass<T>,
    pub critic_reader: ContextPass<T>,
    pub actor: LayerBuffers<T>,
    pub critics: [LayerBuffers<T>; 2],
    /// Mean and log_std `[K, 2 A]` in natural order, and the gradient in them.
    pub output: Vec<f64>,
    pub d_output: Vec<f64>,
    /// Actions `[K, A]` in natural order and their log-probabilities `[K]`.
    pub actions: Vec<f64>,
    pub log_pi: Vec<f64>,
    pub d_actions: Vec<f64>,
    /// Actions in irrep-major order, and the gradient in what a critic reads.
    pub irreps: Vec<T>,
    pub d_state: Vec<T>,
    /// Targets of the critics, `[K]`.
    pub next_q_values: Vec<f64>,
    /// Gradients that nobody asks for.
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
            current: self.trunk.pass(capacity),
            others: self.trunk.pass(capacity * (1 + self.reader.length())),
            observed: Vec::new(),
            sources: Vec::new(),
            next_fields: reals(self.trunk.out_type().dim()),
            items: ContextItems::default(),
            before: <[ContextSteps; 2]>::default(),
            actor_reader: self.reader.pass(capacity),
            critic_reader: self.reader.pass(capacity),
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
    /// The critic that values the action of a slot least, and its value.
    pub fn min_qf(&self, slot: usize) -> (usize, f64) {
        let [qf1, qf2] = [0, 1].map(|qf: usize| self.critics[qf].y[slot].to_f64());
        if qf2 < qf1 { (1, qf2) } else { (0, qf1) }
    }

    /// Notes where the fields of an observation will be; returns its slot among those that are not
    /// acted on if it has to be shown there, since no earlier one is the same.
    pub fn locate(&mut self, observed: Observed, n: usize) -> Option<usize> {
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
