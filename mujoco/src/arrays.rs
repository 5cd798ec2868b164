//! Arrays of `mjModel` by their C names, for programs that compare or change whole models.

use std::ffi::CStr;
use std::ptr;
use std::slice;

use crate::data::Data;
use crate::error::ModelError;
use crate::fields::ArrayStart;
use crate::fields::data::QFRC_APPLIED;
use crate::fields::model::{BODY_SAMEFRAME, GEOM_SAMEFRAME, SITE_SAMEFRAME};
use crate::ids::{BodyIdMarker, Id};
use crate::model::Model;
use crate::raw;
use crate::releases;

/// Expands to the length of a row: a number, a size of the model, or a constant in parentheses.
macro_rules! width {
    ($model:ident, $width:literal) => {
        $width
    };
    ($model:ident, $width:ident) => {
        $model.$width as usize
    };
    ($model:ident, ($constant:ident)) => {
        raw::$constant as usize
    };
}

/// Declares an enum of arrays of `mjModel`, with start, number of rows and length of a row of each.
macro_rules! arrays {
    (
        $(#[$doc:meta])* $name:ident, $start:ident, $table:ident:
        $(
            $(#[$condition:meta])*
            $variant:ident = $field:ident: [$kind:ident; $count:ident, $width:tt],
        )+
    ) => {
        $(#[$doc])*
        #[derive(Clone, Copy, Debug, PartialEq, Eq)]
        pub enum $name {
            $(
                $(#[$condition])*
                #[doc = concat!(
                    "Array `", stringify!($field), "` `[", stringify!($count), ", ",
                    stringify!($width), "]`."
                )]
                $variant,
            )+
        }

        impl $name {
            fn location(self, model: &raw::mjModel) -> ($start, usize, usize) {
                match self {
                    $($(#[$condition])* Self::$variant => {
                        ($start::$kind(model.$field.elements()), model.$count as usize, width!(model, $width))
                    })+
                }
            }
        }

        #[cfg(test)]
        const $table: &[[&str; 4]] = &[
            $(
                $(#[$condition])*
                [stringify!($kind), stringify!($field), stringify!($count), stringify!($width)]
            ),+
        ];
    };
}

/// Start of an array of `mjModel`.
#[allow(non_camel_case_types)]
enum NumberStart {
    f64(*mut f64),
}

/// Start of an array of `mjModel`.
#[allow(non_camel_case_types)]
enum IntegerStart {
    i32(*mut i32),
    u8(*mut u8),
}

arrays! {
    /// Array of numbers in `mjModel`; MuJoCo's documentation describes each of them.
    NumberArray, NumberStart, NUMBERS:
    ActuatorBiasprm = actuator_biasprm: [f64; nu, 10],
    ActuatorCranklength = actuator_cranklength: [f64; nu, 1],
    ActuatorCtrlrange = actuator_ctrlrange: [f64; nu, 2],
    ActuatorDynprm = actuator_dynprm: [f64; nu, 10],
    ActuatorForcerange = actuator_forcerange: [f64; nu, 2],
    ActuatorGainprm = actuator_gainprm: [f64; nu, 10],
    ActuatorGear = actuator_gear: [f64; nu, 6],
    BodyInertia = body_inertia: [f64; nbody, 3],
    BodyIpos = body_ipos: [f64; nbody, 3],
    BodyIquat = body_iquat: [f64; nbody, 4],
    BodyMass = body_mass: [f64; nbody, 1],
    BodyPos = body_pos: [f64; nbody, 3],
    BodyQuat = body_quat: [f64; nbody, 4],
    CamFovy = cam_fovy: [f64; ncam, 1],
    CamPos = cam_pos: [f64; ncam, 3],
    CamQuat = cam_quat: [f64; ncam, 4],
    DofArmature = dof_armature: [f64; nv, 1],
    DofDamping = dof_damping: [f64; nv, 1],
    DofFrictionloss = dof_frictionloss: [f64; nv, 1],
    DofInvweight0 = dof_invweight0: [f64; nv, 1],
    EqData = eq_data: [f64; neq, (mjNEQDATA)],
    EqSolimp = eq_solimp: [f64; neq, 5],
    EqSolref = eq_solref: [f64; neq, 2],
    GeomFriction = geom_friction: [f64; ngeom, 3],
    GeomGap = geom_gap: [f64; ngeom, 1],
    GeomMargin = geom_margin: [f64; ngeom, 1],
    GeomPos = geom_pos: [f64; ngeom, 3],
    GeomQuat = geom_quat: [f64; ngeom, 4],
    GeomSize = geom_size: [f64; ngeom, 3],
    GeomSolimp = geom_solimp: [f64; ngeom, 5],
    GeomSolmix = geom_solmix: [f64; ngeom, 1],
    GeomSolref = geom_solref: [f64; ngeom, 2],
    JntAxis = jnt_axis: [f64; njnt, 3],
    JntMargin = jnt_margin: [f64; njnt, 1],
    JntPos = jnt_pos: [f64; njnt, 3],
    JntRange = jnt_range: [f64; njnt, 2],
    JntSolimp = jnt_solimp: [f64; njnt, 5],
    JntSolref = jnt_solref: [f64; njnt, 2],
    JntStiffness = jnt_stiffness: [f64; njnt, 1],
    KeyCtrl = key_ctrl: [f64; nkey, nu],
    KeyQpos = key_qpos: [f64; nkey, nq],
    QposSpring = qpos_spring: [f64; nq, 1],
    Qpos0 = qpos0: [f64; nq, 1],
    SensorCutoff = sensor_cutoff: [f64; nsensor, 1],
    SensorNoise = sensor_noise: [f64; nsensor, 1],
    SitePos = site_pos: [f64; nsite, 3],
    SiteQuat = site_quat: [f64; nsite, 4],
    TendonDamping = tendon_damping: [f64; ntendon, 1],
    TendonFrictionloss = tendon_frictionloss: [f64; ntendon, 1],
    #[cfg(not(mujoco3))]
    TendonLengthspring = tendon_lengthspring: [f64; ntendon, 1],
    #[cfg(mujoco3)]
    TendonLengthspring = tendon_lengthspring: [f64; ntendon, 2],
    TendonMargin = tendon_margin: [f64; ntendon, 1],
    TendonRange = tendon_range: [f64; ntendon, 2],
    TendonSolimpLim = tendon_solimp_lim: [f64; ntendon, 5],
    TendonSolrefLim = tendon_solref_lim: [f64; ntendon, 2],
    TendonStiffness = tendon_stiffness: [f64; ntendon, 1],
    WrapPrm = wrap_prm: [f64; nwrap, 1],
}

arrays! {
    /// Array of integers, indices or flags in `mjModel`; MuJoCo's documentation describes each of
    /// them.
    IntegerArray, IntegerStart, INTEGERS:
    ActuatorBiastype = actuator_biastype: [i32; nu, 1],
    ActuatorCtrllimited = actuator_ctrllimited: [u8; nu, 1],
    ActuatorDyntype = actuator_dyntype: [i32; nu, 1],
    ActuatorForcelimited = actuator_forcelimited: [u8; nu, 1],
    ActuatorGaintype = actuator_gaintype: [i32; nu, 1],
    ActuatorTrnid = actuator_trnid: [i32; nu, 2],
    ActuatorTrntype = actuator_trntype: [i32; nu, 1],
    BodyParentid = body_parentid: [i32; nbody, 1],
    CamBodyid = cam_bodyid: [i32; ncam, 1],
    #[cfg(not(mujoco3))]
    EqActive = eq_active: [u8; neq, 1],
    #[cfg(mujoco3)]
    EqActive = eq_active0: [u8; neq, 1],
    EqObj1id = eq_obj1id: [i32; neq, 1],
    EqObj2id = eq_obj2id: [i32; neq, 1],
    EqType = eq_type: [i32; neq, 1],
    GeomBodyid = geom_bodyid: [i32; ngeom, 1],
    GeomConaffinity = geom_conaffinity: [i32; ngeom, 1],
    GeomCondim = geom_condim: [i32; ngeom, 1],
    GeomContype = geom_contype: [i32; ngeom, 1],
    GeomPriority = geom_priority: [i32; ngeom, 1],
    GeomType = geom_type: [i32; ngeom, 1],
    JntBodyid = jnt_bodyid: [i32; njnt, 1],
    JntDofadr = jnt_dofadr: [i32; njnt, 1],
    JntLimited = jnt_limited: [u8; njnt, 1],
    JntQposadr = jnt_qposadr: [i32; njnt, 1],
    JntType = jnt_type: [i32; njnt, 1],
    PairGeom1 = pair_geom1: [i32; npair, 1],
    PairGeom2 = pair_geom2: [i32; npair, 1],
    SensorAdr = sensor_adr: [i32; nsensor, 1],
    SensorObjid = sensor_objid: [i32; nsensor, 1],
    SensorObjtype = sensor_objtype: [i32; nsensor, 1],
    SensorReftype = sensor_reftype: [i32; nsensor, 1],
    SensorType = sensor_type: [i32; nsensor, 1],
    SiteBodyid = site_bodyid: [i32; nsite, 1],
    TendonAdr = tendon_adr: [i32; ntendon, 1],
    TendonLimited = tendon_limited: [u8; ntendon, 1],
    TendonNum = tendon_num: [i32; ntendon, 1],
    WrapObjid = wrap_objid: [i32; nwrap, 1],
    WrapType = wrap_type: [i32; nwrap, 1],
}

/// New values for one row of an array of `mjModel`, for [`Model::edited`].
#[derive(Clone, Debug, PartialEq)]
pub struct RowEdit {
    /// Array with the row.
    pub array: NumberArray,
    /// Index of the row.
    pub row: usize,
    /// New values of the row.
    pub values: Vec<f64>,
}

impl Model {
    /// Returns the elements of an array of the model, row after row.
    pub fn numbers(&self, array: NumberArray) -> &[f64] {
        let (NumberStart::f64(start), rows, width) = array.location(self.as_raw());
        // SAFETY: `mjxmacro.h`, which MuJoCo allocates by, gives the array these lengths, and
        // nobody writes to the model.
        unsafe { elements(start, rows * width) }
    }

    /// Returns element `index` of an array of the model, counted row after row; flags are 0 or 1.
    ///
    /// # Panics
    /// If the array has no such element.
    pub fn integer(&self, array: IntegerArray, index: usize) -> i32 {
        let (start, rows, width) = array.location(self.as_raw());
        // SAFETY: as in `numbers`.
        unsafe {
            match start {
                IntegerStart::i32(start) => elements(start, rows * width)[index],
                IntegerStart::u8(start) => elements(start, rows * width)[index].into(),
            }
        }
    }

    /// Returns the type of the two objects that an equality constraint holds together, such as
    /// [`mjOBJ_BODY`](crate::raw::mjOBJ_BODY).
    ///
    /// # Panics
    /// If the model has no such constraint.
    pub fn equality_object_type(&self, equality: usize) -> raw::mjtObj {
        match self.integer(IntegerArray::EqType, equality).cast_unsigned() {
            raw::mjEQ_JOINT => raw::mjOBJ_JOINT,
            raw::mjEQ_TENDON => raw::mjOBJ_TENDON,
            // SAFETY: MuJoCo made the model, and nobody writes to it.
            _ => unsafe { releases::held_object_type(self.as_raw(), equality) },
        }
    }

    /// Returns the name of the object with this index and `mjtObj` type, such as
    /// [`mjOBJ_SENSOR`](crate::raw::mjOBJ_SENSOR); `None` if the XML gives none.
    pub fn object_name(&self, object: raw::mjtObj, index: usize) -> Option<&str> {
        let index = i32::try_from(index).ok()?;
        // SAFETY: live model; MuJoCo returns NULL for unknown types, indices and unnamed objects.
        let name = unsafe { raw::mj_id2name(self.as_raw(), object.cast_signed(), index) };
        // SAFETY: a name is a NUL-terminated string inside the model, which outlives the borrow.
        (!name.is_null()).then(|| unsafe { CStr::from_ptr(name) }.to_str().ok())?
    }

    /// Returns a copy of the model with other values in some rows of its arrays, and with the
    /// constants that MuJoCo derives from them computed afresh. Ids are those of this model.
    ///
    /// # Errors
    /// [`ModelError::FixedInertiaFrame`], with MuJoCo 3.2 or later, for a new frame of inertia, joint
    /// position or axis of a body whose inertia MuJoCo compiled as diagonal, such as a free ball.
    ///
    /// # Panics
    /// If a row does not exist, or has another length than the new values.
    pub fn edited(&self, edits: &[RowEdit]) -> Result<Self, ModelError> {
        // before the copy is made, which nobody would free
        edits.iter().try_for_each(|edit| self.check_inertia_frame(edit.array, edit.row))?;
        let mut copy = self.copied();
        for RowEdit { array, row, values } in edits {
            // SAFETY: nobody else holds the copy yet.
            let (NumberStart::f64(start), rows, width) = array.location(unsafe { copy.as_ref() });
            assert_eq!(values.len(), width, "wrong number of values for a row of {array:?}");
            assert!(*row < rows, "row {row} of {array:?}, which has {rows} rows");
            // SAFETY: the row is inside the array, by the lengths of `mjxmacro.h`.
            unsafe { ptr::copy_nonoverlapping(values.as_ptr(), start.add(row * width), width) };
        }
        // SAFETY: nobody else holds the copy, and the data is one that MuJoCo makes for it.
        unsafe {
            forget_equal_frames(copy.as_mut());
            releases::forget_diagonal_inertia(copy.as_mut());
            let data = raw::mj_makeData(copy.as_ptr());
            raw::mj_setConst(copy.as_mut(), data);
            raw::mj_deleteData(data);
        }
        Ok(self.relative(copy))
    }

    /// Rejects a row that decides whether the inertia of a body is diagonal, where the layout of
    /// the compiled model relies on it.
    fn check_inertia_frame(&self, array: NumberArray, row: usize) -> Result<(), ModelError> {
        let body = match array {
            NumberArray::BodyIpos | NumberArray::BodyIquat => row,
            NumberArray::JntAxis | NumberArray::JntPos => {
                self.integer(IntegerArray::JntBodyid, row) as usize
            }
            _ => return Ok(()),
        };
        // SAFETY: MuJoCo made the model, and nobody writes to it.
        if !unsafe { releases::has_fixed_inertia_frame(self.as_raw(), body) } {
            return Ok(());
        }
        let name = self.name_of(Id::<BodyIdMarker>::new(body));
        Err(ModelError::FixedInertiaFrame { body: name.unwrap_or_default().into(), index: body })
    }
}

impl Data {
    /// Sets the forces `[nv]` that act on the degrees of freedom besides those of the actuators, in
    /// newtons and newton metres. They stay until they are set again.
    ///
    /// # Panics
    /// If there are not `nv` forces. One that is not finite is an error of the next step.
    pub fn set_applied_forces(&mut self, forces: &[f64]) {
        self.rows_mut(&QFRC_APPLIED).as_flattened_mut().copy_from_slice(forces);
    }

    /// Returns the outputs of all sensors `[nsensordata]`; derived (see [`Data`]).
    pub fn sensor_data(&self) -> &[f64] {
        // SAFETY: MuJoCo made the array for this model; it is written through `&mut self` only.
        unsafe { elements(self.as_raw().sensordata, self.model().as_raw().nsensordata as usize) }
    }
}

/// Clears the flags by which MuJoCo skips computations for frames that coincide, which an edit may
/// change.
///
/// # Safety
/// MuJoCo must have made the model, and nobody may read or write its arrays meanwhile.
unsafe fn forget_equal_frames(model: &mut raw::mjModel) {
    for flags in [&BODY_SAMEFRAME, &GEOM_SAMEFRAME, &SITE_SAMEFRAME] {
        // SAFETY: the caller's promise.
        unsafe { flags.own_rows_mut(model) }.fill([0]);
    }
}

/// Returns the elements of an array.
///
/// # Safety
/// `len` must be 0, or `start` an array of `len` elements to which nobody writes for `'a`.
unsafe fn elements<'a, T>(start: *const T, len: usize) -> &'a [T] {
    match len {
        // nothing is promised about the pointer of an empty array
        0 => &[],
        // SAFETY: the caller's promise.
        len => unsafe { slice::from_raw_parts(start, len) },
    }
}

#[cfg(test)]
mod tests {
    use std::fs;
    use std::path::Path;
    use std::sync::Arc;

    use super::*;
    use crate::fields::data::{self, QACC};
    use crate::fields::model;

    #[test]
    fn every_array_has_the_type_and_the_lengths_of_the_header() {
        let header = Path::new(raw::HEADER_FOLDER).join("mjxmacro.h");
        let mut header = fs::read_to_string(header).unwrap().replace(' ', "");
        header = header.replace("XMJV(", "X(").replace("mjtBool", "mjtByte");
        // equal in every model that is accepted
        header = header.replace(",nactuator,", ",nu,").replace(",nout,", ",nu,");
        for (name, size) in [
            ("mjNREF", raw::mjNREF),
            ("mjNIMP", raw::mjNIMP),
            ("mjNGAIN", raw::mjNGAIN),
            ("mjNBIAS", raw::mjNBIAS),
            ("mjNDYN", raw::mjNDYN),
            // MuJoCo 2 has no such constant
            ("mjNTEXROLE", 10),
        ] {
            header = header.replace(&format!("{name})"), &format!("{size})"));
        }
        let declared = |[kind, field, count, width]: [&str; 4]| {
            let kind = match kind {
                "f64" => "mjtNum",
                "f32" => "float",
                "i32" => "int",
                "u8" => "mjtByte",
                other => panic!("{other}"),
            };
            let stated = |row| header.contains(&format!("X({kind},{field},{count},{row})"));
            let width = width.trim_matches(['(', ')']);
            stated(width.to_owned()) || stated(format!("MJ_M({width})"))
        };
        let arrays = NUMBERS.iter().chain(INTEGERS).chain(model::TABLE).chain(data::TABLE);
        for &array in arrays {
            assert!(declared(array), "{array:?}");
        }
        // a wrong type, count or width is noticed
        for wrong in [
            ["f32", "xpos", "nbody", "3"],
            ["f64", "xpos", "ngeom", "3"],
            ["f64", "xpos", "nbody", "4"],
            ["f64", "body_mass", "nbody", "3"],
        ] {
            assert!(!declared(wrong), "{wrong:?}");
        }
    }

    #[test]
    fn an_edited_copy_has_the_new_values_and_their_consequences() {
        let xml = "<mujoco><worldbody><body name='b'><joint/><geom size='.1'/></body></worldbody>\
                   <keyframe><key qpos='0.5'/></keyframe></mujoco>";
        let model = Model::from_xml(xml).unwrap();
        let [mass, weight] = [NumberArray::BodyMass, NumberArray::DofInvweight0];
        let inertia = NumberArray::BodyInertia;
        let double = |array: NumberArray, width: usize| RowEdit {
            array,
            row: 1,
            values: model.numbers(array)[width..].iter().map(|value| 2.0 * value).collect(),
        };
        let heavy = model.edited(&[double(mass, 1), double(inertia, 3)]).unwrap();
        assert_eq!(heavy.numbers(mass)[1], 2.0 * model.numbers(mass)[1]);
        let ratio = model.numbers(weight)[0] / heavy.numbers(weight)[0];
        assert!((ratio - 2.0).abs() < 1e-12, "{ratio}");
        assert_eq!(model.numbers(NumberArray::KeyQpos), [0.5]);
        assert_eq!(model.integer(IntegerArray::JntLimited, 0), 0);
        assert_eq!(model.object_name(raw::mjOBJ_BODY, 1), Some("b"));
        assert_eq!(model.object_name(raw::mjOBJ_SENSOR, 0), None);
    }

    /// Returns the accelerations `[nv]` of a tumbling body, with a joint, on which another hangs.
    fn accelerations(model: Model) -> Vec<f64> {
        let mut data = Data::new(Arc::new(model));
        let speeds = (0..data.model().nv()).map(|dof| 0.5 + 0.3 * dof as f64);
        let speeds: Vec<f64> = speeds.collect();
        data.qvel_mut().copy_from_slice(&speeds);
        data.forward().unwrap();
        data.rows(&QACC).as_flattened().to_vec()
    }

    #[test]
    fn an_edited_copy_moves_as_a_model_compiled_with_the_values() {
        let xml = |joint: &str, place: &str, inertial: &str, child: &str| {
            let xml = format!(
                "<mujoco><worldbody><body name='b' pos='{place}'>{joint}<inertial {inertial}/>\
                 {child}</body></worldbody></mujoco>"
            );
            Model::from_xml(&xml).unwrap()
        };
        let round = "pos='0 0 0' mass='1' diaginertia='1 1.5 2'";
        let arm = "<body pos='1 0 0'><joint axis='0 1 0'/><inertial pos='0 .1 0' mass='1' \
                     diaginertia='.1 .1 .1'/></body>";
        let edit = |array, values: &[f64]| RowEdit { array, row: 1, values: values.to_vec() };
        let [aside, heavy] = [
            (
                "pos='.1 .2 .3' mass='1' diaginertia='1 1.5 2'",
                NumberArray::BodyIpos,
                vec![0.1, 0.2, 0.3],
            ),
            ("pos='0 0 0' mass='3' diaginertia='1 1.5 2'", NumberArray::BodyMass, vec![3.0]),
        ];
        let joints = ["<freejoint/>", "<joint axis='0 0 1'/>"];
        let cases = joints.iter().flat_map(|joint| [(joint, ""), (joint, arm)]);
        for ((joint, child), (inertial, array, values)) in
            cases.flat_map(|case| [(case, &aside), (case, &heavy)])
        {
            let model = xml(joint, "0 0 1", round, child);
            let place = edit(NumberArray::BodyPos, &[0.0, 0.5, 2.0]);
            match model.edited(&[place, edit(*array, values)]) {
                Ok(model) => {
                    let found = accelerations(model);
                    let expected = accelerations(xml(joint, "0 .5 2", inertial, child));
                    let equal = |(a, b): (&f64, &f64)| (a - b).abs() < 1e-12;
                    let all_equal = found.iter().zip(&expected).all(equal);
                    assert!(all_equal, "{joint} {array:?}: {found:?} {expected:?}");
                }
                Err(error) => {
                    let expected = ModelError::FixedInertiaFrame { body: "b".into(), index: 1 };
                    assert_eq!((error, *array), (expected, NumberArray::BodyIpos));
                    // SAFETY: MuJoCo made the model.
                    let fixed = unsafe { releases::has_fixed_inertia_frame(model.as_raw(), 1) };
                    assert!(fixed);
                }
            }
        }
    }

    #[test]
    fn fixed_frames_of_inertia_are_refused_in_every_array() {
        let compiled = |joint: &str| {
            let xml = format!(
                "<mujoco><worldbody><body name='base'><geom size='.1'/></body><body name='b'>{joint}\
                 <geom size='.1'/></body></worldbody></mujoco>"
            );
            Model::from_xml(&xml).unwrap()
        };
        let [free, hinged] = ["<freejoint/>", "<joint axis='0 0 1'/>"].map(compiled);
        for (model, array, row, values) in [
            (&free, NumberArray::BodyIpos, 2, vec![0.1, 0.0, 0.0]),
            (&free, NumberArray::BodyIquat, 2, vec![0.6, 0.8, 0.0, 0.0]),
            (&hinged, NumberArray::JntPos, 0, vec![0.1, 0.0, 0.0]),
            (&hinged, NumberArray::JntAxis, 0, vec![1.0, 0.0, 0.0]),
        ] {
            let refused = model.edited(&[RowEdit { array, row, values }]).err();
            let expected = ModelError::FixedInertiaFrame { body: "b".into(), index: 2 };
            assert_eq!(refused, cfg!(mujoco3).then_some(expected), "{array:?}");
        }
    }

    #[test]
    fn applied_forces_accelerate() {
        let xml = "<mujoco><worldbody><body><joint type='slide'/><geom size='.1' mass='2'/></body>\
                   </worldbody></mujoco>";
        let mut data = Data::new(Arc::new(Model::from_xml(xml).unwrap()));
        data.qvel_mut()[0] = 0.0;
        data.set_applied_forces(&[2.0 * (1.0 + 9.81)]);
        data.step(1).unwrap();
        let speed = data.model().timestep() * 1.0;
        assert!((data.qvel()[0] - speed).abs() < 1e-9, "{:?}", data.qvel());
    }
}
