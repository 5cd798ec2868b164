//! The messages of an event file (tensorflow/core/util/event.proto, framework/summary.proto).

use crate::proto::Message;

use super::record::append;

/// When something was, in decisions and in seconds since the run began.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(super) struct Moment {
    pub step: usize,
    pub seconds: f64,
}

/// The bytes of an event file, as it grows.
pub(super) struct EventFile(Vec<u8>);

impl EventFile {
    pub fn new() -> Self {
        let mut file = Self(Vec::new());
        let version = Message::new().double(1, 0.0).bytes(3, "brain.Event:2");
        append(&mut file.0, &version.into_bytes());
        file
    }

    fn value(&mut self, moment: Moment, tag: &str, field: impl FnOnce(Message) -> Message) {
        let value = field(Message::new().bytes(1, tag));
        let event = Message::new()
            .double(1, moment.seconds)
            .int(2, moment.step as i64)
            .message(5, Message::new().message(1, value));
        append(&mut self.0, &event.into_bytes());
    }

    /// Adds a number.
    pub fn scalar(&mut self, moment: Moment, tag: &str, value: f64) {
        self.value(moment, tag, |message| message.float(2, value as f32));
    }

    /// Adds a picture, the bytes of a PNG file of this size.
    pub fn image(&mut self, moment: Moment, tag: &str, [height, width]: [u32; 2], png: &[u8]) {
        let image = Message::new()
            .int(1, height.into())
            .int(2, width.into())
            // red, green, blue
            .int(3, 3)
            .bytes(4, png);
        self.value(moment, tag, |message| message.message(4, image));
    }

    /// Adds how numbers are distributed: each has a bucket that ends at it.
    pub fn histogram(&mut self, moment: Moment, tag: &str, values: &[f64]) {
        let mut sorted = values.to_vec();
        sorted.sort_by(f64::total_cmp);
        let (Some(&low), Some(&high)) = (sorted.first(), sorted.last()) else {
            return;
        };
        let packed = |values: &[f64]| values.iter().flat_map(|v| v.to_le_bytes()).collect();
        let limits: Vec<u8> = packed(&sorted);
        let counts: Vec<u8> = packed(&vec![1.0; sorted.len()]);
        let histogram = Message::new()
            .double(1, low)
            .double(2, high)
            .double(3, sorted.len() as f64)
            .double(4, sorted.iter().sum())
            .double(5, sorted.iter().map(|value| value * value).sum())
            .bytes(6, limits)
            .bytes(7, counts);
        self.value(moment, tag, |message| message.message(5, histogram));
    }

    pub fn into_bytes(self) -> Vec<u8> {
        self.0
    }
}
