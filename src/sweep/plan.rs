//! What a sweep runs.

use std::path::{Path, PathBuf};

use envs::TaskRegistry;
use serde::{Deserialize, Serialize};

use crate::error::CoversError;
use crate::experiment::Experiment;
use crate::overrides::{self, Override, typed};
use crate::presets::{Budget, Method};

/// Methods times seeds, as a JSON file holds them.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct Plan {
    /// The methods, in the order of the jobs.
    pub methods: Vec<Method>,
    /// The seeds; every method runs with each before the next seed's turn, so that a sweep that is
    /// broken off compares methods fairly.
    pub seeds: Vec<u64>,
    /// How long each run may take.
    pub budget: Budget,
    /// Settings that differ from the preset's in every run, as `--set` takes them.
    #[serde(default)]
    pub set: Vec<String>,
}

/// One run of a sweep.
#[derive(Clone, Debug, PartialEq)]
pub struct Job {
    /// The name of its folder.
    pub name: String,
    /// Its settings.
    pub experiment: Experiment,
}

impl Plan {
    /// Reads a plan.
    ///
    /// # Errors
    /// [`CoversError::Read`] names the file and what is wrong in it.
    pub fn read(path: &Path) -> Result<Self, CoversError> {
        let text = std::fs::read_to_string(path).map_err(|error| CoversError::read(path, error))?;
        let tree = serde_json::from_str(&text).map_err(|error| CoversError::read(path, error))?;
        typed(tree).map_err(|error| CoversError::read(path, error))
    }

    /// The jobs, all of them checked: no sweep fails after days for want of a check.
    ///
    /// # Errors
    /// [`CoversError::Setting`] for a plan without methods or seeds, or with one of them twice; what
    /// [`Experiment::check`] says.
    pub fn jobs(&self) -> Result<Vec<Job>, CoversError> {
        refuse_gaps("methods", &self.methods)?;
        refuse_gaps("seeds", &self.seeds)?;
        let set: Vec<Override> = self
            .set
            .iter()
            .map(|s| s.parse())
            .collect::<Result<_, _>>()?;
        let mut jobs = Vec::with_capacity(self.seeds.len() * self.methods.len());
        for &seed in &self.seeds {
            for &method in &self.methods {
                let experiment = self
                    .budget
                    .experiment(method)
                    .with_seed(seed)
                    .with_threads(1);
                let experiment = overrides::apply(&set, experiment)?;
                experiment.check(&TaskRegistry::standard())?;
                let name = format!("{}-seed{}", method.name(), experiment.learner.seed());
                jobs.push(Job { name, experiment });
            }
        }
        let mut names: Vec<&str> = jobs.iter().map(|job| job.name.as_str()).collect();
        names.sort_unstable();
        refuse_gaps("set", &names).map(|()| jobs)
    }
}

impl Job {
    /// Its folder among the sweep's runs.
    pub fn folder(&self, runs: &Path) -> PathBuf {
        runs.join(&self.name)
    }
}

fn refuse_gaps<T: PartialEq>(name: &'static str, values: &[T]) -> Result<(), CoversError> {
    let twice = (1..values.len()).any(|i| values[..i].contains(&values[i]));
    let (value, expected) = match (values.is_empty(), twice) {
        (true, _) => ("empty", "at least one"),
        (_, true) => (
            "a list with one twice",
            "each once: equal runs would share a folder",
        ),
        _ => return Ok(()),
    };
    Err(CoversError::Setting {
        name,
        value: value.to_owned(),
        expected,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    fn plan(text: &str) -> Result<Plan, CoversError> {
        typed(serde_json::from_str(text).unwrap())
    }

    const TEXT: &str = r#"{"methods": ["covers", "covers-gt"], "seeds": [20, 21],
        "budget": "smoke", "set": ["covers.ppo.gamma=0.9"]}"#;

    #[test]
    fn every_method_runs_with_a_seed_before_the_next_seed() {
        let jobs = plan(TEXT).unwrap().jobs().unwrap();
        let names: Vec<&str> = jobs.iter().map(|job| job.name.as_str()).collect();
        let expected = [
            "covers-seed20",
            "covers-gt-seed20",
            "covers-seed21",
            "covers-gt-seed21",
        ];
        assert_eq!(names, expected);
        assert_eq!(jobs[3].experiment.learner.seed(), 21);
    }

    #[test]
    fn plans_that_make_no_sense_are_refused_by_name() {
        for (from, to, named) in [
            ("\"covers-gt\"", "\"covers\"", "`methods`"),
            ("20, 21", "", "`seeds`"),
            ("gamma=0.9", "gamma=7", "gamma"),
            ("covers.ppo.gamma=0.9", "covers.seed=1", "`set`"),
            ("\"budget\"", "\"budgit\"", "`budget`"),
            ("covers-gt", "covers-gtt", "covers-gt"),
        ] {
            let changed = plan(&TEXT.replace(from, to)).and_then(|plan| plan.jobs());
            let message = changed.unwrap_err().to_string();
            assert!(message.contains(named), "{message}");
        }
    }
}
