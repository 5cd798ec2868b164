//! Things that stand for their names, and what tells two behind one name apart.

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

/// A thing that has a name alone, for tests of what stands for it.
#[cfg(test)]
pub(crate) struct Named(pub &'static str);

/// Compares, orders, hashes, prints and serialises a handle by its `name()`.
macro_rules! stands_for_its_name {
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

pub(crate) use stands_for_its_name;
