//! What is drawn for a minibatch.

use rand::SeedableRng;
use symmetry::Group;

use super::*;
use crate::sac::fixtures;

const DRAWS: usize = 4000;

/// How often each step of the fixtures' replay is drawn in windows of this many steps.
fn counts(window: usize) -> Vec<usize> {
    let settings = SacSettings {
        batch: 6,
        window,
        augmentation: Group::D2,
        ..SacSettings::default()
    };
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
            // five standard errors of independent windows of equal steps
            assert!(error < 5 * 90, "{window}: {count} of {expected}");
        }
    }
}
