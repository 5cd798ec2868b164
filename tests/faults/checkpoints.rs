//! Checkpoints that were cut, changed, swapped or come from the future.

use std::fs;
use std::ops::Range;
use std::path::{Path, PathBuf};

use covers::presets::Method;
use covers::{Experiment, LearnerError, Run, RunError, RunFolder, SwitchableVecEnv, TaskLabel};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::common::{
    Scratch, assert_same, checkpoints, crash_after, expected, finish, full, interrupted, newest,
    reference, tiny,
};

/// Such a run's folder, its newest checkpoint, and what that holds.
fn newest_of(scratch: &Scratch) -> (PathBuf, PathBuf, Vec<u8>) {
    let folder = interrupted(scratch);
    let path = newest(&folder);
    let whole = fs::read(&path).unwrap();
    (folder, path, whole)
}

fn resume(folder: &Path) -> Result<Run, RunError> {
    Run::resume(folder, Some(1))
}

#[test]
fn a_run_of_several_policies_goes_on_to_the_same_bytes() {
    let scratch = Scratch::new("policies");
    let run = resume(&interrupted(&scratch)).unwrap();
    assert_eq!(run.stats().created_for_group.len(), 2);
    assert!(run.stats().rollouts == 3 && !run.is_finished());
    let written = finish(run);
    assert_same(&written, expected());
    let last = Path::new("checkpoints/000005.safetensors");
    assert!(written.contains_key(last), "two rollouts were left");
}

#[test]
fn a_damaged_checkpoint_is_passed_over_and_named() {
    let scratch = Scratch::new("damaged");
    let (folder, path, whole) = newest_of(&scratch);
    let mut rng = ChaCha8Rng::seed_from_u64(3);
    for _ in 0..if full() { 60 } else { 2 } {
        let mut flipped = whole.clone();
        flipped[rng.random_range(0..whole.len())] ^= 1 << rng.random_range(0..8);
        let cut = &whole[..rng.random_range(0..whole.len())];
        for damaged in [&flipped[..], cut] {
            fs::write(&path, damaged).unwrap();
            let run = resume(&folder).unwrap();
            assert_eq!(run.stats().rollouts, 2);
            let passed = format!("passed over a newer checkpoint: cannot read {}", path.display());
            assert!(run.start_message().contains(&passed), "{}", run.start_message());
        }
    }
    fs::write(&path, b"a file of another program").unwrap();
    assert_same(&finish(resume(&folder).unwrap()), expected());
}

#[test]
fn a_checkpoint_under_a_higher_number_is_passed_over_and_named() {
    let scratch = Scratch::new("renamed");
    let folder = interrupted(&scratch);
    let path = newest(&folder);
    let renamed = path.with_file_name("000099.safetensors");
    fs::copy(checkpoints(&folder).first().unwrap(), &renamed).unwrap();
    let experiment = RunFolder::from_path(&folder).read_experiment().unwrap();
    let spec = SwitchableVecEnv::env_spec(&experiment.envs);
    let load = || {
        let folder = RunFolder::from_path(&folder);
        folder.load_learner(&experiment.learner, &spec, &TaskLabel::default())
    };
    // an older policy is never evaluated or exported in place of the newest one
    let refused = load().err().unwrap().to_string();
    assert!(refused.contains("under the name of the one after 99"), "{refused}");
    assert!(refused.contains("covers resume"), "{refused}");
    let run = resume(&folder).unwrap();
    assert_eq!(run.stats().rollouts, 3, "{}", run.start_message());
    let problem = "it is the checkpoint after 1 rollouts under the name of the one after 99";
    assert!(run.start_message().contains(problem), "{}", run.start_message());
    fs::remove_file(renamed.with_added_extension("damaged")).unwrap();
    assert_same(&finish(run), expected());
}

#[test]
fn a_run_without_an_intact_checkpoint_says_what_is_wrong_with_each() {
    let scratch = Scratch::new("none");
    let folder = interrupted(&scratch);
    for path in checkpoints(&folder) {
        fs::write(&path, b"").unwrap();
    }
    let error = resume(&folder).err().unwrap();
    assert!(matches!(error, RunError::NoCheckpoint { .. }), "{error}");
    let message = error.to_string();
    for part in ["000001", "000002", "000003", "experiment.json"] {
        assert!(message.contains(part), "{message}");
    }
    let empty = scratch.0.join("empty");
    fs::create_dir(&empty).unwrap();
    let empty_message = resume(&empty).err().unwrap().to_string();
    assert!(empty_message.contains("holds no run"), "{empty_message}");
}

#[test]
fn settings_whose_file_is_lost_come_back_from_a_checkpoint() {
    let scratch = Scratch::new("settings");
    let path = interrupted(&scratch);
    let (folder, file) = (RunFolder::from_path(&path), path.join("experiment.json"));
    let settings = folder.read_experiment().unwrap().with_threads(1);
    fs::remove_file(&file).unwrap();
    fs::write(newest(&path), b"nor is this one whole").unwrap();
    assert_eq!(folder.read_experiment().unwrap(), settings);
    let run = resume(&path).unwrap();
    let notice = run.start_message();
    assert!(
        notice.contains("continues after 2 rollouts")
            && notice.contains("experiment.json was lost and is written again"),
        "{notice}"
    );
    let written = fs::read_to_string(file).unwrap();
    assert_eq!(Experiment::parse(&written).unwrap(), settings);
    assert_same(&finish(run), expected());
}

