//! Do a variant and its canonical twin stay mirror images of one another?

use std::sync::Arc;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;
use symmetry::D2;

use super::experts::{VariantName, check_seeds, episode};
use crate::camera::RGB;
use crate::carrier::OPEN_APERTURE;
use crate::error::EnvError;
use crate::renderer::SceneRenderer;
use crate::scene::Scene;
use crate::tabletop::{ACTION_DIM, ACTION_IRREPS, TableTop};
use crate::task::{Measurement, Placement};

/// Closed loop, an expert's return may differ by this share between the variants of a group.
const RETURN_SPREAD: f64 = 0.03;
/// Open loop, a variant with an embodiment that mirrors exactly may stray from its twin by this
/// much (metres): before anything touches, and after.
const FREE_DEVIATION: f64 = 1e-9;
const CONTACT_DEVIATION: f64 = 1e-6;

/// Decisions that a random action is held for.
const HELD: usize = 5;

/// How far a variant strayed from the mirror image of its canonical twin.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SymmetryRow {
    /// The variant.
    #[serde(flatten)]
    pub variant: VariantName,
    /// Whether the embodiment mirrors exactly.
    #[serde(skip)]
    exact: bool,
    /// Open loop, mirrored actions: the largest deviation (metres) of hand, fingertips, claw
    /// distance or object before anything touched.
    pub free_deviation: f64,
    /// The same from the first contact on.
    pub contact_deviation: f64,
    /// Open loop: the largest difference of a decision's reward.
    pub reward_deviation: f64,
    /// Open loop: pictures compared, one a decision.
    pub frames: usize,
    /// Pictures that were not the mirror image bit for bit.
    pub frames_differing: usize,
    /// Pixels that differed in the worst of them.
    pub pixels_differing: usize,
    /// Closed loop: the expert's mean return here over its mean return on the canonical twin.
    pub return_ratio: f64,
}

impl SymmetryRow {
    /// Whether the returns agree within 3 %, and with an embodiment that mirrors exactly pictures
    /// to the bit and motion within 1e-9 m, or 1e-6 m from the first contact on.
    pub fn passes(&self) -> bool {
        let fair = (self.return_ratio - 1.0).abs() <= RETURN_SPREAD;
        let mirrors = self.free_deviation <= FREE_DEVIATION
            && self.contact_deviation <= CONTACT_DEVIATION
            && self.frames_differing == 0;
        fair && (mirrors || !self.exact)
    }
}

/// Drives the variant `element` and its canonical twin side by side, on the placements of the seeds
/// `0..seeds`.
///
/// Open loop, the twin's actions are mirrored for the variant: those of the twin's expert, then
/// random ones. Closed loop, each has its own expert.
///
/// # Errors
/// [`EnvError::Setting`] for no seeds, [`EnvError::NoSuchVariant`], or what MuJoCo or OpenGL says.
pub fn symmetry(scene: &Arc<Scene>, element: D2, seeds: u64) -> Result<SymmetryRow, EnvError> {
    check_seeds(seeds)?;
    let mut twins = Twins::new(Arc::clone(scene), element, element)?;
    twins.compare(seeds)?;
    Ok(twins.row)
}

/// A canonical table and a variant of it, driven alike.
struct Twins {
    canonical: TableTop,
    variant: TableTop,
    element: D2,
    /// Maps the canonical actions for the variant; the variant's own element, unless the checker
    /// itself is checked.
    of_actions: D2,
    renderer: SceneRenderer,
    pictures: [Vec<u8>; 2],
    touched: bool,
    row: SymmetryRow,
}

/// Who chooses the canonical actions.
#[derive(Clone, Copy)]
enum Driver {
    Expert,
    Random,
}

impl Twins {
    fn new(scene: Arc<Scene>, element: D2, of_actions: D2) -> Result<Self, EnvError> {
        let control = scene.layout.control();
        let pixels = scene.camera.size * scene.camera.size * RGB;
        let row = SymmetryRow {
            variant: VariantName::new(&scene, element),
            exact: scene.embodiment.mirrors_exactly(),
            free_deviation: 0.0,
            contact_deviation: 0.0,
            reward_deviation: 0.0,
            frames: 0,
            frames_differing: 0,
            pixels_differing: 0,
            return_ratio: 1.0,
        };
        Ok(Self {
            canonical: TableTop::new(Arc::clone(&scene), control)?,
            variant: TableTop::new(Arc::clone(&scene), control)?,
            element,
            of_actions,
            renderer: SceneRenderer::new(scene)?,
            pictures: [vec![0; pixels], vec![0; pixels]],
            touched: false,
            row,
        })
    }

