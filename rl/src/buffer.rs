//! The rollout buffer: T steps of N environments, time-major.

use crate::env::{EnvSpec, Observations, Outcome, Transition};
use crate::error::{RlError, check_finite, check_len};
use crate::gae::{GaeInputs, gae};
use crate::policy::{Decisions, Policy};

/// T steps of N environments. It is allocated once; `push` T times, `finish`, read, `clear`.
#[derive(Clone, Debug)]
pub struct RolloutBuffer {
    spec: EnvSpec,
    steps: usize,
    pushed: usize,
    finished: bool,
    observations: Observations,
    decisions: Decisions,
    rewards: Vec<f32>,
    outcomes: Vec<Outcome>,
    final_values: Vec<f32>,
    last_values: Vec<f32>,
    /// Final observations of the samples that were truncated, and which those are.
    finals: Observations,
    truncated: Vec<usize>,
    last: Observations,
}

impl RolloutBuffer {
    /// Allocates `steps` (T, at least 1) steps of the environments of `spec`.
    ///
    /// # Errors
    /// [`RlError::EmptySpec`] or [`RlError::Setting`] when a size is zero.
    pub fn new(spec: &EnvSpec, steps: usize) -> Result<Self, RlError> {
        spec.check()?;
        if steps == 0 {
            return Err(RlError::Setting {
                name: "steps",
                value: 0.0,
                expected: "at least 1 step",
            });
        }
        let all = EnvSpec {
            num_envs: spec.num_envs * steps,
            ..spec.clone()
        };
        Ok(Self {
            spec: spec.clone(),
            steps,
            pushed: 0,
            finished: false,
            observations: Observations::new(&all),
            decisions: Decisions::new(&all),
            rewards: vec![0.0; all.num_envs],
            outcomes: vec![Outcome::Running; all.num_envs],
            final_values: vec![0.0; all.num_envs],
            last_values: vec![0.0; spec.num_envs],
            finals: Observations::empty(),
            truncated: Vec::new(),
            last: Observations::new(spec),
        })
    }

    /// Appends one step: the observations that were acted on, the decisions, what they led to, and the values of the
    /// final observations `[N]` (read where the outcome is truncated).
    ///
    /// # Errors
    /// [`RlError::BufferFull`] past T steps, [`RlError::Shape`] when an array does not fit, [`RlError::NotFinite`] for
    /// a reward that is not a number.
    pub fn push(
        &mut self,
        observations: &Observations,
        decisions: &Decisions,
        transition: &Transition,
        final_values: &[f32],
    ) -> Result<(), RlError> {
        if self.pushed == self.steps {
            return Err(RlError::BufferFull { steps: self.steps });
        }
        self.check_step(observations, decisions, transition, final_values)?;
        let t = self.pushed;
        copy_row(&mut self.observations.images, t, &observations.images);
        copy_row(&mut self.observations.vectors, t, &observations.vectors);
        copy_row(&mut self.decisions.actions, t, &decisions.actions);
        copy_row(&mut self.decisions.log_probs, t, &decisions.log_probs);
        copy_row(&mut self.decisions.values, t, &decisions.values);
        copy_row(&mut self.rewards, t, &transition.rewards);
        copy_row(&mut self.outcomes, t, &transition.outcomes);
        copy_row(&mut self.final_values, t, final_values);
        self.keep_finals(transition);
        self.pushed += 1;
        Ok(())
    }

    /// Keeps what [`RolloutBuffer::revalue`] needs of the step that is being pushed.
    fn keep_finals(&mut self, transition: &Transition) {
        for (n, &outcome) in transition.outcomes.iter().enumerate() {
            if outcome == Outcome::Truncated {
                let (image, vector) = transition.final_observations.sample(&self.spec, n);
                self.finals.images.extend_from_slice(image);
                self.finals.vectors.extend_from_slice(vector);
                self.truncated.push(self.pushed * self.spec.num_envs + n);
            }
        }
    }

