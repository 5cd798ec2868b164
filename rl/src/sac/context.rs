//! Recurrent context of actor and critics: a GRU over the last steps of the episode before an
//! observation.

use equivariant::{Concat, FieldType, Gru, GruWorkspace, Scalar, Shape};
use rand::Rng;
use symmetry::{Irrep, irrep_major_permutation};

use crate::env::EnvSpec;
use crate::error::{RlError, require};
use crate::sac::settings::ContextSettings;

/// Layer that computes the input of an actor or critic: the observation's fields h, followed by the
/// state of a GRU over the last steps of the episode if there is a context. The GRU's input for a
/// step, its item, is [h, action, reward].
pub(crate) struct ContextReader {
    fields: FieldType,
    context: Option<Context>,
}

/// Layers of a recurrent context: the GRU, and the concatenations before and after it.
struct Context {
    gru: Gru,
    /// Concatenation of an observation's fields h with (action, reward), the GRU's input for a
    /// step.
    item: Concat,
    /// Index in natural order of each component of (action, reward) in irrep-major order (sorted by
    /// irrep).
    order: Vec<usize>,
    /// Concatenation of an observation's fields h with the GRU's state, the input of an actor or
    /// critic.
    widened: Concat,
    /// Maximum number of steps that the GRU reads.
    length: usize,
}

/// GRU inputs (items) `[M, I]` of M distinct steps, I numbers each.
#[derive(Clone, Debug, Default)]
pub(crate) struct ContextItems<T>(Vec<T>);

/// Last steps before each of n observations, as indices of their GRU inputs (items) in
/// [`ContextItems`].
#[derive(Clone, Debug, Default)]
pub(crate) struct ContextSteps {
    /// Indices of GRU inputs, `[L, n]` for up to L steps before each of n observations; for
    /// observation i, the last `lengths[i]` of the L are valid.
    reads: Vec<usize>,
    /// Number of steps before each observation that the GRU reads, `[n]`.
    lengths: Vec<usize>,
}

impl ContextSteps {
    /// Removes all steps, and prepares for `samples` observations with at most `length` steps
    /// before each.
    pub fn clear(&mut self, length: usize, samples: usize) {
        self.reads.clear();
        self.reads.resize(length * samples, 0);
        self.lengths.clear();
        self.lengths.resize(samples, 0);
    }

    /// Adds the step with GRU input `item` before the steps of observation `slot`: steps are added
    /// in reverse order. Steps beyond the maximum length are ignored.
    pub fn prepend(&mut self, slot: usize, item: usize) {
        let samples = self.lengths.len();
        let before = self.reads.len() / samples - self.lengths[slot];
        // filled from the last row up, so that all samples' sequences end in the same row
        if let Some(row) = before.checked_sub(1) {
            self.lengths[slot] += 1;
            self.reads[row * samples + slot] = item;
        }
    }
}

/// Buffers of a [`ContextReader`]'s passes over up to a fixed number of observations.
#[derive(Clone, Debug)]
pub(crate) struct ContextPass<T> {
    gru: Option<GruWorkspace<T>>,
    /// Input of the actor or critic, `[N, S]` for N observations and S channels.
    pub state: Vec<T>,
    /// Gradient of the loss with respect to `state`, written before the backward pass.
    pub d_state: Vec<T>,
    d_out: Vec<T>,
    d_fields: Vec<T>,
}

impl ContextReader {
    pub fn new(
        fields: FieldType,
        settings: Option<ContextSettings>,
        spec: &EnvSpec,
    ) -> Result<Self, RlError> {
        let context = settings.map(|settings| Context::new(fields, settings, spec));
        Ok(Self { fields, context: context.transpose()? })
    }

    /// Returns the field type of the input of an actor or critic, which the reader computes.
    pub fn out_type(&self) -> FieldType {
        let context = self.context.as_ref();
        context.map_or(self.fields, |context| context.widened.out_shape().fields)
    }

    /// Returns L, the maximum number of steps that the GRU reads; 0 without a context.
    pub fn length(&self) -> usize {
        self.context.as_ref().map_or(0, |context| context.length)
    }

    pub fn num_params(&self) -> usize {
        let context = self.context.as_ref();
        context.map_or(0, |context| context.gru.num_params())
    }

    pub fn init<T: Scalar>(&self, rng: &mut dyn Rng, params: &mut [T]) {
        if let Some(context) = &self.context {
            context.gru.init(rng, params);
        }
    }

