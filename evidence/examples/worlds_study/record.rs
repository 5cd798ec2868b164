//! What is kept of one world, and the file that keeps it.

use std::fs::{File, OpenOptions};
use std::io::{self, Error, Write as _};
use std::path::Path;
use std::sync::{Mutex, PoisonError};

use worlds::Kind;

use crate::arguments::{Plan, kind};

/// What is drawn, decided and counted. A change of any of that is another version, and results of
/// two versions do not belong into one table.
const VERSION: &str = "6";

/// Counts of one world.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Record {
    pub kind: Kind,
    pub seed: u64,
    pub counts: [usize; Self::LEN],
}

/// What is counted.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
#[repr(usize)]
pub enum Count {
    /// Policies that the world asks for.
    Groups,
    Policies,
    /// 1 if policies and groups belong to each other one to one.
    Exact,
    Turns,
    /// Rounds of all turns.
    Rounds,
    /// Turns after their group's first visit, and those of them that are right.
    Known,
    Right,
    /// The first turn of each returning group, and those of them that are right.
    Switches,
    Noticed,
    /// First rollouts of a turn with a switch in them, and those that were cut there.
    Mixed,
    Split,
    /// Episodes learnt from, and those of them that another policy should have learnt from.
    Learnt,
    Foreign,
    /// Policies that were merged into another one.
    Merged,
    /// Time of the decisions of the slowest turn, in microseconds.
    Slowest,
    /// Size of the recogniser's state as text, in bytes.
    State,
}

impl Record {
    /// The number of counts.
    pub const LEN: usize = 16;

    const COUNTS: [&str; Self::LEN] = [
        "groups",
        "policies",
        "exact",
        "turns",
        "rounds",
        "known",
        "right",
        "switches",
        "noticed",
        "mixed",
        "split",
        "learnt",
        "foreign",
        "merged",
        "slowest_us",
        "state_bytes",
    ];

    pub fn get(&self, count: Count) -> usize {
        self.counts[count as usize]
    }

    /// The first line of a file.
    fn header() -> String {
        let names = Self::COUNTS.join(",");
        format!("version,kind,seed,visits,stay,forced,{names}")
    }

    fn line(&self, plan: &str) -> String {
        let counts = self.counts.map(|count| count.to_string()).join(",");
        format!(
            "{VERSION},{},{},{plan},{counts}",
            self.kind.name(),
            self.seed
        )
    }

    /// The record of a line, and the columns of its plan.
    fn read(line: &str) -> Option<(Self, String)> {
        let cells: Vec<&str> = line.split(',').collect();
        let ([version, name, seed], rest) = cells.split_first_chunk()?;
        let (plan, counts) = rest.split_first_chunk::<3>()?;
        let counts: Option<Vec<usize>> = counts.iter().map(|cell| cell.parse().ok()).collect();
        let record = Self {
            kind: kind(name)?,
            seed: seed.parse().ok()?,
            counts: counts?.try_into().ok()?,
        };
        (*version == VERSION).then(|| (record, plan.join(",")))
    }
}

impl Plan {
    /// Visits, their rounds and what is forced, in three columns.
    fn columns(&self) -> String {
        let visits = self.visits.map_or("two".to_owned(), |n| n.to_string());
        let alarms = if self.alarms { "alarms" } else { "none" };
        format!(
            "{visits},{}-{},{alarms}",
            self.stay.start(),
            self.stay.end()
        )
    }
}

/// Results as they come in; in a file, if one is named, to which others may be added later.
pub struct Results {
    plan: String,
    file: Option<Mutex<File>>,
    known: Vec<Record>,
}

