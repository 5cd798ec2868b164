//! Times environments on request, for `benches/peers/envs.sh`: reads lines `<measure> <embodiment>
//! <task> <threads>` and answers each with one number.
//!
//! Measures: `state` (control steps per second without pictures), `ceiling` (the same motion by
//! bare physics steps), `image` (control steps per second of a `VecEnv` with a 64 x 64 x 6 image
//! each), `frame` (milliseconds of one picture), `reset` (milliseconds, without a picture),
//! `switch` (milliseconds, from one prepared group to the next with 64 environments), `memory`
//! (megabytes of this process with 64 environments and their images, all task groups prepared).
//! Threads work side by side and their rates add up.

use std::error::Error;
use std::io::{Write, stdin, stdout};
use std::sync::{Arc, Barrier};
use std::thread;
use std::time::{Duration, Instant};

use envs::{
    ACTION_DIM, Camera, ControlSettings, Embodiment, HAND_TARGET_START, RGB_CHANNELS, Scene,
    SceneRenderer, StaticBackdrop, StepBuffers, TableTop, TaskGroup, TaskRegistry, VecEnv,
    VecEnvSettings,
};
use glam::DVec3;
use mujoco::Data;
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use symmetry::D2;

type Failure = Box<dyn Error + Send + Sync>;

const TURN: Duration = Duration::from_millis(400);
/// Number of environments that take turns on each thread.
const ENVS: usize = 16;
/// Number of environments whose memory is measured.
const MANY: usize = 64;
/// Control with an action, and an image, every control step of 12.5 ms. A full action moves the
/// target 1 cm, as in Meta-World.
const CONTROL: ControlSettings =
    ControlSettings { action_repeat: 1, displacement: 0.01, horizon: 500 };

#[derive(Clone, Copy)]
struct Subject {
    embodiment: Embodiment,
    group: TaskGroup,
    camera: Camera,
}

impl Subject {
    fn parse(embodiment: &str, group: &str) -> Result<Self, Failure> {
        Ok(Self {
            embodiment: embodiment.parse()?,
            group: TaskRegistry::with_all().find(group)?,
            camera: Camera { size: 64, ..Camera::default() },
        })
    }

    /// Creates a table at the start of an episode, and a random generator for its actions.
    fn table(self) -> Result<(TableTop, ChaCha8Rng), Failure> {
        let mut rng = ChaCha8Rng::seed_from_u64(0);
        let scene = Scene::new(self.group, self.embodiment, self.camera)?;
        let mut table = TableTop::new(Arc::new(scene), CONTROL)?;
        table.reset(D2::Identity, &mut rng)?;
        Ok((table, rng))
    }

    fn state(self, start: &Barrier) -> Result<f64, Failure> {
        let (table, mut rng) = self.table()?;
        let scene = Arc::clone(table.scene());
        let mut tables = vec![table];
        for _ in 1..ENVS {
            let mut another = TableTop::new(Arc::clone(&scene), CONTROL)?;
            another.reset(D2::Identity, &mut rng)?;
            tables.push(another);
        }
        // as the pools that it is compared with, which have stepped before: the first step touches
        // fresh memory
        for each in &mut tables {
            each.step(&action(&mut rng))?;
        }
        let mut turns = (0..ENVS).cycle();
        start.wait();
        rate(|| {
            let current = &mut tables[turns.next().unwrap_or(0)];
            if current.step(&action(&mut rng))?.truncated {
                current.reset(D2::Identity, &mut rng)?;
            }
            Ok(())
        })
    }

    /// Measures the work of `state` in MuJoCo alone: the target moves, the fingers are set, five
    /// physics steps.
    fn ceiling(self, start: &Barrier) -> Result<f64, Failure> {
        let (table, mut rng) = self.table()?;
        let model = &table.scene().model;
        let (hand_target, begin) =
            (model.mocap_body("hand_target")?, table.simulation().save_state());
        let mut simulations = Vec::new();
        for _ in 0..ENVS {
            let mut data = Data::new(Arc::clone(model));
            data.restore_state(&begin)?;
            data.step(5)?;
            simulations.push((data, HAND_TARGET_START, 0));
        }
        let mut turns = (0..ENVS).cycle();
        start.wait();
        rate(|| {
            let (data, target, steps) = &mut simulations[turns.next().unwrap_or(0)];
            *steps += 1;
            if *steps % CONTROL.horizon == 0 {
                data.restore_state(&begin)?;
                *target = HAND_TARGET_START;
            }
            let [x, y, z, finger] = action(&mut rng).map(f64::from);
            let (low, high) = (DVec3::new(-0.3, -0.3, 0.05), DVec3::new(0.3, 0.3, 0.35));
            *target = (*target + CONTROL.displacement * DVec3::new(x, y, z)).clamp(low, high);
            data.set_mocap_position(hand_target, target.to_array())?;
            data.set_all_ctrl(&[finger, -finger])?;
            Ok(data.step(5)?)
        })
    }

    fn reset(self) -> Result<f64, Failure> {
        let (mut table, mut rng) = self.table()?;
        let resets = rate(|| Ok(table.reset(D2::FlipX, &mut rng)?))?;
        Ok(1e3 / resets)
    }

