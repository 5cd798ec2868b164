//! First basis of a transport problem: greedy by costs less prices, or from an earlier basis.

use super::basis::Basis;
use super::lanes::Lanes;
use super::mass::Mass;

/// Builder of a first basis (a spanning tree), which sends mass along one arc after another.
///
/// Each shipment is as large as its ends allow, so it exhausts one of them. It never exhausts both
/// but at the very end, because no proper subset of nodes balances. The exhausted node hangs below
/// the other. After one shipment less than there are nodes, the arcs form a spanning tree with a
/// positive flow, which is a basis.
#[derive(Clone, Debug, Default)]
pub(crate) struct Start {
    /// Mass that each node has left to send or receive.
    left: Vec<Mass>,
    /// Price of each sink: minus its potential, infinite once it is full.
    prices: Vec<f64>,
    /// Arcs `(source, sink)` of the earlier basis, parents before children.
    arcs: Vec<(u32, u32)>,
    /// Potentials of the sources in the earlier basis.
    source_prices: Vec<f64>,
}

impl Start {
    /// Builds the first basis of a problem from its costs and masses alone. Column means stand in
    /// for the sinks' potentials: they remove the part of a sink's costs that all sources share.
    pub(crate) fn cold(&mut self, basis: &mut Basis, cost: &[f64], masses: &[Mass], sinks: usize) {
        let sources = masses.len() - sinks;
        self.prices.clear();
        self.prices.resize(sinks, 0.0);
        for row in cost.chunks_exact(sinks) {
            for (price, c) in self.prices.iter_mut().zip(row) {
                *price -= c / sources as f64;
            }
        }
        self.begin(basis, masses, sinks);
        self.fill(basis, cost);
    }

    /// Builds the first basis of a problem from that of an earlier one with fewer nodes, or other
    /// weights or costs: as much mass as possible keeps its arcs, the rest goes by the earlier
    /// prices.
    pub(crate) fn warm(&mut self, basis: &mut Basis, cost: &[f64], masses: &[Mass], sinks: usize) {
        let sources = masses.len() - sinks;
        basis.arcs_downwards(&mut self.arcs);
        self.prices.clear();
        self.prices.extend_from_slice(basis.sink_prices());
        self.source_prices.clear();
        self.source_prices.extend_from_slice(basis.source_prices());
        self.prices.truncate(sinks);
        while self.prices.len() < sinks {
            self.prices.push(self.price_of(self.prices.len(), cost, sinks));
        }
        self.begin(basis, masses, sinks);
        // children before parents: the flows of a tree follow from its leaves
        for k in (0..self.arcs.len()).rev() {
            let (source, sink) = (self.arcs[k].0 as usize, self.arcs[k].1 as usize);
            if source < sources && sink < sinks && self.open(source) && self.open(sources + sink) {
                self.ship(basis, source, sink);
            }
        }
        self.fill(basis, cost);
    }

    /// Returns the price of a new sink at which no earlier source gains from it and one is
    /// indifferent.
    fn price_of(&self, sink: usize, cost: &[f64], sinks: usize) -> f64 {
        let column = cost.iter().skip(sink).step_by(sinks);
        let worth = column.zip(&self.source_prices).map(|(c, u)| c - u);
        -worth.fold(f64::INFINITY, f64::min)
    }

    fn begin(&mut self, basis: &mut Basis, masses: &[Mass], sinks: usize) {
        basis.reset(masses.len() - sinks, sinks);
        self.left.clear();
        self.left.extend_from_slice(masses);
    }

    fn open(&self, node: usize) -> bool {
        self.left[node] > Mass::ZERO
    }

    /// Sends the mass that is left, source by source, to the sink of least cost plus price.
    fn fill(&mut self, basis: &mut Basis, cost: &[f64]) {
        let sinks = self.prices.len();
        let sources = self.left.len() - sinks;
        for (price, left) in self.prices.iter_mut().zip(&self.left[sources..]) {
            if *left == Mass::ZERO {
                *price = f64::INFINITY;
            }
        }
        let lanes = Lanes::default();
        for (source, row) in cost.chunks_exact(sinks).enumerate() {
            while self.open(source) {
                // a source with mass left has a sink with room left
                let Some(sink) = lanes.nearest(row, &self.prices) else {
                    break;
                };
                self.ship(basis, source, sink);
            }
        }
        basis.refresh_prices(cost);
    }

    fn ship(&mut self, basis: &mut Basis, source: usize, sink: usize) {
        let sink_node = self.left.len() - self.prices.len() + sink;
        let flow = self.left[source].min(self.left[sink_node]);
        self.left[source] -= flow;
        self.left[sink_node] -= flow;
        let (source, node) = (source as u32, sink_node as u32);
        // the last shipment exhausts both ends: its sink becomes the root
        if self.open(sink_node) || !self.open(source as usize) {
            basis.attach(source, node, flow)
        } else {
            basis.attach(node, source, flow)
        }
        if !self.open(sink_node) {
            self.prices[sink] = f64::INFINITY;
        }
    }
}
