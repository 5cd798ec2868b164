//! Grid of films that play side by side as one film.

use super::canvas::Canvas;
use super::font::LINE_HEIGHT;
use super::gif::Film;

/// Approximate height of a cell of the grid (pixels); pictures are enlarged by a whole number.
const HEIGHT: usize = 144;
/// Width of the border of a cell of the grid (pixels).
const BORDER: usize = 3;
/// Distance between cells of the grid, and from the edge of the film (pixels).
const GAP: usize = 6;
/// Height of a line of text with the gap below it (pixels).
const LINE: usize = LINE_HEIGHT + 2;
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

/// Composes rows of films into one film, with a title over each row and a name over each column.
pub fn compose_film_grid(columns: &[&str], rows: &[FilmGridRow]) -> Film {
    let layout = GridLayout::of(rows);
    let empty = layout.canvas(columns, rows);
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

/// Distances (pixels) between the cells of a grid of films.
struct GridLayout {
    /// Distance from one column of the grid to the next.
    across: usize,
    /// Distance from one row of the grid to the next.
    down: usize,
}

impl GridLayout {
    fn of(rows: &[FilmGridRow]) -> Self {
        let sizes = || rows.iter().flat_map(|row| &row.cells).map(FilmGridCell::size);
        let [width, height] = [0, 1].map(|side| sizes().map(|size| size[side]).max().unwrap_or(0));
        Self { across: width + GAP, down: height + GAP + LINE }
    }

    /// Iterates over the cells of a grid with their top left corners `[x, y]` (pixels).
    fn cells<'a>(
        &self,
        rows: &'a [FilmGridRow],
    ) -> impl Iterator<Item = (&'a FilmGridCell, [usize; 2])> {
        let (across, down) = (self.across, self.down);
        rows.iter().enumerate().flat_map(move |(number, row)| {
            let top = GAP + 2 * LINE + number * down;
            let cells = row.cells.iter().enumerate();
            cells.map(move |(column, cell)| (cell, [GAP + column * across, top]))
        })
    }

    /// Draws names, titles and borders of the grid, which are the same in all pictures of the film.
    fn canvas(&self, columns: &[&str], rows: &[FilmGridRow]) -> Canvas {
        let (across, down) = (self.across, self.down);
        let mut canvas = Canvas::new(GAP + columns.len() * across, GAP + LINE + rows.len() * down);
        for (column, name) in columns.iter().enumerate() {
            canvas.draw_text(name, [GAP + column * across, GAP], INK);
        }
        for (number, row) in rows.iter().enumerate() {
            let top = GAP + LINE + number * down;
            canvas.draw_text(&row.title, [GAP, top], row.colour);
            for (column, cell) in row.cells.iter().enumerate() {
                // the picture will be pasted over all but the border
                canvas.fill_rectangle([GAP + column * across, top + LINE], cell.size(), row.colour);
            }
        }
        canvas
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn cell(frames: usize) -> FilmGridCell {
        let frame = |number| (0..72 * 48).flat_map(|_| [number as u8, 9, 9]).collect();
        FilmGridCell { width: 72, height: 48, frames: (0..frames).map(frame).collect() }
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
        let film = compose_film_grid(&["", ""], &[row]);
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
        let film = compose_film_grid(&["seen"], &[row]);
        let dark = |line: usize| {
            let rows =
                3 * film.width * (GAP + line * LINE)..3 * film.width * (GAP + (line + 1) * LINE);
            let pixels = film.frames[0][rows].chunks_exact(3);
            pixels.filter(|pixel| pixel.iter().all(|&level| level < 128)).count()
        };
        // the name of the column, and the title below it
        assert!(dark(0) > 20 && dark(1) > 200, "{} {}", dark(0), dark(1));
    }
}
