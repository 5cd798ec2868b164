//! The Adam optimiser on one flat parameter vector, with a learning rate for each range of it.

use std::ops::Range;

use crate::algorithm::AlgorithmState;
use crate::error::assert_len;

// checkpoint names of the optimiser's state
const FIRST_MOMENT: &str = "adam.first";
pub(crate) const SECOND_MOMENT_NAME: &str = "adam.second";
const STEPS: &str = "adam.steps";

/// A range of the parameter vector with its own learning rate.
#[derive(Clone, Debug, PartialEq)]
pub struct ParamGroup {
    /// Positions of the group's parameters in the flat parameter vector of a network.
    pub range: Range<usize>,
    /// Adam's step size for the parameters in `range`, at least 0.
    pub learning_rate: f32,
}

impl ParamGroup {
    /// Creates the group of all `len` parameters of a network.
    pub(crate) fn of_all_params(len: usize, learning_rate: f32) -> Self {
        Self { range: 0..len, learning_rate }
    }

    fn assert_within(&self, len: usize) {
        let range = &self.range;
        assert!(
            range.start <= range.end && range.end <= len,
            "the group {range:?} lies outside the {len} parameters"
        );
    }
}

/// Adam optimiser: Kingma and Ba, "Adam: a method for stochastic optimization" (ICLR 2015),
/// algorithm 1. The fields are the complete state: a copy of them continues with the same bits.
#[derive(Clone, Debug, PartialEq)]
pub struct Adam {
    /// Decay rates of Adam's first and second moments, in [0, 1).
    pub betas: [f32; 2],
    /// Constant added to the root of the second moment in Adam's denominator, above 0.
    pub epsilon: f32,
    /// Number of optimiser steps taken so far.
    pub steps: u64,
    /// Running mean of the gradient, one value for each parameter.
    pub first_moment: Vec<f32>,
    /// Running mean of the squared gradient, one value for each parameter.
    pub second_moment: Vec<f32>,
}

impl Adam {
    /// Creates an optimiser with zero moments for `num_params` parameters, and decay rates of 0.9
    /// and 0.999.
    pub fn new(num_params: usize, epsilon: f32) -> Self {
        Self {
            betas: [0.9, 0.999],
            epsilon,
            steps: 0,
            first_moment: vec![0.0; num_params],
            second_moment: vec![0.0; num_params],
        }
    }

    /// Updates the parameters of `groups` in `params` by one Adam step against `gradient`, each
    /// group at its own learning rate; all others stay as they are.
    ///
    /// # Panics
    /// If `params`, `gradient` and the moments differ in length, or a group lies outside them.
    /// Nothing has changed then.
    pub fn step(&mut self, groups: &[ParamGroup], params: &mut [f32], gradient: &[f32]) {
        let len = params.len();
        assert_len("gradient", gradient.len(), len);
        assert_len("first_moment", self.first_moment.len(), len);
        assert_len("second_moment", self.second_moment.len(), len);
        groups.iter().for_each(|group| group.assert_within(len));
        self.steps += 1;
        for group in groups {
            self.step_group(group, params, gradient);
        }
    }

    /// Returns Adam's first and second moments and its number of steps, for a checkpoint.
    pub(crate) fn save(&self) -> AlgorithmState<'_> {
        AlgorithmState {
            tensors: vec![
                (FIRST_MOMENT, &self.first_moment),
                (SECOND_MOMENT_NAME, &self.second_moment),
            ],
            counters: vec![(STEPS, self.steps)],
        }
    }

    /// Restores Adam's moments and number of steps from a state whose first entries are those of
    /// [`Adam::save`].
    pub(crate) fn restore(&mut self, state: &AlgorithmState<'_>) {
        self.first_moment.copy_from_slice(state.tensors[0].1);
        self.second_moment.copy_from_slice(state.tensors[1].1);
        self.steps = state.counters[0].1;
    }

    fn step_group(&mut self, group: &ParamGroup, params: &mut [f32], gradient: &[f32]) {
        let range = group.range.clone();
        let ([beta1, beta2], epsilon) = (self.betas, self.epsilon);
        // the bias corrections c1 and c2, moved out of the loop: m / c1 into the rate, v / c2 into
        // the root; epsilon is added after the correction, as in the paper's algorithm
        let rate = group.learning_rate / bias_correction(beta1, self.steps);
        let root = bias_correction(beta2, self.steps).sqrt();
        let first = &mut self.first_moment[range.clone()];
        let second = &mut self.second_moment[range.clone()];
        for (((p, g), m), v) in
            params[range.clone()].iter_mut().zip(&gradient[range]).zip(first).zip(second)
        {
            *m = beta1 * *m + (1.0 - beta1) * g;
            *v = beta2 * *v + (1.0 - beta2) * g * g;
            *p -= rate * *m / (v.sqrt() / root + epsilon);
        }
    }
}

