//! Minibatches of SAC: sampled steps and noise, and buffers for the passes over them.

use equivariant::Scalar;
use rand::RngExt;
use rand_chacha::ChaCha8Rng;
use symmetry::D2;

use crate::distributions::standard_normals;
use crate::env::{EnvSpec, transform_image};
use crate::replay::{ReplayBuffer, StepId};
use crate::sac::context::{ContextSteps, ContextWorkspace, GruInputs};
use crate::sac::network::SacNetwork;
use crate::sac::settings::SacSettings;
use crate::trunk::{LayerWorkspace, TrunkWorkspace};

/// Returns the number of steps that one thread processes at a time (a chunk) in training: 8 as in
/// PPO, or the `window` of consecutive steps ([`SacSettings::window`]) if that is more, since steps
/// share observations only within a chunk; at most 32, because the memory of a workspace grows with
/// it.
pub(super) fn training_chunk(window: usize) -> usize {
    window.clamp(8, 32)
}

/// Random transformation of a step: a shift of its images, and then a group element that transforms
/// images, vectors and actions.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Augmentation {
    pub element: D2,
    /// Pixels by which images move down and to the right; negative for up and left.
    pub shift: [i8; 2],
}

impl Augmentation {
    #[cfg(test)]
    pub const NONE: Self = Self { element: D2::Identity, shift: [0, 0] };

    fn sample(settings: &SacSettings, rng: &mut ChaCha8Rng) -> Self {
        let group = settings.augmentation.elements();
        let element = group[rng.random_range(0..group.len())];
        // at most 16
        let limit = settings.random_shift as i8;
        let shift = match limit {
            // without shifts, no random numbers are drawn for them
            0 => [0, 0],
            _ => [(); 2].map(|()| rng.random_range(-limit..=limit)),
        };
        Self { element, shift }
    }

    /// Transforms an image `[H, W, C]` of the sizes in `spec`.
    pub fn transform_image(self, image: &mut Vec<u8>, spec: &EnvSpec) {
        // no copies without augmentation
        if self.shift != [0, 0] {
            *image = shifted_image(image, spec.image_shape, self.shift);
        }
        if self.element != D2::Identity {
            *image = transform_image(self.element, image, spec);
        }
    }
}

/// Returns the image `[H, W, C]` moved down and to the right by `shift` pixels, with the pixels of
/// its edge repeated.
fn shifted_image(image: &[u8], shape: [usize; 3], shift: [i8; 2]) -> Vec<u8> {
    let [height, width, channels] = shape;
    if image.is_empty() {
        return Vec::new();
    }
    let [down, right] = shift.map(isize::from);
    let pixel = |row: usize, column: usize| {
        let from_row = row.saturating_add_signed(-down).min(height - 1);
        let from_column = column.saturating_add_signed(-right).min(width - 1);
        let start = (from_row * width + from_column) * channels;
        &image[start..start + channels]
    };
    let pixels = (0..height).flat_map(|row| (0..width).map(move |column| (row, column)));
    pixels.flat_map(|(row, column)| pixel(row, column)).copied().collect()
}

/// Steps, augmentations and noise that were sampled for a minibatch of B steps; kept between
/// gradient steps to reuse the allocations.
#[derive(Debug, Default)]
pub(super) struct SampledMinibatch {
    /// Index in the replay buffer of the first step of each window of consecutive steps.
    pub indices: Vec<usize>,
    /// Index of the window's first step, and offset in the window, of each of the minibatch's
    /// steps, `[B]`.
    pub steps: Vec<(usize, usize)>,
    /// Augmentation of each step, `[B]`, the same for all steps of a window.
    pub augmentations: Vec<Augmentation>,
    /// Standard normal noise of the actor at the current, and at the next observations, `[B, A]`
    /// each.
    pub noise: [Vec<f32>; 2],
}

impl SampledMinibatch {
    /// Samples a minibatch: first the windows of consecutive steps, then their augmentations, then
    /// the actor's noise.
    pub fn sample(&mut self, settings: &SacSettings, replay: &ReplayBuffer, rng: &mut ChaCha8Rng) {
        let (batch, window) = (settings.batch, settings.window);
        let windows = batch.div_ceil(window);
        replay.sample_indices(windows, settings.newest_share, rng, &mut self.indices);
        let in_window = |&index: &usize| (0..window).map(move |offset| (index, offset));
        self.steps.clear();
        self.steps.extend(self.indices.iter().flat_map(in_window).take(batch));
        self.augmentations.clear();
        for _ in 0..windows {
            let augmentation = Augmentation::sample(settings, rng);
            self.augmentations.extend([augmentation].repeat(window));
        }
        self.augmentations.truncate(batch);
        for noise in &mut self.noise {
            noise.resize(batch * replay.spec().action_irreps.len(), 0.0);
            standard_normals(rng, noise);
        }
    }
}

/// Key of an encoded observation: its identifier in the replay buffer and its augmentation.
pub(crate) type ObservationKey = (StepId, Augmentation);

