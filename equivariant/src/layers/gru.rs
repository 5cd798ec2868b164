//! Gated recurrent unit on regular fields.

use std::fmt;
use std::ops::Range;

use rand::Rng;
use symmetry::FieldType;

use crate::error::LayerError;
use crate::layers::layer::{Layer, LayerSignature, Scalar};
use crate::layers::linear::Linear;
use crate::scratch::Scratch;
use crate::steerable::hadamard::hadamard_transform;

/// Factor on the standard deviation of the initial weights of a GRU: 1, because no ReLU follows
/// that would halve the second moment.
const GAIN: f64 = 1.0;

/// Gated recurrent unit (GRU) whose state consists of regular fields.
///
/// The unit of Cho et al., "Learning phrase representations using RNN encoder-decoder" (EMNLP 2014,
/// section 2.3), in the variant of cuDNN and of PyTorch's `GRU`, which applies the reset gate after
/// the matrix and not before:
///
/// ```text
/// r = sigmoid(W_ir x + b_ir + W_hr h + b_hr)
/// z = sigmoid(W_iz x + b_iz + W_hz h + b_hz)
/// n = tanh(W_in x + b_in + r (W_hn h + b_hn))
/// h' = (1 - z) n + z h
/// ```
///
/// The state h starts at zero. Matrices are equivariant and map to regular fields. Pointwise
/// operations happen in their regular basis, which the group permutes, so the unit is equivariant.
/// Under C1 it equals PyTorch's, with its layout of parameters: W_i `[3 H, in]`, b_i, W_h `[3 H,
/// H]`, b_h, and the rows of r, z and n in this order.
///
/// It maps sequences `[L, N, in]` of N samples to their last states `[N, H]`. It does not implement
/// [`Layer`], because the lengths of the sequences are not known in advance.
#[derive(Clone, Debug)]
pub struct Gru {
    /// Number of regular fields of the state.
    fields: usize,
    input: Linear,
    hidden: Linear,
}

impl Gru {
    /// Creates a gated recurrent unit for vectors of the field type `in_type`, with a state of
    /// `fields` regular fields of its group.
    ///
    /// # Errors
    /// When a type has no channels, or the gates have more than a field type can have.
    pub fn new(in_type: FieldType, fields: usize) -> Result<Gru, LayerError> {
        let group = in_type.group();
        let channels = fields.saturating_mul(3 * group.order());
        LayerError::check_channels("Gru", channels)?;
        let gates = group.regular_type(3 * fields);
        Ok(Gru {
            fields,
            input: Linear::new(in_type, gates)?,
            hidden: Linear::new(group.regular_type(fields), gates)?,
        })
    }

    /// Returns the field type of the input vectors.
    pub fn in_type(&self) -> FieldType {
        self.input.in_shape().fields
    }

    /// Returns the field type of the state, which is the output.
    pub fn out_type(&self) -> FieldType {
        self.hidden.in_shape().fields
    }

    /// Returns the number of parameters of the unit.
    pub fn num_params(&self) -> usize {
        self.input.num_params() + self.hidden.num_params()
    }

    /// Samples the initial weights of the unit with variance 1 / fan-in and sets the biases to
    /// zero.
    ///
    /// # Panics
    /// When `params` does not hold the parameters.
    pub fn init<T: Scalar>(&self, rng: &mut dyn Rng, params: &mut [T]) {
        self.check("params", params.len(), self.num_params());
        let (input, hidden) = params.split_at_mut(self.input.num_params());
        self.input.init_with_gain(rng, GAIN, input);
        self.hidden.init_with_gain(rng, GAIN, hidden);
    }

    /// Allocates the memory of forward and backward passes over up to `samples` sequences of up to
    /// `steps` steps.
    pub fn new_workspace<T: Scalar>(&self, steps: usize, samples: usize) -> GruWorkspace<T> {
        let zeros = |len: usize| vec![T::ZERO; len];
        let state = samples * self.state_dim();
        GruWorkspace {
            dims: [self.in_type().dim(), self.state_dim()],
            capacity: [steps, samples],
            sizes: [0; 2],
            is_filled: false,
            first_steps: Vec::with_capacity(samples),
            input_indices: Vec::with_capacity(steps * samples),
            input_gates: zeros(steps * 3 * state),
            states: zeros((steps + 1) * state),
            irrep_states: zeros((steps + 1) * state),
            gates: zeros(steps * 3 * state),
            state_gates: zeros(3 * state),
            candidates: zeros(steps * state),
            d_state: zeros(state),
            d_state_before: zeros(state),
            scratch: self.input.allocate_scratch(steps * samples),
        }
    }

