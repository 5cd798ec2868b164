//! Learners under a grouping that tries policies, merges duplicates and finds changepoints.

use std::path::Path;
use std::sync::{Arc, Mutex};

use cluster::{AssignedPolicy, PolicyAssignment, PolicyEvidence, PolicyVerdict};
use evidence::Trajectory;
use learner::{
    AssignmentData, AssignmentPurpose, CheckpointExtent, CoversLearner, CoversSettings,
    EpisodeRequirements, Grouping, GroupingDecision, GroupingUpdateInput, GroupingUpdateResult,
    Learner, LearnerError, OffPolicyLearner, OffPolicySettings, RequiredTrial,
};
use rand_chacha::ChaCha8Rng;
use rl::{CriticSettings, SacSettings, VectorEnv};

use crate::bars::{Bars, assert_refused, covers_settings, network, number, scratch};

/// Grouping that follows a script: its decisions on rollouts, one for each iteration, and on
/// trials.
#[derive(Clone, Default)]
struct Script {
    /// Episodes that a decision needs; 0 for one.
    episodes: usize,
    decisions: Vec<AssignedPolicy>,
    iterations: usize,
    /// Decisions on the first trials.
    trials: Vec<GroupingDecision>,
    /// Policies that are rejected in other trials.
    rejects: Vec<usize>,
    /// Changepoint of each rollout that is trained on.
    end: Option<usize>,
    /// Policies that serve one group, the first of which continues.
    duplicates: Option<(usize, usize)>,
    merged_into: Vec<Option<usize>>,
    /// `true` if the first rollout of an iteration shows two groups, and if the second one does.
    changes: [bool; 2],
    /// Decisions before the later group.
    changepoint: usize,
    /// Number of episodes that each policy kept at the last request.
    kept: Arc<Mutex<Vec<usize>>>,
    /// `true` if the first rollout of each iteration is left undecided.
    doubts: bool,
    /// `true` if that of this iteration has been.
    is_doubted: bool,
    /// `true` if existing policies are named provisionally.
    is_provisional: bool,
    whole_episodes: bool,
    /// Policy that collects each rollout, if the grouping chooses one.
    collector: Option<usize>,
    /// Number of whole episodes of each request and update.
    trajectories: Arc<Mutex<Vec<usize>>>,
}

impl Grouping for Script {
    fn requirements(&self) -> EpisodeRequirements {
        let (episodes, whole_episodes) = (self.episodes.max(1), self.whole_episodes);
        let chooses_collector = self.collector.is_some();
        EpisodeRequirements { episodes, whole_episodes, chooses_collector }
    }

    fn assign(
        &mut self,
        request: AssignmentPurpose<'_>,
        data: &mut dyn AssignmentData,
        _: &mut ChaCha8Rng,
    ) -> Result<GroupingDecision, LearnerError> {
        let episodes = data.episodes();
        let collector = episodes.collector;
        self.trajectories.lock().unwrap().push(episodes.trajectories.len());
        let with_trial = |decision| with_trial(decision, self.is_provisional);
        let decision = self.decisions[self.iterations - 1];
        Ok(match request {
            AssignmentPurpose::Assign { allow_undecided, .. } => {
                assert!(allow_undecided);
                let clouds = data.clouds()?;
                let kept = clouds.iter().map(|cloud| cloud.buffer.num_episodes());
                *self.kept.lock().unwrap() = kept.collect();
                let is_first = self.doubts && !std::mem::replace(&mut self.is_doubted, true);
                let changes = self.changes[usize::from(!is_first)];
                GroupingDecision {
                    changepoint: changes.then_some(self.changepoint),
                    ..with_trial(if is_first { AssignedPolicy::Undecided } else { decision })
                }
            }
            AssignmentPurpose::Confirm { .. } if !self.trials.is_empty() => self.trials.remove(0),
            AssignmentPurpose::Confirm { proposal, .. } => {
                let mut rejected = proposal.rejected.clone();
                assert!(!rejected.contains(&collector), "{collector} was rejected");
                let stays = !self.rejects.contains(&collector);
                rejected.extend((!stays).then_some(collector));
                GroupingDecision {
                    changepoint: proposal.changepoint,
                    rejected,
                    ..with_trial(if stays {
                        AssignedPolicy::Existing(collector)
                    } else {
                        AssignedPolicy::New
                    })
                }
            }
            AssignmentPurpose::Collect => {
                let begins = |t: &Trajectory| !t.image.is_empty() && t.rewards.is_empty();
                assert!(episodes.trajectories.iter().all(begins));
                let chosen = self.collector.unwrap_or(collector);
                GroupingDecision::for_policy(AssignedPolicy::Existing(chosen))
            }
            AssignmentPurpose::Recognise => panic!("nothing is recognised"),
        })
    }

