//! Choice of the arc of negative reduced cost that enters the basis next.

use super::basis::{Basis, Entering};
use super::lanes::Lanes;

/// Number of sinks beyond which arcs are priced through shortlists: a row of this many costs is
/// read about as fast as the scattered prices of a shortlist.
const DENSE_SINKS: usize = 500;
/// Number of costs in one block of dense pricing, as a multiple of the square root of the number of
/// all costs: a wider search pays off in larger problems.
const BLOCK: f64 = 3.0;
/// Number of sinks on the shortlist of a source.
const SHORT: usize = 32;
/// Number of sources whose shortlists are priced for one pivot.
const SHORT_SOURCES: usize = 8;

/// Block pricing of the network simplex method, cyclic over the sources: it chooses the arc of
/// least reduced cost in the next block that has a negative one.
///
/// Wide matrices are priced through *shortlists*, the sinks that were best for each source when its
/// list was made. When no list has an arc of negative reduced cost, the lists of sources that have
/// one elsewhere are made anew (C. Gottschlich and D. Schuhmacher, "The shortlist method for fast
/// computation of the earth mover's distance", PLoS ONE 9 (2014), with prices taken into account).
/// Optimality is only ever concluded from all costs.
#[derive(Clone, Debug, Default)]
pub(crate) struct Pricing {
    lanes: Lanes,
    tolerance: f64,
    /// Index of the first source of the next block of arcs to price.
    source: usize,
    /// Number of sinks on each shortlist; 0 for dense pricing.
    short: usize,
    costs: Vec<f64>,
    sinks: Vec<u32>,
    ranking: Vec<(f64, u32)>,
}

impl Pricing {
    /// Prepares the pricing of a new transport problem. Reduced costs above `-tolerance` count as
    /// zero.
    pub(crate) fn reset(&mut self, cost: &[f64], basis: &Basis, tolerance: f64) {
        let (sources, sinks) = (basis.source_prices().len(), basis.sink_prices().len());
        self.tolerance = tolerance;
        self.source = 0;
        self.short = if sinks > DENSE_SINKS { SHORT } else { 0 };
        self.costs.clear();
        self.costs.resize(sources * self.short, 0.0);
        self.sinks.clear();
        self.sinks.resize(sources * self.short, 0);
        if self.short > 0 {
            (0..sources).for_each(|source| self.rank(source, cost, basis));
        }
    }

    pub(crate) fn tolerance(&self) -> f64 {
        self.tolerance
    }

    /// Counts reduced costs above `-tolerance` as zero from now on.
    pub(crate) fn tolerate(&mut self, tolerance: f64) {
        self.tolerance = tolerance;
    }

    /// Returns an arc that lowers the cost of the transport plan; `None` if the basis is optimal.
    pub(crate) fn next(&mut self, cost: &[f64], basis: &Basis) -> Option<Entering> {
        match self.short {
            0 => self.next_dense(cost, basis),
            _ => self
                .next_listed(basis)
                .or_else(|| self.renew(cost, basis).then(|| self.next_listed(basis))?),
        }
    }

    fn next_dense(&mut self, cost: &[f64], basis: &Basis) -> Option<Entering> {
        let (own, prices) = (basis.source_prices(), basis.sink_prices());
        // whole rows, so that a block is one stretch of memory
        let block_size = BLOCK * (cost.len() as f64).sqrt();
        let rows = (block_size as usize / prices.len()).max(1);
        let mut priced = 0;
        while priced < own.len() {
            let (first, last) = (self.source, (self.source + rows).min(own.len()));
            let block = &cost[first * prices.len()..last * prices.len()];
            let reduced = self.lanes.minimum(block, prices, &own[first..last]);
            self.source = if last == own.len() { 0 } else { last };
            if reduced < -self.tolerance {
                return self.locate(cost, basis, first..last, reduced);
            }
            priced += last - first;
        }
        None
    }

    fn locate(
        &self,
        cost: &[f64],
        basis: &Basis,
        mut sources: std::ops::Range<usize>,
        reduced: f64,
    ) -> Option<Entering> {
        let (own, prices) = (basis.source_prices(), basis.sink_prices());
        sources.find_map(|source| {
            let row = &cost[source * prices.len()..][..prices.len()];
            let sink = self.lanes.position(row, prices, own[source], reduced)?;
            Some(Entering { source: source as u32, sink: sink as u32, reduced })
        })
    }

    fn next_listed(&mut self, basis: &Basis) -> Option<Entering> {
        let sources = basis.source_prices().len();
        let mut priced = 0;
        while priced < sources {
            let mut best: Option<Entering> = None;
            for _ in 0..SHORT_SOURCES {
                let listed = self.best_listed(self.source, basis);
                if listed.reduced < best.map_or(-self.tolerance, |best| best.reduced) {
                    best = Some(listed);
                }
                self.source += 1;
                if self.source == sources {
                    self.source = 0;
                }
            }
            if best.is_some() {
                return best;
            }
            priced += SHORT_SOURCES;
        }
        None
    }

    fn best_listed(&self, source: usize, basis: &Basis) -> Entering {
        let list = source * self.short..(source + 1) * self.short;
        let sinks = &self.sinks[list.clone()];
        let prices = basis.sink_prices();
        let (least, place) = self.lanes.gathered(&self.costs[list], sinks, prices);
        Entering {
            source: source as u32,
            sink: sinks[place],
            reduced: least - basis.source_prices()[source],
        }
    }

    /// Renews the shortlists of the sources that have an arc of negative reduced cost. Returns
    /// `true` if there was one.
    fn renew(&mut self, cost: &[f64], basis: &Basis) -> bool {
        let (own, prices) = (basis.source_prices(), basis.sink_prices());
        let mut any = false;
        for (source, row) in cost.chunks_exact(prices.len()).enumerate() {
            let own = std::slice::from_ref(&own[source]);
            if self.lanes.minimum(row, prices, own) < -self.tolerance {
                self.rank(source, cost, basis);
                any = true;
            }
        }
        any
    }

    /// Writes the shortlist of a source: the sinks of least reduced cost.
    fn rank(&mut self, source: usize, cost: &[f64], basis: &Basis) {
        let prices = basis.sink_prices();
        let row = &cost[source * prices.len()..][..prices.len()];
        let reduced = row.iter().zip(prices).map(|(c, p)| c + p);
        self.ranking.clear();
        self.ranking.extend(reduced.zip(0..));
        self.ranking.select_nth_unstable_by(self.short - 1, |a, b| a.0.total_cmp(&b.0));
        let list = source * self.short..(source + 1) * self.short;
        let listed = self.costs[list.clone()].iter_mut().zip(&mut self.sinks[list]);
        for ((listed_cost, sink), (_, chosen)) in listed.zip(&self.ranking) {
            (*listed_cost, *sink) = (row[*chosen as usize], *chosen);
        }
    }
}
