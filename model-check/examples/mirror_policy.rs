//! From a robot's model to an equivariant network, without signs written by hand: `cargo run
//! --release -p covers-model-check --example mirror_policy [MODEL.xml]`.
//!
//! The network maps positions and velocities of all joints to controls. It takes the mirrored
//! action in the mirrored state, and the program prints by how much it misses that.

use std::error::Error;
use std::path::PathBuf;

use equivariant::{Layer, LayerSignature, Linear, Relu, Sequential, Shape};
use model_check::{ModelSymmetrySettings, check_model_symmetry, read_model};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

/// Number of regular fields of the hidden layer, each of two channels.
const FIELDS: usize = 32;

fn main() -> Result<(), Box<dyn Error>> {
    let quadruped = || concat!(env!("CARGO_MANIFEST_DIR"), "/assets/models/quadruped.xml").into();
    let path: PathBuf = std::env::args_os().nth(1).map_or_else(quadruped, Into::into);
    let found = check_model_symmetry(&read_model(&path)?, &ModelSymmetrySettings::default())?;
    print!("{}", found.text());
    let maps = found.maps.ok_or("a model without maps has no equivariant network")?;
    let (group, observation) = (maps.group, maps.qpos.concatenated_with(&maps.qvel));
    let hidden = group.regular_type(FIELDS);
    let [inputs, outputs] = [&observation, &maps.ctrl].map(|map| map.field_type(group));
    println!("observation `{inputs}`, action `{outputs}`");
    let layers: Vec<Box<dyn Layer<f64>>> = vec![
        Box::new(Linear::new(inputs, hidden)?),
        Box::new(Relu::new(Shape::vector(hidden))?),
        Box::new(Linear::new(hidden, outputs)?),
    ];
    let network = Sequential::new(layers)?;
    let mut rng = ChaCha8Rng::seed_from_u64(0);
    let mut params = vec![0.0; network.num_params()];
    network.init(&mut rng, &mut params);
    let mut scratch = network.allocate_scratch(1);
    let mut act = |vector: &[f64]| {
        let mut channels = vec![0.0; outputs.dim()];
        let input = observation.vector_to_irreps(group, vector);
        network.forward(&params, &input, &mut channels, &mut scratch);
        maps.ctrl.from_irreps(group, &channels)
    };
    let state: Vec<f64> = (0..inputs.dim()).map(|_| rng.random_range(-1.0..1.0)).collect();
    let action = act(&state);
    let mirrored = act(&observation.apply(&state));
    let misses = maps
        .ctrl
        .apply(&action)
        .iter()
        .zip(&mirrored)
        .map(|(a, b)| (a - b).abs())
        .fold(0.0, f64::max);
    let largest = action.iter().map(|value| value.abs()).fold(0.0, f64::max);
    println!("actions up to {largest:.3}; the mirrored state's differ by at most {misses:.1e}");
    if misses > 1e-12 * largest || largest == 0.0 {
        return Err("the network is not equivariant".into());
    }
    Ok(())
}
