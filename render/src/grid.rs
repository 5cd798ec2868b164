//! Grid of films that play side by side as one film.

use super::canvas::Canvas;
use super::font::{LINE_HEIGHT, text_width};
use super::gif::Film;

/// Approximate height of a cell of the grid (pixels); pictures are enlarged by a whole number.
const HEIGHT: usize = 144;
/// Width of the border of a cell of the grid (pixels).
const BORDER: usize = 3;
/// Distance between cells of the grid, and from the edge of the film (pixels).
const GAP: usize = 6;
/// Height of a line of text with the gap below it (pixels).
const LINE: usize = LINE_HEIGHT + 2;
/// Side of the coloured square of an entry in a legend (pixels).
const SWATCH: usize = 10;
/// Colour of the names above the grid's columns (RGB).
pub(super) const INK: [u8; 3] = [0x1b, 0x1f, 0x24];

/// Film in a cell of a grid. Its last picture stays until the longest film ends.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FilmGridCell {
    /// Width of the cell's pictures (pixels).
    pub width: usize,
    /// Height of the cell's pictures (pixels).
    pub height: usize,
    /// Pictures of the cell's film in order, each RGB bytes `[height, width, 3]`; at least one.
    pub frames: Vec<Vec<u8>>,
    /// Line of text below the cell, such as the outcome of its episode; `None` for no line.
    pub caption: Option<FilmCaption>,
}

/// Line of text below a cell of a film grid.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FilmCaption {
    /// Text of the caption.
    pub text: String,
    /// Colour of the caption (RGB).
    pub colour: [u8; 3],
}

/// Explanation of what a film shows, in the legend below it.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct FilmLegendEntry {
    /// Colour (RGB) that the entry explains, shown as a square; `None` for text alone.
    pub swatch: Option<[u8; 3]>,
    /// Text of the legend's entry.
    pub text: String,
}

impl FilmGridCell {
    /// Returns the whole number by which the cell's pictures are enlarged.
    fn enlarge(&self) -> usize {
        ((HEIGHT + self.height / 2) / self.height).max(1)
    }

    /// Returns width and height of the cell in the grid with its border (pixels).
    fn size(&self) -> [usize; 2] {
        [self.width, self.height].map(|side| side * self.enlarge() + 2 * BORDER)
    }
}

/// Row of films in a grid, with a title.
pub struct FilmGridRow {
    /// Title above the row of films.
    pub title: String,
    /// Colour of the title (RGB).
    pub colour: [u8; 3],
    /// Films of the grid's row, from left to right.
    pub cells: Vec<FilmGridCell>,
}

impl FilmGridRow {
    /// Returns the height of the row with its title, captions and the gap below it (pixels).
    fn height(&self) -> usize {
        let tallest = self.cells.iter().map(|cell| cell.size()[1]).max().unwrap_or(0);
        let has_captions = self.cells.iter().any(|cell| cell.caption.is_some());
        LINE + tallest + if has_captions { LINE } else { 0 } + GAP
    }
}

/// Composes rows of films into one film, with a title over each row, a name over each column and a
/// legend below all rows.
pub fn compose_film_grid(
    columns: &[&str],
    rows: &[FilmGridRow],
    legend: &[FilmLegendEntry],
) -> Film {
    let layout = GridLayout::of(columns, rows, legend);
    let empty = layout.canvas(columns, rows, legend);
    let lengths = rows.iter().flat_map(|row| &row.cells);
    let length = lengths.map(|cell| cell.frames.len()).max().unwrap_or(0);
    let frame = |time| {
        let mut canvas = empty.clone();
        for (cell, [left, top]) in layout.cells(rows) {
            // a film that has ended keeps its last picture
            if let Some(picture) = cell.frames.get(time).or(cell.frames.last()) {
                canvas.draw_enlarged_picture(
                    picture,
                    cell.width,
                    cell.enlarge(),
                    [left + BORDER, top + BORDER],
                );
            }
        }
        canvas.rgb
    };
    Film { width: empty.width, height: empty.height, frames: (0..length).map(frame).collect() }
}

