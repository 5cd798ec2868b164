//! Maps of states, sensor data and actions to those of the mirrored motion.

use std::array;
use std::cmp::Ordering;
use std::f64::consts::FRAC_1_SQRT_2;

use glam::{DMat3, DQuat};
use mujoco::{IntegerArray as Int, NumberArray as Num, raw};
use serde::Serialize;
use symmetry::{FieldType, Group, Irrep, irrep_major_permutation};

use crate::compare::Comparison;
use crate::mirror::{MirrorPlane, quat, quat_values};
use crate::pairs::MirrorPairs;
use crate::snapshot::{ModelObjectKind, PosedModel};

/// Distance of a rounded entry from the entry that is still taken for a permutation.
const ROUNDING: f64 = 1e-3;

/// Linear map of a vector that permutes its entries and changes their signs, and is its own
/// inverse: entry `i` of the mirrored vector is `signs[i]` times entry `sources[i]`.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SignedPermutation {
    /// Index of the entry that becomes each entry.
    pub sources: Vec<usize>,
    /// Sign, 1 or -1, by which it is multiplied.
    pub signs: Vec<i8>,
}

/// Maps of a model's states, sensor data and actions to those of the mirrored motion.
#[derive(Clone, Debug, PartialEq, Serialize)]
pub struct SymmetryMaps {
    /// Group of the identity and the flip: `D1x` if the plane's normal is closest to x, else `D1y`.
    pub group: Group,
    /// Map of `qpos`; positions of free joints count from the plane.
    pub qpos: SignedPermutation,
    /// Map of `qvel`, and of forces on the degrees of freedom.
    pub qvel: SignedPermutation,
    /// Map of `ctrl`, the actions.
    pub ctrl: SignedPermutation,
    /// Map of `sensordata`; `None` if a sensor has no counterpart or its map is not known.
    pub sensordata: Option<SignedPermutation>,
    /// Positions of `qpos` that a plane beyond the origin adds to.
    #[serde(skip)]
    pub(crate) shift: Vec<f64>,
}

impl SignedPermutation {
    fn new(len: usize) -> Self {
        // no entry is its own source until it is set, so a gap is found
        Self { sources: vec![usize::MAX; len], signs: vec![1; len] }
    }

    /// Sets the entries from `at` on to `matrix` times those from `from` on; `None` if the matrix
    /// is no signed permutation.
    fn set<const N: usize>(&mut self, at: usize, from: usize, rows: [[f64; N]; N]) -> Option<()> {
        for (row, entries) in rows.iter().enumerate() {
            let source = entries.iter().position(|entry| entry.abs() > 0.5)?;
            let near = |(column, entry): (usize, &f64)| {
                (entry.abs() - f64::from(u8::from(column == source))).abs() < ROUNDING
            };
            entries.iter().enumerate().all(near).then_some(())?;
            self.sources[at + row] = from + source;
            self.signs[at + row] = if entries[source] < 0.0 { -1 } else { 1 };
        }
        Some(())
    }

    fn complete(self) -> Option<Self> {
        let len = self.sources.len();
        self.sources.iter().all(|&source| source < len).then_some(self)
    }

    /// Returns the mirror image of a vector.
    ///
    /// # Panics
    /// If the vector has another length than the map.
    pub fn apply(&self, vector: &[f64]) -> Vec<f64> {
        assert_eq!(vector.len(), self.sources.len(), "the vector has another length than the map");
        let entries = self.sources.iter().zip(&self.signs);
        entries.map(|(&source, &sign)| f64::from(sign) * vector[source]).collect()
    }

    /// Returns the map of the concatenation of a vector of this map and one of `other`.
    pub fn concatenated_with(&self, other: &Self) -> Self {
        let sources = other.sources.iter().map(|source| source + self.sources.len());
        Self {
            sources: self.sources.iter().copied().chain(sources).collect(),
            signs: [&self.signs[..], &other.signs].concat(),
        }
    }

    /// Returns the irrep of each entry of [`SignedPermutation::vector_to_irreps`] before it is
    /// sorted.
    fn irreps(&self, group: Group) -> Vec<Irrep> {
        let odd = group.irreps()[1];
        let entries = self.sources.iter().zip(&self.signs).enumerate();
        let irrep = |(at, (&source, &sign)): (usize, (&usize, &i8))| match source.cmp(&at) {
            Ordering::Equal if sign < 0 => odd,
            // the sum of a pair stands at its first entry, the difference at its second
            Ordering::Less => odd,
            _ => Irrep::Trivial,
        };
        entries.map(irrep).collect()
    }