    /// Runs the unit on N sequences of up to L vectors with `in` channels, `x` `[L, N, in]`, where
    /// sequence i has its `lengths[i]` steps at the end; [`GruWorkspace::last_states`] then returns
    /// the last states.
    ///
    /// Earlier rows of a sample are ignored but must be finite. An empty sequence leaves the state
    /// at zero.
    ///
    /// # Panics
    /// When a slice has a wrong length, a sequence is longer than L, or the workspace has no room
    /// or belongs to a unit of other sizes.
    pub fn forward<T: Scalar>(
        &self,
        params: &[T],
        x: &[T],
        lengths: &[usize],
        workspace: &mut GruWorkspace<T>,
    ) {
        let (samples, row) = (lengths.len(), lengths.len() * self.in_type().dim());
        let steps = x.len().checked_div(row).unwrap_or(0);
        self.check("x", x.len(), steps * row);
        let input_indices: Vec<usize> = (0..steps * samples).collect();
        self.forward_shared_inputs(params, x, &input_indices, lengths, workspace);
    }

    /// Runs the unit on sequences whose steps share input vectors, as [`Gru::forward`] does on
    /// sequences with vectors of their own.
    ///
    /// Step l of sample i reads row `input_indices[l, i]` of `x` `[M, in]`, for `input_indices`
    /// `[L, N]`; sample i has its `lengths[i]` steps at the end and ignores earlier ones. The input
    /// matrix is applied to each of the M rows once.
    ///
    /// # Panics
    /// As [`Gru::forward`], and when a step reads a row that `x` does not have.
    pub fn forward_shared_inputs<T: Scalar>(
        &self,
        params: &[T],
        x: &[T],
        input_indices: &[usize],
        lengths: &[usize],
        workspace: &mut GruWorkspace<T>,
    ) {
        self.check_and_record_inputs(params, x.len(), input_indices, lengths, workspace);
        let [steps, samples] = workspace.sizes;
        let (input, hidden) = params.split_at(self.input.num_params());
        let gates = 3 * self.state_dim();
        let rows = x.len() / self.in_type().dim();
        workspace.input_gates.resize(rows * gates, T::ZERO);
        self.input.forward(input, x, &mut workspace.input_gates, &mut workspace.scratch);
        self.change_basis(3, &mut workspace.input_gates);
        workspace.copy_input_gates_to_steps(gates);
        workspace.is_filled = true;
        workspace.states[..samples * self.state_dim()].fill(T::ZERO);
        workspace.irrep_states[..samples * self.state_dim()].fill(T::ZERO);
        for step in 0..steps {
            self.step_forward(hidden, step, workspace);
        }
    }

    /// Adds the gradient with respect to the parameters to `dparams` and writes the gradient with
    /// respect to the input into `dx`, if given.
    ///
    /// `d_out` `[N, H]` is the gradient with respect to the last states and `x` is the input of the
    /// last forward pass.
    ///
    /// # Panics
    /// When a slice has a wrong length, the workspace belongs to a unit of other sizes, or no
    /// forward pass ran since the last backward pass, which overwrites the saved values.
    pub fn backward<T: Scalar>(
        &self,
        params: &[T],
        x: &[T],
        d_out: &[T],
        dx: Option<&mut [T]>,
        dparams: &mut [T],
        workspace: &mut GruWorkspace<T>,
    ) {
        self.check_workspace(workspace);
        assert!(
            std::mem::take(&mut workspace.is_filled),
            "{self}: got a workspace that holds no values, expected one that forward has just filled"
        );
        let [steps, samples] = workspace.sizes;
        self.check("d_out", d_out.len(), samples * self.state_dim());
        self.check("dparams", dparams.len(), self.num_params());
        let at = self.input.num_params();
        let (d_input, d_hidden) = dparams.split_at_mut(at);
        workspace.d_state[..d_out.len()].copy_from_slice(d_out);
        self.change_basis(1, &mut workspace.d_state[..d_out.len()]);
        for step in (0..steps).rev() {
            self.step_backward(&params[at..], step, d_hidden, workspace);
        }
        workspace.sum_input_gate_gradients(3 * self.state_dim());
        self.change_basis(3, &mut workspace.input_gates);
        let (input, gates) = (&params[..at], &workspace.input_gates[..]);
        // the layer is linear, so its output is not needed and dy stands in for it
        let scratch = &mut workspace.scratch;
        self.input.backward(input, x, gates, gates, dx, d_input, scratch);
    }

