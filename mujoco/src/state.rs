//! Saving and restoring a simulation, which MuJoCo 2.2 has no function for.

use std::slice;

use crate::data::{Data, check_finite, check_length};
use crate::error::{Quantity, SimError};

/// Everything that the future of a simulation depends on.
///
/// One flat array: time, qpos `[nq]`, qvel `[nv]`, act `[na]`, mocap_pos `[nmocap, 3]`, mocap_quat
/// `[nmocap, 4]`, userdata `[nuserdata]`, qacc_warmstart `[nv]`, ctrl `[nu]`. It can be stored
/// as such: a run restored from it continues to the same bits.
#[derive(Clone, Debug, PartialEq)]
pub struct State {
    values: Vec<f64>,
}

impl State {
    /// The flat array, in the order given above.
    pub fn values(&self) -> &[f64] {
        &self.values
    }
}

impl From<Vec<f64>> for State {
    fn from(values: Vec<f64>) -> Self {
        Self { values }
    }
}

impl Data {
    /// Copies the state out.
    pub fn save(&self) -> State {
        let mut values = Vec::new();
        for (start, count) in self.state_fields().into_iter().filter(|field| field.1 > 0) {
            // SAFETY: `state_fields` gives live arrays of the mjData with their lengths.
            values.extend_from_slice(unsafe { slice::from_raw_parts(start, count) });
        }
        State { values }
    }

    /// Copies a saved state in. Derived quantities are stale until [`Data::forward`] or
    /// [`Data::step`].
    ///
    /// # Errors
    /// [`SimError::Length`] where the state is of another model; [`SimError::NotFinite`].
    pub fn restore(&mut self, state: &State) -> Result<(), SimError> {
        let fields = self.state_fields();
        check_length(
            Quantity::State,
            fields.iter().map(|field| field.1).sum(),
            state.values.len(),
        )?;
        check_finite(Quantity::State, &state.values)?;
        let mut rest = state.values.as_slice();
        for (start, count) in fields.into_iter().filter(|field| field.1 > 0) {
            let (values, after) = rest.split_at(count);
            // SAFETY: `start` holds `count` numbers that `self`, borrowed exclusively, owns.
            unsafe { start.copy_from_nonoverlapping(values.as_ptr(), count) };
            rest = after;
        }
        self.clear_warnings();
        Ok(())
    }

    fn state_fields(&self) -> [(*mut f64, usize); 9] {
        let (data, model) = (self.get(), self.model().get());
        let field = |start, count: i32| (start, count as usize);
        [
            // SAFETY: the mjData is live; only the address of a field is taken.
            (unsafe { &raw mut (*self.raw().as_ptr()).time }, 1),
            field(data.qpos, model.nq),
            field(data.qvel, model.nv),
            field(data.act, model.na),
            field(data.mocap_pos, 3 * model.nmocap),
            field(data.mocap_quat, 4 * model.nmocap),
            field(data.userdata, model.nuserdata),
            field(data.qacc_warmstart, model.nv),
            field(data.ctrl, model.nu),
        ]
    }
}
