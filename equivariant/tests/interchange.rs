//! Files of networks: parameters survive a round trip, and other files are rejected.

use std::path::PathBuf;

use equivariant::{Group, Layer, Linear, Sequential, load_safetensors, save_safetensors};
use safetensors::SafeTensors;

use crate::common::{boxed, forward, layers, network, normal, params};

/// File of this test run, removed when dropped.
struct File(PathBuf);

impl File {
    fn new(name: &str) -> File {
        let name = format!("covers-equivariant-{}-{name}.safetensors", std::process::id());
        File(std::env::temp_dir().join(name))
    }
}

impl Drop for File {
    fn drop(&mut self) {
        // a test that fails before it writes leaves nothing to remove
        let _ = std::fs::remove_file(&self.0);
    }
}

#[test]
fn every_layer_survives_a_round_trip() {
    let file = File::new("round-trip");
    for (name, layer) in layers::<f32>() {
        let params = params(layer.as_ref(), 1);
        save_safetensors(&file.0, layer.as_ref(), &params).unwrap();
        assert_eq!(load_safetensors(&file.0, layer.as_ref()).unwrap(), params, "{name}");
    }
}

#[test]
fn equal_networks_give_equal_bytes() {
    let net = network::<f32>(Group::D2);
    let bytes = |name| {
        let file = File::new(name);
        save_safetensors(&file.0, &net, &params(&net, 1)).unwrap();
        std::fs::read(&file.0).unwrap()
    };
    assert_eq!(bytes("once"), bytes("twice"));
}

#[test]
fn dense_kernels_lie_beside_the_parameters() {
    let file = File::new("dense");
    let net = network::<f32>(Group::C2);
    save_safetensors(&file.0, &net, &params(&net, 1)).unwrap();
    let bytes = std::fs::read(&file.0).unwrap();
    let tensors = SafeTensors::deserialize(&bytes).unwrap();
    let shape = |name| tensors.tensor(name).unwrap().shape().to_vec();
    assert_eq!(shape("0.kernel"), [4, 3, 4, 4]);
    assert_eq!(shape("4.kernel"), [16, 8, 2, 2]);
    assert_eq!(shape("6.bias"), [4]);
    assert!(tensors.tensor("1.params").is_err(), "a ReLU has no parameters");
}

fn message(file: &File, layer: &dyn Layer<f32>) -> String {
    load_safetensors(&file.0, layer).unwrap_err().to_string()
}

#[test]
fn other_networks_are_refused_with_the_layer() {
    let file = File::new("other");
    let linear =
        |n| boxed::<f32, _>(Linear::new(Group::D2.regular_type(2), Group::D2.regular_type(n)));
    let chain = Sequential::new(vec![linear(2), linear(3)]).unwrap();
    save_safetensors(&file.0, &chain, &params(&chain, 1)).unwrap();
    let other = Sequential::new(vec![linear(2), linear(1)]).unwrap();
    let refused = message(&file, &other);
    let expected = "layer 1 is `Linear(2 reg -> 3 reg | 27 parameters)` in the file and \
                    `Linear(2 reg -> 1 reg | 9 parameters)` in the network";
    assert!(refused.contains(expected), "{refused}");
    let shorter = message(&file, linear(2).as_ref());
    assert!(shorter.ends_with("in the file and `nothing` in the network"), "{shorter}");
}

#[test]
fn files_that_are_not_ours_are_refused_by_name() {
    let net = network::<f32>(Group::D2);
    let missing = message(&File::new("missing"), &net);
    assert!(missing.contains("-missing.safetensors: "), "{missing}");
    let file = File::new("foreign");
    std::fs::write(&file.0, b"not tensors").unwrap();
    assert!(message(&file, &net).contains("not a safetensors file"));
    let none: [(&str, safetensors::tensor::TensorView); 0] = [];
    std::fs::write(&file.0, safetensors::serialize(none, None).unwrap()).unwrap();
    assert!(message(&file, &net).contains("got no metadata `covers-equivariant 1`"));
}

#[test]
fn layers_that_print_the_same_compute_the_same() {
    let layers = layers::<f32>();
    let run = |layer: &dyn Layer<f32>| {
        let x = normal(2 * layer.in_shape().len(), 2);
        forward(layer, &params(layer, 1), &x)
    };
    for (i, (a, first)) in layers.iter().enumerate() {
        for (b, second) in &layers[..i] {
            if first.to_string() == second.to_string() {
                let (first, second) = (run(first.as_ref()), run(second.as_ref()));
                assert_eq!(first, second, "{a} and {b}");
            }
        }
    }
}
