//! Grouping by the 1-Wasserstein distance of invariant features.

use std::cell::Cell;

use cluster::{Assigner, AssignerSettings, Candidate, Rule};
use rand_chacha::ChaCha8Rng;

use crate::error::CoversError;

use super::grouping::{Answer, Candidates, Grouping};

/// Compares the rollout's first frames `O` with every policy's `B`, in that policy's own features:
/// by a calibrated test, or by the paper's threshold.
#[derive(Clone, Debug)]
pub struct Distance {
    assigner: Assigner,
    /// Where the last decision cut off what another group showed.
    cut: Cell<Option<usize>>,
}

impl Distance {
    /// Takes the rule that accepts or refuses a policy.
    ///
    /// # Errors
    /// A setting of the rule out of range.
    pub fn new(rule: Rule) -> Result<Self, CoversError> {
        Ok(Self {
            assigner: Assigner::new(AssignerSettings { rule })?,
            cut: Cell::new(None),
        })
    }

    /// What a decision rests on: where the episodes show two groups, the later of them alone.
    fn clouds(
        &self,
        candidates: &mut dyn Candidates,
        rng: &mut ChaCha8Rng,
    ) -> Result<Vec<Candidate>, CoversError> {
        let mut clouds = candidates.clouds()?;
        let began = candidates.began();
        self.cut.set(self.assigner.cut(&clouds, &began, rng)?);
        if let Some(cut) = self.cut.get() {
            let later = |&episode: &usize| began[episode] >= cut;
            let later: Vec<usize> = (0..began.len()).filter(later).collect();
            for cloud in &mut clouds {
                cloud.rollout = cloud.rollout.select(&later)?;
            }
        }
        Ok(clouds)
    }
}

impl Grouping for Distance {
    fn min_episodes(&self) -> usize {
        match &self.assigner.settings().rule {
            Rule::Fixed { .. } => 1,
            Rule::Calibrated(calibrated) => calibrated.min_episodes,
        }
    }

    fn assign(&self, candidates: &mut dyn Candidates, rng: &mut ChaCha8Rng) -> Answer {
        Ok(self.assigner.assign(&self.clouds(candidates, rng)?, rng)?)
    }

    fn recognise(&self, candidates: &mut dyn Candidates, rng: &mut ChaCha8Rng) -> Answer {
        Ok(self.assigner.recognise(&candidates.clouds()?, rng)?)
    }

    fn settle(&self, candidates: &mut dyn Candidates, rng: &mut ChaCha8Rng) -> Answer {
        Ok(self.assigner.settle(&self.clouds(candidates, rng)?, rng)?)
    }

    fn cut(&self) -> Option<usize> {
        self.cut.get()
    }
}

#[cfg(test)]
mod tests {
    use cluster::{Decision, Frames};
    use rand::{RngExt, SeedableRng};

    use super::*;
    use crate::groupings::grouping::Episodes;

    /// Two rounds of ten environments before policies at home in these places, all in one feature.
    struct Rounds {
        rounds: [f32; 2],
        homes: Vec<f32>,
        rng: ChaCha8Rng,
    }

    impl Rounds {
        fn around(&mut self, centres: &[f32], episodes: usize) -> Frames {
            let rng = &mut self.rng;
            let near = |centre: &f32| centre + rng.random_range(-1.0..1.0);
            let all = centres
                .iter()
                .flat_map(|c| std::iter::repeat_n(c, episodes));
            Frames::new(all.map(near).collect(), 1, 1).unwrap()
        }
    }

    impl Candidates for Rounds {
        fn clouds(&mut self) -> Result<Vec<Candidate>, CoversError> {
            let rollout = self.around(&self.rounds.clone(), 10);
            let clouds = self.homes.clone().into_iter().map(|home| Candidate {
                buffer: self.around(&[home], 40),
                rollout: rollout.clone(),
            });
            Ok(clouds.collect())
        }

        fn began(&self) -> Vec<usize> {
            (0..20).map(|episode| 500 * (episode / 10)).collect()
        }

        fn episodes(&self) -> Episodes<'_> {
            panic!("distances are those of frames")
        }
    }

    fn settled(rounds: [f32; 2], homes: &[f32]) -> (Decision, Option<usize>) {
        let distance = Distance::new(Rule::default()).unwrap();
        let homes = homes.to_vec();
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut seen = Rounds {
            rounds,
            homes,
            rng: rng.clone(),
        };
        let decision = distance.settle(&mut seen, &mut rng).unwrap().decision;
        (decision, distance.cut())
    }

    /// A known group that was doubted by chance, and gave way before the second look.
    #[test]
    fn the_second_of_two_groups_decides() {
        let (old, new) = (0.0, 5.0);
        assert_eq!(
            settled([old, new], &[old, new]),
            (Decision::Existing(1), Some(500))
        );
        assert_eq!(settled([old, new], &[old]), (Decision::New, Some(500)));
        assert_eq!(settled([old, old], &[old]), (Decision::Existing(0), None));
        assert_eq!(settled([new, new], &[old]), (Decision::New, None));
    }
}
