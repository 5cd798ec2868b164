//! Text of films.

use std::sync::LazyLock;

use ab_glyph::{Font, FontRef, PxScale, ScaleFont, point};
use epaint_default_fonts::UBUNTU_LIGHT;

/// Height of a line of text (pixels).
pub(super) const LINE_HEIGHT: usize = 18;

static FONT: LazyLock<Option<FontRef<'static>>> =
    LazyLock::new(|| FontRef::try_from_slice(UBUNTU_LIGHT).ok());

/// Calls `draw` with the `[x, y]` of each pixel of `text` from its top left corner, and the share of
/// the pixel that the text covers, in `(0, 1]`.
pub(super) fn for_each_pixel(text: &str, mut draw: impl FnMut([usize; 2], f32)) {
    let Some(font) = &*FONT else { return };
    let font = font.as_scaled(PxScale::from(LINE_HEIGHT as f32 - 1.0));
    let (mut x, mut before) = (0.0, None);
    for letter in text.chars() {
        let mut glyph = font.scaled_glyph(letter);
        x += before.map_or(0.0, |before| font.kern(before, glyph.id));
        glyph.position = point(x, font.ascent());
        (x, before) = (x + font.h_advance(glyph.id), Some(glyph.id));
        let Some(outline) = font.outline_glyph(glyph) else { continue };
        let corner = outline.px_bounds().min;
        outline.draw(|right, down, cover| {
            // a letter may begin a little left of its place or above the line
            let at = [corner.x + right as f32, corner.y + down as f32];
            if cover > 0.0 && at.iter().all(|&at| at >= 0.0) {
                draw(at.map(|at| at as usize), cover.min(1.0));
            }
        });
    }
}

/// Returns the width of a line of text (pixels).
pub(super) fn text_width(text: &str) -> usize {
    let mut width = 0;
    for_each_pixel(text, |[x, _], _| width = width.max(x + 1));
    width
}

#[cfg(test)]
mod tests {
    use super::*;

    /// Returns the ink in each column of a text.
    fn columns(text: &str) -> Vec<f32> {
        let mut ink = vec![0.0; 400];
        for_each_pixel(text, |[x, y], cover| {
            assert!(y < LINE_HEIGHT, "{text}");
            ink[x] += cover;
        });
        ink
    }

    #[test]
    fn letters_follow_one_another() {
        let last = |text: &str| columns(text).iter().rposition(|&ink| ink > 0.0);
        assert!(last("goal") < last("goal-reach") && last("i") < last("m"));
        assert_eq!(last(" "), None);
        // the stem of an l is its only ink
        assert!(columns("l").iter().filter(|&&ink| ink > 0.0).count() <= 3);
        assert_ne!(columns("policy 1"), columns("policy 2"));
        assert_eq!(text_width("goal"), last("goal").map_or(0, |x| x + 1));
    }
}
