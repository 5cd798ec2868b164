//! What tells two things behind one name apart.

use std::any::{Any, TypeId};

/// The type of a thing that lives as long as the program, and where it lies if it has fields.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct Identity {
    kind: TypeId,
    address: Option<usize>,
}

impl Identity {
    pub(crate) fn of(thing: &'static dyn Any) -> Self {
        Self {
            kind: thing.type_id(),
            // things of a type without fields are the same wherever they are
            address: (size_of_val(thing) > 0).then_some(std::ptr::from_ref(thing).addr()),
        }
    }
}
