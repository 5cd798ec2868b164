//! Models with seeded faults, and models without: the table of what is found.

use std::time::Instant;

use crate::robots::{self, FAULTS, Robot};
use model_check::{
    MirrorDifference, ModelSymmetryReport, ModelSymmetrySettings, check_model_symmetry,
};
use mujoco::Model;

/// Number of models with faults, and of models without.
const MODELS: u64 = 40;

fn checked(robot: &Robot, simulates: bool) -> ModelSymmetryReport {
    let model = Model::from_xml(&robot.mjcf).unwrap();
    check_model_symmetry(
        &model,
        &ModelSymmetrySettings { simulates, ..ModelSymmetrySettings::default() },
    )
    .unwrap()
}

/// Returns `true` if a difference names the property and the faulty object.
fn names(difference: &MirrorDifference, (property, object): &(&str, String)) -> bool {
    let sides = [&difference.left, &difference.right];
    difference.property == *property && sides.iter().any(|side| side.contains(object))
}

#[test]
fn seeded_faults_are_found_and_symmetric_models_pass() {
    let mut rows = Vec::new();
    for (at, property) in FAULTS.into_iter().enumerate() {
        let [mut found, mut alone] = [0; 2];
        for round in 0..MODELS / FAULTS.len() as u64 {
            let robot = robots::random(round * FAULTS.len() as u64 + at as u64, Some(property));
            let faulty = robot.faulty.clone().unwrap();
            let differences = checked(&robot, false).differences;
            let is_found = differences.iter().any(|difference| names(difference, &faulty));
            found += usize::from(is_found);
            alone += usize::from(is_found && differences.len() == 1);
            if !is_found {
                println!("{faulty:?}: {differences:#?}");
            }
        }
        rows.push((property, found, alone));
    }
    println!("fault            found  and nothing else  of");
    for (property, found, alone) in &rows {
        println!("{property:<16} {found:>5} {alone:>17} {:>3}", MODELS / FAULTS.len() as u64);
    }
    let total: usize = rows.iter().map(|(_, found, _)| found).sum();
    let flagged = (0..MODELS).filter(|seed| {
        let differences = checked(&robots::random(1000 + seed, None), false).differences;
        if !differences.is_empty() {
            println!("{seed}: {differences:#?}");
        }
        !differences.is_empty()
    });
    let flagged = flagged.count();
    println!("{total} of {MODELS} faults found; {flagged} of {MODELS} symmetric models flagged");
    assert!(total >= 38 && flagged == 0);
}

#[test]
fn only_faults_that_move_something_have_an_effect() {
    for (seed, property) in FAULTS.into_iter().enumerate() {
        let robot = robots::random(seed as u64, Some(property));
        let start = Instant::now();
        let found = checked(&robot, true);
        println!("{} in {:.1?}", found.text(), start.elapsed());
        let twins = found.twin_divergence.unwrap();
        assert!(twins < 1e-6, "{property}: {twins}");
        let effect = found.differences[0].effect;
        match property {
            "mass" | "centre of mass" | "sign" | "damping" | "gain" => {
                assert!(effect.unwrap() > 1e3 * twins, "{property}: {effect:?}, {twins}");
            }
            // keyframes move nothing, the others only what touches or turns about several axes
            _ => assert_eq!(effect.is_none(), property == "position"),
        }
    }
}
