//! Learners under a grouping that tries policies, merges duplicates and cuts rollouts.

use std::path::Path;
use std::sync::{Arc, Mutex};

use cluster::{Assignment, Decision, Evidence, Verdict};
use learner::{
    Candidates, CheckpointExtent, Covers, CoversSettings, Grouping, GroupingDecision, Learned,
    Learner, LearnerError, Lesson, Needs, OffPolicy, OffPolicySettings, Query, Trial,
};
use rand_chacha::ChaCha8Rng;
use rl::{CriticSettings, PpoSettings, SacSettings, VectorEnv};

use crate::bars::{Bars, network, number};

/// Grouping that follows a script: its decisions on rollouts, in turn, and on trials.
#[derive(Clone, Default)]
struct Script {
    /// Episodes that a decision takes; 0 for one.
    needs: usize,
    decisions: Vec<Decision>,
    turns: usize,
    /// Answers to the first trials.
    trials: Vec<GroupingDecision>,
    /// Policies that are rejected in other trials.
    rejects: Vec<usize>,
    /// Changepoint of each rollout that is trained on.
    end: Option<usize>,
    /// Policies that serve one group, the first of which continues.
    twins: Option<(usize, usize)>,
    merged_into: Vec<Option<usize>>,
    /// `true` if the first look of a turn shows two groups, and if the second one does.
    cuts: [bool; 2],
    /// Decisions before the later group.
    cut_at: usize,
    /// Number of episodes that each policy kept at the last query.
    kept: Arc<Mutex<Vec<usize>>>,
    /// `true` if the first look of each turn is undecided.
    doubts: bool,
    /// `true` if that look of this turn has been.
    is_doubted: bool,
    /// `true` if existing policies are named provisionally.
    is_provisional: bool,
    /// `true` if whole episodes are needed.
    whole_episodes: bool,
    /// Number of whole episodes of each query and lesson.
    courses: Arc<Mutex<Vec<usize>>>,
}

impl Grouping for Script {
    fn needs(&self) -> Needs {
        Needs { episodes: self.needs.max(1), whole_episodes: self.whole_episodes }
    }

    fn assign(
        &mut self,
        query: Query<'_>,
        candidates: &mut dyn Candidates,
        _: &mut ChaCha8Rng,
    ) -> Result<GroupingDecision, LearnerError> {
        let episodes = candidates.episodes();
        let collector = episodes.collector;
        self.courses.lock().unwrap().push(episodes.courses.len());
        let with_trial = |decision| with_trial(decision, self.is_provisional);
        let decision = self.decisions[self.turns - 1];
        Ok(match query {
            Query::Rollout { can_wait } => {
                assert!(can_wait);
                let clouds = candidates.clouds()?;
                let kept = clouds.iter().map(|cloud| cloud.buffer.episodes());
                *self.kept.lock().unwrap() = kept.collect();
                let is_first = self.doubts && !std::mem::replace(&mut self.is_doubted, true);
                GroupingDecision {
                    cut: self.cuts[usize::from(!is_first)].then_some(self.cut_at),
                    ..with_trial(if is_first { Decision::Undecided } else { decision })
                }
            }
            Query::Trial { .. } if !self.trials.is_empty() => self.trials.remove(0),
            Query::Trial { earlier, .. } => {
                let mut rejected = earlier.rejected.clone();
                assert!(!rejected.contains(&collector), "{collector} was rejected");
                let stays = !self.rejects.contains(&collector);
                rejected.extend((!stays).then_some(collector));
                GroupingDecision {
                    cut: earlier.cut,
                    rejected,
                    ..with_trial(if stays { Decision::Existing(collector) } else { Decision::New })
                }
            }
            Query::Recognition => panic!("nothing is recognised"),
        })
    }