impl Results {
    /// Reads what the file holds of streams like `plan`. A last line that was broken off is
    /// removed.
    ///
    /// # Errors
    /// A file's, and a line that this version did not write.
    pub fn open(path: Option<&Path>, plan: &Plan) -> io::Result<Self> {
        let plan = plan.columns();
        let Some(path) = path else {
            return Ok(Self {
                plan,
                file: None,
                known: Vec::new(),
            });
        };
        let mut file = OpenOptions::new().append(true).create(true).open(path)?;
        let text = std::fs::read_to_string(path)?;
        let whole = text.rfind('\n').map_or(0, |last| last + 1);
        let rows = rows(&text[..whole]).map_err(|problem| {
            let (path, expected) = (path.display(), Record::header());
            Error::other(format!(
                "{path}: {problem}, expected version {VERSION} with the columns {expected}; begin \
                 another file"
            ))
        })?;
        if whole == 0 && !Record::header().starts_with(&text) {
            return Err(Error::other(format!(
                "{} holds something else, not a table of this study; name another file",
                path.display()
            )));
        }
        file.set_len(whole as u64)?;
        if whole == 0 {
            writeln!(file, "{}", Record::header())?;
        }
        let known = rows.into_iter().filter(|(_, own)| *own == plan);
        Ok(Self {
            known: known.map(|(record, _)| record).collect(),
            file: Some(Mutex::new(file)),
            plan,
        })
    }

    /// What the file held of this world.
    pub fn known(&self, kind: Kind, seed: u64) -> Option<Record> {
        let mut known = self.known.iter();
        known.find(|r| r.kind == kind && r.seed == seed).copied()
    }

    /// Adds a line, at once.
    pub fn add(&self, record: &Record) -> io::Result<()> {
        match &self.file {
            Some(file) => {
                let line = record.line(&self.plan) + "\n";
                let mut file = file.lock().unwrap_or_else(PoisonError::into_inner);
                file.write_all(line.as_bytes())
            }
            None => Ok(()),
        }
    }
}

/// The rows of whole lines, or what is wrong with the first line that cannot be read.
fn rows(text: &str) -> Result<Vec<(Record, String)>, String> {
    let mut lines = text.lines();
    if let Some(header) = lines.next().filter(|line| *line != Record::header()) {
        return Err(format!("got the columns {header}"));
    }
    let read = |line: &str| Record::read(line).ok_or(format!("got the line {line}"));
    lines.map(read).collect()
}

#[cfg(test)]
mod tests {
    use std::path::PathBuf;

    use super::*;

    fn scratch(name: &str) -> PathBuf {
        let name = format!("worlds-study-{name}-{}.csv", std::process::id());
        std::env::temp_dir().join(name)
    }

    #[test]
    fn lines_of_another_version_are_refused() {
        let path = scratch("version");
        let record = "shape,7,two,12-40,none,8,8,1,84,424,47,47,8,8,9,9,333,0,0,431987,478045";
        let names = "kind,seed,visits,stay,forced,groups,policies,exact,turns,rounds,known,right,\
                     switches,noticed,mixed,split,learnt,foreign,merged,slowest_us,state_bytes";
        let first = format!("{names}\n{record}\n");
        let other = format!("version,{names}\n2,{record}\n");
        for text in [first, other] {
            std::fs::write(&path, &text).unwrap();
            let refused = Results::open(Some(&path), &Plan::default()).err().unwrap();
            let message = refused.to_string();
            let expected = format!("expected version {VERSION} with");
            assert!(message.contains(&expected), "{message}");
            assert_eq!(std::fs::read_to_string(&path).unwrap(), text);
        }
        std::fs::remove_file(&path).unwrap();
    }

    #[test]
    fn results_are_found_again_and_a_broken_line_is_not() {
        let path = scratch("broken");
        let plan = Plan::default();
        let record = Record {
            kind: Kind::Shape,
            seed: 7,
            counts: std::array::from_fn(|i| i),
        };
        let results = Results::open(Some(&path), &plan).unwrap();
        assert_eq!(results.known(Kind::Shape, 7), None);
        results.add(&record).unwrap();
        let text = std::fs::read_to_string(&path).unwrap();
        let broken = Record { seed: 8, ..record }.line(&plan.columns());
        // within the last number
        std::fs::write(&path, text + &broken[..broken.len() - 1]).unwrap();
        let again = Results::open(Some(&path), &plan).unwrap();
        assert_eq!(again.known(Kind::Shape, 7), Some(record));
        assert_eq!(again.known(Kind::Shape, 8), None);
        again.add(&Record { seed: 8, ..record }).unwrap();
        let short = Plan {
            visits: Some(100),
            ..Plan::default()
        };
        assert_eq!(Results::open(Some(&path), &short).unwrap().known.len(), 0);
        assert_eq!(Results::open(Some(&path), &plan).unwrap().known.len(), 2);
        std::fs::remove_file(&path).unwrap();
    }
}