#[test]
fn a_checkpoint_of_another_run_is_refused_with_what_differs() {
    let scratch = Scratch::new("foreign");
    let folder = interrupted(&scratch);
    let other = Run::start(tiny(Method::Covers).with_seed(5), scratch.run("other")).unwrap();
    let other = crash_after(3, other);
    fs::copy(newest(&other), newest(&folder)).unwrap();
    let error = resume(&folder).err().unwrap();
    assert!(
        matches!(error, RunError::Learner(LearnerError::CheckpointSettingsDiffer { .. })),
        "{error}"
    );
    assert!(error.to_string().contains("`seed` 0 and 5"), "{error}");
}

#[test]
fn a_checkpoint_of_a_newer_version_is_refused_and_kept() {
    let scratch = Scratch::new("newer");
    let (folder, path, whole) = newest_of(&scratch);
    let newer = resealed(&whole, br#"\"format\":5"#, br#"\"format\":6"#);
    fs::write(&path, &newer).unwrap();
    let error = resume(&folder).err().unwrap();
    assert!(
        matches!(error, RunError::Learner(LearnerError::NewerFormat { format: 6, .. })),
        "{error}"
    );
    assert_eq!(fs::read(&path).unwrap(), newer);
}

/// Parameters and the optimiser's moments alike.
#[test]
fn a_checkpoint_with_a_number_that_is_not_finite_is_passed_over_and_the_number_named() {
    let scratch = Scratch::new("not-finite");
    let (folder, path, whole) = newest_of(&scratch);
    for array in ["policy.0.params", "policy.0.adam.first"] {
        let mut poisoned = whole.clone();
        let start = place(&whole, array).start;
        poisoned[start..start + 4].copy_from_slice(&f32::NAN.to_le_bytes());
        seal(&mut poisoned);
        fs::write(&path, &poisoned).unwrap();
        let run = resume(&folder).unwrap();
        let named = format!("`{array}`[0] is NaN");
        assert!(run.start_message().contains(&named), "{}", run.start_message());
    }
}

#[test]
fn a_checkpoint_that_a_link_leads_to_is_not_followed() {
    let scratch = Scratch::new("links");
    let folder = interrupted(&scratch);
    let path = newest(&folder);
    let outside = scratch.0.join("outside.safetensors");
    fs::rename(&path, &outside).unwrap();
    std::os::unix::fs::symlink(&outside, &path).unwrap();
    assert_eq!(resume(&folder).unwrap().stats().rollouts, 2);
}

#[test]
fn a_run_that_was_killed_before_its_first_checkpoint_begins_anew() {
    let scratch = Scratch::new("first");
    let mut experiment = tiny(Method::Covers);
    experiment.checkpoints.every = 100;
    let folder = crash_after(2, Run::start(experiment.clone(), scratch.run("run")).unwrap());
    let run = resume(&folder).unwrap();
    assert!(run.start_message().contains("started from the beginning"), "{}", run.start_message());
    assert_same(&finish(run), &reference(&experiment));
}

#[test]
fn as_many_checkpoints_are_kept_as_the_settings_say() {
    let scratch = Scratch::new("kept");
    let mut experiment = tiny(Method::Covers);
    experiment.checkpoints.keep = 2;
    let mut run = Run::start(experiment, scratch.run("run")).unwrap();
    while run.advance().unwrap().is_some() {}
    let names: Vec<_> = checkpoints(run.folder().path())
        .iter()
        .map(|path| path.file_name().unwrap().to_str().unwrap().to_owned())
        .collect();
    let last = run.stats().rollouts;
    assert!(last > 2);
    let expected = [last - 1, last].map(|rollouts| format!("{rollouts:06}.safetensors"));
    assert!(names.iter().eq(&expected), "{names:?}");
}

/// The file with one run of bytes replaced by another as long, and a checksum that is right.
fn resealed(bytes: &[u8], from: &[u8], to: &[u8]) -> Vec<u8> {
    let mut bytes = bytes.to_vec();
    let place = bytes.windows(from.len()).position(|w| w == from).unwrap();
    bytes[place..place + to.len()].copy_from_slice(to);
    seal(&mut bytes);
    bytes
}

/// Where an array stands in a safetensors file.
fn place(bytes: &[u8], array: &str) -> Range<usize> {
    let (length, _) = bytes.as_chunks::<8>();
    let length = 8 + u64::from_le_bytes(length[0]) as usize;
    let header: serde_json::Value = serde_json::from_slice(&bytes[8..length]).unwrap();
    let offset = |end: usize| header[array]["data_offsets"][end].as_u64().unwrap() as usize;
    length + offset(0)..length + offset(1)
}

/// Writes the checksum that the bytes should have.
fn seal(bytes: &mut [u8]) {
    let place = place(bytes, "checksum");
    bytes[place.clone()].fill(0);
    let checksum = crc32fast::hash(bytes);
    bytes[place].copy_from_slice(&checksum.to_le_bytes());
}
