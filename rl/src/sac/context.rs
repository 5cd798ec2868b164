//! Recurrent context of actor and critics: a GRU over the last steps of the episode before an
//! observation.

use equivariant::{Concat, FieldType, Gru, GruWorkspace, Scalar, Shape};
use rand::Rng;
use symmetry::{Irrep, irrep_major_permutation};

use crate::env::EnvSpec;
use crate::error::{RlError, require, require_width};
use crate::sac::settings::RecurrentContextSettings;

/// Layer that computes the input of an actor or critic: the observation's fields h, followed by the
/// state of a GRU over the last steps of the episode if there is a context. The GRU's input for a
/// step is [h, action, reward].
pub(crate) struct ContextReader {
    fields: FieldType,
    context: Option<Context>,
}

/// Layers of a recurrent context: the GRU, and the concatenations before and after it.
struct Context {
    gru: Gru,
    /// Concatenation of an observation's fields h with (action, reward), the GRU's input for a
    /// step.
    gru_input_concat: Concat,
    /// Indices of the components of (action, reward) in the environment's order, sorted by irrep
    /// (irrep-major order).
    order: Vec<usize>,
    /// Concatenation of an observation's fields h with the GRU's state, the input of an actor or
    /// critic.
    state_concat: Concat,
    /// Maximum number of steps that the GRU reads.
    length: usize,
}

/// Inputs of a GRU for M distinct steps, `[M, I]` with I numbers each.
#[derive(Clone, Debug, Default)]
pub(crate) struct GruInputs<T>(Vec<T>);

/// Last steps before each of n observations, as indices in [`GruInputs`].
#[derive(Clone, Debug, Default)]
pub(crate) struct ContextSteps {
    /// Indices of GRU inputs, `[L, n]` for up to L steps before each of n observations; for
    /// observation i, the last `lengths[i]` of the L are valid.
    input_indices: Vec<usize>,
    /// Number of steps before each observation that the GRU reads, `[n]`.
    lengths: Vec<usize>,
}

impl ContextSteps {
    /// Removes all steps, and prepares for `samples` observations with at most `length` steps
    /// before each.
    pub fn reset(&mut self, length: usize, samples: usize) {
        self.input_indices.clear();
        self.input_indices.resize(length * samples, 0);
        self.lengths.clear();
        self.lengths.resize(samples, 0);
    }

    /// Adds the step whose GRU input has the index `input` before the steps of observation `slot`:
    /// steps are added in reverse order. Steps beyond the maximum length are ignored.
    pub fn prepend(&mut self, slot: usize, input: usize) {
        let samples = self.lengths.len();
        let before = self.input_indices.len() / samples - self.lengths[slot];
        // filled from the last row up, so that all samples' sequences end in the same row
        if let Some(row) = before.checked_sub(1) {
            self.lengths[slot] += 1;
            self.input_indices[row * samples + slot] = input;
        }
    }
}

