//! Sets the configuration `mujoco3` where `mujoco-sys` found 3.2 or later, and `actuator_counts`
//! where that has a count of its own for actuators.

use std::env;

fn main() {
    println!("cargo::rerun-if-changed=build.rs");
    for (name, variable, value) in [
        ("mujoco3", "DEP_MUJOCO_MAJOR", "3"),
        ("actuator_counts", "DEP_MUJOCO_ACTUATOR_COUNTS", "true"),
    ] {
        println!("cargo::rustc-check-cfg=cfg({name})");
        if env::var(variable).is_ok_and(|found| found == value) {
            println!("cargo::rustc-cfg={name}");
        }
    }
}
