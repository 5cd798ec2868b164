//! A minibatch of steps, and the fields of all that it needs to see.

use std::ops::Range;

use equivariant::Scalar;
use symmetry::D2;

use crate::env::{moved_image, signed};
use crate::replay::recorded::Recorded;
use crate::replay::ring::Replay;
use crate::sac::network::SacNetwork;
use crate::sac::workspace::SacWorkspace;
use crate::trunk::TrunkPass;

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
    /// What a nat of entropy is worth.
    pub temperature: f64,
    pub cloning: f64,
}

impl<'a> Batch<'a> {
    /// The step at a position of the minibatch, and by what it is moved.
    pub fn step(&self, position: usize) -> (Recorded<'a>, D2) {
        let (index, further) = self.steps[position];
        let step = self.replay.get(index).along(further);
        (step, self.elements[position])
    }

    /// The action `[A]` of a step and its reward, moved by g.
    pub fn done<T>(&self, network: &SacNetwork<T>, step: Recorded, g: D2) -> (Vec<f32>, f32)
    where
        T: Scalar,
    {
        let action = signed(g, step.action(), &network.spec().action);
        (action, step.reward())
    }

    /// The weight of one step in a mean over the minibatch.
    pub fn scale(&self) -> f64 {
        1.0 / self.steps.len() as f64
    }

    /// Computes the fields of all observations that the steps at positions `range` need, each of
    /// them once, and hands the steps before them to the contexts.
    pub fn load<T: Scalar>(
        &self,
        (network, params): (&SacNetwork<T>, &[T]),
        range: &Range<usize>,
        w: &mut SacWorkspace<T>,
    ) {
        let n = range.len();
        w.shown.clear();
        w.sources.clear();
        for (slot, position) in range.clone().enumerate() {
            let (step, g) = self.step(position);
            step.image(&mut w.image);
            show(network, slot, (g, step.vector()), &mut w.image, &mut w.here);
            w.shown.push((step.place(), g));
        }
        for position in range.clone() {
            let (step, g) = self.step(position);
            if let Some(slot) = w.source((step.next_place(), g), n) {
                step.next_image(&mut w.image);
                let vector = (g, step.next_vector());
                show(network, slot, vector, &mut w.image, &mut w.there);
            }
            for earlier in before(network, step) {
                if let Some(slot) = w.source((earlier.place(), g), n) {
                    earlier.image(&mut w.image);
                    let vector = (g, earlier.vector());
                    show(network, slot, vector, &mut w.image, &mut w.there);
                }
            }
        }
        let params = &params[network.trunk.params()];
        let there = w.shown.len() - n;
        network.trunk.forward(params, n, &mut w.here);
        network.trunk.forward(params, there, &mut w.there);
        self.hand_out(network, range, w);
    }

    /// Copies the fields of the next observations, and those of the steps before each observation
    /// with their actions and rewards.
    fn hand_out<T: Scalar>(
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
        reader.clear(w.shown.len(), &mut w.items);
        let (here, there) = (w.here.fields(), w.there.fields());
        let fields_of = |source: usize| match source.checked_sub(n) {
            Some(slot) => &there[slot * width..(slot + 1) * width],
            None => &here[source * width..(source + 1) * width],
        };
        let mut sources = w.sources.iter().copied();
        for (slot, position) in range.clone().enumerate() {
            let own = slot * width..(slot + 1) * width;
            let (step, g) = self.step(position);
            let copied = w.next_fields[own].iter_mut();
            copied
                .zip(fields_of(sources.next().unwrap_or_default()))
                .for_each(|(to, &x)| *to = x);
            if reader.length() == 0 {
                continue;
            }
            let (action, reward) = self.done(network, step, g);
            reader.write(slot, fields_of(slot), (&action, reward), &mut w.items);
            next.prepend(slot, slot);
            for step in before(network, step) {
                let source = sources.next().unwrap_or_default();
                // what is acted on here writes its own item
                if source >= n {
                    let (action, reward) = self.done(network, step, g);
                    reader.write(source, fields_of(source), (&action, reward), &mut w.items);
                }
                now.prepend(slot, source);
                next.prepend(slot, source);
            }
        }
    }
}

/// The steps before a step that a context may read, the last one first.
fn before<'r, T: Scalar>(
    network: &SacNetwork<T>,
    step: Recorded<'r>,
) -> impl Iterator<Item = Recorded<'r>> + use<'r, T> {
    (1..=network.reader.length()).map_while(move |count| step.earlier(count))
}

/// Puts an observation into a slot, moved by g.
fn show<T: Scalar>(
    network: &SacNetwork<T>,
    slot: usize,
    (g, vector): (D2, &[f32]),
    image: &mut Vec<u8>,
    pass: &mut TrunkPass<T>,
) {
    let spec = network.spec();
    if g != D2::Identity {
        *image = moved_image(g, image, spec);
    }
    let vector = signed(g, vector, &spec.vector);
    network.trunk.load(slot, image, &vector, pass);
}
