//! When which group runs: the visits of a stream on a clock of decisions.

use crate::schedule::Visit;

/// The visits of a stream, one after another.
#[derive(Clone, Debug)]
pub(crate) struct Timetable {
    visits: Vec<Visit>,
    /// The decision at which each visit ends.
    ends: Vec<usize>,
}

impl Timetable {
    pub fn new(visits: Vec<Visit>) -> Self {
        let mut end = 0;
        let ends = visits.iter().map(|visit| {
            end += visit.decisions;
            end
        });
        Self { ends: ends.collect(), visits }
    }

    /// The index of the visit that the decision of this number belongs to; none behind the last.
    pub fn index_at(&self, decision: usize) -> Option<usize> {
        let index = self.ends.partition_point(|&end| end <= decision);
        (index < self.visits.len()).then_some(index)
    }

    /// The visit of this index, and those before it.
    pub fn visit(&self, index: usize) -> (&Visit, &[Visit]) {
        (&self.visits[index], &self.visits[..index])
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn a_visit_ends_where_the_next_begins() {
        let visit = |decisions: usize| Visit {
            group: decisions.to_string(),
            variants: Vec::new(),
            decisions,
        };
        let timetable = Timetable::new(vec![visit(3), visit(2)]);
        let indices: Vec<_> = (0..6).map(|at| timetable.index_at(at)).collect();
        let expected = [Some(0), Some(0), Some(0), Some(1), Some(1), None];
        assert_eq!(indices, expected);
        let (second, before) = timetable.visit(1);
        assert_eq!((second.decisions, before.len()), (2, 1));
    }
}
