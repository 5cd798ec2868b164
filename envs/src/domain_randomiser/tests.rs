//! Tests of each disturbance, on one picture or on many.

use symmetry::D2;

use super::*;

const OFF: VisualDomainRandomisation = VisualDomainRandomisation::OFF;
const SIZE: usize = 48;

/// Returns a picture without any symmetry, `[SIZE, SIZE, 3]`.
fn picture() -> Vec<u8> {
    let level = |index: usize| ((index * index / 97 + 5 * index) % 256) as u8;
    (0..SIZE * SIZE * RGB_CHANNELS).map(level).collect()
}

fn grey(level: u8) -> Vec<u8> {
    vec![level; SIZE * SIZE * RGB_CHANNELS]
}

/// Returns a camera that draws no mark.
fn camera() -> Camera {
    let mut camera = Camera::default();
    camera.mark.radius = 0.0;
    camera
}

fn randomiser(amounts: VisualDomainRandomisation) -> VisualDomainRandomiser {
    VisualDomainRandomiser::new(amounts, camera())
}

/// Returns a picture as a camera in this state shows it.
fn shown(
    randomiser: &mut VisualDomainRandomiser,
    state: &mut CameraErrors,
    picture: &[u8],
) -> Vec<u8> {
    let mut rgb = picture.to_vec();
    randomiser.add_camera_errors(state, DVec3::new(0.1, -0.05, 0.2), &mut rgb);
    rgb
}

/// Returns a picture as the cameras of `count` episodes show it.
fn episodes(amounts: VisualDomainRandomisation, picture: &[u8], count: usize) -> Vec<Vec<u8>> {
    let (mut randomiser, mut state) = (randomiser(amounts), CameraErrors::new(1000, 0));
    let episode = |_| {
        randomiser.begin_episode(&mut state);
        shown(&mut randomiser, &mut state, picture)
    };
    (0..count).map(episode).collect()
}

/// Returns mean and standard deviation.
fn moments(values: impl Iterator<Item = f64> + Clone) -> (f64, f64) {
    let count = values.clone().count() as f64;
    let mean = values.clone().sum::<f64>() / count;
    let variance = values.map(|value| (value - mean).powi(2)).sum::<f64>() / count;
    (mean, variance.sqrt())
}

#[test]
fn noise_has_the_mean_and_the_spread_that_were_asked_for() {
    for noise_sd in [2.0, 6.0] {
        let levels =
            episodes(VisualDomainRandomisation { noise_sd, ..OFF }, &grey(128), 20).concat();
        let (mean, deviation) = moments(levels.iter().copied().map(f64::from));
        assert!((mean - 128.0).abs() < 0.05, "{mean}");
        // rounding to levels adds a variance of 1/12
        let expected = (noise_sd * noise_sd + 1.0 / 12.0).sqrt();
        assert!((deviation - expected).abs() < 0.02 * noise_sd, "{deviation}");
    }
}

#[test]
fn noise_is_another_in_every_picture_of_an_episode() {
    let amounts = VisualDomainRandomisation { noise_sd: 3.0, ..OFF };
    let (mut randomiser, mut state) = (randomiser(amounts), CameraErrors::new(1000, 0));
    randomiser.begin_episode(&mut state);
    let [one, other] = [(); 2].map(|()| shown(&mut randomiser, &mut state, &picture()));
    assert_ne!(one, other);
}

#[test]
fn a_camera_that_is_moved_by_a_pixel_shows_the_picture_moved_by_one() {
    let pixel = 2.0 * camera().half_extent / SIZE as f64;
    let mut state = CameraErrors::new(1000, 0);
    state.view = Homography::new(&camera(), DVec3::new(pixel, 0.0, 0.0), DVec3::ZERO);
    let (before, after) = (picture(), shown(&mut randomiser(OFF), &mut state, &picture()));
    for row in 0..SIZE {
        let line = row * SIZE * RGB_CHANNELS..(row + 1) * SIZE * RGB_CHANNELS;
        let (before, after) = (&before[line.clone()], &after[line]);
        assert_eq!(after[..(SIZE - 1) * RGB_CHANNELS], before[RGB_CHANNELS..]);
        assert_eq!(after[(SIZE - 1) * RGB_CHANNELS..], before[(SIZE - 1) * RGB_CHANNELS..]);
    }
}

