//! Models with other poses: some bodies mirrored, or everything elsewhere.

use std::ptr::{self, NonNull};

use crate::fields::ArrayField;
use crate::fields::model::{
    BODY_IPOS, BODY_IQUAT, BODY_PARENTID, BODY_POS, BODY_QUAT, GEOM_BODYID, GEOM_POS, GEOM_QUAT,
    JNT_AXIS, JNT_BODYID, JNT_POS, JNT_QPOSADR, JNT_TYPE, QPOS0, SITE_BODYID, SITE_POS, SITE_QUAT,
};
use crate::ids::BodyId;
use crate::model::Model;
use crate::raw;

impl Model {
    /// Returns a copy of the model in which `roots` and all bodies below them are mirrored in the
    /// plane x = 0 of the root's parent: the left door for a right one.
    ///
    /// Joints keep their coordinates: a positive one opens either door. Geoms keep their shapes,
    /// which must be symmetric across the x axis of their frames, as all but meshes are. Ids are
    /// those of this model, a [`State`](crate::State) of one model is one of the other, and a
    /// [`Renderer`](crate::Renderer) of one draws both.
    pub fn reflected(&self, roots: &[BodyId]) -> Self {
        let mut copy = self.copied();
        let below = self.bodies_below(roots);
        // SAFETY: nobody else holds the copy yet.
        reflect(unsafe { copy.as_mut() }, &below);
        self.with_raw(copy)
    }

    /// Returns a copy of the model in which everything but cameras and lights stands elsewhere, by
    /// `offset` (metres). Ids are those of this model.
    pub fn translated(&self, offset: [f64; 3]) -> Self {
        let mut copy = self.copied();
        // SAFETY: nobody else holds the copy yet.
        translate(unsafe { copy.as_mut() }, offset);
        self.with_raw(copy)
    }

    fn copied(&self) -> NonNull<raw::mjModel> {
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
    let all: Vec<i32> = (0..model.nbody).collect();
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
    let (kinds, addresses) = (column(model, &JNT_TYPE), column(model, &JNT_QPOSADR));
    let moving = owners.iter().enumerate().filter(|(_, owner)| below[**owner as usize]);
    for (joint, _) in moving {
        match kinds[joint].cast_unsigned() {
            raw::mjJNT_SLIDE => reflect_point(&mut rows(model, &JNT_AXIS)[joint]),
            // an axis of rotation turns the other way where it is mirrored
            raw::mjJNT_HINGE => rows(model, &JNT_AXIS)[joint][1..].iter_mut().for_each(negate),
            raw::mjJNT_FREE => {
                let free = &mut rows(model, &QPOS0)[addresses[joint] as usize..][..7];
                for at in [0, 5, 6] {
                    negate(&mut free[at][0]);
                }
            }
            _ => {}
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
    for (owners, field) in [(&GEOM_BODYID, &GEOM_POS), (&SITE_BODYID, &SITE_POS)] {
        for (at, owner) in column(model, owners).into_iter().enumerate() {
            if owner == 0 {
                add(&mut rows(model, field)[at], offset);
            }
        }
    }
    let (kinds, addresses) = (column(model, &JNT_TYPE), column(model, &JNT_QPOSADR));
    for (kind, address) in kinds.into_iter().zip(addresses) {
        if kind.cast_unsigned() == raw::mjJNT_FREE {
            let free = rows(model, &QPOS0)[address as usize..].as_flattened_mut();
            free.iter_mut().zip(offset).for_each(|(value, by)| *value += by);
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