/// Buffers of a [`ContextReader`]'s passes over up to a fixed number of observations.
#[derive(Clone, Debug)]
pub(crate) struct ContextWorkspace<T> {
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
        settings: Option<RecurrentContextSettings>,
        spec: &EnvSpec,
    ) -> Result<Self, RlError> {
        let context = settings.map(|settings| Context::new(fields, settings, spec));
        Ok(Self { fields, context: context.transpose()? })
    }

    /// Returns the field type of the input of an actor or critic, which the reader computes.
    pub fn out_type(&self) -> FieldType {
        let context = self.context.as_ref();
        context.map_or(self.fields, |context| context.state_concat.out_shape().fields)
    }

    /// Returns L, the maximum number of steps that the GRU reads; 0 without a context.
    pub fn max_steps(&self) -> usize {
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

    pub fn new_workspace<T: Scalar>(&self, capacity: usize) -> ContextWorkspace<T> {
        let zeros = |width: usize| vec![T::ZERO; capacity * width];
        let context = self.context.as_ref();
        let width = self.out_type().dim();
        ContextWorkspace {
            gru: context.map(|context| context.gru.new_workspace(context.length, capacity)),
            state: zeros(width),
            d_state: zeros(width),
            d_out: zeros(width - self.fields.dim()),
            d_fields: zeros(self.fields.dim()),
        }
    }

    /// Resizes `gru_inputs` to the GRU inputs of `count` steps, all zeros.
    pub fn reset_gru_inputs<T: Scalar>(&self, count: usize, gru_inputs: &mut GruInputs<T>) {
        let width = self.context.as_ref().map_or(0, Context::gru_input_len);
        gru_inputs.0.clear();
        gru_inputs.0.resize(count * width, T::ZERO);
    }

    /// Writes the GRU input of a step from its observation's fields, and its action and reward in
    /// the environment's order.
    pub fn write_gru_input<T: Scalar>(
        &self,
        index: usize,
        fields: &[T],
        action: &[f32],
        reward: f32,
        gru_inputs: &mut GruInputs<T>,
    ) {
        let Some(context) = &self.context else { return };
        let width = context.gru_input_len();
        // the reward is the component after the last of the action
        let natural = |&i: &usize| f64::from(action.get(i).copied().unwrap_or(reward));
        let tail: Vec<T> = context.order.iter().map(natural).map(T::from_f64).collect();
        let item = &mut gru_inputs.0[index * width..(index + 1) * width];
        context.gru_input_concat.forward(fields, &tail, item);
    }

    /// Computes `state`, the input of an actor or critic, for n observations: from their fields
    /// `[n, h]` and the steps before them.
    pub fn forward<T: Scalar>(
        &self,
        params: &[T],
        fields: &[T],
        gru_inputs: &GruInputs<T>,
        steps: &ContextSteps,
        pass: &mut ContextWorkspace<T>,
    ) {
        let samples = fields.len() / self.fields.dim();
        let state = &mut pass.state[..samples * self.out_type().dim()];
        match (&self.context, &mut pass.gru) {
            (Some(context), Some(gru)) => {
                context.gru.forward_shared_inputs(
                    params,
                    &gru_inputs.0,
                    &steps.input_indices,
                    &steps.lengths,
                    gru,
                );
                context.state_concat.forward(fields, gru.last_states(), state);
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
        gru_inputs: &GruInputs<T>,
        n: usize,
        dparams: &mut [T],
        pass: &'a mut ContextWorkspace<T>,
    ) -> &'a [T] {
        let d_state = &pass.d_state[..n * self.out_type().dim()];
        let d_fields = &mut pass.d_fields[..n * self.fields.dim()];
        match (&self.context, &mut pass.gru) {
            (Some(context), Some(gru)) => {
                let d_out = &mut pass.d_out[..n * context.gru.out_type().dim()];
                context.state_concat.backward(d_state, d_fields, d_out);
                context.gru.backward(params, &gru_inputs.0, d_out, None, dparams, gru);
            }
            _ => d_fields.copy_from_slice(d_state),
        }
        d_fields
    }
}

impl Context {
    fn new(
        fields: FieldType,
        settings: RecurrentContextSettings,
        spec: &EnvSpec,
    ) -> Result<Self, RlError> {
        let (group, size) = (fields.group(), settings.size);
        require_width("context.size", size)?;
        let allowed = size.is_multiple_of(group.order());
        let expected = "a multiple of the order of the network's group, at least that";
        require("context.size", size as f32, expected, allowed)?;
        let in_range = (1..=64).contains(&settings.length);
        require("context.length", settings.length as f32, "1 to 64", in_range)?;
        let mut tail = spec.action_irreps.clone();
        tail.push(Irrep::Trivial);
        let shape = Shape::vector(fields);
        let gru_input_concat =
            Concat::new(shape, Shape::vector(FieldType::from_irreps(group, &tail)))?;
        let gru = Gru::new(gru_input_concat.out_shape().fields, size / group.order())?;
        Ok(Self {
            state_concat: Concat::new(shape, Shape::vector(gru.out_type()))?,
            gru,
            gru_input_concat,
            order: irrep_major_permutation(group, &tail),
            length: settings.length,
        })
    }

    /// Returns I, the length of the GRU's input for a step.
    fn gru_input_len(&self) -> usize {
        self.gru_input_concat.out_shape().len()
    }
}
