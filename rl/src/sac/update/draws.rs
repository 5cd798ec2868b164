//! What is drawn for a minibatch.

use rand::SeedableRng;
use symmetry::Group;

use super::*;
use crate::fixtures;

const DRAWS: usize = 4000;

/// Minibatches of six steps in windows of this many.
fn settings(window: usize) -> SacSettings {
    SacSettings {
        batch: 6,
        window,
        augmentation: Group::D2,
        ..SacSettings::default()
    }
}

/// How often each step of the fixtures' replay is drawn in windows of this many steps.
fn counts(window: usize) -> Vec<usize> {
    let settings = settings(window);
    let (replay, mut draws) = (fixtures::replay(), Draws::default());
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let mut counts = vec![0; replay.len()];
    for _ in 0..DRAWS {
        draws.draw(&settings, &replay, &mut rng);
        assert_eq!((draws.steps.len(), draws.elements.len()), (6, 6));
        assert!(
            draws
                .elements
                .chunks(window)
                .all(|own| own.iter().all(|g| *g == own[0]))
        );
        for &(index, further) in &draws.steps {
            let place = replay.get(index).along(further).place();
            let mut steps = 0..replay.len();
            let found = steps.find(|&i| replay.get(i).place() == place);
            counts[found.unwrap()] += 1;
        }
    }
    counts
}

/// The episodes have four and two steps: the last steps are drawn as often as the first ones. A
/// window of four in an episode of two holds both steps twice.
#[test]
fn every_step_is_drawn_equally_often() {
    for window in [1, 2, 3, 4] {
        let expected = 6 * DRAWS / 12;
        for count in counts(window) {
            let error = count.abs_diff(expected);
            // five standard errors; the largest is that of windows of three and four, which hold
            // each step of the short episode more than once
            assert!(error < 5 * 54, "{window}: {count} of {expected}");
        }
    }
}

/// Of three windows a share of two thirds begins among the four steps since the mark, and the third
/// one does so in four cases of twelve.
#[test]
fn a_share_of_the_windows_begins_with_the_newest_steps() {
    let drawn = |newest_share| {
        let settings = SacSettings {
            newest_share,
            ..settings(2)
        };
        let (mut replay, mut draws) = (fixtures::marked(4), Draws::default());
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        let mut newest = 0;
        for _ in 0..DRAWS {
            draws.draw(&settings, &replay, &mut rng);
            let begin = draws.steps.iter().step_by(2);
            newest += begin.filter(|(index, _)| *index >= 8).count();
        }
        // nothing has come since
        replay.mark();
        draws.draw(&settings, &replay, &mut rng);
        assert_eq!(draws.steps.len(), 6);
        newest as f64 / DRAWS as f64
    };
    for (share, expected) in [(0.0, 1.0), (0.7, 2.0 + 1.0 / 3.0), (1.0, 3.0)] {
        // five standard errors of three windows, each with a third
        let error = (drawn(share) - expected).abs();
        assert!(
            error < 5.0 * (3.0 * 2.0 / 9.0 / DRAWS as f64).sqrt(),
            "{share}: {error}"
        );
    }
}
