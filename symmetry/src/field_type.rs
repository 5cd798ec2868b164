//! Field types: multiplicities of irreps among the channels.

use std::ops::{Add, Neg, Range};

use crate::d2::D2;
use crate::group::Group;
use crate::irrep::Irrep;

/// Representation of a [`Group`], given by the multiplicity of each irrep.
///
/// Channels are irrep-major: [`channel_range`](FieldType::channel_range) gives the channels of an
/// irrep. A type prints and parses the notation of the papers, `8 reg + 2 x` for a type of D2 and
/// `C2: 8 reg + 2 x` for one of a subgroup. [`Group::regular_type`] and [`Group::trivial_type`]
/// make the common types.
#[derive(Clone, Copy, Debug, PartialEq, Eq, Hash)]
pub struct FieldType {
    group: Group,
    /// Multiplicities of the irreps 1, x, y and xy; zero for irreps that the group does not have.
    multiplicities: [usize; 4],
}

impl FieldType {
    /// Maximum number of channels of a field type, 2^24.
    pub const MAX_DIM: usize = 1 << 24;

    /// Creates the field type of D2 with the given multiplicities of the irreps 1, x, y and xy,
    /// restricted to `group`.
    ///
    /// Multiplicities of irreps that are equal under `group` are added up.
    ///
    /// # Panics
    /// If the multiplicities add up to more than [`FieldType::MAX_DIM`].
    pub const fn new(group: Group, multiplicities: [usize; 4]) -> FieldType {
        match FieldType::try_new(group, multiplicities) {
            Some(field) => field,
            None => panic!("a field type has at most 2^24 channels"),
        }
    }

    /// Creates a field type as [`FieldType::new`] does; `None` for more than `MAX_DIM` channels.
    pub(crate) const fn try_new(group: Group, multiplicities: [usize; 4]) -> Option<FieldType> {
        // subtracted from the maximum, since a sum could overflow; `for` is not allowed in const fn
        let (mut left, mut a) = (FieldType::MAX_DIM, 0);
        while a < 4 {
            match left.checked_sub(multiplicities[a]) {
                Some(rest) => left = rest,
                None => return None,
            }
            a += 1;
        }
        Some(FieldType::restricted(group, multiplicities))
    }

    /// Returns the direct sum of this field type and `count` copies of `other`, which must have the
    /// same group. `None` for more than `MAX_DIM` channels.
    pub(crate) fn plus_copies_of(&self, other: FieldType, count: usize) -> Option<FieldType> {
        let mut multiplicities = self.multiplicities;
        for (sum, of_one) in multiplicities.iter_mut().zip(other.multiplicities) {
            *sum = count.checked_mul(of_one)?.checked_add(*sum)?;
        }
        FieldType::try_new(self.group, multiplicities)
    }

    /// Restricts a field type of D2, given by its multiplicities, to `group`.
    const fn restricted(group: Group, multiplicities: [usize; 4]) -> FieldType {
        let mut restricted = [0; 4];
        let mut a = 0;
        while a < 4 {
            restricted[group.restrict_d2_irrep(Irrep::ALL[a]).index()] += multiplicities[a];
            a += 1;
        }
        FieldType { group, multiplicities: restricted }
    }

    /// Returns the field type, under `group`, of a vector whose entries have the given irreps of
    /// D2, in any order.
    ///
    /// [`irrep_major_permutation`] sorts such a vector into the layout of the type.
    ///
    /// # Panics
    /// If there are more than [`FieldType::MAX_DIM`] entries.
    pub fn from_irreps(group: Group, irreps: &[Irrep]) -> FieldType {
        let mut multiplicities = [0; 4];
        for irrep in irreps {
            multiplicities[irrep.index()] += 1;
        }
        FieldType::new(group, multiplicities)
    }

    /// Returns the symmetry group that acts on the channels.
    pub const fn group(&self) -> Group {
        self.group
    }

    /// Restricts the field type to a subgroup of its group.
    ///
    /// Channels of irreps that become equal are neighbours in the new layout:
    /// [`irrep_major_permutation`] of [`channel_irreps`](FieldType::channel_irreps) gives the order
    /// of the old channels in it.
    ///
    /// # Panics
    /// If `group` is not a subgroup of the type's.
    pub fn restrict(&self, group: Group) -> FieldType {
        assert!(
            group.is_subgroup_of(self.group),
            "got {group}, expected a subgroup of {} to restrict `{self}` to",
            self.group
        );
        FieldType::new(group, self.multiplicities)
    }

    /// Returns the number of channels of the field type.
    pub fn dim(&self) -> usize {
        self.multiplicities.iter().sum()
    }

