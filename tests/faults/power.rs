//! Power cuts: whatever was not synced may be lost. The operations of a run are recorded, and the
//! folder is rebuilt as a cut after any of them could have left it.
//!
//! The model is the loosest that POSIX allows. Bytes that were not synced are missing, cut
//! anywhere, or zeros. A change of a name (a new file or folder, a rename, a removal) that no sync
//! of its folder followed may have happened or not, each by itself, but for one name in order. With
//! a folder's name all goes that is in it.
//!
//! What is promised is what a caller sees: the checkpoints that are there when `Run::advance`
//! returns.

use std::collections::BTreeMap;
use std::fs;
use std::path::{Path, PathBuf};
use std::sync::{Arc, Mutex};

use covers::presets::Method;
use covers::{Run, RunFolder};
use rand::{RngExt, SeedableRng};
use rand_chacha::ChaCha8Rng;

use crate::common::{
    Bytes, Operation, Scratch, Watched, assert_same, bytes, checkpoints, expected, finish, full,
    tiny,
};

/// A file: the bytes that a cut leaves, and those that were written.
#[derive(Clone, Default)]
struct File {
    durable: Vec<u8>,
    written: Vec<u8>,
}

/// What a name points to.
#[derive(Clone, Copy)]
enum Entry {
    /// The file of this number.
    File(usize),
    Folder,
}

/// A file system before a cut: files by number, and what names point to.
struct Model {
    root: PathBuf,
    files: Vec<File>,
    durable: BTreeMap<PathBuf, Entry>,
    now: BTreeMap<PathBuf, Entry>,
    /// What happened to names since their folder was synced.
    pending: Vec<(PathBuf, Option<Entry>)>,
}

impl Model {
    /// A folder that was just made.
    fn new(root: &Path) -> Self {
        let mut model = Self {
            root: root.to_owned(),
            files: Vec::new(),
            durable: BTreeMap::new(),
            now: BTreeMap::new(),
            pending: Vec::new(),
        };
        model.name(root, Some(Entry::Folder));
        model
    }

    fn name(&mut self, path: &Path, entry: Option<Entry>) {
        change(&mut self.now, path.to_owned(), entry);
        self.pending.push((path.to_owned(), entry));
    }

    fn file(&mut self, path: &Path) -> usize {
        if let Some(&Entry::File(file)) = self.now.get(path) {
            return file;
        }
        self.files.push(File::default());
        let file = self.files.len() - 1;
        self.name(path, Some(Entry::File(file)));
        file
    }

    fn apply(&mut self, operation: &Operation) {
        match operation {
            Operation::Write(path, bytes) => {
                let file = self.file(path);
                self.files[file].written.clone_from(bytes);
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
                self.name(to, Some(Entry::File(file)));
                self.name(from, None);
            }
            Operation::Remove(path) => self.name(path, None),
            Operation::CreateFolder(path) => self.name(path, Some(Entry::Folder)),
            Operation::SyncFolder(folder) => {
                let of_folder = |path: &PathBuf| path.parent() == Some(folder);
                let synced = self.pending.extract_if(.., |(path, _)| of_folder(path));
                for (path, entry) in synced {
                    change(&mut self.durable, path, entry);
                }
            }
            Operation::Promise(_) => {}
        }
    }

    /// Makes of `folder` what a cut could leave of the root: possibly nothing.
    fn cut(&self, folder: &Path, rng: &mut ChaCha8Rng) {
        let mut names = self.durable.clone();
        for (path, entry) in &self.pending {
            if rng.random_range(0..2) == 0 {
                change(&mut names, path.clone(), *entry);
            }
        }
        // in the order of paths: a folder comes before what is in it
        for (path, entry) in names {
            let path = folder.join(path.strip_prefix(&self.root).unwrap());
            let is_lost = path.parent().is_none_or(|parent| !parent.is_dir());
            match entry {
                _ if is_lost => {}
                Entry::File(file) => fs::write(path, self.files[file].left(rng)).unwrap(),
                Entry::Folder => fs::create_dir(path).unwrap(),
            }
        }
    }
}

fn change(names: &mut BTreeMap<PathBuf, Entry>, path: PathBuf, entry: Option<Entry>) {
    match entry {
        Some(entry) => names.insert(path, entry),
        None => names.remove(&path),
    };
}

impl File {
    /// What a cut leaves: synced bytes, and of the others some, none, or zeros.
    fn left(&self, rng: &mut ChaCha8Rng) -> Vec<u8> {
        let kept = if self.written.starts_with(&self.durable) {
            self.durable.len()
        } else if rng.random_range(0..2) == 0 {
            return self.durable.clone();
        } else {
            0
        };
        let mut left = self.written.clone();
        left.truncate(rng.random_range(kept..=left.len()));
        if rng.random_range(0..3) == 0 {
            left[kept..].fill(0);
        }
        left
    }
}

/// Rollouts of the newest checkpoint that must survive these operations.
fn promised(operations: &[Operation]) -> usize {
    let promises = operations.iter().filter_map(|operation| match operation {
        Operation::Promise(rollouts) => Some(*rollouts),
        _ => None,
    });
    promises.max().unwrap_or(0)
}

/// Rollouts of the newest checkpoint that is there.
fn saved(folder: &Path) -> Option<usize> {
    let names = checkpoints(folder).into_iter();
    let numbers = names.filter_map(|path| {
        let name = path.file_name()?.to_str()?;
        name.strip_suffix(".safetensors")?.parse().ok()
    });
    numbers.max()
}

