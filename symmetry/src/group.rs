//! The group D2 and its subgroups as values.

use std::error::Error;
use std::fmt;
use std::str::FromStr;

use serde::{Deserialize, Serialize};

use crate::d2::D2;
use crate::irrep::Irrep;

/// Symmetry group of a network or field type, a subgroup of D2 and a power of Z2.
///
/// Restricted to a subgroup, several irreps of D2 can have equal signs. The first of them in
/// [`Irrep::ALL`] then represents all: C2, for example, has the irreps 1 and x, and y becomes x.
/// Files hold the name that [`Display`](fmt::Display) prints.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash, PartialOrd, Ord, Serialize, Deserialize)]
pub enum Group {
    /// Trivial group, which has the identity alone: no symmetry.
    C1,
    /// Group of the identity and flip x.
    D1x,
    /// Group of the identity and flip y.
    D1y,
    /// Group of the identity and the half turn.
    C2,
    /// Whole group D2: the identity, both flips and the half turn.
    D2,
}

impl Group {
    /// All five subgroups of D2.
    pub const ALL: [Group; 5] = [Group::C1, Group::D1x, Group::D1y, Group::C2, Group::D2];

    /// Returns the elements of the group, in the order of their bits; the first is the identity.
    pub const fn elements(self) -> &'static [D2] {
        match self {
            Group::C1 => &[D2::Identity],
            Group::D1x => &[D2::Identity, D2::FlipX],
            Group::D1y => &[D2::Identity, D2::FlipY],
            Group::C2 => &[D2::Identity, D2::HalfTurn],
            Group::D2 => &D2::ALL,
        }
    }

    /// Returns the number of elements of the group: 1, 2 or 4.
    pub const fn order(self) -> usize {
        self.elements().len()
    }

    /// Returns the irreps of the group, as many as it has elements, in the order of the channel
    /// layout; the first is trivial.
    pub const fn irreps(self) -> &'static [Irrep] {
        match self {
            Group::C1 => &[Irrep::Trivial],
            Group::D1x | Group::C2 => &[Irrep::Trivial, Irrep::X],
            Group::D1y => &[Irrep::Trivial, Irrep::Y],
            Group::D2 => &Irrep::ALL,
        }
    }

    /// Returns the irrep of this group that an irrep of D2 restricts to.
    pub const fn restrict_d2_irrep(self, irrep: Irrep) -> Irrep {
        // equal signs on the elements of the subgroup make two irreps one
        match (self, irrep) {
            (Group::C1, _)
            | (Group::D1x, Irrep::Y)
            | (Group::D1y, Irrep::X)
            | (Group::C2, Irrep::XY) => Irrep::Trivial,
            (Group::D1x, Irrep::XY) | (Group::C2, Irrep::Y) => Irrep::X,
            (Group::D1y, Irrep::XY) => Irrep::Y,
            (_, irrep) => irrep,
        }
    }

    /// Returns `true` if every element of this group is one of `other`.
    pub fn is_subgroup_of(self, other: Group) -> bool {
        self.elements().iter().all(|&g| other.contains(g))
    }

    /// Returns `true` if `g` is an element of the group.
    pub fn contains(self, g: D2) -> bool {
        self.elements().contains(&g)
    }

    /// Returns `true` if an element of the group maps x to -x.
    pub fn has_element_flipping_x(self) -> bool {
        self.elements().iter().any(|g| g.flips_x())
    }

    /// Returns `true` if an element of the group maps y to -y.
    pub fn has_element_flipping_y(self) -> bool {
        self.elements().iter().any(|g| g.flips_y())
    }
}

impl fmt::Display for Group {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        f.pad(match self {
            Group::C1 => "C1",
            Group::D1x => "D1x",
            Group::D1y => "D1y",
            Group::C2 => "C2",
            Group::D2 => "D2",
        })
    }
}

/// Error of parsing the name of a symmetry group; holds the text, which names none.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ParseGroupError(pub String);

impl fmt::Display for ParseGroupError {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        write!(f, "got the group `{}`, expected one of `C1`, `D1x`, `D1y`, `C2`, `D2`", self.0)
    }
}

impl Error for ParseGroupError {}

impl FromStr for Group {
    type Err = ParseGroupError;

    /// Parses the name that [`Display`](fmt::Display) prints.
    fn from_str(text: &str) -> Result<Group, ParseGroupError> {
        Group::ALL
            .into_iter()
            .find(|group| group.to_string() == text)
            .ok_or_else(|| ParseGroupError(text.to_owned()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn elements_are_closed_under_the_product() {
        for group in Group::ALL {
            assert_eq!(group.elements()[0], D2::Identity);
            for &g in group.elements() {
                assert!(group.elements().iter().all(|&h| group.contains(g * h)));
            }
        }
    }

    #[test]
    fn restriction_picks_the_first_irrep_with_the_same_signs() {
        for group in Group::ALL {
            let signs = |a: Irrep| group.elements().iter().map(move |&g| a.sign(g));
            for irrep in Irrep::ALL {
                let first = Irrep::ALL.into_iter().find(|&a| signs(a).eq(signs(irrep)));
                assert_eq!(Some(group.restrict_d2_irrep(irrep)), first, "{group} {irrep}");
            }
            let distinct = Irrep::ALL.into_iter().filter(|&a| group.restrict_d2_irrep(a) == a);
            assert!(distinct.eq(group.irreps().iter().copied()), "{group}");
            assert_eq!(group.irreps().len(), group.order());
        }
    }

    #[test]
    fn irreps_of_every_group_are_orthogonal() {
        for group in Group::ALL {
            for &a in group.irreps() {
                for &b in group.irreps() {
                    let signs = group.elements().iter().map(|&g| a.sign(g) * b.sign(g));
                    let product = usize::try_from(signs.sum::<i8>()).unwrap();
                    assert_eq!(product, if a == b { group.order() } else { 0 });
                }
            }
        }
    }

    #[test]
    fn subgroups_are_those_of_the_lattice() {
        use Group::*;
        for group in Group::ALL {
            assert!(C1.is_subgroup_of(group) && group.is_subgroup_of(D2));
            let proper = Group::ALL.into_iter().filter(|&h| h.is_subgroup_of(group));
            assert_eq!(proper.count(), [1, 2, 2, 2, 5][group as usize]);
        }
        assert!(!D1x.is_subgroup_of(C2) && !D2.is_subgroup_of(D1y));
    }

    #[test]
    fn flips_are_those_of_some_element() {
        let flips = Group::ALL
            .map(|group| [group.has_element_flipping_x(), group.has_element_flipping_y()]);
        let expected = [[0, 0], [1, 0], [0, 1], [1, 1], [1, 1]];
        assert_eq!(flips, expected.map(|axes| axes.map(|flag| flag == 1)));
    }

    #[test]
    fn names_survive_a_round_trip() {
        for group in Group::ALL {
            assert_eq!(group.to_string().parse(), Ok(group));
            let text = serde_json::to_string(&group).unwrap();
            assert_eq!(text, format!("\"{group}\""));
            assert_eq!(serde_json::from_str::<Group>(&text).unwrap(), group);
        }
        assert!(serde_json::from_str::<Group>("\"D4\"").is_err());
        let message = "D4".parse::<Group>().unwrap_err().to_string();
        assert!(message.contains("got the group `D4`"), "{message}");
    }
}
