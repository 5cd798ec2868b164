//! Exact transport by successive shortest augmenting paths.
//!
//! Read this before editing. Three invariants hold between augmentations, with the reduced
//! cost of a pair being `c_ij - v_j - u_i`: no reduced cost is negative, pairs with flow have
//! reduced cost zero, and no source or sink exceeds its share. The first two say that the flow so
//! far is optimal for the mass that it sends; once all mass is sent it is optimal. Dijkstra keeps
//! the first because the potentials move by the distances it finds.
//!
//! The method is that of R. Jonker and A. Volgenant, "A shortest augmenting path algorithm for
//! dense and sparse linear assignment problems", Computing 38 (1987): column reduction, greedy
//! start, augmentation, here with whole units of supply and demand so that `n != m` is the same
//! program; with `n = m` all shares are one.

use crate::ClusterError;
use crate::transport::{Entry, Supplies, TransportPlan};

/// Solves the problem; the plan's cost is left at zero for the caller to price.
pub(crate) fn solve(cost: &[f64], supplies: &Supplies) -> Result<TransportPlan, ClusterError> {
    // the search keeps its books by sink, so the smaller side should play that part
    if supplies.sinks <= supplies.sources {
        return solve_as_given(cost, supplies);
    }
    let mut plan = solve_as_given(
        &transposed_costs(cost, supplies.sinks),
        &supplies.transposed(),
    )?;
    std::mem::swap(&mut plan.sources, &mut plan.sinks);
    std::mem::swap(&mut plan.source_potentials, &mut plan.sink_potentials);
    plan.entries
        .iter_mut()
        .for_each(|e| std::mem::swap(&mut e.source, &mut e.sink));
    Ok(plan)
}

fn transposed_costs(cost: &[f64], columns: usize) -> Vec<f64> {
    let column = |j| cost.iter().skip(j).step_by(columns).copied();
    (0..columns).flat_map(column).collect()
}

fn solve_as_given(cost: &[f64], supplies: &Supplies) -> Result<TransportPlan, ClusterError> {
    let mut flow = Flow::reduced(cost, supplies);
    flow.send_along_tight_pairs();
    let mut search = Search::new(supplies);
    // each augmentation sends a unit or more, so the total bounds their number
    for _ in 0..supplies.total() {
        let Some(root) = flow.next_source() else {
            break;
        };
        let sink = search.run(&flow, root);
        search.shift_potentials(&mut flow, sink);
        search.augment(&mut flow, root, sink);
    }
    match flow.excess.iter().sum() {
        0 => Ok(flow.into_plan()),
        left => Err(ClusterError::Stalled {
            augmentations: supplies.total(),
            left,
        }),
    }
}

/// Flow into one sink from one source.
#[derive(Clone, Copy)]
struct Share {
    source: usize,
    units: usize,
}

/// A partial flow and its potentials.
struct Flow<'a> {
    cost: &'a [f64],
    sinks: usize,
    /// Units that each source has not sent.
    excess: Vec<usize>,
    /// Units that each sink has not received.
    deficit: Vec<usize>,
    /// Positive flows by sink.
    shares: Vec<Vec<Share>>,
    u: Vec<f64>,
    v: Vec<f64>,
    /// All sources before this one have sent everything.
    cursor: usize,
}

impl<'a> Flow<'a> {
    /// Starts without flow, from the potentials of column reduction followed by row reduction.
    fn reduced(cost: &'a [f64], supplies: &Supplies) -> Self {
        let sinks = supplies.sinks;
        let mut v = vec![f64::INFINITY; sinks];
        for row in cost.chunks_exact(sinks) {
            v.iter_mut()
                .zip(row)
                .for_each(|(low, c)| *low = low.min(*c));
        }
        let reduced_minimum = |row: &[f64]| {
            row.iter()
                .zip(&v)
                .map(|(c, v)| c - v)
                .fold(f64::INFINITY, f64::min)
        };
        let u = cost.chunks_exact(sinks).map(reduced_minimum).collect();
        Self {
            cost,
            sinks,
            excess: vec![supplies.supply; supplies.sources],
            deficit: vec![supplies.demand; sinks],
            shares: vec![Vec::with_capacity(2); sinks],
            u,
            v,
            cursor: 0,
        }
    }

    fn row(&self, source: usize) -> &'a [f64] {
        &self.cost[source * self.sinks..][..self.sinks]
    }

    /// Sends what it can along pairs of reduced cost zero.
    fn send_along_tight_pairs(&mut self) {
        for source in 0..self.excess.len() {
            let row = self.row(source);
            for (sink, c) in row.iter().enumerate() {
                let units = self.excess[source].min(self.deficit[sink]);
                // subtracted in the order of `reduced`, so that the minimum gives an exact zero
                if units > 0 && c - self.v[sink] - self.u[source] == 0.0 {
                    self.shares[sink].push(Share { source, units });
                    self.excess[source] -= units;
                    self.deficit[sink] -= units;
                }
            }
        }
    }

    /// Returns the first source that has units left.
    fn next_source(&mut self) -> Option<usize> {
        let ahead = self.excess[self.cursor..]
            .iter()
            .position(|&units| units > 0)?;
        self.cursor += ahead;
        Some(self.cursor)
    }

    fn add(&mut self, source: usize, sink: usize, units: usize) {
        match self.shares[sink].iter_mut().find(|s| s.source == source) {
            Some(share) => share.units += units,
            None => self.shares[sink].push(Share { source, units }),
        }
    }

    fn remove(&mut self, source: usize, sink: usize, units: usize) {
        let shares = &mut self.shares[sink];
        shares
            .iter_mut()
            .filter(|s| s.source == source)
            .for_each(|s| s.units -= units);
        shares.retain(|s| s.units > 0);
    }

    fn units(&self, source: usize, sink: usize) -> usize {
        let found = self.shares[sink].iter().find(|s| s.source == source);
        found.map_or(0, |share| share.units)
    }

    fn into_plan(self) -> TransportPlan {
        let entry = |sink, share: &Share| Entry {
            source: share.source,
            sink,
            units: share.units,
        };
        let by_sink = self.shares.iter().enumerate();
        TransportPlan {
            sources: self.u.len(),
            sinks: self.sinks,
            cost: 0.0,
            entries: by_sink
                .flat_map(|(sink, shares)| shares.iter().map(move |s| entry(sink, s)))
                .collect(),
            source_potentials: self.u,
            sink_potentials: self.v,
        }
    }
}

