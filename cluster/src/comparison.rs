//! Comparison of a rollout with the frames of two policies by energy distances.

use crate::error::{ClusterError, Result};
use crate::euclidean::EuclideanDistances;
use crate::frames::FrameFeatures;

/// Inputs of the comparison of a rollout with two policies: frames (feature vectors) of the rollout
/// and of both policies' buffers, in one feature space.
#[derive(Clone, Debug, PartialEq)]
pub struct NearerPolicyInputs {
    /// Frames of the rollout.
    pub rollout: FrameFeatures,
    /// Frames of the buffers of the two policies.
    pub policies: [FrameFeatures; 2],
}

/// Returns how much nearer a rollout is to the first of two policies than to the second: the
/// difference of the energy distances, relative to the mean distance within and between the
/// policies, summed over all `comparisons`; negative if the second policy is nearer. Each
/// comparison holds the same policies in another feature space.
///
/// In each space, it is the difference of the energy distances `2 E|X - Y| - E|X - X'| - E|Y - Y'|`
/// (Szekely and Rizzo, "Energy statistics: a class of statistics based on distances", Journal of
/// Statistical Planning and Inference 143 (2013)) over the mean distance within and between the
/// policies. So a wide cloud has no advantage or disadvantage, even if the rollout is a single
/// frame, and the scale of a space does not count. Distances within a rival are taken between
/// different episodes only, so the number of its episodes does not count either; a rival of a single
/// episode is taken to be as wide as the other.
///
/// # Errors
/// No comparison, or frames of one comparison that cannot be compared.
pub fn nearer_policy_margin(comparisons: &[NearerPolicyInputs]) -> Result<f64> {
    match comparisons {
        [] => Err(ClusterError::Empty { what: "comparisons" }),
        comparisons => comparisons.iter().map(NearerPolicyInputs::nearer_policy_margin).sum(),
    }
}

impl NearerPolicyInputs {
    fn nearer_policy_margin(&self) -> Result<f64> {
        let (x, [y, z]) = (&self.rollout, &self.policies);
        // one episode says nothing about its spread, which is then taken for that of the other
        let (within_y, within_z) = match (within(y)?, within(z)?) {
            (Some(of_y), Some(of_z)) => (of_y, of_z),
            (one, other) => {
                let known = one.or(other).unwrap_or(0.0);
                (known, known)
            }
        };
        let scale = (within_y + within_z + 2.0 * between(y, z)?) / 4.0;
        // E|X - X'| is equal for both policies and cancels
        let margin = 2.0 * (between(x, z)? - between(x, y)?) + within_y - within_z;
        Ok(if scale > 0.0 { margin / scale } else { 0.0 })
    }
}

fn between(x: &FrameFeatures, y: &FrameFeatures) -> Result<f64> {
    x.check_alike(y)?;
    let mut costs = EuclideanDistances::new();
    let distances = costs.compute(x.features(), y.features(), x.dim())?;
    Ok(distances.iter().sum::<f64>() / distances.len() as f64)
}

/// Returns the mean Euclidean distance between frames of different episodes; `None` for a single
/// episode.
fn within(x: &FrameFeatures) -> Result<Option<f64>> {
    if x.num_episodes() == 1 {
        return Ok(None);
    }
    let mut costs = EuclideanDistances::new();
    let distances = costs.compute(x.features(), x.features(), x.dim())?;
    let (k, episodes) = (x.frames_per_episode(), x.num_episodes());
    let others = distances.iter().enumerate().filter(|(index, _)| {
        let (row, column) = (index / (episodes * k), index % (episodes * k));
        row / k != column / k
    });
    let sum: f64 = others.map(|(_, distance)| distance).sum();
    Ok(Some(sum / (k * k * episodes * (episodes - 1)) as f64))
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::draw;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    fn comparison(rollout: &[f32], policies: [&[f32]; 2]) -> NearerPolicyInputs {
        let frames = |features: &[f32]| FrameFeatures::new(features.to_vec(), 1, 1).unwrap();
        NearerPolicyInputs { rollout: frames(rollout), policies: policies.map(frames) }
    }

    /// From 0: distances 1 and 1 to {-1, 1}, 2 to {2, 2}; within them 2, and 0; between them 2 on
    /// average.
    #[test]
    fn the_margin_is_that_of_the_definition() {
        let policies: [&[f32]; 2] = [&[-1.0, 1.0], &[2.0, 2.0]];
        let expected = (2.0 * (2.0 - 1.0) + 2.0 - 0.0) / ((2.0 + 0.0 + 2.0 * 2.0) / 4.0);
        let one = comparison(&[0.0], policies);
        // in another unit, and with both votes
        let doubled = comparison(&[0.0], [&[-2.0, 2.0], &[4.0, 4.0]]);
        assert!(
            (nearer_policy_margin(&[one.clone(), doubled]).unwrap() - 2.0 * expected).abs() < 1e-12
        );
        let turned = comparison(&[0.0], [policies[1], policies[0]]);
        assert!(nearer_policy_margin(&[one, turned]).unwrap().abs() < 1e-12);
        let still = comparison(&[1.0], [&[1.0, 1.0], &[1.0]]);
        assert_eq!(nearer_policy_margin(&[still]).unwrap(), 0.0);
    }

    /// A frame from a wide cloud around 0 is farther from it on average than from a narrow cloud
    /// beside it, and yet belongs to it.
    #[test]
    fn a_wide_cloud_loses_nothing_by_its_width() {
        let wide: Vec<f32> = (-20..=20).map(|i| i as f32 / 2.0).collect();
        let narrow = [4.0, 4.1, 4.2];
        let mean = |x: f32, cloud: &[f32]| cloud.iter().map(|y| (x - y).abs()).sum::<f32>();
        assert!(mean(0.0, &wide) / 41.0 > mean(0.0, &narrow) / 3.0);
        assert!(nearer_policy_margin(&[comparison(&[0.0], [&wide, &narrow])]).unwrap() > 0.0);
    }

    /// Eight episodes or one, and a hundred, of one distribution, two frames each of which are alike.
    #[test]
    fn a_small_cloud_loses_nothing_by_its_size() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let mut episodes = |count: usize| {
            let features = draw(count, 0.0, &mut rng).into_iter().flat_map(|x| [x; 2]);
            FrameFeatures::new(features.collect(), 2, 1).unwrap()
        };
        // with the distance of a frame to itself it was -0.09; chance moves it by some 0.03. With no
        // spread of the single episode it would be 1.3; chance moves it by some 0.08.
        for (sizes, bound) in [([8, 100], 0.08), ([1, 100], 0.3)] {
            let margins = (0..400).map(|_| {
                let policies = sizes.map(&mut episodes);
                let comparison = NearerPolicyInputs { rollout: episodes(1), policies };
                nearer_policy_margin(&[comparison]).unwrap()
            });
            let mean = margins.sum::<f64>() / 400.0;
            assert!(mean.abs() < bound, "{sizes:?}: {mean}");
        }
    }

    #[test]
    fn what_cannot_be_compared_is_refused() {
        assert!(nearer_policy_margin(&[]).is_err());
        let mut other = comparison(&[0.0], [&[0.0], &[1.0]]);
        other.policies[1] = FrameFeatures::new(vec![0.0, 1.0], 1, 2).unwrap();
        let message = nearer_policy_margin(&[other]).unwrap_err().to_string();
        assert!(message.contains("dim") && message.contains('2'), "{message}");
    }
}
