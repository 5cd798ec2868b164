use std::path::Path;

use envs::Camera;
use rand::Rng;
use rl::{Observations, Transition, VectorEnv};

use super::*;
use crate::presets::{Budget, Method};
use learner::{CheckpointExtent, IterationReport, LearnerError, RecognisedPolicy};

/// Learner that takes the same action at every step, and records first observations of episodes.
#[derive(Default)]
struct Spy {
    /// All components of every action.
    action: f32,
    /// Random numbers drawn during recognition.
    draws: usize,
    /// Parameters of its policies; `None` if it does not expose them.
    parameters: Option<Vec<f32>>,
    seen: Vec<Observations>,
    /// Policies that played, in order.
    played: Vec<usize>,
}

impl Spy {
    /// Plays `rounds` episodes in every environment, from a reset on.
    fn watch(&mut self, env: &mut dyn VectorEnv, rounds: usize) {
        let spec = env.spec().clone();
        let mut begun = Observations::new(&spec);
        env.reset(&mut begun).unwrap();
        self.seen.push(begun);
        let mut transition = Transition::new(&spec);
        let actions = vec![self.action; spec.num_envs * spec.action_irreps.len()];
        for _ in 1..rounds {
            for _ in 0..env.horizon().unwrap() {
                env.step(&actions, &mut transition).unwrap();
            }
            self.seen.push(transition.observations.clone());
        }
    }
}

impl Learner for Spy {
    fn learn(&mut self, _: &mut dyn VectorEnv) -> Result<IterationReport, LearnerError> {
        panic!("evaluations teach nothing")
    }

    fn recognise_policy(
        &mut self,
        env: &mut dyn VectorEnv,
        _: Option<usize>,
        rng: &mut ChaCha8Rng,
    ) -> Result<RecognisedPolicy, LearnerError> {
        self.watch(env, 1);
        (0..self.draws).for_each(|_| _ = rng.next_u32());
        Ok(RecognisedPolicy { policy: 0, fits: true })
    }

    fn evaluate_policy(
        &mut self,
        index: usize,
        env: &mut dyn VectorEnv,
        rounds: usize,
    ) -> Result<PolicyEvaluationResult, LearnerError> {
        self.watch(env, rounds);
        self.played.push(index);
        // policy 1 alone succeeds
        let episode = rl::EpisodeStats {
            env: 0,
            length: 1,
            total_reward: index as f64,
            success: index == 1,
            success_at_end: false,
        };
        let mut performance = PolicyEvaluationResult::default();
        performance.stats.episodes.push(episode);
        Ok(performance)
    }

    fn policy_parameters(&self, _: usize) -> Option<&[f32]> {
        self.parameters.as_deref()
    }

    fn policy_count(&self) -> usize {
        1
    }

    fn to_checkpoint_bytes(
        &self,
        _: &Path,
        _: CheckpointExtent,
        _: &str,
    ) -> Result<Vec<u8>, LearnerError> {
        Ok(Vec::new())
    }
}

/// Returns the first observations that a learner sees when a run of this method and seed is scored
/// twice, and then asked for its policies.
fn shown(method: Method, seeds: [u64; 2], mut spy: Spy) -> Vec<Observations> {
    let mut run = Budget::Smoke.preset_experiment(method).with_seed(seeds[0]);
    run.schedule.groups.truncate(1);
    // methods have pictures of their own, and what is compared is what they show
    run.envs.camera = Camera::default();
    run.evaluation.seed = seeds[1];
    let tasks = TaskRegistry::with_standard();
    let labels = TaskLabel::default();
    let mut evaluator = Evaluator::for_experiment(&run.with_threads(1), &tasks, labels).unwrap();
    let [variant, ..] = evaluator.task_variants()[..] else { panic!() };
    let none = OwnPolicyByGroup::default();
    for rounds in [1, 2] {
        let findings = &mut EvaluationResults::default();
        evaluator.score_variant(&mut spy, variant, &none, rounds, findings).unwrap();
    }
    evaluator.test_recognition(&mut spy, variant, 1).unwrap();
    spy.seen
}

#[test]
fn all_methods_and_seeds_are_scored_on_the_same_placements() {
    let spy = |action, draws| Spy { action, draws, ..Spy::default() };
    let covers = shown(Method::Covers, [20, 0], spy(0.0, 0));
    // a look and one round, a look and two rounds, and three looks
    assert_eq!(covers.len(), 2 + 3 + 3);
    assert!(covers[1] == covers[0] && covers[3] == covers[0], "the first round is always the same");
    assert!(covers[4] != covers[3], "the second round is another one");
    assert!(covers[5] != covers[0] && covers[6] != covers[5], "looks are others");
    for (method, seed) in [
        (Method::Clear, 20),
        (Method::Covers, 29),
        (Method::ThreeRl, 1000),
        // its training pictures are randomised, and these are not
        (Method::CoversRandomised, 20),
    ] {
        assert!(covers == shown(method, [seed, 0], spy(0.9, 7)), "{method:?} {seed}");
    }
    let other = shown(Method::Covers, [20, 1], spy(0.0, 0));
    assert!(covers[0] != other[0], "placements follow the evaluation's seed");
}

#[test]
fn what_the_learner_draws_is_not_what_places_the_episodes() {
    use rand::RngExt;
    let words = |mut rng: ChaCha8Rng| -> [u64; 2] { [rng.random(), rng.random()] };
    let placing = |index| {
        let mut rng = ChaCha8Rng::seed_from_u64(7);
        rng.set_stream(index);
        words(rng)
    };
    assert!((0..1000).all(|index| placing(index) != words(recognition_rng(7))));
}

