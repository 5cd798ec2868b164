//! Environment that films an episode: the policy's observations and a camera's view of the same
//! table.

use std::sync::Arc;

use clap::ValueEnum;
use envs::{
    ACTION_DIM, Camera, CornerViewRenderer, RGB_CHANNELS, Scene, SceneRenderer, TableTop,
    TaskVariant, VecEnvSettings,
};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;
use rl::{BoxedEnvError, EnvSpec, Observations, StepOutcome, Transition, VectorEnv};

use experiments::sheet::{Picture, mark_goal};
use experiments::{RunError, SwitchableVecEnv, scale_observation_vectors};

use super::grid::FilmGridCell;

/// View of an episode that a film shows.
#[derive(Clone, Copy, Debug, PartialEq, Eq, ValueEnum)]
pub enum FilmView {
    /// Picture of a camera: the table and the arm.
    Raw,
    /// Mask of the arm: white where it hides the table.
    Mask,
    /// Lit view of the table and the arm from a corner of the table.
    Perspective,
    /// Picture of the policy: the table without the arm, and a mark at the gripper.
    #[value(name = "seen")]
    PolicyInput,
}

/// Minimum width and height of a camera's pictures in a film (pixels).
const SIDE: usize = 144;

/// Width and height of pictures of [`FilmView::Perspective`] (pixels).
pub(super) const PERSPECTIVE_SIZE: [usize; 2] = [360, 270];

/// Vector environment with a single environment, of one task variant, that films its only episode.
/// Observations are those of training.
pub struct SingleEpisodeFilmEnv {
    spec: EnvSpec,
    variant: TaskVariant,
    seed: u64,
    table: TableTop,
    renderer: SceneRenderer,
    /// Second simulation for [`FilmView::Raw`] and [`FilmView::Mask`]; `None` without these views.
    large: Option<LargeView>,
    /// Renderer of [`FilmView::Perspective`]; `None` without this view.
    corner: Option<CornerViewRenderer>,
    /// Pictures of [`FilmView::Perspective`].
    perspective: Vec<Vec<u8>>,
    /// First picture of the episode `[size, size, 3]`; empty before the reset.
    first: Vec<u8>,
    /// Pictures that the policy saw, with a mark at a goal that no picture shows.
    seen: Vec<Vec<u8>>,
}

/// Copy of the episode's simulation that takes the same actions, rendered at a higher resolution.
struct LargeView {
    table: TableTop,
    with_arm: SceneRenderer,
    without: SceneRenderer,
    raw: Vec<Vec<u8>>,
    mask: Vec<Vec<u8>>,
}

impl SingleEpisodeFilmEnv {
    /// Creates a recorder of one episode of `variant`, in an environment with the settings of a
    /// run. The placement depends on `seed` alone, so the variants of a group are mirror images of
    /// each other.
    ///
    /// # Errors
    /// Errors of the scene and its renderers.
    pub fn new(
        settings: &VecEnvSettings,
        variant: TaskVariant,
        views: &[FilmView],
        seed: u64,
    ) -> Result<Self, RunError> {
        let alone = VecEnvSettings { num_envs: 1, ..*settings };
        let (table, scene) = table(settings, variant, settings.camera)?;
        let needs_large = views.iter().any(|view| matches!(view, FilmView::Raw | FilmView::Mask));
        let [width, height] = PERSPECTIVE_SIZE;
        let corner = || CornerViewRenderer::new(&scene, width, height);
        let corner = views.contains(&FilmView::Perspective).then(corner).transpose()?;
        Ok(Self {
            spec: SwitchableVecEnv::env_spec(&alone),
            variant,
            seed,
            table,
            renderer: SceneRenderer::new(scene)?,
            large: needs_large.then(|| LargeView::new(settings, variant)).transpose()?,
            corner,
            perspective: Vec::new(),
            first: Vec::new(),
            seen: Vec::new(),
        })
    }

    /// Returns the film of each of `views`, all requested from [`SingleEpisodeFilmEnv::new`]: the
    /// first picture and those after at most `decisions` decisions.
    pub fn films_of_views(
        &self,
        views: &[FilmView],
        decisions: Option<usize>,
    ) -> Vec<FilmGridCell> {
        let cell = |&view| {
            let ([width, height], frames) = self.filmed(view);
            // the first picture comes before any decision
            let length = decisions.map_or(usize::MAX, |decisions| decisions.saturating_add(1));
            let frames = frames.iter().take(length).cloned().collect();
            FilmGridCell { width, height, frames, caption: None }
        };
        views.iter().map(cell).collect()
    }

    /// Returns the environment of the recorded episode, a table with the simulation.
    pub fn environment(&self) -> &TableTop {
        &self.table
    }

    /// Returns the top-down camera of a requested view; of the perspective view and of views that
    /// were not requested, that of the policy's images.
    pub fn camera(&self, view: FilmView) -> Camera {
        let table = match (view, &self.large) {
            (FilmView::Raw | FilmView::Mask, Some(large)) => &large.table,
            _ => &self.table,
        };
        table.scene().camera
    }