    /// Returns the field type of the channels of [`SignedPermutation::vector_to_irreps`], under a
    /// group of two elements.
    ///
    /// # Panics
    /// If the group has not two elements.
    pub fn field_type(&self, group: Group) -> FieldType {
        FieldType::from_irreps(group, &self.irreps(group))
    }

    /// Converts a vector to channels of [`SignedPermutation::field_type`]: sums and differences of
    /// counterparts, over √2.
    ///
    /// # Panics
    /// As [`SignedPermutation::apply`] and [`SignedPermutation::field_type`].
    pub fn vector_to_irreps(&self, group: Group, vector: &[f64]) -> Vec<f64> {
        let image = self.apply(vector);
        let mixed: Vec<f64> = (0..vector.len())
            .map(|at| match self.sources[at].cmp(&at) {
                Ordering::Equal => vector[at],
                Ordering::Greater => FRAC_1_SQRT_2 * (vector[at] + image[at]),
                Ordering::Less => FRAC_1_SQRT_2 * (vector[at] - image[at]),
            })
            .collect();
        irrep_major_permutation(group, &self.irreps(group)).iter().map(|&at| mixed[at]).collect()
    }

    /// Converts channels of [`SignedPermutation::field_type`] to a vector, the inverse of
    /// [`SignedPermutation::vector_to_irreps`].
    ///
    /// # Panics
    /// As [`SignedPermutation::vector_to_irreps`].
    pub fn from_irreps(&self, group: Group, channels: &[f64]) -> Vec<f64> {
        let order = irrep_major_permutation(group, &self.irreps(group));
        let mut mixed = vec![0.0; channels.len()];
        order.iter().zip(channels).for_each(|(&at, &channel)| mixed[at] = channel);
        let entry = |at: usize| {
            let (source, sign) = (self.sources[at], f64::from(self.signs[at]));
            match source.cmp(&at) {
                Ordering::Equal => mixed[at],
                Ordering::Greater => FRAC_1_SQRT_2 * (mixed[at] - sign * mixed[source]),
                Ordering::Less => FRAC_1_SQRT_2 * (mixed[at] + sign * mixed[source]),
            }
        };
        (0..channels.len()).map(entry).collect()
    }
}

impl SymmetryMaps {
    /// Builds the maps of a model from the comparison of its sides.
    ///
    /// # Errors
    /// A text that names a joint, an actuator or a body without counterpart, or whose map is no
    /// signed permutation because its frame or the plane is askew.
    pub(crate) fn new(
        snapshot: &PosedModel,
        pairs: &MirrorPairs,
        comparison: &Comparison,
        plane: &MirrorPlane,
    ) -> Result<Self, String> {
        let model = snapshot.model;
        let mut qpos = SignedPermutation::new(model.nq());
        let mut qvel = SignedPermutation::new(model.nv());
        let mut shift = vec![0.0; model.nq()];
        for joint in 0..snapshot.count(ModelObjectKind::Joint) {
            let mut mapped = || {
                let other = pairs.counterpart_of(ModelObjectKind::Joint, joint)?;
                let at = |array| [other, joint].map(|joint| snapshot.index(array, joint));
                let ([to, from], [to_dof, from_dof]) = (at(Int::JntQposadr), at(Int::JntDofadr));
                let sign = comparison.joint_signs[joint];
                if snapshot.is_scalar_joint(joint) {
                    let [one, image] = [from, to].map(|entry| snapshot.number(Num::Qpos0, entry));
                    shift[to] = image - sign * one;
                    qpos.set(to, from, [[sign]])?;
                    return qvel.set(to_dof, from_dof, [[sign]]);
                }
                let mirror =
                    comparison.mirrors[snapshot.body_of_object(ModelObjectKind::Joint, joint)?]?;
                let turning = rows(-mirror.turn);
                if snapshot.joint_type(joint) == raw::mjJNT_BALL {
                    qpos.set(to, from, quat_rows(mirror.turn, mirror.turn))?;
                    return qvel.set(to_dof, from_dof, turning);
                }
                let world = plane.mirror();
                shift[to..to + 3].copy_from_slice(&world.shift.to_array());
                qpos.set(to, from, rows(world.turn))?;
                qpos.set(to + 3, from + 3, quat_rows(world.turn, mirror.turn))?;
                qvel.set(to_dof, from_dof, rows(world.turn))?;
                qvel.set(to_dof + 3, from_dof + 3, turning)
            };
            mapped().ok_or_else(|| unmapped(snapshot, ModelObjectKind::Joint, joint))?;
        }
        let mut ctrl = SignedPermutation::new(model.nu());
        for (actuator, &sign) in comparison.control_signs.iter().enumerate() {
            let other = pairs.counterpart_of(ModelObjectKind::Actuator, actuator);
            let set = other.and_then(|other| ctrl.set(other, actuator, [[sign]]));
            set.ok_or_else(|| unmapped(snapshot, ModelObjectKind::Actuator, actuator))?;
        }
        let [x, y, _] = plane.normal.map(f64::abs);
        let group = if x > y { Group::D1x } else { Group::D1y };
        let sensordata = sensor_map(snapshot, pairs, comparison);
        Ok(Self { group, qpos, qvel, ctrl, sensordata, shift })
    }
}

