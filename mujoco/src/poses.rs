//! Models with other poses: some bodies mirrored, or everything elsewhere.

use std::ptr::{self, NonNull};

use crate::error::ModelError;
use crate::fields::ArrayField;
use crate::fields::model::{
    BODY_IPOS, BODY_IQUAT, BODY_PARENTID, BODY_POS, BODY_QUAT, CAM_BODYID, EQ_OBJ1ID, EQ_OBJ2ID,
    EQ_TYPE, GEOM_BODYID, GEOM_POS, GEOM_QUAT, GEOM_SAMEFRAME, GEOM_TYPE, JNT_AXIS, JNT_BODYID,
    JNT_POS, JNT_QPOSADR, JNT_TYPE, LIGHT_BODYID, QPOS_SPRING, QPOS0, SITE_BODYID, SITE_POS,
    SITE_QUAT, SITE_SAMEFRAME,
};
use crate::ids::BodyId;
use crate::model::{JointType, Model};
use crate::raw;

impl Model {
    /// Returns a copy of the model in which each of `roots`, with all bodies below it, is mirrored
    /// in the plane x = 0 of its parent: a right door becomes a left one.
    ///
    /// Joints keep their coordinates: a positive one opens either door. A mocap body and the body
    /// of a free joint stand where the state puts them, mirrored in the plane x = 0 of their own
    /// frames. Ids are those of this model, a [`State`](crate::State) of one model is one of the
    /// other, and a [`Renderer`](crate::Renderer) of one draws both.
    ///
    /// # Errors
    /// [`ModelError::FixedPoses`] for a model with keyframes; and if a ball joint, a mesh, a height
    /// field, a camera, a light, or a body of a weld or connect constraint is below a root.
    pub fn with_mirrored_bodies(&self, roots: &[BodyId]) -> Result<Self, ModelError> {
        let below = self.bodies_below(roots);
        self.check_reflectable(&below)?;
        let mut copy = self.copied();
        // SAFETY: nobody else holds the copy yet.
        reflect(unsafe { copy.as_mut() }, &below);
        Ok(self.reflection(copy))
    }

    /// Returns a copy of the model in which everything but the world's cameras and lights is moved
    /// by `offset` (metres). Ids are those of this model, but a [`Renderer`](crate::Renderer) of
    /// one does not draw the other.
    ///
    /// # Errors
    /// [`ModelError::FixedPoses`] for a model with keyframes, or with a weld or connect constraint
    /// to the world.
    pub fn translated(&self, offset: [f64; 3]) -> Result<Self, ModelError> {
        self.check_poses("moved", |body| body == 0)?;
        let mut copy = self.copied();
        // SAFETY: nobody else holds the copy yet.
        translate(unsafe { copy.as_mut() }, offset);
        Ok(self.relative(copy))
    }

    /// Rejects models with an object below the roots that mirrored poses alone do not mirror.
    fn check_reflectable(&self, below: &[bool]) -> Result<(), ModelError> {
        let is_below = |body: i32| below[body as usize];
        self.check_poses("mirrored", is_below)?;
        let joint = |kind: i32| JointType::from_raw(kind) == JointType::Ball;
        let mesh = |kind: i32| kind.cast_unsigned() == raw::mjGEOM_MESH;
        let field = |kind: i32| kind.cast_unsigned() == raw::mjGEOM_HFIELD;
        let of_kind = |kinds, owners, is_kind: fn(i32) -> bool| {
            let kinds = self.rows(kinds).iter().map(|row| row[0]);
            kinds.zip(self.rows(owners)).any(|(kind, owner)| is_kind(kind) && is_below(owner[0]))
        };
        let any_below =
            |owners| self.rows(owners).iter().any(|owner: &[i32; 1]| is_below(owner[0]));
        for (what, found) in [
            ("a ball joint", of_kind(&JNT_TYPE, &JNT_BODYID, joint)),
            ("a mesh", of_kind(&GEOM_TYPE, &GEOM_BODYID, mesh)),
            ("a height field", of_kind(&GEOM_TYPE, &GEOM_BODYID, field)),
            ("a camera", any_below(&CAM_BODYID)),
            ("a light", any_below(&LIGHT_BODYID)),
        ] {
            if found {
                return Err(ModelError::FixedPoses { change: "mirrored", what });
            }
        }
        Ok(())
    }

    /// Rejects models with poses that are kept outside bodies, joints, geoms and sites: those of
    /// keyframes, and of welds and connections of the bodies that `of` selects.
    fn check_poses(
        &self,
        change: &'static str,
        of: impl Fn(i32) -> bool,
    ) -> Result<(), ModelError> {
        if self.as_raw().nkey > 0 {
            return Err(ModelError::FixedPoses { change, what: "a keyframe" });
        }
        let ends = self.rows(&EQ_OBJ1ID).iter().zip(self.rows(&EQ_OBJ2ID));
        let mut constraints = self.rows(&EQ_TYPE).iter().zip(ends);
        let of_bodies = [raw::mjEQ_CONNECT, raw::mjEQ_WELD];
        if constraints.any(|([kind], ([one], [other]))| {
            of_bodies.contains(&kind.cast_unsigned()) && (of(*one) || of(*other))
        }) {
            return Err(ModelError::FixedPoses { change, what: "a weld or connect constraint" });
        }
        Ok(())
    }