    fn learn(&mut self, lesson: Lesson<'_>, _: &mut ChaCha8Rng) -> Result<Learned, LearnerError> {
        let mut learned = Learned::default();
        match lesson {
            Lesson::Rollout { policy, episodes, .. } => {
                self.turns += 1;
                self.is_doubted = false;
                self.courses.lock().unwrap().push(episodes.courses.len());
                let twins = self.twins.filter(|&(_, gone)| policy == gone);
                learned.end = self.end;
                learned.probe = twins.map(|(kept, _)| kept);
            }
            Lesson::Probes { policy, probes } => {
                let (twin, _) = self.twins.unwrap();
                let collectors: Vec<usize> = probes.iter().map(|probe| probe.collector).collect();
                if let [collector] = collectors[..] {
                    assert_eq!(collector, twin, "asked by {policy}");
                    learned.probe = Some(policy);
                } else {
                    assert_eq!(collectors, [twin, policy]);
                    self.merged_into = vec![None, Some(twin)];
                }
            }
        }
        learned.merged_into = self.merged_into.clone();
        Ok(learned)
    }
}

/// A decision that demands a trial, also if the evidence speaks against the policy.
fn with_trial(decision: Decision, is_provisional: bool) -> GroupingDecision {
    let against = Evidence { distance: 1.0, test: None, verdict: Verdict::Rejected };
    let assignment = Assignment { decision, evidence: vec![against; 2] };
    GroupingDecision {
        trial: Trial::Episodes,
        is_provisional: is_provisional && matches!(decision, Decision::Existing(_)),
        ..assignment.into()
    }
}

fn bars() -> Bars {
    let mut env = Bars::new();
    env.limited = true;
    env
}

fn learner(script: Script) -> (Bars, Covers) {
    learner_of(100, script)
}

/// A learner whose rollouts take so many decisions.
fn learner_of(rollout_steps: usize, script: Script) -> (Bars, Covers) {
    let env = bars();
    let settings = CoversSettings {
        network: network(CriticSettings::Pooled { width: 8 }),
        ppo: PpoSettings { epochs: 1, minibatch: 20, ..PpoSettings::default() },
        rollout_steps,
        ..CoversSettings::default()
    };
    let covers = Covers::with_grouping(settings, env.spec(), Box::new(script)).unwrap();
    (env, covers)
}

/// The same by soft actor-critic.
fn off_policy(script: Script) -> (Bars, OffPolicy) {
    let env = bars();
    let method = OffPolicySettings::equi_sac();
    let settings = OffPolicySettings {
        network: network(CriticSettings::Joint { fields: 4 }),
        sac: SacSettings { burn_in: 1000, ..method.sac },
        still_channels: 0,
        rollout_steps: 100,
        ..method
    };
    let learner = OffPolicy::with_grouping(settings, env.spec(), Box::new(script)).unwrap();
    (env, learner)
}

/// Policies and decisions of so many turns.
fn turns(covers: &mut dyn Learner, env: &mut Bars, count: usize) -> Vec<(usize, usize)> {
    let turns = (0..count).map(|_| covers.learn(env).unwrap());
    turns.map(|turn| (turn.policy, turn.decisions)).collect()
}

/// A policy that is one of several acts for a round of 50 decisions before it acts for 100.
#[test]
fn a_policy_that_is_rejected_in_its_audition_costs_one_round() {
    let script = |rejects: &[usize]| Script {
        decisions: vec![Decision::New, Decision::Existing(0)],
        rejects: rejects.to_vec(),
        ..Script::default()
    };
    let (mut env, mut covers) = learner(script(&[]));
    assert_eq!(turns(&mut covers, &mut env, 3), [(0, 100), (1, 200), (0, 250)]);
    let (mut other_env, mut other_covers) = learner(script(&[0]));
    assert_eq!(turns(&mut other_covers, &mut other_env, 3), [(0, 100), (1, 200), (2, 250)]);
}

/// Opens policy 1, which serves the group of policy 0.
fn twins() -> Script {
    Script {
        decisions: vec![Decision::New, Decision::Existing(0)],
        twins: Some((0, 1)),
        merged_into: vec![None],
        ..Script::default()
    }
}

