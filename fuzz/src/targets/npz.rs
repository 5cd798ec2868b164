//! Fuzz target of recordings in npz archives.

use std::io::{Cursor, Write};

use zip::write::SimpleFileOptions;
use zip::{CompressionMethod, ZipWriter};

use super::{Reading, Target, accepted, measured};

// this module is private to the crate that reads recordings
#[allow(dead_code)]
#[path = "../../../src/check/npz.rs"]
mod reader;

/// Target of npz archives. Deflate expands a byte to at most 1032, whose copies are at most twice
/// as large, and a boolean of one byte becomes a number of eight.
pub const NPZ: Target =
    Target::new("npz", read, seeds).holding(1032 * (2 + 8), 1 << 12).tried(5_000);

/// Reads an archive after an even byte, and after an odd byte one file that is packed here. Few
/// mutations of an archive would reach the parser of its files, since it has checksums.
fn read(input: &[u8]) -> Option<Reading> {
    let (&kind, rest) = input.split_first()?;
    let archive = match kind % 2 {
        0 => rest.to_vec(),
        _ => pack(&[("reward", rest)], CompressionMethod::Stored)?,
    };
    measured(|| match reader::Npz::new(Cursor::new(&archive)) {
        Ok(mut npz) => reads(&mut npz, "reward", &[0, 0]) | reads(&mut npz, "qpos", &[0, 0, 3]),
        Err(error) => accepted(Err::<(), _>(error)),
    })
}

fn reads(npz: &mut reader::Npz<Cursor<&Vec<u8>>>, name: &str, shape: &[usize]) -> bool {
    let array = npz.array(name, shape);
    if let Ok(array) = &array {
        assert!(!array.row(&[0]).is_empty());
    }
    accepted(array)
}

fn pack(files: &[(&str, &[u8])], method: CompressionMethod) -> Option<Vec<u8>> {
    let mut archive = ZipWriter::new(Cursor::new(Vec::new()));
    let options = SimpleFileOptions::default().compression_method(method);
    for (name, content) in files {
        archive.start_file(format!("{name}.npy"), options).ok()?;
        archive.write_all(content).ok()?;
    }
    Some(archive.finish().ok()?.into_inner())
}

fn npy(kind: &str, shape: &str, values: &[u8]) -> Vec<u8> {
    let header = format!("{{'descr': '{kind}', 'fortran_order': False, 'shape': ({shape}), }}\n");
    let length = (header.len() as u16).to_le_bytes();
    [b"\x93NUMPY\x01\x00", &length[..], header.as_bytes(), values].concat()
}

fn reward() -> Vec<u8> {
    let values = [1.5_f64, -2.0].map(f64::to_le_bytes).concat();
    npy("<f8", "2, 1", &values)
}

fn qpos() -> Vec<u8> {
    npy("<f8", "1, 2, 3", &[0; 48])
}

/// Returns two archives of the same files, and a small one that expands to much.
fn archives() -> [Option<Vec<u8>>; 3] {
    let (reward, qpos) = (reward(), qpos());
    let bomb = npy("|b1", "100, 1000", &[1; 100_000]);
    let files = [("reward", &reward[..]), ("qpos", &qpos)];
    [
        pack(&files, CompressionMethod::Stored),
        pack(&files, CompressionMethod::Deflated),
        pack(&[("reward", &bomb)], CompressionMethod::Deflated),
    ]
}

fn seeds() -> Vec<Vec<u8>> {
    let files = [reward(), qpos(), npy("|b1", "2, 2", &[1, 0, 0, 1])];
    let archives = archives().into_iter().flatten();
    let archives = archives.map(|archive| [&[0], &archive[..]].concat());
    let files = files.into_iter().map(|file| [&[1], &file[..]].concat());
    archives.chain(files).collect()
}