    /// Measures the milliseconds of one image as a `VecEnv` renders it, of a scene that moves
    /// between images. The time of the motion does not count.
    fn frame(self) -> Result<f64, Failure> {
        let (mut table, mut rng) = self.table()?;
        let mut renderer = SceneRenderer::new(Arc::clone(table.scene()))?;
        let mut backdrop = StaticBackdrop::default();
        let mut rgb = vec![0; self.camera.size * self.camera.size * RGB_CHANNELS];
        let (mut spent, mut frames, start) = (Duration::ZERO, 0_u32, Instant::now());
        let mut begins = true;
        while start.elapsed() < TURN {
            let before = Instant::now();
            if begins {
                renderer.render_backdrop(&mut table, &mut backdrop)?;
            }
            renderer.render_over_backdrop(&mut table, &mut backdrop, &mut rgb)?;
            spent += before.elapsed();
            frames += 1;
            begins = table.step(&action(&mut rng))?.truncated;
            if begins {
                table.reset(D2::Identity, &mut rng)?;
            }
        }
        Ok(1e3 * spent.as_secs_f64() / f64::from(frames))
    }

    fn image(self, threads: usize) -> Result<f64, Failure> {
        let mut driven = Driven::new(self, ENVS * threads, threads)?;
        driven.step()?;
        Ok((ENVS * threads) as f64 * rate(|| driven.step())?)
    }

    fn switch(self, threads: usize) -> Result<f64, Failure> {
        let mut driven = Driven::new(self, MANY, threads)?;
        driven.env.prepare_task_groups(&TaskGroup::STANDARD)?;
        let mut groups = TaskGroup::STANDARD.into_iter().cycle();
        let switches = rate(|| {
            let group = groups.next().unwrap_or(self.group);
            Ok(driven.env.set_task_group(group, &D2::ALL)?)
        })?;
        Ok(1e3 / switches)
    }

    fn memory(self, threads: usize) -> Result<f64, Failure> {
        let mut driven = Driven::new(self, MANY, threads)?;
        driven.env.prepare_task_groups(&TaskGroup::STANDARD)?;
        for _ in 0..50 {
            driven.step()?;
        }
        let status = std::fs::read_to_string("/proc/self/status")?;
        let resident = status.lines().find_map(|line| line.strip_prefix("VmRSS:"));
        let kilobytes = resident.and_then(|text| text.split_whitespace().next());
        Ok(kilobytes.ok_or("no VmRSS")?.parse::<f64>()? / 1024.0)
    }
}

/// Vector environment with random actions.
struct Driven {
    env: VecEnv,
    rng: ChaCha8Rng,
    actions: Vec<f32>,
    batch: StepBuffers,
}

impl Driven {
    fn new(subject: Subject, num_envs: usize, threads: usize) -> Result<Self, Failure> {
        let settings = VecEnvSettings {
            num_envs,
            threads,
            embodiment: subject.embodiment,
            camera: subject.camera,
            control: CONTROL,
            ..VecEnvSettings::default()
        };
        let mut driven = Self {
            env: VecEnv::new(settings, subject.group, &D2::ALL)?,
            rng: ChaCha8Rng::seed_from_u64(0),
            actions: vec![0.0; num_envs * ACTION_DIM],
            batch: StepBuffers::new(&settings),
        };
        driven.env.reset(driven.batch.observations_mut())?;
        Ok(driven)
    }

    fn step(&mut self) -> Result<(), Failure> {
        for row in self.actions.chunks_exact_mut(ACTION_DIM) {
            row.copy_from_slice(&action(&mut self.rng));
        }
        match self.env.step(&self.actions, self.batch.step_results_mut())? {
            [] => Ok(()),
            [failure, ..] => Err(failure.error.to_string().into()),
        }
    }
}

fn action(rng: &mut ChaCha8Rng) -> [f32; ACTION_DIM] {
    std::array::from_fn(|_| rng.random_range(-1.0..1.0))
}

/// Returns the number of runs of `run` per second, measured for [`TURN`].
fn rate(mut run: impl FnMut() -> Result<(), Failure>) -> Result<f64, Failure> {
    let (mut runs, start) = (0_u32, Instant::now());
    while start.elapsed() < TURN {
        run()?;
        runs += 1;
    }
    Ok(f64::from(runs) / start.elapsed().as_secs_f64())
}

/// Returns the sum of the rates that `work` reaches on each of `threads` threads at the same time.
fn side_by_side(
    threads: usize,
    work: impl Fn(&Barrier) -> Result<f64, Failure> + Sync,
) -> Result<f64, Failure> {
    let barrier = Barrier::new(threads);
    thread::scope(|scope| {
        let running: Vec<_> = (0..threads).map(|_| scope.spawn(|| work(&barrier))).collect();
        let mut sum = 0.0;
        for thread in running {
            sum += thread.join().map_err(|_| "a thread panicked")??;
        }
        Ok(sum)
    })
}

fn answer(line: &str) -> Result<f64, Failure> {
    let words: Vec<&str> = line.split_whitespace().collect();
    let [measure, embodiment, group, threads] = words[..] else {
        return Err("expected `<measure> <embodiment> <task> <threads>`".into());
    };
    let (subject, threads) = (Subject::parse(embodiment, group)?, threads.parse()?);
    match measure {
        "state" => side_by_side(threads, |start| subject.state(start)),
        "ceiling" => side_by_side(threads, |start| subject.ceiling(start)),
        "image" => subject.image(threads),
        "frame" => subject.frame(),
        "reset" => subject.reset(),
        "switch" => subject.switch(threads),
        "memory" => subject.memory(threads),
        _ => Err(format!("unknown measure `{measure}`").into()),
    }
}

fn main() -> Result<(), Failure> {
    // the first model of a process tunes software rendering, provided that there are no threads yet
    Subject::parse("sawyer", "goal-reach")?.table()?;
    for line in stdin().lines() {
        writeln!(stdout(), "{}", answer(&line?)?)?;
        stdout().flush()?;
    }
    Ok(())
}
