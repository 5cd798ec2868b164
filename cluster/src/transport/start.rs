//! First basis of a transport problem: greedy by costs less prices.

use super::basis::Basis;
use super::lanes::Lanes;
use super::mass::Mass;

/// Builder of the simplex method's first basis (spanning tree): sends mass along arc after arc.
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
}

impl Start {
    /// Builds the first basis of a transport problem from its costs and masses. Column means stand
    /// in for the sinks' potentials: they remove the part of a sink's costs that all sources share.
    /// The mass goes, source by source, to the sink of least cost plus price.
    pub(crate) fn build(&mut self, basis: &mut Basis, cost: &[f64], masses: &[Mass], sinks: usize) {
        let sources = masses.len() - sinks;
        self.prices.clear();
        self.prices.resize(sinks, 0.0);
        for row in cost.chunks_exact(sinks) {
            for (price, c) in self.prices.iter_mut().zip(row) {
                *price -= c / sources as f64;
            }
        }
        basis.reset(sources, sinks);
        self.left.clear();
        self.left.extend_from_slice(masses);
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

    fn open(&self, node: usize) -> bool {
        self.left[node] > Mass::ZERO
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
