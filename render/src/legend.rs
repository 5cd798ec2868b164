//! Captions and legends of films: outcomes of episodes, and what the marks in pictures mean.

use experiments::Experiment;
use experiments::sheet::GOAL_MARK_COLOUR;

use super::grid::{FilmCaption, FilmLegendEntry};
use super::recorder::FilmView;

const SOLVED: [u8; 3] = [0x00, 0x6b, 0x3c];
const NOT_SOLVED: [u8; 3] = [0xa4, 0x1e, 0x22];
const WHITE: [u8; 3] = [255; 3];

/// Returns the outcome of an episode in words.
pub(super) fn outcome(success: bool) -> &'static str {
    if success { "solved" } else { "not solved" }
}

/// Returns the caption of an episode: the policy that plays it and the outcome. It stands below all
/// pictures, also of the time before success.
pub(super) fn episode_caption(policy: usize, success: bool) -> FilmCaption {
    FilmCaption {
        text: format!("policy {policy} {}", if success { "solves it" } else { "fails" }),
        colour: if success { SOLVED } else { NOT_SOLVED },
    }
}

/// Returns the legend of a film in these views, `mirrored_back` if it has rows of mirrored pictures,
/// and `shows_goal` if the pictures mark a goal.
pub(super) fn film_legend(
    experiment: &Experiment,
    views: &[FilmView],
    mirrored_back: bool,
    shows_goal: bool,
) -> Vec<FilmLegendEntry> {
    let shows = |any: &[FilmView]| any.iter().any(|view| views.contains(view));
    let entry = |swatch, text: &str| FilmLegendEntry { swatch, text: text.to_owned() };
    let mark = experiment.envs.camera.mark;
    let mut legend = Vec::new();
    if shows(&[FilmView::PolicyInput]) && mark.radius > 0.0 {
        legend.push(entry(Some(mark.color), "gripper (the policy does not see the arm)"));
    }
    if shows(&[FilmView::PolicyInput, FilmView::Raw]) && shows_goal {
        legend.push(entry(Some(GOAL_MARK_COLOUR), "goal, which the policy gets as numbers"));
    }
    if shows(&[FilmView::Mask]) {
        legend.push(entry(Some(WHITE), "area that the arm hides"));
    }
    if mirrored_back {
        legend.push(entry(None, "mirrored back: the row above in the frame of identity"));
    }
    let decisions = experiment.envs.control.decisions_per_episode();
    let whole = format!("solves it: success within the episode of {decisions} decisions");
    legend.push(entry(None, &whole));
    legend
}

#[cfg(test)]
mod tests {
    use super::*;
    use experiments::presets::{Budget, Method};

    #[test]
    fn a_legend_explains_what_the_views_show_and_nothing_else() {
        let experiment = Budget::Full.preset_experiment(Method::CoversSac);
        let legend = |views: &[FilmView], shows_goal| {
            let entries = film_legend(&experiment, views, false, shows_goal);
            entries.into_iter().map(|entry| entry.text).collect::<Vec<_>>().join("; ")
        };
        let whole = "solves it: success within the episode of 50 decisions";
        let seen = legend(&[FilmView::PolicyInput], true);
        assert!(seen.starts_with("gripper (the policy") && seen.contains("; goal, "), "{seen}");
        assert!(!legend(&[FilmView::PolicyInput], false).contains("goal"));
        assert_eq!(legend(&[FilmView::Perspective], true), whole);
        let masked = legend(&[FilmView::Mask], true);
        assert_eq!(masked, format!("area that the arm hides; {whole}"));
    }

    #[test]
    fn outcomes_differ_in_words_and_colours() {
        let [solved, failed] = [true, false].map(|success| episode_caption(2, success));
        assert_eq!(
            (solved.text.as_str(), failed.text.as_str()),
            ("policy 2 solves it", "policy 2 fails")
        );
        assert_ne!(solved.colour, failed.colour);
    }
}