    fn check_step(
        &self,
        observations: &Observations,
        decisions: &Decisions,
        transition: &Transition,
        final_values: &[f32],
    ) -> Result<(), RlError> {
        let n = self.spec.num_envs;
        observations.check(&self.spec, n)?;
        transition.check(&self.spec)?;
        check_len(
            "actions",
            "[N, A]",
            decisions.actions.len(),
            n * self.spec.action.len(),
        )?;
        check_len("log_probs", "[N]", decisions.log_probs.len(), n)?;
        check_len("values", "[N]", decisions.values.len(), n)?;
        check_len("final_values", "[N]", final_values.len(), n)?;
        transition
            .rewards
            .iter()
            .try_for_each(|&r| check_finite("a reward", f64::from(r)))
    }

    /// Closes a full buffer with the observations after its last step, and their values `[N]`.
    ///
    /// # Errors
    /// [`RlError::BufferNotFinished`] before T steps were pushed, [`RlError::Shape`] for a wrong length.
    pub fn finish(&mut self, last: &Observations, last_values: &[f32]) -> Result<(), RlError> {
        if self.pushed != self.steps {
            return Err(RlError::BufferNotFinished {
                got: self.pushed,
                steps: self.steps,
            });
        }
        check_len("last_values", "[N]", last_values.len(), self.spec.num_envs)?;
        last.check(&self.spec, self.spec.num_envs)?;
        self.last_values.copy_from_slice(last_values);
        self.last.clone_from(last);
        self.finished = true;
        Ok(())
    }

    /// Replaces log-probabilities and values, those that bootstrap included, by what `policy` says. So it can learn from
    /// actions that another one took: probability ratios start at 1, and advantages are differences to its own values. That the states
    /// are those the other policy came to is not corrected.
    ///
    /// # Errors
    /// [`RlError::BufferNotFinished`] before `finish`, [`RlError::Shape`] for a policy of other environments.
    pub fn revalue<P: Policy>(&mut self, policy: &mut P) -> Result<(), RlError> {
        self.check_finished()?;
        policy.assess(&self.observations, &mut self.decisions)?;
        let mut values = vec![0.0; self.truncated.len()];
        policy.values(&self.finals, &mut values)?;
        for (&sample, value) in self.truncated.iter().zip(values) {
            self.final_values[sample] = value;
        }
        policy.values(&self.last, &mut self.last_values)
    }

    /// Forgets every step and keeps the memory.
    pub fn clear(&mut self) {
        self.pushed = 0;
        self.finished = false;
        self.truncated.clear();
        self.finals.images.clear();
        self.finals.vectors.clear();
    }

    /// Writes advantages and returns `[T, N]` by [`gae`]; `gamma` and `lambda` in [0, 1].
    ///
    /// # Errors
    /// [`RlError::BufferNotFinished`] before `finish`, [`RlError::Shape`] for wrong lengths.
    pub fn advantages(
        &self,
        gamma: f32,
        lambda: f32,
        advantages: &mut [f32],
        returns: &mut [f32],
    ) -> Result<(), RlError> {
        self.check_finished()?;
        check_len("advantages", "[T, N]", advantages.len(), self.samples())?;
        check_len("returns", "[T, N]", returns.len(), self.samples())?;
        let inputs = GaeInputs {
            rewards: &self.rewards,
            values: &self.decisions.values,
            outcomes: &self.outcomes,
            final_values: &self.final_values,
            last_values: &self.last_values,
        };
        gae(&inputs, gamma, lambda, advantages, returns);
        Ok(())
    }

    /// Refuses a buffer that is not full and finished.
    pub(crate) fn check_finished(&self) -> Result<(), RlError> {
        if self.finished {
            Ok(())
        } else {
            Err(RlError::BufferNotFinished {
                got: self.pushed,
                steps: self.steps,
            })
        }
    }

    /// Sizes and types of the environments.
    pub fn spec(&self) -> &EnvSpec {
        &self.spec
    }

    /// T, the number of steps that fit.
    pub fn steps(&self) -> usize {
        self.steps
    }

    /// T * N, the number of decisions that fit.
    pub fn samples(&self) -> usize {
        self.steps * self.spec.num_envs
    }

    /// Observations acted on, `[T, N, ...]`: sample t * N + n is environment n at step t.
    pub fn observations(&self) -> &Observations {
        &self.observations
    }

