//! Optimal transport between uniform weights on a given cost matrix.

use crate::ClusterError;
use crate::augmenting;
use crate::certificate::certify;
use crate::check::positive;

/// Largest magnitude accepted in a cost matrix: sums of costs along any path stay far from
/// overflow.
pub const MAX_COST: f64 = 1e100;

/// Units of mass that go from one source to one sink.
#[derive(Clone, Copy, Debug, PartialEq, Eq)]
pub struct Entry {
    /// Row index, in `0..sources`.
    pub source: usize,
    /// Column index, in `0..sinks`.
    pub sink: usize,
    /// Mass in units of `1 / lcm(sources, sinks)`; see [`TransportPlan::mass`].
    pub units: usize,
}

/// A certified optimal plan and the potentials that prove it.
#[derive(Clone, Debug, PartialEq)]
pub struct TransportPlan {
    /// Number of sources `n`, each of weight `1/n`.
    pub sources: usize,
    /// Number of sinks `m`, each of weight `1/m`.
    pub sinks: usize,
    /// Mean cost of a unit of mass: the optimal value `<gamma, M>` of the transport problem, in the
    /// costs' unit.
    pub cost: f64,
    /// The positive entries of `gamma`; each (source, sink) pair occurs at most once.
    pub entries: Vec<Entry>,
    /// Dual potentials `u` of the sources, `[n]`.
    pub source_potentials: Vec<f64>,
    /// Dual potentials `v` of the sinks, `[m]`; `u_i + v_j <= c_ij` for all pairs.
    pub sink_potentials: Vec<f64>,
}

impl TransportPlan {
    /// Returns the mass `gamma_ij` of an entry, in `(0, 1]`; all masses add up to 1.
    pub fn mass(&self, entry: &Entry) -> f64 {
        entry.units as f64 / lcm(self.sources, self.sinks) as f64
    }

    /// Returns the cost of the entries under `cost` `[n, m]`.
    pub(crate) fn priced(&self, cost: &[f64]) -> f64 {
        let price = |e: &Entry| e.units as f64 * cost[e.source * self.sinks + e.sink];
        self.entries.iter().map(price).sum::<f64>() / lcm(self.sources, self.sinks) as f64
    }
}

/// Uniform weights in whole units: each source holds `supply`, each sink asks for `demand`.
#[derive(Clone, Copy, Debug)]
pub(crate) struct Supplies {
    pub(crate) sources: usize,
    pub(crate) sinks: usize,
    /// `m / gcd(n, m)`.
    pub(crate) supply: usize,
    /// `n / gcd(n, m)`.
    pub(crate) demand: usize,
}

impl Supplies {
    /// Checks the shape of a cost matrix and returns its supplies.
    pub(crate) fn new(cost: &[f64], sources: usize, sinks: usize) -> Result<Self, ClusterError> {
        positive("sources", sources)?;
        positive("sinks", sinks)?;
        if sources.checked_mul(sinks) != Some(cost.len()) {
            return Err(ClusterError::CostShape {
                len: cost.len(),
                sources,
                sinks,
            });
        }
        let divisor = gcd(sources, sinks);
        Ok(Self {
            sources,
            sinks,
            supply: sinks / divisor,
            demand: sources / divisor,
        })
    }

    /// Returns the problem with sources and sinks exchanged.
    pub(crate) fn transposed(&self) -> Self {
        Self {
            sources: self.sinks,
            sinks: self.sources,
            supply: self.demand,
            demand: self.supply,
        }
    }

    /// Units in total, `lcm(n, m)`.
    pub(crate) fn total(&self) -> usize {
        self.sources * self.supply
    }
}

/// Solves the transport problem between `sources` points of weight `1/n` and `sinks` points of
/// weight `1/m`.
///
/// `cost` is row-major `[n, m]`; entries may be negative. The answer is exact up to rounding and
/// carries its own proof: [`certify`] has accepted it. Worst-case time is `O(lcm(n, m) n m)`.
///
/// # Errors
/// An empty or misshapen matrix, a cost that is not finite or exceeds [`MAX_COST`], and an answer
/// that the certificate refuses.
pub fn transport(
    cost: &[f64],
    sources: usize,
    sinks: usize,
) -> Result<TransportPlan, ClusterError> {
    let supplies = Supplies::new(cost, sources, sinks)?;
    check_costs(cost)?;
    let mut plan = augmenting::solve(cost, &supplies)?;
    plan.cost = plan.priced(cost);
    certify(cost, &plan)?;
    Ok(plan)
}

fn check_costs(cost: &[f64]) -> Result<(), ClusterError> {
    let Some(index) = cost.iter().position(|c| c.is_nan() || c.abs() > MAX_COST) else {
        return Ok(());
    };
    let value = cost[index];
    Err(match value.is_finite() {
        true => ClusterError::CostTooLarge {
            index,
            value,
            limit: MAX_COST,
        },
        false => ClusterError::NonFinite {
            what: "cost",
            index,
            value,
        },
    })
}

fn gcd(a: usize, b: usize) -> usize {
    if b == 0 { a } else { gcd(b, a % b) }
}

fn lcm(a: usize, b: usize) -> usize {
    a / gcd(a, b) * b
}
