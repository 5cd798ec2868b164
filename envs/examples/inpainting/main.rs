//! Paints the arm out of an episode and writes a strip of raw pictures, masks and results:
//! `inpainting [FILE.png]`.

mod arm;

use std::error::Error;
use std::fs::File;
use std::io::BufWriter;
use std::sync::Arc;

use arm::Arm;
use envs::{Camera, Control, Embodiment, RGB_CHANNELS, Scene, SceneRenderer, TableTop, TaskGroup};
use inpainting::{ColorCorrection, Inpainter, InpainterSettings};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use symmetry::D2;

/// Pixels along a picture's side.
const SIZE: usize = 128;
/// Pictures across the strip.
const COLUMNS: usize = 6;
/// Decisions between frames.
const EVERY: usize = 5;

/// Rows of the strip, frame after frame.
type Rows = [Vec<Vec<u8>>; 3];

fn main() -> Result<(), Box<dyn Error>> {
    let path = std::env::args().nth(1).unwrap_or("inpainting.png".into());
    let rows = episode()?;
    let file = BufWriter::new(File::create(&path)?);
    let mut encoder = png::Encoder::new(file, (COLUMNS * SIZE) as u32, (3 * SIZE) as u32);
    encoder.set_color(png::ColorType::Rgb);
    encoder.write_header()?.write_image_data(&strip(&rows))?;
    println!("raw pictures, masks and results: {path}");
    Ok(())
}

/// Records an episode in which the expert closes a drawer.
fn episode() -> Result<Rows, Box<dyn Error>> {
    let camera = Camera { size: SIZE, ..Camera::default() };
    let scene = Arc::new(Scene::new(TaskGroup::DRAWER_CLOSE, Embodiment::SAWYER, camera)?);
    let mut table = TableTop::new(Arc::clone(&scene), Control::default())?;
    table.reset(D2::FlipX, &mut ChaCha8Rng::seed_from_u64(5))?;

    let arm = Arm::new(&scene.model)?;
    let settings = InpainterSettings {
        camera: arm::pinhole(&camera),
        arm_links: arm.links().to_vec(),
        colour_correction: ColorCorrection::MeanAndDeviation,
        gripper_mark: arm::mark(&camera),
    };
    let mut picture = vec![0; SIZE * SIZE * RGB_CHANNELS];
    SceneRenderer::without_arm(Arc::clone(&scene))?.render(&mut table, &mut picture)?;
    let mut inpainter = Inpainter::new(settings, &picture)?;
    let mut with_arm = SceneRenderer::with_arm(scene)?;

    let mut rows = Rows::default();
    for decision in 0..COLUMNS * EVERY {
        with_arm.render(&mut table, &mut picture)?;
        let mut result = picture.clone();
        inpainter.inpaint(&picture, &arm.joints(&table), table.hand_position(), &mut result)?;
        if decision % EVERY == 0 {
            let mask = inpainter.arm_mask().iter();
            let mask = mask.flat_map(|&hidden| [if hidden { 255 } else { 0 }; RGB_CHANNELS]);
            for (row, shown) in rows.iter_mut().zip([picture.clone(), mask.collect(), result]) {
                row.push(shown);
            }
        }
        let action = table.expert_action()?;
        table.step(&action)?;
    }
    Ok(rows)
}

/// Puts pictures side by side, row below row.
fn strip(rows: &Rows) -> Vec<u8> {
    let line = SIZE * RGB_CHANNELS;
    let lines = rows.iter().flat_map(|pictures| {
        (0..SIZE).flat_map(move |y| pictures.iter().flat_map(move |p| &p[y * line..][..line]))
    });
    lines.copied().collect()
}
