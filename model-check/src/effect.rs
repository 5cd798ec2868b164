//! Effect of differences on the motion.

use std::f64::consts::TAU;
use std::sync::Arc;

use mujoco::{
    Data, IntegerArray as Int, Model, ModelError, NumberArray as Num, RowEdit, SimError, raw,
};
use rayon::iter::{IntoParallelRefIterator, ParallelIterator};

use crate::compare::MirrorDifference;
use crate::maps::SymmetryMaps;

/// Simulated time (seconds).
const SECONDS: f64 = 1.0;
/// Amplitude of the torques: that of the accelerations that they would cause alone (rad/s^2).
const ACCELERATION: f64 = 10.0;
/// Amplitude of the controls, in their units: radians for servos, newton metres for motors.
const CONTROL: f64 = 0.1;
/// Number of differences that are simulated, the largest ones: seconds for models of 50 bodies.
const MAX_SIMULATED: usize = 40;

/// Simulates the largest differences between the model's sides, each on its own, and sets their
/// effects on the motion; returns the effect of no difference at all, `None` if that run fails.
///
/// The model's right side is replaced by the mirror image of its left one, but for one difference.
///
/// # Errors
/// [`ModelError`] of an edit that removes a difference, see [`Model::edited`].
pub(crate) fn simulate(
    model: &Model,
    maps: &SymmetryMaps,
    differences: &mut [MirrorDifference],
) -> Result<Option<f64>, ModelError> {
    let edits: Vec<&[RowEdit]> =
        differences.iter().map(|difference| &difference.edits[..]).collect();
    model.edited(&edits.concat())?;
    let divergence_without = |kept: Option<usize>| {
        let applied = edits.iter().enumerate().filter(|(at, _)| Some(*at) != kept);
        let applied: Vec<RowEdit> = applied.flat_map(|(_, rows)| rows.to_vec()).collect();
        divergence(&Arc::new(model.edited(&applied).ok()?), maps).ok()
    };
    let mut order: Vec<usize> = (0..edits.len()).filter(|&at| !edits[at].is_empty()).collect();
    let size = |at: &usize| differences[*at].scaled_amount();
    order.sort_by(|a, b| size(b).total_cmp(&size(a)));
    order.truncate(MAX_SIMULATED);
    let effects: Vec<_> = order.par_iter().map(|&at| (at, divergence_without(Some(at)))).collect();
    let baseline = divergence_without(None);
    for (at, effect) in effects {
        differences[at].effect = effect;
    }
    Ok(baseline)
}

/// Returns the root mean square difference between the joint positions of a motion, mirrored, and
/// those of the motion under mirrored torques (radians and metres).
fn divergence(model: &Arc<Model>, maps: &SymmetryMaps) -> Result<f64, SimError> {
    let mirrored = |qpos: &[f64]| -> Vec<f64> {
        maps.qpos.apply(qpos).iter().zip(&maps.shift).map(|(entry, shift)| entry + shift).collect()
    };
    let [mut motion, mut other] = [0; 2].map(|_| Data::new(Arc::clone(model)));
    let start = mirrored(motion.qpos());
    other.qpos_mut().copy_from_slice(&start);
    let weights = model.numbers(Num::DofInvweight0);
    let joints: Vec<[usize; 3]> = (0..model.as_raw().njnt as usize)
        .map(|joint| {
            [Int::JntType, Int::JntQposadr, Int::JntDofadr]
                .map(|array| model.integer(array, joint) as usize)
        })
        .collect();
    let mut amplitudes = vec![0.0; model.nv()];
    for [kind, _, dof] in &joints {
        // nothing pushes a free body but its limbs
        let dofs = [0, 3, 1, 1][*kind];
        for at in *dof..dof + dofs {
            amplitudes[at] = ACCELERATION / weights[at].max(1e-9);
        }
    }
    let reaches = vec![CONTROL; model.nu()];
    let steps = (SECONDS / model.timestep()).ceil() as usize;
    for _ in 0..steps {
        // frequencies of 1 to 2 Hz and phases that no two degrees of freedom share
        let wave = |(at, amplitude): (usize, &f64)| {
            let share = (at as f64 * 0.618_034).fract();
            amplitude * (TAU * ((1.0 + share) * motion.time() + 3.0 * share)).sin()
        };
        let forces: Vec<f64> = amplitudes.iter().enumerate().map(wave).collect();
        let controls: Vec<f64> = reaches.iter().enumerate().map(wave).collect();
        motion.set_all_ctrl(&controls)?;
        other.set_all_ctrl(&maps.ctrl.apply(&controls))?;
        motion.set_applied_forces(&forces);
        other.set_applied_forces(&maps.qvel.apply(&forces));
        motion.step(1)?;
        other.step(1)?;
    }
    let image = mirrored(motion.qpos());
    let scalars = joints.iter().filter(|[kind, ..]| {
        [raw::mjJNT_HINGE, raw::mjJNT_SLIDE].map(|scalar| scalar as usize).contains(kind)
    });
    let squares = scalars.map(|&[_, at, _]| (image[at] - other.qpos()[at]).powi(2));
    let squares: Vec<f64> = squares.collect();
    Ok((squares.iter().sum::<f64>() / squares.len().max(1) as f64).sqrt())
}
