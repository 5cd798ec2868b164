//! What a turn logs.

use cluster::{Evidence, PermutationTest};

use crate::learners::metrics::Metrics;

const DISTANCES: &str = "distances";
const HEIRS: &str = "heirs";

type Figure = fn(&PermutationTest) -> f64;

/// Figures of the test of each policy.
const FIGURES: [(&str, Figure); 5] = [
    ("null_means", |test| test.null.mean),
    ("null_maxima", |test| test.null.max),
    ("scores", |test| test.score),
    ("p_values", |test| test.p_value),
    ("tail_p_values", |test| test.tail_p_value),
];

/// The names of what has one number for each policy, also while there is one policy only.
pub(crate) fn per_policy_columns() -> impl Iterator<Item = &'static str> {
    let figures = FIGURES.into_iter().map(|(name, _)| name);
    [DISTANCES, HEIRS].into_iter().chain(figures)
}

/// What is logged: the evidence of the grouping, one number for each policy, who has which heir
/// where policies are merged, and the update.
pub(super) fn metrics(
    evidence: &[Evidence],
    looks: usize,
    heirs: Option<&[Option<usize>]>,
    update: Vec<(String, f64)>,
) -> Metrics {
    let mut metrics = Metrics::default();
    metrics.number("looks", looks as f64);
    metrics.per_policy(DISTANCES, evidence.iter().map(|e| Some(e.distance)));
    for (name, figure) in FIGURES {
        metrics.per_policy(name, evidence.iter().map(|e| e.test().map(figure)));
    }
    if let Some(heirs) = heirs {
        metrics.per_policy(HEIRS, heirs.iter().map(|heir| heir.map(|heir| heir as f64)));
    }
    for (name, value) in update {
        metrics.number(name, value);
    }
    metrics
}
