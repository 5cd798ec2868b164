//! Files of `covers export`, read back without the crates that wrote them.

use std::collections::HashMap;
use std::fs;
use std::path::{Path, PathBuf};

use covers::presets::Method;
use covers::{CoversError, Experiment, LearnerSettings};
use envs::{Camera, ControlSettings, Embodiment, ExtraViews};
use rl::{CriticSettings, EncoderSettings, NetworkSettings};
use safetensors::tensor::{Dtype, SafeTensors};
use symmetry::Group;

use crate::common::covers;
use crate::common::packed::small;
use crate::common::scratch::Scratch;

fn export(run: &Path, policy: &str, out: &Path) -> Result<String, CoversError> {
    let (run, to) = (run.display().to_string(), out.display().to_string());
    covers(&["export", &run, "--policy", policy, "--out", &to])
}

/// Names and shapes of the arrays of a safetensors file, in which no number is infinite or NaN.
fn arrays(path: &Path) -> HashMap<String, Vec<usize>> {
    let bytes = fs::read(path).unwrap();
    let file = SafeTensors::deserialize(&bytes).unwrap();
    let arrays = file.iter().map(|(name, view)| {
        let finite = |b: &[u8; 4]| f32::from_le_bytes(*b).is_finite();
        assert!(
            view.dtype() == Dtype::U8 || view.data().as_chunks().0.iter().all(finite),
            "{name}"
        );
        (name.to_owned(), view.shape().to_vec())
    });
    arrays.collect()
}

/// Narrow networks on small pictures.
fn narrow(method: Method, group: Group) -> Experiment {
    let mut experiment = small(method).with_symmetry_group(group);
    experiment.envs.camera.size = 16;
    let network = network(&mut experiment);
    *network = NetworkSettings {
        group,
        action_gain: 1.0,
        log_std: -0.25,
        ..NetworkSettings::with_strided_encoder(vec![1, 2], 3)
    };
    experiment
}

fn network(experiment: &mut Experiment) -> &mut NetworkSettings {
    match &mut experiment.learner {
        LearnerSettings::Covers(settings) => &mut settings.network,
        LearnerSettings::OffPolicy(settings) => &mut settings.network,
    }
}

/// Policies of every group, of both learners, and with every part that can be exported.
fn policies() -> Vec<Experiment> {
    let groups = Group::ALL.into_iter().map(|group| narrow(Method::Covers, group));
    let mut pooled = narrow(Method::Covers, Group::D2);
    network(&mut pooled).encoder = EncoderSettings::Pooled { fields: vec![1], inner: [2, 1] };
    network(&mut pooled).critic = CriticSettings::Pooled { width: 5 };
    let mut blind = narrow(Method::Covers, Group::C2);
    network(&mut blind).encoder = EncoderSettings::Blind;
    let others = [pooled, blind, narrow(Method::EquiSac, Group::D2)];
    groups.chain(others).collect()
}

/// `make python` names a folder in `COVERS_EXPORTED`, and runs what is written there by ONNX.
#[test]
fn policies_of_every_kind_are_written_with_golden_outputs() {
    for (number, experiment) in policies().into_iter().enumerate() {
        let scratch = Scratch::new("export");
        let kept = std::env::var_os("COVERS_EXPORTED").map(PathBuf::from);
        let folder = kept.unwrap_or(scratch.0.join("new")).join(number.to_string());
        export(&scratch.pack(&experiment), "0", &folder).unwrap();
        let golden = arrays(&folder.join("golden.safetensors"));
        // two observations of each of two groups
        assert!(golden.values().all(|shape| shape[0] == 4), "{golden:?}");
        assert_eq!(golden["action"], [4, 4]);
        let about = fs::read_to_string(folder.join("policy.json")).unwrap();
        let about: serde_json::Value = serde_json::from_str(&about).unwrap();
        let sees = network(&mut experiment.clone()).encoder != EncoderSettings::Blind;
        assert_eq!(about["inputs"].get("image").is_some(), sees, "{about}");
        assert_eq!(
            golden.contains_key("value"),
            matches!(experiment.learner, LearnerSettings::Covers(_))
        );
    }
}

