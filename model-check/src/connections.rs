//! Objects that tendons and equality constraints connect, and comparison of these with their mirror
//! images.

use mujoco::{NumberArray as Num, raw};

use crate::snapshot::{ModelObjectKind, PosedModel};

/// Index that stands for an object without counterpart.
const NONE: usize = usize::MAX / 2;

/// Part of a tendon's path between two pulleys.
#[derive(Default)]
pub(crate) struct Branch {
    /// Type, object and side site of each point, with its row of `wrap_prm`, from the end that makes
    /// them smaller. Those of joints, whose order does not matter, are sorted.
    points: Vec<([usize; 3], usize)>,
    /// Row of `wrap_prm` of the pulley before the branch, if there is one.
    pulley: Option<usize>,
}

impl Branch {
    fn sort(&mut self) {
        let shapes = self.points.iter().map(|([shape, ..], _)| *shape);
        if shapes.eq(std::iter::repeat_n(raw::mjWRAP_JOINT as usize, self.points.len())) {
            self.points.sort_unstable();
        } else if self.objects().gt(self.objects().rev()) {
            self.points.reverse();
        }
    }

    fn objects(&self) -> impl DoubleEndedIterator<Item = [usize; 3]> {
        self.points.iter().map(|(point, _)| *point)
    }

    /// Returns the rows of `wrap_prm` of the points, then that of the pulley.
    pub fn rows(&self) -> impl Iterator<Item = usize> {
        self.points.iter().map(|(_, row)| *row).chain(self.pulley)
    }
}

/// Returns the branches of a tendon, sorted, with `map` of its objects in the place of these.
pub(crate) fn branches(
    snapshot: &PosedModel,
    tendon: usize,
    map: impl Fn(ModelObjectKind, usize) -> Option<usize>,
) -> Vec<Branch> {
    let image = |kind, index| map(kind, index).unwrap_or(NONE);
    let mut all = vec![Branch::default()];
    for (row, shape, object) in snapshot.tendon_path(tendon) {
        let (kind, side) = match shape {
            raw::mjWRAP_PULLEY => {
                all.push(Branch { pulley: Some(row), ..Branch::default() });
                continue;
            }
            raw::mjWRAP_JOINT => (ModelObjectKind::Joint, 0),
            raw::mjWRAP_SITE => (ModelObjectKind::Site, 0),
            _ => {
                // MuJoCo has -1 for a geom without side site
                let side = snapshot.number(Num::WrapPrm, row);
                let site = (side >= 0.0).then(|| 1 + image(ModelObjectKind::Site, side as usize));
                (ModelObjectKind::Geom, site.unwrap_or(0))
            }
        };
        if let Some(branch) = all.last_mut() {
            branch.points.push(([shape as usize, image(kind, object), side], row));
        }
    }
    all.iter_mut().for_each(Branch::sort);
    all.sort_by(|one, other| one.objects().cmp(other.objects()));
    all
}

/// Returns `true` if the path of the second tendon is the mirror image of that of the first, from
/// either end.
pub(crate) fn paths_correspond(
    snapshot: &PosedModel,
    counterpart: impl Fn(ModelObjectKind, usize) -> Option<usize>,
    [one, other]: [usize; 2],
) -> bool {
    let image = branches(snapshot, one, counterpart);
    let found = branches(snapshot, other, |_, index| Some(index));
    let are_equal = |(left, right): (&Branch, &Branch)| {
        left.objects().eq(right.objects()) && left.pulley.is_some() == right.pulley.is_some()
    };
    image.len() == found.len() && image.iter().zip(&found).all(are_equal)
}

/// Order of the mirror images of the two objects of an equality constraint in its counterpart.
#[derive(Clone, Copy, PartialEq, Eq)]
pub(crate) enum ObjectOrder {
    Same,
    Swapped,
}

/// Returns the order of the objects of the first equality constraint in the second; `None` if they
/// are not counterparts.
pub(crate) fn object_order(
    snapshot: &PosedModel,
    counterpart: impl Fn(ModelObjectKind, usize) -> Option<usize>,
    equalities: [usize; 2],
) -> Option<ObjectOrder> {
    let [one, other] = equalities.map(|equality| snapshot.connected_objects(equality));
    let image = |object: Option<(ModelObjectKind, usize)>| match object {
        Some((kind, index)) => counterpart(kind, index).map(|index| Some((kind, index))),
        None => Some(None),
    };
    let [first, second] = [image(one[0])?, image(one[1])?];
    let data = snapshot.equality_data(equalities[0]);
    // of a joint or tendon that follows another, the other is a polynomial only if it is a line
    let can_swap = match one[0] {
        Some((ModelObjectKind::Joint | ModelObjectKind::Tendon, _)) => {
            data[1] != 0.0 && data[2..5] == [0.0; 3]
        }
        _ => true,
    };
    if [first, second] == other {
        Some(ObjectOrder::Same)
    } else if can_swap && [second, first] == other {
        Some(ObjectOrder::Swapped)
    } else {
        None
    }
}