#[test]
fn of_twins_one_continues() {
    let (mut env, mut covers) = learner(twins());
    // policy 1 trains, both act for a round, and policy 0 collects the next rollout
    let expected = [(0, 100), (1, 300), (0, 100)];
    assert_eq!(turns(&mut covers, &mut env, 3), expected);
    // auditions last as long after a rollout that lost its end
    let (mut short_env, mut short_covers) = learner(Script { end: Some(50), ..twins() });
    assert_eq!(turns(&mut short_covers, &mut short_env, 3), expected);
}

/// Report and metrics of an iteration in which policies were merged.
#[test]
fn merges_are_seen() {
    let (mut env, mut covers) = learner(twins());
    let told = (0..3).map(|_| {
        let turn = covers.learn(&mut env).unwrap();
        let logged = turn.metrics.get("heirs").unwrap().to_string();
        (turn.merged_into.iter().flatten().count(), logged)
    });
    let merged = || (1, ";0".to_owned());
    let expected = [(0, String::new()), merged(), merged()];
    assert_eq!(told.collect::<Vec<_>>(), expected);
}

/// A replay takes what another policy collected, so that only twins cost decisions.
#[test]
fn twins_are_looked_for_whatever_trains_them() {
    let (mut env, mut learner) = off_policy(twins());
    let expected = [(0, 100), (1, 200), (0, 100)];
    assert_eq!(turns(&mut learner, &mut env, 3), expected);
}

/// Ten environments show twenty episodes in two rounds, which must be less than a rollout.
#[test]
fn auditions_last_as_long_as_a_decision_takes_or_do_not_take_place() {
    let script = Script { needs: 20, ..twins() };
    let (mut env, mut covers) = learner(script.clone());
    assert_eq!(turns(&mut covers, &mut env, 2), [(0, 100), (1, 200)]);
    let (mut long_env, mut long_covers) = learner_of(150, script);
    assert_eq!(turns(&mut long_covers, &mut long_env, 2), [(0, 150), (1, 500)]);
}

/// Decisions of three turns, and how many the replay holds that was trained on, where the first
/// policy continues after another one was created.
fn held(script: Script) -> Vec<(usize, usize)> {
    let (mut env, mut learner) =
        off_policy(Script { decisions: vec![Decision::New, Decision::Existing(0)], ..script });
    let turns = (0..3).map(|_| learner.learn(&mut env).unwrap());
    let held = turns.map(|turn| (turn.decisions, number(&turn, "replay") as usize));
    held.collect()
}

/// A replay holds what its policy collected after a rollout of two groups, and nothing of that one.
#[test]
fn no_replay_takes_a_rollout_of_two_groups() {
    let cut = |cuts| held(Script { cuts, ..Script::default() });
    assert_eq!(cut([false; 2]), [(100, 100), (100, 100), (100, 200)]);
    assert_eq!(cut([true; 2]), [(100, 100), (200, 100), (250, 200)]);
}

/// No replay takes a rollout that was left undecided, nor one of two groups.
#[test]
fn no_replay_takes_what_was_undecided_or_cut_off() {
    let cut = |cuts| held(Script { cuts, doubts: true, ..Script::default() });
    assert_eq!(cut([false; 2]), [(100, 100), (200, 100), (200, 200)]);
    assert_eq!(cut([true, false]), [(100, 100), (200, 100), (200, 200)]);
    assert_eq!(cut([false, true]), [(100, 100), (300, 100), (350, 200)]);
}

/// A rollout shows episodes that begin after 0 and 50 decisions, ten each time.
#[test]
fn a_policy_keeps_no_frames_of_the_group_before() {
    let kept = |cut_at| {
        let script = Script {
            decisions: vec![Decision::New, Decision::Existing(1)],
            cuts: [false, true],
            cut_at,
            doubts: true,
            ..Script::default()
        };
        let kept = Arc::clone(&script.kept);
        let (mut env, mut covers) = learner(script);
        turns(&mut covers, &mut env, 3);
        kept.lock().unwrap().clone()
    };
    assert_eq!([0, 50].map(kept), [[20, 20], [20, 10]]);
}

