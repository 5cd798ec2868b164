//! Comparison of a variant with the canonical variant: both should stay mirror images of each
//! other.

use std::sync::Arc;

use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;
use serde::Serialize;
use symmetry::D2;

use super::experts::{VariantName, check_seeds, episode};
use crate::camera::RGB_CHANNELS;
use crate::embodiment_spec::OPEN_APERTURE;
use crate::error::EnvError;
use crate::renderer::SceneRenderer;
use crate::scene::Scene;
use crate::tabletop::{ACTION_DIM, ACTION_IRREPS, TableTop};
use crate::task::{Placement, TaskState};

/// Largest relative difference of an expert's return between variants of a group, closed loop.
const RETURN_SPREAD: f64 = 0.03;
/// Largest deviation (metres) of a variant from its canonical twin before the first contact, open
/// loop, with an exactly symmetric embodiment.
const FREE_DEVIATION: f64 = 1e-9;
/// Largest such deviation (metres) from the first contact on: contacts amplify rounding errors.
const CONTACT_DEVIATION: f64 = 1e-6;

/// Number of decisions that a random action is held for.
const HELD: usize = 5;

/// Deviation of a variant from the mirror image of its canonical twin.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SymmetryDeviation {
    /// Variant that was compared with its canonical twin.
    #[serde(flatten)]
    pub variant: VariantName,
    /// `true` if the embodiment is exactly symmetric.
    #[serde(skip)]
    moves_exactly: bool,
    /// `true` if pictures are mirror images bit for bit, too.
    #[serde(skip)]
    looks_exact: bool,
    /// Largest deviation (metres) of hand, fingertips, pads, claw distance or object before the
    /// first contact; open loop with mirrored actions.
    pub free_deviation: f64,
    /// Largest deviation (metres) of hand, fingertips, pads, claw distance or object from the first
    /// contact on.
    pub contact_deviation: f64,
    /// Largest difference between the rewards of a decision, open loop.
    pub reward_deviation: f64,
    /// Number of pictures compared between variant and twin, one per decision, open loop.
    pub frames: usize,
    /// Number of compared pictures that were not exact mirror images.
    pub frames_differing: usize,
    /// Number of differing pixels in the picture that differs most.
    pub pixels_differing: usize,
    /// Expert's mean return on the variant divided by that on the canonical twin, closed loop.
    pub return_ratio: f64,
}

impl SymmetryDeviation {
    /// Returns `true` if the returns agree within 3 % and, with an exactly symmetric embodiment,
    /// motion agrees within 1e-9 m (1e-6 m from the first contact on) and pictures of an aligned
    /// camera mirror bit for bit.
    pub fn passes(&self) -> bool {
        let fair = (self.return_ratio - 1.0).abs() <= RETURN_SPREAD;
        let moves =
            self.free_deviation <= FREE_DEVIATION && self.contact_deviation <= CONTACT_DEVIATION;
        let looks = self.frames_differing == 0;
        fair && (moves || !self.moves_exactly) && (looks || !self.looks_exact)
    }
}

/// Compares the motion, pictures and returns of the variant `element` with those of its canonical
/// twin, on the placements of the seeds `0..seeds`.
///
/// Open loop, the variant gets the twin's actions mirrored: first those of the twin's expert, then
/// random ones. Closed loop, each has its own expert.
///
/// # Errors
/// [`EnvError::InvalidSetting`] for zero seeds, [`EnvError::NoSuchVariant`], or an error of MuJoCo
/// or OpenGL.
pub fn measure_symmetry(
    scene: &Arc<Scene>,
    element: D2,
    seeds: u64,
) -> Result<SymmetryDeviation, EnvError> {
    check_seeds(seeds)?;
    let mut twins = Twins::new(Arc::clone(scene), element, element)?;
    twins.compare(seeds)?;
    Ok(twins.row)
}

/// Canonical environment and a variant of it that gets the same actions, mirrored.
struct Twins {
    canonical: TableTop,
    variant: TableTop,
    element: D2,
    /// Element of D2 that maps the actions of the canonical environment to the variant's. Only the
    /// tests of this checker use another one than `element`.
    of_actions: D2,
    renderer: SceneRenderer,
    pictures: [Vec<u8>; 2],
    touched: bool,
    row: SymmetryDeviation,
}

/// Source of the actions in the canonical environment: the scripted expert or random numbers.
#[derive(Clone, Copy)]
enum Driver {
    Expert,
    Random,
}