/// Positions (pixels) of the parts of a grid of films.
struct GridLayout {
    width: usize,
    /// Distance from one column of the grid to the next.
    across: usize,
    /// Tops of the titles of the rows, and last the bottom of all rows.
    tops: Vec<usize>,
    /// Top left corner of each entry of the legend.
    legend: Vec<[usize; 2]>,
}

impl GridLayout {
    fn of(columns: &[&str], rows: &[FilmGridRow], legend: &[FilmLegendEntry]) -> Self {
        let cells = rows.iter().flat_map(|row| &row.cells);
        let across = cells.map(|cell| cell.size()[0]).max().unwrap_or(0) + GAP;
        let mut tops = vec![GAP + LINE];
        for row in rows {
            tops.push(tops[tops.len() - 1] + row.height());
        }
        let width = GAP + columns.len() * across;
        let bottom = tops[tops.len() - 1];
        Self { width, across, legend: legend_corners(legend, width, bottom), tops }
    }

    fn height(&self) -> usize {
        let bottom = self.tops[self.tops.len() - 1];
        self.legend.last().map_or(bottom, |corner| corner[1] + LINE + GAP)
    }

    /// Iterates over the cells of a grid with their top left corners `[x, y]` (pixels).
    fn cells<'a>(
        &self,
        rows: &'a [FilmGridRow],
    ) -> impl Iterator<Item = (&'a FilmGridCell, [usize; 2])> {
        let across = self.across;
        rows.iter().zip(&self.tops).flat_map(move |(row, top)| {
            let cells = row.cells.iter().enumerate();
            cells.map(move |(column, cell)| (cell, [GAP + column * across, top + LINE]))
        })
    }

    /// Draws names, titles, borders, captions and the legend of the grid, which are the same in all
    /// pictures of the film.
    fn canvas(&self, columns: &[&str], rows: &[FilmGridRow], legend: &[FilmLegendEntry]) -> Canvas {
        let mut canvas = Canvas::new(self.width, self.height());
        for (column, name) in columns.iter().enumerate() {
            canvas.draw_text(name, [GAP + column * self.across, GAP], INK);
        }
        for (row, &top) in rows.iter().zip(&self.tops) {
            canvas.draw_text(&row.title, [GAP, top], row.colour);
            for (column, cell) in row.cells.iter().enumerate() {
                let [left, top] = [GAP + column * self.across, top + LINE];
                // the picture will be pasted over all but the border
                canvas.fill_rectangle([left, top], cell.size(), row.colour);
                if let Some(caption) = &cell.caption {
                    let below = [left, top + cell.size()[1] + 1];
                    canvas.draw_text(&caption.text, below, caption.colour);
                }
            }
        }
        for (entry, &corner) in legend.iter().zip(&self.legend) {
            draw_legend_entry(&mut canvas, entry, corner);
        }
        canvas
    }
}

/// Returns the top left corners of the entries of a legend below `bottom`, side by side as far as
/// they fit into `width`.
fn legend_corners(legend: &[FilmLegendEntry], width: usize, bottom: usize) -> Vec<[usize; 2]> {
    let [mut left, mut top] = [GAP, bottom];
    let corner = |entry: &FilmLegendEntry| {
        let own = legend_entry_width(entry);
        if left > GAP && left + own + GAP > width {
            [left, top] = [GAP, top + LINE];
        }
        let corner = [left, top];
        left += own + 3 * GAP;
        corner
    };
    legend.iter().map(corner).collect()
}

/// Returns the width of an entry of a legend (pixels).
fn legend_entry_width(entry: &FilmLegendEntry) -> usize {
    let swatch = if entry.swatch.is_some() { SWATCH + GAP } else { 0 };
    swatch + text_width(&entry.text)
}

