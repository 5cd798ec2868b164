//! Benchmark of one step of perception, from an image of 640 x 480 to a policy's input.

use std::hint::black_box;

use criterion::{Criterion, Throughput, criterion_group, criterion_main};
use glam::DVec3;
use inpainting::{
    ArmLink, CameraCalibration, ColorCorrection, Extrinsics, GripperMark, Intrinsics,
    LensDistortion, Perception, PerceptionSettings, PinholeCamera,
};

const SIZE: usize = 48;
/// Number of capsules of a Kinova Gen3 and its gripper.
const LINKS: usize = 11;

fn perception() -> Perception {
    let settings = PerceptionSettings {
        calibration: CameraCalibration {
            intrinsics: Intrinsics::REALSENSE_D435,
            distortion: LensDistortion::NONE,
            extrinsics: Extrinsics::overhead(1.5),
        },
        policy_camera: PinholeCamera::overhead(SIZE, 1.5, 0.44),
        oversampling: 3,
        arm_links: (0..LINKS)
            .map(|link| ArmLink { end_joints: [link, link + 1], radius: 0.05 })
            .collect(),
        mask_margin_m: 0.015,
        colour_correction: ColorCorrection::GreyWorld,
        gripper_mark: GripperMark::disc(0.03, [0, 0, 255], 1.5),
    };
    Perception::new(settings, &[100; 3 * SIZE * SIZE]).unwrap_or_else(|error| panic!("{error}"))
}

/// Returns the joints of an arm that reaches from behind the table over its middle, its elbow up.
fn joints(sway: f64) -> Vec<DVec3> {
    let share = |joint| joint as f64 / LINKS as f64;
    let joint = |joint| {
        let along = share(joint);
        let height = 0.1 + 2.4 * along * (1.0 - along);
        DVec3::new(sway * along, -0.44 + 0.5 * along, height)
    };
    (0..=LINKS).map(joint).collect()
}

fn look(criterion: &mut Criterion) {
    let mut perception = perception();
    let frames = [100_u8, 97].map(|level| {
        (0..3 * 640 * 480_u32).map(|i| level + (i * 7 % 5) as u8).collect::<Vec<u8>>()
    });
    let arms = [joints(0.1), joints(-0.2)];
    let mut out = vec![0; 3 * SIZE * SIZE];
    let mut group = criterion.benchmark_group("perception");
    group.throughput(Throughput::Elements(1));
    let mut turn = 0;
    group.bench_function("look_640x480_to_48", |bencher| {
        bencher.iter(|| {
            turn = 1 - turn;
            let arm = &arms[turn];
            let looked = perception.observe(black_box(&frames[turn]), arm, arm[LINKS], &mut out);
            assert!(looked.is_ok() && perception.arm_mask().iter().any(|hidden| *hidden));
        });
    });
    group.finish();
}

criterion_group!(benches, look);
criterion_main!(benches);
