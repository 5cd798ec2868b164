//! Algorithm 1 without MuJoCo: the learner on a toy environment whose hidden group changes.

use cluster::PolicyVerdict;
use learner::{
    CoversLearner, CoversSettings, GroupingSettings, IterationReport, Learner, LearnerSettings,
    NewPolicyInit, ReassignedRolloutHandling, TaskLabel,
};
use rl::VectorEnv;

use crate::bars::{Bars, HORIZON, assert_continues_alike, assert_refused, covers_settings, number};

fn settings() -> CoversSettings {
    CoversSettings { first_frames: 2, ..covers_settings() }
}

fn with(mut settings: CoversSettings, change: impl FnOnce(&mut CoversSettings)) -> CoversSettings {
    change(&mut settings);
    settings
}

/// The learner of `settings` after rollouts in these groups, with its reports.
fn after(settings: CoversSettings, groups: &[usize]) -> (CoversLearner, Vec<IterationReport>) {
    let mut env = Bars::new();
    let mut covers = CoversLearner::new(settings, env.spec()).unwrap();
    let reports = env.train(&mut covers, groups);
    (covers, reports)
}

/// A figure of each report.
fn each<T>(reports: &[IterationReport], figure: fn(&IterationReport) -> T) -> Vec<T> {
    reports.iter().map(figure).collect()
}

#[test]
fn a_new_group_creates_a_policy_and_an_old_one_is_recalled() {
    let (covers, reports) = after(settings(), &[0, 0, 1, 1, 0, 1, 0, 0]);
    assert_eq!(each(&reports, |report| report.policy), [0, 0, 1, 1, 0, 1, 0, 0]);
    let created = each(&reports, |report| report.policy_created);
    assert_eq!(created, [false, false, true, false, false, false, false, false]);
    assert_eq!(covers.policy_count(), 2);
    // the first rollout has nothing to be compared with; a policy is created after a second rollout
    // and collects its own, and one that is recalled is chosen before the rollout
    assert!(reports[0].evidence.is_empty());
    let decisions = each(&reports, |report| report.decisions);
    assert_eq!(decisions, [100, 100, 300, 100, 100, 100, 100, 100]);
    assert_eq!(each(&reports, |report| report.discarded == 1), created);
    let verdicts: Vec<_> = reports[2].evidence.iter().map(|e| e.verdict).collect();
    assert_eq!(verdicts, [PolicyVerdict::Rejected]);
}

#[test]
fn settings_that_would_disable_assignment_are_refused() {
    let mut env = Bars::new();
    let small = with(settings(), |s| s.buffer_episodes = Some(3));
    assert_refused(CoversLearner::new(small, env.spec()), "`buffer_episodes` is 3");
    // episodes of 5 steps never show 6 frames
    let long = with(settings(), |s| s.first_frames = 6);
    let mut covers = CoversLearner::new(long, env.spec()).unwrap();
    assert_refused(covers.learn(&mut env), "of 0 episodes, expected at least 4");
    let oracle = with(settings(), |s| s.grouping = GroupingSettings::Oracle);
    assert_refused(CoversLearner::new(oracle, env.spec()), "a grouping without labels");
    env.spec.num_envs = 50;
    env.limited = true;
    let mut short = CoversLearner::new(settings(), env.spec()).unwrap();
    assert_refused(short.learn(&mut env), "rollouts of 2 steps end before an episode of 5");
}

#[test]
fn few_environments_are_recognised_over_several_rounds() {
    let mut env = Bars::new();
    env.spec.num_envs = 4;
    let mut covers = CoversLearner::new(settings(), env.spec()).unwrap();
    env.train(&mut covers, &[0, 1]);
    let recognised = [0, 1].map(|group| env.recognised(&mut covers, group, None));
    assert_eq!(recognised, [Some(0), Some(1)]);
}

#[test]
fn recognition_finds_the_policy_and_does_not_disturb_learning() {
    let run = |recognise: bool| {
        let mut env = Bars::new();
        let mut covers = CoversLearner::new(settings(), env.spec()).unwrap();
        env.train(&mut covers, &[0, 1]);
        for group in (0..2).filter(|_| recognise) {
            assert_eq!(Bars::new().recognised(&mut covers, group, None), Some(group));
        }
        covers.learn(&mut env).unwrap()
    };
    let (with, without) = (run(true), run(false));
    assert_eq!((with.metrics, with.evidence), (without.metrics, without.evidence));
}

#[test]
fn one_episode_names_a_known_group_and_many_can_say_that_no_policy_fits() {
    let (mut covers, _) = after(covers_settings(), &[0, 1, 0, 1]);
    assert_eq!(covers.policy_count(), 2);
    for (group, episodes) in [0, 1].into_iter().flat_map(|g| [(g, 1), (g, 4), (g, 20)]) {
        let named = Bars::new().recognised(&mut covers, group, Some(episodes));
        assert_eq!(named, Some(group));
    }
    let (mut of_one_group, _) = after(covers_settings(), &[0, 0, 0]);
    assert_eq!(Bars::new().recognised(&mut of_one_group, 0, Some(20)), Some(0));
    assert_eq!(Bars::new().recognised(&mut of_one_group, 1, Some(20)), None);
}

#[test]
fn a_policy_that_does_not_exist_is_named() {
    let mut env = Bars::new();
    let mut covers = CoversLearner::new(settings(), env.spec()).unwrap();
    assert_refused(covers.evaluate_policy(7, &mut env, 1), "`policy` is 7");
}