    /// Returns the latest picture of a requested view, or `None` before the episode.
    pub fn newest_picture(&self, view: FilmView) -> Option<Picture> {
        let ([width, height], frames) = self.filmed(view);
        Some(Picture { width, height, rgb: frames.last()?.clone() })
    }

    /// Returns width and height (pixels) of a view, and its pictures.
    fn filmed(&self, view: FilmView) -> ([usize; 2], &[Vec<u8>]) {
        let frames = match (view, &self.large) {
            (FilmView::Perspective, _) => return (PERSPECTIVE_SIZE, &self.perspective),
            (FilmView::Raw, Some(large)) => &large.raw,
            (FilmView::Mask, Some(large)) => &large.mask,
            _ => &self.seen,
        };
        ([self.camera(view).size; 2], frames)
    }

    fn observe(&mut self, out: &mut Observations) -> Result<(), RunError> {
        let mut picture = vec![0; self.pixels()];
        self.renderer.render(&mut self.table, &mut picture)?;
        if self.first.is_empty() {
            self.first.clone_from(&picture);
        }
        self.renderer.compose_observation(&self.table, &picture, &self.first, &mut out.images);
        out.vectors.copy_from_slice(&self.table.observe()?);
        scale_observation_vectors(&mut out.vectors);
        if let Some(corner) = &mut self.corner {
            self.perspective.push(corner.render(&mut self.table)?);
        }
        // for viewers only: the policy's observation is complete, and it gets the goal as numbers
        mark_goal(&self.table, &mut picture);
        self.seen.push(picture);
        Ok(())
    }

    fn pixels(&self) -> usize {
        self.spec.image_shape[0] * self.spec.image_shape[1] * RGB_CHANNELS
    }

    fn begin(&mut self, out: &mut Observations) -> Result<(), RunError> {
        // both simulations draw the same placement from generators of the same seed
        let rng = || ChaCha8Rng::seed_from_u64(self.seed);
        self.table.reset(self.variant.element, &mut rng())?;
        if let Some(large) = &mut self.large {
            large.table.reset(self.variant.element, &mut rng())?;
            large.film()?;
        }
        self.observe(out)
    }

    fn act(&mut self, action: &[f32], out: &mut Transition) -> Result<(), RunError> {
        let action = std::array::from_fn::<_, ACTION_DIM, _>(|i| action[i]);
        let step = self.table.step(&action)?;
        if let Some(large) = &mut self.large {
            large.table.step(&action)?;
            large.film()?;
        }
        self.observe(&mut out.observations)?;
        out.final_observations.clone_from(&out.observations);
        out.rewards.fill(step.reward as f32);
        out.success.fill(step.success);
        out.success_at_end.fill(step.success_at_end);
        out.outcomes.fill(if step.truncated {
            StepOutcome::Truncated
        } else {
            StepOutcome::Running
        });
        Ok(())
    }
}

impl LargeView {
    fn new(settings: &VecEnvSettings, variant: TaskVariant) -> Result<Self, RunError> {
        let size = settings.camera.size.max(SIDE);
        let camera = settings.camera.with_size(size);
        let (table, scene) = table(settings, variant, camera)?;
        Ok(Self {
            table,
            with_arm: SceneRenderer::with_arm(Arc::clone(&scene))?,
            without: SceneRenderer::without_arm(scene)?,
            raw: Vec::new(),
            mask: Vec::new(),
        })
    }

    /// Renders the table with and without the arm; the mask is where the two pictures differ.
    fn film(&mut self) -> Result<(), RunError> {
        let size = self.table.scene().camera.size;
        let [mut raw, mut bare] = [(); 2].map(|()| vec![0; size * size * RGB_CHANNELS]);
        self.with_arm.render(&mut self.table, &mut raw)?;
        self.without.render(&mut self.table, &mut bare)?;
        let pixels = raw.chunks_exact(RGB_CHANNELS).zip(bare.chunks_exact(RGB_CHANNELS));
        let hidden = pixels.map(|(with, without)| if with == without { 0 } else { 255 });
        self.mask.push(hidden.flat_map(|grey| [grey; RGB_CHANNELS]).collect());
        mark_goal(&self.table, &mut raw);
        self.raw.push(raw);
        Ok(())
    }
}

impl VectorEnv for SingleEpisodeFilmEnv {
    fn spec(&self) -> &EnvSpec {
        &self.spec
    }

    fn reset(&mut self, out: &mut Observations) -> Result<(), BoxedEnvError> {
        Ok(self.begin(out)?)
    }

    fn step(&mut self, actions: &[f32], out: &mut Transition) -> Result<(), BoxedEnvError> {
        Ok(self.act(actions, out)?)
    }
}

fn table(
    settings: &VecEnvSettings,
    variant: TaskVariant,
    camera: Camera,
) -> Result<(TableTop, Arc<Scene>), RunError> {
    let (layout, embodiment) = (settings.layout, settings.embodiment);
    let scene = Arc::new(Scene::new_in_layout(layout, variant.group, embodiment, camera)?);
    Ok((TableTop::new(Arc::clone(&scene), settings.control)?, scene))
}