    /// Returns the number of channels that transform by `irrep`; 0 for an irrep that the group does
    /// not have.
    pub const fn multiplicity(&self, irrep: Irrep) -> usize {
        self.multiplicities[irrep.index()]
    }

    /// Returns the range of the channels that transform by `irrep` in a channel vector.
    pub fn channel_range(&self, irrep: Irrep) -> Range<usize> {
        let start = self.multiplicities[..irrep.index()].iter().sum();
        start..start + self.multiplicity(irrep)
    }

    /// Returns the irrep of each channel, in the order of the channels.
    pub fn channel_irreps(&self) -> impl Iterator<Item = Irrep> + use<> {
        let multiplicities = self.multiplicities;
        Irrep::ALL.into_iter().flat_map(move |a| std::iter::repeat_n(a, multiplicities[a.index()]))
    }

    /// Returns the number of copies of the regular representation that the field type consists of;
    /// `None` if the type has other channels, too.
    ///
    /// Every type of C1 consists of regular fields: its regular representation is the trivial one.
    pub fn num_regular_fields(&self) -> Option<usize> {
        let n = self.multiplicity(Irrep::Trivial);
        let irreps = self.group.irreps();
        let is_regular = irreps.iter().all(|&irrep| self.multiplicity(irrep) == n);
        is_regular.then_some(n)
    }

    /// Returns `true` if every element of the group leaves every channel unchanged.
    pub fn is_trivial(&self) -> bool {
        self.multiplicities[1..] == [0; 3]
    }

    /// Transforms a channel vector by the group element `g` in place: channels of irreps with the
    /// sign -1 are negated.
    ///
    /// # Panics
    /// If `g` is not in the group or `channels` does not hold [`dim`](FieldType::dim) values.
    pub fn transform_channels<T: Copy + Neg<Output = T>>(&self, g: D2, channels: &mut [T]) {
        assert!(
            self.group.contains(g),
            "got {g}, which is not in the group {} of `{self}`",
            self.group
        );
        assert_eq!(channels.len(), self.dim(), "wrong number of channels for {self}");
        for irrep in Irrep::ALL.into_iter().filter(|a| a.sign(g) < 0) {
            for value in &mut channels[self.channel_range(irrep)] {
                *value = -*value;
            }
        }
    }
}

impl Group {
    /// Returns the field type of `fields` copies of the regular representation, in which every
    /// irrep occurs `fields` times.
    ///
    /// # Panics
    /// If that is more than [`FieldType::MAX_DIM`] channels.
    pub const fn regular_type(self, fields: usize) -> FieldType {
        match self {
            Group::C1 => FieldType::new(self, [fields, 0, 0, 0]),
            Group::D1x | Group::C2 => FieldType::new(self, [fields, fields, 0, 0]),
            Group::D1y => FieldType::new(self, [fields, 0, fields, 0]),
            Group::D2 => FieldType::new(self, [fields; 4]),
        }
    }

    /// Returns the field type of `channels` invariant channels.
    ///
    /// # Panics
    /// If `channels` is more than [`FieldType::MAX_DIM`].
    pub const fn trivial_type(self, channels: usize) -> FieldType {
        FieldType::new(self, [channels, 0, 0, 0])
    }
}

impl Add for FieldType {
    type Output = FieldType;

    /// Returns the direct sum of two field types. Its channels are irrep-major again, so it is no
    /// concatenation.
    ///
    /// # Panics
    /// If the groups differ, or the sum has more than [`FieldType::MAX_DIM`] channels.
    fn add(self, other: FieldType) -> FieldType {
        assert_eq!(
            self.group, other.group,
            "`{self}` and `{other}` are types of different groups, restrict one of them"
        );
        let sum = |a: usize| self.multiplicities[a] + other.multiplicities[a];
        FieldType::new(self.group, std::array::from_fn(sum))
    }
}

