//! TensorBoard's event files, read back as TensorFlow frames them.

use std::fs;
use std::path::Path;

use covers::CoversError;
use covers::presets::Method;
use prost::Message;

use crate::common::covers;
use crate::common::packed::small;
use crate::common::scratch::Scratch;

const METRICS: &str = "rollout,decisions,group,straddles,policy,reward,success,distances,loss\n\
    0,500,goal-reach,false,0,20.5,0.25,,0.5\n\
    1,1000,button-press,true,1,,,1.5;;0.5,NaN\n\
    2,1500,button-press,false,1,30,0.5,2,1\n\
    3,2000,button-press,false,1,30,0.5,2,0.0";
const TIMINGS: &str = "rollout,decisions,total,update\n0,500,2.5,1\n2,500,1.5,0.5\n";
const SCORES: &str = "rollouts,decisions,group,element,seen,policy,episodes,success,reward\n\
    2,1000,goal-reach,identity,true,0,4,1,400\n\
    2,1000,goal-reach,flip x,true,0,4,0.5,300\n";

/// TensorFlow's message of this name (core/util/event.proto), without the fields that no test reads;
/// so are those below (core/framework/summary.proto).
#[derive(Clone, PartialEq, Message)]
struct Event {
    #[prost(double, tag = "1")]
    wall_time: f64,
    #[prost(int64, tag = "2")]
    step: i64,
    #[prost(string, tag = "3")]
    file_version: String,
    #[prost(message, optional, tag = "5")]
    summary: Option<Summary>,
}

#[derive(Clone, PartialEq, Message)]
struct Summary {
    #[prost(message, repeated, tag = "1")]
    value: Vec<Value>,
}

#[derive(Clone, PartialEq, Message)]
struct Value {
    #[prost(string, tag = "1")]
    tag: String,
    #[prost(float, optional, tag = "2")]
    simple_value: Option<f32>,
    #[prost(message, optional, tag = "4")]
    image: Option<Image>,
    #[prost(message, optional, tag = "5")]
    histogram: Option<Histogram>,
}

#[derive(Clone, PartialEq, Message)]
struct Image {
    #[prost(int32, tag = "1")]
    height: i32,
    #[prost(int32, tag = "2")]
    width: i32,
    #[prost(bytes = "vec", tag = "4")]
    encoded_image_string: Vec<u8>,
}

#[derive(Clone, PartialEq, Message)]
struct Histogram {
    #[prost(double, tag = "1")]
    min: f64,
    #[prost(double, tag = "2")]
    max: f64,
    #[prost(double, tag = "3")]
    num: f64,
    #[prost(double, tag = "4")]
    sum: f64,
    #[prost(double, tag = "5")]
    sum_squares: f64,
    #[prost(double, repeated, tag = "6")]
    bucket_limit: Vec<f64>,
}

/// A folder of a run that goes on: the last row of its metrics is being written, and nobody knows
/// how long its second rollout took.
fn running(scratch: &Scratch) -> std::path::PathBuf {
    let run = scratch.pack(&small(Method::Covers));
    for (name, text) in
        [("metrics.csv", METRICS), ("timings.csv", TIMINGS), ("evaluation.csv", SCORES)]
    {
        fs::write(run.join(name), text).unwrap();
    }
    let sheet = fs::File::create(run.join("contact_sheet.png")).unwrap();
    let mut sheet = png::Encoder::new(sheet, 3, 2);
    sheet.set_color(png::ColorType::Rgb);
    let mut sheet = sheet.write_header().unwrap();
    sheet.write_image_data(&[7; 3 * 2 * 3]).unwrap();
    run
}

fn report(run: &Path, folder: &Path) -> Result<String, CoversError> {
    let (run, to) = (run.display().to_string(), folder.display().to_string());
    covers(&["report", &run, "--tensorboard", &to])
}

/// CRC32C bit by bit (RFC 3720, appendix B.4), masked as TensorFlow masks it.
fn checksum(bytes: &[u8]) -> u32 {
    let mut crc = !0u32;
    for byte in bytes {
        crc ^= u32::from(*byte);
        for _ in 0..8 {
            crc = if crc & 1 == 1 { crc >> 1 ^ 0x82f6_3b78 } else { crc >> 1 };
        }
    }
    let crc = !crc;
    crc.rotate_right(15).wrapping_add(0xa282_ead8)
}

/// The records of a file; none where a checksum is wrong.
fn records(mut file: &[u8]) -> Option<Vec<&[u8]>> {
    let mut records = Vec::new();
    while !file.is_empty() {
        let (length, rest) = file.split_first_chunk::<8>()?;
        let (of_length, rest) = rest.split_first_chunk::<4>()?;
        let size = u64::from_le_bytes(*length) as usize;
        let (bytes, rest) = rest.split_at_checked(size)?;
        let (of_bytes, rest) = rest.split_first_chunk::<4>()?;
        let sound = u32::from_le_bytes(*of_length) == checksum(length)
            && u32::from_le_bytes(*of_bytes) == checksum(bytes);
        records.push(sound.then_some(bytes)?);
        file = rest;
    }
    Some(records)
}

/// The values of a tag: decisions, seconds, number.
fn scalars(file: &[u8], tag: &str) -> Vec<(i64, f64, f32)> {
    let events = records(file).unwrap().into_iter().map(|bytes| Event::decode(bytes).unwrap());
    let values = events.filter_map(|event| {
        let value = event.summary?.value.into_iter().next()?;
        let number = value.simple_value?;
        (value.tag == tag).then_some((event.step, event.wall_time, number))
    });
    values.collect()
}

