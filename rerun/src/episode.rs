//! Recording of an episode while a policy plays it.

use envs::TaskVariant;
use re_sdk_types::archetypes::{EncodedImage, Scalars};
use rl::{BoxedEnvError, EnvSpec, Observations, Transition, VectorEnv};

use covers::RunError;
use covers::render::{FilmView, PolicyPlayer, SingleEpisodeFilmEnv};

use crate::recording::{DECISION, Recording, refused};
use crate::scene::ShapeRecorder;

/// Views of an episode that are recorded as images, each with its entity path below the variant's.
pub(crate) const VIEWS: [(FilmView, &str); 3] = [
    (FilmView::Raw, "table/camera/raw"),
    (FilmView::Mask, "mask"),
    (FilmView::PolicyInput, "seen"),
];

/// Names of the components of an action.
const ACTION: [&str; 4] = ["x", "y", "z", "fingers"];

/// Returns the entity path of a task variant in a Rerun recording.
pub(crate) fn place(variant: TaskVariant) -> String {
    let element = variant.element.to_string().replace(' ', "-");
    format!("{}/{element}", variant.group)
}

/// Records an episode of a variant, played by the policy that the learner chooses for it. Returns a
/// line with the policy's number and the outcome.
pub(crate) fn record(
    variant: TaskVariant,
    seed: u64,
    show: &mut PolicyPlayer,
    recording: &Recording,
) -> Result<String, RunError> {
    let views = VIEWS.map(|(view, _)| view);
    let studio = SingleEpisodeFilmEnv::new(&show.experiment.envs, variant, &views, seed)?;
    let mut stage = Stage { place: place(variant), solids: None, decision: 0, studio, recording };
    let (policy, success) = show.play_episode(variant, &mut stage)?;
    let outcome = if success { "solved" } else { "not solved" };
    Ok(format!("{variant}: policy {policy}, {outcome}"))
}

/// Environment whose steps are recorded.
struct Stage<'a> {
    place: String,
    /// Shapes on the table; `None` before the episode.
    solids: Option<ShapeRecorder>,
    decision: usize,
    studio: SingleEpisodeFilmEnv,
    recording: &'a Recording,
}

impl Stage<'_> {
    fn begin(&mut self) -> Result<(), RunError> {
        let place = format!("{}/table", self.place);
        let (table, above) = (self.studio.environment(), self.studio.camera(FilmView::Raw));
        self.solids = Some(ShapeRecorder::record_shapes(place, table, &above, self.recording)?);
        self.decision = 0;
        self.recording.set_time(&[(DECISION, 0)]);
        self.show()
    }

    fn show(&mut self) -> Result<(), RunError> {
        let (recording, table) = (self.recording, self.studio.environment());
        if let Some(solids) = &mut self.solids {
            solids.record_moved_poses(table, recording)?;
        }
        for (view, name) in VIEWS {
            if let Some(picture) = self.studio.newest_picture(view) {
                let png = picture.to_png().map_err(refused(recording.path()))?;
                let image = EncodedImage::from_file_contents(png).with_media_type("image/png");
                recording.log(&format!("{}/{name}", self.place), &image)?;
            }
        }
        Ok(())
    }

    fn decided(&mut self, actions: &[f32], step: &Transition) -> Result<(), RunError> {
        let (recording, place) = (self.recording, &self.place);
        recording.set_time(&[(DECISION, self.decision)]);
        for (name, &value) in ACTION.iter().zip(actions) {
            let part = Scalars::single(f64::from(value));
            recording.log(&format!("{place}/action/{name}"), &part)?;
        }
        self.decision += 1;
        recording.set_time(&[(DECISION, self.decision)]);
        let reward = Scalars::single(f64::from(step.rewards[0]));
        recording.log(&format!("{place}/reward"), &reward)?;
        self.show()
    }
}

impl VectorEnv for Stage<'_> {
    fn spec(&self) -> &EnvSpec {
        self.studio.spec()
    }

    fn reset(&mut self, out: &mut Observations) -> Result<(), BoxedEnvError> {
        self.studio.reset(out)?;
        Ok(self.begin()?)
    }

    fn step(&mut self, actions: &[f32], out: &mut Transition) -> Result<(), BoxedEnvError> {
        self.studio.step(actions, out)?;
        Ok(self.decided(actions, out)?)
    }
}
