//! The table.

use std::fmt;

use worlds::Kind;

use crate::record::{Count, Record};
use crate::trial::ROUNDS;

/// One line of the table.
pub struct Report<'a> {
    kind: Kind,
    records: &'a [Record],
}

impl<'a> Report<'a> {
    pub const HEADER: &'static str = "| worlds | number | exact policies | most superfluous \
| most missing | right after first visits | switches noticed at once | mixed rollouts \
| split exactly | learnt by the wrong policy | rollouts a turn | policies merged | slowest decisions |\n\
|---|---|---|---|---|---|---|---|---|---|---|---|---|";

    pub fn new(kind: Kind, records: &'a [Record]) -> Self {
        Self { kind, records }
    }

    fn sum(&self, count: Count) -> usize {
        self.records.iter().map(|record| record.get(count)).sum()
    }

    /// A share in per cent; a dash where nothing was asked.
    fn share(&self, part: Count, whole: Count) -> String {
        match self.sum(whole) {
            0 => "-".to_owned(),
            whole => format!("{:.1} %", 100.0 * self.sum(part) as f64 / whole as f64),
        }
    }

    /// The largest excess of one count over another.
    fn most(&self, count: Count, over: Count) -> usize {
        let excess = |record: &Record| record.get(count).saturating_sub(record.get(over));
        self.records.iter().map(excess).max().unwrap_or(0)
    }
}

impl fmt::Display for Report<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let worlds = self.records.len();
        let slowest = self.records.iter().map(|r| r.get(Count::Slowest)).max();
        write!(
            f,
            "| {} | {worlds} | {:.1} % | {} | {} | {} | {} | {} | {} | {} | {:.2} | {} | {} ms |",
            self.kind.name(),
            100.0 * self.sum(Count::Exact) as f64 / worlds.max(1) as f64,
            self.most(Count::Policies, Count::Groups),
            self.most(Count::Groups, Count::Policies),
            self.share(Count::Right, Count::Known),
            self.share(Count::Noticed, Count::Switches),
            self.sum(Count::Mixed),
            self.share(Count::Split, Count::Mixed),
            self.share(Count::Foreign, Count::Learnt),
            self.sum(Count::Rounds) as f64 / (ROUNDS * self.sum(Count::Turns).max(1)) as f64,
            self.sum(Count::Merged),
            slowest.unwrap_or(0) / 1000,
        )
    }
}
