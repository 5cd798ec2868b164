//! Networks that branch and join, and kernels of other crates.

use equivariant::gpu::{
    BatchUniforms, CompiledPlan, ComputePlan, KernelDispatch, PassesToRun, WorkgroupCount,
};
use equivariant::{Group, LayerSignature, Linear, Shape};

use crate::common::{concat, normal};
use crate::device;

const SAMPLES: usize = 3;

fn batch() -> BatchUniforms {
    BatchUniforms { samples: SAMPLES, ..BatchUniforms::default() }
}

#[test]
fn sums_of_maps_and_their_gradients_are_those_of_the_cpu() {
    for group in Group::ALL {
        let concat = concat(group);
        let [a, b] = concat.in_shapes();
        let mut plan = ComputePlan::new();
        let inputs = [a, b].map(|shape| plan.add_tensor(shape));
        let y = plan.add_concat(&concat, inputs);
        let program = CompiledPlan::new(device(), &plan, 4).unwrap();
        let [x_a, x_b] = [(a, 1), (b, 2)].map(|(shape, seed)| normal(SAMPLES * shape.len(), seed));
        let dy: Vec<f32> = normal(SAMPLES * y.shape.len(), 3);
        program.write_floats(inputs[0].values, &x_a);
        program.write_floats(inputs[1].values, &x_b);
        program.write_floats(y.gradient.unwrap(), &dy);
        program.submit_passes(PassesToRun::All, batch());
        let mut expected = vec![0.0; dy.len()];
        concat.forward(&x_a, &x_b, &mut expected);
        let [sum] = program.read_floats([(y.values, dy.len())]).unwrap();
        assert_eq!(sum, expected, "{group}");
        let [mut dx_a, mut dx_b] = [vec![0.0; x_a.len()], vec![0.0; x_b.len()]];
        concat.backward(&dy, &mut dx_a, &mut dx_b);
        let gradients = inputs.map(|x| (x.gradient.unwrap(), SAMPLES * x.shape.len()));
        assert_eq!(program.read_floats(gradients).unwrap(), [dx_a, dx_b], "{group}");
    }
}

#[test]
fn the_gradient_of_a_map_with_two_readers_is_the_sum_of_theirs() {
    let types = [Group::D2.regular_type(2), Group::D2.regular_type(1)];
    let layer = Linear::new(types[0], types[1]).unwrap();
    let mut plan = ComputePlan::new();
    let x = plan.add_tensor(Shape::vector(types[0]));
    let [first, second] = plan.add_fork(x);
    let ends = [first, second].map(|branch| plan.add_layer(&layer, branch).unwrap());
    let program = CompiledPlan::new(device(), &plan, SAMPLES).unwrap();
    assert_eq!(plan.num_params(), 2 * layer.num_params());
    // one layer passes the gradient on, the other its triple
    let params: Vec<f32> = normal(layer.num_params(), 1);
    let threefold = params.iter().map(|p| 3.0 * p);
    let both: Vec<f32> = params.iter().copied().chain(threefold).collect();
    program.write_floats(plan.params_buffer(), &plan.params_to_device_order(&both));
    let dy: Vec<f32> = normal(SAMPLES * 4, 2);
    for y in ends {
        program.write_floats(y.gradient.unwrap(), &dy);
    }
    program.submit_passes(PassesToRun::All, batch());
    let slots = [x, first].map(|x| (x.gradient.unwrap(), SAMPLES * 8));
    let [sum, branch_gradient] = program.read_floats(slots).unwrap();
    assert!(branch_gradient.iter().any(|&d| d.abs() > 0.1));
    for (whole, part) in sum.iter().zip(branch_gradient) {
        assert!((whole - 4.0 * part).abs() < 1e-5, "{whole} {part}");
    }
}

#[test]
fn a_kernel_of_somebody_else_sees_the_batch() {
    let mut plan = ComputePlan::new();
    let y = plan.add_input(Shape::vector(Group::C1.trivial_type(1)));
    let kernel = KernelDispatch::new("mine", 1, WorkgroupCount::for_threads_per_sample(1))
        .add_output_buffer("y", "f32", y.values);
    let kernel = kernel.add_wgsl(
        "@compute @workgroup_size(THREADS)
         fn main(place: Place) {
             let i = index_of(place);
             if i < batch.samples { y[i] = f32(batch.start + i) + batch.numbers.w; }
         }",
    );
    plan.add_final_kernel(kernel);
    let program = CompiledPlan::new(device(), &plan, 100).unwrap();
    for (samples, start) in [(100, 7), (70, 20)] {
        let extra_numbers = [0.0, 0.0, 0.0, 0.5];
        let batch = BatchUniforms { samples, start, extra_numbers, ..BatchUniforms::default() };
        program.submit_passes(PassesToRun::Backward, batch);
    }
    let [y] = program.read_floats([(y.values, 100)]).unwrap();
    assert_eq!([y[0], y[69], y[70], y[99]], [20.5, 89.5, 77.5, 106.5]);
}

#[test]
fn bytes_are_words_whose_last_one_is_filled_up() {
    let numbers = [1.5_f32, -2.25];
    let bytes = numbers.map(f32::to_le_bytes).concat();
    let mut plan = ComputePlan::new();
    let slot = plan.add_buffer(2, 0);
    let program = CompiledPlan::new(device(), &plan, 1).unwrap();
    for len in 0..=bytes.len() {
        program.write_floats(slot, &[7.0, 7.0]);
        program.write_bytes(slot, &bytes[..len]);
        let [read] = program.read_floats([(slot, 2)]).unwrap();
        let mut expected = [7.0_f32; 2].map(f32::to_le_bytes).concat();
        expected[..len.next_multiple_of(4)].fill(0);
        expected[..len].copy_from_slice(&bytes[..len]);
        let read: Vec<u8> = read.into_iter().flat_map(f32::to_le_bytes).collect();
        assert_eq!(read, expected, "{len} bytes");
    }
}
