//! Policies that act with their parameters from before the latest update.

use std::sync::{Arc, Mutex};

use cluster::AssignedPolicy;
use learner::{
    AssignmentData, AssignmentPurpose, CheckpointExtent, CoversLearner, CoversSettings,
    EpisodeRequirements, Grouping, GroupingDecision, Learner as _, LearnerError,
    PreviousParameters, RequiredTrial,
};
use rand_chacha::ChaCha8Rng;
use rl::{PpoSettings, VectorEnv as _};

use crate::bars::{Bars, covers_settings, number, scratch};

/// Availability of previous parameters in a request, and the largest action of its rollout.
type Request = (PreviousParameters, f32);

/// Grouping that doubts each rollout for which the policy can act with its previous parameters, and
/// accepts all others.
#[derive(Clone, Default)]
struct Doubting(Arc<Mutex<Vec<Request>>>);

impl Grouping for Doubting {
    fn requirements(&self) -> EpisodeRequirements {
        EpisodeRequirements { episodes: 1, whole_episodes: true, chooses_collector: false }
    }

    fn assign(
        &mut self,
        request: AssignmentPurpose<'_>,
        data: &mut dyn AssignmentData,
        _: &mut ChaCha8Rng,
    ) -> Result<GroupingDecision, LearnerError> {
        let AssignmentPurpose::Assign { previous_parameters, .. } = request else {
            panic!("{request:?}")
        };
        let actions = data.episodes().trajectories.iter().flat_map(|t| &t.actions);
        let largest = actions.fold(0.0_f32, |largest, action| largest.max(action.abs()));
        self.0.lock().unwrap().push((previous_parameters, largest));
        let collector = AssignedPolicy::Existing(data.episodes().collector);
        Ok(if previous_parameters == PreviousParameters::Available {
            let trial = RequiredTrial::PreviousParameters;
            GroupingDecision { trial, ..GroupingDecision::for_policy(AssignedPolicy::Undecided) }
        } else {
            GroupingDecision::for_policy(collector)
        })
    }
}

/// The first update makes actions many times larger. Those of a doubted policy are as small as
/// before, also when the run continues from a checkpoint, and the latest parameters are trained.
#[test]
fn a_doubted_policy_acts_once_as_before_its_latest_update() {
    let fast = PpoSettings { head_learning_rate: 3.0, ..covers_settings().ppo };
    let settings = CoversSettings { ppo: fast, ..covers_settings() };
    let grouping = Doubting::default();
    let (mut env, path) = (Bars::new(), scratch("previous"));
    let whole = CheckpointExtent::Everything;
    let mut covers =
        CoversLearner::with_grouping(settings, env.spec(), Box::new(grouping.clone())).unwrap();
    covers.learn(&mut env).unwrap();
    covers.save(&path, whole, "").unwrap();
    let loaded = CoversLearner::load_with_grouping(&path, env.spec(), Box::new(grouping.clone()));
    let mut trained = Vec::new();
    for mut learner in [covers, loaded.unwrap().0] {
        let latest = learner.policy_parameters(0).unwrap().to_vec();
        let iteration = learner.learn(&mut env.clone()).unwrap();
        assert_eq!((iteration.decisions, iteration.discarded), (200, 1));
        let requests = std::mem::take(&mut *grouping.0.lock().unwrap());
        let [(available, large), (acted, small)] = requests[..] else { panic!("{requests:?}") };
        assert_eq!(available, PreviousParameters::Available);
        assert_eq!(acted, PreviousParameters::Acted);
        assert!(large > 100.0 && small < 10.0, "{large} {small}");
        learner.save(&path, whole, "").unwrap();
        let bytes = std::fs::read(&path).unwrap();
        let file = safetensors::SafeTensors::deserialize(&bytes).unwrap();
        let before = file.tensor("policy.0.previous_params").unwrap();
        let latest: Vec<u8> = latest.iter().flat_map(|value| value.to_le_bytes()).collect();
        assert!(before.data() == latest, "other parameters than the latest were trained");
        assert!(number(&iteration, "steps") >= 1.0, "nothing was trained");
        trained.push(learner.policy_parameters(0).unwrap().to_vec());
    }
    std::fs::remove_file(&path).unwrap();
    assert!(trained[0] == trained[1], "a learner that was loaded trains differently");
}
