//! Meta-World itself, recorded by `benches/peers/record_metaworld.sh`, against the `metaworld`
//! layout; and recordings that are none.

use std::fs::{self, File};
use std::io::{Read, Write};
use std::path::Path;

use covers::check::{MetaWorldComparison, compare_meta_world_recordings};
use envs::TaskGroup;
use zip::write::SimpleFileOptions;
use zip::{ZipArchive, ZipWriter};

use crate::common::scratch::Scratch;

const RECORDINGS: &str = concat!(env!("CARGO_MANIFEST_DIR"), "/tests/recordings");
const REACH: &str = "mj222_reach_expert.npz";

/// Expert's steps of single steps and of replays that can be compared: of 200, those in which
/// neither a mesh nor a box in its place touches anything, and those before the first other one.
const COMPARABLE: [(&str, usize, usize); 7] = [
    ("mj222_button-press_expert.npz", 115, 115),
    ("mj222_door-close_expert.npz", 90, 81),
    ("mj222_door-open_expert.npz", 181, 72),
    ("mj222_drawer-open_expert.npz", 192, 151),
    ("mj222_plate-slide_expert.npz", 113, 98),
    ("mj222_window-close_expert.npz", 127, 127),
    ("mj222_window-open_expert.npz", 147, 136),
];

/// Replays (metres) that the solver's tolerance leaves looser: in a jammed button, and in a grip.
const LOOSE: [(&str, f64); 3] = [
    ("mj222_button-press-topdown_expert.npz", 4e-8),
    ("mj222_push_expert.npz", 1e-8),
    ("mj222_pick-place_expert.npz", 1e-8),
];

/// The bounds are the figures of `envs/README.md`. Other releases of MuJoCo than that of the
/// recordings reward alike and move in other ways (docs/platforms.md).
#[test]
fn rewards_steps_and_replays_are_meta_worlds() {
    let rows = compare_meta_world_recordings(Path::new(RECORDINGS)).unwrap();
    assert_eq!(rows.len(), 2 * TaskGroup::ALL.len());
    for row in rows {
        assert_eq!(row.reward_steps, 200, "{row:?}");
        assert_eq!(row.success_mismatches, 0, "{row:?}");
        if !envs::mujoco::is_reference_release() {
            assert!(row.max_reward_deviation <= 1.1e-13, "{row:?}");
            continue;
        }
        assert!(row.max_reward_deviation <= 1e-13, "{row:?}");
        assert!(row.passes(), "{row:?}");
        let comparable = COMPARABLE.iter().find(|(file, ..)| *file == row.file);
        let &(_, physics, replay) = comparable.unwrap_or(&("", 200, 200));
        assert!(row.physics_steps >= physics, "{row:?}");
        assert!(row.median_qpos_deviation <= 1e-15, "{row:?}");
        assert!(row.p99_qpos_deviation <= 1e-12, "{row:?}");
        assert!(row.replay_steps >= replay, "{row:?}");
        let loose = LOOSE.iter().find(|(file, _)| *file == row.file);
        let bound = loose.map_or(3e-12, |&(_, bound)| bound);
        assert!(row.max_replay_deviation_m <= bound, "{row:?}");
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

fn only_row(folder: &Scratch) -> MetaWorldComparison {
    let mut rows = compare_meta_world_recordings(&folder.0).unwrap();
    assert_eq!(rows.len(), 1);
    rows.remove(0)
}

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
    compare_meta_world_recordings(folder).unwrap_err().to_string()
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
