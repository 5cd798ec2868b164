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
    pub const HEADER: &'static str = "| worlds | number | as many policies as groups \
| exact policies | with superfluous policies | most superfluous | with missing policies \
| most missing | right after first visits | switches noticed at once | mixed rollouts \
| split exactly | learnt by the wrong policy | rollouts a turn | policies merged \
| slowest decisions |\n\
|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|---|";

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

    /// The share of worlds for which this holds, in per cent.
    fn worlds(&self, holds: impl Fn(&Record) -> bool) -> f64 {
        let number = self.records.iter().filter(|record| holds(record)).count();
        100.0 * number as f64 / self.records.len().max(1) as f64
    }

    /// The number of worlds in which one count exceeds another, and by how much at most.
    fn excess(&self, count: Count, over: Count) -> (usize, usize) {
        let records = self.records.iter();
        let excess = records.map(|record| record.get(count).saturating_sub(record.get(over)));
        let positive: Vec<usize> = excess.filter(|&excess| excess > 0).collect();
        (positive.len(), positive.into_iter().max().unwrap_or(0))
    }
}

impl fmt::Display for Report<'_> {
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        let worlds = self.records.len();
        let slowest = self.records.iter().map(|r| r.get(Count::Slowest)).max();
        let (too_many, superfluous) = self.excess(Count::Policies, Count::Groups);
        let (too_few, missing) = self.excess(Count::Groups, Count::Policies);
        write!(
            f,
            "| {} | {worlds} | {:.1} % | {:.1} % | {too_many} | {superfluous} | {too_few} \
             | {missing} | {} | {} | {} | {} | {} | {:.2} | {} | {} ms |",
            self.kind.name(),
            self.worlds(|record| record.get(Count::Policies) == record.get(Count::Groups)),
            self.worlds(|record| record.get(Count::Exact) == 1),
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

#[cfg(test)]
mod tests {
    use super::*;

    fn record(groups: usize, policies: usize, exact: usize) -> Record {
        let mut counts = [0; Record::LEN];
        counts[Count::Groups as usize] = groups;
        counts[Count::Policies as usize] = policies;
        counts[Count::Exact as usize] = exact;
        Record {
            kind: Kind::Target,
            seed: 0,
            counts,
        }
    }

    #[test]
    fn the_right_number_of_policies_is_not_enough_to_be_exact() {
        let records = [
            record(4, 4, 1),
            record(4, 4, 0),
            record(4, 6, 0),
            record(4, 3, 0),
        ];
        let line = Report::new(Kind::Target, &records).to_string();
        let start = "| target | 4 | 50.0 % | 25.0 % | 1 | 2 | 1 | 1 | - |";
        assert!(line.starts_with(start), "{line}");
        let columns = |line: &str| line.matches('|').count();
        let header: Vec<usize> = Report::HEADER.lines().map(columns).collect();
        assert_eq!(header, [columns(&line); 2]);
    }
}
