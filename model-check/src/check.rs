//! Check of a model: plane, pairs, differences and maps in one result.

use glam::DVec3;
use mujoco::{Model, NumberArray};
use serde::Serialize;

use crate::compare::{Comparison, DifferenceMeasure, MirrorDifference};
use crate::effect;
use crate::error::ModelSymmetryError;
use crate::maps::SymmetryMaps;
use crate::mirror::MirrorPlane;
use crate::names::{are_mirror_names, is_left};
use crate::pairs::{MirrorPairs, PlaneAndPairCorrections};
use crate::snapshot::{ModelObjectKind, PosedModel};

/// Settings of the symmetry check of a model, [`check_model_symmetry`].
#[derive(Clone, Debug, PartialEq)]
pub struct ModelSymmetrySettings {
    /// Smallest difference that is listed: a share of the value, an angle in radians, or ten times
    /// a length in metres.
    pub tolerance: f64,
    /// Corrections of the proposed plane and pairs.
    pub corrections: PlaneAndPairCorrections,
    /// `true` to simulate the effect on the motion of each difference between left and right.
    pub simulates: bool,
}

impl Default for ModelSymmetrySettings {
    /// Returns a tolerance of 0.001 (0.1 %, 0.1 mm, 0.06 degrees), with effects.
    fn default() -> Self {
        Self { tolerance: 1e-3, corrections: PlaneAndPairCorrections::default(), simulates: true }
    }
}

/// Result of the comparison of a model's left and right sides.
#[derive(Clone, Debug, Serialize)]
pub struct ModelSymmetryReport {
    /// Plane and counterparts, in the form of a file of corrections.
    pub corrections: PlaneAndPairCorrections,
    /// Differences, those with the largest effect first.
    pub differences: Vec<MirrorDifference>,
    /// Root mean square by which two copies of the same side diverge after a second of mirrored
    /// torques (radians and metres); `None` if that is not simulated.
    pub twin_divergence: Option<f64>,
    /// Reason for which no effect could be simulated.
    pub unsimulated: Option<String>,
    /// Maps of states and actions to those of the mirrored motion.
    pub maps: Option<SymmetryMaps>,
    /// Reason for which there are no maps.
    pub unmapped: Option<String>,
}

/// Compares the left side of a model with its right side.
///
/// # Errors
/// [`ModelSymmetryError::UnknownObject`] and [`ModelSymmetryError::InvalidPlane`] for corrections,
/// [`ModelSymmetryError::InvalidTolerance`].
pub fn check_model_symmetry(
    model: &Model,
    settings: &ModelSymmetrySettings,
) -> Result<ModelSymmetryReport, ModelSymmetryError> {
    let tolerance = settings.tolerance;
    if !(0.0..=1.0).contains(&tolerance) {
        return Err(ModelSymmetryError::InvalidTolerance { tolerance });
    }
    let snapshot = PosedModel::new(model);
    let corrections = &settings.corrections;
    let forced = corrections.indices(&snapshot)?;
    let planes = match corrections.plane {
        Some(plane) if plane.is_valid() => vec![plane],
        Some(plane) => return Err(ModelSymmetryError::InvalidPlane { plane }),
        None => proposed_planes(&snapshot),
    };
    let compared = planes.into_iter().map(|plane| {
        let pairs = MirrorPairs::new(&snapshot, &plane, &forced);
        let comparison = Comparison::new(&snapshot, &pairs, &plane, tolerance);
        (plane, pairs, comparison)
    });
    let best = compared
        .min_by_key(|(_, pairs, comparison)| comparison.differences.len() + pairs.unpaired_count());
    // there is always a proposal
    let Some((plane, pairs, mut comparison)) = best else {
        return Err(ModelSymmetryError::InvalidPlane { plane: MirrorPlane::default() });
    };
    pairs.check_corrections(&snapshot, &forced)?;
    let mut differences = std::mem::take(&mut comparison.differences);
    let ignores = |difference: &MirrorDifference| {
        let names = [&difference.left, &difference.right];
        let names = names.map(|name| format!("{} {name}", difference.kind));
        corrections.ignore.iter().any(|ignored| names.contains(ignored))
    };
    let maps = SymmetryMaps::new(&snapshot, &pairs, &comparison, &plane);
    let simulated = match &maps {
        Ok(maps) if settings.simulates => effect::simulate(model, maps, &mut differences),
        _ => Ok(None),
    };
    let (twin_divergence, unsimulated) = match simulated {
        Ok(divergence) => (divergence, None),
        Err(reason) => (None, Some(reason.to_string())),
    };
    // after the simulation, whose effects are of a model without any difference
    differences.retain(|difference| !ignores(difference));
    sort_by_effect(&mut differences);
    let (maps, unmapped) = match maps {
        Ok(maps) => (Some(maps), None),
        Err(reason) => (None, Some(reason)),
    };
    let corrections = corrections_of(&snapshot, &pairs, &plane, &corrections.ignore);
    Ok(ModelSymmetryReport {
        corrections,
        differences,
        twin_divergence,
        unsimulated,
        maps,
        unmapped,
    })
}

