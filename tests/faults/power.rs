//! Power cuts: whatever was not synced may be lost. The operations of a run are recorded, and the
//! folder is rebuilt as a cut after any of them could have left it.
//!
//! The model is the loosest that POSIX allows. Bytes that were not synced are missing, cut anywhere,
//! or zeros. A change of a name (a new file, a rename, a removal) that no sync of the folder followed
//! may have happened or not, each by itself, but for one name in order.

use std::collections::BTreeMap;
use std::fs;
use std::io;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

use covers::presets::Method;
use covers::{Disk, LocalDisk, Run, RunFolder};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::common::{Bytes, Scratch, assert_same, expected, finish, full, tiny};

#[derive(Clone, Debug)]
enum Operation {
    Write(PathBuf, Vec<u8>),
    Append(PathBuf, Vec<u8>),
    Sync(PathBuf),
    Rename(PathBuf, PathBuf),
    Remove(PathBuf),
    SyncFolder(PathBuf),
}

/// The real disk, and a list of all that was done to it.
#[derive(Debug, Default)]
struct Recording(Mutex<Vec<Operation>>);

impl Recording {
    fn note(&self, operation: Operation) {
        self.0.lock().unwrap().push(operation);
    }
}

impl Disk for Recording {
    fn write(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        self.note(Operation::Write(path.to_owned(), bytes.to_vec()));
        LocalDisk.write(path, bytes)
    }

    fn append(&self, path: &Path, bytes: &[u8]) -> io::Result<()> {
        self.note(Operation::Append(path.to_owned(), bytes.to_vec()));
        LocalDisk.append(path, bytes)
    }

    fn sync(&self, path: &Path) -> io::Result<()> {
        self.note(Operation::Sync(path.to_owned()));
        LocalDisk.sync(path)
    }

    fn rename(&self, from: &Path, to: &Path) -> io::Result<()> {
        self.note(Operation::Rename(from.to_owned(), to.to_owned()));
        LocalDisk.rename(from, to)
    }

    fn remove(&self, path: &Path) -> io::Result<()> {
        self.note(Operation::Remove(path.to_owned()));
        LocalDisk.remove(path)
    }

    fn create_folder(&self, path: &Path) -> io::Result<()> {
        // always synced at once; a cut before leaves a folder without checkpoints either way
        LocalDisk.create_folder(path)
    }

    fn sync_folder(&self, path: &Path) -> io::Result<()> {
        self.note(Operation::SyncFolder(path.to_owned()));
        LocalDisk.sync_folder(path)
    }
}

/// A file: the bytes that a cut leaves, and those that were written.
#[derive(Clone, Default)]
struct File {
    durable: Vec<u8>,
    written: Vec<u8>,
}

/// A file system before a cut: files by number, and what names point to.
#[derive(Clone, Default)]
struct Model {
    files: Vec<File>,
    durable: BTreeMap<PathBuf, usize>,
    now: BTreeMap<PathBuf, usize>,
    /// What happened to names since their folder was synced.
    pending: Vec<(PathBuf, Option<usize>)>,
}

impl Model {
    fn name(&mut self, path: &Path, file: Option<usize>) {
        match file {
            Some(file) => self.now.insert(path.to_owned(), file),
            None => self.now.remove(path),
        };
        self.pending.push((path.to_owned(), file));
    }

    fn file(&mut self, path: &Path) -> usize {
        if let Some(&file) = self.now.get(path) {
            return file;
        }
        self.files.push(File::default());
        let file = self.files.len() - 1;
        self.name(path, Some(file));
        file
    }

    fn apply(&mut self, operation: &Operation) {
        match operation {
            Operation::Write(path, bytes) => {
                let file = self.file(path);
                self.files[file].written.clone_from(bytes);
                self.files[file].durable.clone_from(bytes);
            }
            Operation::Append(path, bytes) => {
                let file = self.file(path);
                self.files[file].written.extend(bytes);
            }
            Operation::Sync(path) => {
                let file = self.file(path);
                self.files[file].durable = self.files[file].written.clone();
            }
            Operation::Rename(from, to) => {
                let file = self.file(from);
                self.name(to, Some(file));
                self.name(from, None);
            }
            Operation::Remove(path) => self.name(path, None),
            Operation::SyncFolder(folder) => {
                let of_folder = |path: &PathBuf| path.parent() == Some(folder);
                let synced = self.pending.extract_if(.., |(path, _)| of_folder(path));
                for (path, file) in synced {
                    change(&mut self.durable, path, file);
                }
            }
        }
    }

    /// Writes into `folder` what a cut could leave of `original`.
    fn cut(&self, original: &Path, folder: &Path, rng: &mut ChaCha8Rng) {
        let mut names = self.durable.clone();
        for (path, file) in &self.pending {
            if rng.random_range(0..2) == 0 {
                change(&mut names, path.clone(), *file);
            }
        }
        fs::create_dir_all(folder.join("checkpoints")).unwrap();
        for (path, file) in names {
            let path = folder.join(path.strip_prefix(original).unwrap());
            fs::write(path, self.files[file].left(rng)).unwrap();
        }
    }
}

