//! Failures of environments, which must not affect the others.

mod commands;

use super::*;
use crate::batch::StepBuffers;
use crate::embodiment::Embodiment;
use crate::messages::Fault;
use crate::renderer::SceneRenderer;

const N: usize = 3;
/// Index of the environment that is made to fail.
const BROKEN: usize = 1;
/// Decisions in an episode, and the index of the one that fails.
const DECISIONS: usize = 4;
const FATAL: usize = 2;

/// Row of one step's results.
#[derive(Clone, Debug, PartialEq)]
struct Seen {
    observation: (Vec<u8>, Vec<f32>),
    last: Option<(Vec<u8>, Vec<f32>)>,
    reward: f32,
    /// Success at any control step, and at the last.
    success: [bool; 2],
}

struct Rig {
    env: VecEnv,
    batch: StepBuffers,
}

impl Rig {
    fn new(threads: usize) -> Self {
        let mut settings = VecEnvSettings { num_envs: N, threads, ..VecEnvSettings::default() };
        settings.camera.size = 16;
        settings.control.horizon = 10 * DECISIONS;
        Self {
            env: VecEnv::new(settings, TaskGroup::DRAWER_CLOSE, &D2::ALL).unwrap(),
            batch: StepBuffers::new(&settings),
        }
    }

    fn reset(&mut self) -> Vec<String> {
        texts(self.env.reset(self.batch.observations_mut()).unwrap())
    }

    fn row(observation: &ObservationsMut, env: usize) -> (Vec<u8>, Vec<f32>) {
        let image = observation.images.len() / N;
        (
            observation.images[env * image..][..image].to_vec(),
            observation.vectors[env * VECTOR_OBSERVATION_DIM..][..VECTOR_OBSERVATION_DIM].to_vec(),
        )
    }

    fn observation(&mut self, env: usize) -> (Vec<u8>, Vec<f32>) {
        Self::row(&self.batch.observations_mut(), env)
    }

    /// Takes the same action everywhere, and returns the rows and the failures.
    fn step(&mut self) -> (Vec<Seen>, Vec<String>) {
        self.try_step().unwrap()
    }

    fn try_step(&mut self) -> Result<(Vec<Seen>, Vec<String>), EnvError> {
        let actions = [0.5; N * ACTION_DIM];
        let failures = texts(self.env.step(&actions, self.batch.step_results_mut())?);
        let out = self.batch.step_results_mut();
        let seen = |env| Seen {
            observation: Self::row(&out.observations, env),
            last: out.truncated[env].then(|| Self::row(&out.final_observations, env)),
            reward: out.rewards[env],
            success: [out.success[env], out.success_at_end[env]],
        };
        Ok(((0..N).map(seen).collect(), failures))
    }

    /// Breaks one environment at its next decision.
    fn inject(&mut self, fault: Fault) {
        let owner = |worker: &&mut Worker| worker.envs.contains(&BROKEN);
        let worker = self.env.workers.iter_mut().find(owner).unwrap();
        worker.send(WorkerCommand::Inject(BROKEN - worker.envs.start, fault));
        worker.receive().result.unwrap();
    }
}

fn texts(failures: &[EnvFailure]) -> Vec<String> {
    let text = |failure: &EnvFailure| format!("{}: {}", failure.env, failure.error);
    failures.iter().map(text).collect()
}

/// Lets one environment fail in its third decision, and compares everything with a run without the
/// failure.
fn check_failure(threads: usize, fault: Fault, says: &str) {
    let (mut sane, mut hurt) = (Rig::new(threads), Rig::new(threads));
    assert!(sane.reset().is_empty() && hurt.reset().is_empty());
    for decision in 0..2 * DECISIONS {
        if decision == FATAL {
            hurt.inject(fault);
        }
        let before = hurt.observation(BROKEN);
        let ((expected, _), (seen, failures)) = (sane.step(), hurt.step());
        for env in (0..N).filter(|&env| env != BROKEN) {
            assert_eq!(seen[env], expected[env], "{env} in decision {decision}");
        }
        let broken = &seen[BROKEN];
        if decision == FATAL {
            let [failure] = &failures[..] else { panic!("{failures:?}") };
            assert!(failure.starts_with(&format!("{BROKEN}: ")), "{failure}");
            assert!(failure.contains(says), "{failure}");
            assert_eq!(broken.last.as_ref(), Some(&before));
            assert_eq!(broken.reward, 0.0);
            assert_eq!(broken.success, [false; 2]);
            let image = broken.observation.0.chunks_exact(6);
            assert!(image.into_iter().all(|pixel| pixel[..3] == pixel[3..]));
        } else {
            assert!(failures.is_empty(), "{failures:?}");
            // its second episode began when the first failed
            let ends = decision == FATAL + DECISIONS;
            assert_eq!(broken.last.is_some(), ends, "decision {decision}");
            assert_eq!(decision < FATAL, *broken == expected[BROKEN]);
        }
    }
}

