//! What a sweep runs.

use std::fmt::Display;
use std::path::{Path, PathBuf};

use envs::TaskRegistry;
use serde::{Deserialize, Serialize};

use crate::error::CoversError;
use crate::experiment::Experiment;
use crate::overrides::{self, Override, parse};
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
    /// Settings that differ from the preset's in every run, as `--set` takes them. The seed is none
    /// of them. The number of threads is each worker's own, whatever stands here.
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
        Self::parse(&text).map_err(|error| CoversError::read(path, error))
    }

    /// Reads a plan from JSON.
    ///
    /// # Errors
    /// [`CoversError::NotJson`], [`CoversError::UnknownSetting`], [`CoversError::WrongSetting`].
    pub fn parse(text: &str) -> Result<Self, CoversError> {
        parse(text)
    }

    /// The jobs, all of them checked: no sweep fails after days for want of a check.
    ///
    /// # Errors
    /// [`CoversError::Setting`] for a plan without methods or seeds, with one of them twice, or
    /// with a seed in `set`; what [`Experiment::check`] says.
    pub fn jobs(&self) -> Result<Vec<Job>, CoversError> {
        let (jobs, tasks) = (self.listed()?, TaskRegistry::standard());
        let mut experiments = jobs.iter().map(|job| &job.experiment);
        experiments.try_for_each(|experiment| experiment.check(&tasks))?;
        Ok(jobs)
    }

    /// The jobs in their order, their settings not checked against each other.
    ///
    /// # Errors
    /// As [`Plan::jobs`], but for those of [`Experiment::check`].
    pub fn listed(&self) -> Result<Vec<Job>, CoversError> {
        let methods: Vec<&str> = self.methods.iter().map(|method| method.name()).collect();
        distinct("methods", &methods)?;
        distinct("seeds", &self.seeds)?;
        let set = self.set.iter().map(|text| text.parse());
        let set: Vec<Override> = set.collect::<Result<_, _>>()?;
        let mut jobs = Vec::with_capacity(self.seeds.len() * self.methods.len());
        for &seed in &self.seeds {
            for &method in &self.methods {
                jobs.push(self.job(method, seed, &set)?);
            }
        }
        Ok(jobs)
    }

    fn job(&self, method: Method, seed: u64, set: &[Override]) -> Result<Job, CoversError> {
        let preset = self.budget.experiment(method);
        // with a seed of another job, so that one that happens to be this job's is found, too
        let other = overrides::apply(set, preset.clone().with_seed(!seed))?;
        if other.learner.seed() != !seed {
            return Err(CoversError::Setting {
                name: "set",
                value: format!("{:?}", self.set),
                expected: "no seed: `seeds` lists them",
            });
        }
        let experiment = overrides::apply(set, preset.with_seed(seed))?.with_threads(1);
        let name = format!("{}-seed{seed}", method.name());
        Ok(Job { name, experiment })
    }
}

impl Job {
    /// Its folder among the sweep's runs.
    pub fn folder(&self, runs: &Path) -> PathBuf {
        runs.join(&self.name)
    }
}

/// Refuses a list that is empty or holds a value twice.
fn distinct<T: PartialEq + Display>(name: &'static str, values: &[T]) -> Result<(), CoversError> {
    let mut numbered = values.iter().enumerate();
    let twice = numbered.find(|(i, value)| values[..*i].contains(value));
    let (value, expected) = match twice {
        Some((_, value)) => (
            format!("a list that holds {value} twice"),
            "every value once: equal runs would share a folder",
        ),
        None if values.is_empty() => ("empty".to_owned(), "at least one value"),
        None => return Ok(()),
    };
    Err(CoversError::Setting {
        name,
        value,
        expected,
    })
}

#[cfg(test)]
mod tests {
    use super::*;

    const TEXT: &str = r#"{"methods": ["covers", "covers-gt"], "seeds": [20, 21],
        "budget": "smoke", "set": ["covers.ppo.gamma=0.9"]}"#;

    #[test]
    fn every_method_runs_with_a_seed_before_the_next_seed() {
        let jobs = Plan::parse(TEXT).unwrap().jobs().unwrap();
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
            (
                "\"covers-gt\"",
                "\"covers\"",
                "`methods` is a list that holds covers twice",
            ),
            ("20, 21", "", "`seeds` is empty"),
            (
                "20, 21",
                "7, 20, 20",
                "`seeds` is a list that holds 20 twice",
            ),
            (
                "covers.ppo.gamma=0.9",
                "covers.seed=20",
                "`set` is [\"covers.seed=20\"]",
            ),
            ("gamma=0.9", "gamma=7", "gamma = 7"),
            (
                "covers.ppo.gamma=0.9",
                "covers.seed=1",
                "`set` is [\"covers.seed=1\"]",
            ),
            ("\"budget\"", "\"budgit\"", "`budget`"),
            ("covers-gt", "covers-gtt", "`covers-gt`"),
            (
                "\"budget\"",
                "\"seeds\": [], \"budget\"",
                "duplicate field `seeds`",
            ),
        ] {
            let changed = Plan::parse(&TEXT.replace(from, to)).and_then(|plan| plan.jobs());
            let message = changed.unwrap_err().to_string();
            assert!(message.contains(named), "{message}");
        }
    }

    #[test]
    fn a_seed_in_the_settings_is_refused_also_for_a_single_seed() {
        let text = TEXT.replace("20, 21", "20");
        let text = text.replace("covers.ppo.gamma=0.9", "covers.seed=1");
        let message = Plan::parse(&text).unwrap().jobs().unwrap_err().to_string();
        assert!(message.contains("`seeds` lists them"), "{message}");
    }

    #[test]
    fn jobs_do_not_depend_on_threads() {
        let text = TEXT.replace("covers.ppo.gamma=0.9", "envs.threads=2");
        for job in Plan::parse(&text).unwrap().jobs().unwrap() {
            assert_eq!(job.experiment.envs.threads, 1, "{}", job.name);
        }
    }
}
