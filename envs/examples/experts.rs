//! Measures the success rate of the scripted expert on each of the 16 variants: `experts EMBODIMENT
//! N` runs N episodes of each, with the placements of the seeds 0 to N - 1.

use std::error::Error;
use std::sync::Arc;

use envs::conformance::measure_expert;
use envs::{Camera, Control, Embodiment, Scene, TaskGroup};
use symmetry::D2;

fn main() -> Result<(), Box<dyn Error>> {
    let arguments: Vec<String> = std::env::args().skip(1).collect();
    let [name, episodes] = &arguments[..] else {
        return Err("usage: experts EMBODIMENT N".into());
    };
    let (embodiment, episodes): (Embodiment, u64) = (name.parse()?, episodes.parse()?);
    for group in TaskGroup::STANDARD {
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
