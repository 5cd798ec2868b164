//! Basis of the transport problem: a spanning tree of sources and sinks, and its pivot.
//!
//! Read this before editing. Nodes are numbered sources first (`0..n`), then sinks (`n..n + m`).
//! Each node but the root has one arc, to its parent; an arc always carries flow from its source to
//! its sink, whichever of the two is the parent. `price` is a source's potential `u_i` and *minus*
//! a sink's potential `v_j`, so that along an arc of the tree `price[source] - price[sink] = cost`
//! and a whole subtree moves by one number.

use super::mass::Mass;

/// Node index that stands for "no node".
pub(crate) const NONE: u32 = u32::MAX;

/// Rounding error of a reduced cost, as a fraction of the largest node price: a few last bits.
const PRICE_TOLERANCE: f64 = 1e-14;

/// Arc (source, sink) that enters the basis in a pivot because it lowers the cost.
#[derive(Clone, Copy, Debug, PartialEq)]
pub(crate) struct Entering {
    pub(crate) source: u32,
    /// Index of the arc's sink among the sinks, not among the nodes.
    pub(crate) sink: u32,
    /// Reduced cost of the arc, negative.
    pub(crate) reduced: f64,
}

/// Basis of the network simplex method: a spanning tree of sources and sinks, with the flows of its
/// arcs and the prices of its nodes. The children of a node form a doubly linked list.
#[derive(Clone, Debug, Default)]
pub(crate) struct Basis {
    sources: usize,
    parent: Vec<u32>,
    flow: Vec<Mass>,
    first_child: Vec<u32>,
    next: Vec<u32>,
    previous: Vec<u32>,
    price: Vec<f64>,
    /// For each node, the number of the last search of a common ancestor that visited it.
    visited: Vec<u32>,
    search: u32,
    stack: Vec<u32>,
}

impl Basis {
    /// Removes all arcs of the spanning tree and sets the numbers of sources and sinks.
    pub(crate) fn reset(&mut self, sources: usize, sinks: usize) {
        let nodes = sources + sinks;
        self.sources = sources;
        let links = [&mut self.parent, &mut self.first_child, &mut self.next, &mut self.previous];
        for list in links {
            list.clear();
            list.resize(nodes, NONE);
        }
        self.flow.clear();
        self.flow.resize(nodes, Mass::ZERO);
        self.price.clear();
        self.price.resize(nodes, 0.0);
        self.visited.clear();
        self.visited.resize(nodes, 0);
        self.search = 0;
        // a walk's stack depends on the tree's shape, but never holds more than all nodes
        self.stack.reserve(nodes);
    }

    pub(crate) fn nodes(&self) -> usize {
        self.parent.len()
    }

    pub(crate) fn source_prices(&self) -> &[f64] {
        &self.price[..self.sources]
    }

    pub(crate) fn sink_prices(&self) -> &[f64] {
        &self.price[self.sources..]
    }

    /// Returns the magnitude that a reduced cost may have by rounding alone.
    pub(crate) fn price_tolerance(&self) -> f64 {
        PRICE_TOLERANCE * self.price.iter().fold(0.0, |top: f64, p| top.max(p.abs()))
    }

    pub(crate) fn is_root(&self, node: u32) -> bool {
        self.parent[node as usize] == NONE
    }

    /// Attaches a node without a parent below `parent`, by an arc with the given flow.
    pub(crate) fn attach(&mut self, node: u32, parent: u32, flow: Mass) {
        let sibling = self.first_child[parent as usize];
        self.parent[node as usize] = parent;
        self.flow[node as usize] = flow;
        self.next[node as usize] = sibling;
        self.previous[node as usize] = NONE;
        if sibling != NONE {
            self.previous[sibling as usize] = node;
        }
        self.first_child[parent as usize] = node;
    }

    fn detach(&mut self, node: u32) {
        let (previous, next) = (self.previous[node as usize], self.next[node as usize]);
        match previous {
            NONE => self.first_child[self.parent[node as usize] as usize] = next,
            _ => self.next[previous as usize] = next,
        }
        if next != NONE {
            self.previous[next as usize] = previous;
        }
    }

    fn is_source(&self, node: u32) -> bool {
        (node as usize) < self.sources
    }

    /// Returns source index and sink index of the arc between a node and its parent.
    fn arc(&self, node: u32) -> (usize, usize) {
        let (node, parent) = (node as usize, self.parent[node as usize] as usize);
        if node < self.sources {
            (node, parent - self.sources)
        } else {
            (parent, node - self.sources)
        }
    }

