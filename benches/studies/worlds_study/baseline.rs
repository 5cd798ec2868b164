//! Simple baselines: groupings by one description of first pictures.

use cluster::{
    AlternativeHypothesis, AssignedPolicy, EvidenceSourceSamples, FrameFeatures,
    RolloutAndBufferFeatures, assign_by_threshold, joint_permutation_test,
};
use evidence::{RecogniserSettings, Trajectory};
use learner::{
    AssignmentData, AssignmentPurpose, CoversSettings, EpisodeRequirements, Grouping,
    GroupingDecision, GroupingUpdateInput, GroupingUpdateResult, LearnerError,
    PolicyCollectionSettings, RolloutEpisodes,
};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use rayon::prelude::*;
use rl::{ActorCriticPolicy, EnvSpec, FeatureExtractor, Observations};
use symmetry::D2;

use crate::cases::AssignmentRule;

/// Returns the shares of 64 colours: four levels of each of the first three channels.
fn histogram(spec: &EnvSpec, trajectory: &Trajectory) -> Vec<f32> {
    let mut shares = vec![0.0; 64];
    let [height, width, channels] = spec.image_shape;
    for pixel in trajectory.image.chunks_exact(channels) {
        let bin = pixel[..3].iter().fold(0, |bin, &level| 4 * bin + usize::from(level / 64));
        shares[bin] += 1.0 / (height * width) as f32;
    }
    shares
}

/// Returns the average of the picture's four mirror images, `[H / 2, W / 2, 3]`.
fn mean_image(spec: &EnvSpec, trajectory: &Trajectory) -> Vec<f32> {
    let [height, width, channels] = spec.image_shape;
    let places = (0..height / 2).flat_map(|row| (0..width / 2).map(move |col| (row, col)));
    let means = places.flat_map(|(row, col)| {
        let mirrored = D2::ALL.map(|g| g.apply_pixel(row, col, height, width));
        let level = |i, (y, x)| f32::from(trajectory.image[(y * width + x) * channels + i]);
        [0, 1, 2].map(|i| mirrored.map(|place| level(i, place)).iter().sum::<f32>() / 1020.0)
    });
    means.collect()
}

/// Simple grouping rule for comparison: it takes the policy whose descriptions of first images
/// differ least, or a new one if they differ too much. Without second rollouts, trials and merges.
pub struct BaselineGrouping {
    rule: AssignmentRule,
    untrained: ActorCriticPolicy,
    settings: RecogniserSettings,
    /// Latest descriptions that each policy trained on.
    memories: Vec<Vec<f32>>,
}

impl BaselineGrouping {
    pub fn new(rule: AssignmentRule, spec: &EnvSpec, seed: u64) -> Result<Self, LearnerError> {
        let untrained = CoversSettings::default().new_policy(spec, seed)?;
        Ok(Self { rule, untrained, settings: RecogniserSettings::default(), memories: Vec::new() })
    }

    /// Returns descriptions of the first pictures, which but for rounding are equal for mirror
    /// images.
    fn describe(&mut self, episodes: RolloutEpisodes<'_>) -> Result<FrameFeatures, LearnerError> {
        let RolloutEpisodes { spec, trajectories, .. } = episodes;
        let points: Vec<f32> = match self.rule {
            AssignmentRule::Histogram => {
                trajectories.iter().flat_map(|t| histogram(spec, t)).collect()
            }
            AssignmentRule::Image => {
                trajectories.iter().flat_map(|t| mean_image(spec, t)).collect()
            }
            _ => {
                let first = |t: &Trajectory| t.vectors[..spec.vector_irreps.len()].to_vec();
                let observations = Observations {
                    images: trajectories.iter().flat_map(|t| t.image.clone()).collect(),
                    vectors: trajectories.iter().flat_map(first).collect(),
                };
                let mut features = vec![0.0; trajectories.len() * self.untrained.feature_dim()];
                self.untrained.features(&observations, &mut features)?;
                features
            }
        };
        let dim = points.len() / trajectories.len().max(1);
        Ok(FrameFeatures::new(points, 1, dim)?)
    }

    /// Returns the policy whose descriptions differ least by a permutation test, or a new one. A
    /// policy is rejected at the levels of the learner's own rule: `doubt` for the exact p-value
    /// and `level` for that of the fitted tail.
    fn test(
        &self,
        clouds: Vec<RolloutAndBufferFeatures>,
        seed: u64,
    ) -> Result<AssignedPolicy, LearnerError> {
        let tests = clouds.into_par_iter().map(|clouds| {
            let source =
                EvidenceSourceSamples { clouds, alternative: AlternativeHypothesis::TwoSided };
            let stages = [self.settings.permutations / 4, self.settings.permutations];
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            // a test that is far from significant may end early
            joint_permutation_test(&[source], &stages, |test| test.overall.p_value > 0.15, &mut rng)
        });
        let tests = tests.collect::<Result<Vec<_>, _>>()?.into_iter().enumerate();
        let nearest =
            tests.min_by(|(_, one), (_, other)| one.overall.score.total_cmp(&other.overall.score));
        let fits = nearest.filter(|(_, test)| {
            // without a source all descriptions are equal
            test.sources[0].is_none_or(|source| {
                source.p_value > self.settings.doubt || source.tail_p_value > self.settings.level
            })
        });
        Ok(fits.map_or(AssignedPolicy::New, |(policy, _)| AssignedPolicy::Existing(policy)))
    }
}

impl Grouping for BaselineGrouping {
    fn requirements(&self) -> EpisodeRequirements {
        let episodes = self.settings.min_episodes;
        EpisodeRequirements { episodes, whole_episodes: true, chooses_collector: false }
    }

    fn assign(
        &mut self,
        _: AssignmentPurpose<'_>,
        data: &mut dyn AssignmentData,
        rng: &mut ChaCha8Rng,
    ) -> Result<GroupingDecision, LearnerError> {
        let rollout = self.describe(data.episodes())?;
        let clouds = self.memories.iter().map(|memory| {
            let buffer = FrameFeatures::new(memory.clone(), 1, rollout.dim())?;
            Ok(RolloutAndBufferFeatures { buffer, rollout: rollout.clone() })
        });
        let clouds = clouds.collect::<Result<Vec<_>, LearnerError>>()?;
        Ok(match self.rule {
            AssignmentRule::Threshold => assign_by_threshold(&clouds, 1.0)?.into(),
            _ => GroupingDecision::for_policy(self.test(clouds, rng.random())?),
        })
    }

    fn update(
        &mut self,
        assigned: GroupingUpdateInput<'_>,
        _: &mut ChaCha8Rng,
    ) -> Result<GroupingUpdateResult, LearnerError> {
        if let GroupingUpdateInput::Rollout { policy, episodes, .. } = assigned {
            let described = self.describe(episodes)?;
            self.memories.resize(self.memories.len().max(policy + 1), Vec::new());
            let memory = &mut self.memories[policy];
            memory.extend(described.features());
            let most = self.settings.memory * described.dim();
            memory.drain(..memory.len().saturating_sub(most));
        }
        Ok(GroupingUpdateResult::default())
    }
}
