//! Films of policies, inside of the page.

use base64::Engine;
use base64::engine::general_purpose::STANDARD;

use super::svg::escaped;
use experiments::{GroupFilm, RunData};

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
        STANDARD.encode(&film.gif)
    )
}

/// Thousands of bytes, rounded up.
fn kilobytes(gif: &[u8]) -> usize {
    gif.len().div_ceil(1000)
}

#[cfg(test)]
mod tests {
    use super::*;
    use experiments::presets::{Budget, Method};

    #[test]
    fn a_run_shows_its_films_and_how_large_they_are() {
        let mut run = RunData::empty("run", Budget::Smoke.experiment(Method::Covers));
        assert_eq!(html(&run), "");
        run.films.push(GroupFilm { group: "a<b".to_owned(), gif: vec![0; 1001] });
        let page = html(&run);
        assert!(page.contains("a&lt;b") && page.contains("(2 kB)"), "{page}");
        assert!(page.contains("data:image/gif;base64,AAAA"));
    }
}
