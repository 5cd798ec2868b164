//! Meta-World itself, recorded by `benches/peers/record_metaworld.sh`, against the `metaworld`
//! layout; and recordings that are none.

use std::fs::{self, File};
use std::io::{Read, Write};
use std::path::Path;

use covers::check::{ParityRow, compare_recordings};
use envs::{Camera, Embodiment, Layout, Scene, TaskGroup};
use zip::write::SimpleFileOptions;
use zip::{ZipArchive, ZipWriter};

use crate::common::scratch::Scratch;

const RECORDINGS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/recordings");
const REACH: &str = "mj222_reach_expert.npz";

#[test]
fn rewards_steps_and_replays_are_meta_worlds() {
    let rows = compare_recordings(Path::new(RECORDINGS)).unwrap();
    assert_eq!(rows.len(), 2 * TaskGroup::ALL.len());
    for row in rows {
        assert!(row.passes(), "{row:?}");
        assert!(row.reward_steps >= 200, "{row:?}");
        assert_eq!(row.success_mismatches, 0, "{row:?}");
        assert!(row.max_reward_deviation <= 1e-9, "{row:?}");
        assert!(row.physics_steps >= 90, "{row:?}");
        assert!(row.median_qpos_deviation <= 1e-15, "{row:?}");
        assert!(row.p99_qpos_deviation <= 5e-12, "{row:?}");
        assert!(row.replay_steps >= 60, "{row:?}");
        // the solver's tolerance leaves more in a jammed button, and in a grip
        let holds = ["button-press-topdown", "push", "pick-place"].contains(&row.task);
        let bound = if holds { 1e-7 } else { 1e-10 };
        assert!(row.max_replay_deviation_m <= bound, "{row:?}");
    }
}

/// Figures of Meta-World 3.1.1 on MuJoCo 2.2.2 after a reset: joints 0 to 6 in radians, then the
/// fingers.
#[test]
fn episodes_start_where_meta_worlds_do() {
    let over_the_centre = [1.882616, -0.593460, -0.959474, 1.648329, 0.923299, 1.026890, 2.323406];
    let further_back = [2.163679, -0.562765, -1.225574, 2.173459, 1.237292, 1.003001, 1.918364];
    for group in TaskGroup::STANDARD {
        let (layout, arm) = (Layout::MetaWorld, Embodiment::SAWYER);
        let scene = Scene::new_in_layout(layout, group, arm, Camera::default()).unwrap();
        let joints = match group.name() {
            "button-press" => further_back,
            _ => over_the_centre,
        };
        // a state begins with the time
        let qpos = &scene.start_state().values()[1..];
        for (got, expected) in qpos.iter().zip(joints) {
            assert!((got - expected).abs() < 1e-6, "{group}: {got}, {expected}");
        }
        assert!((qpos[7] + 0.000172).abs() < 1e-6 && (qpos[8] - 0.000172).abs() < 1e-6);
    }
}

/// Copies a recording into a folder, with its arrays changed.
fn changed(test: &str, change: impl Fn(&str, &mut Vec<u8>)) -> Scratch {
    let to = Scratch::new(test);
    let source = File::open(Path::new(RECORDINGS).join(REACH)).unwrap();
    let mut archive = ZipArchive::new(source).unwrap();
    let mut copy = ZipWriter::new(File::create(to.0.join(REACH)).unwrap());
    for index in 0..archive.len() {
        let mut member = archive.by_index(index).unwrap();
        let name = member.name().unwrap().into_owned();
        let mut bytes = Vec::new();
        member.read_to_end(&mut bytes).unwrap();
        change(name.trim_end_matches(".npy"), &mut bytes);
        if !bytes.is_empty() {
            copy.start_file(&*name, SimpleFileOptions::default()).unwrap();
            copy.write_all(&bytes).unwrap();
        }
    }
    copy.finish().unwrap();
    to
}

/// Where an npy file's values begin, for files of version 1.
fn start(bytes: &[u8]) -> usize {
    10 + usize::from(u16::from_le_bytes([bytes[8], bytes[9]]))
}

