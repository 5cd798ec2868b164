//! Encoding of films as GIF files.

use ::gif::{DisposalMethod, Encoder, EncodingError, Frame, Repeat};

use super::palette::Palette;

/// Palette index of pixels that did not change since the film's last picture.
const UNCHANGED: u8 = Palette::MAX_COLOURS as u8;

/// Encodes a film as a GIF file that repeats for ever.
///
/// # Errors
/// A film whose width or height is 0 or above 65535 pixels.
pub fn encode_gif(film: &Film) -> Result<Vec<u8>, EncodingError> {
    let side = |side: usize| u16::try_from(side).map_err(std::io::Error::other);
    let (width, height) = (side(film.width)?, side(film.height)?);
    let palette = Palette::from_pictures(film.frames.iter().map(Vec::as_slice));
    let mut colours = palette.rgb_bytes();
    // a palette of fewer colours would have no index `UNCHANGED`
    colours.resize(3 * (Palette::MAX_COLOURS + 1), 0);
    let mut bytes = Vec::new();
    let mut encoder = Encoder::new(&mut bytes, width, height, &colours)?;
    encoder.set_repeat(Repeat::Infinite)?;
    let mut before = Vec::new();
    for (number, picture) in film.frames.iter().enumerate() {
        let now = palette.indices(picture);
        let mut frame = difference(&before, &now, film.width);
        let last = number + 1 == film.frames.len();
        frame.delay = DELAY_CENTISECONDS * if last { HOLD_DELAYS } else { 1 };
        encoder.write_frame(&frame)?;
        before = now;
    }
    drop(encoder);
    Ok(bytes)
}

/// Returns a GIF frame of the smallest rectangle that holds all pixels that changed since `before`.
fn difference(before: &[u8], now: &[u8], width: usize) -> Frame<'static> {
    let changed = |pixel: &usize| before.get(*pixel) != now.get(*pixel);
    let changes = || (0..now.len()).filter(changed);
    let columns = || changes().map(|pixel| pixel % width);
    let (left, right) = (columns().min().unwrap_or(0), columns().max().unwrap_or(0));
    let rows = |pixel: Option<usize>| pixel.unwrap_or(0) / width;
    let (top, bottom) = (rows(changes().next()), rows(changes().next_back()));
    let pixels = (top..=bottom).flat_map(|row| (left..=right).map(move |x| row * width + x));
    let pixels = pixels.map(|pixel| if changed(&pixel) { now[pixel] } else { UNCHANGED });
    Frame {
        left: left as u16,
        top: top as u16,
        width: (right - left + 1) as u16,
        height: (bottom - top + 1) as u16,
        transparent: Some(UNCHANGED),
        dispose: DisposalMethod::Keep,
        buffer: pixels.collect(),
        ..Frame::default()
    }
}

/// Delay between pictures of a film (hundredths of a second), which makes 12.5 pictures per second.
/// A decision lasts 0.125 s, so a film runs at about one and a half times the simulated speed.
pub(super) const DELAY_CENTISECONDS: u16 = 8;
/// Time for which a film's last picture stays before the film repeats, in delays between pictures.
pub(super) const HOLD_DELAYS: u16 = 12;

/// Film: a sequence of pictures of one size, shown at 12.5 pictures per second.
#[derive(Clone, Debug, Default, PartialEq, Eq)]
pub struct Film {
    /// Width of the film's pictures (pixels).
    pub width: usize,
    /// Height of the film's pictures (pixels).
    pub height: usize,
    /// Pictures of the film in order, each RGB bytes `[height, width, 3]` with row 0 on top.
    pub frames: Vec<Vec<u8>>,
}

#[cfg(test)]
mod tests {
    use super::*;
    use ::gif::{ColorOutput, DecodeOptions};

    /// Film of three pictures: a dot moves, then rests.
    fn film() -> Film {
        let (width, height) = (5, 3);
        let frame = |dot: usize| {
            let colour = |pixel| {
                if pixel == dot { [200, 0, 7] } else { [pixel as u8, 90, 90] }
            };
            (0..width * height).flat_map(colour).collect()
        };
        Film { width, height, frames: [1, 8, 8].map(frame).to_vec() }
    }

    /// Returns the pictures that a viewer shows, each with its delay.
    fn shown(bytes: &[u8]) -> Vec<(Vec<u8>, u16)> {
        let mut options = DecodeOptions::new();
        options.set_color_output(ColorOutput::RGBA);
        let mut decoder = options.read_info(bytes).unwrap();
        let colours = decoder.global_palette().unwrap().len() / 3;
        assert!(colours > usize::from(UNCHANGED), "{colours}");
        let (width, height) = (usize::from(decoder.width()), usize::from(decoder.height()));
        let mut screen = vec![0; width * height * 3];
        let mut pictures = Vec::new();
        while let Some(frame) = decoder.read_next_frame().unwrap() {
            let [left, top, across] = [frame.left, frame.top, frame.width].map(usize::from);
            for (pixel, rgba) in frame.buffer.chunks_exact(4).enumerate() {
                let at = ((top + pixel / across) * width + left + pixel % across) * 3;
                if rgba[3] > 0 {
                    screen[at..at + 3].copy_from_slice(&rgba[..3]);
                }
            }
            pictures.push((screen.clone(), frame.delay));
        }
        pictures
    }

    #[test]
    fn a_viewer_shows_the_pictures_of_the_film() {
        let film = film();
        let bytes = encode_gif(&film).unwrap();
        let shown = shown(&bytes);
        let delays = [DELAY_CENTISECONDS, DELAY_CENTISECONDS, DELAY_CENTISECONDS * HOLD_DELAYS];
        assert_eq!(shown.len(), 3);
        for ((picture, delay), (frame, expected)) in
            shown.iter().zip(film.frames.iter().zip(delays))
        {
            assert_eq!((picture, *delay), (frame, expected));
        }
    }

    #[test]
    fn only_what_changes_is_kept() {
        let frame = difference(&[1, 2, 3, 4, 5, 6], &[1, 2, 9, 4, 7, 6], 3);
        assert_eq!((frame.left, frame.top, frame.width, frame.height), (1, 0, 2, 2));
        assert_eq!(frame.buffer[..], [UNCHANGED, 9, 7, UNCHANGED]);
        let same = difference(&[1, 2], &[1, 2], 2);
        assert_eq!((same.width, same.height, same.buffer[0]), (1, 1, UNCHANGED));
    }

    #[test]
    fn pictures_that_are_too_large_for_the_format_are_refused() {
        let film = Film { width: 70_000, height: 1, frames: vec![vec![0; 210_000]] };
        assert!(encode_gif(&film).is_err());
    }
}