    /// Returns a copy of the model's `mjModel`, which the caller owns and may alter.
    pub(crate) fn copied(&self) -> NonNull<raw::mjModel> {
        // SAFETY: a live model; MuJoCo allocates a copy where it is given none.
        let copy = unsafe { raw::mj_copyModel(ptr::null_mut(), self.as_raw()) };
        // SAFETY: `mj_copyModel` reports a failed allocation as an error, which aborts.
        unsafe { NonNull::new_unchecked(copy) }
    }

    /// Returns, for each body, `true` if it is one of `roots` or below one.
    fn bodies_below(&self, roots: &[BodyId]) -> Vec<bool> {
        let mut below = vec![false; self.nbody()];
        // a body comes after its parent
        for body in 1..self.nbody() {
            let parent = self.rows(&BODY_PARENTID)[body][0] as usize;
            below[body] = below[parent] || roots.iter().any(|root| root.index() == body);
        }
        below
    }
}

fn reflect(model: &mut raw::mjModel, below: &[bool]) {
    let all: Vec<i32> = (0..model.nbody as usize).map(|body| body as i32).collect();
    for (owners, positions, orientations) in [
        (all.clone(), &BODY_POS, &BODY_QUAT),
        (all, &BODY_IPOS, &BODY_IQUAT),
        (column(model, &GEOM_BODYID), &GEOM_POS, &GEOM_QUAT),
        (column(model, &SITE_BODYID), &SITE_POS, &SITE_QUAT),
    ] {
        each(model, positions, &owners, below, reflect_point);
        each(model, orientations, &owners, below, reflect_quat);
    }
    let owners = column(model, &JNT_BODYID);
    each(model, &JNT_POS, &owners, below, reflect_point);
    let (types, addresses) = (column(model, &JNT_TYPE), column(model, &JNT_QPOSADR));
    let moving = owners.iter().enumerate().filter(|(_, owner)| below[**owner as usize]);
    for (joint, _) in moving {
        match JointType::from_raw(types[joint]) {
            JointType::Slide => reflect_point(&mut rows(model, &JNT_AXIS)[joint]),
            // an axis of rotation turns the other way where it is mirrored
            JointType::Hinge => rows(model, &JNT_AXIS)[joint][1..].iter_mut().for_each(negate),
            JointType::Free => {
                for field in [&QPOS0, &QPOS_SPRING] {
                    let pose = &mut rows(model, field)[addresses[joint] as usize..][..7];
                    for at in [0, 5, 6] {
                        negate(&mut pose[at][0]);
                    }
                }
            }
            // refused by `check_reflectable`: its coordinates are no numbers to keep
            JointType::Ball => {}
        }
    }
}

fn translate(model: &mut raw::mjModel, offset: [f64; 3]) {
    let (parents, all) = (column(model, &BODY_PARENTID), 0..);
    let top_bodies: Vec<usize> = all
        .zip(&parents)
        .skip(1)
        .filter(|(_, parent)| **parent == 0)
        .map(|(body, _)| body)
        .collect();
    for &body in &top_bodies {
        add(&mut rows(model, &BODY_POS)[body], offset);
    }
    for (owners, positions, same_frame) in
        [(&GEOM_BODYID, &GEOM_POS, &GEOM_SAMEFRAME), (&SITE_BODYID, &SITE_POS, &SITE_SAMEFRAME)]
    {
        for (at, owner) in column(model, owners).into_iter().enumerate() {
            if owner == 0 {
                add(&mut rows(model, positions)[at], offset);
                // MuJoCo reads no position of what it knows to stand at its body's origin
                rows(model, same_frame)[at] = [0];
            }
        }
    }
    let (types, addresses) = (column(model, &JNT_TYPE), column(model, &JNT_QPOSADR));
    for (joint_type, address) in types.into_iter().zip(addresses) {
        if JointType::from_raw(joint_type) == JointType::Free {
            for field in [&QPOS0, &QPOS_SPRING] {
                let pose = rows(model, field)[address as usize..].as_flattened_mut();
                pose.iter_mut().zip(offset).for_each(|(value, by)| *value += by);
            }
        }
    }
}

fn add(point: &mut [f64; 3], offset: [f64; 3]) {
    point.iter_mut().zip(offset).for_each(|(value, by)| *value += by);
}

/// Applies `change` to the rows of an array whose owners are below the roots.
fn each<const N: usize>(
    model: &mut raw::mjModel,
    field: &ArrayField<raw::mjModel, f64, N>,
    owners: &[i32],
    below: &[bool],
    change: fn(&mut [f64; N]),
) {
    for (row, owner) in rows(model, field).iter_mut().zip(owners) {
        if below[*owner as usize] {
            change(row);
        }
    }
}

fn column(model: &mut raw::mjModel, field: &ArrayField<raw::mjModel, i32, 1>) -> Vec<i32> {
    rows(model, field).iter().map(|row| row[0]).collect()
}

fn rows<'a, T, const N: usize>(
    model: &'a mut raw::mjModel,
    field: &ArrayField<raw::mjModel, T, N>,
) -> &'a mut [[T; N]] {
    // SAFETY: MuJoCo made the model, and the exclusive borrow keeps others out.
    unsafe { field.own_rows_mut(model) }
}

fn reflect_point(point: &mut [f64; 3]) {
    negate(&mut point[0]);
}

fn reflect_quat([_, _, y, z]: &mut [f64; 4]) {
    negate(y);
    negate(z);
}

fn negate(value: &mut f64) {
    *value = -*value;
}
