//! Context of the heads: a GRU over the last steps before an observation.

use equivariant::{Concat, FieldType, Gru, GruWorkspace, Scalar, Shape};
use rand::Rng;
use symmetry::{Irrep, irrep_major_permutation};

use crate::env::EnvSpec;
use crate::error::{RlError, require};
use crate::sac::settings::ContextSettings;

/// Computes the input of a head: the observation's fields h, followed by the state of a GRU over
/// the last steps of the episode if there is a context. A step's item is [h, action, reward].
pub(crate) struct ContextReader {
    fields: FieldType,
    context: Option<Context>,
}

/// Layers of a context.
struct Context {
    gru: Gru,
    /// Concatenation of h with (action, reward).
    item: Concat,
    /// Natural index of every irrep-major component of (action, reward).
    order: Vec<usize>,
    /// Concatenation of h with the GRU's state.
    widened: Concat,
    /// Maximum number of steps.
    length: usize,
}

/// GRU inputs `[M, I]` of M distinct steps.
#[derive(Clone, Debug, Default)]
pub(crate) struct ContextItems<T>(Vec<T>);

/// Indices of the items of the last steps before each of n samples.
#[derive(Clone, Debug, Default)]
pub(crate) struct ContextSteps {
    /// Indices of items, `[L, n]`; the last `lengths[i]` rows of column i are valid.
    reads: Vec<usize>,
    /// Number of steps of each sample, `[n]`.
    lengths: Vec<usize>,
}

impl ContextSteps {
    /// Prepares for `samples` samples with at most `length` steps each, and removes all steps.
    pub fn clear(&mut self, length: usize, samples: usize) {
        self.reads.clear();
        self.reads.resize(length * samples, 0);
        self.lengths.clear();
        self.lengths.resize(samples, 0);
    }

    /// Adds a step before those of sample `slot`: steps are added in reverse order. Steps beyond
    /// the maximum length are ignored.
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

/// Buffers of a context reader for up to a fixed number of samples.
#[derive(Clone, Debug)]
pub(crate) struct ContextPass<T> {
    gru: Option<GruWorkspace<T>>,
    /// Input of a head, `[N, S]`.
    pub state: Vec<T>,
    /// Gradient with respect to `state`, written before the backward pass.
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

    /// Returns the field type of a head's input.
    pub fn out_type(&self) -> FieldType {
        let context = self.context.as_ref();
        context.map_or(self.fields, |context| context.widened.out_shape().fields)
    }

    /// Returns L, the maximum number of steps; 0 without a context.
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

    /// Resizes `items` to `count` zeros.
    pub fn clear<T: Scalar>(&self, count: usize, items: &mut ContextItems<T>) {
        let width = self.context.as_ref().map_or(0, Context::item_len);
        items.0.clear();
        items.0.resize(count * width, T::ZERO);
    }

    /// Writes the item of a step from its fields, and its action and reward in natural order.
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

    /// Fills `state` for samples with the fields `[n, h]` and the steps before them.
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

    /// Adds the gradient with respect to the parameters to `dparams`, from `d_state` of the n
    /// samples of the last forward pass; returns that of their fields, `[n, h]`. The fields of the
    /// steps before get no gradient: the encoder is not trained through the context.
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

    /// Returns I, the length of a step's item.
    fn item_len(&self) -> usize {
        self.item.out_shape().len()
    }
}
