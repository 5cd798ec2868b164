//! Counterparts of objects on the other side, from names and geometry.

use std::collections::BTreeMap;
use std::path::Path;

use mujoco::IntegerArray;
use robots::without_byte_order_mark;
use serde::{Deserialize, Serialize};

use crate::connections::{object_order, paths_correspond};
use crate::error::ModelSymmetryError;
use crate::mirror::MirrorPlane;
use crate::names::are_mirror_names;
use crate::snapshot::{ModelObjectKind, PosedModel};

/// Distance within which objects without names of sides are counterparts, as a share of the model's
/// extent.
const NEARNESS: f64 = 0.1;

/// Counterparts that corrections give, in both directions.
type Forced = BTreeMap<(ModelObjectKind, usize), usize>;

/// Corrections of the proposed mirror plane and pairs, as a JSON file holds them.
///
/// Objects are named as reports name them, [left, right]; a name twice is an object in the plane.
#[derive(Clone, Debug, Default, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields, default)]
pub struct PlaneAndPairCorrections {
    /// Mirror plane; `None` for the proposed one.
    pub plane: Option<MirrorPlane>,
    /// Counterparts of each kind of object.
    pub pairs: BTreeMap<ModelObjectKind, Vec<[String; 2]>>,
    /// Objects whose differences are left out, for instance `camera side`.
    pub ignore: Vec<String>,
}

impl PlaneAndPairCorrections {
    /// Reads corrections from a JSON file.
    ///
    /// # Errors
    /// [`ModelSymmetryError::Read`], [`ModelSymmetryError::InvalidFile`].
    pub fn read(path: &Path) -> Result<Self, ModelSymmetryError> {
        let text = std::fs::read(path)
            .map_err(|source| ModelSymmetryError::Read { path: path.into(), source })?;
        serde_json::from_slice(without_byte_order_mark(&text)).map_err(|error| {
            ModelSymmetryError::InvalidFile { path: path.into(), message: error.to_string() }
        })
    }

    /// Returns the corrected pairs of objects of each kind as indices, in both directions, after
    /// checking the names of ignored objects.
    ///
    /// # Errors
    /// [`ModelSymmetryError::UnknownObject`], [`ModelSymmetryError::UnknownIgnored`],
    /// [`ModelSymmetryError::UnusablePair`] for an object in two pairs.
    pub(crate) fn indices(&self, snapshot: &PosedModel) -> Result<Forced, ModelSymmetryError> {
        let mut forced = BTreeMap::new();
        let objects = ModelObjectKind::ALL.into_iter().flat_map(|kind| {
            let all = 0..snapshot.count(kind);
            all.map(move |index| format!("{kind} {}", snapshot.object_label(kind, index)))
        });
        let objects: Vec<String> = objects.collect();
        if let Some(name) = self.ignore.iter().find(|name| !objects.contains(name)) {
            return Err(ModelSymmetryError::UnknownIgnored { name: name.clone() });
        }
        for (&kind, pairs) in &self.pairs {
            let labels = (0..snapshot.count(kind)).map(|index| snapshot.object_label(kind, index));
            let known: Vec<String> = labels.collect();
            let find = |name: &String| {
                let found = known.iter().position(|label| label == name);
                found.ok_or_else(|| {
                    let (name, known) = (name.clone(), known.clone());
                    ModelSymmetryError::UnknownObject { kind, name, known }
                })
            };
            for [one, other] in pairs {
                let pair = [one, other].map(Clone::clone);
                let [left, right] = [find(one)?, find(other)?];
                for (from, to) in [(left, right), (right, left)] {
                    if forced.insert((kind, from), to).is_some_and(|before| before != to) {
                        let reason = "one of them is in another pair, too";
                        return Err(ModelSymmetryError::UnusablePair { kind, pair, reason });
                    }
                }
            }
        }
        Ok(forced)
    }
}

/// Counterparts of all objects of a model on its other side.
pub(crate) struct MirrorPairs {
    counterparts: [Vec<Option<usize>>; 10],
}

