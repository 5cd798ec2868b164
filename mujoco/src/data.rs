//! `mjData`: the state of one simulation, and the quantities derived from it.

use std::ptr::NonNull;
use std::slice;
use std::sync::Arc;

use crate::error::{SimError, SimQuantity, check_finite, check_length};
use crate::fields::ArrayField;
use crate::fields::data::{
    ACTUATOR_FORCE, CTRL, GEOM_XMAT, GEOM_XPOS, MOCAP_POS, MOCAP_QUAT, QACC, QPOS, QVEL, SITE_XPOS,
    XPOS, XQUAT,
};
use crate::ids::{BodyId, GeomId, Id, MocapId, SiteId};
use crate::model::Model;
use crate::{raw, releases};

/// One MuJoCo simulation of a [`Model`]: the state and the quantities derived from it.
///
/// *Derived* quantities (positions of bodies, geoms and sites; contacts) are those of the last
/// [`Data::forward`], or lag the state by one physics step: call `forward` before reading them and
/// before drawing. After [`Data::new`] and [`Data::reset`] they are zero until then.
///
/// # Panics
/// Methods that take an id panic if the id comes from a larger model.
pub struct Data {
    raw: NonNull<raw::mjData>,
    model: Arc<Model>,
}

// SAFETY: the mjData is owned by this value alone and MuJoCo keeps no thread-bound state in it.
unsafe impl Send for Data {}

/// Pair of geoms that touch, or are within their collision margin.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Contact {
    /// Two geoms that touch, or are within their collision margin.
    pub geoms: [GeomId; 2],
    /// Gap between the two surfaces in metres; negative if they overlap.
    pub distance: f64,
    /// Point midway between the two surfaces, in metres, in the world frame.
    pub position: [f64; 3],
}

impl Data {
    /// Creates a simulation in the model's initial state.
    pub fn new(model: Arc<Model>) -> Self {
        // SAFETY: live model; MuJoCo never returns NULL for one (it calls the error handler).
        let raw = unsafe { NonNull::new_unchecked(raw::mj_makeData(model.as_raw())) };
        Self { raw, model }
    }

    /// Returns the model that this simulation is of.
    pub fn model(&self) -> &Arc<Model> {
        &self.model
    }

    /// Resets the simulation to the model's initial state, at time 0.
    pub fn reset(&mut self) {
        // SAFETY: live data of this model.
        unsafe { raw::mj_resetData(self.model.as_raw(), self.as_mut_ptr()) };
        self.clear_warnings();
    }

    /// Advances the simulation by `n` physics steps of [`Model::timestep`] seconds each.
    ///
    /// Derived quantities are then one step behind the state: see [`Data::forward`].
    ///
    /// # Errors
    /// [`SimError::Diverged`] as soon as a step diverges, after which the state is the initial one;
    /// [`SimError::BufferOverflow`] if contacts or constraints did not fit and were dropped.
    pub fn step(&mut self, n: usize) -> Result<(), SimError> {
        for _ in 0..n {
            let time = self.time();
            // SAFETY: live data of this model.
            unsafe { raw::mj_step(self.model.as_raw(), self.as_mut_ptr()) };
            self.check_warnings(time)?;
        }
        Ok(())
    }

    /// Computes every derived quantity from the state, without advancing time.
    ///
    /// This also refreshes the constraint solver's warm start, which is part of the state: a run
    /// with an extra `forward` may differ in the last bits from a run without.
    ///
    /// # Errors
    /// Errors of [`Data::step`], and [`SimError::NotFinite`] if the state, the control or a
    /// resulting acceleration is not finite. A step also rejects positions and velocities beyond
    /// 1e10; `forward` accepts them, and other derived quantities may then not be finite.
    pub fn forward(&mut self) -> Result<(), SimError> {
        check_finite(SimQuantity::Qpos, self.qpos())?;
        check_finite(SimQuantity::Qvel, self.qvel())?;
        check_finite(SimQuantity::Ctrl, self.ctrl())?;
        // SAFETY: live data of this model.
        unsafe { raw::mj_forward(self.model.as_raw(), self.as_mut_ptr()) };
        self.check_warnings(self.time())?;
        check_finite(SimQuantity::Qacc, self.values(&QACC))
    }

