//! Reads the wire format of protocol buffers.

#[derive(Clone, Debug, PartialEq)]
pub enum Field<'a> {
    Int(u64),
    Four([u8; 4]),
    Eight([u8; 8]),
    Bytes(&'a [u8]),
}

#[derive(Clone, Debug, PartialEq)]
pub struct Message<'a>(Vec<(u64, Field<'a>)>);

impl<'a> Message<'a> {
    pub fn parse(mut bytes: &'a [u8]) -> Self {
        let mut fields = Vec::new();
        while !bytes.is_empty() {
            let key = varint(&mut bytes);
            let field = match key & 7 {
                0 => Field::Int(varint(&mut bytes)),
                1 => Field::Eight(take(&mut bytes, 8).try_into().unwrap()),
                2 => {
                    let length = varint(&mut bytes) as usize;
                    Field::Bytes(take(&mut bytes, length))
                }
                5 => Field::Four(take(&mut bytes, 4).try_into().unwrap()),
                wire => panic!("wire type {wire}"),
            };
            fields.push((key >> 3, field));
        }
        Self(fields)
    }

    pub fn all(&self, number: u64) -> impl Iterator<Item = &Field<'a>> {
        let fields = self.0.iter();
        fields.filter(move |(n, _)| *n == number).map(|(_, f)| f)
    }

    pub fn blobs(&self, number: u64) -> impl Iterator<Item = &'a [u8]> {
        self.all(number).map(move |field| match field {
            Field::Bytes(bytes) => *bytes,
            other => panic!("field {number} is {other:?}"),
        })
    }

    pub fn messages(&self, number: u64) -> impl Iterator<Item = Message<'a>> {
        self.blobs(number).map(Message::parse)
    }

    pub fn message(&self, number: u64) -> Option<Message<'a>> {
        self.messages(number).next()
    }

    pub fn text(&self, number: u64) -> &'a str {
        let bytes = self.blobs(number).next().unwrap_or_default();
        std::str::from_utf8(bytes).unwrap()
    }

    pub fn ints(&self, number: u64) -> Vec<i64> {
        let ints = self.all(number).map(|field| match field {
            Field::Int(value) => *value as i64,
            other => panic!("field {number} is {other:?}"),
        });
        ints.collect()
    }

    pub fn int(&self, number: u64) -> i64 {
        self.ints(number).first().copied().unwrap_or_default()
    }

    pub fn float(&self, number: u64) -> Option<f32> {
        self.all(number).next().map(|field| match field {
            Field::Four(bytes) => f32::from_le_bytes(*bytes),
            other => panic!("field {number} is {other:?}"),
        })
    }

    pub fn double(&self, number: u64) -> Option<f64> {
        self.all(number).next().map(|field| match field {
            Field::Eight(bytes) => f64::from_le_bytes(*bytes),
            other => panic!("field {number} is {other:?}"),
        })
    }
}

fn take<'a>(bytes: &mut &'a [u8], length: usize) -> &'a [u8] {
    let (front, back) = bytes.split_at(length);
    *bytes = back;
    front
}

fn varint(bytes: &mut &[u8]) -> u64 {
    let mut value = 0;
    for shift in (0..64).step_by(7) {
        let byte = take(bytes, 1)[0];
        value |= u64::from(byte & 0x7f) << shift;
        if byte < 0x80 {
            return value;
        }
    }
    panic!("a number of more than 64 bits");
}