    pub fn new_pass<T: Scalar>(&self, capacity: usize) -> ContextPass<T> {
        let zeros = |width: usize| vec![T::ZERO; capacity * width];
        let context = self.context.as_ref();
        let width = self.out_type().dim();
        ContextPass {
            gru: context.map(|context| context.gru.new_workspace(context.length, capacity)),
            state: zeros(width),
            d_state: zeros(width),
            d_out: zeros(width - self.fields.dim()),
            d_fields: zeros(self.fields.dim()),
        }
    }

    /// Resizes `items` to the GRU inputs of `count` steps, all zeros.
    pub fn clear<T: Scalar>(&self, count: usize, items: &mut ContextItems<T>) {
        let width = self.context.as_ref().map_or(0, Context::item_len);
        items.0.clear();
        items.0.resize(count * width, T::ZERO);
    }

    /// Writes the GRU input of a step from its observation's fields, and its action and reward in
    /// natural order.
    pub fn write<T: Scalar>(
        &self,
        index: usize,
        fields: &[T],
        action: &[f32],
        reward: f32,
        items: &mut ContextItems<T>,
    ) {
        let Some(context) = &self.context else { return };
        let width = context.item_len();
        // the reward is the component after the last of the action
        let natural = |&i: &usize| f64::from(action.get(i).copied().unwrap_or(reward));
        let tail: Vec<T> = context.order.iter().map(natural).map(T::from_f64).collect();
        let item = &mut items.0[index * width..(index + 1) * width];
        context.item.forward(fields, &tail, item);
    }

    /// Computes `state`, the input of an actor or critic, for n observations: from their fields
    /// `[n, h]` and the steps before them.
    pub fn forward<T: Scalar>(
        &self,
        params: &[T],
        fields: &[T],
        items: &ContextItems<T>,
        steps: &ContextSteps,
        pass: &mut ContextPass<T>,
    ) {
        let samples = fields.len() / self.fields.dim();
        let state = &mut pass.state[..samples * self.out_type().dim()];
        match (&self.context, &mut pass.gru) {
            (Some(context), Some(gru)) => {
                context.gru.forward_shared_inputs(
                    params,
                    &items.0,
                    &steps.reads,
                    &steps.lengths,
                    gru,
                );
                context.widened.forward(fields, gru.last_states(), state);
            }
            _ => state.copy_from_slice(fields),
        }
    }

    /// Adds the gradient with respect to the GRU's parameters to `dparams`, from `d_state` of the n
    /// observations of the last forward pass; returns the gradient with respect to their fields,
    /// `[n, h]`. The fields of the steps before get no gradient: the encoder is not trained through
    /// the context.
    pub fn backward<'a, T: Scalar>(
        &self,
        params: &[T],
        items: &ContextItems<T>,
        n: usize,
        dparams: &mut [T],
        pass: &'a mut ContextPass<T>,
    ) -> &'a [T] {
        let d_state = &pass.d_state[..n * self.out_type().dim()];
        let d_fields = &mut pass.d_fields[..n * self.fields.dim()];
        match (&self.context, &mut pass.gru) {
            (Some(context), Some(gru)) => {
                let d_out = &mut pass.d_out[..n * context.gru.out_type().dim()];
                context.widened.backward(d_state, d_fields, d_out);
                context.gru.backward(params, &items.0, d_out, None, dparams, gru);
            }
            _ => d_fields.copy_from_slice(d_state),
        }
        d_fields
    }
}

impl Context {
    fn new(fields: FieldType, settings: ContextSettings, spec: &EnvSpec) -> Result<Self, RlError> {
        let (group, size) = (fields.group(), settings.size);
        let allowed = size > 0 && size.is_multiple_of(group.order());
        let expected = "a multiple of the order of the network's group, at least that";
        require("context.size", size as f32, expected, allowed)?;
        let in_range = (1..=64).contains(&settings.length);
        require("context.length", settings.length as f32, "1 to 64", in_range)?;
        let mut tail = spec.action_irreps.clone();
        tail.push(Irrep::Trivial);
        let shape = Shape::vector(fields);
        let item = Concat::new(shape, Shape::vector(FieldType::from_irreps(group, &tail)))?;
        let gru = Gru::new(item.out_shape().fields, size / group.order())?;
        Ok(Self {
            widened: Concat::new(shape, Shape::vector(gru.out_type()))?,
            gru,
            item,
            order: irrep_major_permutation(group, &tail),
            length: settings.length,
        })
    }

    /// Returns I, the length of the GRU's input for a step.
    fn item_len(&self) -> usize {
        self.item.out_shape().len()
    }
}
