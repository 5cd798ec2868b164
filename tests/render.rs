//! What `covers render` draws, and what it refuses.

use std::fs;
use std::path::Path;

use covers::CoversError;
use covers::presets::Method;
use gif::{ColorOutput, DecodeOptions};

use crate::common::covers;
use crate::common::packed::small;
use crate::common::scratch::Scratch;

fn render(run: &Path, out: &Path, more: &[&str]) -> Result<String, CoversError> {
    let (run, to) = (run.display().to_string(), out.display().to_string());
    covers(&[&["render", &run, "--out", &to], more].concat())
}

/// The sides of a GIF, the number of its pictures, and its first one as `[height, width, 4]`.
fn read(path: &Path) -> ([usize; 2], usize, Vec<u8>) {
    let mut options = DecodeOptions::new();
    options.set_color_output(ColorOutput::RGBA);
    let mut decoder = options.read_info(fs::File::open(path).unwrap()).unwrap();
    let sides = [decoder.width(), decoder.height()].map(usize::from);
    let first = decoder.read_next_frame().unwrap().unwrap().buffer.to_vec();
    let mut count = 1;
    while decoder.read_next_frame().unwrap().is_some() {
        count += 1;
    }
    (sides, count, first)
}

/// Height of a row: its title, cells with borders, captions and a gap.
const ROW: usize = 20 + 150 + 20 + 6;

/// Rows of pixels of the cell in this column and row, without its border.
fn cell(picture: &[u8], width: usize, column: usize, row: usize) -> Vec<&[u8]> {
    let (left, top) = (9 + column * 156, 49 + row * ROW);
    let line = |y: usize| &picture[((top + y) * width + left) * 4..][..144 * 4];
    (0..144).map(line).collect()
}

#[test]
fn twins_that_are_mirrored_back_are_the_same_pictures() {
    let scratch = Scratch::new("render");
    let run = scratch.pack(&small(Method::Covers));
    let film = scratch.0.join("new/film.gif");
    let more = ["--group", "button-press", "--views", "seen,raw", "--twins"];
    let said = render(&run, &film, &more).unwrap();
    assert!(said.contains("button-press half turn: policy 0"), "{said}");
    assert!(!said.contains("goal-reach"), "{said}");
    let ([width, height], count, first) = read(&film);
    // the start and five decisions; two views and their twins
    let legend = 3 * 20 + 6;
    assert_eq!((width, height, count), (630, 6 + 20 + 4 * ROW + legend, 6));
    for row in [1, 3] {
        let identity = cell(&first, width, 0, row);
        assert!(identity.concat().chunks(4).any(|rgba| rgba != &identity[0][..4]));
        for column in 1..4 {
            assert!(cell(&first, width, column, row) == identity, "{row} {column}");
            assert!(cell(&first, width, column, row - 1) != identity);
        }
    }
}

#[test]
fn all_groups_are_shown_and_a_film_may_end_early() {
    let scratch = Scratch::new("render-all");
    let run = scratch.pack(&small(Method::Equi));
    let film = scratch.0.join("film.gif");
    let said = render(&run, &film, &["--decisions", "2"]).unwrap();
    assert_eq!(said.matches("policy 0").count(), 8, "{said}");
    let ([_, height], count, _) = read(&film);
    let legend = 2 * 20 + 6;
    assert_eq!((height, count), (6 + 20 + 2 * ROW + legend, 3));
}

#[test]
fn what_cannot_be_rendered_is_refused_with_the_reason() {
    let scratch = Scratch::new("render-refused");
    let run = scratch.pack(&small(Method::Covers));
    let there = scratch.0.join("there.gif");
    fs::write(&there, "a film").unwrap();
    let film = scratch.0.join("film.gif");
    let below_a_file = there.join("film.gif");
    for (source, out, more, expected) in [
        (&run, &film, &["--group", "button-pres"][..], "button-press"),
        (&run, &film, &["--group", "drawer-close"], "its groups are goal-reach, button-press"),
        (&run, &film, &["--views", "seen,perspective", "--twins"], "cannot be mirrored back"),
        (&scratch.0, &film, &[], "holds no run"),
        (&run, &there, &[], "exists already"),
        (&run, &below_a_file, &[], "cannot write"),
        (&run, &scratch.0.join("film.png"), &[], ".gif or .mp4"),
        (&run, &scratch.0.join("film"), &[], ".gif or .mp4"),
    ] {
        let message = render(source, out, more).unwrap_err().to_string();
        assert!(message.contains(expected), "{message}");
    }
    assert_eq!(fs::read(&there).unwrap(), b"a film");
    assert_eq!(fs::read_dir(&scratch.0).unwrap().count(), 2);
    let partial = scratch.0.join("film.gif.partial");
    fs::write(&partial, "a part").unwrap();
    let message = render(&run, &film, &[]).unwrap_err().to_string();
    assert!(message.contains("film.gif.partial exists"), "{message}");
    assert_eq!(fs::read(&partial).unwrap(), b"a part");
    let folder = scratch.0.join("new");
    assert!(render(&scratch.0, &folder.join("film.gif"), &[]).is_err());
    assert!(!folder.exists());
}