    /// Calls `f(source, sink, flow)` for each arc of the tree, in the order of the child nodes.
    pub(crate) fn for_each_arc(&self, mut f: impl FnMut(usize, usize, Mass)) {
        for node in (0..self.nodes() as u32).filter(|&node| !self.is_root(node)) {
            let (source, sink) = self.arc(node);
            f(source, sink, self.flow[node as usize]);
        }
    }

    /// Computes all node prices afresh from the cost matrix `[sources, sinks]`, parents before
    /// their children, which undoes accumulated rounding.
    pub(crate) fn refresh_prices(&mut self, cost: &[f64]) {
        let sinks = self.nodes() - self.sources;
        let root = self.parent.iter().position(|&parent| parent == NONE);
        let mut stack = std::mem::take(&mut self.stack);
        stack.extend(root.map(|root| root as u32));
        while let Some(parent) = stack.pop() {
            let mut child = self.first_child[parent as usize];
            while child != NONE {
                let (source, sink) = self.arc(child);
                let cost = cost[source * sinks + sink];
                let signed = if self.is_source(child) { cost } else { -cost };
                self.price[child as usize] = self.price[parent as usize] + signed;
                stack.push(child);
                child = self.next[child as usize];
            }
        }
        self.stack = stack;
    }

    /// Brings the arc `entering` into the basis: sends as much flow as fits around the cycle that
    /// it closes, drops the arc whose flow becomes 0, and shifts the prices of the subtree cut off
    /// by it.
    pub(crate) fn pivot(&mut self, entering: Entering) {
        let source = entering.source;
        let sink = entering.sink + self.sources as u32;
        let top = self.common_ancestor(source, sink);
        let (below_source, from_source) = self.narrowest(source, top, true);
        let (below_sink, from_sink) = self.narrowest(sink, top, false);
        // at most one end is the top, and the arc above the other one shrinks: the flow is bounded
        let flow = from_source.min(from_sink);
        // flows change before the tree does, since `send` follows the parents along the old cycle
        self.send(source, top, flow, true);
        self.send(sink, top, flow, false);
        if from_source <= from_sink {
            self.hang(source, below_source, sink, flow);
            self.shift(source, entering.reduced);
        } else {
            self.hang(sink, below_sink, source, flow);
            self.shift(sink, -entering.reduced);
        }
    }

    fn common_ancestor(&mut self, mut a: u32, mut b: u32) -> u32 {
        // marks of earlier searches have smaller numbers, so they need not be cleared
        self.search += 1;
        loop {
            for node in [&mut a, &mut b] {
                if *node == NONE {
                    continue;
                }
                let visited = &mut self.visited[*node as usize];
                if *visited == self.search {
                    return *node;
                }
                *visited = self.search;
                *node = self.parent[*node as usize];
            }
        }
    }

    /// Returns the lower node and the flow of the arc with the smallest flow, among those between
    /// `from` and `top` that a pivot would shrink. On the entering source's side these belong to
    /// sources, on the sink's side to sinks.
    fn narrowest(&self, from: u32, top: u32, source_side: bool) -> (u32, Mass) {
        let (mut node, mut found) = (from, (NONE, Mass::MAX));
        while node != top {
            let flow = self.flow[node as usize];
            if self.is_source(node) == source_side && flow < found.1 {
                found = (node, flow);
            }
            node = self.parent[node as usize];
        }
        found
    }

    fn send(&mut self, from: u32, top: u32, flow: Mass, source_side: bool) {
        let mut node = from;
        while node != top {
            if self.is_source(node) == source_side {
                self.flow[node as usize] -= flow
            } else {
                self.flow[node as usize] += flow
            }
            node = self.parent[node as usize];
        }
    }

    /// Hangs the subtree below the leaving arc (above `cut`) onto `parent` by its node `from`: the
    /// path between the two turns around, each arc keeping its flow.
    fn hang(&mut self, from: u32, cut: u32, parent: u32, flow: Mass) {
        let (mut node, mut parent, mut flow) = (from, parent, flow);
        loop {
            let above = (self.parent[node as usize], self.flow[node as usize]);
            self.detach(node);
            self.attach(node, parent, flow);
            if node == cut {
                return;
            }
            parent = node;
            (node, flow) = above;
        }
    }

    /// Adds `amount` to the prices of all nodes of the subtree below and including `node`.
    fn shift(&mut self, node: u32, amount: f64) {
        let mut stack = std::mem::take(&mut self.stack);
        stack.push(node);
        while let Some(next) = stack.pop() {
            self.price[next as usize] += amount;
            let mut child = self.first_child[next as usize];
            while child != NONE {
                stack.push(child);
                child = self.next[child as usize];
            }
        }
        self.stack = stack;
    }
}