#[test]
fn a_policy_that_has_not_changed_is_not_played_again() {
    let run = Budget::Smoke.preset_experiment(Method::Covers).with_threads(1);
    let (tasks, labels) = (TaskRegistry::with_standard(), TaskLabel::default());
    let mut evaluator = Evaluator::for_experiment(&run, &tasks, labels).unwrap();
    let [first, second, ..] = evaluator.task_variants()[..] else { panic!() };
    let mut spy = Spy::default();
    let mut plays = |parameters: Option<Vec<f32>>, variant, rounds| {
        (spy.parameters, spy.seen) = (parameters, Vec::new());
        let (findings, none) = (&mut EvaluationResults::default(), OwnPolicyByGroup::default());
        evaluator.score_variant(&mut spy, variant, &none, rounds, findings).unwrap();
        assert_eq!(findings.scores.len(), 1);
        // the look before it is another one
        spy.seen.len() - 1
    };
    let some = |parameter| Some(vec![1.0, parameter]);
    assert_eq!(plays(some(2.0), first, 1), 1);
    assert_eq!(plays(some(2.0), first, 1), 0);
    assert_eq!(plays(some(2.0), second, 1), 1);
    assert_eq!(plays(some(2.0), first, 1), 0);
    assert_eq!(plays(some(2.0), first, 2), 2);
    assert_eq!(plays(some(0.0), first, 1), 1);
    assert_eq!(plays(some(-0.0), first, 1), 1);
    for _ in 0..2 {
        assert_eq!(plays(None, first, 1), 1);
    }
}

/// The learner always chooses policy 0.
#[test]
fn a_groups_own_policy_plays_the_same_episodes_where_another_one_was_chosen() {
    let run = Budget::Smoke.preset_experiment(Method::Covers).with_threads(1);
    let (tasks, labels) = (TaskRegistry::with_standard(), TaskLabel::default());
    let mut evaluator = Evaluator::for_experiment(&run, &tasks, labels).unwrap();
    let variant = evaluator.task_variants()[0];
    let group = variant.group.name().to_owned();
    let mut score = |own: Option<usize>| {
        let own = own.map(|own| (group.clone(), own)).into_iter().collect();
        let (mut spy, findings) = (Spy::default(), &mut EvaluationResults::default());
        evaluator.score_variant(&mut spy, variant, &own, 1, findings).unwrap();
        assert!(spy.seen.iter().all(|seen| *seen == spy.seen[0]));
        (findings.scores.remove(0), spy.played)
    };
    let (untrained, played) = score(None);
    assert_eq!((untrained.own_policy_score, played), (None, vec![0]));
    let (right, played_once) = score(Some(0));
    assert_eq!(played_once, [0], "nothing is played twice");
    let own = right.own_policy_score.unwrap();
    assert_eq!((own.policy, own.success, own.reward), (0, 0.0, 0.0));
    let (wrong, played_both) = score(Some(1));
    assert_eq!(played_both, [0, 1]);
    let other_own = wrong.own_policy_score.unwrap();
    assert!(wrong.is_policy_mismatch() && !right.is_policy_mismatch());
    assert_eq!((wrong.policy, wrong.success), (0, 0.0));
    assert_eq!((other_own.policy, other_own.success, other_own.success_at_end), (1, 1.0, 0.0));
    assert!(other_own.reward > 0.0);
}

/// Placements are compared by the pictures of the first observations, each mirrored back.
#[test]
fn variants_have_mirrored_placements_or_placements_of_their_own() {
    let pictures = |distinct_placements| {
        let mut run = Budget::Smoke.preset_experiment(Method::Covers).with_threads(1);
        run.evaluation.distinct_placements = distinct_placements;
        // without an arm, whose pictures are not symmetric
        run.envs.embodiment = envs::Embodiment::FLOATING_HAND;
        let (tasks, labels) = (TaskRegistry::with_standard(), TaskLabel::default());
        let mut evaluator = Evaluator::for_experiment(&run, &tasks, labels).unwrap();
        let mut spy = Spy::default();
        let (per_group, mut variants) = (D2::ALL.len(), evaluator.task_variants());
        // of Button Press: pictures of Goal Reach do not show where the goal is
        for variant in variants.drain(per_group..2 * per_group) {
            let findings = &mut EvaluationResults::default();
            let own = OwnPolicyByGroup::default();
            evaluator.score_variant(&mut spy, variant, &own, 1, findings).unwrap();
        }
        let spec = evaluator.stream.spec();
        let [height, width, channels] = spec.image_shape;
        // a look and a round for each variant
        assert_eq!(spy.seen.len(), 2 * D2::ALL.len());
        let shown = spy.seen.iter().step_by(2).zip(D2::ALL);
        let mirrored_back = shown.map(|(seen, element)| {
            let images = seen.images.chunks(spec.image_len());
            images
                .flat_map(|image| element.transform_image(image, height, width, channels))
                .collect()
        });
        mirrored_back.collect::<Vec<Vec<u8>>>()
    };
    let mirrored = pictures(false);
    assert!(mirrored.iter().all(|images| *images == mirrored[0]));
    let distinct = pictures(true);
    assert!(distinct[0] == mirrored[0], "seeds of the identity are the same");
    for (index, images) in distinct.iter().enumerate() {
        assert!(distinct[..index].iter().all(|others| others != images));
    }
}
