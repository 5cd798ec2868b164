//! Algorithm 1 without MuJoCo: the learner on a toy environment whose hidden group changes.

use cluster::{Decision, Verdict};
use learner::{
    Candidates, CheckpointExtent, Covers, CoversSettings, Grouping, GroupingDecision,
    GroupingSettings, Handover, Iteration, Learned, Learner, LearnerError, Lesson, NewPolicyInit,
    Query,
};
use rand_chacha::ChaCha8Rng;
use rl::{CriticSettings, PpoSettings, VectorEnv};

use crate::bars::{Bars, HORIZON, network, number};

fn settings() -> CoversSettings {
    CoversSettings {
        network: network(CriticSettings::Pooled { width: 8 }),
        ppo: PpoSettings { epochs: 1, minibatch: 20, ..PpoSettings::default() },
        first_frames: 2,
        rollout_steps: 100,
        ..CoversSettings::default()
    }
}

/// Settings with one thing changed.
fn with(mut settings: CoversSettings, change: impl FnOnce(&mut CoversSettings)) -> CoversSettings {
    change(&mut settings);
    settings
}

/// Checks that a result is an error whose message has this part.
fn assert_refused<T>(result: Result<T, LearnerError>, part: &str) {
    let message = result.err().unwrap().to_string();
    assert!(message.contains(part), "{message}");
}

#[test]
fn a_new_group_opens_a_policy_and_an_old_one_is_recalled() {
    let mut env = Bars::new();
    let mut covers = Covers::new(settings(), env.spec()).unwrap();
    let assigned = env.teach(&mut covers, &[0, 0, 1, 1, 0, 1, 0, 0]);
    let policies: Vec<usize> = assigned.iter().map(|report| report.policy).collect();
    assert_eq!(policies, [0, 0, 1, 1, 0, 1, 0, 0]);
    let created: Vec<bool> = assigned.iter().map(|report| report.policy_created).collect();
    assert_eq!(created, [false, false, true, false, false, false, false, false]);
    assert_eq!(covers.policy_count(), 2);
    // the first rollout has nothing to be compared with; a rollout that changes hands is collected
    // twice, and a policy is opened after a second look
    assert!(assigned[0].evidence.is_empty());
    let decisions: Vec<usize> = assigned.iter().map(|report| report.decisions).collect();
    assert_eq!(decisions, [100, 100, 300, 100, 200, 200, 200, 100]);
    let twice: Vec<bool> = assigned.iter().map(|report| report.discarded == 1).collect();
    assert_eq!(twice, created);
    let verdicts: Vec<_> = assigned[2].evidence.iter().map(|e| e.verdict).collect();
    assert_eq!(verdicts, [Verdict::Rejected]);
}

#[test]
fn settings_that_would_disable_assignment_are_refused() {
    let mut env = Bars::new();
    let small = with(settings(), |s| s.buffer_episodes = Some(3));
    assert_refused(Covers::new(small, env.spec()), "`buffer_episodes` is 3");
    // episodes of 5 steps never show 6 frames
    let long = with(settings(), |s| s.first_frames = 6);
    let mut covers = Covers::new(long, env.spec()).unwrap();
    assert_refused(covers.learn(&mut env), "of 0 episodes, expected at least 4");
}

#[test]
fn few_environments_are_recognised_over_several_rounds() {
    let mut env = Bars::new();
    env.spec.num_envs = 4;
    let mut covers = Covers::new(settings(), env.spec()).unwrap();
    env.teach(&mut covers, &[0, 1]);
    assert_eq!(env.recognised(&mut covers), [0, 1]);
}

#[test]
fn recognising_finds_the_policy_and_does_not_disturb_learning() {
    let run = |look: bool| {
        let mut env = Bars::new();
        let mut covers = Covers::new(settings(), env.spec()).unwrap();
        env.teach(&mut covers, &[0, 1]);
        if look {
            assert_eq!(Bars::new().recognised(&mut covers), [0, 1]);
        }
        covers.learn(&mut env).unwrap()
    };
    let (with, without) = (run(true), run(false));
    assert_eq!(with.metrics, without.metrics);
    assert_eq!(with.evidence, without.evidence);
}

#[test]
fn a_policy_that_does_not_exist_is_named() {
    let mut env = Bars::new();
    let mut covers = Covers::new(settings(), env.spec()).unwrap();
    assert_refused(covers.evaluate_policy(7, &mut env, 1), "`policy` is 7");
}

/// The learner of `settings` after rollouts in these groups, with what it reported.
fn after(settings: CoversSettings, groups: &[usize]) -> (Covers, Vec<Iteration>) {
    let mut env = Bars::new();
    let mut covers = Covers::new(settings, env.spec()).unwrap();
    let reports = env.teach(&mut covers, groups);
    (covers, reports)
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
    let learnt = |correlation| {
        let (covers, _) = after(single(correlation), &[0]);
        covers.policy_parameters(0).unwrap().to_vec()
    };
    assert_eq!(learnt(0.5), learnt(0.5));
    assert_ne!(learnt(0.5), learnt(0.0));
    let refused = Covers::new(single(1.0), &Bars::new().spec);
    assert_refused(refused, "noise_correlation");
}