/// Returns Adam's bias correction 1 - beta^t after t = `steps` steps, computed in f64, since the
/// subtraction cancels digits for a beta near 1.
pub(crate) fn bias_correction(beta: f32, steps: u64) -> f32 {
    (1.0 - f64::from(beta).powf(steps as f64)) as f32
}

/// Scales `gradient` so that its Euclidean norm is at most `max_norm`; returns the norm before
/// clipping.
///
/// Pascanu et al., "On the difficulty of training recurrent neural networks" (ICML 2013),
/// algorithm 1. The sum runs in order, in f64, so its bits do not depend on the thread count.
///
/// # Panics
/// If `max_norm` is not above 0.
pub fn clip_global_norm(gradient: &mut [f32], max_norm: f32) -> f64 {
    assert!(max_norm > 0.0, "max_norm is {max_norm}, expected a number above 0");
    let norm = norm(gradient);
    if norm > f64::from(max_norm) {
        let scale = (f64::from(max_norm) / norm) as f32;
        gradient.iter_mut().for_each(|g| *g *= scale);
    }
    norm
}

/// Returns the Euclidean norm of `gradient`, whose squares are summed in order in f64.
pub(crate) fn norm(gradient: &[f32]) -> f64 {
    gradient.iter().map(|&g| f64::from(g).powi(2)).sum::<f64>().sqrt()
}

/// Clips every component of `gradient` to [-`limit`, `limit`]; returns the number of clipped
/// components.
pub(crate) fn clip_values(gradient: &mut [f32], limit: f32) -> usize {
    let mut outside = 0;
    for g in gradient.iter_mut().filter(|g| g.abs() > limit) {
        *g = g.clamp(-limit, limit);
        outside += 1;
    }
    outside
}

#[cfg(test)]
mod tests {
    use super::*;

    fn group(range: Range<usize>, learning_rate: f32) -> ParamGroup {
        ParamGroup { range, learning_rate }
    }

    /// Golden numbers, from this Python script (no library):
    /// ```text
    /// p = [1.0, -2.0]; m = [0, 0]; v = [0, 0]; lr = [0.1, 0.01]
    /// for t, g in enumerate([(0.5, -1.0), (0.25, 3.0), (-1.0, 0.0)], 1):
    ///     for i in range(2):
    ///         m[i] = 0.9 * m[i] + 0.1 * g[i]; v[i] = 0.999 * v[i] + 0.001 * g[i] ** 2
    ///         p[i] -= lr[i] * (m[i] / (1 - 0.9 ** t)) / ((v[i] / (1 - 0.999 ** t)) ** 0.5 + 1e-5)
    ///     print(p)
    /// ```
    #[test]
    fn three_steps_by_hand() {
        let golden = [[0.900_002, -1.9900001], [0.8067864, -1.994_942], [0.8274218, -1.9987621]];
        let mut adam = Adam::new(2, 1e-5);
        let mut params = [1.0, -2.0];
        let groups = [group(0..1, 0.1), group(1..2, 0.01)];
        for (gradient, expected) in [[0.5, -1.0], [0.25, 3.0], [-1.0, 0.0]].iter().zip(golden) {
            adam.step(&groups, &mut params, gradient);
            for (p, e) in params.iter().zip(expected) {
                assert!((p - e).abs() < 1e-5, "{params:?} {expected:?}");
            }
        }
    }

    #[test]
    fn the_first_step_is_the_learning_rate_and_ungrouped_parameters_stay() {
        let mut adam = Adam::new(3, 1e-12);
        let mut params = [0.0; 3];
        adam.step(&[group(0..2, 0.1)], &mut params, &[7.0, -0.01, 1.0]);
        assert!((params[0] + 0.1).abs() < 1e-6 && (params[1] - 0.1).abs() < 1e-6);
        assert_eq!(params[2], 0.0);
    }

    #[test]
    fn clipping_keeps_the_direction() {
        let mut gradient = [3.0, -4.0];
        assert_eq!(clip_global_norm(&mut gradient, 0.5), 5.0);
        assert!((gradient[0] - 0.3).abs() < 1e-6 && (gradient[1] + 0.4).abs() < 1e-6);
        assert!((clip_global_norm(&mut gradient, 0.6) - 0.5).abs() < 1e-6);
        assert!((gradient[0] - 0.3).abs() < 1e-6);
    }
}