#[test]
fn the_camera_of_an_episode_stays_and_that_of_the_next_is_another() {
    let amounts = VisualDomainRandomisation {
        noise_sd: 0.0,
        max_patches: 0,
        ..VisualDomainRandomisation::NOMINAL
    };
    let (mut randomiser, mut state) = (randomiser(amounts), CameraErrors::new(1000, 0));
    let mut before = picture();
    for _ in 0..5 {
        randomiser.begin_episode(&mut state);
        let [one, other] = [(); 2].map(|()| shown(&mut randomiser, &mut state, &picture()));
        assert_eq!(one, other);
        assert_ne!(one, before);
        before = one;
    }
}

#[test]
fn exposure_and_balance_spread_as_they_should() {
    let amounts = VisualDomainRandomisation { exposure_sd: 20.0, white_balance_sd: 6.0, ..OFF };
    let (randomiser, mut state) = (randomiser(amounts), CameraErrors::new(1000, 0));
    let light = |gain: f32| GAMMA * f64::from(gain).ln();
    let drawn: Vec<[f64; RGB_CHANNELS]> = (0..20_000)
        .map(|_| {
            randomiser.begin_episode(&mut state);
            state.gains.map(light)
        })
        .collect();
    let (mean, deviation) = moments(drawn.iter().map(|of| of[1]));
    assert!(mean.abs() < 0.005 && (deviation - 0.2).abs() < 0.004, "{mean} {deviation}");
    for other in [0, 2] {
        let (ratio_mean, ratio_deviation) = moments(drawn.iter().map(|of| of[other] - of[1]));
        assert!(ratio_mean.abs() < 0.002, "{ratio_mean}");
        assert!((ratio_deviation - 0.06).abs() < 0.002, "{ratio_deviation}");
    }
    state.gains = [0.5, 1.0, 9.0];
    let dim = shown(&mut self::randomiser(OFF), &mut state, &grey(100));
    assert_eq!(dim[..RGB_CHANNELS], [50, 100, 255]);
}

#[test]
fn errors_of_the_camera_keep_their_bounds_and_prefer_no_side() {
    let rng = &mut ChaCha8Rng::seed_from_u64(1000);
    let drawn: Vec<DVec3> = (0..50_000).map(|_| vector(10.0, rng)).collect();
    for axis in 0..3 {
        let (mean, deviation) = moments(drawn.iter().map(|of| of[axis]));
        // the mean square of a length is 100 / 3, and each axis has a third of it
        assert!(mean.abs() < 0.08 && (deviation - 10.0 / 3.0).abs() < 0.05, "{mean} {deviation}");
    }
    let (mean, _) = moments(drawn.iter().map(|of| of.length()));
    assert!((mean - 5.0).abs() < 0.05 && drawn.iter().all(|of| of.length() <= 10.0), "{mean}");
}

/// The levels of a bright pixel must spread by the variance along either axis without loss.
#[test]
fn blur_is_as_wide_as_it_should_be() {
    let middle = SIZE / 2;
    for variance in [0.1, 0.5, 2.7] {
        let mut randomiser = randomiser(OFF);
        randomiser.levels[middle * SIZE + middle][0] = 1.0;
        let (count, share) = passes(variance);
        assert!(share <= MAX_SHARE as f32);
        (0..count).for_each(|_| randomiser.blur(share));
        let sum = |weight: fn(f64, f64) -> f64| -> f64 {
            let pixels = randomiser.levels.iter().enumerate();
            pixels
                .map(|(index, levels)| {
                    let off = |at: usize| at as f64 - middle as f64;
                    f64::from(levels[0]) * weight(off(index / SIZE), off(index % SIZE))
                })
                .sum()
        };
        assert!((sum(|_, _| 1.0) - 1.0).abs() < 1e-4);
        assert!((sum(|y, _| y * y) - variance).abs() < 1e-4);
        assert!((sum(|_, x| x * x) - variance).abs() < 1e-4);
        assert!(sum(|y, x| x * y).abs() < 1e-4);
    }
    assert_eq!(passes(0.0).0, 0);
    let mut flat = randomiser(OFF);
    flat.levels.fill([9.0; 4]);
    flat.blur(0.25);
    assert!(flat.levels.iter().all(|&levels| levels == [9.0; 4]), "borders keep their levels");
}

