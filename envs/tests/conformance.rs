//! The rules of `envs::conformance` asked of every group, and of tasks that break one each.

#![allow(clippy::unwrap_used, reason = "test code")]

mod common;

use std::sync::atomic::{AtomicU64, Ordering};

use common::PushBlock;
use envs::conformance::{Flaw, check};
use envs::{
    EnvError, EpisodeStart, ExpertCommand, Measurement, Parts, Placement, StepReward, Stock, Task,
    TaskGroup,
};
use glam::DVec3;
use rand_chacha::ChaCha8Rng;

fn leaked(task: impl Task + 'static) -> TaskGroup {
    TaskGroup::of(Box::leak(Box::new(task)))
}

#[test]
fn every_standard_group_conforms() {
    std::thread::scope(|scope| {
        for group in TaskGroup::STANDARD {
            scope.spawn(move || check(group).unwrap());
        }
    });
}

#[test]
fn a_task_of_somebody_elses_conforms() {
    check(leaked(PushBlock::default())).unwrap();
}

type Reward = fn(&mut StepReward, &EpisodeStart, &Measurement, f64);

/// A sound task with one thing wrong.
struct Spoilt {
    task: PushBlock,
    place: fn(&mut Placement),
    reward: Reward,
    expert: fn(&mut ExpertCommand, &Measurement),
    goal_observable: bool,
}

impl Default for Spoilt {
    fn default() -> Self {
        Self {
            task: PushBlock::default(),
            place: |_| {},
            reward: |_, _, _, _| {},
            expert: |_, _| {},
            goal_observable: false,
        }
    }
}

impl Task for Spoilt {
    fn name(&self) -> &str {
        self.task.name()
    }

    fn parts(&self) -> Parts<'_> {
        Parts {
            goal_observable: self.goal_observable,
            ..self.task.parts()
        }
    }

    fn place(&self, rng: &mut ChaCha8Rng) -> Placement {
        let mut placement = self.task.place(rng);
        (self.place)(&mut placement);
        placement
    }

    fn reward(&self, start: &EpisodeStart, now: &Measurement, finger: f64) -> StepReward {
        let mut reward = self.task.reward(start, now, finger);
        (self.reward)(&mut reward, start, now, finger);
        reward
    }

    fn expert(&self, placement: &Placement, now: &Measurement) -> ExpertCommand {
        let mut command = self.task.expert(placement, now);
        (self.expert)(&mut command, now);
        command
    }
}

fn assert_flaw(what: &str, task: Spoilt, expected: &str) {
    let message = check(leaked(task)).unwrap_err().to_string();
    assert!(message.contains(expected), "{what}: {message}");
}

#[test]
fn scenes_with_a_flaw_are_refused() {
    let cases = [
        ("no name", "geom name=\"block\"", "geom", "has a name"),
        (
            "no object body",
            "name=\"object\"",
            "name=\"thing\"",
            "`object`",
        ),
        ("invisible", "group=\"1\"", "group=\"4\"", "differ"),
        (
            "lopsided",
            "</body>\n    </body>",
            "<geom name=\"nose\" type=\"box\" size=\".03 .01 .01\" pos=\".06 0 0\" group=\"1\"/>\
             </body></body>",
            "mirrors its canonical twin",
        ),
        ("not XML", "<worldbody>", "", "XML"),
    ];
    for (what, old, new, expected) in cases {
        let scene = common::SCENE.replacen(old, new, 1);
        assert_ne!(scene, common::SCENE, "{what}");
        let task = PushBlock {
            scene,
            ..PushBlock::default()
        };
        let spoilt = Spoilt {
            task,
            ..Spoilt::default()
        };
        assert_flaw(what, spoilt, expected);
    }
}

#[test]
fn rewards_with_a_flaw_are_refused() {
    static CALLS: AtomicU64 = AtomicU64::new(0);
    let cases: [(&str, Reward, &str); 5] = [
        ("not a number", |r, _, _, _| r.reward = f64::NAN, "in range"),
        ("too large", |r, _, _, _| r.reward += 10.0, "in range"),
        ("easy", |r, _, _, _| r.success = true, "doing nothing"),
        ("impossible", |r, _, _, _| r.success = false, "expert"),
        (
            "remembers",
            |r, _, _, _| r.reward *= 1.0 / (1 + CALLS.fetch_add(1, Ordering::Relaxed)) as f64,
            "two episodes of one seed differ",
        ),
    ];
    for (what, reward, expected) in cases {
        let spoilt = Spoilt {
            reward,
            ..Spoilt::default()
        };
        assert_flaw(what, spoilt, expected);
    }
}

#[test]
fn placements_and_experts_with_a_flaw_are_refused() {
    let centred = Spoilt {
        place: |placement| {
            placement.object.x = 0.0;
            placement.goal.x = 0.0;
        },
        ..Spoilt::default()
    };
    assert_flaw("on an axis", centred, "variants differ");
    let constant = Spoilt {
        place: |placement| {
            *placement = Placement {
                object: DVec3::new(0.1, 0.06, 0.045),
                goal: DVec3::new(0.1, 0.16, 0.045),
            }
        },
        ..Spoilt::default()
    };
    assert_flaw("one placement", constant, "the seed changes nothing");
    let nowhere = Spoilt {
        place: |placement| placement.goal.y = f64::NAN,
        ..Spoilt::default()
    };
    assert_flaw("no number", nowhere, "the placement's goal is");
    let lazy = Spoilt {
        expert: |command, now| command.hand = now.hand,
        ..Spoilt::default()
    };
    assert_flaw("lazy expert", lazy, "the expert solves it");
}

#[test]
fn a_malformed_name_is_refused() {
    let task = PushBlock {
        name: "Push Block".to_owned(),
        ..PushBlock::default()
    };
    let flaw = check(leaked(task)).unwrap_err();
    let source = match flaw {
        Flaw::Failed { source, .. } => source,
        other => panic!("{other}"),
    };
    assert!(matches!(source, EnvError::TaskName { .. }), "{source}");
}

/// What a task brings for Meta-World's layout is held to the rules, too.
#[test]
fn a_flaw_of_the_stock_layout_alone_is_found() {
    struct Stuck(PushBlock);
    impl Task for Stuck {
        fn name(&self) -> &str {
            self.0.name()
        }
        fn parts(&self) -> Parts<'_> {
            self.0.parts()
        }
        fn place(&self, rng: &mut ChaCha8Rng) -> Placement {
            self.0.place(rng)
        }
        fn reward(&self, start: &EpisodeStart, now: &Measurement, finger: f64) -> StepReward {
            self.0.reward(start, now, finger)
        }
        fn expert(&self, placement: &Placement, now: &Measurement) -> ExpertCommand {
            self.0.expert(placement, now)
        }
        fn stock(&self) -> Option<Stock<'_>> {
            Some(Stock {
                name: "push-block",
                hand_target: DVec3::new(0.0, 0.0, 0.2),
                addition: None,
                place: |_| Placement {
                    object: DVec3::ZERO,
                    goal: DVec3::X,
                },
            })
        }
    }
    let message = check(leaked(Stuck(PushBlock::default()))).unwrap_err();
    assert!(message.to_string().contains("metaworld"), "{message}");
}