impl MirrorPairs {
    /// Finds counterparts by the pairs `forced`, then by names, then by the distance of mirror
    /// images. Objects of bodies without counterparts have none either.
    pub fn new(snapshot: &PosedModel, plane: &MirrorPlane, forced: &Forced) -> Self {
        let none = ModelObjectKind::ALL.map(|kind| vec![None; snapshot.count(kind)]);
        let mut pairs = Self { counterparts: none };
        let finder = Finder { snapshot, plane, forced };
        pairs.counterparts[ModelObjectKind::Body as usize][0] = Some(0);
        for body in 0..snapshot.count(ModelObjectKind::Body) {
            // a body comes after its parent, whose counterpart is known here
            let Some(other) =
                pairs.counterpart_of(ModelObjectKind::Body, body).filter(|&other| body <= other)
            else {
                continue;
            };
            for kind in [
                ModelObjectKind::Body,
                ModelObjectKind::Joint,
                ModelObjectKind::Geom,
                ModelObjectKind::Site,
                ModelObjectKind::Camera,
            ] {
                let [one, other] = [body, other].map(|owner| finder.objects(kind, owner));
                finder.pair_up(kind, &one, &other, &mut pairs);
            }
        }
        // each after what it connects, moves or observes
        for kind in [
            ModelObjectKind::Tendon,
            ModelObjectKind::Equality,
            ModelObjectKind::Actuator,
            ModelObjectKind::Sensor,
            ModelObjectKind::Keyframe,
        ] {
            let all: Vec<usize> = (0..snapshot.count(kind)).collect();
            finder.pair_up(kind, &all, &all, &mut pairs);
        }
        pairs
    }

    /// Checks that corrected pairs of objects are counterparts.
    ///
    /// # Errors
    /// [`ModelSymmetryError::UnusablePair`].
    pub fn check_corrections(
        &self,
        snapshot: &PosedModel,
        forced: &Forced,
    ) -> Result<(), ModelSymmetryError> {
        for (&(kind, one), &other) in forced {
            if self.counterpart_of(kind, one) != Some(other) {
                let pair = [one, other].map(|index| snapshot.object_label(kind, index));
                let reason = "their types differ, or what they belong to, connect, move or observe \
                    are no counterparts, or they are not compared";
                return Err(ModelSymmetryError::UnusablePair { kind, pair, reason });
            }
        }
        Ok(())
    }

    /// Returns the index of an object's counterpart, its own if it lies in the plane; `None` if it
    /// has no counterpart.
    pub fn counterpart_of(&self, kind: ModelObjectKind, index: usize) -> Option<usize> {
        *self.counterparts[kind as usize].get(index)?
    }

    /// Returns the number of objects without counterparts, those that are only drawn included.
    pub fn unpaired_count(&self) -> usize {
        self.counterparts.iter().flatten().filter(|other| other.is_none()).count()
    }

    fn set(&mut self, kind: ModelObjectKind, one: usize, other: usize) {
        let counterparts = &mut self.counterparts[kind as usize];
        counterparts[one] = Some(other);
        counterparts[other] = Some(one);
    }

    /// Returns the indices of all pairs of counterparts of a kind, [left, right], each pair once.
    pub fn left_right_pairs(
        &self,
        kind: ModelObjectKind,
        snapshot: &PosedModel,
        plane: &MirrorPlane,
    ) -> Vec<[usize; 2]> {
        let pairs = self.counterparts[kind as usize].iter().enumerate();
        let pairs = pairs.filter_map(|(one, other)| other.map(|other| [one, other]));
        let once = pairs.filter(|[one, other]| one <= other);
        let left_first = |[one, other]: [usize; 2]| {
            let [a, b] = [one, other].map(|at| plane.distance(snapshot.object_position(kind, at)));
            if a < b { [other, one] } else { [one, other] }
        };
        once.map(left_first).collect()
    }
}

struct Finder<'a> {
    snapshot: &'a PosedModel<'a>,
    plane: &'a MirrorPlane,
    forced: &'a Forced,
}

