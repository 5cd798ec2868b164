//! Fuzz target of networks, and the format that all files of tensors share.

use std::ops::Range;
use std::path::Path;

use equivariant::{Layer, LayerSignature, Linear, Relu, Sequential, Shape};
use serde_json::Value;
use symmetry::Group;

use super::{Reading, Target, accepted, in_file, measured};

pub const NETWORK: Target =
    Target::new("network", |input| in_file("network", input, read_network), networks)
        .holding(64, 1 << 12)
        .tried(5_000);

/// Builds a checkpoint from its parts: its metadata (JSON), the list of its arrays (JSON), and
/// their bytes. Lengths and the checksum are computed, so that mutations of a part get past their
/// checks.
pub fn sealed(envelope: &str, arrays: &str, data: &[u8]) -> Option<Vec<u8>> {
    let envelope = Value::from(envelope);
    let arrays = arrays.strip_prefix('{')?;
    let header = format!(r#"{{"__metadata__":{{"covers":{envelope}}},{arrays}"#);
    let length = (header.len() as u64).to_le_bytes();
    let mut file = [&length[..], header.as_bytes(), data].concat();
    if let Some(place) = checksum_place(&header, file.len() - data.len()) {
        let checksum = crc32fast::hash(&file);
        file.get_mut(place)?.copy_from_slice(&checksum.to_le_bytes());
    }
    Some(file)
}

/// Returns the range of the checksum in a file whose arrays begin at `start`. Its bytes count as
/// zeros in the checksum itself.
fn checksum_place(header: &str, start: usize) -> Option<Range<usize>> {
    let header: Value = serde_json::from_str(header).ok()?;
    let offset = header["checksum"]["data_offsets"][0].as_u64()?;
    let start = usize::try_from(offset).ok()?.checked_add(start)?;
    Some(start..start.checked_add(4)?)
}

/// Splits a checkpoint into its parts, with zeros for the checksum.
pub fn parts(file: &[u8]) -> Option<(String, String, Vec<u8>)> {
    let length = u64::from_le_bytes(*file.first_chunk()?);
    let (header, data) = file[8..].split_at_checked(usize::try_from(length).ok()?)?;
    let mut header: Value = serde_json::from_slice(header).ok()?;
    let metadata = header.as_object_mut()?.remove("__metadata__")?;
    let envelope = metadata["covers"].as_str()?.to_owned();
    let offset = header["checksum"]["data_offsets"][0].as_u64()?;
    let mut data = data.to_vec();
    data[offset as usize..][..4].fill(0);
    Some((envelope, header.to_string(), data))
}

fn network() -> Option<Sequential<f32>> {
    let (from, to) = (Group::D2.trivial_type(2), Group::D2.regular_type(1));
    let layers: [Box<dyn Layer<f32>>; 3] = [
        Box::new(Linear::new(from, to).ok()?),
        Box::new(Relu::new(Shape::vector(to)).ok()?),
        Box::new(Linear::new(to, from).ok()?),
    ];
    Sequential::new(layers.into()).ok()
}

fn read_network(path: &Path) -> Option<Reading> {
    let network = network()?;
    measured(|| {
        let params = equivariant::load_safetensors(path, &network);
        if let Ok(params) = &params {
            assert_eq!(params.len(), network.num_params());
        }
        accepted(params)
    })
}

fn networks() -> Vec<Vec<u8>> {
    let saved = network().and_then(|network| {
        let params = vec![0.5; network.num_params()];
        in_file("network-seed", &[], |path| {
            equivariant::save_safetensors(path, &network, &params).ok()?;
            std::fs::read(path).ok()
        })
    });
    saved.into_iter().collect()
}
