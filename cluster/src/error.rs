//! Errors of distances and assignments.

pub(crate) type Result<T> = std::result::Result<T, ClusterError>;

/// Errors of distances, transport plans, permutation tests, assignments and reservoirs.
#[derive(Clone, Debug, PartialEq, thiserror::Error)]
#[non_exhaustive]
pub enum ClusterError {
    /// Empty list of points, costs or sources that must hold at least one.
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
        /// Index of the source of evidence whose numbers of episodes differ.
        source_index: usize,
        /// Numbers of episodes of this source's rollout and of its buffer.
        got: (usize, usize),
        /// Numbers of episodes of the first source's rollout and of its buffer.
        expected: (usize, usize),
    },
    /// Size or setting outside its range.
    #[error("{name} is {value}: expected {expected}")]
    OutOfRange {
        /// Name of the size or setting that is out of range.
        name: &'static str,
        /// Rejected value of the size or setting.
        value: f64,
        /// Accepted range of the size or setting, in words.
        expected: &'static str,
    },
    /// Flat list whose length is not a multiple of the length of one row, such as one point.
    #[error("{what} has {len} values, which is not a multiple of {row} (the length of one {unit})")]
    Ragged {
        /// Name of the list that does not divide into rows.
        what: &'static str,
        /// Number of values in the list.
        len: usize,
        /// Number of values in one row, which must divide the length of the list.
        row: usize,
        /// Name of what one row of the list is, for instance `point`.
        unit: &'static str,
    },
    /// NaN or infinite value in a list of numbers.
    #[error("{what}[{index}] is {value}: expected a finite number")]
    NonFinite {
        /// Name of the list that holds the NaN or infinite value.
        what: &'static str,
        /// Index of the value in the flat list.
        index: usize,
        /// NaN or infinite value that was found.
        value: f64,
    },
    /// Transport cost so large that sums of costs could overflow.
    #[error(
        "cost[{index}] is {value:e}: expected at most {limit:e} in magnitude; rescale the costs"
    )]
    CostTooLarge {
        /// Index of the cost in the flat row-major cost matrix.
        index: usize,
        /// Cost that is too large.
        value: f64,
        /// Largest accepted magnitude of a cost.
        limit: f64,
    },
    /// Cost matrix whose length is not the product of the numbers of sources and sinks.
    #[error("cost has {len} entries: expected sources x sinks = {sources} x {sinks}")]
    CostShape {
        /// Number of entries of the cost matrix.
        len: usize,
        /// Number of sources, the rows of the cost matrix.
        sources: usize,
        /// Number of sinks, the columns of the cost matrix.
        sinks: usize,
    },
    /// Weight of a point, or mass of a plan's entry, that is negative, infinite or NaN.
    #[error("{what}[{index}] is {value}: expected a finite number, at least 0")]
    Weight {
        /// Name of the list of weights or masses.
        what: &'static str,
        /// Index of the wrong number in the list.
        index: usize,
        /// Number that is negative, infinite or NaN.
        value: f64,
    },
    /// Weights of the transport problem that do not add up to 1, on one side or both.
    #[error(
        "the weights of {} add up to {}, those of {} to {}: expected 1 within {tolerance:e} for \
         both; divide the weights of each side by their sum",
        .sides[0], .sums[0], .sides[1], .sums[1]
    )]
    WeightSums {
        /// Names of both sides: `sources` and `sinks`, or the names of the clouds.
        sides: [&'static str; 2],
        /// Sums of the weights of both sides.
        sums: [f64; 2],
        /// Largest accepted difference of a sum of weights from 1.
        tolerance: f64,
    },
    /// Matrix of distances between two clouds that does not fit in memory.
    #[error(
        "the distances between {points} and {others} points do not fit in memory; \
         compare samples of the clouds"
    )]
    TooManyPoints {
        /// Number of points of one cloud.
        points: usize,
        /// Number of points of the other cloud.
        others: usize,
    },
    /// Network simplex method that reached its largest number of pivots without an optimum.
    #[error(
        "the network simplex method stopped after {pivots} pivots without an optimum; \
         rescale the costs"
    )]
    Stalled {
        /// Number of pivots made, which is also the largest number allowed.
        pivots: usize,
    },
    /// List whose length does not fit the other arguments, such as the weights of a cloud or the
    /// potentials of a plan.
    #[error("{what} has length {got}: expected {expected}")]
    Length {
        /// Name of the list that has the wrong length.
        what: &'static str,
        /// Length of the list.
        got: usize,
        /// Length that the other arguments require.
        expected: usize,
    },
    /// Source or sink whose mass in a transport plan is not its weight: the plan is not primal
    /// feasible.
    #[error("{side} {index} carries the mass {got}: expected {expected}")]
    Marginal {
        /// Side of the wrong mass: `source` or `sink`.
        side: &'static str,
        /// Index of the source or sink with the wrong mass.
        index: usize,
        /// Mass that the transport plan sends from the source or to the sink, as a fraction of all
        /// mass.
        got: f64,
        /// Weight of the source or sink.
        expected: f64,
    },
    /// Pair of potentials that add up to more than their cost: the potentials are not dual
    /// feasible.
    #[error(
        "reduced cost {slack:e} at source {source_index}, sink {sink_index}: \
         expected at least -{tolerance:e}"
    )]
    DualInfeasible {
        /// Index of the source with the violated cost, a row of the cost matrix.
        source_index: usize,
        /// Index of the sink with the violated cost, a column of the cost matrix.
        sink_index: usize,
        /// Reduced cost of the pair: cost minus both potentials.
        slack: f64,
        /// Largest magnitude of a negative reduced cost that rounding explains.
        tolerance: f64,
    },
    /// Difference between the cost of a transport plan and the value of its potentials: optimality
    /// is not proven.
    #[error("primal cost {primal:e} and dual value {dual:e} differ by more than {tolerance:e}")]
    DualityGap {
        /// Cost of the transport plan.
        primal: f64,
        /// Lower bound of the cost that the potentials prove.
        dual: f64,
        /// Largest difference of both that rounding explains.
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
        /// Cost of the transport plan that was found.
        cost: f64,
        /// Largest amount by which the cost may exceed the optimum.
        excess: f64,
        /// Largest accepted excess of the cost over the optimum.
        tolerance: f64,
    },
    /// Frames of two clouds that differ in a size, so that they cannot be compared.
    #[error("{what} is {first} in one cloud and {second} in the other, expected the same")]
    FramesMismatch {
        /// Name of the size of the frames that differs.
        what: &'static str,
        /// Size of the frames in the first cloud.
        first: usize,
        /// Size of the frames in the second cloud.
        second: usize,
    },
    /// Reservoir restored from a capacity and numbers of episodes that do not fit together.
    #[error("a reservoir of capacity {capacity} that has seen {seen} episodes cannot hold {held}")]
    ReservoirParts {
        /// Capacity of the reservoir, in episodes.
        capacity: usize,
        /// Number of episodes offered to the reservoir so far.
        seen: u64,
        /// Number of episodes that the reservoir is to hold.
        held: usize,
    },
}