    /// Actions `[T, N, A]`, log-probabilities and values `[T, N]` as they were when collected.
    pub fn decisions(&self) -> &Decisions {
        &self.decisions
    }

    /// Rewards `[T, N]`.
    pub fn rewards(&self) -> &[f32] {
        &self.rewards
    }

    /// Outcomes `[T, N]`.
    pub fn outcomes(&self) -> &[Outcome] {
        &self.outcomes
    }
}

/// Copies `row` to row `t` of an array of such rows.
fn copy_row<T: Copy>(array: &mut [T], t: usize, row: &[T]) {
    array[t * row.len()..(t + 1) * row.len()].copy_from_slice(row);
}

#[cfg(test)]
mod tests {
    use symmetry::Irrep;

    use super::*;

    fn spec() -> EnvSpec {
        EnvSpec {
            num_envs: 2,
            image: [2, 2, 1],
            vector: vec![Irrep::X],
            action: vec![Irrep::X],
        }
    }

    /// Pushes one step whose every array carries `mark`.
    fn push(buffer: &mut RolloutBuffer, mark: u8, outcome: Outcome) -> Result<(), RlError> {
        let value = f32::from(mark);
        let observations = Observations {
            images: vec![mark; 8],
            vectors: vec![value; 2],
        };
        let decisions = Decisions {
            actions: vec![value; 2],
            log_probs: vec![value; 2],
            values: vec![value; 2],
        };
        let mut transition = Transition::new(&spec());
        transition.rewards.fill(value);
        transition.outcomes.fill(outcome);
        buffer.push(&observations, &decisions, &transition, &[10.0, 20.0])
    }

    #[test]
    fn pushing_past_the_end_is_an_error() {
        let mut buffer = RolloutBuffer::new(&spec(), 2).unwrap();
        push(&mut buffer, 1, Outcome::Running).unwrap();
        push(&mut buffer, 2, Outcome::Running).unwrap();
        assert!(matches!(
            push(&mut buffer, 3, Outcome::Running),
            Err(RlError::BufferFull { steps: 2 })
        ));
        assert_eq!(
            buffer.observations().images,
            [vec![1; 8], vec![2; 8]].concat()
        );
        buffer.clear();
        push(&mut buffer, 3, Outcome::Running).unwrap();
        assert_eq!(buffer.rewards()[..2], [3.0, 3.0]);
    }

    #[test]
    fn a_buffer_is_read_only_when_finished() {
        let mut buffer = RolloutBuffer::new(&spec(), 2).unwrap();
        push(&mut buffer, 1, Outcome::Running).unwrap();
        assert!(matches!(
            buffer.finish(&Observations::new(&spec()), &[0.0; 2]),
            Err(RlError::BufferNotFinished { got: 1, steps: 2 })
        ));
        push(&mut buffer, 2, Outcome::Truncated).unwrap();
        let (mut advantages, mut returns) = ([0.0; 4], [0.0; 4]);
        assert!(
            buffer
                .advantages(1.0, 1.0, &mut advantages, &mut returns)
                .is_err()
        );
        buffer
            .finish(&Observations::new(&spec()), &[-1000.0; 2])
            .unwrap();
        buffer
            .advantages(1.0, 1.0, &mut advantages, &mut returns)
            .unwrap();
        // returns bootstrap the final observations (10, 20), never what came after the reset (-1000)
        assert_eq!(
            returns,
            [1.0 + 2.0 + 10.0, 1.0 + 2.0 + 20.0, 2.0 + 10.0, 2.0 + 20.0]
        );
    }

    #[test]
    fn a_reward_that_is_not_a_number_is_refused() {
        let mut buffer = RolloutBuffer::new(&spec(), 1).unwrap();
        let mut transition = Transition::new(&spec());
        transition.rewards[1] = f32::NAN;
        let result = buffer.push(
            &Observations::new(&spec()),
            &Decisions::new(&spec()),
            &transition,
            &[0.0; 2],
        );
        assert!(matches!(
            result,
            Err(RlError::NotFinite {
                what: "a reward",
                ..
            })
        ));
    }
}