/// Settings whose updates change nothing that could be seen.
fn still() -> CoversSettings {
    let mut settings = settings();
    settings.ppo.head_learning_rate = 1e-30;
    settings.ppo.encoder_learning_rate = 1e-30;
    settings
}

#[test]
fn a_rollout_that_changes_hands_is_collected_again_or_reused() {
    let groups = [0, 1, 0, 1];
    let run = |handover| {
        let settings = with(still(), |s| s.handover = handover);
        let (_, reports) = after(settings, &groups);
        let policies: Vec<usize> = reports.iter().map(|r| r.policy).collect();
        assert_eq!(policies, groups);
        reports
    };
    let decisions = |reports: &[Iteration]| reports.iter().map(|r| r.decisions).collect::<Vec<_>>();
    let (again, reused) = (run(Handover::CollectAgain), run(Handover::Reuse));
    // the second rollout opens a policy, after a second look
    assert_eq!(decisions(&again), [100, 300, 200, 200]);
    assert_eq!(decisions(&reused), [100, 200, 100, 100]);
    for turn in reused {
        assert!(number(&turn, "approx_kl") < 1e-9 && number(&turn, "clip_fraction") == 0.0);
    }
}

#[test]
fn a_buffer_grows_up_to_its_bound_or_without() {
    let grown = |buffer_episodes| {
        let settings = with(settings(), |s| s.buffer_episodes = buffer_episodes);
        let (covers, reports) = after(settings, &[0, 0, 0]);
        let decisions: usize = reports.iter().map(|report| report.decisions).sum();
        (covers.buffered_episodes(0), decisions / HORIZON)
    };
    let (bounded, shown) = grown(Some(30));
    assert!(bounded == Some(30) && shown >= 60);
    let (unbounded, shown_all) = grown(None);
    assert_eq!(unbounded, Some(shown_all));
    assert_eq!(after(settings(), &[0]).0.buffered_episodes(1), None, "there is one policy");
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
}

#[test]
fn the_papers_reading_learns_and_asks_for_its_pictures() {
    assert_refused(
        Covers::new(CoversSettings::paper(), &Bars::new().spec),
        "expected exactly 128 x 128",
    );
    let settings = CoversSettings {
        network: settings().network,
        rollout_steps: 100,
        ..CoversSettings::paper()
    };
    let (covers, reports) = after(settings, &[0, 0, 1, 1]);
    for report in &reports {
        assert_eq!(report.decisions, 100);
        assert_eq!(report.discarded, 0);
    }
    let kept = (0..covers.policy_count()).map(|index| covers.buffered_episodes(index).unwrap());
    assert_eq!(kept.sum::<usize>(), 80);
}

#[test]
fn a_single_policy_takes_everything_and_an_oracle_asks_for_a_run() {
    let single = with(settings(), |s| s.grouping = GroupingSettings::Single);
    let (covers, turns) = after(single, &[0, 1, 0]);
    assert_eq!(covers.policy_count(), 1);
    for turn in &turns {
        assert!(turn.policy == 0 && !turn.policy_created && turn.evidence.is_empty());
        assert_eq!(turn.decisions, 100);
    }
    let oracle = with(settings(), |s| s.grouping = GroupingSettings::Oracle);
    let oracle = Covers::new(oracle, &Bars::new().spec);
    assert_refused(oracle, "a grouping without labels");
}

/// A grouping of somebody else's: what it decides is written down, and begins anew at the end.
struct Scripted {
    decisions: Vec<Decision>,
    asked: usize,
}

impl Scripted {
    fn new(decisions: &[Decision]) -> Box<Self> {
        let decisions = decisions.to_vec();
        Box::new(Self { decisions, asked: 0 })
    }
}

impl Grouping for Scripted {
    fn assign(
        &mut self,
        _: Query<'_>,
        candidates: &mut dyn Candidates,
        _: &mut ChaCha8Rng,
    ) -> Result<GroupingDecision, LearnerError> {
        assert!(!candidates.clouds()?.is_empty());
        let decision = self.decisions[(self.asked - 1) % self.decisions.len()];
        Ok(GroupingDecision::of(decision))
    }

    fn learn(&mut self, _: Lesson<'_>, _: &mut ChaCha8Rng) -> Result<Learned, LearnerError> {
        self.asked += 1;
        Ok(Learned::default())
    }

    fn state(&self) -> serde_json::Value {
        self.asked.into()
    }

    fn restore(&mut self, state: &serde_json::Value, _: usize) -> Result<(), String> {
        let asked = state.as_u64().ok_or("expected a number of decisions")?;
        self.asked = usize::try_from(asked).map_err(|error| error.to_string())?;
        Ok(())
    }
}

