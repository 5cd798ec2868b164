//! In-painting on the simulation, where its exact limit is at hand: the scene drawn without the
//! arm.

use std::sync::Arc;

use envs::{
    Camera, ControlSettings, Embodiment, Light, RGB_CHANNELS, Scene, SceneRenderer, TableTop,
    TaskGroup,
};
use glam::DVec3;
use inpainting::{ArmLink, ColorCorrection, Inpainter, InpainterSettings, PinholeCamera};
use mujoco::{Model, is_reference_release};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use symmetry::D2;

mod arm;

use arm::Arm;

const SIZE: usize = 64;

/// Counts of pixels in an episode.
#[derive(Debug, Default)]
struct Tally {
    pixels: usize,
    /// Pixels of the arm, and those of them that the mask leaves uncovered.
    arm: usize,
    uncovered: usize,
    /// Pixels that differ from the same pipeline on pictures drawn without the arm.
    from_composed: usize,
    /// Pixels that differ from the picture drawn without the arm, which also shows motion below the
    /// arm.
    from_live: usize,
    /// Pixels that differ from it under a perfect mask of the arm: the least that a memory of
    /// earlier pictures can reach.
    least: usize,
}

struct Studio {
    table: TableTop,
    raw: SceneRenderer,
    alone: SceneRenderer,
    shortcut: SceneRenderer,
    arm: Arm,
    /// Factor of the links' radii.
    thickness: f64,
}

impl Studio {
    fn new(group: TaskGroup) -> Self {
        Self::lit(group, Light::default())
    }

    fn lit(group: TaskGroup, light: Light) -> Self {
        let camera = Camera { size: SIZE, light, ..Camera::default() };
        let scene = Arc::new(Scene::new(group, Embodiment::SAWYER, camera).unwrap());
        Self {
            table: TableTop::new(Arc::clone(&scene), ControlSettings::default()).unwrap(),
            raw: SceneRenderer::with_arm(Arc::clone(&scene)).unwrap(),
            alone: SceneRenderer::without_arm(Arc::clone(&scene)).unwrap(),
            shortcut: SceneRenderer::new(Arc::clone(&scene)).unwrap(),
            arm: Arm::new(&scene.model).unwrap(),
            thickness: 1.0,
        }
    }

    fn paint(renderer: &mut SceneRenderer, table: &mut TableTop) -> Vec<u8> {
        let mut rgb = vec![0; SIZE * SIZE * RGB_CHANNELS];
        renderer.render(table, &mut rgb).unwrap();
        rgb
    }

    fn inpainter(&mut self, correction: ColorCorrection) -> Inpainter {
        let camera = self.table.scene().camera;
        let links = self
            .arm
            .links()
            .iter()
            .map(|link| ArmLink { radius: self.thickness * link.radius, ..*link });
        let settings = InpainterSettings {
            camera: PinholeCamera::overhead(camera.size, camera.height, camera.half_extent),
            arm_links: links.collect(),
            colour_correction: correction,
            gripper_mark: arm::mark(&camera),
        };
        Inpainter::new(settings, &Self::paint(&mut self.alone, &mut self.table)).unwrap()
    }

    /// Runs the expert for an episode of the variant and compares every frame with the one drawn
    /// without the arm.
    fn episode(&mut self, element: D2, correction: ColorCorrection) -> Tally {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        self.table.reset(element, &mut rng).unwrap();
        let (mut full, mut composed) = (self.inpainter(correction), self.inpainter(correction));
        let mut last_seen = Self::paint(&mut self.alone, &mut self.table);
        let (mut tally, mut truncated) = (Tally::default(), false);
        while !truncated {
            let raw = Self::paint(&mut self.raw, &mut self.table);
            let alone = Self::paint(&mut self.alone, &mut self.table);
            let painted = self.inpaint(&mut full, &raw);
            tally.pixels += SIZE * SIZE;
            tally.arm += differing(&raw, &alone).count();
            let shown = differing(&raw, &alone);
            tally.uncovered += shown.filter(|&i| !full.arm_mask()[i]).count();
            let without_arm = self.inpaint(&mut composed, &alone);
            tally.from_composed += differing(&painted, &without_arm).count();
            let live = Self::paint(&mut self.shortcut, &mut self.table);
            tally.from_live += differing(&painted, &live).count();
            remember(&mut last_seen, &raw, &alone);
            let mark: Vec<usize> = differing(&live, &alone).collect();
            let stale = differing(&last_seen, &alone).filter(|i| mark.binary_search(i).is_err());
            tally.least += stale.count();
            let action = self.table.expert_action().unwrap();
            truncated = self.table.step(&action).unwrap().truncated;
        }
        tally
    }

    fn inpaint(&self, inpainter: &mut Inpainter, rgb: &[u8]) -> Vec<u8> {
        let mut out = vec![0; rgb.len()];
        let (joints, hand) = (self.arm.joints(&self.table), self.table.hand_position());
        inpainter.inpaint(rgb, &joints, hand, &mut out).unwrap();
        out
    }
}

/// Stores in `last_seen` the pixels of `raw` without the arm.
fn remember(last_seen: &mut [u8], raw: &[u8], alone: &[u8]) {
    let pixels = raw.chunks_exact(RGB_CHANNELS).zip(alone.chunks_exact(RGB_CHANNELS));
    for (old, (now, without_arm)) in last_seen.chunks_exact_mut(RGB_CHANNELS).zip(pixels) {
        if now == without_arm {
            old.copy_from_slice(now);
        }
    }
}

