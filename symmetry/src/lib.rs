//! Symmetries of a table top: the group D2, its subgroups, and their actions on vectors and images.
//!
//! [`D2`] holds the identity, the two mirror flips of the table and the half turn. A [`Group`] is
//! D2 or one of its subgroups: C1, D1x, D1y, C2. Their irreducible representations are signs
//! ([`Irrep`]). So a representation is fully described by its group and the multiplicity of each
//! irrep ([`FieldType`]). Channel vectors are laid out irrep-major: every channel of the trivial
//! irrep first, then of `x`, of `y` and of `xy`.
//!
//! Conventions shared by every crate of the workspace: world x points right and y away from
//! the robot; images are channels-last with row 0 at the largest y and column 0 at the smallest x.
//!
//! ```
//! use symmetry::{D2, FieldType, Group, Irrep};
//!
//! // a hand position and a finger opening: one `x`, one `y`, two invariants
//! let irreps = [Irrep::X, Irrep::Y, Irrep::Trivial, Irrep::Trivial];
//! let hand = FieldType::from_irreps(Group::D2, &irreps);
//! assert_eq!(hand.to_string(), "2 1 + 1 x + 1 y");
//!
//! // irrep-major order: z, finger, x, y
//! let mut channels = [0.1, 0.5, 0.2, -0.3];
//! hand.transform_channels(D2::FlipX, &mut channels);
//! assert_eq!(channels, [0.1, 0.5, -0.2, -0.3]);
//!
//! // under the group that only flips x, y is one more invariant
//! assert_eq!(hand.restrict(Group::D1x).to_string(), "D1x: 1 reg + 2 1");
//! ```

#[cfg(doctest)]
#[doc = include_str!("../README.md")]
struct Readme;

mod d2;
mod field_type;
mod group;
mod irrep;
mod notation;

pub use d2::D2;
pub use field_type::{FieldType, irrep_major_permutation};
pub use group::{Group, ParseGroupError};
pub use irrep::Irrep;
pub use notation::ParseFieldTypeError;