impl Finder<'_> {
    /// Returns the objects that are compared of a body, or the bodies that hang on it.
    fn objects(&self, kind: ModelObjectKind, owner: usize) -> Vec<usize> {
        let all = 0..self.snapshot.count(kind);
        let belongs = |&index: &usize| match kind {
            ModelObjectKind::Body => index > 0 && self.snapshot.parent(index) == owner,
            ModelObjectKind::Geom => {
                self.snapshot.body_of_object(kind, index) == Some(owner)
                    && self.snapshot.geom_collides_or_bends_tendon(index)
            }
            _ => self.snapshot.body_of_object(kind, index) == Some(owner),
        };
        all.filter(belongs).collect()
    }

    /// Pairs objects of two lists, which are one list if their owner lies in the plane.
    fn pair_up(
        &self,
        kind: ModelObjectKind,
        left: &[usize],
        right: &[usize],
        pairs: &mut MirrorPairs,
    ) {
        let is_one_list = left == right;
        let mut candidates = Vec::new();
        for &one in left {
            for &other in right.iter().filter(|&&other| !is_one_list || one <= other) {
                let rank = self.rank(kind, one, other, pairs);
                // what is left on two sides corresponds, however far it was moved
                if let Some(rank) = rank.filter(|(rank, _)| *rank < 3 || !is_one_list) {
                    candidates.push((rank, one, other));
                }
            }
        }
        candidates.sort_by(|((a, near), ..), ((b, far), ..)| a.cmp(b).then(near.total_cmp(far)));
        for (_, one, other) in candidates {
            if pairs.counterpart_of(kind, one).is_none()
                && pairs.counterpart_of(kind, other).is_none()
            {
                pairs.set(kind, one, other);
            }
        }
    }

    /// Returns the priority of a pair, the lower the better, and its distance: 0 by corrections, 1
    /// by names, 2 by nearness, 3 for the rest. `None` if the two cannot be counterparts.
    fn rank(
        &self,
        kind: ModelObjectKind,
        one: usize,
        other: usize,
        pairs: &MirrorPairs,
    ) -> Option<(u8, f64)> {
        let given = [(one, other), (other, one)]
            .map(|(from, to)| self.forced.get(&(kind, from)).map(|&at| at == to));
        match given {
            [None, None] => {}
            [Some(true), _] | [_, Some(true)] => {
                return self.have_one_type(kind, [one, other]).then_some((0, 0.0));
            }
            _ => return None,
        }
        let snapshot = self.snapshot;
        let names = [one, other].map(|index| snapshot.name(kind, index));
        let is_named = matches!(names, [Some(a), Some(b)] if are_mirror_names(a, b));
        if !self.can_correspond(kind, [one, other], is_named, pairs) {
            return None;
        }
        let [position, image] = [other, one].map(|index| snapshot.object_position(kind, index));
        let image = self.plane.mirror().point(image);
        let distance = match kind {
            ModelObjectKind::Actuator | ModelObjectKind::Sensor | ModelObjectKind::Keyframe => 0.0,
            ModelObjectKind::Joint => {
                let axis = self.plane.mirror().direction(snapshot.joint_axis(one));
                let cosine = axis.dot(snapshot.joint_axis(other)).abs();
                image.distance(position) + NEARNESS * snapshot.extent * (1.0 - cosine)
            }
            _ => image.distance(position),
        };
        // what connects counterparts is near however far its anchors were moved
        let is_near = distance <= NEARNESS * snapshot.extent
            || matches!(kind, ModelObjectKind::Tendon | ModelObjectKind::Equality);
        Some((if is_named { 1 } else { 3 - u8::from(is_near) }, distance))
    }

    /// Returns `true` if the types of two objects agree.
    fn have_one_type(&self, kind: ModelObjectKind, [one, other]: [usize; 2]) -> bool {
        let types: &[IntegerArray] = match kind {
            ModelObjectKind::Joint => &[IntegerArray::JntType],
            ModelObjectKind::Geom => &[IntegerArray::GeomType],
            ModelObjectKind::Equality => &[IntegerArray::EqType],
            ModelObjectKind::Actuator => {
                &[IntegerArray::ActuatorTrntype, IntegerArray::ActuatorGaintype]
            }
            ModelObjectKind::Sensor => &[IntegerArray::SensorType, IntegerArray::SensorReftype],
            _ => &[],
        };
        let number = |array, index| self.snapshot.integer(array, index);
        types.iter().all(|&array| number(array, one) == number(array, other))
    }

    /// Returns `true` if the types of two objects agree, and what they connect, move or observe are
    /// counterparts. Tendons and equality constraints with names of sides may connect others.
    fn can_correspond(
        &self,
        kind: ModelObjectKind,
        [one, other]: [usize; 2],
        is_named: bool,
        pairs: &MirrorPairs,
    ) -> bool {
        let snapshot = self.snapshot;
        let counterpart = |of, index| pairs.counterpart_of(of, index);
        self.have_one_type(kind, [one, other])
            && match kind {
                ModelObjectKind::Tendon => {
                    is_named || paths_correspond(snapshot, counterpart, [one, other])
                }
                ModelObjectKind::Equality => {
                    is_named || object_order(snapshot, counterpart, [one, other]).is_some()
                }
                ModelObjectKind::Actuator | ModelObjectKind::Sensor => {
                    self.targets_correspond(kind, one, other, pairs)
                }
                ModelObjectKind::Keyframe => is_named || one == other,
                _ => true,
            }
    }

    /// Returns `true` if the objects that two actuators or sensors act on or observe are
    /// counterparts.
    fn targets_correspond(
        &self,
        kind: ModelObjectKind,
        one: usize,
        other: usize,
        pairs: &MirrorPairs,
    ) -> bool {
        match (self.snapshot.target_object(kind, one), self.snapshot.target_object(kind, other)) {
            (Some((of, from)), Some((_, to))) => pairs.counterpart_of(of, from) == Some(to),
            (None, None) => kind == ModelObjectKind::Sensor && one == other,
            _ => false,
        }
    }
}
