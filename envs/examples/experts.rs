//! Measures the success rate of the scripted experts: `experts EMBODIMENT N [GROUP ...]` runs N
//! episodes of each variant of the groups (by default all), with the placements of the seeds 0 to
//! N - 1.

use std::error::Error;
use std::sync::Arc;

use envs::conformance::measure_expert;
use envs::{Camera, Control, Embodiment, Scene, TaskGroup, TaskRegistry};
use symmetry::D2;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [name, episodes, names @ ..] = &arguments[..] else {
        return Err("usage: experts EMBODIMENT N [GROUP ...]".into());
    };
    let (embodiment, episodes): (Embodiment, u64) = (name.parse()?, episodes.parse()?);
    let all = TaskRegistry::all();
    let chosen: Result<Vec<TaskGroup>, _> = names.iter().map(|group| all.get(group)).collect();
    let groups = if names.is_empty() { all.groups().to_vec() } else { chosen? };
    for group in groups {
        let scene = Arc::new(Scene::new(group, embodiment, Camera::default())?);
        for element in D2::ALL {
            let row = measure_expert(&scene, element, Control::default(), episodes)?;
            println!(
                "{} {} of {episodes}, return {:.1}",
                row.variant, row.successes, row.mean_return
            );
        }
    }
    Ok(())
}