/// Returns the permutation that sorts channels with the given irreps into irrep-major order under
/// `group`: entry `i` is the index in `irreps` of irrep-major channel `i`.
///
/// Channels of one irrep keep their order.
///
/// ```
/// use symmetry::{Group, Irrep, irrep_major_permutation};
///
/// // natural order x, y, z, finger
/// let irreps = [Irrep::X, Irrep::Y, Irrep::Trivial, Irrep::Trivial];
/// assert_eq!(irrep_major_permutation(Group::D2, &irreps), [2, 3, 0, 1]);
/// // flip x leaves y alone
/// assert_eq!(irrep_major_permutation(Group::D1x, &irreps), [1, 2, 3, 0]);
/// ```
pub fn irrep_major_permutation(group: Group, irreps: &[Irrep]) -> Vec<usize> {
    let mut order: Vec<usize> = (0..irreps.len()).collect();
    // a stable sort, so channels of one irrep keep their order
    order.sort_by_key(|&i| group.restrict_d2_irrep(irreps[i]).index());
    order
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn ranges_are_irrep_major_and_cover_the_channels() {
        let field = FieldType::new(Group::D2, [2, 0, 3, 1]);
        assert_eq!(field.dim(), 6);
        let ranges = Irrep::ALL.map(|a| field.channel_range(a));
        assert_eq!(ranges, [0..2, 2..2, 2..5, 5..6]);
        use Irrep::*;
        assert!(field.channel_irreps().eq([Trivial, Trivial, Y, Y, Y, XY]));
    }

    #[test]
    fn regular_fields_are_recognised() {
        for group in Group::ALL {
            let regular = group.regular_type(3);
            assert_eq!(regular.dim(), 3 * group.order());
            assert_eq!(regular.num_regular_fields(), Some(3));
            assert!(group.trivial_type(6).is_trivial());
            assert_eq!(regular.is_trivial(), group == Group::C1);
        }
        let uneven = FieldType::new(Group::D2, [3, 3, 3, 2]);
        assert_eq!(uneven.num_regular_fields(), None);
        let foreign = FieldType::new(Group::D1y, [1, 0, 0, 0]);
        assert_eq!(foreign.num_regular_fields(), None);
    }

    #[test]
    fn the_action_is_a_representation_of_every_group() {
        for group in Group::ALL {
            let field = FieldType::new(group, [1, 2, 1, 1]);
            for &g in group.elements() {
                for &h in group.elements() {
                    let mut twice = [1, 2, 3, 4, 5];
                    field.transform_channels(h, &mut twice);
                    field.transform_channels(g, &mut twice);
                    let mut once = [1, 2, 3, 4, 5];
                    field.transform_channels(g * h, &mut once);
                    assert_eq!(once, twice);
                }
            }
        }
        let mut flipped = [1, 2, 3, 4, 5];
        FieldType::new(Group::D2, [1, 2, 1, 1]).transform_channels(D2::FlipX, &mut flipped);
        assert_eq!(flipped, [1, -2, -3, 4, -5]);
    }

    #[test]
    fn restriction_keeps_the_action_of_the_subgroup() {
        for group in Group::ALL {
            let field = FieldType::new(group, [1, 2, 1, 3]);
            let irreps: Vec<Irrep> = field.channel_irreps().collect();
            for sub in Group::ALL.into_iter().filter(|h| h.is_subgroup_of(group)) {
                let order = irrep_major_permutation(sub, &irreps);
                for &g in sub.elements() {
                    let mut before = [1, 2, 3, 4, 5, 6, 7];
                    let mut after: Vec<i32> = order.iter().map(|&i| before[i]).collect();
                    field.transform_channels(g, &mut before);
                    field.restrict(sub).transform_channels(g, &mut after);
                    let moved: Vec<i32> = order.iter().map(|&i| before[i]).collect();
                    assert_eq!(after, moved, "{group} to {sub}");
                }
            }
        }
    }

    #[test]
    fn the_sum_adds_multiplicities() {
        let sum = Group::C2.regular_type(2) + Group::C2.trivial_type(1);
        assert_eq!(sum, FieldType::new(Group::C2, [3, 2, 0, 0]));
    }

    #[test]
    #[should_panic(expected = "`1 1` and `C2: 1 1` are types of different groups")]
    fn types_of_different_groups_are_not_added() {
        let _ = Group::D2.trivial_type(1) + Group::C2.trivial_type(1);
    }

    #[test]
    #[should_panic(expected = "got D1x, expected a subgroup of C2")]
    fn a_restriction_to_another_group_is_refused() {
        Group::C2.regular_type(1).restrict(Group::D1x);
    }

    #[test]
    #[should_panic(expected = "got flip x, which is not in the group C2")]
    fn elements_outside_the_group_do_not_act() {
        Group::C2.regular_type(1).transform_channels(D2::FlipX, &mut [0.0; 2]);
    }

    #[test]
    #[should_panic(expected = "wrong number of channels for 1 reg")]
    fn acting_on_the_wrong_number_of_channels_is_refused() {
        Group::D2.regular_type(1).transform_channels(D2::FlipX, &mut [0.0; 5]);
    }

    #[test]
    fn the_order_is_stable_within_an_irrep() {
        use Irrep::*;
        let order = irrep_major_permutation(Group::D2, &[XY, Y, Trivial, Y, X, Trivial]);
        assert_eq!(order, [2, 5, 4, 1, 3, 0]);
    }
}