/// Sorts differences by effect, the largest first, and those of equal effect by size; those that
/// were not simulated come last.
fn sort_by_effect(differences: &mut [MirrorDifference]) {
    let rank = |difference: &MirrorDifference| {
        (difference.effect.unwrap_or(-1.0), difference.scaled_amount())
    };
    differences.sort_by(|a, b| {
        let ((a, small), (b, large)) = (rank(a), rank(b));
        b.total_cmp(&a).then(large.total_cmp(&small))
    });
}

/// Returns candidate planes across y, across x and across the mean direction from right to left
/// names, through the world's origin, the bodies on the world, and between named bodies.
fn proposed_planes(snapshot: &PosedModel) -> Vec<MirrorPlane> {
    let bodies = 1..snapshot.count(ModelObjectKind::Body);
    let names: Vec<_> =
        bodies.clone().map(|body| snapshot.name(ModelObjectKind::Body, body)).collect();
    let named = |one: usize| {
        let is_of = |other: &usize| {
            matches!((names[one - 1], names[other - 1]), (Some(a), Some(b))
                if are_mirror_names(a, b) && is_left(a, b))
        };
        bodies.clone().find(is_of).map(|other| [one, other].map(|body| snapshot.body_frame(body).0))
    };
    let named: Vec<[DVec3; 2]> = bodies.clone().filter_map(named).collect();
    let across: DVec3 = named.iter().map(|[left, right]| *left - *right).sum();
    let mut normals = vec![DVec3::Y, DVec3::X];
    normals.extend(across.try_normalize());
    let roots = bodies.clone().filter(|&body| snapshot.parent(body) == 0);
    let mut points: Vec<DVec3> = roots.map(|body| snapshot.body_frame(body).0).collect();
    // more roots than arms of a robot are objects of a scene
    points.truncate(4);
    points.insert(0, DVec3::ZERO);
    let mut planes = Vec::new();
    for normal in normals {
        let normal = if normal.dot(across) < 0.0 { -normal } else { normal };
        let mut offsets: Vec<f64> = points.iter().map(|point| normal.dot(*point)).collect();
        let between = named.iter().map(|[left, right]| 0.5 * normal.dot(*left + *right));
        let mut between: Vec<f64> = between.collect();
        between.sort_by(f64::total_cmp);
        offsets.extend(between.get(between.len() / 2));
        let mass = |body: usize| snapshot.number(NumberArray::BodyMass, body);
        let total: f64 = bodies.clone().map(mass).sum();
        let centre: DVec3 = bodies
            .clone()
            .map(|body| mass(body) * snapshot.object_position(ModelObjectKind::Body, body))
            .sum();
        offsets.push(normal.dot(centre) / total.max(1e-9));
        let new =
            offsets.into_iter().map(|offset| MirrorPlane { normal: normal.to_array(), offset });
        planes.extend(new);
    }
    planes
}