/// Activations, gradients and scratch memory of a [`SacNetwork`]'s passes over up to K steps,
/// allocated once.
pub(crate) struct SacWorkspace<T> {
    /// Buffers of the trunk's pass over the observations acted on.
    pub current: TrunkWorkspace<T>,
    /// Buffers of the trunk's pass over all other observations: the next ones, and those of the
    /// steps before.
    pub others: TrunkWorkspace<T>,
    /// Keys of the observations of `current`, then of `others`.
    pub observation_keys: Vec<ObservationKey>,
    /// Positions in `observation_keys` of each step's next observation and of the observations of
    /// the steps before it.
    pub observation_positions: Vec<usize>,
    /// Fields of the trunk for the next observations, `[K, h]`.
    pub next_fields: Vec<T>,
    /// GRU input of the step at each observation in `observation_keys`.
    pub gru_inputs: GruInputs<T>,
    /// Steps before the current, and before the next observations, that the GRUs read.
    pub context_steps: [ContextSteps; 2],
    pub actor_reader: ContextWorkspace<T>,
    pub critic_reader: ContextWorkspace<T>,
    pub actor: LayerWorkspace<T>,
    pub critics: [LayerWorkspace<T>; 2],
    /// Actor outputs (mean, raw log_std) `[K, 2 A]` in the environment's order, and their gradient.
    pub output: Vec<f64>,
    pub d_output: Vec<f64>,
    /// Actions `[K, A]` in the environment's order, their log-probabilities `[K]`, and the actions'
    /// gradient.
    pub actions: Vec<f64>,
    pub log_pi: Vec<f64>,
    pub d_actions: Vec<f64>,
    /// Actions in irrep-major order, and the gradient with respect to a critic's state input.
    pub irrep_actions: Vec<T>,
    pub d_state: Vec<T>,
    /// Targets y of the critics' loss, `[K]`.
    pub td_targets: Vec<f64>,
    /// Gradient of the actor's loss with respect to the critics' parameters, which must not train
    /// the critics.
    pub unused_gradient: Vec<T>,
    /// Scratch memory for one image.
    pub image: Vec<u8>,
}

impl<T: Scalar> SacNetwork<T> {
    /// Allocates a workspace for up to `capacity` steps (K).
    pub(crate) fn new_workspace(&self, capacity: usize) -> SacWorkspace<T> {
        let width = self.action_order.len();
        let zeros = |len: usize| vec![0.0; capacity * len];
        let reals = |len: usize| vec![T::ZERO; capacity * len];
        SacWorkspace {
            current: self.trunk.new_workspace(capacity),
            others: self.trunk.new_workspace(capacity * (1 + self.reader.max_steps())),
            observation_keys: Vec::new(),
            observation_positions: Vec::new(),
            next_fields: reals(self.trunk.out_type().dim()),
            gru_inputs: GruInputs::default(),
            context_steps: <[ContextSteps; 2]>::default(),
            actor_reader: self.reader.new_workspace(capacity),
            critic_reader: self.reader.new_workspace(capacity),
            actor: LayerWorkspace::new(&self.actor, capacity),
            critics: [(); 2].map(|()| LayerWorkspace::new(&self.critic, capacity)),
            output: zeros(2 * width),
            d_output: zeros(2 * width),
            actions: zeros(width),
            log_pi: zeros(1),
            d_actions: zeros(width),
            irrep_actions: reals(width),
            d_state: reals(self.reader.out_type().dim()),
            td_targets: zeros(1),
            unused_gradient: vec![T::ZERO; self.num_params()],
            image: vec![0; self.spec().image_len()],
        }
    }
}

impl<T: Scalar> SacWorkspace<T> {
    /// Returns the index and value of the critic with the smaller Q-value for the action in `slot`.
    pub fn min_q_value(&self, slot: usize) -> (usize, f64) {
        let [qf1, qf2] = [0, 1].map(|qf: usize| self.critics[qf].y[slot].to_f64());
        if qf2 < qf1 { (1, qf2) } else { (0, qf1) }
    }

    /// Records the position of an observation in `observation_keys`; returns its slot in `others`
    /// if the observation is new and must be loaded there. `n` is the number of current
    /// observations.
    pub fn assign_observation_slot(&mut self, observed: ObservationKey, n: usize) -> Option<usize> {
        let known = self.observation_keys.iter().position(|&other| other == observed);
        let source = known.unwrap_or(self.observation_keys.len());
        self.observation_positions.push(source);
        if known.is_some() {
            return None;
        }
        self.observation_keys.push(observed);
        Some(source - n)
    }
}

#[cfg(test)]
mod tests {
    use rand::SeedableRng;

    use super::*;

    #[test]
    fn shifted_images_repeat_the_pixels_of_their_edges() {
        // two channels, of which the second is 10 times the first
        let image = |pixels: [u8; 6]| pixels.into_iter().flat_map(|p| [p, 10 * p]).collect();
        let original: Vec<u8> = image([1, 2, 3, 4, 5, 6]);
        for (shift, expected) in [
            ([0, 0], [1, 2, 3, 4, 5, 6]),
            ([1, 0], [1, 2, 3, 1, 2, 3]),
            ([-1, 0], [4, 5, 6, 4, 5, 6]),
            ([0, 1], [1, 1, 2, 4, 4, 5]),
            ([0, -2], [3, 3, 3, 6, 6, 6]),
            ([5, -5], [3, 3, 3, 3, 3, 3]),
        ] {
            let expected: Vec<u8> = image(expected);
            assert_eq!(shifted_image(&original, [2, 3, 2], shift), expected, "{shift:?}");
        }
        assert!(shifted_image(&[], EnvSpec::NO_IMAGE, [1, 1]).is_empty());
    }

    #[test]
    fn shifts_are_drawn_evenly_within_their_limit() {
        let settings = SacSettings { random_shift: 2, ..SacSettings::default() };
        let mut rng = ChaCha8Rng::seed_from_u64(1);
        let mut counts = [[0_usize; 5]; 5];
        for _ in 0..25_000 {
            let [down, right] = Augmentation::sample(&settings, &mut rng).shift;
            counts[(down + 2) as usize][(right + 2) as usize] += 1;
        }
        // five standard errors of about 31
        assert!(counts.concat().iter().all(|count| count.abs_diff(1000) < 155), "{counts:?}");
    }
}
