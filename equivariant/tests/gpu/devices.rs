//! Adapters, limits and lost devices.

use equivariant::gpu::{GpuDevice, GpuError, GpuLayer, available_gpu_adapters};
use equivariant::{BackwardArgs, Group, Layer, LayerSignature, Relu, Scalar, Shape};

fn relu() -> Relu {
    Relu::new(Shape::image(16, 16, Group::D2.regular_type(8))).unwrap()
}

#[test]
fn adapters_are_listed_with_their_limits() {
    let adapters = available_gpu_adapters();
    assert!(!adapters.is_empty(), "no Vulkan driver is installed");
    for adapter in &adapters {
        assert_eq!(adapter.backend, "vulkan");
        assert!(adapter.max_binding_bytes >= 1 << 27 && adapter.max_workgroup_threads >= 64);
        let line = adapter.to_string();
        assert!(line.contains(&adapter.name) && line.contains("MiB a binding"), "{line}");
    }
    let device = GpuDevice::open(None).unwrap();
    assert_eq!(device.adapter(), &adapters[0]);
}

#[test]
fn an_adapter_that_is_not_there_is_refused_with_those_that_are() {
    let error = GpuDevice::open(Some("abacus")).unwrap_err();
    let message = error.to_string();
    assert!(message.contains("got no adapter named `abacus`"), "{message}");
    assert!(message.contains(&available_gpu_adapters()[0].name), "{message}");
}

#[test]
fn a_batch_that_the_adapter_cannot_hold_is_refused() {
    let device = GpuDevice::open(None).unwrap();
    let samples = device.adapter().max_binding_bytes as usize / (4 * relu().in_shape().len()) + 1;
    let error = GpuLayer::new(&device, &relu(), samples).unwrap_err();
    let bytes = (samples * 4 * relu().in_shape().len()) as u64;
    match error {
        GpuError::BufferTooLarge { needed, limit, .. } => {
            assert_eq!((needed, limit), (bytes, device.adapter().max_binding_bytes));
        }
        other => unreachable!("{other}"),
    }
    GpuLayer::new(&device, &relu(), 1).unwrap();
}

#[test]
fn a_lost_device_is_an_error() {
    let device = GpuDevice::open(None).unwrap();
    let mut network = GpuLayer::new(&device, &relu(), 1).unwrap();
    let x = vec![1.0; relu().in_shape().len()];
    network.forward(&x).unwrap();
    device.close();
    let lost = |error| matches!(error, GpuError::DeviceLost { .. });
    assert!(lost(network.forward(&x).unwrap_err()));
    assert!(lost(network.backward(&x).unwrap_err()));
    assert!(lost(GpuLayer::new(&device, &relu(), 1).unwrap_err()));
    // other devices are not affected
    let other = GpuDevice::open(None).unwrap();
    GpuLayer::new(&other, &relu(), 1).unwrap().forward(&x).unwrap();
}

/// Layer of another crate.
struct Foreign;

impl std::fmt::Display for Foreign {
    fn fmt(&self, f: &mut std::fmt::Formatter<'_>) -> std::fmt::Result {
        f.write_str("Foreign")
    }
}

impl LayerSignature for Foreign {
    fn in_shape(&self) -> Shape {
        Shape::vector(Group::D2.trivial_type(1))
    }

    fn out_shape(&self) -> Shape {
        self.in_shape()
    }
}

impl<T: Scalar> Layer<T> for Foreign {
    fn run_forward(&self, _params: &[T], x: &[T], y: &mut [T], _scratch: &mut [T]) {
        y.copy_from_slice(x);
    }

    fn run_backward(&self, args: BackwardArgs<T>) {
        if let Some(dx) = args.dx {
            dx.copy_from_slice(args.dy);
        }
    }
}

#[test]
fn a_layer_of_another_crate_is_refused_by_name() {
    let device = GpuDevice::open(None).unwrap();
    let error = GpuLayer::new(&device, &Foreign, 1).unwrap_err();
    assert_eq!(error, GpuError::UnsupportedLayer { layer: "Foreign".to_owned() });
}

#[test]
#[should_panic(
    expected = "got x of 4096 values, expected a multiple of 8192 above 0 and at most 2"
)]
fn half_a_sample_is_refused() {
    let device = GpuDevice::open(None).unwrap();
    let mut network = GpuLayer::new(&device, &relu(), 2).unwrap();
    let _ = network.forward(&vec![0.0; relu().in_shape().len() / 2]);
}