    /// Returns H, the number of channels of the state.
    fn state_dim(&self) -> usize {
        self.out_type().dim()
    }

    /// Transforms vectors of `parts` times the state's regular fields between the regular basis and
    /// the irrep basis.
    fn change_basis<T: Scalar>(&self, parts: usize, rows: &mut [T]) {
        for row in rows.chunks_exact_mut(parts * self.state_dim()) {
            hadamard_transform(self.out_type().group(), row);
        }
    }

    /// Checks the slices of a forward pass and records in the workspace the first step of each
    /// sequence and the input vector that each step reads.
    fn check_and_record_inputs<T>(
        &self,
        params: &[T],
        x: usize,
        input_indices: &[usize],
        lengths: &[usize],
        workspace: &mut GruWorkspace<T>,
    ) {
        let (samples, rows) = (lengths.len(), x / self.in_type().dim());
        let steps = input_indices.len().checked_div(samples).unwrap_or(0);
        self.check_workspace(workspace);
        self.check("params", params.len(), self.num_params());
        self.check("x", x, rows * self.in_type().dim());
        self.check("input_indices", input_indices.len(), steps * samples);
        let longest = lengths.iter().max().copied().unwrap_or(0);
        let [most_steps, most] = workspace.capacity;
        assert!(
            longest <= steps && steps <= most_steps && samples <= most,
            "{self}: got {samples} sequences of {longest} steps in {steps}, expected at most \
             {most} of {most_steps}"
        );
        workspace.sizes = [steps, samples];
        workspace.first_steps.clear();
        workspace.first_steps.extend(lengths.iter().map(|len| steps - len));
        workspace.input_indices.clear();
        for (at, &row) in input_indices.iter().enumerate() {
            let counts = at / samples >= workspace.first_steps[at % samples];
            assert!(row < rows || !counts, "{self}: got row {row} to read, expected one of {rows}");
            workspace.input_indices.push(counts.then_some(row));
        }
    }

    /// Computes the next states of all sequences from the states before step `step`.
    fn step_forward<T: Scalar>(&self, hidden: &[T], step: usize, workspace: &mut GruWorkspace<T>) {
        let width = self.state_dim();
        let rows = workspace.rows(step);
        let (before, after) = workspace.states[rows.start..].split_at_mut(rows.len());
        let state_gates = &mut workspace.state_gates[..3 * rows.len()];
        let irrep_states = &workspace.irrep_states[rows.clone()];
        self.hidden.forward(hidden, irrep_states, state_gates, &mut workspace.scratch);
        self.change_basis(3, state_gates);
        let samples = after.chunks_exact_mut(width).zip(before.chunks_exact(width));
        let gates = workspace.gates[3 * rows.start..3 * rows.end].chunks_exact_mut(3 * width);
        let candidates = workspace.candidates[rows.clone()].chunks_exact_mut(width);
        let parts = gates.zip(state_gates.chunks_exact(3 * width)).zip(candidates);
        for (((next_state, state), ((gate_rows, state_rows), candidate)), &begin) in
            samples.zip(parts).zip(&workspace.first_steps)
        {
            if step < begin {
                // the sequence has not begun: its state is still the initial one
                next_state.fill(T::ZERO);
            } else {
                self.cell(gate_rows, state_rows, candidate, state, next_state);
            }
        }
        let next = rows.end..rows.end + rows.len();
        workspace.irrep_states[next.clone()].copy_from_slice(&workspace.states[next.clone()]);
        self.change_basis(1, &mut workspace.irrep_states[next]);
    }

