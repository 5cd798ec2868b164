//! Colours and line styles by number, for groups (in the order of the schedule) and methods.

/// Colours for light and dark pages that colour-blind readers can distinguish (Okabe and Ito,
/// "Color Universal Design", 2008).
const COLOURS: [&str; 8] =
    ["#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#808080", "#8C8C00"];

/// Returns the colour of the curve with index `number` as `#RRGGBB`; colours repeat after eight.
pub fn curve_colour(number: usize) -> &'static str {
    COLOURS[number % COLOURS.len()]
}

/// Colour and dash pattern of a curve in a figure.
#[derive(Clone, Debug, PartialEq, Eq, Hash)]
pub struct LineStyle {
    /// Colour of the line, as SVG writes it.
    pub colour: &'static str,
    /// Lengths of dashes and gaps in turn (pixels), as SVG's `stroke-dasharray` lists them; empty
    /// for a solid line.
    pub dashes: String,
}

impl LineStyle {
    /// Returns the style of a solid line in `colour`.
    pub fn solid(colour: &'static str) -> Self {
        Self { colour, dashes: String::new() }
    }
}

/// Returns the colour and dash pattern of the curve with index `number`; no two indices share both.
/// The first eight curves are solid, the next eight dashed, and each later eight have one more dot
/// between dashes.
pub fn curve_style(number: usize) -> LineStyle {
    let round = number / COLOURS.len();
    let dots = round.checked_sub(1);
    LineStyle {
        colour: curve_colour(number),
        dashes: dots.map_or_else(String::new, |dots| "8 4".to_owned() + &" 2 4".repeat(dots)),
    }
}

/// Returns the colour of the curve with index `number` as red, green and blue bytes.
pub fn curve_rgb(number: usize) -> [u8; 3] {
    let hex = u32::from_str_radix(&curve_colour(number)[1..], 16).unwrap_or_default();
    // the highest byte of `0x00RRGGBB` is unused
    let [_, rgb @ ..] = hex.to_be_bytes();
    rgb
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_colour_is_the_same_as_a_word_and_as_numbers() {
        assert_eq!(curve_rgb(1), [0xd5, 0x5e, 0x00]);
        for number in 0..COLOURS.len() {
            let [r, g, b] = curve_rgb(number);
            assert_eq!(format!("#{r:02X}{g:02X}{b:02X}"), curve_colour(number));
        }
    }

    #[test]
    fn no_two_strokes_are_equal() {
        let strokes: Vec<LineStyle> = (0..100).map(curve_style).collect();
        assert!(itertools::Itertools::all_unique(&mut strokes.iter()));
        assert_eq!(strokes[7], LineStyle::solid("#8C8C00"));
        let patterns = [8, 16, 24].map(|number| strokes[number].dashes.as_str());
        assert_eq!(patterns, ["8 4", "8 4 2 4", "8 4 2 4 2 4"]);
    }
}
