//! What is kept of one world, and the file that keeps it.

use std::fs::{File, OpenOptions};
use std::io::{self, Write as _};
use std::path::Path;
use std::sync::{Mutex, PoisonError};

use worlds::Kind;

use crate::arguments::{Plan, kind};

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

    fn line(&self, plan: &str) -> String {
        let counts = self.counts.map(|count| count.to_string()).join(",");
        format!("{},{},{plan},{counts}", self.kind.name(), self.seed)
    }

    fn read(line: &str, plan: &str) -> Option<Self> {
        let (name, rest) = line.split_once(',')?;
        let (seed, rest) = rest.split_once(',')?;
        let counts = rest.strip_prefix(plan)?.strip_prefix(',')?;
        let counts: Option<Vec<usize>> = counts.split(',').map(|word| word.parse().ok()).collect();
        Some(Self {
            kind: kind(name)?,
            seed: seed.parse().ok()?,
            counts: counts?.try_into().ok()?,
        })
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
    /// Reads what the file holds of streams like `plan`. A last line that was broken off is left
    /// behind and not counted.
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
        if text.is_empty() {
            let names = Record::COUNTS.join(",");
            writeln!(file, "kind,seed,visits,stay,forced,{names}")?;
        } else if !text.ends_with('\n') {
            writeln!(file)?;
        }
        let whole = text.lines().filter_map(|line| Record::read(line, &plan));
        Ok(Self {
            known: whole.collect(),
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

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn results_are_found_again_and_a_broken_line_is_not() {
        let name = format!("worlds-study-{}.csv", std::process::id());
        let path = std::env::temp_dir().join(name);
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
        std::fs::write(&path, text + "shape,8,two,12-40,none,1,2").unwrap();
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