#[test]
fn patches_are_discs_around_the_gripper_in_colours_that_are_off_to_either_side() {
    let amounts = VisualDomainRandomisation {
        max_patches: 3,
        max_patch_radius_mm: 30.0,
        patch_color_sd: 20.0,
        ..OFF
    };
    let pictures = episodes(amounts, &grey(128), 2000);
    let touched = |picture: &&Vec<u8>| picture.iter().any(|&level| level != 128);
    let share = pictures.iter().filter(touched).count() as f64 / 2000.0;
    // a quarter has none, and some are too small for a pixel or outside
    assert!((0.6..0.75).contains(&share), "{share}");
    let levels = pictures.concat();
    let off = levels.iter().map(|&level| f64::from(level) - 128.0);
    let (mean, _) = moments(off.clone());
    assert!(mean.abs() < 0.02, "{mean}");
    let (mut sum, mut total) = ([0.0; 2], 0.0);
    for (index, difference) in off.enumerate().filter(|(_, off)| *off != 0.0) {
        let (row, column) = (index / RGB_CHANNELS / SIZE % SIZE, index / RGB_CHANNELS % SIZE);
        let weight = difference.abs();
        let x = column as f64 + 0.5 - SIZE as f64 / 2.0;
        let y = SIZE as f64 / 2.0 - row as f64 - 0.5;
        sum = [sum[0] + weight * x, sum[1] + weight * y];
        total += weight;
    }
    let hand = camera().project(DVec3::new(0.1, -0.05, 0.2));
    for axis in 0..2 {
        assert!((sum[axis] / total - hand[axis]).abs() < 0.5, "{sum:?} {total} {hand:?}");
    }
}

/// The mirrored error must show the mirrored table in the mirrored picture. Since errors are drawn
/// from symmetric distributions, all variants are then equally hard.
#[test]
fn a_mirrored_camera_shows_a_mirrored_table_in_a_mirrored_picture() {
    let (position, turn) = (DVec3::new(0.02, 0.01, 0.03), DVec3::new(0.01, 0.02, 0.05));
    let mirrored =
        |element: D2, picture: &[u8]| element.transform_image(picture, SIZE, SIZE, RGB_CHANNELS);
    let shown = |element: D2| {
        let [x, y] =
            [element.flips_x(), element.flips_y()].map(|flips| if flips { -1.0 } else { 1.0 });
        let mut state = CameraErrors::new(1000, 0);
        let position = position * DVec3::new(x, y, 1.0);
        // rotations are axial vectors: an axis in the mirror's plane flips, one across it stays
        let turn = turn * DVec3::new(y, x, x * y);
        state.view = Homography::new(&camera(), position, turn);
        state.blur = passes(0.3);
        shown(&mut randomiser(OFF), &mut state, &mirrored(element, &picture()))
    };
    let canonical = shown(D2::Identity);
    for element in D2::ALL {
        let (seen, expected) = (shown(element), mirrored(element, &canonical));
        let off = seen.iter().zip(&expected).map(|(a, b)| a.abs_diff(*b)).max();
        assert!(off <= Some(1), "{element}: {off:?}");
    }
}

#[test]
fn numbers_have_mean_0_and_variance_1_and_are_drawn_apart() {
    let rng = &mut ChaCha8Rng::seed_from_u64(1000);
    let drawn: Vec<[f64; RGB_CHANNELS]> =
        (0..100_000).map(|_| normals(rng).map(f64::from)).collect();
    for channel in 0..RGB_CHANNELS {
        let (mean, deviation) = moments(drawn.iter().map(|of| of[channel]));
        assert!(mean.abs() < 0.01, "{mean}");
        assert!((deviation - 1.0).abs() < 0.01, "{deviation}");
        let next = (channel + 1) % RGB_CHANNELS;
        let (shared, _) = moments(drawn.iter().map(|of| of[channel] * of[next]));
        assert!(shared.abs() < 0.01, "{shared}");
    }
    let most = drawn.as_flattened().iter().copied().fold(0.0, f64::max);
    assert!(most > 2.8 && most < 2.98, "{most}");
}
