//! Draws pictures that policies learn from, perfect and randomised: each group has two lines, with
//! the same placements below each other, some of the expert's decisions into an episode.
//!
//! ```sh
//! cargo run --release -p covers-envs --example randomised sheet.png
//! ```

use std::error::Error;
use std::fs::File;

use envs::{ACTION_DIM, Batch, RGB, Randomisation, TaskGroup, VecEnv, VecEnvSettings};
use symmetry::D2;

/// Pictures in a line.
const ACROSS: usize = 8;
/// Decisions before a picture is taken.
const DECISIONS: usize = 12;
/// Each pixel becomes a square of this side.
const ENLARGE: usize = 3;

fn main() -> Result<(), Box<dyn Error>> {
    let path = std::env::args().nth(1);
    let path = path.ok_or("name the PNG file to write")?;
    let mut pictures = Vec::new();
    for group in TaskGroup::STANDARD {
        for randomisation in [None, Some(Randomisation::NOMINAL)] {
            pictures.extend(line(group, randomisation)?);
        }
    }
    let size = VecEnvSettings::default().camera.size;
    write(&path, &pictures, size)
}

/// One picture `[size, size, 3]` of each environment.
fn line(
    group: TaskGroup,
    randomisation: Option<Randomisation>,
) -> Result<Vec<Vec<u8>>, envs::EnvError> {
    let settings = VecEnvSettings {
        num_envs: ACROSS,
        randomisation,
        ..VecEnvSettings::default()
    };
    let mut env = VecEnv::new(settings, group, &D2::ALL)?;
    let mut batch = Batch::new(&settings);
    env.reset(batch.observations())?;
    let mut actions = [0.0; ACROSS * ACTION_DIM];
    for _ in 0..DECISIONS {
        env.expert_actions(&mut actions)?;
        env.step(&actions, batch.step())?;
    }
    let newest = |image: &[u8]| {
        let pixels = image.chunks_exact(settings.camera.beside.channels());
        pixels.flat_map(|pixel| &pixel[..RGB]).copied().collect()
    };
    let images = batch.images.chunks_exact(settings.image_len());
    Ok(images.map(newest).collect())
}

fn write(path: &str, pictures: &[Vec<u8>], size: usize) -> Result<(), Box<dyn Error>> {
    let cell = size * ENLARGE;
    let [width, height] = [ACROSS, pictures.len() / ACROSS].map(|cells| cells * cell);
    let mut rgb = Vec::with_capacity(width * height * RGB);
    for (y, x) in (0..height).flat_map(|y| (0..width).map(move |x| (y, x))) {
        let picture = &pictures[y / cell * ACROSS + x / cell];
        let [row, column] = [y, x].map(|at| at % cell / ENLARGE);
        rgb.extend(&picture[(row * size + column) * RGB..][..RGB]);
    }
    let mut encoder = png::Encoder::new(File::create(path)?, width as u32, height as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.write_header()?.write_image_data(&rgb)?;
    Ok(())
}
