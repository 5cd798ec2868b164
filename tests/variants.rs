//! The 16 variants as the learner sees them, and what its network makes of them.

use std::collections::HashSet;

use covers::experiments::sheet::{contact_sheet, variant_pictures};
use envs::{
    ACTION_IRREPS, ExtraViews, RGB_CHANNELS, TaskGroup, VECTOR_OBSERVATION_IRREPS, VecEnvSettings,
};
use rl::{Actor, ActorCriticPolicy, EnvSpec, NetworkSettings, Observations};
use symmetry::D2;

#[test]
fn sixteen_pictures_differ_and_variants_of_a_group_are_exact_mirror_images() {
    let settings = VecEnvSettings::default();
    let size = settings.camera.size;
    let groups = variant_pictures(&settings, &TaskGroup::STANDARD).unwrap();
    let different: HashSet<_> = groups.iter().flatten().collect();
    assert_eq!(different.len(), 16);
    for variants in &groups {
        for (element, picture) in D2::ALL.into_iter().zip(variants) {
            let mirrored = element.transform_image(&variants[0], size, size, RGB_CHANNELS);
            assert!(*picture == mirrored, "{element} is not a mirror image");
        }
    }
}

/// Groups down and elements across, each pixel a square of 4, with 6 white pixels around each
/// picture.
#[test]
fn the_contact_sheet_shows_every_picture_in_its_place() {
    let settings = VecEnvSettings::default();
    let (size, enlarge, gap) = (settings.camera.size, 4, 6);
    let sheet = contact_sheet(&settings, &TaskGroup::STANDARD).unwrap();
    assert_eq!(sheet.rgb.len(), sheet.width * sheet.height * RGB_CHANNELS);
    let cell = size * enlarge + gap;
    for (row, variants) in
        variant_pictures(&settings, &TaskGroup::STANDARD).unwrap().iter().enumerate()
    {
        for (column, picture) in variants.iter().enumerate() {
            for (i, pixel) in picture.chunks(RGB_CHANNELS).enumerate() {
                let y = gap + row * cell + (i / size) * enlarge + 1;
                let x = gap + column * cell + (i % size) * enlarge + 1;
                let shown = &sheet.rgb[(y * sheet.width + x) * RGB_CHANNELS..][..RGB_CHANNELS];
                assert_eq!(shown, pixel, "row {row}, column {column}, pixel {i}");
            }
        }
    }
}

/// One observation of a variant: its picture twice, and `vector` mapped by `element`.
fn observation(picture: &[u8], vector: &[f32], element: D2) -> Observations {
    let images = picture.chunks_exact(RGB_CHANNELS).flat_map(|pixel| [pixel, pixel].concat());
    let signs = VECTOR_OBSERVATION_IRREPS.map(|irrep| f32::from(irrep.sign(element)));
    Observations {
        images: images.collect(),
        vectors: vector.iter().zip(signs).map(|(value, sign)| value * sign).collect(),
    }
}

/// Relative deviations from `action(g s) = g action(s)` over all pictures, for observations made by
/// `map`.
fn deviations(map: impl Fn(D2) -> D2) -> Vec<f32> {
    let settings = VecEnvSettings::default();
    let size = settings.camera.size;
    let spec = EnvSpec {
        num_envs: 1,
        image_shape: [size, size, ExtraViews::First.num_total_channels()],
        vector_irreps: VECTOR_OBSERVATION_IRREPS.to_vec(),
        action_irreps: ACTION_IRREPS.to_vec(),
        choices: vec![],
    };
    // a large gain, so that actions are of order one and a relative error means something
    let network = NetworkSettings { action_gain: 1.0, ..NetworkSettings::default() };
    let mut policy = ActorCriticPolicy::new(&network, &spec, 5).unwrap();
    let vector = [0.4, -0.9, 0.3, 0.2, 1.1, 0.7, -0.5, 0.2, -0.1, 0.05];
    let mut act = |picture: &[u8], element| {
        let mut action = [0.0; 4];
        policy.mean_actions(&observation(picture, &vector, element), &mut (), &mut action).unwrap();
        action
    };
    let mut deviations = Vec::new();
    for variants in variant_pictures(&settings, &TaskGroup::STANDARD).unwrap() {
        let reference = act(&variants[0], D2::Identity);
        let scale = reference.iter().fold(0.0_f32, |scale, value| scale.max(value.abs()));
        for (element, picture) in D2::ALL.into_iter().zip(&variants) {
            let action = act(picture, map(element));
            for (i, irrep) in ACTION_IRREPS.into_iter().enumerate() {
                let expected = reference[i] * f32::from(irrep.sign(element));
                deviations.push((action[i] - expected).abs() / scale);
            }
        }
    }
    deviations
}

#[test]
fn the_policy_acts_on_mirrored_scenes_by_mirrored_actions() {
    let deviations = deviations(|element| element);
    assert!(deviations.iter().all(|&deviation| deviation <= 1e-5), "{deviations:?}");
}

#[test]
fn a_vector_mirrored_along_the_wrong_axis_is_noticed() {
    let swapped = |element| match element {
        D2::FlipX => D2::FlipY,
        D2::FlipY => D2::FlipX,
        other => other,
    };
    let deviations = deviations(swapped);
    assert!(deviations.iter().any(|&deviation| deviation > 1e-3), "{deviations:?}");
}
