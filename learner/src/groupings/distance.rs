//! Grouping by the 1-Wasserstein distance of invariant features.

use cluster::{Assigner, AssignerSettings, Candidate, Decision, Rule, Verdict, lead};
use rand_chacha::ChaCha8Rng;

use crate::error::LearnerError;

use super::grouping::{Candidates, Grouping, GroupingDecision, Needs, Query};

/// Grouping that compares the rollout's first frames `O` with every policy's `B`, in that policy's
/// own features, by a calibrated test or the paper's threshold.
#[derive(Clone, Copy, Debug)]
pub struct Distance {
    assigner: Assigner,
}

impl Distance {
    /// Creates a grouping with the rule by which distances accept or reject a policy.
    ///
    /// # Errors
    /// A setting of the rule out of range.
    pub fn new(rule: Rule) -> Result<Self, LearnerError> {
        let assigner = Assigner::new(AssignerSettings { rule })?;
        Ok(Self { assigner })
    }

    /// Names the policy of episodes that are not used for training.
    ///
    /// A frame unlike all remembered ones, for example of another camera, may by chance be less
    /// distant in the features of a wrong policy. So the two best fits are compared in the features
    /// of both, and the test decides if the winner fits. A policy that remembers too few episodes
    /// for a test is named if all others are doubted.
    fn recognise(
        &self,
        candidates: &mut dyn Candidates,
        clouds: &[Candidate],
        rng: &mut ChaCha8Rng,
    ) -> Result<GroupingDecision, LearnerError> {
        let assignment = self.assigner.recognise(clouds, rng)?;
        let untested = |policy: usize| assignment.evidence[policy].test().is_none();
        let is_untested = matches!(assignment.decision, Decision::Existing(p) if untested(p));
        let Rule::Calibrated(settings) = &self.assigner.settings().rule else {
            return Ok(assignment.into());
        };
        let Some([first, second]) = assignment.rivals().filter(|_| !is_untested) else {
            return Ok(assignment.into());
        };
        let contests = candidates.contests([first, second], settings.buffer_episodes)?;
        let second_leads = lead(&contests)? < 0.0;
        let winner = if second_leads { second } else { first };
        let policy = match assignment.evidence[winner].verdict {
            Verdict::Accepted => Decision::Existing(winner),
            Verdict::Doubted | Verdict::Rejected => Decision::Undecided,
        };
        Ok(GroupingDecision { policy, nearest: Some(winner), ..assignment.into() })
    }
}

impl Grouping for Distance {
    fn needs(&self) -> Needs {
        match &self.assigner.settings().rule {
            Rule::Fixed { .. } => Needs::LEAST,
            Rule::Calibrated(calibrated) => {
                Needs { episodes: calibrated.min_episodes, ..Needs::LEAST }
            }
        }
    }

    fn assign(
        &mut self,
        query: Query<'_>,
        candidates: &mut dyn Candidates,
        rng: &mut ChaCha8Rng,
    ) -> Result<GroupingDecision, LearnerError> {
        let mut clouds = candidates.clouds()?;
        if let Query::Recognition = query {
            return self.recognise(candidates, &clouds, rng);
        }
        let began = candidates.began();
        let cut = self.assigner.cut(&clouds, &began, rng)?;
        if let Some(cut) = cut {
            // the policy acts in the later group from here on, so only that one decides
            let is_later = |&episode: &usize| began[episode] >= cut;
            let later: Vec<usize> = (0..began.len()).filter(is_later).collect();
            for cloud in &mut clouds {
                cloud.rollout = cloud.rollout.select(&later)?;
            }
        }
        let assignment = match query {
            Query::TwoRollouts => self.assigner.settle(&clouds, rng)?,
            _ => self.assigner.assign(&clouds, rng)?,
        };
        Ok(GroupingDecision { cut, ..assignment.into() })
    }
}

#[cfg(test)]
mod tests {
    use cluster::{Contest, Frames};
    use rand::{RngExt, SeedableRng};

    use super::*;
    use crate::groupings::grouping::{Episodes, Recognised};

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
            let all = centres.iter().flat_map(|c| std::iter::repeat_n(c, episodes));
            Frames::new(all.map(near).collect(), 1, 1).unwrap()
        }
    }

    impl Candidates for Rounds {
        fn clouds(&mut self) -> Result<Vec<Candidate>, LearnerError> {
            let rollout = self.around(&self.rounds.clone(), 10);
            let clouds = self.homes.clone().into_iter().map(|home| Candidate {
                buffer: self.around(&[home], 40),
                rollout: rollout.clone(),
            });
            Ok(clouds.collect())
        }

        fn contests(&mut self, _: [usize; 2], _: usize) -> Result<[Contest; 2], LearnerError> {
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
        let mut distance = Distance::new(Rule::default()).unwrap();
        let homes = homes.to_vec();
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut seen = Rounds { rounds, homes, rng: rng.clone() };
        let decision = distance.assign(Query::TwoRollouts, &mut seen, &mut rng);
        let decision = decision.unwrap();
        (decision.policy, decision.cut)
    }

    /// A known group that was doubted by chance, and gave way before the second look.
    #[test]
    fn the_second_of_two_groups_decides() {
        let (old, new) = (0.0, 5.0);
        assert_eq!(settled([old, new], &[old, new]), (Decision::Existing(1), Some(500)));
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
        fn clouds(&mut self) -> Result<Vec<Candidate>, LearnerError> {
            let clouds = [0, 1].map(|policy| Candidate {
                buffer: self.frames(policy, &self.home(policy)),
                rollout: self.frames(policy, &[self.seen]),
            });
            Ok(clouds.into())
        }

        fn contests(&mut self, rivals: [usize; 2], _: usize) -> Result<[Contest; 2], LearnerError> {
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
        let mut distance = Distance::new(Rule::default()).unwrap();
        let mut rng = ChaCha8Rng::seed_from_u64(3);
        let mut glance = Glance { seen: [-1.0, 1.2], rng: rng.clone() };
        let clouds = glance.clouds().unwrap();
        let alone = distance.assigner.recognise(&clouds, &mut rng).unwrap();
        assert_eq!(alone.nearest(), Some(1));
        let mut recognise = |seen| {
            glance.seen = seen;
            let decision = distance.assign(Query::Recognition, &mut glance, &mut rng);
            let Recognised { policy, fits } = (&decision.unwrap()).into();
            (policy, fits)
        };
        assert_eq!(recognise([-1.0, 1.2]), (0, false));
        assert_eq!(recognise([-1.0, 0.1]), (0, true));
        assert_eq!(recognise([1.0, 0.1]), (1, true));
    }
}