    fn compare(&mut self, seeds: u64) -> Result<(), EnvError> {
        let mut returns = [0.0; 2];
        for seed in 0..seeds {
            let mut rng = ChaCha8Rng::seed_from_u64(seed);
            let placement = self.canonical.scene().place(&mut rng);
            for driver in [Driver::Expert, Driver::Random] {
                self.open_loop(placement, driver, &mut rng)?;
            }
            self.reset(placement)?;
            returns[0] += episode(&mut self.canonical)?.0;
            returns[1] += episode(&mut self.variant)?.0;
        }
        self.row.return_ratio = returns[1] / returns[0];
        Ok(())
    }

    fn reset(&mut self, placement: Placement) -> Result<(), EnvError> {
        self.canonical.reset_to(D2::Identity, placement)?;
        self.variant.reset_to(self.element, placement)?;
        self.touched = false;
        Ok(())
    }

    fn open_loop(
        &mut self,
        placement: Placement,
        driver: Driver,
        rng: &mut ChaCha8Rng,
    ) -> Result<(), EnvError> {
        self.reset(placement)?;
        let mut action = [0.0; ACTION_DIM];
        for decision in 0..self.canonical.control().decisions() {
            match driver {
                Driver::Expert => action = self.canonical.expert_action()?,
                Driver::Random if decision % HELD == 0 => {
                    action = std::array::from_fn(|_| rng.random_range(-1.0..1.0));
                }
                Driver::Random => {}
            }
            self.decide(&action)?;
            self.compare_pictures()?;
        }
        Ok(())
    }

    fn decide(&mut self, action: &[f32; ACTION_DIM]) -> Result<(), EnvError> {
        let mirrored: [f32; ACTION_DIM] =
            std::array::from_fn(|i| action[i] * f32::from(ACTION_IRREPS[i].sign(self.of_actions)));
        let here = self.canonical.step(action)?;
        let there = self.variant.step(&mirrored)?;
        self.touched |= self.canonical.touched() || self.variant.touched();
        let deviation = deviation(&self.canonical.measurement()?, &self.variant.measurement()?);
        let worst = if self.touched {
            &mut self.row.contact_deviation
        } else {
            &mut self.row.free_deviation
        };
        *worst = larger(*worst, deviation);
        let of_reward = (here.reward - there.reward).abs();
        self.row.reward_deviation = larger(self.row.reward_deviation, of_reward);
        Ok(())
    }

    fn compare_pictures(&mut self) -> Result<(), EnvError> {
        let size = self.canonical.scene().camera.size;
        let [here, there] = &mut self.pictures;
        self.renderer.render(&mut self.canonical, here)?;
        self.renderer.render(&mut self.variant, there)?;
        let mirrored = self.element.transform_image(here, size, size, RGB);
        let pixels = mirrored.chunks(RGB).zip(there.chunks(RGB));
        let differing = pixels.filter(|(a, b)| a != b).count();
        self.row.frames += 1;
        self.row.frames_differing += usize::from(differing > 0);
        self.row.pixels_differing = self.row.pixels_differing.max(differing);
        Ok(())
    }
}

/// The largest distance (metres) between what two tables measure, both in the canonical frame.
fn deviation(a: &Measurement, b: &Measurement) -> f64 {
    let distances = [
        a.hand.distance(b.hand),
        a.tcp.distance(b.tcp),
        a.object.distance(b.object),
        (a.aperture - b.aperture).abs() * OPEN_APERTURE,
    ];
    distances.into_iter().fold(0.0, larger)
}

/// The larger of two deviations; what is not a number is larger than any.
fn larger(a: f64, b: f64) -> f64 {
    if b > a || b.is_nan() { b } else { a }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::camera::Camera;
    use crate::embodiment::Embodiment;
    use crate::task::TaskGroup;

    fn row(embodiment: Embodiment, element: D2, of_actions: D2) -> SymmetryRow {
        let scene = Scene::new(TaskGroup::PLATE_SLIDE, embodiment, Camera::default()).unwrap();
        let mut twins = Twins::new(Arc::new(scene), element, of_actions).unwrap();
        twins.compare(1).unwrap();
        twins.row
    }

    #[test]
    fn a_wrong_mirror_is_noticed() {
        let row = row(Embodiment::HAND, D2::FlipX, D2::FlipY);
        assert!(row.free_deviation > 1e-2, "{row:?}");
        assert!(row.reward_deviation > 1e-2, "{row:?}");
        assert!(row.frames_differing * 2 > row.frames, "{row:?}");
        assert!(!row.passes());
    }

    #[test]
    fn the_arm_is_not_symmetric_open_loop() {
        let row = row(Embodiment::SAWYER, D2::FlipY, D2::FlipY);
        assert!(row.free_deviation > 1e-3, "{row:?}");
        assert!(row.passes(), "the arm is held to its returns alone: {row:?}");
    }
}