    /// Computes the next state of one sequence in the regular basis. `gates` holds the input's
    /// contribution to the gates on entry, and r, z and n afterwards.
    fn cell<T: Scalar>(
        &self,
        gates: &mut [T],
        state_gates: &[T],
        candidate: &mut [T],
        before: &[T],
        after: &mut [T],
    ) {
        for i in 0..after.len() {
            let [r, z, n] = self.gate_positions(i);
            gates[r] = sigmoid(gates[r] + state_gates[r]);
            gates[z] = sigmoid(gates[z] + state_gates[z]);
            // saved, because the gradient of r needs the candidate before the reset gate
            candidate[i] = state_gates[n];
            gates[n] = tanh(gates[n] + gates[r] * state_gates[n]);
            after[i] = gates[n] + gates[z] * (before[i] - gates[n]);
        }
    }

    /// Returns the positions of the gates r, z and n of channel `i` of the state, in the regular
    /// basis.
    fn gate_positions(&self, i: usize) -> [usize; 3] {
        let (element, field) = (i / self.fields, i % self.fields);
        [0, 1, 2].map(|gate| (3 * element + gate) * self.fields + field)
    }

    /// Propagates the gradient of the states after step `step` to the states before the step and to
    /// the gates, whose gradients overwrite their values.
    fn step_backward<T: Scalar>(
        &self,
        hidden: &[T],
        step: usize,
        d_hidden: &mut [T],
        workspace: &mut GruWorkspace<T>,
    ) {
        let width = self.state_dim();
        let rows = workspace.rows(step);
        for (sample, &begin) in workspace.first_steps.iter().enumerate() {
            let own = sample * width..(sample + 1) * width;
            let at = rows.start + own.start..rows.start + own.end;
            let gates = &mut workspace.gates[3 * at.start..3 * at.end];
            let d_state_gates = &mut workspace.state_gates[3 * own.start..3 * own.end];
            if step < begin {
                gates.fill(T::ZERO);
                d_state_gates.fill(T::ZERO);
                workspace.d_state[own].fill(T::ZERO);
            } else {
                let values = [&workspace.candidates[at.clone()], &workspace.states[at]];
                self.cell_backward(gates, d_state_gates, values, &mut workspace.d_state[own]);
            }
        }
        let d_state_gates = &mut workspace.state_gates[..3 * rows.len()];
        self.change_basis(3, d_state_gates);
        let d_state_before = &mut workspace.d_state_before[..rows.len()];
        let (irrep_states, d_state_gates) =
            (&workspace.irrep_states[rows.clone()], &*d_state_gates);
        self.hidden.backward(
            hidden,
            irrep_states,
            // the layer is linear, so its output is not needed and the gradient stands in for it
            d_state_gates,
            d_state_gates,
            Some(&mut *d_state_before),
            d_hidden,
            &mut workspace.scratch,
        );
        self.change_basis(1, d_state_before);
        for (sum, &d) in workspace.d_state.iter_mut().zip(&*d_state_before) {
            *sum += d;
        }
    }

    /// Differentiates one step of one sequence in the regular basis; `d_state` becomes the part of
    /// the gradient that reaches the earlier state h through z h.
    fn cell_backward<T: Scalar>(
        &self,
        gates: &mut [T],
        d_state_gates: &mut [T],
        [candidate, before]: [&[T]; 2],
        d_state: &mut [T],
    ) {
        let one = T::from_f64(1.0);
        for i in 0..d_state.len() {
            let at = self.gate_positions(i);
            let [r, z, n] = at.map(|gate| gates[gate]);
            let d = d_state[i];
            // sigmoid' = r (1 - r) and tanh' = 1 - n^2, from the values of the forward pass
            let d_n = d * (one - z) * (one - n * n);
            let d_z = d * (before[i] - n) * z * (one - z);
            let d_r = d_n * candidate[i] * r * (one - r);
            for (gate, value) in at.into_iter().zip([d_r, d_z, d_n]) {
                gates[gate] = value;
                d_state_gates[gate] = value;
            }
            d_state_gates[at[2]] = d_n * r;
            d_state[i] = d * z;
        }
    }

    /// Panics if `workspace` belongs to a GRU of other sizes.
    fn check_workspace<T>(&self, workspace: &GruWorkspace<T>) {
        let own = [self.in_type().dim(), self.state_dim()];
        assert!(
            workspace.dims == own,
            "{self}: got a workspace of a unit with {:?} channels of input and state, expected {own:?}",
            workspace.dims
        );
    }

    fn check(&self, name: &str, got: usize, expected: usize) {
        assert!(got == expected, "{self}: got {name} of {got} values, expected {expected}");
    }
}