    /// Computes the poses of bodies, geoms, sites, cameras and lights from the state, without
    /// velocities or forces.
    ///
    /// Sufficient for observing and rendering, several times cheaper than [`Data::forward`], and
    /// without effect on the state. Cameras and lights that track a centre of mass need `forward`.
    ///
    /// # Errors
    /// [`SimError::NotFinite`] if a position is not finite.
    pub fn forward_kinematics(&mut self) -> Result<(), SimError> {
        check_finite(SimQuantity::Qpos, self.qpos())?;
        // SAFETY: live data of this model.
        unsafe {
            raw::mj_kinematics(self.model.as_raw(), self.as_mut_ptr());
            raw::mj_camlight(self.model.as_raw(), self.as_mut_ptr());
        }
        Ok(())
    }

    /// Returns the simulation time, in seconds.
    pub fn time(&self) -> f64 {
        self.as_raw().time
    }

    /// Returns the generalised positions `[nq]`, in metres and radians; a free joint is 3 positions
    /// and a quaternion (w, x, y, z).
    pub fn qpos(&self) -> &[f64] {
        self.values(&QPOS)
    }

    /// Returns the generalised positions `[nq]` for setting them. A NaN is an error of the next
    /// step.
    pub fn qpos_mut(&mut self) -> &mut [f64] {
        self.values_mut(&QPOS)
    }

    /// Returns the generalised velocities `[nv]`, in metres and radians per second.
    pub fn qvel(&self) -> &[f64] {
        self.values(&QVEL)
    }

    /// Returns the generalised velocities `[nv]` for setting them. A NaN is an error of the next
    /// step.
    pub fn qvel_mut(&mut self) -> &mut [f64] {
        self.values_mut(&QVEL)
    }

    /// Returns the controls `[nu]`, one per actuator.
    pub fn ctrl(&self) -> &[f64] {
        self.values(&CTRL)
    }

    /// Returns the forces of the actuators in the last step `[nu]`, in newtons and newton metres.
    pub fn actuator_force(&self) -> &[f64] {
        self.values(&ACTUATOR_FORCE)
    }

    /// Sets the controls of all actuators `[nu]`.
    ///
    /// # Errors
    /// [`SimError::WrongLength`]; [`SimError::NotFinite`] (MuJoCo would set every control to zero).
    pub fn set_all_ctrl(&mut self, ctrl: &[f64]) -> Result<(), SimError> {
        check_length(SimQuantity::Ctrl, self.model.nu(), ctrl.len())?;
        check_finite(SimQuantity::Ctrl, ctrl)?;
        self.values_mut(&CTRL).copy_from_slice(ctrl);
        Ok(())
    }

    /// Returns the position of a mocap body in the world, in metres.
    pub fn mocap_position(&self, mocap: MocapId) -> [f64; 3] {
        self.rows(&MOCAP_POS)[mocap.index()]
    }

    /// Sets the position of a mocap body in the world, in metres.
    ///
    /// # Errors
    /// [`SimError::NotFinite`].
    pub fn set_mocap_position(
        &mut self,
        mocap: MocapId,
        position: [f64; 3],
    ) -> Result<(), SimError> {
        check_finite(SimQuantity::MocapPose, &position)?;
        self.rows_mut(&MOCAP_POS)[mocap.index()] = position;
        Ok(())
    }

    /// Returns the orientation of a mocap body, as a quaternion (w, x, y, z).
    pub fn mocap_orientation(&self, mocap: MocapId) -> [f64; 4] {
        self.rows(&MOCAP_QUAT)[mocap.index()]
    }

