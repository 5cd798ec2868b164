//! Contact sheet: the first image of every variant, as evaluations show it, without close-ups.

use std::sync::Arc;

use envs::{GripperMark, RGB_CHANNELS, Scene, SceneRenderer, TableTop, TaskGroup, VecEnvSettings};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use symmetry::D2;

use crate::error::RunError;

/// RGB image of any size.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Picture {
    /// Width of the image in pixels.
    pub width: usize,
    /// Height of the image in pixels.
    pub height: usize,
    /// RGB bytes of the image `[height, width, 3]`, row 0 on top.
    pub rgb: Vec<u8>,
}

impl Picture {
    /// Encodes the image as a PNG file.
    ///
    /// # Errors
    /// An image whose number of bytes does not fit its size.
    pub fn to_png(&self) -> Result<Vec<u8>, png::EncodingError> {
        let mut bytes = Vec::new();
        let (width, height) = (self.width as u32, self.height as u32);
        let mut encoder = png::Encoder::new(&mut bytes, width, height);
        encoder.set_color(png::ColorType::Rgb);
        encoder.set_depth(png::BitDepth::Eight);
        let mut writer = encoder.write_header()?;
        writer.write_image_data(&self.rgb)?;
        writer.finish()?;
        Ok(bytes)
    }

    /// Decodes a PNG file of 8-bit RGB; `None` for any other file.
    pub fn from_png(bytes: &[u8]) -> Option<Self> {
        let reader = png::Decoder::new(std::io::Cursor::new(bytes)).read_info();
        let mut reader = reader.ok()?;
        let mut rgb = vec![0; reader.output_buffer_size()?];
        let info = reader.next_frame(&mut rgb).ok()?;
        let fits = (info.color_type, info.bit_depth) == (png::ColorType::Rgb, png::BitDepth::Eight);
        fits.then_some(Self { width: info.width as usize, height: info.height as usize, rgb })
    }
}

/// Factor by which the contact sheet enlarges images along each side.
const ENLARGE: usize = 4;
/// Width of the white border around each image of the contact sheet (pixels).
const GAP: usize = 6;

/// Colour (RGB) of the mark at a goal that the learner observes as a vector, and that images do not
/// show.
pub const GOAL_MARK_COLOUR: [u8; 3] = [0, 200, 0];

/// Renders the first image of every variant, `[group][element]`, each RGB bytes `[size, size, 3]`.
/// The four variants of a group share one placement. A green disc marks goals that are observed as
/// vectors.
///
/// # Errors
/// Errors of the environments.
pub fn variant_pictures(
    settings: &VecEnvSettings,
    groups: &[TaskGroup],
) -> Result<Vec<Vec<Vec<u8>>>, RunError> {
    groups.iter().map(|&group| group_pictures(group, settings)).collect()
}

fn group_pictures(group: TaskGroup, settings: &VecEnvSettings) -> Result<Vec<Vec<u8>>, RunError> {
    let (embodiment, camera) = (settings.embodiment, settings.camera);
    let scene = Scene::new_in_layout(settings.layout, group, embodiment, camera)?;
    let scene = Arc::new(scene);
    let mut table = TableTop::new(Arc::clone(&scene), settings.control)?;
    let mut renderer = SceneRenderer::new(scene)?;
    let placement =
        group.identity_task().sample_placement(&mut ChaCha8Rng::seed_from_u64(settings.seed));
    D2::ALL
        .into_iter()
        .map(|element| {
            let mut rgb = vec![0; settings.camera.size * settings.camera.size * RGB_CHANNELS];
            table.reset_to(element, placement)?;
            renderer.render(&mut table, &mut rgb)?;
            mark_goal(&table, &mut rgb);
            Ok(rgb)
        })
        .collect()
}

/// Draws a green mark over an image `[size, size, 3]` of `table` at the goal if it is observed as a
/// vector; else nothing.
pub fn mark_goal(table: &TableTop, rgb: &mut [u8]) {
    if let Some(goal) = table.observable_goal() {
        let camera = table.scene().camera;
        let mark = GripperMark { color: GOAL_MARK_COLOUR, ..camera.mark };
        camera.draw_gripper_mark(&mark, goal, rgb);
    }
}

/// Renders the contact sheet of the first images of all variants: one row per group, one column per
/// element (identity, flip x, flip y, half turn), enlarged on white.
///
/// # Errors
/// Errors of the environments.
pub fn contact_sheet(settings: &VecEnvSettings, groups: &[TaskGroup]) -> Result<Picture, RunError> {
    let pictures = variant_pictures(settings, groups)?;
    let size = settings.camera.size;
    let cell = size * ENLARGE + GAP;
    let (width, height) = (D2::ALL.len() * cell + GAP, pictures.len() * cell + GAP);
    let mut rgb = vec![255; width * height * RGB_CHANNELS];
    for (row, variants) in pictures.iter().enumerate() {
        for (column, picture) in variants.iter().enumerate() {
            let origin = (GAP + row * cell, GAP + column * cell);
            draw_enlarged_picture(picture, size, &mut rgb, width, origin);
        }
    }
    Ok(Picture { width, height, rgb })
}

/// Crops the first variant of the group with index `group` from a contact sheet, four times as
/// large as the rendered image of `size` pixels a side; `None` if the sheet is too small.
pub fn crop_first_variant(sheet: &Picture, size: usize, group: usize) -> Option<Picture> {
    let side = size * ENLARGE;
    let (top, left) = (GAP + group * (side + GAP), GAP);
    if left + side > sheet.width || top + side > sheet.height {
        return None;
    }
    let rows = sheet.rgb.chunks_exact(sheet.width * RGB_CHANNELS).skip(top).take(side);
    let rows = rows.map(|row| &row[left * RGB_CHANNELS..(left + side) * RGB_CHANNELS]);
    Some(Picture { width: side, height: side, rgb: rows.flatten().copied().collect() })
}

fn draw_enlarged_picture(
    picture: &[u8],
    size: usize,
    sheet: &mut [u8],
    width: usize,
    origin: (usize, usize),
) {
    for y in 0..size * ENLARGE {
        for x in 0..size * ENLARGE {
            let from = ((y / ENLARGE) * size + x / ENLARGE) * RGB_CHANNELS;
            let to = ((origin.0 + y) * width + origin.1 + x) * RGB_CHANNELS;
            sheet[to..to + RGB_CHANNELS].copy_from_slice(&picture[from..from + RGB_CHANNELS]);
        }
    }
}