fn only_row(folder: &Scratch) -> ParityRow {
    let mut rows = compare_recordings(&folder.0).unwrap();
    assert_eq!(rows.len(), 1);
    rows.remove(0)
}

/// Adds to the number at `index` of an array.
fn add(bytes: &mut [u8], index: usize, value: f64) {
    let at = start(bytes) + 8 * index;
    let number = bytes[at..].first_chunk_mut().unwrap();
    *number = (f64::from_le_bytes(*number) + value).to_le_bytes();
}

#[test]
fn a_reward_and_a_success_that_differ_are_noticed() {
    let row = only_row(&changed("reward", |name, bytes| match name {
        "reward" => add(bytes, 17, 1e-6),
        "info" => add(bytes, 0, 1.0),
        _ => {}
    }));
    assert!((row.max_reward_deviation - 1e-6).abs() < 1e-9, "{row:?}");
    assert_eq!(row.success_mismatches, 1, "{row:?}");
}

#[test]
fn another_motion_is_noticed() {
    let row = only_row(&changed("motion", |name, bytes| {
        if name == "mocap_pos" {
            // the target after the third step, 5 mm higher
            add(bytes, 3 * 3 + 2, 5e-3);
        }
    }));
    assert!(row.max_qpos_deviation > 1e-5, "{row:?}");
    assert!(row.max_replay_deviation_m > 1e-5, "{row:?}");
    assert!(row.max_reward_deviation <= 1e-9, "{row:?}");
}

fn message(folder: &Path) -> String {
    compare_recordings(folder).unwrap_err().to_string()
}

#[test]
fn damaged_recordings_are_refused_by_name() {
    type Damage = fn(&mut Vec<u8>);
    let cases: [(&str, &str, Damage); 9] = [
        ("qvel", "`qvel` is missing among", Vec::clear),
        ("qvel", "more or fewer values than its shape says", |bytes| {
            bytes.truncate(bytes.len() - 8);
        }),
        ("qvel", "its last number is cut", |bytes| bytes.extend([0; 7])),
        ("qvel", "its header ends early", |bytes| bytes.truncate(40)),
        ("qvel", "does not begin as an npy file", |bytes| bytes[0] = b'x'),
        ("qvel", "holds values of kind `<f4`", |bytes| {
            let at = bytes.windows(3).position(|w| w == b"<f8").unwrap();
            bytes[at + 2] = b'4';
        }),
        ("qvel", "has the shape [1, 202, 15]", |bytes| {
            let at = bytes.windows(7).position(|w| w == b"(2, 101").unwrap();
            bytes[at..at + 7].copy_from_slice(b"(1, 202");
        }),
        ("qvel", "`qvel` has a value that is not finite at index 4", |bytes| {
            add(bytes, 4, f64::NAN);
        }),
        // placements that are too short would be read past their end
        ("rand_vec", "`rand_vec` has the shape [2, 2], expected [2, 6]", |bytes| {
            let at = bytes.windows(6).position(|w| w == b"(2, 6)").unwrap();
            bytes[at..at + 6].copy_from_slice(b"(2, 2)");
            bytes.truncate(start(bytes) + 8 * 2 * 2);
        }),
    ];
    for (array, expected, damage) in cases {
        let folder = changed("damaged", |name, bytes| {
            if name == array {
                damage(bytes);
            }
        });
        let refusal = message(&folder.0);
        assert!(refusal.contains(expected) && refusal.contains(REACH), "{refusal}");
    }
}

#[test]
fn what_is_no_recording_is_refused_by_name() {
    let scratch = Scratch::new("garbage");
    let to = &scratch.0;
    assert!(message(to).contains("no recording in it"));
    fs::write(to.join(REACH), b"not a zip").unwrap();
    let text = message(to);
    assert!(text.contains(REACH) && text.contains("not an npz archive"), "{text}");
    fs::rename(to.join(REACH), to.join("mj222_basketball_expert.npz")).unwrap();
    let swapped = message(to);
    assert!(swapped.contains("basketball") && swapped.contains("plate-slide"), "{swapped}");
    assert!(message(&to.join("nowhere")).contains("cannot read"));
}