    fn update(
        &mut self,
        assigned: GroupingUpdateInput<'_>,
        _: &mut ChaCha8Rng,
    ) -> Result<GroupingUpdateResult, LearnerError> {
        let mut update = GroupingUpdateResult::default();
        match assigned {
            GroupingUpdateInput::Rollout { policy, episodes, .. } => {
                self.iterations += 1;
                self.is_doubted = false;
                self.trajectories.lock().unwrap().push(episodes.trajectories.len());
                let duplicates = self.duplicates.filter(|&(_, gone)| policy == gone);
                update.changepoint = self.end;
                update.probe = duplicates.map(|(kept, _)| kept);
            }
            GroupingUpdateInput::Probes { policy, probes } => {
                let (kept, _) = self.duplicates.unwrap();
                let collectors: Vec<usize> = probes.iter().map(|probe| probe.collector).collect();
                if let [collector] = collectors[..] {
                    assert_eq!(collector, kept, "asked by {policy}");
                    update.probe = Some(policy);
                } else {
                    assert_eq!(collectors, [kept, policy]);
                    self.merged_into = vec![None, Some(kept)];
                }
            }
        }
        update.merged_into = self.merged_into.clone();
        Ok(update)
    }

    fn state(&self) -> serde_json::Value {
        self.iterations.into()
    }

    fn restore(&mut self, state: &serde_json::Value, _: usize) -> Result<(), String> {
        let iterations = state.as_u64().ok_or("expected a number of iterations")?;
        self.iterations = usize::try_from(iterations).map_err(|error| error.to_string())?;
        Ok(())
    }
}

/// A decision that demands a trial, also if there is evidence against the policy.
fn with_trial(decision: AssignedPolicy, is_provisional: bool) -> GroupingDecision {
    let against = PolicyEvidence { distance: 1.0, test: None, verdict: PolicyVerdict::Rejected };
    let assignment = PolicyAssignment { decision, evidence: vec![against; 2] };
    GroupingDecision {
        trial: RequiredTrial::Episodes,
        is_provisional: is_provisional && matches!(decision, AssignedPolicy::Existing(_)),
        ..assignment.into()
    }
}

/// Script in which policy 1 is created, and policy 0 continues.
fn create_and_return(script: Script) -> Script {
    Script { decisions: vec![AssignedPolicy::New, AssignedPolicy::Existing(0)], ..script }
}

fn bars() -> Bars {
    let mut env = Bars::new();
    env.limited = true;
    env
}

fn learner(script: Script) -> (Bars, CoversLearner) {
    learner_of(100, script)
}

/// A learner whose rollouts have so many decisions.
fn learner_of(rollout_steps: usize, script: Script) -> (Bars, CoversLearner) {
    let env = bars();
    let settings = CoversSettings { rollout_steps, ..covers_settings() };
    let covers = CoversLearner::with_grouping(settings, env.spec(), Box::new(script)).unwrap();
    (env, covers)
}

