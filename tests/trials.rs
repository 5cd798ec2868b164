//! What a grouping that hears policies, finds twins and cuts rollouts makes the learner do.

#[allow(
    dead_code,
    reason = "what teaches by groups and reads metrics is for other tests"
)]
use std::path::Path;

use cluster::{Assignment, Decision};
use covers::{
    Candidates, Covers, CoversError, CoversSettings, Episodes, Extent, Grouping, Learner,
};
use evidence::Merge;
use rand_chacha::ChaCha8Rng;
use rl::{Critic, PpoSettings, VectorEnv};

use crate::common::bars::{Bars, network};

/// Follows a script: what is said of each rollout, in turn, and of each policy that is heard.
#[derive(Default)]
struct Script {
    decisions: Vec<Decision>,
    turns: usize,
    /// Policies that are refused once they acted.
    refuses: Vec<usize>,
    /// Decisions of each rollout that may be learnt from.
    learns: Option<usize>,
    /// Policies that serve one group, the first of which goes on.
    twins: Option<(usize, usize)>,
}

impl Grouping for Script {
    fn min_episodes(&self) -> usize {
        1
    }

    fn assign(
        &self,
        _: &mut dyn Candidates,
        _: &mut ChaCha8Rng,
    ) -> Result<Assignment, CoversError> {
        Ok(Assignment {
            decision: self.decisions[self.turns - 1],
            evidence: Vec::new(),
        })
    }

    fn review(
        &self,
        candidates: &mut dyn Candidates,
        refused: &mut Vec<usize>,
        _: &mut ChaCha8Rng,
    ) -> Result<Option<Assignment>, CoversError> {
        let collector = candidates.episodes().collector;
        let is_refused = self.refuses.contains(&collector);
        refused.push(collector);
        Ok(is_refused.then_some(Assignment {
            decision: Decision::New,
            evidence: Vec::new(),
        }))
    }

    fn is_contested(&self) -> bool {
        true
    }

    fn remember(
        &mut self,
        _: usize,
        _: Episodes<'_>,
        _: &mut ChaCha8Rng,
    ) -> Result<Option<usize>, CoversError> {
        self.turns += 1;
        Ok(self.learns)
    }

    fn twin(&self, index: usize) -> Option<usize> {
        let (kept, gone) = self.twins?;
        (index == gone).then_some(kept)
    }

    fn compare(
        &mut self,
        index: usize,
        twin: usize,
        episodes: Episodes<'_>,
        _: &mut ChaCha8Rng,
    ) -> Result<bool, CoversError> {
        assert_eq!(episodes.collector, twin, "asked by {index}");
        Ok(true)
    }

    fn merge(
        &mut self,
        index: usize,
        twin: usize,
        episodes: Episodes<'_>,
        _: &mut ChaCha8Rng,
    ) -> Result<Option<Merge>, CoversError> {
        assert_eq!(episodes.collector, index);
        Ok(Some(Merge {
            kept: twin,
            gone: index,
        }))
    }
}

fn learner(script: Script) -> (Bars, Covers) {
    let mut env = Bars::new();
    env.limited = true;
    let settings = CoversSettings {
        network: network(Critic::Pooled { width: 8 }),
        ppo: PpoSettings {
            epochs: 1,
            minibatch: 20,
            ..PpoSettings::default()
        },
        rollout_steps: 100,
        ..CoversSettings::default()
    };
    let covers = Covers::with_grouping(settings, env.spec(), Box::new(script)).unwrap();
    (env, covers)
}

/// Policies and decisions of so many turns.
fn turns(covers: &mut Covers, env: &mut Bars, count: usize) -> Vec<(usize, usize)> {
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
    assert_eq!(
        turns(&mut covers, &mut env, 3),
        [(0, 100), (1, 200), (0, 250)]
    );
    let (mut env, mut covers) = learner(script(&[0]));
    assert_eq!(
        turns(&mut covers, &mut env, 3),
        [(0, 100), (1, 200), (2, 250)]
    );
}

#[test]
fn of_twins_one_goes_on() {
    let (mut env, mut covers) = learner(Script {
        decisions: vec![Decision::New, Decision::Existing(0)],
        twins: Some((0, 1)),
        ..Script::default()
    });
    // policy 1 learns, both act for a round, and policy 0 collects the next rollout
    let expected = [(0, 100), (1, 300), (0, 100)];
    assert_eq!(turns(&mut covers, &mut env, 3), expected);
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
        covers
            .encode(Path::new("none"), Extent::Everything, "")
            .unwrap()
    };
    assert_eq!(learnt(None), learnt(Some(100)));
    assert_ne!(learnt(None), learnt(Some(50)));
}
