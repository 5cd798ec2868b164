//! Decisions of 10 control steps: the state alone, and with the 48 x 48 x 6 picture; one thread.

use std::sync::Arc;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use envs::{
    ACTION_DIM, Dynamics, EnvError, Painter, RGB, Scene, TableTop, TaskGroup, VecEnvSettings,
};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use symmetry::D2;

fn tables(group: TaskGroup) -> Result<(TableTop, Painter), EnvError> {
    let settings = VecEnvSettings::default();
    let scene = Arc::new(Scene::new(group, settings.embodiment, settings.camera)?);
    let table = TableTop::new(Arc::clone(&scene), Dynamics::default())?;
    Ok((table, Painter::new(scene)?))
}

/// One decision of the expert; a new episode where one ended.
fn decide(table: &mut TableTop, rng: &mut ChaCha8Rng) -> Result<(), EnvError> {
    let action: [f32; ACTION_DIM] = table.expert_action()?;
    if table.step(&action)?.truncated {
        table.reset(D2::Identity, rng)?;
    }
    Ok(())
}

fn measure(c: &mut Criterion, task: TaskGroup) -> Result<(), EnvError> {
    let (mut table, mut painter) = tables(task)?;
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let size = table.scene().camera.size;
    let mut rgb = vec![0; size * size * RGB];
    table.reset(D2::Identity, &mut rng)?;
    let mut group = c.benchmark_group(format!("sawyer_{task}"));
    group.throughput(Throughput::Elements(
        Dynamics::default().action_repeat as u64,
    ));
    group.bench_function("decision_state", |b| {
        b.iter(|| assert!(decide(&mut table, &mut rng).is_ok()));
    });
    group.throughput(Throughput::Elements(1));
    group.bench_function("picture_48x48", |b| {
        b.iter(|| assert!(painter.paint(&mut table, &mut rgb).is_ok()));
    });
    assert!(rgb.iter().any(|&value| value != rgb[0]));
    group.bench_function("reset", |b| {
        b.iter(|| assert!(table.reset(D2::FlipX, &mut rng).is_ok()));
    });
    group.finish();
    Ok(())
}

fn environments(c: &mut Criterion) {
    for group in TaskGroup::ALL {
        if let Err(error) = measure(c, group) {
            panic!("{error}");
        }
    }
}

criterion_group!(benches, environments);
criterion_main!(benches);
