//! Benchmarks of environments on one thread: a decision of 10 control steps, a 64 x 64 image, a
//! reset, and a vector environment's step of one control step and one image, with and without
//! domain randomisation. `EMBODIMENT=hand` measures another embodiment than `sawyer`.

use std::sync::Arc;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use envs::{
    ACTION_DIM, Camera, ControlSettings, Embodiment, EnvError, RGB_CHANNELS, Scene, SceneRenderer,
    StaticBackdrop, StepBuffers, TableTop, TaskGroup, VecEnv, VecEnvSettings,
    VisualDomainRandomisation,
};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use symmetry::D2;

/// Width and height of an image (pixels).
const SIZE: usize = 64;
/// Number of environments of the vector environment.
const ENVS: usize = 16;

fn embodiment() -> Result<Embodiment, EnvError> {
    std::env::var("EMBODIMENT").map_or(Ok(Embodiment::default()), |name| name.parse())
}

fn camera() -> Camera {
    Camera { size: SIZE, ..Camera::default() }
}

/// Takes one decision of the expert, and begins a new episode if one ended.
fn decide(table: &mut TableTop, rng: &mut ChaCha8Rng) -> Result<(), EnvError> {
    let action = table.expert_action()?;
    if table.step(&action)?.truncated {
        table.reset(D2::Identity, rng)?;
    }
    Ok(())
}

fn one_table(c: &mut Criterion, task: TaskGroup) -> Result<(), EnvError> {
    let scene = Arc::new(Scene::new(task, embodiment()?, camera())?);
    let mut table = TableTop::new(Arc::clone(&scene), ControlSettings::default())?;
    let mut renderer = SceneRenderer::new(scene)?;
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let mut group = c.benchmark_group(task.name());
    table.reset(D2::Identity, &mut rng)?;
    group.throughput(Throughput::Elements(ControlSettings::default().action_repeat as u64));
    group.bench_function("decision", |b| {
        b.iter(|| assert!(decide(&mut table, &mut rng).is_ok()));
    });
    group.throughput(Throughput::Elements(1));
    group.bench_function("reset", |b| {
        b.iter(|| assert!(table.reset(D2::FlipX, &mut rng).is_ok()));
    });
    let (mut backdrop, mut rgb) = (StaticBackdrop::default(), vec![0; SIZE * SIZE * RGB_CHANNELS]);
    group.bench_function("picture", |b| {
        b.iter(|| assert!(renderer.render(&mut table, &mut rgb).is_ok()));
    });
    let whole = rgb.clone();
    renderer.render_backdrop(&mut table, &mut backdrop)?;
    group.bench_function("picture_over_backdrop", |b| {
        b.iter(|| {
            assert!(renderer.render_over_backdrop(&mut table, &mut backdrop, &mut rgb).is_ok())
        });
    });
    assert!(rgb == whole);
    group.finish();
    Ok(())
}

fn vector(
    c: &mut Criterion,
    task: TaskGroup,
    (name, randomisation): (&str, Option<VisualDomainRandomisation>),
) -> Result<(), EnvError> {
    let settings = VecEnvSettings {
        num_envs: ENVS,
        threads: 1,
        embodiment: embodiment()?,
        camera: camera(),
        randomisation,
        control: ControlSettings {
            action_repeat: 1,
            displacement: 0.01,
            ..ControlSettings::default()
        },
        ..VecEnvSettings::default()
    };
    let mut env = VecEnv::new(settings, task, &D2::ALL)?;
    let mut batch = StepBuffers::new(&settings);
    env.reset(batch.observations_mut())?;
    let mut group = c.benchmark_group(task.name());
    group.throughput(Throughput::Elements(ENVS as u64));
    group.bench_function(name, |b| {
        b.iter(|| {
            let failures = env.step(&[0.1; ENVS * ACTION_DIM], batch.step_results_mut());
            assert!(failures.is_ok_and(<[_]>::is_empty));
        });
    });
    group.finish();
    Ok(())
}

fn measure(c: &mut Criterion, task: TaskGroup) -> Result<(), EnvError> {
    one_table(c, task)?;
    vector(c, task, ("vec_env_step", None))?;
    let nominal = Some(VisualDomainRandomisation::NOMINAL);
    vector(c, task, ("vec_env_step_randomised", nominal))
}

fn environments(c: &mut Criterion) {
    for task in TaskGroup::STANDARD {
        if let Err(error) = measure(c, task) {
            panic!("{error}");
        }
    }
}

criterion_group!(benches, environments);
criterion_main!(benches);
