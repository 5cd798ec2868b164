//! Weights as exact integers, perturbed so that no basis of the transport problem is degenerate.

use std::ops::{AddAssign, Sub, SubAssign};

use super::problem::PointWeights;

/// Number of integer units of the whole mass, for weights given as numbers: finer than the rounding
/// of an `f64` near 1.
const FINE: i64 = 1 << 60;

/// Amount of transported mass: whole units, and a number of infinitesimals.
///
/// The infinitesimals are Orden's perturbation. They change the supplies so that no proper subset
/// of sources supplies exactly what a subset of sinks demands. Every basic flow is then positive,
/// each pivot lowers the cost and the simplex method cannot cycle. Two amounts are compared by
/// their units first. The perturbation costs no precision, because the units alone are the flow of
/// the problem as given.
#[derive(Clone, Copy, Debug, Default, PartialEq, Eq, PartialOrd, Ord)]
pub(crate) struct Mass {
    pub(crate) units: i64,
    infinitesimals: i64,
}

impl Mass {
    pub(crate) const ZERO: Self = Self { units: 0, infinitesimals: 0 };
    pub(crate) const MAX: Self = Self { units: i64::MAX, infinitesimals: 0 };
}

impl Sub for Mass {
    type Output = Self;

    fn sub(self, other: Self) -> Self {
        Self {
            units: self.units - other.units,
            infinitesimals: self.infinitesimals - other.infinitesimals,
        }
    }
}

impl AddAssign for Mass {
    fn add_assign(&mut self, other: Self) {
        self.units += other.units;
        self.infinitesimals += other.infinitesimals;
    }
}

impl SubAssign for Mass {
    fn sub_assign(&mut self, other: Self) {
        *self = *self - other;
    }
}

/// Supplies of the sources and demands of the sinks of a transport problem.
#[derive(Clone, Debug, Default)]
pub(crate) struct Balance {
    /// Supply or demand of each node, sources first.
    pub(crate) masses: Vec<Mass>,
    /// Number of units of mass on each side in total.
    pub(crate) total: i64,
}

impl Balance {
    /// Computes the supplies and demands from the weights of sources and sinks, which were checked.
    pub(crate) fn fill(&mut self, sources: PointWeights, sinks: PointWeights) {
        let (n, m) = (sources.len(), sinks.len());
        self.masses.clear();
        self.masses.resize(n + m, Mass::ZERO);
        let (supplies, demands) = self.masses.split_at_mut(n);
        self.total = match (sources, sinks) {
            (PointWeights::Uniform(_), PointWeights::Uniform(_)) => {
                // n sources of m units and m sinks of n units, in the smallest whole numbers
                let divisor = gcd(n, m);
                supplies.fill(whole(m / divisor));
                demands.fill(whole(n / divisor));
                (n / divisor * m) as i64
            }
            _ => {
                apportion(sources, supplies);
                apportion(sinks, demands);
                FINE
            }
        };
        perturb(supplies, demands);
    }
}

fn whole(units: usize) -> Mass {
    Mass { units: units as i64, infinitesimals: 0 }
}

/// Perturbs supplies and demands: each source gets `m` infinitesimals and each sink one; the last
/// sink balances. A subset of sinks without the last one holds fewer than `m` of them, so it never
/// equals a subset of sources, and neither does its complement.
fn perturb(supplies: &mut [Mass], demands: &mut [Mass]) {
    let (n, m) = (supplies.len() as i64, demands.len() as i64);
    supplies.iter_mut().for_each(|s| s.infinitesimals = m);
    demands.iter_mut().for_each(|d| d.infinitesimals = 1);
    if let Some(last) = demands.last_mut() {
        last.infinitesimals = n * m - (m - 1);
    }
}

/// Rounds weights to integer units of mass. The heaviest takes the remainder, where it changes the
/// least in relation.
fn apportion(weights: PointWeights, masses: &mut [Mass]) {
    let sum = weights.sum();
    for (index, mass) in masses.iter_mut().enumerate() {
        mass.units = (weights.get(index) / sum * FINE as f64).round() as i64;
    }
    let left = FINE - masses.iter().map(|m| m.units).sum::<i64>();
    if let Some(heaviest) = masses.iter_mut().max() {
        heaviest.units += left;
    }
}

fn gcd(a: usize, b: usize) -> usize {
    if b == 0 { a } else { gcd(b, a % b) }
}

#[cfg(test)]
mod tests {
    use super::*;

    fn balance(sources: PointWeights, sinks: PointWeights) -> Balance {
        let mut balance = Balance::default();
        balance.fill(sources, sinks);
        balance
    }

    #[test]
    fn both_sides_carry_the_same_mass() {
        let weights = [0.1, 0.0, 0.6, 0.3];
        for sinks in [PointWeights::Uniform(7), PointWeights::Given(&weights)] {
            let b = balance(PointWeights::Given(&weights), sinks);
            let side = |part: &[Mass]| {
                part.iter().fold(Mass::ZERO, |mut sum, m| {
                    sum += *m;
                    sum
                })
            };
            let (supplies, demands) = b.masses.split_at(4);
            assert_eq!(side(supplies), side(demands));
            assert_eq!(side(supplies).units, b.total);
        }
    }

    #[test]
    fn no_proper_subset_of_sources_equals_one_of_sinks() {
        // the worst case: all weights equal, one of them zero
        let weights = [0.5, 0.0, 0.5];
        let b = balance(PointWeights::Given(&weights), PointWeights::Given(&weights));
        for subset in 1..63_u32 {
            let mut difference = Mass::ZERO;
            for (index, mass) in b.masses.iter().enumerate() {
                if subset >> index & 1 == 1 {
                    if index < 3 { difference += *mass } else { difference -= *mass }
                }
            }
            assert_ne!(difference, Mass::ZERO, "{subset:b}");
        }
    }

    #[test]
    fn uniform_weights_are_small_whole_numbers() {
        let b = balance(PointWeights::Uniform(4), PointWeights::Uniform(6));
        assert_eq!(b.total, 12);
        assert!(b.masses[..4].iter().all(|m| m.units == 3));
        assert!(b.masses[4..].iter().all(|m| m.units == 2));
    }
}
