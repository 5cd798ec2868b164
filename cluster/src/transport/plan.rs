//! An optimal plan, and what proves it.

/// Mass that goes from one source to one sink.
#[derive(Clone, Copy, Debug, PartialEq)]
pub struct Entry {
    /// Row index, in `0..n`.
    pub source: usize,
    /// Column index, in `0..m`.
    pub sink: usize,
    /// `gamma_ij`, in `(0, 1]`.
    pub mass: f64,
}

/// A certified optimal plan and the potentials that prove it.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct TransportPlan {
    /// The optimal value `<gamma, M>` of the transport problem, in the costs' unit.
    pub cost: f64,
    /// The positive entries of `gamma`, at most `n + m - 1`; each (source, sink) pair occurs at
    /// most once.
    pub entries: Vec<Entry>,
    /// Dual potentials `u` of the sources, `[n]`.
    pub source_potentials: Vec<f64>,
    /// Dual potentials `v` of the sinks, `[m]`; `u_i + v_j <= c_ij` for all pairs.
    pub sink_potentials: Vec<f64>,
    /// How exactly the plan and the potentials prove each other.
    pub certificate: Certificate,
    /// Pivots of the simplex method.
    pub pivots: usize,
}

/// How exactly a plan and its potentials prove each other optimal.
///
/// The value of a plan exceeds the optimum by at most `gap + violation`, in the costs' unit.
#[derive(Clone, Copy, Debug, Default, PartialEq)]
pub struct Certificate {
    /// Largest deviation of a row or column sum of the plan from its weight, as a fraction of all
    /// mass.
    pub marginal_error: f64,
    /// Largest `u_i + v_j - c_ij` over all pairs, or zero, in the costs' unit.
    pub violation: f64,
    /// Cost of the plan less the value of the potentials, in magnitude, or what the entries cost
    /// above their potentials if that is more, in the costs' unit.
    pub gap: f64,
}
