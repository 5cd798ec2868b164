//! Sums of `timings.csv`, and its rows up to a checkpoint.

use crate::schema::TimingRow;

/// Sums of seconds and decisions of training over the rollouts with known seconds.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct TimingSums {
    /// Wall-clock seconds of training, summed over the rollouts with known seconds.
    pub seconds: f64,
    decisions: f64,
}

impl TimingSums {
    /// Sums the rows of a timings table up to the first one that cannot be read.
    pub fn of_table(table: &[u8]) -> Self {
        let mut reader = csv::Reader::from_reader(table);
        let rows = reader.deserialize().map_while(Result::ok);
        rows.fold(Self::default(), |sums, row: TimingRow| Self {
            seconds: sums.seconds + row.total,
            decisions: sums.decisions + row.decisions as f64,
        })
    }

    /// Returns the decisions per second of training; `None` if no rollout has known seconds.
    pub fn decisions_per_second(&self) -> Option<f64> {
        (self.decisions > 0.0).then(|| self.decisions / self.seconds)
    }
}

/// Returns the header and the complete rows of the first `rollouts` rollouts of a timings table.
pub fn first_timing_rows(table: &[u8], rollouts: usize) -> String {
    let text = String::from_utf8_lossy(table);
    let mut lines = text.split_inclusive('\n');
    let Some(header) = lines.next().filter(|line| line.ends_with('\n')) else {
        return String::new();
    };
    // a crash may leave a torn row anywhere, since later processes append behind it
    let commas = |line: &str| line.matches(',').count();
    let mut kept = header.to_owned();
    for row in lines {
        let rollout = row.split(',').next().and_then(|cell| cell.parse().ok());
        let early = rollout.is_some_and(|rollout: usize| rollout < rollouts);
        if early && row.ends_with('\n') && commas(row) == commas(header) {
            kept.push_str(row);
        }
    }
    kept
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn timings_are_kept_up_to_the_checkpoint() {
        let text = "rollout,total\n0,1.5\n1,2.5\n2,3.5\n";
        let kept = |table: &str, rollouts| first_timing_rows(table.as_bytes(), rollouts);
        assert_eq!(kept(text, 2), "rollout,total\n0,1.5\n1,2.5\n");
        assert_eq!(kept(text, 9), text);
        assert_eq!(kept(&text[..text.len() - 1], 9), kept(text, 2));
        let gap = text.replace("1,2.5\n", "");
        assert_eq!(kept(&gap, 9), gap);
        assert_eq!((kept("", 2), kept("rollout,to", 2)), Default::default());
    }

    #[test]
    fn rows_that_can_be_read_are_summed_up() {
        let names = "rollout,decisions,total,environments,inference,assignment,update\n";
        let text = format!("{names}0,80,2,1,0,0,1\n1,40,1,1,0,0,0\n2,x,1,1,0,0,0\n");
        let sums = TimingSums::of_table(text.as_bytes());
        assert_eq!((sums.seconds, sums.decisions_per_second()), (3.0, Some(40.0)));
        assert_eq!(TimingSums::of_table(names.as_bytes()).decisions_per_second(), None);
    }
}
