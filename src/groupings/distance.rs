//! Grouping by the 1-Wasserstein distance of invariant features.

use std::cell::Cell;

use cluster::{Assigner, AssignerSettings, Candidate, Decision, Rule, Verdict, lead};
use rand_chacha::ChaCha8Rng;

use crate::error::CoversError;

use super::grouping::{Answer, Candidates, Grouping, Recognised};

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

    /// A frame that is strange to all policies, as those of another camera are, may by chance be
    /// less strange in the features of a wrong one. So the two that fit best compete in the
    /// features of both. The test says whether the winner fits. A policy that remembers too little
    /// for a test is named where all others are doubted.
    fn recognise(
        &self,
        candidates: &mut dyn Candidates,
        rng: &mut ChaCha8Rng,
    ) -> Result<Recognised, CoversError> {
        let assignment = self.assigner.recognise(&candidates.clouds()?, rng)?;
        let Rule::Calibrated(settings) = &self.assigner.settings().rule else {
            return Ok(Recognised::of(&assignment));
        };
        let untested = |policy: usize| assignment.evidence[policy].test().is_none();
        let [first, second] = match (assignment.decision, assignment.rivals()) {
            (Decision::Existing(policy), _) if untested(policy) => {
                return Ok(Recognised::of(&assignment));
            }
            (_, None) => return Ok(Recognised::of(&assignment)),
            (_, Some(rivals)) => rivals,
        };
        let contests = candidates.contests([first, second], settings.buffer_episodes)?;
        let policy = match lead(&contests)? < 0.0 {
            true => second,
            false => first,
        };
        Ok(Recognised {
            policy,
            fits: assignment.evidence[policy].verdict == Verdict::Accepted,
        })
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
    use cluster::{Contest, Frames};
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

        fn contests(&mut self, _: [usize; 2], _: usize) -> Result<[Contest; 2], CoversError> {
            panic!("nothing is recognised")
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

    /// Policies 0 and 1 at home in -1 and 1 of two features. Both know frames in which the first
    /// feature alone says which, and policy 1 hardly sees it.
    struct Glance {
        seen: [f32; 2],
        rng: ChaCha8Rng,
    }

    impl Glance {
        const SIGHT: [[f32; 2]; 2] = [[1.0, 1.0], [0.2, 1.0]];

        fn frames(&self, policy: usize, points: &[[f32; 2]]) -> Frames {
            let [x, y] = Self::SIGHT[policy];
            let seen = points.iter().flat_map(|p| [x * p[0], y * p[1]]);
            Frames::new(seen.collect(), 1, 2).unwrap()
        }

        fn home(&self, policy: usize) -> Vec<[f32; 2]> {
            let mut rng = self.rng.clone();
            let centre = [-1.0, 1.0][policy];
            let mut near = |width: f32| rng.random_range(-width..width);
            let points = (0..40).map(|_| [centre + near(0.5), near([0.5, 1.5][policy])]);
            points.collect()
        }
    }

    impl Candidates for Glance {
        fn clouds(&mut self) -> Result<Vec<Candidate>, CoversError> {
            let clouds = [0, 1].map(|policy| Candidate {
                buffer: self.frames(policy, &self.home(policy)),
                rollout: self.frames(policy, &[self.seen]),
            });
            Ok(clouds.into())
        }

        fn contests(&mut self, rivals: [usize; 2], _: usize) -> Result<[Contest; 2], CoversError> {
            Ok(rivals.map(|policy| Contest {
                rollout: self.frames(policy, &[self.seen]),
                rivals: rivals.map(|rival| self.frames(policy, &self.home(rival))),
            }))
        }

        fn began(&self) -> Vec<usize> {
            vec![0]
        }

        fn episodes(&self) -> Episodes<'_> {
            panic!("distances are those of frames")
        }
    }

    /// The second feature of the frame is beyond what policy 0 knows and within what policy 1 does:
    /// by its own distance it is policy 1's.
    #[test]
    fn a_strange_frame_goes_to_the_policy_whose_frames_it_is_nearer_to() {
        let distance = Distance::new(Rule::default()).unwrap();
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut glance = Glance {
            seen: [-1.0, 1.2],
            rng: rng.clone(),
        };
        let clouds = glance.clouds().unwrap();
        let alone = distance.assigner.recognise(&clouds, &mut rng).unwrap();
        assert_eq!(alone.nearest(), Some(1));
        let recognised = distance.recognise(&mut glance, &mut rng).unwrap();
        assert_eq!((recognised.policy, recognised.fits), (0, false));
        glance.seen = [-1.0, 0.1];
        let recognised = distance.recognise(&mut glance, &mut rng).unwrap();
        assert_eq!((recognised.policy, recognised.fits), (0, true));
        glance.seen = [1.0, 0.1];
        let recognised = distance.recognise(&mut glance, &mut rng).unwrap();
        assert_eq!((recognised.policy, recognised.fits), (1, true));
    }
}