impl Twins {
    fn new(scene: Arc<Scene>, element: D2, of_actions: D2) -> Result<Self, EnvError> {
        let control = scene.layout.control_settings();
        let pixels = scene.camera.size * scene.camera.size * RGB_CHANNELS;
        let row = SymmetryDeviation {
            variant: VariantName::new(&scene, element),
            moves_exactly: scene.embodiment.mirrors_exactly(),
            looks_exact: scene.mirrors_exactly(),
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
            // one placement for both: the variant maps it itself
            let placement = self.canonical.scene().sample_placement(&mut rng);
            for driver in [Driver::Expert, Driver::Random] {
                self.open_loop(placement, driver, &mut rng)?;
            }
            self.reset(placement)?;
            returns[0] += episode(&mut self.canonical)?.0;
            returns[1] += episode(&mut self.variant)?.0;
        }
        // of sums, since single returns of a hard placement may be near zero
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
        for decision in 0..self.canonical.control_settings().decisions_per_episode() {
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
        self.touched |= self.canonical.had_contact() || self.variant.had_contact();
        let deviation = deviation(&self.canonical.task_state()?, &self.variant.task_state()?);
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
        // pixels are permuted without interpolation, so exact equality is the right test
        let mirrored = self.element.transform_image(here, size, size, RGB_CHANNELS);
        let pixels = mirrored.chunks(RGB_CHANNELS).zip(there.chunks(RGB_CHANNELS));
        let differing = pixels.filter(|(a, b)| a != b).count();
        self.row.frames += 1;
        self.row.frames_differing += usize::from(differing > 0);
        self.row.pixels_differing = self.row.pixels_differing.max(differing);
        Ok(())
    }
}

/// Returns the largest distance (metres) between the measurements of two environments, in the
/// canonical frame.
fn deviation(a: &TaskState, b: &TaskState) -> f64 {
    let distances = [
        a.hand.distance(b.hand),
        a.tcp.distance(b.tcp),
        a.object.distance(b.object),
        a.tip.distance(b.tip),
        (a.pads[0] - b.pads[0]).abs(),
        (a.pads[1] - b.pads[1]).abs(),
        // back in metres, like the other deviations
        (a.aperture - b.aperture).abs() * OPEN_APERTURE,
    ];
    distances.into_iter().fold(0.0, larger)
}

/// Returns the larger of two deviations; NaN counts as larger than any number.
fn larger(a: f64, b: f64) -> f64 {
    if b > a || b.is_nan() { b } else { a }
}

#[cfg(test)]
mod tests {
    use glam::DVec3;

    use super::*;
    use crate::camera::Camera;
    use crate::control::ControlSettings;
    use crate::embodiment::Embodiment;
    use crate::task::TaskGroup;

    #[test]
    fn a_wrong_mirror_is_noticed() {
        let scene =
            Scene::new(TaskGroup::PLATE_SLIDE, Embodiment::FLOATING_HAND, Camera::default());
        let mut twins = Twins::new(Arc::new(scene.unwrap()), D2::FlipX, D2::FlipY).unwrap();
        twins.compare(1).unwrap();
        let row = twins.row;
        assert!(row.free_deviation > 1e-2, "{row:?}");
        assert!(row.reward_deviation > 1e-2, "{row:?}");
        assert!(row.frames_differing * 2 > row.frames, "{row:?}");
        assert!(!row.passes());
    }

    #[test]
    fn every_point_and_the_sides_of_the_pads_count() {
        let scene =
            Scene::new(TaskGroup::PEG_INSERT_SIDE, Embodiment::FLOATING_HAND, Camera::default());
        let mut table =
            TableTop::new(Arc::new(scene.unwrap()), ControlSettings::default()).unwrap();
        table.reset(D2::FlipY, &mut ChaCha8Rng::seed_from_u64(0)).unwrap();
        let good = table.task_state().unwrap();
        assert_eq!(deviation(&good, &good), 0.0);
        let [low, high] = good.pads;
        assert!(low < high, "{good:?}");
        let moved = DVec3::new(0.0, 0.0, 0.02);
        for (bad, least) in [
            (TaskState { pads: [high, low], ..good }, 0.05),
            (TaskState { hand: good.hand + moved, ..good }, 0.01),
            (TaskState { tcp: good.tcp + moved, ..good }, 0.01),
            (TaskState { object: good.object + moved, ..good }, 0.01),
            (TaskState { tip: good.tip + moved, ..good }, 0.01),
            (TaskState { aperture: good.aperture - 0.2, ..good }, 0.01),
        ] {
            assert!(deviation(&good, &bad) > least, "{bad:?}");
        }
    }
}