/// Returns the indices of the pixels in which two pictures differ.
fn differing(a: &[u8], b: &[u8]) -> impl Iterator<Item = usize> {
    let pixels = a.chunks_exact(RGB_CHANNELS).zip(b.chunks_exact(RGB_CHANNELS)).enumerate();
    pixels.filter(|(_, (p, q))| p != q).map(|(index, _)| index)
}

/// The picture without the arm is the limit of in-painting: equal pixels, except single ones at the
/// arm's edge. Every in-painting sees motion below the arm late; the picture without the arm sees
/// it at once.
#[test]
fn painting_the_arm_out_equals_not_drawing_it() {
    for group in TaskGroup::STANDARD {
        let mut studio = Studio::new(group);
        for element in D2::ALL {
            let tally = studio.episode(element, ColorCorrection::MeanAndDeviation);
            let share = |count: usize| count as f64 / tally.pixels as f64;
            assert!(share(tally.arm) > 0.04, "{group} {element}: {tally:?}");
            assert!(tally.uncovered < 5, "{group} {element}: {tally:?}");
            let most_composed = if is_reference_release() { 1e-4 } else { 3e-4 };
            assert!(share(tally.from_composed) < most_composed, "{group} {element}: {tally:?}");
            let late = share(tally.from_live);
            assert!(late <= share(tally.least) + 2e-3, "{group} {element}: {tally:?}");
            let most = match group.name() {
                "goal-reach" => 0.0,
                "plate-slide" | "button-press" => 0.01,
                _ => 0.015,
            };
            assert!(late <= most, "{group} {element}: {tally:?}");
        }
    }
}

#[test]
fn a_mask_that_is_too_thin_is_noticed() {
    let mut studio = Studio::new(TaskGroup::GOAL_REACH);
    studio.thickness = 0.7;
    let tally = studio.episode(D2::Identity, ColorCorrection::MeanAndDeviation);
    assert!(tally.uncovered > 1000, "{tally:?}");
    assert!(tally.from_composed * 200 > tally.pixels, "{tally:?}");
}

/// Returns the mean difference (levels) between pictures under dim light, in-painted with a
/// background under full light, and the picture without the arm under full light, mark included.
fn deviation_under_dim_light(correction: ColorCorrection) -> f64 {
    let light = Light { ambient: 0.3, camera: 0.25, overhead: 0.2 };
    let group = TaskGroup::PLATE_SLIDE;
    let (mut full, mut dim) = (Studio::new(group), Studio::lit(group, light));
    for studio in [&mut full, &mut dim] {
        let mut rng = ChaCha8Rng::seed_from_u64(5);
        studio.table.reset(D2::HalfTurn, &mut rng).unwrap();
    }
    let mut inpainter = full.inpainter(correction);
    let (mut sum, mut count) = (0.0, 0.0);
    for _ in 0..10 {
        let raw = Studio::paint(&mut dim.raw, &mut dim.table);
        let painted = dim.inpaint(&mut inpainter, &raw);
        let expected = Studio::paint(&mut full.shortcut, &mut full.table);
        let differences = painted.iter().zip(&expected).map(|(a, b)| a.abs_diff(*b));
        sum += differences.map(f64::from).sum::<f64>();
        count += raw.len() as f64;
        let action = full.table.expert_action().unwrap();
        full.table.step(&action).unwrap();
        dim.table.step(&action).unwrap();
    }
    sum / count
}

#[test]
fn other_light_is_corrected() {
    let none = deviation_under_dim_light(ColorCorrection::None);
    for correction in [ColorCorrection::MeanAndDeviation, ColorCorrection::GreyWorld] {
        let corrected = deviation_under_dim_light(correction);
        println!("{correction:?}: {none} -> {corrected}");
        assert!(corrected < none / 10.0, "{correction:?}: {none} -> {corrected}");
    }
}

#[test]
fn the_pinhole_camera_projects_as_the_table_camera_does() {
    let camera = Camera::default();
    let pinhole = PinholeCamera::overhead(camera.size, camera.height, camera.half_extent);
    pinhole.check().unwrap();
    for point in [[0.1, -0.2, 0.3], [-0.4, 0.3, 0.0]].map(DVec3::from_array) {
        let [u, v] = camera.project(point);
        let [right, down] = pinhole.project(point).unwrap();
        assert!((right - u).abs() < 1e-9 && (down + v).abs() < 1e-9);
    }
}

/// A link that is missing in the mask would stay in the picture.
#[test]
fn an_arm_with_a_shape_that_has_no_capsule_is_refused_by_name() {
    let model = |shape: &str| {
        let geom = format!(r#"<geom name="wrist" group="3" {shape}/>"#);
        let body = format!(r#"<body name="arm">{geom}</body>"#);
        Model::from_xml(&format!("<mujoco><worldbody>{body}</worldbody></mujoco>")).unwrap()
    };
    let sphere = model(r#"type="sphere" size=".1""#);
    assert_eq!(Arm::new(&sphere).unwrap().links().len(), 1);
    let ellipsoid = model(r#"type="ellipsoid" size=".1 .2 .3""#);
    let message = Arm::new(&ellipsoid).unwrap_err();
    assert!(message.contains("`wrist`"), "{message}");
}
