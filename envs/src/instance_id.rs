//! Handles that behave like their names, and an id that distinguishes definitions of equal names.

use std::any::{Any, TypeId};

/// Id of a `'static` value: its type, and its address unless the type has no fields.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub(crate) struct InstanceId {
    kind: TypeId,
    address: Option<usize>,
}

impl InstanceId {
    pub(crate) fn of(thing: &'static dyn Any) -> Self {
        Self {
            kind: thing.type_id(),
            // values of a type without fields are interchangeable, wherever they are
            address: (size_of_val(thing) > 0).then_some(std::ptr::from_ref(thing).addr()),
        }
    }
}

/// Definition that has only a name, for tests of handles.
#[cfg(test)]
pub(crate) struct Named(pub &'static str);

/// Implements comparison, hashing, printing and serialisation of a handle by its `name()`.
macro_rules! impl_traits_by_name {
    ($handle:ident) => {
        impl PartialEq for $handle {
            fn eq(&self, other: &Self) -> bool {
                self.name() == other.name()
            }
        }

        impl Eq for $handle {}

        impl PartialOrd for $handle {
            fn partial_cmp(&self, other: &Self) -> Option<std::cmp::Ordering> {
                Some(self.cmp(other))
            }
        }

        impl Ord for $handle {
            fn cmp(&self, other: &Self) -> std::cmp::Ordering {
                self.name().cmp(other.name())
            }
        }

        impl std::hash::Hash for $handle {
            fn hash<H: std::hash::Hasher>(&self, state: &mut H) {
                self.name().hash(state);
            }
        }

        impl serde::Serialize for $handle {
            fn serialize<S: serde::Serializer>(&self, serializer: S) -> Result<S::Ok, S::Error> {
                serializer.serialize_str(self.name())
            }
        }

        impl std::fmt::Debug for $handle {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                write!(f, concat!(stringify!($handle), "({})"), self.name())
            }
        }

        impl std::fmt::Display for $handle {
            fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
                f.write_str(self.name())
            }
        }
    };
}

pub(crate) use impl_traits_by_name;
