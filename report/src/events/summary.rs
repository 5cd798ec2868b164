//! Protocol-buffer messages of an event file (tensorflow/core/util/event.proto,
//! framework/summary.proto) and their framing.

use crc::{CRC_32_ISCSI, Crc};
use prost::Message;

/// Time of a TensorBoard event: decisions, its step, and seconds of learning, its wall-clock time.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct EventTime {
    /// Decisions since the run began.
    pub step: usize,
    /// Seconds of learning since the run began.
    pub learning_seconds: f64,
}

/// Message `Event` of a TensorBoard event file: the contents of one record, without length and
/// checksums.
#[derive(Clone, PartialEq, Message)]
pub(super) struct Event {
    #[prost(double, tag = "1")]
    pub wall_time: f64,
    #[prost(int64, tag = "2")]
    pub step: i64,
    #[prost(string, optional, tag = "3")]
    pub file_version: Option<String>,
    #[prost(message, optional, tag = "5")]
    pub summary: Option<Summary>,
}

#[derive(Clone, PartialEq, Message)]
pub(super) struct Summary {
    #[prost(message, repeated, tag = "1")]
    pub values: Vec<Value>,
}

#[derive(Clone, PartialEq, Message)]
pub(super) struct Value {
    #[prost(string, tag = "1")]
    pub tag: String,
    #[prost(float, optional, tag = "2")]
    pub simple_value: Option<f32>,
    #[prost(message, optional, tag = "4")]
    pub image: Option<Image>,
    #[prost(message, optional, tag = "5")]
    pub histogram: Option<Histogram>,
}

#[derive(Clone, PartialEq, Message)]
pub(super) struct Image {
    #[prost(int32, tag = "1")]
    pub height: i32,
    #[prost(int32, tag = "2")]
    pub width: i32,
    /// Number of channels of the image: 3 for red, green and blue.
    #[prost(int32, tag = "3")]
    pub colorspace: i32,
    /// Bytes of the image as a PNG file.
    #[prost(bytes = "vec", tag = "4")]
    pub encoded: Vec<u8>,
}

#[derive(Clone, PartialEq, Message)]
pub(super) struct Histogram {
    #[prost(double, tag = "1")]
    pub min: f64,
    #[prost(double, tag = "2")]
    pub max: f64,
    #[prost(double, tag = "3")]
    pub num: f64,
    #[prost(double, tag = "4")]
    pub sum: f64,
    #[prost(double, tag = "5")]
    pub sum_squares: f64,
    #[prost(double, repeated, tag = "6")]
    pub bucket_limit: Vec<f64>,
    #[prost(double, repeated, tag = "7")]
    pub bucket: Vec<f64>,
}

/// TensorBoard event file that grows in memory.
pub(super) struct EventFile(Vec<u8>);

impl EventFile {
    pub fn new() -> Self {
        let mut file = Self(Vec::new());
        file.append(Event { file_version: Some("brain.Event:2".to_owned()), ..Event::default() });
        file
    }

    fn append(&mut self, event: Event) {
        append_record(&mut self.0, &event.encode_to_vec());
    }

    fn value(&mut self, time: EventTime, value: Value) {
        let values = vec![value];
        self.append(Event {
            wall_time: time.learning_seconds,
            step: time.step as i64,
            summary: Some(Summary { values }),
            ..Event::default()
        });
    }

    /// Adds an event to the file with the number `value` under the name `tag`.
    pub fn add_scalar(&mut self, time: EventTime, tag: &str, value: f64) {
        let value =
            Value { tag: tag.to_owned(), simple_value: Some(value as f32), ..Value::default() };
        self.value(time, value);
    }

    /// Adds an event to the file with an image, the bytes of a PNG file of size `[height, width]`.
    pub fn add_image(&mut self, time: EventTime, tag: &str, [height, width]: [u32; 2], png: &[u8]) {
        let image = Image {
            height: height as i32,
            width: width as i32,
            colorspace: 3,
            encoded: png.to_vec(),
        };
        let value = Value { tag: tag.to_owned(), image: Some(image), ..Value::default() };
        self.value(time, value);
    }

    /// Adds an event to the file with the histogram of some numbers. Each number has a bucket of
    /// its own that ends at it, so nothing is lost. No event is added for an empty slice.
    pub fn add_histogram(&mut self, time: EventTime, tag: &str, values: &[f64]) {
        let mut sorted = values.to_vec();
        sorted.sort_by(f64::total_cmp);
        let (Some(&min), Some(&max)) = (sorted.first(), sorted.last()) else {
            return;
        };
        let histogram = Histogram {
            min,
            max,
            num: sorted.len() as f64,
            sum: sorted.iter().sum(),
            sum_squares: sorted.iter().map(|value| value * value).sum(),
            bucket: vec![1.0; sorted.len()],
            bucket_limit: sorted,
        };
        let value = Value { tag: tag.to_owned(), histogram: Some(histogram), ..Value::default() };
        self.value(time, value);
    }

    pub fn into_bytes(self) -> Vec<u8> {
        self.0
    }
}

/// Checksum algorithm of an event file's records: CRC32C (Castagnoli).
const CHECKSUM: Crc<u32> = Crc::<u32>::new(&CRC_32_ISCSI);
/// Constant that masks a rotated checksum, as TensorFlow does: the CRC of data that contains its
/// own CRC would be a weak checksum (tensorflow/core/lib/hash/crc32c.h).
const MASK: u32 = 0xa282_ead8;

fn masked(bytes: &[u8]) -> u32 {
    CHECKSUM.checksum(bytes).rotate_right(15).wrapping_add(MASK)
}

/// Appends a record to an event file: its length (u64), the masked checksum of the length (u32),
/// its bytes, and their masked checksum, all little-endian
/// (tensorflow/core/lib/io/record_writer.h).
fn append_record(file: &mut Vec<u8>, bytes: &[u8]) {
    let length = (bytes.len() as u64).to_le_bytes();
    file.extend(length);
    file.extend(masked(&length).to_le_bytes());
    file.extend(bytes);
    file.extend(masked(bytes).to_le_bytes());
}

#[cfg(test)]
mod tests {
    use super::*;

    /// The first record of every event file that TensorFlow writes has 24 bytes, and this checksum
    /// of its length.
    #[test]
    fn a_record_is_framed() {
        let mut file = Vec::new();
        append_record(&mut file, &[7; 24]);
        assert_eq!(file.len(), 8 + 4 + 24 + 4);
        assert_eq!(file[..12], [24, 0, 0, 0, 0, 0, 0, 0, 0xa3, 0x7f, 0x4b, 0x22]);
        assert_eq!(file[36..], masked(&[7; 24]).to_le_bytes());
    }
}