fn change(names: &mut BTreeMap<PathBuf, usize>, path: PathBuf, file: Option<usize>) {
    match file {
        Some(file) => names.insert(path, file),
        None => names.remove(&path),
    };
}

impl File {
    /// What a cut leaves: synced bytes, and of the others some, none, or zeros.
    fn left(&self, rng: &mut ChaCha8Rng) -> Vec<u8> {
        let synced = self.durable.len();
        if !self.written.starts_with(&self.durable) {
            return self.durable.clone();
        }
        let mut left = self.written.clone();
        left.truncate(rng.random_range(synced..=left.len()));
        if rng.random_range(0..3) == 0 {
            left[synced..].fill(0);
        }
        left
    }
}

/// Rollouts of the newest checkpoint whose writing had returned within these operations.
fn promised(operations: &[Operation]) -> usize {
    let number = |path: &Path| {
        let name = path.to_str()?.strip_suffix(".safetensors")?;
        name.rsplit('/').next()?.parse().ok()
    };
    let mut promised = 0;
    for pair in operations.windows(2) {
        if let [Operation::Rename(_, to), Operation::SyncFolder(_)] = pair {
            promised = promised.max(number(to).unwrap_or(0));
        }
    }
    promised
}

/// The recorded operations of a whole run, and its folder.
fn record(scratch: &Scratch) -> (PathBuf, Vec<Operation>) {
    let disk = Arc::new(Recording::default());
    let folder = scratch
        .run("recorded")
        .with_disk(Arc::<Recording>::clone(&disk));
    let path = folder.path().to_owned();
    finish(Run::start(tiny(Method::Covers), folder).unwrap());
    let operations = disk.0.lock().unwrap().clone();
    (path, operations)
}

fn check(folder: &Path, promised: usize, expected: &Bytes, to_the_end: bool) {
    let run = if RunFolder::open(folder).holds_run() {
        Run::resume(folder, Some(2)).unwrap()
    } else {
        assert_eq!(promised, 0);
        Run::start(tiny(Method::Covers), RunFolder::open(folder)).unwrap()
    };
    let rollouts = run.ledger().rollouts;
    assert!(
        rollouts >= promised,
        "{rollouts} rollouts, {promised} were promised"
    );
    let metrics = fs::read(folder.join("metrics.csv")).unwrap();
    assert!(expected[Path::new("metrics.csv")].starts_with(&metrics));
    if to_the_end {
        assert_same(&finish(run), expected);
    }
}

#[test]
fn a_power_cut_after_any_operation_loses_no_checkpoint_that_was_written() {
    let scratch = Scratch::new("power");
    let expected = expected();
    let (original, operations) = record(&scratch);
    let mut rng = ChaCha8Rng::seed_from_u64(5);
    let (step, trials, ends) = if full() { (1, 4, 10) } else { (13, 1, 4) };
    let (mut model, mut cuts) = (Model::default(), 0);
    for (index, operation) in operations.iter().enumerate() {
        model.apply(operation);
        if index % step > 0 {
            continue;
        }
        for _ in 0..trials {
            let folder = scratch.0.join("cut");
            model.cut(&original, &folder, &mut rng);
            let promised = promised(&operations[..=index]);
            check(&folder, promised, expected, cuts % ends == 0);
            fs::remove_dir_all(&folder).unwrap();
            cuts += 1;
        }
    }
    println!("{cuts} cuts after {} operations", operations.len());
}

#[test]
fn the_model_loses_what_was_not_synced() {
    let scratch = Scratch::new("model");
    let (from, to) = (PathBuf::from("/run/a.partial"), PathBuf::from("/run/a"));
    let mut model = Model::default();
    model.apply(&Operation::Write(from.clone(), b"whole".to_vec()));
    model.apply(&Operation::Rename(from, to.clone()));
    model.apply(&Operation::Append(
        PathBuf::from("/run/log"),
        b"row".to_vec(),
    ));
    let left = |model: &Model, seed| {
        let folder = scratch.0.join("left");
        model.cut(
            Path::new("/run"),
            &folder,
            &mut ChaCha8Rng::seed_from_u64(seed),
        );
        let read = |name: &str| fs::read(folder.join(name)).ok();
        let left = (read("a"), read("log"));
        fs::remove_dir_all(&folder).unwrap();
        left
    };
    let cuts: Vec<_> = (0..100).map(|seed| left(&model, seed)).collect();
    assert!(cuts.iter().any(|(a, _)| a.is_none()));
    assert!(cuts.iter().any(|(a, _)| a.as_deref() == Some(b"whole")));
    assert!(cuts.iter().any(|(_, log)| log.as_deref() == Some(b"ro")));
    assert!(
        cuts.iter()
            .any(|(_, log)| log.as_deref() == Some(b"\0\0\0"))
    );
    model.apply(&Operation::SyncFolder(PathBuf::from("/run")));
    assert!((0..100).all(|seed| left(&model, seed).0.as_deref() == Some(b"whole")));
}