/// Draws an entry of a legend with its top left corner at `[left, top]`.
fn draw_legend_entry(canvas: &mut Canvas, entry: &FilmLegendEntry, [mut left, top]: [usize; 2]) {
    if let Some(colour) = entry.swatch {
        let below = top + (LINE_HEIGHT - SWATCH) / 2 + 1;
        // the edge shows a white square on the white paper
        canvas.fill_rectangle([left, below], [SWATCH; 2], INK);
        canvas.fill_rectangle([left + 1, below + 1], [SWATCH - 2; 2], colour);
        left += SWATCH + GAP;
    }
    canvas.draw_text(&entry.text, [left, top], INK);
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cell(frames: usize) -> FilmGridCell {
        let frame = |number| (0..72 * 48).flat_map(|_| [number as u8, 9, 9]).collect();
        FilmGridCell {
            width: 72,
            height: 48,
            frames: (0..frames).map(frame).collect(),
            caption: None,
        }
    }

    fn count(film: &Film, time: usize, rgb: [u8; 3]) -> usize {
        let pixels = film.frames[time].chunks_exact(3);
        pixels.filter(|pixel| **pixel == rgb).count()
    }

    #[test]
    fn cells_are_enlarged_side_by_side_with_borders_and_the_shorter_film_waits() {
        let row = FilmGridRow {
            title: String::new(),
            colour: [0, 0, 255],
            cells: vec![cell(2), cell(3)],
        };
        let film = compose_film_grid(&["", ""], &[row], &[]);
        assert_eq!((film.frames.len(), film.width), (3, 6 + 2 * (216 + 12)));
        assert_eq!(film.height, 6 + 20 + 20 + 144 + 12);
        let area = 216 * 144;
        assert_eq!(count(&film, 1, [1, 9, 9]), 2 * area);
        assert_eq!(count(&film, 2, [1, 9, 9]), area);
        assert_eq!(count(&film, 2, [2, 9, 9]), area);
        assert_eq!(count(&film, 0, [0, 0, 255]), 2 * (222 * 150 - area));
    }

    #[test]
    fn titles_have_the_colour_of_their_row_and_stay_on_the_paper() {
        let row = FilmGridRow {
            title: "a long title ".repeat(9),
            colour: [1, 2, 3],
            cells: vec![cell(1)],
        };
        let film = compose_film_grid(&["seen"], &[row], &[]);
        let dark = |line: usize| {
            let rows =
                3 * film.width * (GAP + line * LINE)..3 * film.width * (GAP + (line + 1) * LINE);
            let pixels = film.frames[0][rows].chunks_exact(3);
            pixels.filter(|pixel| pixel.iter().all(|&level| level < 128)).count()
        };
        // the name of the column, and the title below it
        assert!(dark(0) > 20 && dark(1) > 200, "{} {}", dark(0), dark(1));
    }

    #[test]
    fn captions_stand_below_their_cells_and_the_legend_below_all() {
        let (red, blue) = ([200, 0, 0], [0, 0, 255]);
        let caption = FilmCaption { text: "policy 1 fails".to_owned(), colour: red };
        let captioned = FilmGridCell { caption: Some(caption), ..cell(1) };
        let row = |cells| FilmGridRow { title: String::new(), colour: [0, 255, 0], cells };
        let entry = |swatch, text: &str| FilmLegendEntry { swatch, text: text.to_owned() };
        let rows = [row(vec![cell(1), captioned]), row(vec![cell(1)])];
        let plain = compose_film_grid(&["", ""], &rows, &[]);
        assert_eq!(plain.height, 6 + 20 + (20 + 150 + 20 + 6) + (20 + 150 + 6));
        let legend = [entry(Some(blue), "gripper"), entry(None, &"a long line ".repeat(6))];
        let film = compose_film_grid(&["", ""], &rows, &legend);
        // the second entry does not fit beside the first one
        assert_eq!(film.height, plain.height + 2 * 20 + 6);
        assert_eq!(count(&film, 0, blue), 8 * 8);
        let top = 6 + 20 + 20 + 150;
        // edges of letters are lighter
        let is_red = |rgb: &[u8]| rgb[0] >= red[0] && rgb[1] < 150 && rgb[1] == rgb[2];
        let below: Vec<usize> = (0..film.width * film.height)
            .filter(|pixel| is_red(&film.frames[0][3 * pixel..][..3]))
            .collect();
        assert!(below.len() > 50, "{}", below.len());
        for pixel in below {
            let (x, y) = (pixel % film.width, pixel / film.width);
            assert!((6 + 228..6 + 2 * 228).contains(&x) && (top..top + 20).contains(&y), "{x} {y}");
        }
    }
}