/// Merged policies, for example, are named provisionally.
#[test]
fn a_provisional_policy_acts_before_it_trains_where_rollouts_are_reused() {
    let tried = |rejects: &[usize]| {
        held(Script { is_provisional: true, rejects: rejects.to_vec(), ..Script::default() })
    };
    assert_eq!(tried(&[]), [(100, 100), (100, 100), (250, 300)]);
    assert_eq!(tried(&[0]), [(100, 100), (100, 100), (250, 200)]);
}

/// Answer to a trial in which the group has changed.
fn changed(decision: Decision, trial: Trial) -> GroupingDecision {
    GroupingDecision { group_changed: true, trial, ..with_trial(decision, false) }
}

/// Policy 0 passes its audition, and its rollout, or already the audition, shows that the group has
/// changed. The rollouts before are of the earlier group.
#[test]
fn no_replay_takes_rollouts_of_an_earlier_group() {
    let tried = |trials: &[GroupingDecision]| {
        let script = Script { is_provisional: true, trials: trials.to_vec(), ..Script::default() };
        held(script)[2]
    };
    let passes = with_trial(Decision::Existing(0), true);
    for named in [Decision::New, Decision::Existing(1)] {
        // policy 1 has 100 decisions of its own
        let own = if named == Decision::New { 0 } else { 100 };
        let moved = changed(named, Trial::Rollout);
        assert_eq!(tried(std::slice::from_ref(&moved)), (250, own + 100));
        assert_eq!(tried(&[passes.clone(), moved]), (350, own + 100));
    }
}

/// The group has become that of policy 1 again. It trains on the rollout of policy 0, but not on a
/// few episodes: it collects its own rollout then, which is reviewed.
#[test]
fn a_waived_trial_saves_a_rollout_unless_a_few_episodes_showed_the_change() {
    let passes = with_trial(Decision::Existing(0), false);
    let waived = changed(Decision::Existing(1), Trial::Waived);
    let back = changed(Decision::Existing(0), Trial::Waived);
    let created = with_trial(Decision::Existing(1), false);
    for (third_turn, expected) in [
        (vec![passes, waived.clone()], (1, 250)),
        (vec![waived.clone()], (1, 250)),
        (vec![waived, back], (0, 250)),
    ] {
        let (mut env, mut covers) = learner(Script {
            decisions: vec![Decision::New, Decision::Existing(0)],
            trials: [vec![created.clone()], third_turn].concat(),
            ..Script::default()
        });
        assert_eq!(turns(&mut covers, &mut env, 3)[2], expected);
    }
}

/// Ten environments show twenty episodes in a rollout of 100 decisions.
#[test]
fn whole_episodes_are_collected_for_groupings_that_ask() {
    let shown = |whole_episodes| {
        let script =
            Script { decisions: vec![Decision::Existing(0)], whole_episodes, ..Script::default() };
        let courses = Arc::clone(&script.courses);
        let (mut env, mut covers) = learner(script);
        turns(&mut covers, &mut env, 2);
        courses.lock().unwrap().clone()
    };
    // the first rollout of all is trained on without a decision
    assert_eq!(shown(true), [20; 3]);
    assert_eq!(shown(false), [0; 3]);
}

/// The first half of a rollout is trained on where the second shows another group.
#[test]
fn no_policy_trains_on_steps_after_a_changepoint() {
    let trained = |end| {
        let (mut env, mut covers) =
            learner(Script { decisions: vec![Decision::Existing(0); 2], end, ..Script::default() });
        turns(&mut covers, &mut env, 2);
        covers.to_checkpoint_bytes(Path::new("none"), CheckpointExtent::Everything, "").unwrap()
    };
    assert_eq!(trained(None), trained(Some(100)));
    assert_ne!(trained(None), trained(Some(50)));
}