    /// Sets the orientation of a mocap body, a quaternion (w, x, y, z), which is normalised.
    ///
    /// # Errors
    /// [`SimError::NotFinite`]; [`SimError::NotNormalisable`] for a norm below 1e-6 or above 1e150.
    pub fn set_mocap_orientation(
        &mut self,
        mocap: MocapId,
        quat: [f64; 4],
    ) -> Result<(), SimError> {
        check_finite(SimQuantity::MocapPose, &quat)?;
        // MuJoCo would silently turn a zero quaternion into the identity
        if !(1e-12..=1e300).contains(&quat.iter().map(|q| q * q).sum()) {
            return Err(SimError::NotNormalisable { value: quat });
        }
        // 2.2.2 does the same in the next step, and later releases do not
        let mut normalised = quat;
        // SAFETY: MuJoCo reads and writes the four elements.
        unsafe { raw::mju_normalize4(normalised.as_mut_ptr()) };
        self.rows_mut(&MOCAP_QUAT)[mocap.index()] = normalised;
        Ok(())
    }

    /// Returns the position of a body's frame in the world, in metres; derived (see [`Data`]).
    pub fn body_position(&self, body: BodyId) -> [f64; 3] {
        self.rows(&XPOS)[body.index()]
    }

    /// Returns the orientation of a body's frame in the world, as a quaternion (w, x, y, z);
    /// derived (see [`Data`]).
    pub fn body_orientation(&self, body: BodyId) -> [f64; 4] {
        self.rows(&XQUAT)[body.index()]
    }

    /// Returns the position of a geom's centre in the world, in metres; derived (see [`Data`]).
    pub fn geom_position(&self, geom: GeomId) -> [f64; 3] {
        self.rows(&GEOM_XPOS)[geom.index()]
    }

    /// Returns the x, y and z axis of a geom's frame, unit vectors in the world; derived (see
    /// [`Data`]).
    pub fn geom_axes(&self, geom: GeomId) -> [[f64; 3]; 3] {
        let m = self.rows(&GEOM_XMAT)[geom.index()];
        // MuJoCo's matrices are row-major
        [0, 1, 2].map(|axis| [m[axis], m[3 + axis], m[6 + axis]])
    }

    /// Returns the position of a site in the world, in metres; derived (see [`Data`]).
    pub fn site_position(&self, site: SiteId) -> [f64; 3] {
        self.rows(&SITE_XPOS)[site.index()]
    }

    /// Returns the number of contacts between geoms; derived (see [`Data`]).
    pub fn contact_count(&self) -> usize {
        self.contacts().count()
    }

    /// Returns the contacts between geoms, in MuJoCo's order; derived (see [`Data`]).
    pub fn contacts(&self) -> impl Iterator<Item = Contact> {
        self.raw_contacts().iter().filter_map(|contact| {
            let geom = |index: i32| usize::try_from(index).ok().map(Id::new);
            // MuJoCo 3 has -1 for a flex
            Some(Contact {
                geoms: [geom(contact.geom1)?, geom(contact.geom2)?],
                distance: contact.dist,
                position: contact.pos,
            })
        })
    }

    fn raw_contacts(&self) -> &[raw::mjContact] {
        match self.as_raw().ncon as usize {
            0 => &[],
            // SAFETY: MuJoCo has filled `ncon` entries of the array, which nobody writes to while
            // `self` is borrowed.
            count => unsafe { slice::from_raw_parts(self.as_raw().contact, count) },
        }
    }

    /// Returns MuJoCo's `mjData`, for reading fields without a method.
    ///
    /// Plain fields can be read directly. Arrays are pointers, and reading through one is `unsafe`:
    /// `mjdata.h` documents the number of elements.
    ///
    /// ```
    /// # use std::sync::Arc;
    /// # let xml = "<mujoco><worldbody><body><joint/><geom
    /// size='.1'/></body></worldbody></mujoco>";
    /// # let model = Arc::new(mujoco::Model::from_xml(xml)?);
    /// let mut data = mujoco::Data::new(model);
    /// data.forward()?;
    /// let (raw, nv) = (data.as_raw(), data.model().nv());
    /// // SAFETY: `qfrc_bias` is an array of `nv` numbers that live as long as `data`.
    /// let bias = unsafe { std::slice::from_raw_parts(raw.qfrc_bias, nv) };
    /// assert_eq!((raw.ncon, bias.len()), (0, 1));
    /// # Ok::<(), mujoco::MujocoError>(())
    /// ```
    pub fn as_raw(&self) -> &raw::mjData {
        // SAFETY: the pointer is valid until `drop`, and nobody writes while `self` is borrowed.
        unsafe { self.raw.as_ref() }
    }