#[test]
fn a_grouping_of_somebody_elses_decides_and_is_saved() {
    let mut env = Bars::new();
    let script = [Decision::New, Decision::Existing(0), Decision::Existing(1)];
    let mut covers = Covers::with_grouping(settings(), env.spec(), Scripted::new(&script)).unwrap();
    let turns = (0..4).map(|_| covers.learn(&mut env).unwrap());
    let turns: Vec<_> = turns.map(|turn| (turn.policy, turn.policy_created)).collect();
    assert_eq!(turns, [(0, false), (1, true), (0, false), (1, false)]);
    let path = std::env::temp_dir().join(format!("covers-script-{}", std::process::id()));
    covers.save(&path, CheckpointExtent::Everything, "").unwrap();
    // the settings name another grouping than the one that decided
    assert_refused(Covers::load(&path, env.spec()), "grouping");
    let other_script = Scripted::new(&[Decision::Existing(0)]);
    let (mut twin, _) = Covers::load_with_grouping(&path, env.spec(), other_script).unwrap();
    std::fs::remove_file(path).unwrap();
    assert_eq!(twin.learn(&mut env).unwrap().policy, 0);
}

#[test]
fn a_policy_that_a_grouping_made_up_is_refused() {
    let mut env = Bars::new();
    let script = Scripted::new(&[Decision::Existing(7)]);
    let mut covers = Covers::with_grouping(settings(), env.spec(), script).unwrap();
    covers.learn(&mut env).unwrap();
    assert_refused(covers.learn(&mut env), "`policy` is 7");
}

#[test]
fn a_copy_of_the_nearest_needs_distances() {
    let mut env = Bars::new();
    let settings = with(settings(), |s| s.new_policy = NewPolicyInit::Copy);
    let script = Scripted::new(&[Decision::New]);
    let mut covers = Covers::with_grouping(settings, env.spec(), script).unwrap();
    covers.learn(&mut env).unwrap();
    assert_refused(covers.learn(&mut env), "`new_policy` is copy");
}

#[test]
fn rollouts_that_end_before_an_episode_does_are_refused() {
    let mut env = Bars::new();
    env.spec.num_envs = 50;
    env.limited = true;
    let mut covers = Covers::new(settings(), env.spec()).unwrap();
    assert_refused(covers.learn(&mut env), "rollouts of 2 steps end before an episode of 5");
}

#[test]
fn an_iteration_logs_the_same_names_whatever_happens() {
    let (_, turns) = after(settings(), &[0, 1, 0]);
    let names = |turn: &Iteration| -> Vec<String> {
        turn.metrics.iter().map(|(name, _)| name.to_owned()).collect()
    };
    assert!(names(&turns[0]).contains(&"distances".to_owned()));
    for turn in &turns {
        assert_eq!(names(turn), names(&turns[0]));
    }
    let distances = |turn: &Iteration| turn.metrics.get("distances").unwrap().to_string();
    assert_eq!(distances(&turns[0]), "");
    assert_eq!(distances(&turns[2]).split(';').count(), 2);
}

#[test]
fn a_saved_learner_goes_on_alike() {
    let path = std::env::temp_dir().join(format!("covers-learner-{}", std::process::id()));
    let mut env = Bars::new();
    let mut covers = Covers::new(settings(), env.spec()).unwrap();
    covers.save(&path, CheckpointExtent::Everything, "fresh").unwrap();
    covers = Covers::load(&path, env.spec()).unwrap().0;
    env.teach(&mut covers, &[0, 1, 0]);
    covers.save(&path, CheckpointExtent::Everything, "a note").unwrap();
    let mut twin_env = env.clone();
    let (mut twin, note) = Covers::load(&path, env.spec()).unwrap();
    assert_eq!((note.as_str(), twin.policy_count()), ("a note", 2));
    let turns = env.teach(&mut covers, &[0, 1, 1]);
    let again = twin_env.teach(&mut twin, &[0, 1, 1]);
    for (turn, repeated) in turns.iter().zip(again) {
        assert_eq!(turn.metrics, repeated.metrics);
        assert_eq!(turn.evidence, repeated.evidence);
    }
    std::fs::remove_file(path).unwrap();
}

#[test]
fn covers_from_vectors_or_pictures_alone_goes_on_alike() {
    let path = std::env::temp_dir().join(format!("covers-alone-{}", std::process::id()));
    let settings = with(settings(), |s| s.grouping = GroupingSettings::Single);
    for mut env in Bars::half_blind() {
        let mut learner = Covers::new(settings.clone(), env.spec()).unwrap();
        env.teach(&mut learner, &[0, 1]);
        learner.save(&path, CheckpointExtent::Everything, "").unwrap();
        let (mut twin, _) = Covers::load(&path, env.spec()).unwrap();
        let mut twin_env = env.clone();
        env.teach(&mut learner, &[1]);
        twin_env.teach(&mut twin, &[1]);
        let bytes = |any: &Covers| {
            any.to_checkpoint_bytes(&path, CheckpointExtent::Everything, "").unwrap()
        };
        assert!(bytes(&learner) == bytes(&twin), "{:?}", env.spec);
    }
    std::fs::remove_file(path).unwrap();
}
