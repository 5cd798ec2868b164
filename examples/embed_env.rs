//! Runs environments without a learner: a scripted expert solves the four variants of a task, and a
//! GIF shows them side by side.
//!
//! `cargo run --release --example embed_env [TASK] [FILE.gif]`; tasks are goal-reach, button-press,
//! drawer-close, plate-slide.

use std::error::Error;
use std::fs::{File, create_dir_all};
use std::path::{Path, PathBuf};
use std::sync::Arc;

use envs::{
    Camera, ControlSettings, Embodiment, RGB_CHANNELS, Scene, SceneRenderer, TableTop, TaskRegistry,
};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use symmetry::D2;

/// Side of a variant's image (pixels).
const SIZE: usize = 128;
/// Delay between frames in hundredths of a second; a decision lasts 0.125 s.
const DELAY: u16 = 12;

fn main() -> Result<(), Box<dyn Error>> {
    let mut arguments = std::env::args().skip(1);
    let name = arguments.next();
    let name = name.as_deref().unwrap_or("drawer-close");
    let group = TaskRegistry::with_all().find(name)?;
    let path = arguments.next().map_or("runs/embed_env.gif".into(), PathBuf::from);
    let camera = Camera { size: SIZE, ..Camera::default() };
    let scene = Arc::new(Scene::new(group, Embodiment::SAWYER, camera)?);
    let mut renderer = SceneRenderer::with_arm(Arc::clone(&scene))?;
    let films = D2::ALL
        .into_iter()
        .map(|element| film(&scene, element, &mut renderer))
        .collect::<Result<Vec<_>, _>>()?;
    write_gif(&path, &films)?;
    println!("{}", path.display());
    Ok(())
}

/// Renders one episode of the expert.
fn film(
    scene: &Arc<Scene>,
    element: D2,
    renderer: &mut SceneRenderer,
) -> Result<Vec<Vec<u8>>, Box<dyn Error>> {
    let mut table = TableTop::new(Arc::clone(scene), ControlSettings::default())?;
    table.reset(element, &mut ChaCha8Rng::seed_from_u64(1))?;
    let (mut frames, mut reward, mut success) = (Vec::new(), 0.0, false);
    loop {
        let mut picture = vec![0; SIZE * SIZE * RGB_CHANNELS];
        renderer.render(&mut table, &mut picture)?;
        frames.push(picture);
        let action = table.expert_action()?;
        let step = table.step(&action)?;
        reward += step.reward;
        success |= step.success;
        if step.truncated {
            println!(
                "{} {element}: reward {reward:.1} of {}, success {success}",
                scene.group,
                frames.len()
            );
            return Ok(frames);
        }
    }
}

/// Writes a GIF whose frames show all films side by side.
fn write_gif(path: &Path, films: &[Vec<Vec<u8>>]) -> Result<(), Box<dyn Error>> {
    if let Some(folder) = path.parent() {
        create_dir_all(folder)?;
    }
    let (width, height) = ((films.len() * SIZE) as u16, SIZE as u16);
    let mut encoder = gif::Encoder::new(File::create(path)?, width, height, &[])?;
    encoder.set_repeat(gif::Repeat::Infinite)?;
    for index in 0..films[0].len() {
        let line = |y| {
            films.iter().flat_map(move |film| {
                &film[index][y * SIZE * RGB_CHANNELS..][..SIZE * RGB_CHANNELS]
            })
        };
        let rgb: Vec<u8> = (0..SIZE).flat_map(line).copied().collect();
        let mut frame = gif::Frame::from_rgb_speed(width, height, &rgb, 10);
        frame.delay = DELAY;
        encoder.write_frame(&frame)?;
    }
    Ok(())
}
