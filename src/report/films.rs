//! Films of policies, inside of the page.

use super::run_data::{GroupFilm, RunData};
use super::svg::escaped;

/// Signs that stand for six bits each (RFC 4648, section 4).
const SIGNS: &[u8; 64] = b"ABCDEFGHIJKLMNOPQRSTUVWXYZabcdefghijklmnopqrstuvwxyz0123456789+/";

/// The films of a run, one below the other; nothing where there are none.
pub fn html(run: &RunData) -> String {
    if run.films.is_empty() {
        return String::new();
    }
    let films: String = run.films.iter().map(film).collect();
    format!("<h4>Policies at work</h4>\n{films}")
}

fn film(film: &GroupFilm) -> String {
    let (group, size) = (escaped(&film.group), kilobytes(&film.gif));
    format!(
        "<p class=\"caption\">{group}: the four variants, each played by the policy that the \
         learner chose ({size} kB)</p>\n<div class=\"wide\"><img alt=\"{group}, played\" \
         src=\"data:image/gif;base64,{}\"></div>\n",
        base64(&film.gif)
    )
}

/// Thousands of bytes, rounded up.
fn kilobytes(gif: &[u8]) -> usize {
    gif.len().div_ceil(1000)
}

fn base64(bytes: &[u8]) -> String {
    let mut text = String::with_capacity(bytes.len().div_ceil(3) * 4);
    for chunk in bytes.chunks(3) {
        let byte = |at: usize| u32::from(chunk.get(at).copied().unwrap_or(0));
        let bits = byte(0) << 16 | byte(1) << 8 | byte(2);
        for sign in 0..4 {
            text.push(match sign <= chunk.len() {
                true => char::from(SIGNS[(bits >> (18 - 6 * sign) & 63) as usize]),
                false => '=',
            });
        }
    }
    text
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::presets::{Budget, Method};

    #[test]
    fn bytes_are_written_as_the_standard_says() {
        // the vectors of RFC 4648, section 10
        let expected = [
            "", "Zg==", "Zm8=", "Zm9v", "Zm9vYg==", "Zm9vYmE=", "Zm9vYmFy",
        ];
        for (length, expected) in expected.into_iter().enumerate() {
            assert_eq!(base64(&b"foobar"[..length]), expected);
        }
        assert_eq!(base64(&[0xfb, 0xff, 0xfe]), "+//+");
    }

    #[test]
    fn a_run_shows_its_films_and_how_large_they_are() {
        let mut run = RunData::empty("run", Budget::Smoke.experiment(Method::Covers));
        assert_eq!(html(&run), "");
        run.films.push(GroupFilm {
            group: "a<b".to_owned(),
            gif: vec![0; 1001],
        });
        let page = html(&run);
        assert!(page.contains("a&lt;b") && page.contains("(2 kB)"), "{page}");
        assert!(page.contains("data:image/gif;base64,AAAA"));
    }
}