#[test]
fn weights_have_the_names_that_pytorch_gives_them() {
    let scratch = Scratch::new("export-weights");
    let root = PathBuf::from(env!("CARGO_MANIFEST_DIR")).join("assets/pretrained");
    let folder = scratch.0.join("new");
    let said = export(&root, "1", &folder).unwrap();
    assert!(said.contains("policy.onnx"), "{said}");
    let arrays = arrays(&folder.join("policy.safetensors"));
    // weights and biases of image, vector and actor; critics of soft actor-critic are not exported
    assert_eq!(arrays.len(), 2 * (5 + 1 + 2));
    assert_eq!(arrays["actor.2.weight"], [8, 128], "means and standard deviations");
    assert_eq!(arrays["image.0.weight"], [16, 6, 4, 4]);
    let text = fs::read_to_string(folder.join("policy.json")).unwrap();
    let about: serde_json::Value = serde_json::from_str(&text).unwrap();
    assert_eq!(about["policy"], 1);
    assert_eq!(about["inputs"]["image"]["shape"][1], 48);
    assert_eq!(about["layers"]["image"][8]["kind"], "linear");
    assert_eq!(about["layers"]["image"][8]["size"], 3);
    assert_eq!(about["inputs"]["vector"]["components"][2]["offset"], 0.2f32);
}

/// Without which nobody could make what the policy shall see.
#[test]
fn a_description_says_what_the_pictures_show() {
    for (beside, channels, shown) in [
        (ExtraViews::First, 6, "picture; red, green, blue of the episode's first"),
        (ExtraViews::CloseUp, 6, "picture; red, green, blue of the close-up"),
        (
            ExtraViews::FirstAndCloseUp,
            9,
            "of the episode's first; red, green, blue of the close-up",
        ),
    ] {
        let mut experiment = narrow(Method::Covers, Group::D2);
        (experiment.envs.camera.oversampling, experiment.envs.camera.extra_views) = (2, beside);
        let scratch = Scratch::new("export-pictures");
        let folder = scratch.0.join("new");
        export(&scratch.pack(&experiment), "0", &folder).unwrap();
        let text = fs::read_to_string(folder.join("policy.json")).unwrap();
        let about: serde_json::Value = serde_json::from_str(&text).unwrap();
        let image = &about["inputs"]["image"];
        assert_eq!(image["shape"][3], channels);
        assert!(image["channels"].as_str().unwrap().ends_with(shown), "{text}");
        // the camera reads back as it was, so that a program can ask for the same images
        let camera: Camera = serde_json::from_value(image["camera"].clone()).unwrap();
        assert_eq!(camera, experiment.envs.camera);
    }
}

#[test]
fn a_description_names_the_environments_of_the_training() {
    let mut experiment = narrow(Method::Covers, Group::D2);
    experiment.envs.embodiment = Embodiment::FLOATING_HAND;
    experiment.envs.control = ControlSettings { action_repeat: 5, displacement: 0.03, horizon: 45 };
    let scratch = Scratch::new("export-environment");
    let folder = scratch.0.join("new");
    export(&scratch.pack(&experiment), "0", &folder).unwrap();
    let text = fs::read_to_string(folder.join("policy.json")).unwrap();
    let about: serde_json::Value = serde_json::from_str(&text).unwrap();
    let expected = serde_json::json!({
        "layout": "symmetric", "embodiment": "hand", "horizon": 45,
    });
    assert_eq!(about["environment"], expected);
    let action = &about["outputs"]["action"];
    assert_eq!(action["control_steps_per_decision"], 5);
    assert_eq!(action["displacement"], 0.03);
}

#[test]
fn what_cannot_be_exported_is_refused_with_the_reason() {
    let refusal = |experiment: &Experiment, policy: &str| {
        let scratch = Scratch::new("export-refused");
        let out = scratch.0.join("new");
        let error = export(&scratch.pack(experiment), policy, &out).unwrap_err();
        assert!(!out.exists());
        error.to_string()
    };
    let covers = narrow(Method::Covers, Group::D2);
    assert!(refusal(&covers, "1").contains("`policy` is 1 (policies so far: 1, from 0)"));
    let recurrent = narrow(Method::ThreeRl, Group::C1);
    assert!(refusal(&recurrent, "0").contains("a context"));
    let scratch = Scratch::new("export-refused");
    let error = export(&scratch.pack(&covers), "0", &scratch.0).unwrap_err();
    assert!(error.to_string().contains("exists already"));
    let no_run = export(&scratch.0, "0", &scratch.0.join("new")).unwrap_err();
    assert!(no_run.to_string().contains("holds no run"));
}