    /// Returns a pointer to MuJoCo's `mjData`, for calling functions without a method.
    ///
    /// The pointer is valid as long as this value lives. Using it is `unsafe`: the caller must pass
    /// it to MuJoCo only together with [`Model::as_raw`] of the same model, must free nothing, and
    /// must change pointers and counts only as MuJoCo does.
    ///
    /// A warning that MuJoCo raises meanwhile becomes an error of the next [`Data::step`] or
    /// [`Data::forward`] if it is a divergence or an overflow. Warnings of other kinds are dropped
    /// there, and [`Data::reset`] and [`Data::restore_state`] drop all.
    pub fn as_mut_ptr(&mut self) -> *mut raw::mjData {
        self.raw.as_ptr()
    }

    fn check_warnings(&mut self, time: f64) -> Result<(), SimError> {
        if self.as_raw().warning.iter().all(|warning| warning.number == 0) {
            return Ok(());
        }
        let divergence = self.divergence(time);
        let error = divergence.clone().or_else(|| self.overflow(time));
        if divergence.is_some() {
            self.reset();
        }
        self.clear_warnings();
        error.map_or(Ok(()), Err)
    }

    fn divergence(&self, time: f64) -> Option<SimError> {
        let kinds = [
            (raw::mjWARN_BADQPOS, SimQuantity::Qpos),
            (raw::mjWARN_BADQVEL, SimQuantity::Qvel),
            (raw::mjWARN_BADQACC, SimQuantity::Qacc),
            (raw::mjWARN_BADCTRL, SimQuantity::Ctrl),
            (raw::mjWARN_INERTIA, SimQuantity::Inertia),
        ];
        kinds.into_iter().find_map(|(warning, what)| {
            let warning = self.as_raw().warning[warning as usize];
            (warning.number > 0).then_some(SimError::Diverged {
                what,
                index: warning.lastinfo as usize,
                time,
            })
        })
    }

    fn overflow(&self, time: f64) -> Option<SimError> {
        let kinds = [(raw::mjWARN_CONTACTFULL, "contacts"), (raw::mjWARN_CNSTRFULL, "constraints")];
        let limits = releases::buffer_limits(self.model.as_raw());
        kinds.into_iter().zip(limits).find_map(|((warning, what), (limit, setting))| {
            let raised = self.as_raw().warning[warning as usize].number > 0;
            raised.then_some(SimError::BufferOverflow { what, limit, setting, time })
        })
    }

    pub(crate) fn clear_warnings(&mut self) {
        for warning in &mut self.raw_mut().warning {
            warning.number = 0;
        }
    }

    pub(crate) fn rows<T, const N: usize>(
        &self,
        field: &ArrayField<raw::mjData, T, N>,
    ) -> &[[T; N]] {
        // SAFETY: MuJoCo made the data for this model; it is written through `&mut self` only.
        unsafe { field.rows(self.as_raw(), self.model.as_raw()) }
    }

    pub(crate) fn rows_mut<T, const N: usize>(
        &mut self,
        field: &ArrayField<raw::mjData, T, N>,
    ) -> &mut [[T; N]] {
        // SAFETY: MuJoCo made the data, which lives until `drop`, for this model; the result
        // borrows `self` exclusively.
        unsafe { field.rows_mut(self.raw.as_mut(), self.model.as_raw()) }
    }

    fn values<const N: usize>(&self, field: &ArrayField<raw::mjData, f64, N>) -> &[f64] {
        self.rows(field).as_flattened()
    }

    fn values_mut<const N: usize>(
        &mut self,
        field: &ArrayField<raw::mjData, f64, N>,
    ) -> &mut [f64] {
        self.rows_mut(field).as_flattened_mut()
    }

    pub(crate) fn raw_mut(&mut self) -> &mut raw::mjData {
        // SAFETY: the pointer is valid until `drop`, and borrowed exclusively.
        unsafe { self.raw.as_mut() }
    }
}

impl Drop for Data {
    fn drop(&mut self) {
        // SAFETY: MuJoCo allocated it and nothing refers to it any more.
        unsafe { raw::mj_deleteData(self.raw.as_ptr()) };
    }
}
