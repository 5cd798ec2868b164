//! An actor with a memory: collection and evaluation forget an episode when it ends, and never
//! before.

use proptest::prelude::*;
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rl::{
    Actor, ActorMemory, OnPolicyActor, ReplayBuffer, ReplaySettings, RolloutState, VectorEnv,
    collect_experience, evaluate_policy,
};

use crate::common::actors::{Ages, BlindActor};
use crate::common::steps::OnPolicyRun;

/// Reaction of a counter's memory to the end of an episode.
#[derive(Clone, Copy)]
enum Forgets {
    ThisOne,
    Nothing,
    TheFirst,
    Everything,
}

/// The steps of each running episode.
struct Counts {
    steps: Vec<u8>,
    forgets: Forgets,
}

impl ActorMemory for Counts {
    fn forget_episode(&mut self, env: usize) {
        match self.forgets {
            Forgets::ThisOne => self.steps[env] = 0,
            Forgets::Nothing => {}
            Forgets::TheFirst => self.steps[0] = 0,
            Forgets::Everything => self.steps.fill(0),
        }
    }
}

/// Counts the steps of each running episode: the smallest recurrent actor there is.
fn counter(forgets: Forgets) -> impl OnPolicyActor<Memory = Counts> {
    BlindActor {
        new_memory: move |envs| Counts { steps: vec![0; envs], forgets },
        decide: |memory: &mut Counts, out: &mut [f32]| {
            for (action, steps) in out.iter_mut().zip(&mut memory.steps) {
                *action = f32::from(*steps);
                *steps = steps.saturating_add(1);
            }
        },
    }
}

/// Returns `true` if every action of `rollouts` rollouts of `steps` steps that follow one another,
/// after a reset, is right.
fn is_right(lengths: &[usize], forgets: Forgets, [rollouts, steps]: [usize; 2]) -> bool {
    let mut run = OnPolicyRun::new(Ages::new(lengths), counter(forgets), steps);
    // after another reset of the same environments
    (0..2).all(|_| {
        run.state = RolloutState::from_env_reset(&mut run.env, &run.policy).unwrap();
        (0..rollouts).all(|_| {
            run.collect();
            run.buffer.rewards().iter().all(|&reward| reward == 1.0)
        })
    })
}

proptest! {
    /// Every action tells the age of its own episode: within a rollout, from one rollout to the
    /// next where the episode goes on, and after another reset of the same environments.
    #[test]
    fn a_memory_lasts_as_long_as_its_episode(
        lengths in prop::collection::vec(1usize..9, 1..6),
        rollouts in 1usize..4,
        steps in 1usize..12,
    ) {
        prop_assert!(is_right(&lengths, Forgets::ThisOne, [rollouts, steps]));
        let mut actor = counter(Forgets::ThisOne);
        for episode in evaluate_policy(&mut Ages::new(&lengths), &mut actor, 2).unwrap().episodes {
            prop_assert_eq!(episode.length, lengths[episode.env]);
            prop_assert_eq!(episode.total_reward, episode.length as f64);
        }
    }
}

/// The state carries the memory: a fresh one in the middle of an episode gives wrong actions, too.
#[test]
fn the_check_fails_for_memories_that_leak_or_are_lost() {
    for forgets in [Forgets::Nothing, Forgets::TheFirst, Forgets::Everything] {
        assert!(!is_right(&[3, 4], forgets, [2, 5]));
        let stats = evaluate_policy(&mut Ages::new(&[3, 4]), &mut counter(forgets), 2).unwrap();
        assert!(stats.episodes.iter().any(|e| e.total_reward < e.length as f64));
    }
    let mut run = OnPolicyRun::new(Ages::new(&[5]), counter(Forgets::ThisOne), 3);
    run.collect();
    assert_eq!(run.buffer.rewards(), [1.0; 3]);
    run.state.memory = run.policy.new_memory(1);
    run.collect();
    assert_ne!(run.buffer.rewards(), [1.0; 3]);
}

/// A memory that records every call for the first environment.
#[derive(Default)]
struct Notes {
    age: f32,
    heard: Vec<Heard>,
}

#[derive(Debug, PartialEq)]
enum Heard {
    Step { action: f32, reward: f32 },
    End,
}

impl ActorMemory for Notes {
    fn forget_episode(&mut self, env: usize) {
        if env == 0 {
            self.heard.push(Heard::End);
        }
    }

    fn remember_step(&mut self, env: usize, action: &[f32], reward: f32) {
        if env == 0 {
            self.heard.push(Heard::Step { action: action[0], reward });
        }
    }
}

/// A memory hears of each step after it was taken, with what was executed, and then of the end.
#[test]
fn a_memory_hears_of_actions_and_rewards_before_the_end() {
    let mut env = Ages::new(&[2, 5]);
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let mut heard = |steps, warm_up| {
        let settings = ReplaySettings { steps, warm_up, ..ReplaySettings::default() };
        let mut replay = ReplayBuffer::new(settings, env.spec()).unwrap();
        // acts wrongly at every second step
        let mut actor = BlindActor {
            new_memory: |_| Notes::default(),
            decide: |memory: &mut Notes, out: &mut [f32]| {
                out.fill(memory.age);
                memory.age += 2.0;
            },
        };
        let mut state = RolloutState::from_env_reset(&mut env, &actor).unwrap();
        collect_experience(&mut env, &mut actor, &mut replay, &mut state, &mut rng).unwrap();
        (state.memory.heard, replay.get(0).action()[0])
    };
    let step = |action: f32, reward| Heard::Step { action, reward };
    let expected = [step(0.0, 1.0), step(2.0, 0.0), Heard::End, step(4.0, 0.0)];
    assert_eq!(heard(3, 0).0, expected);
    // random actions of a warm-up are heard as they were executed
    let (heard, executed) = heard(1, 1);
    assert_eq!(heard, [step(executed, 0.0)]);
    assert!(executed != 0.0);
}