/// A learner that trains by soft actor-critic.
fn off_policy(script: Script) -> (Bars, OffPolicyLearner) {
    let env = bars();
    let method = OffPolicySettings::equi_sac();
    let settings = OffPolicySettings {
        network: network(CriticSettings::Joint { fields: 4 }),
        sac: SacSettings { burn_in: 1000, ..method.sac },
        still_channels: 0,
        rollout_steps: 100,
        ..method
    };
    let learner = OffPolicyLearner::with_grouping(settings, env.spec(), Box::new(script)).unwrap();
    (env, learner)
}

/// Policies and decisions of so many iterations.
fn run((mut env, mut learner): (Bars, impl Learner), count: usize) -> Vec<(usize, usize)> {
    let iterations = (0..count).map(|_| learner.learn(&mut env).unwrap());
    iterations.map(|iteration| (iteration.policy, iteration.decisions)).collect()
}

/// A policy that is one of several acts for a round of 50 decisions before it acts for 100.
#[test]
fn a_policy_that_is_rejected_after_a_few_episodes_costs_one_round() {
    for (rejects, last) in [(vec![], (0, 250)), (vec![0], (2, 250))] {
        let script = create_and_return(Script { rejects, ..Script::default() });
        assert_eq!(run(learner(script), 3), [(0, 100), (1, 200), last]);
    }
}

/// Policy 1 is created, and serves the group of policy 0.
fn duplicates() -> Script {
    let merged_into = vec![None];
    create_and_return(Script { duplicates: Some((0, 1)), merged_into, ..Script::default() })
}

/// Policy 1 trains, both act for a round, and policy 0 collects the next rollout.
#[test]
fn of_two_duplicates_one_continues() {
    let expected = [(0, 100), (1, 300), (0, 100)];
    assert_eq!(run(learner(duplicates()), 3), expected);
    // probes last as long after a rollout that lost its end
    assert_eq!(run(learner(Script { end: Some(50), ..duplicates() }), 3), expected);
    // a replay takes what another policy collected, so that only probes cost decisions
    assert_eq!(run(off_policy(duplicates()), 3), [(0, 100), (1, 200), (0, 100)]);
    // ten environments show twenty episodes in two rounds, which must be less than a rollout
    let script = Script { episodes: 20, ..duplicates() };
    assert_eq!(run(learner(script.clone()), 2), [(0, 100), (1, 200)]);
    assert_eq!(run(learner_of(150, script), 2), [(0, 150), (1, 500)]);
}

/// Report and metrics of an iteration in which policies were merged.
#[test]
fn merges_are_reported() {
    let (mut env, mut covers) = learner(duplicates());
    let reported = (0..3).map(|_| {
        let iteration = covers.learn(&mut env).unwrap();
        let logged = iteration.metrics.metric("heirs").unwrap().to_string();
        (iteration.merged_into.iter().flatten().count(), logged)
    });
    let merged = || (1, ";0".to_owned());
    assert_eq!(reported.collect::<Vec<_>>(), [(0, String::new()), merged(), merged()]);
}

/// Decisions of three iterations, and how many the replay holds that was trained on, where the
/// first policy continues after another one was created.
fn replayed(script: Script) -> Vec<(usize, usize)> {
    let (mut env, mut learner) = off_policy(create_and_return(script));
    let iterations = (0..3).map(|_| learner.learn(&mut env).unwrap());
    let replayed = iterations.map(|one| (one.decisions, number(&one, "replay") as usize));
    replayed.collect()
}

/// A replay holds what its policy collected after a rollout of two groups, and nothing of that one,
/// nor of one that was left undecided. A provisional policy, such as a merged one, acts before it
/// trains.
#[test]
fn no_replay_takes_a_rollout_that_is_undecided_or_of_two_groups() {
    let with = |changes, doubts| Script { changes, doubts, ..Script::default() };
    let tried = |rejects: &[usize]| Script {
        is_provisional: true,
        rejects: rejects.to_vec(),
        ..Script::default()
    };
    for (script, expected) in [
        (with([false; 2], false), [(100, 100), (100, 100), (100, 200)]),
        (with([true; 2], false), [(100, 100), (200, 100), (250, 200)]),
        (with([false; 2], true), [(100, 100), (200, 100), (200, 200)]),
        (with([true, false], true), [(100, 100), (200, 100), (200, 200)]),
        (with([false, true], true), [(100, 100), (300, 100), (350, 200)]),
        (tried(&[]), [(100, 100), (100, 100), (250, 300)]),
        (tried(&[0]), [(100, 100), (100, 100), (250, 200)]),
    ] {
        assert_eq!(replayed(script), expected);
    }
}