#[test]
fn a_diverged_simulation_is_a_failure_of_its_environment_alone() {
    for threads in [1, 2] {
        let fault: Fault = |table, _| table.simulation_mut().qpos_mut()[0] = f64::NAN;
        check_failure(threads, fault, "diverged");
    }
}

#[test]
fn a_panic_is_a_failure_of_its_environment_alone() {
    for threads in [1, 2] {
        check_failure(threads, |_, _| panic!("a deliberate panic"), "a deliberate panic");
    }
}

/// With the data of another model every restart fails: the row must stay as it was, with a failure
/// in every step.
#[test]
fn an_environment_that_cannot_restart_fails_in_every_step() {
    let mut rig = Rig::new(2);
    rig.reset();
    rig.inject(|table, _| {
        let other = mujoco::Model::from_xml("<mujoco/>").unwrap();
        *table.simulation_mut() = mujoco::Data::new(Arc::new(other));
    });
    let before = rig.observation(BROKEN);
    for says in ["panicked", "no episode is running"] {
        let (seen, failures) = rig.step();
        assert_eq!(failures.len(), 2, "{failures:?}");
        assert!(failures[0].contains(says), "{failures:?}");
        assert!(failures[1].contains("elements, expected"), "{failures:?}");
        assert_eq!(seen[BROKEN].observation, before);
        assert_eq!(seen[BROKEN].last.as_ref(), Some(&before));
    }
    assert_eq!(rig.reset().len(), 1);
}

#[test]
fn a_seed_that_a_lost_worker_did_not_take_is_not_the_settings() {
    let mut rig = Rig::new(2);
    rig.env.workers[0].send(WorkerCommand::Inject(N, |_, _| {}));
    let lost = rig.env.workers[0].receive().result.unwrap_err();
    assert!(matches!(lost, EnvError::WorkerLost { .. }), "{lost}");
    let seed = rig.env.settings().seed;
    rig.env.reseed(seed + 1).unwrap_err();
    assert_eq!(rig.env.settings().seed, seed);
}

/// All environments of a thread are drawn by one renderer. Where it fails the call fails, and the
/// next reset makes a new one.
#[test]
fn lost_rendering_is_an_error_of_the_call_and_a_reset_recovers() {
    for threads in [1, 2] {
        let (mut sane, mut hurt) = (Rig::new(threads), Rig::new(threads));
        assert!(sane.reset().is_empty() && hurt.reset().is_empty());
        // a renderer of another scene rejects every simulation, like a lost context
        hurt.inject(|table, renderer| {
            let camera = table.scene().camera;
            let other = Scene::new(table.scene().group, Embodiment::FLOATING_HAND, camera).unwrap();
            *renderer = SceneRenderer::new(Arc::new(other)).unwrap();
        });
        let lost = hurt.try_step().unwrap_err().to_string();
        assert!(lost.starts_with("environment 1: "), "{lost}");
        assert!(matches!(hurt.try_step(), Err(EnvError::NotReset)));
        for rig in [&mut sane, &mut hurt] {
            rig.env.reseed(5).unwrap();
            assert!(rig.reset().is_empty());
        }
        for env in 0..N {
            assert_eq!(sane.observation(env), hurt.observation(env));
        }
        assert_eq!(sane.step(), hurt.step());
    }
}

/// A forked child has its parent's memory and none of its worker threads. The test only pretends to
/// be another process; `python/tests/test_fork.py` forks.
#[test]
fn in_another_process_every_call_is_refused_and_a_drop_joins_no_thread() {
    for threads in [1, 2] {
        let mut rig = Rig::new(threads);
        rig.reset();
        let scene = Arc::downgrade(&rig.env.scenes[&TaskGroup::DRAWER_CLOSE]);
        let (here, elsewhere) = (rig.env.process, rig.env.process + 1);
        rig.env.process = elsewhere;
        let mut actions = [0.0; N * ACTION_DIM];
        let commands = [EnvCommand::Reset; N];
        let reset = rig.env.reset(rig.batch.observations_mut()).map(|_| ());
        let step = rig.env.step(&actions, rig.batch.step_results_mut()).map(|_| ());
        let advance = rig.env.execute_commands(&actions, &commands, rig.batch.step_results_mut());
        for refused in [
            reset,
            step,
            advance.map(|_| ()),
            rig.env.expert_actions(&mut actions),
            rig.env.reseed(1),
            rig.env.prepare_task_groups(&[TaskGroup::DRAWER_CLOSE]),
            rig.env.set_task_group(TaskGroup::DRAWER_CLOSE, &D2::ALL),
        ] {
            let error = refused.unwrap_err();
            let EnvError::UsedAfterFork { made_in, process } = error else {
                panic!("{error}");
            };
            assert_eq!((made_in, process), (elsewhere, here));
        }
        drop(rig);
        assert!(scene.strong_count() > 0, "the workers go on");
        // in its own process the same drop ends them
        let mut last_rig = Rig::new(threads);
        last_rig.reset();
        let last_scene = Arc::downgrade(&last_rig.env.scenes[&TaskGroup::DRAWER_CLOSE]);
        drop(last_rig);
        assert_eq!(last_scene.strong_count(), 0);
    }
}
