//! Generalised advantage estimation.

use crate::env::StepOutcome;
use crate::error::assert_len;

/// Inputs of generalised advantage estimation: T steps of N environments, time-major.
#[derive(Clone, Copy, Debug)]
pub struct GaeInputs<'a> {
    /// Rewards of all steps, `[T, N]`.
    pub rewards: &'a [f32],
    /// State values V(s_t) of the observations acted on, `[T, N]`.
    pub values: &'a [f32],
    /// State of the episode after each step, `[T, N]`.
    pub outcomes: &'a [StepOutcome],
    /// State value V of the final observation of each step that truncated an episode, `[T, N]`;
    /// other entries are not read.
    pub final_values: &'a [f32],
    /// State value V of each environment's observation after the last step, `[N]`.
    pub last_values: &'a [f32],
}

impl GaeInputs<'_> {
    /// Panics if the lengths of the inputs do not agree on one number T of steps and N of
    /// environments.
    fn check(&self) {
        let (n, len) = (self.last_values.len(), self.rewards.len());
        assert!(
            n > 0 && len.is_multiple_of(n),
            "rewards: got {len} values, expected a multiple of the {n} last_values ([T, N])"
        );
        assert_len("values", self.values.len(), len);
        assert_len("outcomes", self.outcomes.len(), len);
        assert_len("final_values", self.final_values.len(), len);
    }

    /// Returns the next state value V_(t+1) and the next advantage A_(t+1) of sample `i` = t * N +
    /// n; `later` holds the advantages computed so far.
    fn next_value_and_advantage(&self, i: usize, later: &[f32]) -> (f32, f32) {
        let n = self.last_values.len();
        match self.outcomes[i] {
            StepOutcome::Running if i + n < self.values.len() => (self.values[i + n], later[i + n]),
            // the episode goes on after the rollout: its value is known, its advantages are not
            StepOutcome::Running => (self.last_values[i % n], 0.0),
            StepOutcome::Terminated => (0.0, 0.0),
            // not `values[i + n]`, which belongs to the first observation of the next episode
            StepOutcome::Truncated => (self.final_values[i], 0.0),
        }
    }
}

/// Writes the advantages and the returns (advantage + value) of all steps, both `[T, N]`.
///
/// Schulman et al., "High-dimensional continuous control using generalized advantage estimation"
/// (ICLR 2016), equation 16, as the recurrence A_t = delta_t + gamma lambda A_(t+1) with
/// delta_t = r_t + gamma V_(t+1) - V_t. Ends follow Pardo et al., "Time limits in reinforcement
/// learning" (ICML 2018): a termination bootstraps zero, a truncation the value of the final
/// observation, and neither lets the next episode into the sum. `gamma` and `lambda` are in [0, 1].
///
/// # Panics
/// If the lengths do not agree on one T and N, or `gamma` or `lambda` is outside [0, 1];
/// [`crate::RolloutBuffer`] guarantees that they do and are not.
pub fn gae(
    inputs: &GaeInputs,
    gamma: f32,
    lambda: f32,
    advantages: &mut [f32],
    returns: &mut [f32],
) {
    inputs.check();
    for (name, value) in [("gamma", gamma), ("lambda", lambda)] {
        assert!((0.0..=1.0).contains(&value), "{name} is {value}, expected a number in [0, 1]");
    }
    assert_len("advantages", advantages.len(), inputs.rewards.len());
    assert_len("returns", returns.len(), inputs.rewards.len());
    // backwards, since A_t needs A_(t+1)
    for i in (0..inputs.rewards.len()).rev() {
        let (bootstrap, tail) = inputs.next_value_and_advantage(i, advantages);
        let delta = inputs.rewards[i] + gamma * bootstrap - inputs.values[i];
        advantages[i] = delta + gamma * lambda * tail;
        returns[i] = advantages[i] + inputs.values[i];
    }
}

#[cfg(test)]
mod tests {
    use rand::{RngExt, SeedableRng};
    use rand_chacha::ChaCha8Rng;