/// A rollout shows episodes that begin after 0 and 50 decisions, ten each time.
#[test]
fn a_policy_keeps_no_frames_of_the_group_before() {
    let kept = |changepoint| {
        let script = Script {
            decisions: vec![AssignedPolicy::New, AssignedPolicy::Existing(1)],
            changes: [false, true],
            changepoint,
            doubts: true,
            ..Script::default()
        };
        let kept = Arc::clone(&script.kept);
        run(learner(script), 3);
        kept.lock().unwrap().clone()
    };
    assert_eq!([0, 50].map(kept), [[20, 20], [20, 10]]);
}

/// Decision on a trial in which the group has changed.
fn changed(decision: AssignedPolicy, trial: RequiredTrial) -> GroupingDecision {
    GroupingDecision { group_changed: true, trial, ..with_trial(decision, false) }
}

/// Policy 0 passes its first episodes, and its rollout, or already these episodes, show that the
/// group has changed. The rollouts before are of the earlier group.
#[test]
fn no_replay_takes_rollouts_of_an_earlier_group() {
    let tried = |trials: &[GroupingDecision]| {
        let script = Script { is_provisional: true, trials: trials.to_vec(), ..Script::default() };
        replayed(script)[2]
    };
    let passes = with_trial(AssignedPolicy::Existing(0), true);
    for named in [AssignedPolicy::New, AssignedPolicy::Existing(1)] {
        // policy 1 has 100 decisions of its own
        let own = if named == AssignedPolicy::New { 0 } else { 100 };
        let moved = changed(named, RequiredTrial::Rollout);
        assert_eq!(tried(std::slice::from_ref(&moved)), (250, own + 100));
        assert_eq!(tried(&[passes.clone(), moved]), (350, own + 100));
    }
    // the group has become that of policy 0 itself, which has 100 decisions of its own
    let stays = changed(AssignedPolicy::Existing(0), RequiredTrial::Rollout);
    assert_eq!(tried(std::slice::from_ref(&passes)), (250, 300));
    assert_eq!(tried(std::slice::from_ref(&stays)), (250, 200));
    assert_eq!(tried(&[passes, stays.clone()]), (250, 200));
    // its rollout does not confirm this, and policy 1 takes both rollouts since the change
    let moves = with_trial(AssignedPolicy::Existing(1), false);
    assert_eq!(tried(&[stays, moves]), (400, 300));
}

/// The group has become that of policy 1 again. It trains on the rollout of policy 0, but not on a
/// few episodes: it collects its own rollout then, which is reviewed.
#[test]
fn a_waived_trial_saves_a_rollout_unless_a_few_episodes_showed_the_change() {
    let passes = with_trial(AssignedPolicy::Existing(0), false);
    let waived = changed(AssignedPolicy::Existing(1), RequiredTrial::Waived);
    let back = changed(AssignedPolicy::Existing(0), RequiredTrial::Waived);
    let created = with_trial(AssignedPolicy::Existing(1), false);
    for (third, expected) in [
        (vec![passes, waived.clone()], (1, 250)),
        (vec![waived.clone()], (1, 250)),
        (vec![waived, back], (0, 250)),
    ] {
        let trials = [vec![created.clone()], third].concat();
        let script = create_and_return(Script { trials, ..Script::default() });
        assert_eq!(run(learner(script), 3)[2], expected);
    }
}

