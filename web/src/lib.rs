//! Live demonstration of COVERS in a browser: the learner of `covers-learner` in worlds that
//! `covers-worlds` draws. [`WorldsDemo`] is the demonstration; [`DemoSession`] is its JavaScript
//! interface.

mod demo;

pub use demo::{IterationRecord, NUM_FILMED_ENVS, PolicyComparison, WorldsDemo};

use symmetry::D2;
use wasm_bindgen::JsError;
use wasm_bindgen::prelude::wasm_bindgen;

/// Interface of the demonstration for JavaScript.
#[wasm_bindgen]
pub struct DemoSession(WorldsDemo);

#[wasm_bindgen]
impl DemoSession {
    /// Draws a world and a stream of visits from a seed; the world has `num_groups` task groups, at
    /// least 1 and at most 16 whatever is given.
    ///
    /// # Errors
    /// Settings that the learner refuses.
    #[wasm_bindgen(constructor)]
    pub fn new(seed: u32, num_groups: usize) -> Result<DemoSession, JsError> {
        Ok(Self(WorldsDemo::new(seed.into(), num_groups)?))
    }

    /// Runs one iteration of learning, and returns its [`IterationRecord`] as JSON.
    ///
    /// # Errors
    /// Errors of the learner.
    pub fn learn(&mut self) -> Result<String, JsError> {
        Ok(serde_json::to_string(&self.0.learn()?)?)
    }

    /// Returns the images `[T, 4, 48, 48, 3]` of the first four environments in the latest rollout,
    /// at its start and after each decision.
    #[wasm_bindgen(js_name = rolloutFilm)]
    pub fn rollout_film(&self) -> Vec<u8> {
        self.0.rollout_film().to_vec()
    }

    /// Returns the first image `[48, 48, 3]` of an episode of a task group, as bytes.
    ///
    /// # Errors
    /// A group that the world does not have.
    #[wasm_bindgen(js_name = groupPicture)]
    pub fn group_picture(&self, group: usize) -> Result<Vec<u8>, JsError> {
        Ok(self.0.group_picture(group)?)
    }

    /// Inserts a visit of `rounds` rollouts to a task group, which begins within two iterations and
    /// ends the visit that it interrupts. The variant is the two bits of an element of D2 (bit 0
    /// mirrors x, bit 1 mirrors y), or missing for random ones.
    ///
    /// # Errors
    /// A group that the world does not have, no rounds, and a variant above 3.
    #[wasm_bindgen(js_name = insertVisit)]
    pub fn insert_visit(
        &mut self,
        group: usize,
        rounds: usize,
        variant: Option<usize>,
    ) -> Result<(), JsError> {
        if let Some(bits) = variant.filter(|&bits| bits > 3) {
            return Err(JsError::new(&format!("variant is {bits}, expected 0 to 3")));
        }
        Ok(self.0.insert_visit(group, rounds, variant.map(D2::from_bits))?)
    }
}
