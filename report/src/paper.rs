//! Table 1 of the paper (Liu et al., CoRL 2023).

use experiments::presets::Method;

/// Groups of the paper, in the order of its columns.
const GROUPS: [&str; 4] = ["plate-slide", "button-press", "drawer-close", "goal-reach"];

/// Row of the paper's Table 1: a method's success in `[0, 1]` and reward in `[0, 500]`.
pub struct PaperRow {
    /// Preset that corresponds to the method of the paper.
    pub method: Method,
    /// Success and reward of each of [`GROUPS`].
    groups: [(f64, f64); 4],
    /// Averages of success and reward, as the paper prints them.
    pub average_success_and_reward: (f64, f64),
}

impl PaperRow {
    /// Returns success and reward of a task group in this row; `None` for a group that is not in
    /// the paper.
    pub fn group_success_and_reward(&self, name: &str) -> Option<(f64, f64)> {
        let column = GROUPS.iter().position(|group| *group == name)?;
        Some(self.groups[column])
    }
}

/// Returns a method's row of the paper's Table 1; `None` for a method that is not in the paper.
pub fn paper_row(method: Method) -> Option<&'static PaperRow> {
    // the paper does not say how wide the networks of COVERS-CNN are: both widths get its row
    let method = match method {
        Method::CoversCnnSlim => Method::CoversCnn,
        other => other,
    };
    ROWS.iter().find(|row| row.method == method)
}

const fn printed(method: Method, groups: [(f64, f64); 4], average: (f64, f64)) -> PaperRow {
    PaperRow { method, groups, average_success_and_reward: average }
}

// Each line is a line of the paper's table.
#[rustfmt::skip]
const ROWS: [PaperRow; 7] = [
    printed(Method::Covers,    [(0.97, 344.0), (0.87, 323.0), (0.82, 400.0), (0.98, 484.0)], (0.91, 388.0)),
    printed(Method::ThreeRl,   [(0.28, 101.0), (0.52, 261.0), (0.40, 281.0), (0.60, 322.0)], (0.44, 241.0)),
    printed(Method::Clear,     [(0.06,  66.0), (0.31, 139.0), (0.27, 216.0), (0.58, 294.0)], (0.30, 179.0)),
    printed(Method::Cnn,       [(0.03,  23.0), (0.09,  91.0), (0.16, 116.0), (0.14, 151.0)], (0.10, 96.0)),
    printed(Method::Equi,      [(0.02,  64.0), (0.01, 121.0), (0.40, 273.0), (0.47, 307.0)], (0.22, 191.0)),
    printed(Method::CoversGt,  [(0.91, 337.0), (0.87, 331.0), (0.98, 417.0), (0.97, 488.0)], (0.93, 393.0)),
    printed(Method::CoversCnn, [(0.62, 232.0), (0.26, 181.0), (0.56, 227.0), (0.97, 481.0)], (0.60, 280.0)),
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn averages_are_those_of_the_groups_up_to_rounding() {
        for row in &ROWS {
            let mean =
                |figure: fn(&(f64, f64)) -> f64| row.groups.iter().map(figure).sum::<f64>() / 4.0;
            let success = mean(|group| group.0);
            assert!(
                (success - row.average_success_and_reward.0).abs() < 0.011,
                "{:?} {success}",
                row.method
            );
            let reward = mean(|group| group.1);
            assert!(
                (reward - row.average_success_and_reward.1).abs() < 1.0,
                "{:?} {reward}",
                row.method
            );
        }
    }
}
