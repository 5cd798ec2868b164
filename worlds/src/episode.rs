//! Episode of one environment, simulated in one frame of reference; pictures, vectors and actions
//! are mirrored by an element of D2.

use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use symmetry::{D2, Irrep};

use crate::group::TaskGroup;
use crate::picture::{PICTURE_SIZE, Picture};
use crate::scene::SceneSettings;

/// Largest absolute coordinate of the hand, in units of half the side of the picture.
// Below 1, so that the hand's centre stays in the picture.
const REACH: f32 = 0.95;
/// Largest distance of the hand from a position of full reward that counts as success, in units of
/// half the side of the picture.
// The reward there is exp(-10 * 0.06), about 0.55.
const NEAR: f32 = 0.06;

/// State of an environment's current episode: task group, scene, hand, object, and pictures.
#[derive(Clone, Debug)]
pub(crate) struct Episode {
    group: TaskGroup,
    scene: SceneSettings,
    variant: D2,
    hand: [f32; 2],
    object: [f32; 2],
    still: Picture,
    /// Picture without the object, in scenes in which the object appears after some decisions.
    empty: Option<Picture>,
    first: Vec<u8>,
    now: Vec<u8>,
    rng: ChaCha8Rng,
}

impl Episode {
    /// Begins an episode: places the object of `group` at random in a scene.
    pub fn begin(
        scene: SceneSettings,
        group: TaskGroup,
        variant: Option<D2>,
        mut rng: ChaCha8Rng,
    ) -> Self {
        // drawn even if the caller chose a variant, so that the rest of the episode stays the same
        let drawn = D2::from_bits(rng.random_range(0..4));
        let [from, to] = scene.object_range;
        let object = [0; 2].map(|_| rng.random_range(from..=to));
        let empty = (scene.decisions_without_object > 0)
            .then(|| Picture::render_without_hand(&scene, &group, object, false, &mut rng.clone()));
        let still = Picture::render_without_hand(&scene, &group, object, true, &mut rng);
        let mut episode = Self {
            group,
            scene,
            variant: variant.unwrap_or(drawn),
            hand: [0.0; 2],
            object,
            still,
            empty,
            first: Vec::new(),
            now: Vec::new(),
            rng,
        };
        episode.render();
        episode.first.clone_from(&episode.now);
        episode
    }

    /// Moves the hand by an action, which is mirrored as the pictures are. Returns the reward, and
    /// `true` if the step counts as success.
    pub fn step(&mut self, action: [f32; 2]) -> (f32, bool) {
        let action = mirrored(self.variant, action).map(|a| a.clamp(-1.0, 1.0));
        let motion = self.group.dynamics.displacement(action);
        for (hand, shift) in self.hand.iter_mut().zip(motion) {
            *hand = (*hand + shift).clamp(-REACH, REACH);
        }
        self.scene.decisions_without_object = self.scene.decisions_without_object.saturating_sub(1);
        self.render();
        let (position, reward) = (self.relative_position(), &self.group.reward);
        let value = self.scene.reward_scale * reward.reward_at(position);
        (value, reward.distance_to_target_circle(position) <= NEAR)
    }

    /// Renders the camera picture of the present state.
    fn render(&mut self) {
        let empty = self.empty.as_ref().filter(|_| self.scene.decisions_without_object > 0);
        let picture = empty.unwrap_or(&self.still).with_hand(self.hand);
        self.now = picture.to_noisy_bytes(self.scene.noise_amplitude, &mut self.rng);
    }

    /// Returns the action of a scripted expert for `group`, mirrored as the pictures are.
    pub fn expert_action(&self, group: &TaskGroup) -> [f32; 2] {
        let action = group.dynamics.action_for_displacement(
            group.reward.vector_to_target_circle(self.relative_position()),
        );
        // actions are scaled as a whole, since clipping each component would change the direction
        let most = action[0].abs().max(action[1].abs()).max(1.0);
        mirrored(self.variant, action.map(|a| a / most))
    }

    /// Writes the observation, the picture `[48, 48, 6]` and the hand's position (x, y), both
    /// mirrored by the episode's element of D2.
    pub fn write_observation(&self, image: &mut [u8], vector: &mut [f32]) {
        for (at, pixel) in image.chunks_exact_mut(6).enumerate() {
            // every variant is its own inverse, so the source is where the pixel goes
            let (row, col) = self.variant.apply_pixel(
                at / PICTURE_SIZE,
                at % PICTURE_SIZE,
                PICTURE_SIZE,
                PICTURE_SIZE,
            );
            let from = 3 * (row * PICTURE_SIZE + col);
            pixel[..3].copy_from_slice(&self.now[from..from + 3]);
            pixel[3..].copy_from_slice(&self.first[from..from + 3]);
        }
        vector.copy_from_slice(&mirrored(self.variant, self.hand));
    }

    /// Returns the hand's position relative to the object.
    fn relative_position(&self) -> [f32; 2] {
        [self.hand[0] - self.object[0], self.hand[1] - self.object[1]]
    }
}

fn mirrored(g: D2, [x, y]: [f32; 2]) -> [f32; 2] {
    [x * f32::from(Irrep::X.sign(g)), y * f32::from(Irrep::Y.sign(g))]
}
