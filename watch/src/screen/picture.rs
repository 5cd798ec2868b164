//! A picture in half blocks: two pixels a cell, one above the other.

use envs::RGB;
use ratatui::buffer::Buffer;
use ratatui::layout::Rect;
use ratatui::style::Color;

use experiments::sheet::Picture;

/// As large a part of an area as has the picture's own shape.
pub fn fit(picture: &Picture, area: Rect) -> Rect {
    let (width, height) = (picture.width.max(1), picture.height.max(1));
    let (across, down) = (usize::from(area.width), 2 * usize::from(area.height));
    // the side that is the narrower one
    let (across, down) = match across * height <= down * width {
        true => (across, across * height / width),
        false => (down * width / height, down),
    };
    Rect::new(area.x, area.y, across as u16, (down / 2) as u16)
}

/// Fills an area, which [`fit`] has chosen.
pub fn draw(picture: &Picture, area: Rect, buffer: &mut Buffer) {
    let (across, down) = (usize::from(area.width), 2 * usize::from(area.height));
    for y in 0..down / 2 {
        for x in 0..across {
            let pixel = |row: usize| mean(picture, [x, row], [across, down]);
            let cell = &mut buffer[(area.x + x as u16, area.y + y as u16)];
            cell.set_char('▀').set_fg(pixel(2 * y)).set_bg(pixel(2 * y + 1));
        }
    }
}

/// The mean colour of the part of a picture that one of `[across, down]` pixels stands for.
fn mean(picture: &Picture, at: [usize; 2], of: [usize; 2]) -> Color {
    let range = |axis: usize, side: usize| {
        let from = at[axis] * side / of[axis];
        from..((at[axis] + 1) * side / of[axis]).max(from + 1)
    };
    let columns = range(0, picture.width);
    let (mut sums, mut count) = ([0_usize; RGB], 0);
    for y in range(1, picture.height) {
        let row = &picture.rgb[y * picture.width * RGB..][columns.start * RGB..columns.end * RGB];
        for pixel in row.chunks_exact(RGB) {
            sums.iter_mut().zip(pixel).for_each(|(sum, &part)| *sum += usize::from(part));
            count += 1;
        }
    }
    let [r, g, b] = sums.map(|sum| (sum / count) as u8);
    Color::Rgb(r, g, b)
}