/// Marks a source that the current search has not reached.
const UNREACHED: usize = usize::MAX;
/// Marks the source that the current search started from.
const ROOT: usize = usize::MAX - 1;

/// Working memory of Dijkstra's search over the residual graph, reused by all augmentations.
struct Search {
    /// Distance of each sink from the root.
    distance: Vec<f64>,
    /// Source from which each sink was reached.
    via: Vec<usize>,
    /// Sink from which each source was reached, or [`ROOT`], or [`UNREACHED`].
    entered_from: Vec<usize>,
    /// Sinks whose distance is not final.
    open: Vec<usize>,
    /// Sources reached, with their distances, in order of distance.
    reached: Vec<(usize, f64)>,
}

impl Search {
    fn new(supplies: &Supplies) -> Self {
        Self {
            distance: vec![0.0; supplies.sinks],
            via: vec![0; supplies.sinks],
            entered_from: vec![UNREACHED; supplies.sources],
            open: Vec::with_capacity(supplies.sinks),
            reached: Vec::with_capacity(supplies.sources),
        }
    }

    /// Returns the sink nearest to `root` that still wants units.
    fn run(&mut self, flow: &Flow, root: usize) -> usize {
        self.distance.fill(f64::INFINITY);
        self.entered_from.fill(UNREACHED);
        self.reached.clear();
        self.open.clear();
        self.open.extend(0..flow.sinks);
        let mut nearest = self.enter(flow, root, ROOT, 0.0);
        loop {
            let sink = self.open.swap_remove(nearest);
            if flow.deficit[sink] > 0 {
                return sink;
            }
            nearest = self.pass_through(flow, sink);
        }
    }

    /// Reaches the sources that a closed sink could send back to; returns the place of the nearest
    /// open sink.
    fn pass_through(&mut self, flow: &Flow, sink: usize) -> usize {
        let distance = self.distance[sink];
        let mut nearest = None;
        for share in &flow.shares[sink] {
            if self.entered_from[share.source] == UNREACHED {
                nearest = Some(self.enter(flow, share.source, sink, distance));
            }
        }
        nearest.unwrap_or_else(|| self.nearest())
    }

    /// Reaches a source and relaxes its pairs with the open sinks; returns the place of the nearest
    /// open sink.
    fn enter(&mut self, flow: &Flow, source: usize, from: usize, start: f64) -> usize {
        self.entered_from[source] = from;
        self.reached.push((source, start));
        let (row, u) = (flow.row(source), flow.u[source]);
        let mut nearest = (0, f64::INFINITY);
        for (place, &sink) in self.open.iter().enumerate() {
            // rounding may leave a reduced cost a hair below zero; distances must not shrink
            let candidate = start + (row[sink] - flow.v[sink] - u).max(0.0);
            let known = &mut self.distance[sink];
            if candidate < *known {
                *known = candidate;
                self.via[sink] = source;
            }
            if *known < nearest.1 {
                nearest = (place, *known);
            }
        }
        nearest.0
    }

    /// Returns the place of the nearest open sink. One is open: closed sinks want nothing, yet the
    /// root's units are wanted somewhere.
    fn nearest(&self) -> usize {
        let distances = self.open.iter().map(|&sink| self.distance[sink]);
        let first = (0, f64::INFINITY);
        let closer =
            |best: (usize, f64), next: (usize, f64)| if next.1 < best.1 { next } else { best };
        distances.enumerate().fold(first, closer).0
    }

    /// Moves the potentials so that the shortest paths found become tight.
    fn shift_potentials(&self, flow: &mut Flow, target: usize) {
        let length = self.distance[target];
        for &(source, distance) in &self.reached {
            flow.u[source] += length - distance;
        }
        // an open sink is at least `length` away, so only closed ones move
        for (v, distance) in flow.v.iter_mut().zip(&self.distance) {
            *v -= (length - distance).max(0.0);
        }
    }

    /// Sends as much as fits along the path from `root` to `target`.
    fn augment(&self, flow: &mut Flow, root: usize, target: usize) {
        let units = self.bottleneck(flow, root, target);
        flow.deficit[target] -= units;
        flow.excess[root] -= units;
        let mut sink = target;
        loop {
            let source = self.via[sink];
            flow.add(source, sink, units);
            if source == root {
                return;
            }
            sink = self.entered_from[source];
            flow.remove(source, sink, units);
        }
    }

    fn bottleneck(&self, flow: &Flow, root: usize, target: usize) -> usize {
        let mut units = flow.excess[root].min(flow.deficit[target]);
        let mut source = self.via[target];
        while source != root {
            let sink = self.entered_from[source];
            units = units.min(flow.units(source, sink));
            source = self.via[sink];
        }
        units
    }
}
