//! Values of small transport problems, found without the crate's solver.

/// Returns the optimal value where one side is one or two points, or where up to eight meet as many
/// of equal weight. Weights may have any common sum.
pub fn transport(cost: &[f64], a: &[f64], b: &[f64]) -> Option<f64> {
    let (n, m) = (a.len(), b.len());
    let transposed = || -> Vec<f64> { (0..n * m).map(|k| cost[(k % n) * m + k / n]).collect() };
    let equal = |weights: &[f64]| weights.iter().all(|w| *w == weights[0]);
    match (n, m) {
        (1, _) => Some(dot(cost, b)),
        (_, 1) => Some(dot(cost, a)),
        (2, _) => Some(two_sources(cost, a[0], b)),
        (_, 2) => Some(two_sources(&transposed(), b[0], a)),
        _ if n == m && n <= 8 && equal(a) && equal(b) => {
            Some(cheapest_matching(cost, n, 0, &mut vec![false; n]) * a[0])
        }
        _ => None,
    }
}

/// Returns the distance between points of equal weight on a line: the area between their
/// distribution functions, whose steps are whole numbers.
pub fn line(x: &[f32], y: &[f32]) -> f64 {
    let (n, m) = (x.len() as i64, y.len() as i64);
    let rising = x.iter().map(|&p| (f64::from(p), m));
    let mut steps: Vec<_> = rising.chain(y.iter().map(|&p| (f64::from(p), -n))).collect();
    steps.sort_by(|(s, _), (t, _)| s.total_cmp(t));
    let mut difference = 0;
    let areas = steps.windows(2).map(|pair| {
        difference += pair[0].1;
        difference.abs() as f64 * (pair[1].0 - pair[0].0)
    });
    areas.sum::<f64>() / (n * m) as f64
}

fn dot(cost: &[f64], weights: &[f64]) -> f64 {
    cost.iter().zip(weights).map(|(c, w)| c * w).sum()
}

/// Two sources: the second serves everybody, then the first takes over the sinks that gain most by
/// it.
fn two_sources(cost: &[f64], first: f64, b: &[f64]) -> f64 {
    let (near, far) = cost.split_at(b.len());
    let mut order: Vec<usize> = (0..b.len()).collect();
    let gain = |j: usize| near[j] - far[j];
    order.sort_by(|&j, &k| gain(j).total_cmp(&gain(k)));
    let mut left = first;
    let mut value = 0.0;
    for j in order {
        let mass = b[j].min(left);
        left -= mass;
        value += mass * near[j] + (b[j] - mass) * far[j];
    }
    value
}

/// Returns the smallest total cost of a perfect matching of the rows from `row` on with the unused
/// columns.
fn cheapest_matching(cost: &[f64], n: usize, row: usize, used: &mut Vec<bool>) -> f64 {
    if row == n {
        return 0.0;
    }
    let mut best = f64::INFINITY;
    for column in 0..n {
        if !used[column] {
            used[column] = true;
            best = best.min(cost[row * n + column] + cheapest_matching(cost, n, row + 1, used));
            used[column] = false;
        }
    }
    best
}