fn unmapped(snapshot: &PosedModel, kind: ModelObjectKind, index: usize) -> String {
    format!(
        "{kind} `{}` has no counterpart, or its map is no permutation with signs because its frame \
         or the plane is askew",
        snapshot.object_label(kind, index)
    )
}

fn sensor_map(
    snapshot: &PosedModel,
    pairs: &MirrorPairs,
    comparison: &Comparison,
) -> Option<SignedPermutation> {
    let mut map = SignedPermutation::new(snapshot.model.as_raw().nsensordata as usize);
    for sensor in 0..snapshot.count(ModelObjectKind::Sensor) {
        let other = pairs.counterpart_of(ModelObjectKind::Sensor, sensor)?;
        let [to, from] = [other, sensor].map(|sensor| snapshot.index(Int::SensorAdr, sensor));
        let (_, object) = snapshot.target_object(ModelObjectKind::Sensor, sensor)?;
        // vectors are in the frame of their site
        let turn = || comparison.site_directions(snapshot, pairs, object);
        match snapshot.integer(Int::SensorType, sensor).cast_unsigned() {
            raw::mjSENS_TOUCH | raw::mjSENS_RANGEFINDER => map.set(to, from, [[1.0]])?,
            raw::mjSENS_ACCELEROMETER
            | raw::mjSENS_VELOCIMETER
            | raw::mjSENS_FORCE
            | raw::mjSENS_MAGNETOMETER => map.set(to, from, rows(turn()?))?,
            raw::mjSENS_GYRO | raw::mjSENS_TORQUE => map.set(to, from, rows(-turn()?))?,
            raw::mjSENS_JOINTPOS | raw::mjSENS_JOINTVEL => {
                map.set(to, from, [[comparison.joint_signs[object]]])?
            }
            raw::mjSENS_TENDONPOS | raw::mjSENS_TENDONVEL => {
                map.set(to, from, [[comparison.tendon_signs[object]]])?
            }
            raw::mjSENS_ACTUATORPOS | raw::mjSENS_ACTUATORVEL | raw::mjSENS_ACTUATORFRC => {
                map.set(to, from, [[comparison.control_signs[object]]])?
            }
            _ => return None,
        }
    }
    map.complete()
}

fn rows(matrix: DMat3) -> [[f64; 3]; 3] {
    matrix.transpose().to_cols_array_2d()
}

/// Returns the map of the quaternion of a rotation Q to that of `outer` Q `inner`ᵀ, where both are
/// mirrors.
fn quat_rows(outer: DMat3, inner: DMat3) -> [[f64; 4]; 4] {
    let [outer, inner] = [outer, inner.transpose()].map(|turn| DQuat::from_mat3(&-turn));
    let unit = |at: usize| {
        let mut unit = [0.0; 4];
        unit[at] = 1.0;
        quat_values(outer * quat(&unit) * inner)
    };
    let columns: [[f64; 4]; 4] = array::from_fn(unit);
    // a quaternion and its negative are one rotation; the real part keeps its sign
    let sign = columns[0].iter().sum::<f64>().signum();
    array::from_fn(|row| array::from_fn(|column| sign * columns[column][row]))
}
