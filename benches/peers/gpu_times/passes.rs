//! Times of passes through networks on a device.

use std::error::Error;

use equivariant::gpu::{
    BatchUniforms, BufferSlot, CompiledPlan, ComputePlan, GpuDevice, PassesToRun,
};
use equivariant::{Layer, LayerSignature};
use rand::SeedableRng;
use rand_chacha::ChaCha8Rng;

use crate::milliseconds;
use crate::networks::build_d2_conv_network;

/// Program of a network, and the buffer that it writes last.
struct Bench {
    program: CompiledPlan,
    last: BufferSlot,
    batch: BatchUniforms,
}

impl Bench {
    fn new(
        device: &GpuDevice,
        name: &str,
        passes: PassesToRun,
        samples: usize,
    ) -> Result<Bench, Box<dyn Error>> {
        let (size, fields, pooled): (usize, &[usize], bool) = match name {
            "reference" => (64, &[8, 16, 32, 32], false),
            "narrow" => (64, &[4, 8, 16, 16], false),
            "pooled" => (128, &[8, 16, 32, 32, 32], true),
            "wide" => (64, &[16, 32, 64, 64], false),
            _ => return Err(format!("got the network `{name}`").into()),
        };
        let network = build_d2_conv_network(size, fields, pooled)?;
        let mut plan = ComputePlan::new();
        let x = plan.add_input(network.in_shape());
        let y = plan.add_layer(&network, x)?;
        let trains = passes == PassesToRun::All;
        let plan = if trains { plan } else { plan.forward_only() };
        let program = CompiledPlan::new(device, &plan, samples)?;
        let mut params = vec![0.0; network.num_params()];
        network.init(&mut ChaCha8Rng::seed_from_u64(0), &mut params);
        program.write_floats(plan.params_buffer(), &plan.params_to_device_order(&params));
        let picture = (0..samples * x.shape.len()).map(|i| (i % 251) as f32 / 251.0);
        program.write_floats(x.values, &picture.collect::<Vec<f32>>());
        let gradient = y.gradient.filter(|_| trains);
        if let Some(gradient) = gradient {
            program.write_floats(gradient, &vec![1.0; samples * y.shape.len()]);
        }
        let last = if trains { plan.params_gradient_buffer() } else { y.values };
        let batch = BatchUniforms { samples, ..BatchUniforms::default() };
        Ok(Bench { program, last, batch })
    }
}

/// Returns the mean milliseconds of passes through a network on a GPU: forward and backward for the
/// task `training`, forward alone for `decisions`.
pub fn time_network_pass_ms(
    device: &GpuDevice,
    network: &str,
    task: &str,
    batch: usize,
) -> Result<f64, Box<dyn Error>> {
    let passes = match task {
        "training" => PassesToRun::All,
        "decisions" => PassesToRun::Forward,
        _ => return Err(format!("got the task `{task}`").into()),
    };
    let bench = Bench::new(device, network, passes, batch)?;
    milliseconds(|runs| {
        for _ in 0..runs {
            bench.program.submit_passes(passes, bench.batch);
        }
        bench.program.read_floats([(bench.last, 1)])?;
        Ok(())
    })
}

/// Returns the name and the microseconds of each GPU kernel of a training pass, after passes that
/// warm up the device.
pub fn kernel_times(
    device: &GpuDevice,
    network: &str,
    batch: usize,
) -> Result<String, Box<dyn Error>> {
    let bench = Bench::new(device, network, PassesToRun::All, batch)?;
    milliseconds(|runs| {
        for _ in 0..runs {
            bench.program.submit_passes(PassesToRun::All, bench.batch);
        }
        bench.program.read_floats([(bench.last, 1)])?;
        Ok(())
    })?;
    let times = bench.program.time_kernels(PassesToRun::All, bench.batch)?;
    let times = times.iter();
    let words =
        times.map(|(name, seconds)| format!("{} {:.2}", name.replace(' ', "_"), 1e6 * seconds));
    Ok(words.collect::<Vec<_>>().join(" "))
}
