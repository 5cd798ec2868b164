//! What a learner logs: values with names, so that different learners share one table.

use std::fmt;

/// One logged value.
#[derive(Clone, Debug, PartialEq)]
pub enum Metric {
    /// A number.
    Number(f64),
    /// One number for each policy, in their order; none where there was nothing to measure.
    PerPolicy(Vec<Option<f64>>),
}

impl fmt::Display for Metric {
    /// The cell of a table: the shortest decimal that reads back to the same bits; numbers of
    /// several policies are joined by semicolons, and what was not measured is empty.
    fn fmt(&self, f: &mut fmt::Formatter<'_>) -> fmt::Result {
        match self {
            Self::Number(value) => write!(f, "{value}"),
            Self::PerPolicy(values) => {
                let cells: Vec<String> = values
                    .iter()
                    .map(|value| value.map_or_else(String::new, |value| value.to_string()))
                    .collect();
                f.write_str(&cells.join(";"))
            }
        }
    }
}

/// Named values, in the order in which they are logged.
#[derive(Clone, Debug, Default, PartialEq)]
pub struct Metrics(Vec<(String, Metric)>);

impl Metrics {
    /// Adds a number.
    pub fn number(&mut self, name: impl Into<String>, value: f64) {
        self.0.push((name.into(), Metric::Number(value)));
    }

    /// Adds one number for each policy.
    pub fn per_policy(
        &mut self,
        name: impl Into<String>,
        values: impl IntoIterator<Item = Option<f64>>,
    ) {
        let values = Metric::PerPolicy(values.into_iter().collect());
        self.0.push((name.into(), values));
    }

    /// The value of this name.
    pub fn get(&self, name: &str) -> Option<&Metric> {
        self.iter().find(|(own, _)| *own == name).map(|(_, m)| m)
    }

    /// Names and values in their order.
    pub fn iter(&self) -> impl Iterator<Item = (&str, &Metric)> {
        self.0.iter().map(|(name, value)| (name.as_str(), value))
    }
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn cells_read_back_to_the_same_bits_and_gaps_are_empty() {
        let mut metrics = Metrics::default();
        metrics.number("loss", 0.1 + 0.2);
        metrics.per_policy("distances", [Some(1.5), None, Some(-2.0)]);
        let loss = metrics.get("loss").unwrap().to_string();
        assert_eq!(loss.parse::<f64>().unwrap(), 0.1 + 0.2);
        assert_eq!(metrics.get("distances").unwrap().to_string(), "1.5;;-2");
        assert_eq!(metrics.get("lost"), None);
        let names: Vec<&str> = metrics.iter().map(|(name, _)| name).collect();
        assert_eq!(names, ["loss", "distances"]);
    }
}