#[test]
fn figures_come_with_their_decisions_and_seconds() {
    let scratch = Scratch::new("events");
    let run = running(&scratch);
    let folder = scratch.0.join("boards");
    let said = report(&run, &folder).unwrap();
    let path = folder.join("packed/events.out.tfevents.0.covers");
    assert_eq!(said.trim(), path.display().to_string());
    let file = fs::read(path).unwrap();
    let scalars = |tag| scalars(&file, tag);
    // a rollout whose seconds are not known takes none
    assert_eq!(scalars("reward"), [(500, 2.5, 20.5), (1500, 4.0, 30.0)]);
    assert_eq!(scalars("policy").len(), 3);
    assert_eq!(scalars("straddles").len(), 3);
    assert_eq!(scalars("loss"), [(500, 2.5, 0.5), (1500, 4.0, 1.0)], "no number, no point");
    assert_eq!(scalars("distances/policy 0"), [(1000, 2.5, 1.5), (1500, 4.0, 2.0)]);
    assert_eq!(scalars("distances/policy 2"), [(1000, 2.5, 0.5)]);
    assert_eq!(scalars("distances/policy 1"), []);
    assert_eq!(scalars("seconds/update"), [(500, 2.5, 1.0), (1500, 4.0, 0.5)]);
    let evaluation = "evaluation/goal-reach/success";
    assert_eq!(scalars(evaluation), [(1000, 2.5, 0.75)]);
    assert_eq!(scalars("evaluation/goal-reach/success/flip x"), [(1000, 2.5, 0.5)]);
    for word in ["rollout", "decisions", "group"] {
        assert_eq!(scalars(word), []);
    }
}

#[test]
fn pictures_and_histograms_are_whole() {
    let scratch = Scratch::new("events-picture");
    let run = running(&scratch);
    report(&run, &scratch.0).unwrap();
    let file = fs::read(scratch.0.join("packed/events.out.tfevents.0.covers")).unwrap();
    let records = records(&file).unwrap();
    let mut events = records.into_iter().map(|bytes| Event::decode(bytes).unwrap());
    assert_eq!(events.next().unwrap().file_version, "brain.Event:2");
    let values: Vec<Value> = events.flat_map(|event| event.summary.unwrap().value).collect();
    let png = fs::read(run.join("contact_sheet.png")).unwrap();
    let image = Image { height: 2, width: 3, encoded_image_string: png };
    assert_eq!(values.iter().find_map(|value| value.image.as_ref()), Some(&image));
    let histogram = Histogram {
        min: 0.5,
        max: 1.5,
        num: 2.0,
        sum: 2.0,
        sum_squares: 2.5,
        bucket_limit: vec![0.5, 1.5],
    };
    assert_eq!(values.iter().find_map(|value| value.histogram.as_ref()), Some(&histogram));
}

#[test]
fn a_column_of_policies_has_their_tags_while_there_is_one() {
    let scratch = Scratch::new("events-one-policy");
    let run = running(&scratch);
    let metrics = "rollout,decisions,distances\n0,500,1.5\n";
    fs::write(run.join("metrics.csv"), metrics).unwrap();
    report(&run, &scratch.0).unwrap();
    let file = fs::read(scratch.0.join("packed/events.out.tfevents.0.covers")).unwrap();
    assert_eq!(scalars(&file, "distances/policy 0"), [(500, 2.5, 1.5)]);
    assert_eq!(scalars(&file, "distances"), []);
}

#[test]
fn runs_of_one_name_are_refused() {
    let scratch = Scratch::new("events-names");
    let run = running(&scratch).display().to_string();
    let boards = scratch.0.join("boards");
    let to = boards.display().to_string();
    let refused = covers(&["report", &run, &run, "--tensorboard", &to]);
    let message = refused.unwrap_err().to_string();
    assert!(message.matches("packed").count() == 2, "{message}");
    assert!(!boards.exists());
}

#[test]
fn a_damaged_file_is_found_and_a_folder_without_a_run_refused() {
    let scratch = Scratch::new("events-damaged");
    report(&running(&scratch), &scratch.0).unwrap();
    let file = fs::read(scratch.0.join("packed/events.out.tfevents.0.covers")).unwrap();
    for at in [0, 8, 12, file.len() - 1] {
        let mut damaged = file.clone();
        damaged[at] ^= 1;
        assert!(records(&damaged).is_none(), "byte {at}");
    }
    let message = report(&scratch.0, &scratch.0).unwrap_err().to_string();
    assert!(message.contains("holds no run"), "{message}");
}

/// Only the last row may be cut, by a run that goes on.
#[test]
fn damaged_tables_are_refused() {
    let scratch = Scratch::new("events-tables");
    let (run, boards) = (running(&scratch), scratch.0.join("boards"));
    let refusal = || report(&run, &boards).unwrap_err().to_string();
    let metrics = run.join("metrics.csv");
    fs::write(&metrics, METRICS.replace(",,,1.5;;0.5", "")).unwrap();
    let ragged = refusal();
    assert!(ragged.contains("metrics.csv") && ragged.contains("line: 3"), "{ragged}");
    fs::write(&metrics, METRICS).unwrap();
    let sums = r#"{"tables": {"metrics.csv": "00000000", "evaluation.csv": "00000000"}}"#;
    fs::write(run.join("summary.json"), sums).unwrap();
    let changed = refusal();
    assert!(changed.contains("evaluation.csv was changed"), "{changed}");
    fs::remove_file(run.join("evaluation.csv")).unwrap();
    let missing = refusal();
    assert!(missing.contains("missing"), "{missing}");
    assert!(!boards.exists());
}