/// Ten environments show twenty episodes in a rollout of 100 decisions.
#[test]
fn whole_episodes_are_collected_for_groupings_that_ask() {
    // the first rollout of all is trained on without a decision
    for (whole_episodes, expected) in [(true, [20; 3]), (false, [0; 3])] {
        let script = Script {
            decisions: vec![AssignedPolicy::Existing(0)],
            whole_episodes,
            ..Script::default()
        };
        let trajectories = Arc::clone(&script.trajectories);
        run(learner(script), 2);
        assert_eq!(*trajectories.lock().unwrap(), expected);
    }
}

/// Policy 1 is created and then replaced by policy 0, whose rollout needs no other: without a
/// choice, policy 1 collects one and policy 0 another one.
#[test]
fn a_policy_that_the_grouping_chooses_collects_the_rollout() {
    for (collector, decisions) in [(None, 250), (Some(0), 100)] {
        let script = create_and_return(Script { collector, ..Script::default() });
        let trajectories = Arc::clone(&script.trajectories);
        assert_eq!(run(learner(script), 3), [(0, 100), (1, 200), (0, decisions)]);
        // the beginnings of ten episodes before the third rollout, when there are two policies
        let beginnings = trajectories.lock().unwrap().iter().filter(|count| **count == 10).count();
        assert_eq!(beginnings, usize::from(collector.is_some()));
    }
    // a policy that does not exist is refused
    let script = create_and_return(Script { collector: Some(7), ..Script::default() });
    let (mut env, mut covers) = learner(script);
    env.train(&mut covers, &[0, 0]);
    assert_refused(covers.learn(&mut env), "`policy` is 7");
}

/// Each trial of an iteration shows another group. Sixteen may end so; then a rollout is trained on.
#[test]
fn trials_end_where_the_group_changes_with_each() {
    let named =
        [1, 0].map(|policy| changed(AssignedPolicy::Existing(policy), RequiredTrial::Episodes));
    let created = with_trial(AssignedPolicy::Existing(1), false);
    let trials = [vec![created], [named.as_slice(); 20].concat()].concat();
    let script = create_and_return(Script { trials, ..Script::default() });
    assert_eq!(run(learner(script), 3)[2], (0, 100 + 16 * 50 + 100));
}

/// The first half of a rollout is trained on where the second shows another group.
#[test]
fn no_policy_trains_on_steps_after_a_changepoint() {
    let trained = |end| {
        let decisions = vec![AssignedPolicy::Existing(0); 2];
        let (mut env, mut covers) = learner(Script { decisions, end, ..Script::default() });
        env.train(&mut covers, &[0, 0]);
        covers.to_checkpoint_bytes(Path::new("none"), CheckpointExtent::Everything, "").unwrap()
    };
    assert_eq!(trained(None), trained(Some(100)));
    assert_ne!(trained(None), trained(Some(50)));
}

#[test]
fn a_grouping_from_outside_decides_and_is_saved() {
    let decisions =
        vec![AssignedPolicy::New, AssignedPolicy::Existing(0), AssignedPolicy::Existing(1)];
    let (mut env, mut covers) = learner(Script { decisions, ..Script::default() });
    let iterations = (0..4).map(|_| covers.learn(&mut env).unwrap());
    let iterations: Vec<_> = iterations.map(|one| (one.policy, one.policy_created)).collect();
    assert_eq!(iterations, [(0, false), (1, true), (0, false), (1, false)]);
    let path = scratch("script");
    covers.save(&path, CheckpointExtent::Everything, "").unwrap();
    // the settings name another grouping than the one that decided
    assert_refused(CoversLearner::load(&path, env.spec()), "grouping");
    // a policy that does not exist is refused
    let others = [vec![AssignedPolicy::Existing(0); 4], vec![AssignedPolicy::Existing(7)]].concat();
    let other = Box::new(Script { decisions: others, ..Script::default() });
    let (mut copy, _) = CoversLearner::load_with_grouping(&path, env.spec(), other).unwrap();
    std::fs::remove_file(path).unwrap();
    assert_eq!(copy.learn(&mut env).unwrap().policy, 0);
    assert_refused(copy.learn(&mut env), "`policy` is 7");
}
