//! Linear response of observation vectors to actions: least squares over one episode, invariant
//! under D2.

use symmetry::Irrep;

/// Ridge of the least-squares fit, as a share of the mean diagonal of the actions' Gram matrix: an
/// action that never varies gets no response.
const RIDGE: f64 = 1e-6;

/// Returns the linear response of an episode's vectors to its actions: `M`, `[D, A]`, of the
/// least-squares fit `vector[t + 1] - vector[t] = M action[t]`, for D vector components and A
/// action dimensions. Entries that change sign under a flip, whose component and action have
/// different irreps, are absolute values.
///
/// Actions are clipped to `[-1, 1]`, as environments clip them; otherwise their measured effect
/// would depend on how far a policy explores.
///
/// `vectors` are `[T + 1, D]` with the irreps `components`, `actions` `[T, A]` with the irreps
/// `directions`. Mirror images of an episode give the same bits.
pub(crate) fn motion(
    vectors: &[f32],
    components: &[Irrep],
    actions: &[f32],
    directions: &[Irrep],
) -> Vec<f32> {
    let (d, a) = (components.len(), directions.len());
    let mut gram = vec![0.0; a * a];
    let mut moment = vec![0.0; a * d];
    let pairs = vectors.chunks_exact(d).zip(vectors.chunks_exact(d).skip(1));
    let actions: Vec<f32> = actions.iter().map(|value| value.clamp(-1.0, 1.0)).collect();
    for ((now, next), action) in pairs.zip(actions.chunks_exact(a)) {
        for (i, &ai) in action.iter().enumerate() {
            for (j, &aj) in action.iter().enumerate() {
                gram[i * a + j] += f64::from(ai) * f64::from(aj);
            }
            for (k, (from, to)) in now.iter().zip(next).enumerate() {
                moment[i * d + k] += f64::from(ai) * (f64::from(*to) - f64::from(*from));
            }
        }
    }
    let trace: f64 = (0..a).map(|i| gram[i * a + i]).sum();
    for i in 0..a {
        gram[i * a + i] += RIDGE * trace / a as f64 + f64::MIN_POSITIVE;
    }
    solve(&mut gram, &mut moment, a, d);
    let entries = (0..d).flat_map(|k| (0..a).map(move |i| (k, i)));
    let entry = |(k, i): (usize, usize)| {
        if components[k] == directions[i] {
            moment[i * d + k] as f32
        } else {
            moment[i * d + k].abs() as f32
        }
    };
    entries.map(entry).collect()
}

/// Returns the direction in the space of A-dimensional actions in which the reward increases, by a
/// linear fit to the rewards `[T]` and actions `[T, A]` of T steps: absolute values, scaled to
/// length 1, or zeros if the reward does not depend on actions.
pub(crate) fn reward_gradient(rewards: &[f32], actions: &[f32], directions: &[Irrep]) -> Vec<f32> {
    // reward[t] follows action[t], so the change from reward[t] to reward[t + 1] is due to
    // action[t + 1]
    let later = actions.get(directions.len()..).unwrap_or(&[]);
    let found = motion(rewards, &[Irrep::Trivial], later, directions);
    let squares: f64 = found.iter().map(|&m| f64::from(m).powi(2)).sum();
    let length = squares.sqrt().max(f64::MIN_POSITIVE);
    found.iter().map(|&m| (f64::from(m.abs()) / length) as f32).collect()
}

/// Solves the linear systems `gram x = moment` in place, for a positive definite `gram` `[n, n]`
/// and `moment` `[n, m]`.
fn solve(gram: &mut [f64], moment: &mut [f64], n: usize, m: usize) {
    for pivot in 0..n {
        for row in (0..n).filter(|&row| row != pivot) {
            let factor = gram[row * n + pivot] / gram[pivot * n + pivot];
            for col in pivot..n {
                gram[row * n + col] -= factor * gram[pivot * n + col];
            }
            for col in 0..m {
                moment[row * m + col] -= factor * moment[pivot * m + col];
            }
        }
    }
    for row in 0..n {
        moment[row * m..(row + 1) * m].iter_mut().for_each(|value| *value /= gram[row * n + row]);
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    const IRREPS: [Irrep; 2] = [Irrep::X, Irrep::Y];

    /// A trajectory under a motion that turns and slows.
    fn trajectory() -> (Vec<f32>, Vec<f32>) {
        let actions: Vec<f32> = (0..20).map(|i| ((i * 7 % 11) as f32 - 5.0) / 8.0).collect();
        let mut vectors = vec![0.25, -0.5];
        for action in actions.chunks(2) {
            let [x, y] = [vectors[vectors.len() - 2], vectors[vectors.len() - 1]];
            let (dx, dy) = (0.5 * action[0] - 0.25 * action[1], 0.125 * action[1]);
            vectors.extend([x + dx, y + dy]);
        }
        (vectors, actions)
    }

    #[test]
    fn the_motion_of_the_hand_is_found() {
        let (vectors, actions) = trajectory();
        let found = motion(&vectors, &IRREPS, &actions, &IRREPS);
        for (got, expected) in found.iter().zip([0.5, 0.25, 0.0, 0.125]) {
            assert!((got - expected).abs() < 2e-3, "{found:?}");
        }
        assert_eq!(motion(&[0.5; 6], &IRREPS, &[0.0; 4], &IRREPS), [0.0; 4], "no action");
    }

    #[test]
    fn the_reward_gradient_does_not_depend_on_the_scale_of_rewards() {
        let (_, actions) = trajectory();
        let rewards = |height: f32| -> Vec<f32> {
            let steps = actions.chunks(2).scan(0.0, |sum, action| {
                *sum += height * (4.0 * action[0] + 3.0 * action[1]);
                Some(*sum)
            });
            steps.collect()
        };
        let low = reward_gradient(&rewards(0.125), &actions, &IRREPS);
        assert!((low[0] - 0.8).abs() < 1e-3 && (low[1] - 0.6).abs() < 1e-3, "{low:?}");
        assert_eq!(reward_gradient(&rewards(8.0), &actions, &IRREPS), low);
        assert_eq!(reward_gradient(&[1.0; 10], &actions, &IRREPS), [0.0, 0.0]);
    }
}
