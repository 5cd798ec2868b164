//! Picture of a film on which rectangles, text, curves and other pictures are drawn.

use super::font::for_each_pixel;

/// Level (0 to 255) of all channels of a film's background.
const WHITE: u8 = 255;

/// RGB picture to draw on; parts of shapes beyond its edges are not drawn.
#[derive(Clone)]
pub(super) struct Canvas {
    pub width: usize,
    pub height: usize,
    /// Bytes `[height, width, 3]`, the top row first.
    pub rgb: Vec<u8>,
}

impl Canvas {
    /// Creates a white picture.
    pub fn new(width: usize, height: usize) -> Self {
        Self { width, height, rgb: vec![WHITE; width * height * 3] }
    }

    /// Blends a colour into a pixel; a `share` of 1 replaces the pixel's colour.
    pub fn blend_pixel(&mut self, [x, y]: [usize; 2], rgb: [u8; 3], share: f32) {
        if x < self.width && y < self.height {
            let pixel = &mut self.rgb[(y * self.width + x) * 3..][..3];
            for (old, new) in pixel.iter_mut().zip(rgb) {
                *old = (f32::from(*old) * (1.0 - share) + f32::from(new) * share).round() as u8;
            }
        }
    }

    /// Blends a colour into all pixels of a rectangle.
    pub fn blend_rectangle(
        &mut self,
        [left, top]: [usize; 2],
        [width, height]: [usize; 2],
        rgb: [u8; 3],
        share: f32,
    ) {
        for y in top..top + height {
            (left..left + width).for_each(|x| self.blend_pixel([x, y], rgb, share));
        }
    }

    /// Fills a rectangle with one colour.
    pub fn fill_rectangle(&mut self, corner: [usize; 2], size: [usize; 2], rgb: [u8; 3]) {
        self.blend_rectangle(corner, size, rgb, 1.0);
    }

    /// Draws a line of text whose top left corner is at `[left, top]`.
    pub fn draw_text(&mut self, text: &str, [left, top]: [usize; 2], rgb: [u8; 3]) {
        for_each_pixel(text, |[x, y], cover| self.blend_pixel([left + x, top + y], rgb, cover));
    }

    /// Draws a line two pixels wide from one point to another, `[x, y]` in pixels.
    pub fn draw_line(&mut self, from: [f64; 2], to: [f64; 2], rgb: [u8; 3]) {
        let steps = (to[0] - from[0]).abs().max((to[1] - from[1]).abs()).ceil().max(1.0);
        for step in 0..=steps as usize {
            let share = step as f64 / steps;
            let at = [0, 1].map(|axis| from[axis] + share * (to[axis] - from[axis]));
            self.fill_rectangle(at.map(|at| at.round().max(0.0) as usize), [2, 2], rgb);
        }
    }

    /// Draws a picture of RGB bytes and `width` columns with its top left corner at `[left, top]`,
    /// each pixel as a square with sides of `enlarge` pixels.
    pub fn draw_enlarged_picture(
        &mut self,
        picture: &[u8],
        width: usize,
        enlarge: usize,
        [left, top]: [usize; 2],
    ) {
        for (pixel, rgb) in picture.as_chunks().0.iter().enumerate() {
            let [x, y] = [pixel % width, pixel / width].map(|at| at * enlarge);
            self.fill_rectangle([left + x, top + y], [enlarge; 2], *rgb);
        }
    }
}