fn corrections_of(
    snapshot: &PosedModel,
    pairs: &MirrorPairs,
    plane: &MirrorPlane,
    ignore: &[String],
) -> PlaneAndPairCorrections {
    let list = |kind| {
        let pairs = pairs.left_right_pairs(kind, snapshot, plane).into_iter();
        pairs.map(|pair| pair.map(|index| snapshot.object_label(kind, index))).collect::<Vec<_>>()
    };
    let lists = ModelObjectKind::ALL.into_iter().map(|kind| (kind, list(kind))).collect();
    PlaneAndPairCorrections { plane: Some(*plane), pairs: lists, ignore: ignore.to_vec() }
}

impl MirrorDifference {
    /// Returns one line that names both objects, the property and the amount.
    fn line(&self) -> String {
        let names = self.objects_text();
        if self.property == "counterpart" {
            return names;
        }
        let [expected, found] = [&self.expected, &self.found].map(|side| Self::numbers_text(side));
        let (property, amount) = (&self.property, self.amount_text());
        if self.found.is_empty() {
            return format!("{names}: {property} {amount}");
        }
        format!("{names}: {property} {amount}: mirror image {expected}, found {found}")
    }

    /// Returns the kind and the names of both objects.
    pub(crate) fn objects_text(&self) -> String {
        let Self { kind, left, right, .. } = self;
        if self.property == "counterpart" {
            format!("{kind} {left} has no counterpart on {right}")
        } else if left == right {
            format!("{kind} {left} and its mirror image")
        } else {
            format!("{kind} {left} | {right}")
        }
    }

    /// Returns the amount in its unit, for instance `differs by 2.000 %`.
    pub(crate) fn amount_text(&self) -> String {
        let amount = self.amount;
        match self.measure {
            DifferenceMeasure::Share | DifferenceMeasure::Scale => {
                format!("differs by {:.3} %", 100.0 * amount)
            }
            DifferenceMeasure::Metres => format!("differs by {:.2} mm", 1000.0 * amount),
            DifferenceMeasure::Radians => format!("differs by {amount:.4} rad"),
            DifferenceMeasure::Exact => "differs".to_owned(),
        }
    }

    /// Returns the effect on the motion; `-` if it was not simulated.
    pub(crate) fn effect_text(&self) -> String {
        self.effect.map_or("-".to_owned(), |effect| format!("{effect:.1e}"))
    }

    /// Returns numbers with at most six decimals.
    pub(crate) fn numbers_text(values: &[f64]) -> String {
        let texts: Vec<String> = values.iter().map(|value| format!("{value:.6}")).collect();
        let short = texts.iter().map(|text| text.trim_end_matches('0').trim_end_matches('.'));
        short.collect::<Vec<_>>().join(" ")
    }
}

impl ModelSymmetryReport {
    /// Returns the report as text: the plane, and a line for each difference.
    pub fn text(&self) -> String {
        let mut lines = vec![self.plane_text()];
        lines.push(match self.differences.len() {
            0 => "no differences".to_owned(),
            1 => "1 difference, by effect after 1 s:".to_owned(),
            count => format!("{count} differences, by effect after 1 s:"),
        });
        let twins = self.twin_divergence;
        lines.extend(twins.map(|twin| format!("{twin:>9.1e}  two copies of the left side")));
        let differences = self.differences.iter();
        lines.extend(
            differences.map(|found| format!("{:>9}  {}", found.effect_text(), found.line())),
        );
        lines.extend(self.missing_text());
        lines.join("\n") + "\n"
    }

    /// Returns the mirror plane and the number of pairs.
    pub(crate) fn plane_text(&self) -> String {
        let pairs: usize = self.corrections.pairs.values().map(Vec::len).sum();
        let MirrorPlane { normal, offset } = self.corrections.plane.unwrap_or_default();
        // no negative zeros
        let [x, y, z] = normal.map(|part| part + 0.0);
        let offset = offset + 0.0;
        format!("plane: normal {x:.4} {y:.4} {z:.4}, {offset:.4} m from the origin; {pairs} pairs")
    }

    /// Returns the reason for which there are no maps or no effects, if there are none.
    pub(crate) fn missing_text(&self) -> Option<String> {
        let unmapped = self.unmapped.as_ref();
        let unmapped = unmapped.map(|reason| format!("no maps and effects: {reason}"));
        unmapped.or_else(|| Some(format!("no effects: {}", self.unsimulated.as_ref()?)))
    }
}