/// A single policy, so that nothing but the rollouts can make a difference.
#[test]
fn the_noise_of_rollouts_keeps_its_direction_as_set() {
    let single = |noise_correlation| {
        with(settings(), |s| {
            s.grouping = GroupingSettings::Single;
            s.noise_correlation = noise_correlation;
        })
    };
    let trained = |correlation| {
        let (covers, _) = after(single(correlation), &[0]);
        covers.policy_parameters(0).unwrap().to_vec()
    };
    assert_eq!(trained(0.5), trained(0.5));
    assert_ne!(trained(0.5), trained(0.0));
    assert_refused(CoversLearner::new(single(1.0), &Bars::new().spec), "noise_correlation");
}

/// Settings whose updates change nothing that could be seen.
fn still() -> CoversSettings {
    with(settings(), |s| {
        (s.ppo.head_learning_rate, s.ppo.encoder_learning_rate) = (1e-30, 1e-30);
    })
}

#[test]
fn a_rollout_that_changes_hands_is_collected_again_or_reused() {
    let groups = [0, 1, 0, 1];
    // this grouping decides after a rollout which policy should have collected it
    let grouping = GroupingSettings::Threshold { threshold: 0.1 };
    let run = |handover| {
        let settings = with(still(), |s| (s.handover, s.grouping) = (handover, grouping));
        let (_, reports) = after(settings, &groups);
        assert_eq!(each(&reports, |report| report.policy), groups);
        reports
    };
    let (again, reused) =
        (run(ReassignedRolloutHandling::CollectAgain), run(ReassignedRolloutHandling::Reuse));
    assert_eq!(each(&again, |report| report.decisions), [100, 200, 200, 200]);
    assert_eq!(each(&reused, |report| report.decisions), [100; 4]);
    for report in reused {
        assert!(number(&report, "approx_kl") < 1e-9 && number(&report, "clip_fraction") == 0.0);
    }
}

#[test]
fn a_buffer_grows_up_to_its_bound_or_without() {
    let grown = |buffer_episodes| {
        let settings = with(settings(), |s| s.buffer_episodes = buffer_episodes);
        let (covers, reports) = after(settings, &[0, 0, 0]);
        let decisions: usize = reports.iter().map(|report| report.decisions).sum();
        (covers.num_policy_buffer_episodes(0), decisions / HORIZON)
    };
    let (bounded, shown) = grown(Some(30));
    assert!(bounded == Some(30) && shown >= 60);
    let (unbounded, shown_all) = grown(None);
    assert_eq!(unbounded, Some(shown_all));
    assert_eq!(
        after(settings(), &[0]).0.num_policy_buffer_episodes(1),
        None,
        "there is one policy"
    );
}

#[test]
fn a_new_policy_is_random_or_a_copy_of_the_nearest() {
    let act_alike = |new_policy| {
        let settings = with(still(), |s| s.new_policy = new_policy);
        let (mut covers, reports) = after(settings, &[0, 1]);
        assert!(reports[1].policy_created);
        let mut perform = |index| covers.evaluate_policy(index, &mut Bars::new(), 1).unwrap();
        perform(0) == perform(1)
    };
    assert!(act_alike(NewPolicyInit::Copy));
    assert!(!act_alike(NewPolicyInit::Random));
    // labels have no distances, so no policy is nearest
    let labelled = with(settings(), |s| {
        (s.grouping, s.new_policy) = (GroupingSettings::Oracle, NewPolicyInit::Copy);
    });
    let (env, labels) = (Bars::new(), TaskLabel::default());
    let learner = LearnerSettings::Covers(labelled).new_learner(env.spec(), &labels);
    assert_refused(learner.map(|_| ()), "`new_policy` is copy");
}

#[test]
fn the_papers_reading_learns_and_asks_for_its_images() {
    let paper = CoversSettings::paper();
    assert_refused(
        CoversLearner::new(paper.clone(), &Bars::new().spec),
        "expected exactly 128 x 128",
    );
    let settings = CoversSettings { network: settings().network, rollout_steps: 100, ..paper };
    let (covers, reports) = after(settings, &[0, 0, 1, 1]);
    assert_eq!(each(&reports, |report| (report.decisions, report.discarded)), [(100, 0); 4]);
    let kept =
        (0..covers.policy_count()).map(|index| covers.num_policy_buffer_episodes(index).unwrap());
    assert_eq!(kept.sum::<usize>(), 80);
}

#[test]
fn a_single_policy_takes_everything() {
    let single = with(settings(), |s| s.grouping = GroupingSettings::Single);
    let (covers, reports) = after(single, &[0, 1, 0]);
    assert_eq!(covers.policy_count(), 1);
    for report in &reports {
        assert!(report.policy == 0 && !report.policy_created && report.evidence.is_empty());
        assert_eq!(report.decisions, 100);
    }
}

#[test]
fn an_iteration_logs_the_same_names_whatever_happens() {
    let (_, reports) = after(settings(), &[0, 1, 0]);
    let names = |report: &IterationReport| -> Vec<String> {
        report.metrics.iter().map(|(name, _)| name.to_owned()).collect()
    };
    assert!(names(&reports[0]).contains(&"distances".to_owned()));
    for report in &reports {
        assert_eq!(names(report), names(&reports[0]));
    }
    let distances =
        |report: &IterationReport| report.metrics.metric("distances").unwrap().to_string();
    assert_eq!(distances(&reports[0]), "");
    assert_eq!(distances(&reports[2]).split(';').count(), 2);
}

#[test]
fn a_saved_learner_continues_alike() {
    assert_continues_alike(settings(), Bars::new(), "covers");
    for env in Bars::half_blind() {
        let single = with(settings(), |s| s.grouping = GroupingSettings::Single);
        assert_continues_alike(single, env, "covers-half-blind");
    }
}
