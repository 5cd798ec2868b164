//! Saving and restoring of a simulation's state, which MuJoCo 2.2 has no function for.

use crate::data::Data;
use crate::error::{SimError, SimQuantity, check_finite, check_length};
use crate::fields::data::{
    ACT, CTRL, MOCAP_POS, MOCAP_QUAT, QACC_WARMSTART, QFRC_APPLIED, QPOS, QVEL, USERDATA,
    XFRC_APPLIED,
};

/// State of a simulation: everything that determines its future.
///
/// One flat array: time, qpos `[nq]`, qvel `[nv]`, act `[na]`, mocap_pos `[nmocap, 3]`, mocap_quat
/// `[nmocap, 4]`, userdata `[nuserdata]`, qacc_warmstart `[nv]`, ctrl `[nu]`. It can be stored: a
/// run restored from it continues to the same bits.
///
/// Forces that a program applies through [`Data::as_mut_ptr`] (`qfrc_applied`, `xfrc_applied`) are
/// not included: [`Data::restore_state`] sets them to zero. Equality constraints that a program
/// turns off with MuJoCo 3 (`eq_active`) are not included either: they stay off.
#[derive(Clone, Debug, PartialEq)]
pub struct State {
    values: Vec<f64>,
}

impl State {
    /// Returns the values of the state as one flat array: time, qpos, qvel and the further parts
    /// that [`State`] lists, in that order.
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
    /// Returns a copy of the simulation's state.
    pub fn save_state(&self) -> State {
        let time = [self.time()];
        let parts: [&[f64]; 9] = [
            &time,
            self.rows(&QPOS).as_flattened(),
            self.rows(&QVEL).as_flattened(),
            self.rows(&ACT).as_flattened(),
            self.rows(&MOCAP_POS).as_flattened(),
            self.rows(&MOCAP_QUAT).as_flattened(),
            self.rows(&USERDATA).as_flattened(),
            self.rows(&QACC_WARMSTART).as_flattened(),
            self.rows(&CTRL).as_flattened(),
        ];
        State { values: parts.concat() }
    }

    /// Restores a saved state of the simulation, and sets applied forces to zero. Derived
    /// quantities are stale until [`Data::forward`] or [`Data::step`].
    ///
    /// # Errors
    /// [`SimError::WrongLength`] if the state is of another model; [`SimError::NotFinite`].
    pub fn restore_state(&mut self, state: &State) -> Result<(), SimError> {
        check_length(SimQuantity::State, self.state_len(), state.values.len())?;
        check_finite(SimQuantity::State, &state.values)?;
        let mut rest = state.values.as_slice();
        fill(std::slice::from_mut(&mut self.raw_mut().time), &mut rest);
        fill(self.rows_mut(&QPOS).as_flattened_mut(), &mut rest);
        fill(self.rows_mut(&QVEL).as_flattened_mut(), &mut rest);
        fill(self.rows_mut(&ACT).as_flattened_mut(), &mut rest);
        fill(self.rows_mut(&MOCAP_POS).as_flattened_mut(), &mut rest);
        fill(self.rows_mut(&MOCAP_QUAT).as_flattened_mut(), &mut rest);
        fill(self.rows_mut(&USERDATA).as_flattened_mut(), &mut rest);
        fill(self.rows_mut(&QACC_WARMSTART).as_flattened_mut(), &mut rest);
        fill(self.rows_mut(&CTRL).as_flattened_mut(), &mut rest);
        self.rows_mut(&QFRC_APPLIED).as_flattened_mut().fill(0.0);
        self.rows_mut(&XFRC_APPLIED).as_flattened_mut().fill(0.0);
        self.clear_warnings();
        Ok(())
    }

    fn state_len(&self) -> usize {
        let model = self.model().as_raw();
        let mocap = 7 * model.nmocap;
        let total = 1 + model.nq + 2 * model.nv + model.na + mocap + model.nuserdata + model.nu;
        total as usize
    }
}

/// Fills `out` with the first numbers of `rest`, and removes them from `rest`.
fn fill(out: &mut [f64], rest: &mut &[f64]) {
    let (first, others) = rest.split_at(out.len());
    out.copy_from_slice(first);
    *rest = others;
}
