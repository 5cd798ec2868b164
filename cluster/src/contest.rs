//! Comparison of a rollout with the frames of two policies by energy distances.

use crate::error::{ClusterError, Result};
use crate::euclidean::EuclideanCosts;
use crate::frames::Frames;

/// Frames (feature vectors) of a rollout and of two policies' buffers, in one feature space.
#[derive(Clone, Debug, PartialEq)]
pub struct Contest {
    /// Frames of the rollout.
    pub rollout: Frames,
    /// Frames of the buffers of the two policies that the rollout may belong to.
    pub rivals: [Frames; 2],
}

/// Returns the margin by which the rollout is nearer to the first of two rivals than to the second:
/// above 0 for the first, below for the second. Each contest holds the same rivals in another
/// feature space; margins are summed over the spaces.
///
/// In each space, it is the difference of the energy distances `2 E|X - Y| - E|X - X'| - E|Y - Y'|`
/// (Szekely and Rizzo, "Energy statistics: a class of statistics based on distances", Journal of
/// Statistical Planning and Inference 143 (2013)) over the mean distance within and between the
/// rivals. So a wide cloud has no advantage or disadvantage, even if the rollout is a single frame,
/// and the scale of a space does not count. Distances within a rival are taken between different
/// episodes only, so the number of its episodes does not count either.
///
/// # Errors
/// No contest, or frames of one contest that cannot be compared.
pub fn lead(contests: &[Contest]) -> Result<f64> {
    match contests {
        [] => Err(ClusterError::Empty { what: "contests" }),
        contests => contests.iter().map(Contest::lead).sum(),
    }
}

impl Contest {
    fn lead(&self) -> Result<f64> {
        let (x, [y, z]) = (&self.rollout, &self.rivals);
        let (within_y, within_z) = (within(y)?, within(z)?);
        let scale = (within_y + within_z + 2.0 * between(y, z)?) / 4.0;
        // E|X - X'| is equal for both rivals and cancels
        let lead = 2.0 * (between(x, z)? - between(x, y)?) + within_y - within_z;
        Ok(if scale > 0.0 { lead / scale } else { 0.0 })
    }
}

/// Returns the mean Euclidean distance between the frames of `x` and those of `y`.
fn between(x: &Frames, y: &Frames) -> Result<f64> {
    x.check_alike(y)?;
    let mut costs = EuclideanCosts::new();
    let distances = costs.compute(x.features(), y.features(), x.dim())?;
    Ok(distances.iter().sum::<f64>() / distances.len() as f64)
}

/// Returns the mean Euclidean distance between frames of different episodes; 0 for a single
/// episode.
fn within(x: &Frames) -> Result<f64> {
    let mut costs = EuclideanCosts::new();
    let distances = costs.compute(x.features(), x.features(), x.dim())?;
    let (k, episodes) = (x.frames_per_episode(), x.episodes());
    let others = distances.iter().enumerate().filter(|(index, _)| {
        let (row, column) = (index / (episodes * k), index % (episodes * k));
        row / k != column / k
    });
    let sum: f64 = others.map(|(_, distance)| distance).sum();
    Ok(sum / (k * k * episodes * (episodes - 1).max(1)) as f64)
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::draw;
    use rand::SeedableRng;
    use rand_chacha::ChaCha8Rng;

    fn contest(rollout: &[f32], rivals: [&[f32]; 2]) -> Contest {
        let frames = |features: &[f32]| Frames::new(features.to_vec(), 1, 1).unwrap();
        Contest { rollout: frames(rollout), rivals: rivals.map(frames) }
    }

    /// From 0: distances 1 and 1 to {-1, 1}, 2 to {2, 2}; within them 2, and 0; between them 2 on
    /// average.
    #[test]
    fn the_lead_is_that_of_the_definition() {
        let rivals: [&[f32]; 2] = [&[-1.0, 1.0], &[2.0, 2.0]];
        let expected = (2.0 * (2.0 - 1.0) + 2.0 - 0.0) / ((2.0 + 0.0 + 2.0 * 2.0) / 4.0);
        let one = contest(&[0.0], rivals);
        // in another unit, and with both votes
        let doubled = contest(&[0.0], [&[-2.0, 2.0], &[4.0, 4.0]]);
        assert!((lead(&[one.clone(), doubled]).unwrap() - 2.0 * expected).abs() < 1e-12);
        let turned = contest(&[0.0], [rivals[1], rivals[0]]);
        assert!(lead(&[one, turned]).unwrap().abs() < 1e-12);
        let still = contest(&[1.0], [&[1.0, 1.0], &[1.0]]);
        assert_eq!(lead(&[still]).unwrap(), 0.0);
    }

    /// A frame from a wide cloud around 0 is farther from it on average than from a narrow cloud
    /// beside it, and yet belongs to it.
    #[test]
    fn a_wide_cloud_loses_nothing_by_its_width() {
        let wide: Vec<f32> = (-20..=20).map(|i| i as f32 / 2.0).collect();
        let narrow = [4.0, 4.1, 4.2];
        let mean = |x: f32, cloud: &[f32]| cloud.iter().map(|y| (x - y).abs()).sum::<f32>();
        assert!(mean(0.0, &wide) / 41.0 > mean(0.0, &narrow) / 3.0);
        assert!(lead(&[contest(&[0.0], [&wide, &narrow])]).unwrap() > 0.0);
    }

    /// Eight episodes and a hundred of one distribution, two frames each of which are alike.
    #[test]
    fn a_small_cloud_loses_nothing_by_its_size() {
        let mut rng = ChaCha8Rng::seed_from_u64(2);
        let mut episodes = |count: usize| {
            let features = draw(count, 0.0, &mut rng).into_iter().flat_map(|x| [x; 2]);
            Frames::new(features.collect(), 2, 1).unwrap()
        };
        let leads = (0..400).map(|_| {
            let contest = Contest { rollout: episodes(1), rivals: [8, 100].map(&mut episodes) };
            lead(&[contest]).unwrap()
        });
        // with the distance of a frame to itself it was -0.09; chance moves it by some 0.03
        let mean = leads.sum::<f64>() / 400.0;
        assert!(mean.abs() < 0.08, "{mean}");
    }

    #[test]
    fn what_cannot_be_compared_is_refused() {
        assert!(lead(&[]).is_err());
        let mut other = contest(&[0.0], [&[0.0], &[1.0]]);
        other.rivals[1] = Frames::new(vec![0.0, 1.0], 1, 2).unwrap();
        let message = lead(&[other]).unwrap_err().to_string();
        assert!(message.contains("dim") && message.contains('2'), "{message}");
    }
}
