//! Noise of actions whose direction lasts.

use rand_chacha::ChaCha8Rng;

use crate::error::RlError;
use crate::gaussian::standard_normals;
use crate::require::require;

/// Standard normal numbers `[N, A]` for the actions of N environments: x_0 = e_0 and
/// x_t = c x_(t-1) + sqrt(1 - c^2) e_t with independent standard normal e, in each component and
/// each episode by itself. This is a stationary autoregressive process of order one: a number by
/// itself is standard normal at every step, and two that are k steps apart have the correlation
/// c^k (Korenkevych et al., "Autoregressive policies for continuous control deep reinforcement
/// learning", IJCAI 2019, p = 1).
#[derive(Clone, Debug)]
pub(crate) struct ActionNoise {
    /// c, in [0, 1).
    correlation: f32,
    width: usize,
    values: Vec<f32>,
    fresh: Vec<f32>,
    /// Whether the episode of an environment has had noise, `[N]`.
    begun: Vec<bool>,
}

impl ActionNoise {
    /// Independent noise for actions of `width` components (A, at least 1).
    pub fn independent(envs: usize, width: usize) -> Self {
        Self {
            correlation: 0.0,
            width,
            values: vec![0.0; envs * width],
            fresh: vec![0.0; envs * width],
            begun: vec![false; envs],
        }
    }

    /// Sets c.
    ///
    /// # Errors
    /// [`RlError::Setting`] for one outside [0, 1).
    pub fn set_correlation(&mut self, correlation: f32) -> Result<(), RlError> {
        let allowed = (0.0..1.0).contains(&correlation);
        let expected = "a number in [0, 1)";
        require("noise_correlation", correlation, expected, allowed)?;
        self.correlation = correlation;
        Ok(())
    }

    /// Begins an episode in every environment.
    pub fn restart(&mut self) {
        self.begun.fill(false);
    }

    /// Begins an episode in environment `env`, in 0..N.
    pub fn forget(&mut self, env: usize) {
        self.begun[env] = false;
    }

    /// The noise `[N, A]` of the next step.
    pub fn draw(&mut self, rng: &mut ChaCha8Rng) -> &[f32] {
        standard_normals(rng, &mut self.fresh);
        let (kept, new) = (self.correlation, (1.0 - self.correlation.powi(2)).sqrt());
        let rows = self.values.chunks_exact_mut(self.width);
        let fresh = self.fresh.chunks_exact(self.width);
        for ((row, fresh), begun) in rows.zip(fresh).zip(&mut self.begun) {
            if std::mem::replace(begun, true) {
                row.iter_mut()
                    .zip(fresh)
                    .for_each(|(x, e)| *x = kept * *x + new * e);
            } else {
                row.copy_from_slice(fresh);
            }
        }
        &self.values
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::*;

    const ENVS: usize = 500;
    const STEPS: usize = 6;

    /// `STEPS` rows `[N, 2]`, in which environment 0 begins an episode with the fourth.
    fn rows(correlation: f32) -> Vec<Vec<f32>> {
        let mut noise = ActionNoise::independent(ENVS, 2);
        noise.set_correlation(correlation).unwrap();
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let draw = |t| {
            if t == 3 {
                noise.forget(0);
            }
            noise.draw(&mut rng).to_vec()
        };
        (0..STEPS).map(draw).collect()
    }

    fn moment(a: &[f32], b: &[f32]) -> f64 {
        let products = a.iter().zip(b).map(|(&x, &y)| f64::from(x) * f64::from(y));
        products.sum::<f64>() / a.len() as f64
    }

    /// 1000 numbers: standard errors of the moments are at most 0.045.
    #[test]
    fn every_step_is_standard_and_steps_are_correlated_as_set() {
        for correlation in [0.0, 0.5, 0.9] {
            let rows = rows(correlation);
            for (t, row) in rows.iter().enumerate() {
                assert!(moment(row, &[1.0; 2 * ENVS]).abs() < 0.14, "{correlation}");
                for (k, later) in rows[t..].iter().enumerate() {
                    let (seen, expected) =
                        (moment(row, later), f64::from(correlation).powi(k as i32));
                    assert!((seen - expected).abs() < 0.18, "{correlation} {k}: {seen}");
                }
            }
        }
    }

    #[test]
    fn without_correlation_it_is_what_the_generator_says() {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        for row in rows(0.0) {
            let mut plain = [0.0; 2 * ENVS];
            standard_normals(&mut rng, &mut plain);
            assert_eq!(row, plain);
        }
    }

    /// By hand from the generator's numbers, at c = 0.6, so that sqrt(1 - c^2) = 0.8.
    #[test]
    fn an_episode_begins_afresh_in_its_environment_alone() {
        let rows = rows(0.6);
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        let mut expected = vec![0.0_f64; 2 * ENVS];
        for (t, row) in rows.iter().enumerate() {
            let mut fresh = [0.0; 2 * ENVS];
            standard_normals(&mut rng, &mut fresh);
            for (i, (x, &e)) in expected.iter_mut().zip(&fresh).enumerate() {
                *x = match t == 0 || (t == 3 && i < 2) {
                    true => f64::from(e),
                    false => 0.6 * *x + 0.8 * f64::from(e),
                };
                assert!(
                    (*x - f64::from(row[i])).abs() < 1e-5,
                    "step {t}, number {i}"
                );
            }
        }
    }

    #[test]
    fn a_correlation_that_keeps_everything_is_refused() {
        let mut noise = ActionNoise::independent(1, 1);
        for wrong in [-0.1, 1.0, f32::NAN] {
            let message = noise.set_correlation(wrong).unwrap_err().to_string();
            assert!(message.contains("noise_correlation") && message.contains("[0, 1)"));
        }
    }
}
