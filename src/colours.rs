//! Colours by number: of groups in the order of a run's schedule, and of methods.

/// Colours that colour-blind people tell apart (Okabe and Ito, "Color Universal Design", 2008), on
/// a light and on a dark page.
const COLOURS: [&str; 8] = [
    "#0072B2", "#D55E00", "#009E73", "#CC79A7", "#E69F00", "#56B4E9", "#808080", "#8C8C00",
];
/// The colour of the one with this number.
pub fn colour(number: usize) -> &'static str {
    COLOURS[number % COLOURS.len()]
}

/// The same as red, green and blue.
pub fn rgb(number: usize) -> [u8; 3] {
    let hex = u32::from_str_radix(&colour(number)[1..], 16).unwrap_or_default();
    let [_, rgb @ ..] = hex.to_be_bytes();
    rgb
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_colour_is_the_same_as_a_word_and_as_numbers() {
        assert_eq!(rgb(1), [0xd5, 0x5e, 0x00]);
        for number in 0..COLOURS.len() {
            let [r, g, b] = rgb(number);
            assert_eq!(format!("#{r:02X}{g:02X}{b:02X}"), colour(number));
        }
    }
}
