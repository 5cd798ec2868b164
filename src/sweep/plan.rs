//! What a sweep runs.

use std::fmt::Display;
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
        let tree = serde_json::from_str(&text).map_err(|error| CoversError::read(path, error))?;
        typed(tree).map_err(|error| CoversError::read(path, error))
    }

    /// The jobs, all of them checked: no sweep fails after days for want of a check.
    ///
    /// # Errors
    /// [`CoversError::Setting`] for a plan without methods or seeds, with one of them twice, or
    /// with a seed in `set`; what [`Experiment::check`] says.
    pub fn jobs(&self) -> Result<Vec<Job>, CoversError> {
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
        experiment.check(&TaskRegistry::standard())?;
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
    use crate::learners::LearnerSettings;

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
        ] {
            let changed = plan(&TEXT.replace(from, to)).and_then(|plan| plan.jobs());
            let message = changed.unwrap_err().to_string();
            assert!(message.contains(named), "{message}");
        }
    }

    #[test]
    fn a_seed_in_the_settings_is_refused_also_for_a_single_seed() {
        let text = TEXT.replace("20, 21", "20");
        let text = text.replace("covers.ppo.gamma=0.9", "covers.seed=1");
        let message = plan(&text).unwrap().jobs().unwrap_err().to_string();
        assert!(message.contains("`seeds` lists them"), "{message}");
    }

    /// The plans that come with the project, by their names.
    fn plans() -> Vec<(String, Plan)> {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/results/plans");
        let files = std::fs::read_dir(folder).unwrap();
        let paths = files.map(|file| file.unwrap().path());
        let name = |path: &Path| path.file_stem().unwrap().to_string_lossy().into_owned();
        paths
            .map(|path| (name(&path), Plan::read(&path).unwrap()))
            .collect()
    }

    #[test]
    fn the_plans_of_the_project_have_jobs_that_can_be_finished() {
        for (name, plan) in plans() {
            let runs = plan.methods.len() * plan.seeds.len();
            assert_eq!(plan.jobs().unwrap().len(), runs, "{name}");
            let budget = Budget::Smoke;
            assert_eq!(
                Plan { budget, ..plan }.jobs().unwrap().len(),
                runs,
                "{name}"
            );
        }
    }

    /// Reported seeds for the table alone; five for each method that learns by PPO, three for each
    /// other.
    #[test]
    fn the_plans_of_the_table_run_every_method_on_the_same_stream() {
        let (tables, others): (Vec<_>, Vec<_>) = plans()
            .into_iter()
            .partition(|(name, _)| name.starts_with("table-"));
        for (name, plan) in others {
            assert!(plan.seeds.iter().all(|&seed| seed >= 1000), "{name}");
        }
        let mut methods = Vec::new();
        for (name, plan) in tables {
            let seeds = if name == "table-sac" { 20..23 } else { 20..25 };
            assert!(plan.seeds.iter().copied().eq(seeds), "{name}");
            assert_eq!(plan.budget, Budget::Table, "{name}");
            assert!(plan.set.is_empty(), "{name}: presets and nothing else");
            for &method in &plan.methods {
                let sac = matches!(method.learner(), LearnerSettings::OffPolicy(_));
                assert_eq!(sac, name == "table-sac", "{method:?}");
                methods.push(method);
            }
        }
        let all = Method::ALL.into_iter();
        let missing: Vec<Method> = all.filter(|method| !methods.contains(method)).collect();
        assert_eq!(missing, [Method::Paper]);
    }

    #[test]
    fn jobs_do_not_depend_on_threads() {
        let text = TEXT.replace("covers.ppo.gamma=0.9", "envs.threads=2");
        for job in plan(&text).unwrap().jobs().unwrap() {
            assert_eq!(job.experiment.envs.threads, 1, "{}", job.name);
        }
    }
}