fn record(scratch: &Scratch) -> (PathBuf, Vec<Operation>) {
    let operations = Arc::new(Mutex::new(Vec::new()));
    let recorded = Arc::clone(&operations);
    let disk = Watched(move |operation: &Operation| {
        // no folder is made twice
        let is_there = matches!(operation, Operation::CreateFolder(path) if path.exists());
        recorded.lock().unwrap().extend((!is_there).then(|| operation.clone()));
        Ok(())
    });
    let folder = scratch.run("recorded").with_disk(Arc::new(disk));
    let path = folder.path().to_owned();
    let mut run = Run::start(tiny(Method::Covers), folder).unwrap();
    while run.advance().unwrap().is_some() {
        operations.lock().unwrap().push(Operation::Promise(saved(&path).unwrap()));
    }
    assert_same(&bytes(&path), expected());
    let operations = operations.lock().unwrap().clone();
    (path, operations)
}

/// Goes on in what a cut left.
fn go_on(folder: &Path) -> Run {
    if RunFolder::from_path(folder).holds_run() {
        return Run::resume(folder, Some(2)).unwrap();
    }
    fs::create_dir_all(folder).unwrap();
    Run::start(tiny(Method::Covers), RunFolder::from_path(folder)).unwrap()
}

fn check(folder: &Path, promised: usize, expected: &Bytes, to_the_end: bool) {
    let run = go_on(folder);
    let rollouts = run.stats().rollouts;
    assert!(rollouts >= promised, "{rollouts} rollouts, {promised} were promised");
    // a header, and a row for each rollout; nothing before the first
    let rows = if rollouts > 0 { 1 + rollouts } else { 0 };
    let lines = expected[Path::new("metrics.csv")].split_inclusive(|&byte| byte == b'\n');
    let metrics = fs::read(folder.join("metrics.csv")).unwrap();
    assert!(metrics == lines.take(rows).collect::<Vec<_>>().concat());
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
    let (step, trials, ends) = if full() { (1, 4, 10) } else { (19, 1, 5) };
    let (mut model, mut cuts) = (Model::new(&original), 0);
    for (index, operation) in operations.iter().enumerate() {
        model.apply(operation);
        if index % step > 0 && !matches!(operation, Operation::Promise(_)) {
            continue;
        }
        for _ in 0..trials {
            let folder = scratch.0.join("cut");
            model.cut(&folder, &mut rng);
            let promised = promised(&operations[..=index]);
            check(&folder, promised, expected, cuts % ends == 0);
            fs::remove_dir_all(&folder).unwrap();
            cuts += 1;
        }
    }
    println!("{cuts} cuts after {} operations", operations.len());
}

/// What 100 cuts leave of a file.
fn cuts(scratch: &Scratch, model: &Model, name: &str) -> Vec<Option<Vec<u8>>> {
    let cut = |seed| {
        let folder = scratch.0.join("left");
        model.cut(&folder, &mut ChaCha8Rng::seed_from_u64(seed));
        let left = fs::read(folder.join(name)).ok();
        let _ = fs::remove_dir_all(&folder);
        left
    };
    (0..100).map(cut).collect()
}

#[test]
fn the_model_loses_what_was_not_synced() {
    let scratch = Scratch::new("model");
    let path = |name: &str| Path::new("/run").join(name);
    let mut model = Model::new(&path(""));
    let apply = |disk: &mut Model, operations: &[Operation]| {
        operations.iter().for_each(|operation| disk.apply(operation));
    };
    let left = |disk: &Model, name: &str, bytes: &[u8]| {
        let cuts = cuts(&scratch, disk, name);
        cuts.iter().filter(|left| left.as_deref() == Some(bytes)).count()
    };
    let sync = |folder: &str| Operation::SyncFolder(PathBuf::from(folder));
    let write = |name: &str| Operation::Write(path(name), b"whole".to_vec());
    apply(&mut model, &[write("a.partial"), sync("/run"), sync("/")]);
    // names are there, bytes are not yet
    for part in [&b""[..], b"who", b"\0\0\0", b"whole"] {
        assert!((1..100).contains(&left(&model, "a.partial", part)), "{part:?}");
    }
    let rename = Operation::Rename(path("a.partial"), path("a"));
    apply(&mut model, &[Operation::Sync(path("a.partial")), rename]);
    assert!((1..100).contains(&left(&model, "a", b"whole")));
    apply(&mut model, &[sync("/run")]);
    assert_eq!(left(&model, "a", b"whole"), 100);
    assert_eq!(left(&model, "a.partial", b"whole"), 0);
    // what was synced stays when more is appended, and may go when it is written anew
    apply(&mut model, &[Operation::Append(path("a"), b"row".to_vec())]);
    for part in [&b"whole"[..], b"wholero", b"whole\0\0\0"] {
        assert!(left(&model, "a", part) > 0, "{part:?}");
    }
    assert_eq!(left(&model, "a", b"who"), 0);
    apply(&mut model, &[Operation::Write(path("a"), b"other".to_vec())]);
    for part in [&b"whole"[..], b"oth", b"other"] {
        assert!(left(&model, "a", part) > 0, "{part:?}");
    }
    // a folder goes with all that is in it
    let folder = Operation::CreateFolder(path("folder"));
    let synced = [write("folder/b"), Operation::Sync(path("folder/b")), sync("/run/folder")];
    apply(&mut model, &[folder]);
    apply(&mut model, &synced);
    assert!((1..100).contains(&left(&model, "folder/b", b"whole")));
    apply(&mut model, &[sync("/run")]);
    assert_eq!(left(&model, "folder/b", b"whole"), 100);
}
