//! What the command line says.

use std::ops::RangeInclusive;
use std::path::PathBuf;

use worlds::Kind;

use crate::trial::TrialError;

/// `FIRST COUNT [KIND] [--visits N] [--stay A-B] [--alarms] [--csv FILE] [--explain]`
#[derive(Clone, Debug, PartialEq)]
pub struct Arguments {
    /// Seeds of the worlds: the first, and how many.
    pub seeds: std::ops::Range<u64>,
    pub kinds: Vec<Kind>,
    pub plan: Plan,
    /// Where results are kept; worlds that are in it are not run again.
    pub csv: Option<PathBuf>,
    /// Whether every decision is printed.
    pub explain: bool,
}

/// What a stream looks like.
#[derive(Clone, Debug, PartialEq)]
pub struct Plan {
    /// Visits of all groups together; without a number two of each group.
    pub visits: Option<usize>,
    /// Rounds that a visit lasts.
    pub stay: RangeInclusive<usize>,
    /// Whether a superfluous policy is opened by force in the third turn of each group.
    pub alarms: bool,
}

impl Default for Plan {
    /// Three rollouts to ten, with switches in the middle of some.
    fn default() -> Self {
        Self {
            visits: None,
            stay: 12..=40,
            alarms: false,
        }
    }
}

impl Arguments {
    /// Reads the words of the command line.
    pub fn read(mut words: impl Iterator<Item = String>) -> Result<Self, TrialError> {
        let mut positional = Vec::new();
        let (mut plan, mut csv, mut explain) = (Plan::default(), None, false);
        while let Some(word) = words.next() {
            let mut value = || words.next().ok_or(TrialError::Argument(word.clone()));
            match word.as_str() {
                "--visits" => plan.visits = Some(number(&value()?)?),
                "--stay" => plan.stay = range(&value()?)?,
                "--csv" => csv = Some(value()?.into()),
                "--alarms" => plan.alarms = true,
                "--explain" => explain = true,
                _ => positional.push(word),
            }
        }
        if let Some(word) = positional.get(3) {
            return Err(TrialError::Argument(word.clone()));
        }
        let seed = |index: usize, default| match positional.get(index) {
            Some(word) => number(word),
            None => Ok(default),
        };
        let (first, count) = (seed(0, 1000)?, seed(1, 10)?);
        let kinds = match positional.get(2) {
            Some(name) => vec![kind(name).ok_or(TrialError::Argument(name.clone()))?],
            None => Kind::ALL.to_vec(),
        };
        Ok(Self {
            seeds: first..first + count,
            kinds,
            plan,
            csv,
            explain,
        })
    }
}

/// The kind of this name.
pub fn kind(name: &str) -> Option<Kind> {
    Kind::ALL.into_iter().find(|kind| kind.name() == name)
}

fn number<T: std::str::FromStr>(word: &str) -> Result<T, TrialError> {
    let number = word.parse();
    number.map_err(|_| TrialError::Argument(word.to_owned()))
}

/// Two numbers with a dash between them.
fn range(word: &str) -> Result<RangeInclusive<usize>, TrialError> {
    let (from, to) = word
        .split_once('-')
        .ok_or(TrialError::Argument(word.to_owned()))?;
    let (from, to) = (number(from)?, number(to)?);
    match (1..=to).contains(&from) {
        true => Ok(from..=to),
        false => Err(TrialError::Argument(word.to_owned())),
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn read(line: &str) -> Result<Arguments, TrialError> {
        Arguments::read(line.split_whitespace().map(str::to_owned))
    }

    #[test]
    fn words_are_read_in_any_order_and_wrong_ones_are_named() {
        let read_all = read("--stay 4-12 1100 3 target --visits 100 --explain").unwrap();
        assert_eq!(
            (read_all.seeds, read_all.kinds),
            (1100..1103, vec![Kind::Target])
        );
        assert_eq!(
            (read_all.plan.visits, read_all.plan.stay),
            (Some(100), 4..=12)
        );
        assert_eq!(read("").unwrap().kinds.len(), Kind::ALL.len());
        for wrong in [
            "1000 x",
            "--stay 5",
            "--stay 0-4",
            "--stay 9-4",
            "1000 2 targets",
            "1000 2 target 7",
            "--csv",
        ] {
            let word = wrong.split_whitespace().last().unwrap();
            assert!(
                read(wrong).unwrap_err().to_string().contains(word),
                "{wrong}"
            );
        }
    }
}
