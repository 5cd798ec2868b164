//! Where policies learn: what is refused, and, with the feature `wgpu`, runs on a GPU or on
//! software that stands in for one.

use covers::presets::{Budget, Method};
use covers::{DeviceChoice, Experiment};

fn on(method: Method, device: DeviceChoice) -> Result<Experiment, String> {
    let experiment = Budget::Smoke.preset_experiment(method).with_device(device);
    experiment.map_err(|error| error.to_string())
}

#[test]
fn learners_with_replays_or_a_symmetry_loss_learn_on_the_cpu() {
    for (method, reason) in
        [(Method::Clear, "a learner with replays"), (Method::CnnDrac, "a symmetry loss")]
    {
        let message = on(method, DeviceChoice::Gpu).unwrap_err();
        assert!(message.contains("setting `device` is gpu"), "{message}");
        assert!(message.contains(reason), "{message}");
        for choice in [DeviceChoice::Cpu, DeviceChoice::Auto] {
            let experiment = on(method, choice).unwrap();
            assert_eq!(experiment.learner.gpu_name(), None);
        }
    }
}

#[cfg(not(feature = "wgpu"))]
#[test]
fn a_program_without_gpus_says_how_to_build_one_that_has_them() {
    let message = on(Method::Covers, DeviceChoice::Gpu).unwrap_err();
    assert!(message.contains("`--features wgpu`"), "{message}");
    let experiment = on(Method::Covers, DeviceChoice::Auto).unwrap();
    assert_eq!(experiment, on(Method::Covers, DeviceChoice::Cpu).unwrap());
}

#[cfg(feature = "wgpu")]
mod gpu {
    use std::fs;

    use covers::{LearnerSettings, Provenance, Run, RunFolder};
    use envs::TaskRegistry;
    use rl::NetworkSettings;

    use super::*;
    use crate::common::scratch::Scratch;

    /// A small network and short updates: software takes the place of a GPU.
    fn small(device: DeviceChoice) -> Experiment {
        let mut experiment = on(Method::Covers, device).unwrap().with_threads(1);
        if let LearnerSettings::Covers(settings) = &mut experiment.learner {
            settings.network = NetworkSettings::with_strided_encoder(vec![2, 2], 4);
            settings.ppo.epochs = 2;
        }
        experiment
    }

    /// The first row of metrics of a run in this folder, which goes on for one turn.
    fn first_turn(experiment: Experiment, folder: &RunFolder) -> Vec<(String, String)> {
        let mut run = Run::start(experiment, folder.clone()).unwrap();
        run.advance().unwrap();
        run.save_checkpoint().unwrap();
        let text = fs::read_to_string(folder.path().join("metrics.csv")).unwrap();
        let mut lines = text.lines().map(|line| line.split(',').map(str::to_owned));
        lines.next().unwrap().zip(lines.next().unwrap()).collect()
    }

    #[test]
    fn a_run_learns_the_same_on_a_gpu_and_goes_on_on_the_cpu() {
        let scratch = Scratch::new("device");
        let [here, there] = [DeviceChoice::Cpu, DeviceChoice::Gpu].map(|device| {
            let folder = RunFolder::create(&scratch.0, "run").unwrap();
            (first_turn(small(device), &folder), folder)
        });
        let mut losses = 0;
        for ((name, expected), (_, got)) in here.0.iter().zip(&there.0) {
            let numbers = [expected, got].map(|text| text.parse::<f64>());
            if let [Ok(wanted), Ok(found)] = numbers {
                let allowed = 1e-3 * wanted.abs().max(0.1);
                assert!((wanted - found).abs() <= allowed, "{name}: {wanted} {found}");
                losses += usize::from(name.contains("loss"));
            }
        }
        assert!(losses >= 2, "{:?}", here.0);
        // sums are rounded in another way there
        assert_ne!(here.0, there.0, "the GPU computed nothing");
        let folder = there.1.path();
        let mut run = Run::resume(folder, Some(1)).unwrap();
        run.advance().unwrap();
        run.save_checkpoint().unwrap();
        drop(run);
        let (again, tasks) = (RunFolder::from_path(folder), TaskRegistry::with_standard());
        let mut resumed = Run::resume_with_tasks(again, Some(1), DeviceChoice::Gpu, tasks).unwrap();
        resumed.advance().unwrap();
        let gpus = Provenance::read(folder).unwrap().into_iter().map(|line| line.gpu);
        let gpus: Vec<bool> = gpus.map(|gpu| gpu.is_some()).collect();
        assert_eq!(gpus, [true, false, true]);
    }
}
