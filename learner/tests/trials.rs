//! Learners under a grouping that tries policies, finds twins and cuts rollouts.

use std::path::Path;
use std::sync::{Arc, Mutex};

use cluster::{Assignment, Decision, Evidence, Judgement, Verdict};
use learner::{
    Candidates, CheckpointExtent, Covers, CoversSettings, Grouping, GroupingDecision, Learned,
    Learner, LearnerError, Lesson, Needs, OffPolicy, OffPolicySettings, Query, Trial,
};
use rand_chacha::ChaCha8Rng;
use rl::{CriticSettings, PpoSettings, SacSettings, VectorEnv};

use crate::bars::{Bars, network, number};

/// Follows a script: what is said of each rollout, in turn, and of each policy that is heard.
#[derive(Clone, Default)]
struct Script {
    /// Episodes that a decision takes; 0 for one.
    needs: usize,
    decisions: Vec<Decision>,
    turns: usize,
    /// Policies that are refused once they acted.
    refuses: Vec<usize>,
    /// Decisions of each rollout that may be learnt from.
    learns: Option<usize>,
    /// Policies that serve one group, the first of which goes on.
    twins: Option<(usize, usize)>,
    merged_into: Vec<Option<usize>>,
    /// Which looks of a turn show two groups: the first one, the second one.
    cuts: [bool; 2],
    /// Decisions before the later group.
    cut_at: usize,
    /// Episodes that each policy kept when it was asked last.
    kept: Arc<Mutex<Vec<usize>>>,
    /// `true` if the first look of each turn is undecided.
    doubts: bool,
    /// `true` if that look of this turn has been.
    is_doubted: bool,
    /// Whether looks speak against the policies that are named.
    is_provisional: bool,
    /// Whether whole episodes are asked for.
    whole_episodes: bool,
    /// Whole episodes of each look and lesson.
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
        let said = |decision| said(decision, self.is_provisional);
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
                    ..said(if is_first { Decision::Undecided } else { decision })
                }
            }
            Query::Trial { earlier, .. } => {
                let mut rejected = earlier.rejected.clone();
                assert!(!rejected.contains(&collector), "{collector} was rejected");
                let stays = !self.refuses.contains(&collector);
                rejected.extend((!stays).then_some(collector));
                GroupingDecision {
                    cut: earlier.cut,
                    rejected,
                    ..said(if stays { Decision::Existing(collector) } else { Decision::New })
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
                learned.end = self.learns;
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

/// A decision that demands a trial; what speaks against a policy does not put it out of question.
fn said(decision: Decision, is_provisional: bool) -> GroupingDecision {
    let against = Evidence {
        distance: 1.0,
        judgement: Judgement::Threshold { limit: 0.0 },
        verdict: Verdict::Rejected,
    };
    let assignment = Assignment { decision, evidence: vec![against; 2] };
    GroupingDecision {
        trial: Trial::Episodes,
        provisional: is_provisional && matches!(decision, Decision::Existing(_)),
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
fn a_policy_that_is_refused_when_it_is_heard_costs_one_round() {
    let script = |refuses: &[usize]| Script {
        decisions: vec![Decision::New, Decision::Existing(0)],
        refuses: refuses.to_vec(),
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
fn of_twins_one_goes_on() {
    let (mut env, mut covers) = learner(twins());
    // policy 1 learns, both act for a round, and policy 0 collects the next rollout
    let expected = [(0, 100), (1, 300), (0, 100)];
    assert_eq!(turns(&mut covers, &mut env, 3), expected);
    // a rollout that lost its end says nothing of how long policies may be heard
    let (mut short_env, mut short_covers) = learner(Script { learns: Some(50), ..twins() });
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
fn policies_are_heard_as_long_as_a_decision_takes_or_not_at_all() {
    let script = Script { needs: 20, ..twins() };
    let (mut env, mut covers) = learner(script.clone());
    assert_eq!(turns(&mut covers, &mut env, 2), [(0, 100), (1, 200)]);
    let (mut long_env, mut long_covers) = learner_of(150, script);
    assert_eq!(turns(&mut long_covers, &mut long_env, 2), [(0, 150), (1, 500)]);
}

/// Decisions of three turns, and how many the replay holds that learnt, where the first policy goes
/// on after another one was opened.
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

/// One that looks speak against, as they do against all that have heirs, is heard whatever becomes
/// of rollouts that change hands.
#[test]
fn who_is_named_against_the_looks_is_heard_where_rollouts_are_reused() {
    let heard = |refuses: &[usize]| {
        held(Script { is_provisional: true, refuses: refuses.to_vec(), ..Script::default() })
    };
    assert_eq!(heard(&[]), [(100, 100), (100, 100), (250, 300)]);
    assert_eq!(heard(&[0]), [(100, 100), (100, 100), (250, 200)]);
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
    // the first rollout of all is learnt from without a decision
    assert_eq!(shown(true), [20; 3]);
    assert_eq!(shown(false), [0; 3]);
}

/// The first half of a rollout is learnt from where the second shows another group.
#[test]
fn what_shows_another_group_is_not_learnt_from() {
    let learnt = |learns| {
        let (mut env, mut covers) = learner(Script {
            decisions: vec![Decision::Existing(0); 2],
            learns,
            ..Script::default()
        });
        turns(&mut covers, &mut env, 2);
        covers.to_checkpoint_bytes(Path::new("none"), CheckpointExtent::Everything, "").unwrap()
    };
    assert_eq!(learnt(None), learnt(Some(100)));
    assert_ne!(learnt(None), learnt(Some(50)));
}
