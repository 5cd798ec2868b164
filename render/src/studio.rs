//! One variant on film: what its policy sees, and what a camera would see of the same episode.

use std::sync::Arc;

use clap::ValueEnum;
use envs::{ACTION_DIM, Camera, RGB, Scene, SceneRenderer, TableTop, TaskVariant, VecEnvSettings};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rl::{BoxError, EnvSpec, Observations, Outcome, Transition, VectorEnv};

use experiments::sheet::{Picture, mark_goal};
use experiments::{RunError, Stream, scale};

use super::mosaic::Cell;

/// What is shown of an episode.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum View {
    /// What a camera sees: the table and the arm.
    Raw,
    /// Where the arm hides the table: white.
    Mask,
    /// What the policy sees: the table without the arm, and a mark at the gripper.
    Seen,
}

/// Least side of a camera's pictures (pixels).
const SIDE: usize = 144;

/// An environment of one that is filmed. The policy sees what it has learnt with.
pub struct Studio {
    spec: EnvSpec,
    variant: TaskVariant,
    seed: u64,
    table: TableTop,
    renderer: SceneRenderer,
    camera: Option<CameraMan>,
    first: Vec<u8>,
    /// What the policy saw, with a mark where a goal is told that no picture shows.
    seen: Vec<Vec<u8>>,
}

/// A table on which all happens once more, with a larger picture of it.
struct CameraMan {
    table: TableTop,
    with_arm: SceneRenderer,
    without: SceneRenderer,
    raw: Vec<Vec<u8>>,
    mask: Vec<Vec<u8>>,
}

impl Studio {
    /// A studio for environments of `settings`. The placement depends on `seed` alone, so variants
    /// of a group are mirror images.
    pub fn new(
        settings: &VecEnvSettings,
        variant: TaskVariant,
        views: &[View],
        seed: u64,
    ) -> Result<Self, RunError> {
        let alone = VecEnvSettings { num_envs: 1, ..*settings };
        let (table, scene) = table(settings, variant, settings.camera)?;
        let filmed = views.iter().any(|view| *view != View::Seen);
        Ok(Self {
            spec: Stream::spec_of(&alone),
            variant,
            seed,
            table,
            renderer: SceneRenderer::new(scene)?,
            camera: match filmed {
                true => Some(CameraMan::new(settings, variant)?),
                false => None,
            },
            first: Vec::new(),
            seen: Vec::new(),
        })
    }

    /// What was filmed, one cell for each view, up to a number of decisions.
    pub fn cells(&self, views: &[View], decisions: Option<usize>) -> Vec<Cell> {
        let cell = |&view| {
            let (table, frames) = self.filmed(view);
            let size = table.scene().camera.size;
            let length = decisions.map_or(usize::MAX, |decisions| decisions.saturating_add(1));
            Cell {
                width: size,
                height: size,
                frames: frames.iter().take(length).cloned().collect(),
            }
        };
        views.iter().map(cell).collect()
    }

    /// The table on which the episode is played.
    pub fn table(&self) -> &TableTop {
        &self.table
    }

    /// The camera of a view that was asked for.
    pub fn camera(&self, view: View) -> Camera {
        self.filmed(view).0.scene().camera
    }

    /// The newest picture of a view that was asked for.
    pub fn newest(&self, view: View) -> Option<Picture> {
        let (table, frames) = self.filmed(view);
        let size = table.scene().camera.size;
        Some(Picture { width: size, height: size, rgb: frames.last()?.clone() })
    }

    fn filmed(&self, view: View) -> (&TableTop, &[Vec<u8>]) {
        match (view, &self.camera) {
            (View::Raw, Some(camera)) => (&camera.table, &camera.raw),
            (View::Mask, Some(camera)) => (&camera.table, &camera.mask),
            _ => (&self.table, &self.seen),
        }
    }

    fn observe(&mut self, out: &mut Observations) -> Result<(), RunError> {
        let mut picture = vec![0; self.pixels()];
        self.renderer.render(&mut self.table, &mut picture)?;
        if self.first.is_empty() {
            self.first.clone_from(&picture);
        }
        self.renderer.compose(&self.table, &picture, &self.first, &mut out.images);
        out.vectors.copy_from_slice(&self.table.observe()?);
        scale(&mut out.vectors);
        mark_goal(&self.table, &mut picture);
        self.seen.push(picture);
        Ok(())
    }

    fn pixels(&self) -> usize {
        self.spec.image[0] * self.spec.image[1] * RGB
    }

    fn begin(&mut self, out: &mut Observations) -> Result<(), RunError> {
        let rng = || ChaCha8Rng::seed_from_u64(self.seed);
        self.table.reset(self.variant.element, &mut rng())?;
        if let Some(camera) = &mut self.camera {
            camera.table.reset(self.variant.element, &mut rng())?;
            camera.take()?;
        }
        self.observe(out)
    }

    fn act(&mut self, action: &[f32], out: &mut Transition) -> Result<(), RunError> {
        let action = std::array::from_fn::<_, ACTION_DIM, _>(|i| action[i]);
        let step = self.table.step(&action)?;
        if let Some(camera) = &mut self.camera {
            camera.table.step(&action)?;
            camera.take()?;
        }
        self.observe(&mut out.observations)?;
        out.final_observations.clone_from(&out.observations);
        out.rewards.fill(step.reward as f32);
        out.success.fill(step.success);
        out.success_at_end.fill(step.success_at_end);
        let outcome = [Outcome::Running, Outcome::Truncated][usize::from(step.truncated)];
        out.outcomes.fill(outcome);
        Ok(())
    }
}

impl CameraMan {
    fn new(settings: &VecEnvSettings, variant: TaskVariant) -> Result<Self, RunError> {
        let size = settings.camera.size.max(SIDE);
        let camera = settings.camera.with_size(size);
        let (table, scene) = table(settings, variant, camera)?;
        Ok(Self {
            table,
            with_arm: SceneRenderer::with_arm(Arc::clone(&scene))?,
            without: SceneRenderer::of_table(scene)?,
            raw: Vec::new(),
            mask: Vec::new(),
        })
    }

    fn take(&mut self) -> Result<(), RunError> {
        let size = self.table.scene().camera.size;
        let [mut raw, mut bare] = [(); 2].map(|()| vec![0; size * size * RGB]);
        self.with_arm.render(&mut self.table, &mut raw)?;
        self.without.render(&mut self.table, &mut bare)?;
        let pixels = raw.chunks_exact(RGB).zip(bare.chunks_exact(RGB));
        let hidden = pixels.map(|(with, without)| if with == without { 0 } else { 255 });
        self.mask.push(hidden.flat_map(|grey| [grey; RGB]).collect());
        mark_goal(&self.table, &mut raw);
        self.raw.push(raw);
        Ok(())
    }
}

impl VectorEnv for Studio {
    fn spec(&self) -> &EnvSpec {
        &self.spec
    }

    fn reset(&mut self, out: &mut Observations) -> Result<(), BoxError> {
        Ok(self.begin(out)?)
    }

    fn step(&mut self, actions: &[f32], out: &mut Transition) -> Result<(), BoxError> {
        Ok(self.act(actions, out)?)
    }
}

/// A table of a variant's group under a camera, and its scene.
fn table(
    settings: &VecEnvSettings,
    variant: TaskVariant,
    camera: Camera,
) -> Result<(TableTop, Arc<Scene>), RunError> {
    let (layout, embodiment) = (settings.layout, settings.embodiment);
    let scene = Arc::new(Scene::in_layout(layout, variant.group, embodiment, camera)?);
    Ok((TableTop::new(Arc::clone(&scene), settings.control)?, scene))
}