    use super::*;

    const STEPS: usize = 23;
    const ENVS: usize = 3;

    /// Computes the defining double sum: A_t = sum over l of (gamma lambda)^l delta_(t+l), up to
    /// the end of the episode.
    fn slow(inputs: &GaeInputs, gamma: f64, lambda: f64) -> Vec<f64> {
        let delta = |t: usize, e: usize| {
            let i = t * ENVS + e;
            let next = match inputs.outcomes[i] {
                StepOutcome::Terminated => 0.0,
                StepOutcome::Truncated => inputs.final_values[i],
                StepOutcome::Running if t + 1 == STEPS => inputs.last_values[e],
                StepOutcome::Running => inputs.values[i + ENVS],
            };
            f64::from(inputs.rewards[i]) + gamma * f64::from(next) - f64::from(inputs.values[i])
        };
        let mut all = Vec::new();
        for t in 0..STEPS {
            for e in 0..ENVS {
                let end = (t..STEPS)
                    .find(|&s| inputs.outcomes[s * ENVS + e].is_ended())
                    .unwrap_or(STEPS - 1);
                all.push(
                    (t..=end).map(|s| (gamma * lambda).powi((s - t) as i32) * delta(s, e)).sum(),
                );
            }
        }
        all
    }

    #[test]
    fn recurrence_equals_double_sum() {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let mut random =
            |n: usize| (0..n).map(|_| rng.random_range(-1.0f32..1.0)).collect::<Vec<_>>();
        let len = STEPS * ENVS;
        let (rewards, values, final_values, last_values) =
            (random(len), random(len), random(len), random(ENVS));
        let kinds = [
            StepOutcome::Running,
            StepOutcome::Running,
            StepOutcome::Terminated,
            StepOutcome::Running,
            StepOutcome::Truncated,
        ];
        let outcomes: Vec<_> = (0..len).map(|i| kinds[(i * i + i / 7) % 5]).collect();
        assert!(
            outcomes.contains(&StepOutcome::Terminated)
                && outcomes.contains(&StepOutcome::Truncated)
        );
        let inputs = GaeInputs {
            rewards: &rewards,
            values: &values,
            outcomes: &outcomes,
            final_values: &final_values,
            last_values: &last_values,
        };
        let (mut advantages, mut returns) = (vec![0.0; len], vec![0.0; len]);
        gae(&inputs, 0.99, 0.95, &mut advantages, &mut returns);
        for (i, expected) in slow(&inputs, 0.99, 0.95).into_iter().enumerate() {
            assert!(
                (f64::from(advantages[i]) - expected).abs() < 1e-5,
                "{i}: {} {expected}",
                advantages[i]
            );
            assert!((returns[i] - advantages[i] - values[i]).abs() < 1e-6);
        }
    }

    /// Returns the first advantage of one environment, two steps, gamma 0.5 and lambda 1, if the
    /// first step ends as `outcome`. By hand: the second step has delta = 1 + 0.5 * 4 - 2 = 1.
    fn first_advantage(outcome: StepOutcome) -> f32 {
        let inputs = GaeInputs {
            rewards: &[1.0, 1.0],
            values: &[0.0, 2.0],
            outcomes: &[outcome, StepOutcome::Running],
            final_values: &[10.0, -100.0],
            last_values: &[4.0],
        };
        let (mut advantages, mut returns) = ([0.0; 2], [0.0; 2]);
        gae(&inputs, 0.5, 1.0, &mut advantages, &mut returns);
        assert_eq!(advantages[1], 1.0);
        advantages[0]
    }

    #[test]
    fn the_three_outcomes_bootstrap_differently() {
        assert_eq!(first_advantage(StepOutcome::Running), 1.0 + 0.5 * 2.0 + 0.5 * 1.0);
        assert_eq!(first_advantage(StepOutcome::Terminated), 1.0);
        assert_eq!(first_advantage(StepOutcome::Truncated), 1.0 + 0.5 * 10.0);
    }
}
