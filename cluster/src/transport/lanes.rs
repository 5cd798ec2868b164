//! Inner loops of pricing, compiled for several instruction sets and chosen at run time.
//!
//! Minima are taken in sixteen lanes: a single running minimum would wait for each comparison in
//! turn. A minimum does not depend on the order of its arguments, so results are the same on every
//! machine.

use pulp::Arch;

/// Number of running minima of a scan: two vectors of AVX-512, four of AVX2.
const LANES: usize = 16;

/// Vectorised searches for the smallest reduced cost in rows of a cost matrix.
#[derive(Clone, Copy, Debug, Default)]
pub(crate) struct Lanes {
    arch: Arch,
}

impl Lanes {
    /// Returns the sink `j` of least cost plus price, `row[j] + prices[j]`; `None` if all are
    /// infinite.
    pub(crate) fn nearest(self, row: &[f64], prices: &[f64]) -> Option<usize> {
        self.arch.dispatch(
            #[inline(always)]
            || {
                let least = minimum(row, prices, &[0.0]);
                if least == f64::INFINITY {
                    return None;
                }
                position(row, prices, 0.0, least)
            },
        )
    }

    /// Returns the smallest reduced cost `rows[i][j] + prices[j] - own[i]` in rows of costs.
    pub(crate) fn minimum(self, rows: &[f64], prices: &[f64], own: &[f64]) -> f64 {
        self.arch.dispatch(
            #[inline(always)]
            || minimum(rows, prices, own),
        )
    }

    /// Returns the sink `j` whose reduced cost `row[j] + prices[j] - own` is `least`, the value
    /// that [`minimum`](Self::minimum) found; `None` if the row has no such sink.
    pub(crate) fn position(
        self,
        row: &[f64],
        prices: &[f64],
        own: f64,
        least: f64,
    ) -> Option<usize> {
        self.arch.dispatch(
            #[inline(always)]
            || position(row, prices, own, least),
        )
    }

    /// Returns the least cost plus price in a list of sinks, `costs[k] + prices[sinks[k]]`, and
    /// `k`.
    pub(crate) fn gathered(self, costs: &[f64], sinks: &[u32], prices: &[f64]) -> (f64, usize) {
        self.arch.dispatch(
            #[inline(always)]
            || gathered(costs, sinks, prices),
        )
    }
}

#[inline(always)]
fn lower(a: f64, b: f64) -> f64 {
    if b < a { b } else { a }
}

#[inline(always)]
fn least_lane<const N: usize>(mut lanes: [f64; N]) -> f64 {
    let mut width = N / 2;
    while width > 0 {
        for k in 0..width {
            lanes[k] = lower(lanes[k], lanes[k + width]);
        }
        width /= 2;
    }
    lanes[0]
}

#[inline(always)]
fn minimum(rows: &[f64], prices: &[f64], own: &[f64]) -> f64 {
    let mut lanes = [f64::INFINITY; LANES];
    let (price_blocks, price_rest) = prices.as_chunks::<LANES>();
    for (row, &own_price) in rows.chunks_exact(prices.len()).zip(own) {
        let (blocks, rest) = row.as_chunks::<LANES>();
        for (c, p) in blocks.iter().zip(price_blocks) {
            for k in 0..LANES {
                lanes[k] = lower(lanes[k], c[k] + p[k] - own_price);
            }
        }
        for (lane, (c, p)) in lanes.iter_mut().zip(rest.iter().zip(price_rest)) {
            *lane = lower(*lane, c + p - own_price);
        }
    }
    least_lane(lanes)
}

#[inline(always)]
fn position(row: &[f64], prices: &[f64], own: f64, least: f64) -> Option<usize> {
    let (blocks, rest) = row.as_chunks::<LANES>();
    let (price_blocks, price_rest) = prices.as_chunks::<LANES>();
    for (block, (c, p)) in blocks.iter().zip(price_blocks).enumerate() {
        // a branch for each block, not for each value, leaves the inner loop to vector code
        let mut hit = false;
        for k in 0..LANES {
            hit |= c[k] + p[k] - own == least;
        }
        if hit {
            let lane = (0..LANES).find(|&k| c[k] + p[k] - own == least);
            return lane.map(|lane| block * LANES + lane);
        }
    }
    let lane = rest.iter().zip(price_rest).position(|(c, p)| c + p - own == least);
    lane.map(|lane| blocks.len() * LANES + lane)
}

#[inline(always)]
fn gathered(costs: &[f64], sinks: &[u32], prices: &[f64]) -> (f64, usize) {
    let mut lanes = [f64::INFINITY; 8];
    let (cost_blocks, cost_rest) = costs.as_chunks::<8>();
    let (sink_blocks, sink_rest) = sinks.as_chunks::<8>();
    for (c, j) in cost_blocks.iter().zip(sink_blocks) {
        for k in 0..8 {
            lanes[k] = lower(lanes[k], c[k] + prices[j[k] as usize]);
        }
    }
    for (lane, (c, j)) in lanes.iter_mut().zip(cost_rest.iter().zip(sink_rest)) {
        *lane = lower(*lane, c + prices[*j as usize]);
    }
    let least = least_lane(lanes);
    let is_least = |(c, j): (&f64, &u32)| c + prices[*j as usize] == least;
    (least, costs.iter().zip(sinks).position(is_least).unwrap_or(0))
}
