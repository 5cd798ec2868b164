//! Errors of distances and assignments.

pub(crate) type Result<T> = std::result::Result<T, ClusterError>;

/// Error of a distance that cannot be computed or of an assignment that cannot be made.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ClusterError {
    /// A list that must hold something is empty.
    #[error("{what} is empty: expected at least one value")]
    Empty {
        /// Name of the list, for instance `x` or `cost`.
        what: &'static str,
    },
    /// Sources of evidence that show different numbers of episodes.
    #[error(
        "source {source_index} shows {got:?} episodes, expected {expected:?} (rollout, buffer)"
    )]
    SourceMismatch {
        /// Index of the source.
        source_index: usize,
        /// Episodes of the source's rollout and of its buffer.
        got: (usize, usize),
        /// Episodes of the first source's rollout and of its buffer.
        expected: (usize, usize),
    },
    /// A size or a setting lies outside its range.
    #[error("{name} is {value}: expected {expected}")]
    OutOfRange {
        /// Name of the size or setting.
        name: &'static str,
        /// Value given.
        value: f64,
        /// Accepted range in words.
        expected: &'static str,
    },
    /// A flat list does not divide into whole rows.
    #[error("{what} has {len} values, which is not a multiple of {row} (the length of one {unit})")]
    Ragged {
        /// Name of the list.
        what: &'static str,
        /// Number of values given.
        len: usize,
        /// Number of values in one row.
        row: usize,
        /// Name of one row, for instance `point`.
        unit: &'static str,
    },
    /// A value is NaN or infinite.
    #[error("{what}[{index}] is {value}: expected a finite number")]
    NonFinite {
        /// Name of the list.
        what: &'static str,
        /// Position in the flat list.
        index: usize,
        /// Value found.
        value: f64,
    },
    /// A cost is so large that sums of costs could overflow.
    #[error(
        "cost[{index}] is {value:e}: expected at most {limit:e} in magnitude; rescale the costs"
    )]
    CostTooLarge {
        /// Position in the flat row-major matrix.
        index: usize,
        /// Value found.
        value: f64,
        /// Largest magnitude accepted.
        limit: f64,
    },
    /// The length of a cost matrix disagrees with its numbers of rows and columns.
    #[error("cost has {len} entries: expected sources x sinks = {sources} x {sinks}")]
    CostShape {
        /// Number of entries given.
        len: usize,
        /// Number of rows.
        sources: usize,
        /// Number of columns.
        sinks: usize,
    },
    /// A weight is negative or not a number.
    #[error("weight {index} of {side} is {value}: expected a finite number, at least 0")]
    Weight {
        /// `sources` or `sinks`, or the name of a cloud.
        side: &'static str,
        /// Index of the point.
        index: usize,
        /// Weight given.
        value: f64,
    },
    /// The weights of a side are no distribution.
    #[error(
        "the weights of {} add up to {}, those of {} to {}: expected 1 within {tolerance:e} for \
         both; divide the weights of each side by their sum",
        .sides[0], .sums[0], .sides[1], .sums[1]
    )]
    WeightSums {
        /// `sources` and `sinks`, or the names of the clouds.
        sides: [&'static str; 2],
        /// Sums of the weights given.
        sums: [f64; 2],
        /// Largest difference from one that is accepted.
        tolerance: f64,
    },
    /// A cloud has another number of weights than of points.
    #[error("{side} has {points} points and {weights} weights: expected a weight for each point")]
    WeightCount {
        /// Name of the cloud.
        side: &'static str,
        /// Number of points.
        points: usize,
        /// Number of weights given.
        weights: usize,
    },
    /// A matrix of distances does not fit in memory.
    #[error(
        "the distances between {points} and {others} points do not fit in memory; \
         compare samples of the clouds"
    )]
    TooManyPoints {
        /// Number of points of one cloud.
        points: usize,
        /// Number of points of the other.
        others: usize,
    },
    /// The solver used up its bound on pivots.
    #[error(
        "the network simplex method stopped after {pivots} pivots without an optimum; \
         rescale the costs"
    )]
    Stalled {
        /// Pivots made, which is also the bound.
        pivots: usize,
    },
    /// A plan has other numbers of sources, sinks or potentials than the cost matrix.
    #[error("the plan's {what} has length {got}: expected {expected}")]
    PlanShape {
        /// Name of the part of the plan.
        what: &'static str,
        /// Length found.
        got: usize,
        /// Length that the cost matrix requires.
        expected: usize,
    },
    /// An entry of a plan points outside the cost matrix.
    #[error(
        "a plan entry sends from source {source_index} of {sources} to sink {sink_index} of {sinks}"
    )]
    EntryOutOfRange {
        /// Row index of the entry.
        source_index: usize,
        /// Number of rows.
        sources: usize,
        /// Column index of the entry.
        sink_index: usize,
        /// Number of columns.
        sinks: usize,
    },
    /// A row or column of a plan carries the wrong mass: the plan is not primal feasible.
    #[error("{side} {index} carries the mass {got}: expected {expected}")]
    Marginal {
        /// `source` or `sink`.
        side: &'static str,
        /// Index of the source or sink.
        index: usize,
        /// Mass carried, as a fraction of the whole.
        got: f64,
        /// Weight of the source or sink.
        expected: f64,
    },
    /// An entry of a plan has a negative mass or NaN.
    #[error("{what}[{index}] is {value}: expected at least 0")]
    NegativeMass {
        /// Name of the list.
        what: &'static str,
        /// Position in the list.
        index: usize,
        /// Mass found.
        value: f64,
    },
    /// Two potentials add up to more than a cost: the potentials are not dual feasible.
    #[error(
        "reduced cost {slack:e} at source {source_index}, sink {sink_index}: \
         expected at least -{tolerance:e}"
    )]
    DualInfeasible {
        /// Row index.
        source_index: usize,
        /// Column index.
        sink_index: usize,
        /// Cost minus both potentials.
        slack: f64,
        /// Rounding allowance.
        tolerance: f64,
    },
    /// The cost of a plan and the value of its potentials differ: optimality is not proven.
    #[error("primal cost {primal:e} and dual value {dual:e} differ by more than {tolerance:e}")]
    DualityGap {
        /// Cost of the plan.
        primal: f64,
        /// Lower bound that the potentials prove.
        dual: f64,
        /// Rounding allowance.
        tolerance: f64,
    },
    /// Rounding leaves too much of the cost of a plan unproven: costs, or the distances between
    /// points, span more orders of magnitude than an `f64` resolves.
    #[error(
        "the cost {cost:e} may exceed the optimum by {excess:e}, expected at most {tolerance:e}: \
         the costs that carry mass differ too much in size; leave out points of very small weight \
         that lie far from all others, or bring the costs closer together"
    )]
    Imprecise {
        /// Cost of the plan that was found.
        cost: f64,
        /// Largest amount by which it may exceed the optimum.
        excess: f64,
        /// Largest amount accepted.
        tolerance: f64,
    },
    /// Frames of two clouds that differ in a size, so that they cannot be compared.
    #[error("{what} is {first} in one cloud and {second} in the other, expected the same")]
    FramesMismatch {
        /// Name of the size that differs.
        what: &'static str,
        /// Size in the first cloud.
        first: usize,
        /// Size in the second cloud.
        second: usize,
    },
    /// A reservoir was restored from parts that no run could have left.
    #[error("a reservoir of capacity {capacity} that has seen {seen} episodes cannot hold {held}")]
    ReservoirParts {
        /// Capacity given.
        capacity: usize,
        /// Number of episodes offered so far.
        seen: u64,
        /// Number of episodes given.
        held: usize,
    },
}