fn sigmoid<T: Scalar>(x: T) -> T {
    let one = T::from_f64(1.0);
    one / (one + (-x).exp())
}

fn tanh<T: Scalar>(x: T) -> T {
    // tanh x = 2 sigmoid(2 x) - 1, because `Real` has no function but exp
    let two = T::from_f64(2.0);
    two * sigmoid(two * x) - T::from_f64(1.0)
}

impl fmt::Display for Gru {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let (from, to, parameters) = (self.in_type(), self.out_type(), self.num_params());
        write!(f, "Gru({from} -> {to} | {parameters} parameters)")
    }
}

/// Memory of a [`Gru`] for a limited number of sequences: values that the forward pass saves for
/// the backward pass.
#[derive(Clone, Debug)]
pub struct GruWorkspace<T> {
    /// Numbers of channels of the input vectors and of the state.
    dims: [usize; 2],
    /// Maximum numbers of steps and of sequences that the workspace has memory for.
    capacity: [usize; 2],
    /// Numbers L of steps and N of sequences of the last forward pass.
    sizes: [usize; 2],
    /// `true` if the values of a forward pass have not been overwritten by a backward pass.
    is_filled: bool,
    /// Number of steps before each of the N sequences begins, `[N]`.
    first_steps: Vec<usize>,
    /// Index of the input vector that each of L steps of N sequences reads, `[L, N]`; `None` before
    /// a sequence begins.
    input_indices: Vec<Option<usize>>,
    /// Contribution of each of M input vectors to the gates, later its gradient, `[M, 3 H]` for H
    /// channels of the state.
    input_gates: Vec<T>,
    /// States of N sequences before and after each of L steps, in the regular basis with H
    /// channels, `[L + 1, N, H]`.
    states: Vec<T>,
    /// States of N sequences before and after each of L steps, in the irrep basis with H channels,
    /// `[L + 1, N, H]`.
    irrep_states: Vec<T>,
    /// Contribution of the input to the gates, later the gates r, z and n, then their gradients,
    /// for L steps of N sequences and H channels of the state, `[L, N, 3 H]`.
    gates: Vec<T>,
    /// Contribution of the states of N sequences to the gates of the current step, later its
    /// gradient, `[N, 3 H]` for H channels of the state.
    state_gates: Vec<T>,
    /// Contribution W_hn h + b_hn of the state h to the candidate state n, before the reset gate,
    /// for L steps of N sequences, `[L, N, H]` for H channels.
    candidates: Vec<T>,
    /// Gradient with respect to the states of N sequences after the current step, `[N, H]` for H
    /// channels.
    d_state: Vec<T>,
    /// Gradient with respect to the states of N sequences before the current step, through the
    /// matrices W_h only, `[N, H]` for H channels.
    d_state_before: Vec<T>,
    scratch: Scratch<T>,
}

impl<T: Scalar> GruWorkspace<T> {
    /// Returns the states of the N sequences after the last step of the last forward pass, `[N, H]`
    /// for H channels in the irrep basis.
    pub fn last_states(&self) -> &[T] {
        &self.irrep_states[self.rows(self.sizes[0])]
    }

    /// Returns the range, in the buffers of states, of all sequences' states before a step.
    fn rows(&self, step: usize) -> Range<usize> {
        let len = self.sizes[1] * self.dims[1];
        step * len..(step + 1) * len
    }

    /// Copies the contribution of each input vector to the gates, `width` numbers, to the steps
    /// that read the vector.
    fn copy_input_gates_to_steps(&mut self, width: usize) {
        for (to, read) in self.gates.chunks_exact_mut(width).zip(&self.input_indices) {
            if let Some(row) = read {
                to.copy_from_slice(&self.input_gates[row * width..(row + 1) * width]);
            }
        }
    }

    /// Sums the gradients of the gates over all steps that read the same input vector.
    fn sum_input_gate_gradients(&mut self, width: usize) {
        self.input_gates.fill(T::ZERO);
        for (from, read) in self.gates.chunks_exact(width).zip(&self.input_indices) {
            if let Some(row) = read {
                let sums = &mut self.input_gates[row * width..(row + 1) * width];
                sums.iter_mut().zip(from).for_each(|(sum, &d)| *sum += d);
            }
        }
    }
}
