//! Table 1 of the paper: Liu et al., CoRL 2023.

/// Rewards of the paper are of 500.
pub struct PaperRow {
    /// The method as presets name it.
    pub method: &'static str,
    /// Success and reward of a group, by its name.
    groups: [(&'static str, f64, f64); 4],
    /// Averages of success and reward, as printed.
    pub average: (f64, f64),
}

impl PaperRow {
    /// Success and reward of a group; none for a group that the paper has not.
    pub fn group(&self, name: &str) -> Option<(f64, f64)> {
        let mut groups = self.groups.iter();
        let found = groups.find(|(group, ..)| *group == name);
        found.map(|&(_, success, reward)| (success, reward))
    }
}

/// The row of a method; none for one that the paper has not.
pub fn row(method: &str) -> Option<&'static PaperRow> {
    ROWS.iter().find(|row| row.method == method)
}

const P: &str = "plate-slide";
const B: &str = "button-press";
const D: &str = "drawer-close";
const G: &str = "goal-reach";

const ROWS: [PaperRow; 7] = [
    PaperRow {
        method: "covers",
        groups: [
            (P, 0.97, 344.0),
            (B, 0.87, 323.0),
            (D, 0.82, 400.0),
            (G, 0.98, 484.0),
        ],
        average: (0.91, 388.0),
    },
    PaperRow {
        method: "3rl",
        groups: [
            (P, 0.28, 101.0),
            (B, 0.52, 261.0),
            (D, 0.40, 281.0),
            (G, 0.60, 322.0),
        ],
        average: (0.44, 241.0),
    },
    PaperRow {
        method: "clear",
        groups: [
            (P, 0.06, 66.0),
            (B, 0.31, 139.0),
            (D, 0.27, 216.0),
            (G, 0.58, 294.0),
        ],
        average: (0.30, 179.0),
    },
    PaperRow {
        method: "cnn",
        groups: [
            (P, 0.03, 23.0),
            (B, 0.09, 91.0),
            (D, 0.16, 116.0),
            (G, 0.14, 151.0),
        ],
        average: (0.10, 96.0),
    },
    PaperRow {
        method: "equi",
        groups: [
            (P, 0.02, 64.0),
            (B, 0.01, 121.0),
            (D, 0.40, 273.0),
            (G, 0.47, 307.0),
        ],
        average: (0.22, 191.0),
    },
    PaperRow {
        method: "covers-gt",
        groups: [
            (P, 0.91, 337.0),
            (B, 0.87, 331.0),
            (D, 0.98, 417.0),
            (G, 0.97, 488.0),
        ],
        average: (0.93, 393.0),
    },
    PaperRow {
        method: "covers-cnn",
        groups: [
            (P, 0.62, 232.0),
            (B, 0.26, 181.0),
            (D, 0.56, 227.0),
            (G, 0.97, 481.0),
        ],
        average: (0.60, 280.0),
    },
];

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn averages_are_those_of_the_groups_up_to_rounding() {
        for row in &ROWS {
            let mean = |figure: fn(&(&str, f64, f64)) -> f64| {
                row.groups.iter().map(figure).sum::<f64>() / 4.0
            };
            let success = mean(|group| group.1);
            assert!(
                (success - row.average.0).abs() < 0.011,
                "{} {success}",
                row.method
            );
            let reward = mean(|group| group.2);
            assert!(
                (reward - row.average.1).abs() < 1.0,
                "{} {reward}",
                row.method
            );
        }
    }
}
