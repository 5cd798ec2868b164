//! Plan of a sweep: methods, variants and seeds, and the jobs that they give.

use std::collections::{HashMap, HashSet};
use std::fmt::Display;
use std::hash::Hash;
use std::path::{Path, PathBuf};

use envs::TaskRegistry;
use serde::{Deserialize, Serialize};

use experiments::presets::{Budget, Method};
use experiments::{Experiment, RunError};
use learner::overrides::{self, SettingOverride, parse_json, read_json};

/// Largest number of jobs of a plan.
const MAX_JOBS: usize = 100_000;
/// Largest number of characters in the name of a variant; the names of folders have at most 255.
const MAX_VARIANT_NAME: usize = 100;

/// Plan of a sweep, as a JSON file holds it: all combinations of methods, variants and seeds.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SweepPlan {
    /// Methods of the sweep, in the order of the jobs.
    pub methods: Vec<Method>,
    /// Seeds with which each method, or each of its variants, runs. All methods run with one seed
    /// before the next, so that an interrupted sweep compares methods fairly.
    pub seeds: Vec<u64>,
    /// Length of each run.
    pub budget: Budget,
    /// Overrides of the preset in every run, as for `--set`. They must not set the seed; a number
    /// of threads is ignored, since each worker sets its own.
    #[serde(default)]
    pub set: Vec<String>,
    /// Variants of every method, for a study of settings; if empty, each method runs once per seed.
    #[serde(default)]
    pub variants: Vec<SettingsVariant>,
}

/// Named variant of the settings, one arm of a study.
#[derive(Clone, Debug, PartialEq, Serialize, Deserialize)]
#[serde(deny_unknown_fields)]
pub struct SettingsVariant {
    /// Name of the variant, which follows the method's name in the folders of its runs.
    pub name: String,
    /// Overrides that apply after the plan's own `set`.
    #[serde(default)]
    pub set: Vec<String>,
}

/// One run of a sweep: a method, a variant of its settings and a seed.
#[derive(Clone, Debug, PartialEq)]
pub struct SweepJob {
    /// Name of the run's folder.
    pub folder_name: String,
    /// Settings of the job's run.
    pub experiment: Experiment,
}

impl SweepPlan {
    /// Reads the plan of a sweep from a JSON file.
    ///
    /// # Errors
    /// [`RunError::Read`] with the file and the problem.
    pub fn read(path: &Path) -> Result<Self, RunError> {
        Ok(read_json(path)?)
    }

    /// Reads the plan of a sweep from JSON text.
    ///
    /// # Errors
    /// [`learner::LearnerError::NotJson`], [`learner::LearnerError::UnknownSetting`],
    /// [`learner::LearnerError::WrongSetting`].
    pub fn parse(text: &str) -> Result<Self, RunError> {
        Ok(parse_json(text)?)
    }

    /// Returns the jobs of the plan after checking all of them.
    ///
    /// # Errors
    /// [`RunError::InvalidSetting`] for a plan without methods or seeds, with more than 100,000
    /// jobs, with duplicate methods, seeds or variants, with variants of equal settings, with a
    /// variant's name that no folder can have, or with a seed in `set`; errors of
    /// [`Experiment::check`].
    pub fn jobs(&self) -> Result<Vec<SweepJob>, RunError> {
        let (jobs, tasks) = (self.jobs_unchecked()?, TaskRegistry::with_all());
        // All methods and variants before the first one runs, so that no sweep fails after days.
        // Seeds follow another in the list, and make no settings wrong.
        let different_settings = jobs.len() / self.seeds.len();
        let mut experiments = jobs[..different_settings].iter().map(|job| &job.experiment);
        experiments.try_for_each(|experiment| experiment.check(&tasks))?;
        Ok(jobs)
    }

    /// Returns the jobs of the plan in their order; checks the plan itself, but does not call
    /// [`Experiment::check`] on the settings.
    ///
    /// # Errors
    /// As [`SweepPlan::jobs`], without errors of [`Experiment::check`].
    pub fn jobs_unchecked(&self) -> Result<Vec<SweepJob>, RunError> {
        let methods: Vec<&str> = self.methods.iter().map(|method| method.name()).collect();
        distinct("methods", &methods)?;
        distinct("seeds", &self.seeds)?;
        let arms = self.arms()?;
        let count = self.seeds.len() * arms.len() * self.methods.len();
        if count > MAX_JOBS {
            return Err(RunError::invalid(
                "seeds",
                format!("a list that makes {count} jobs"),
                "at most 100000 jobs in one plan: split it",
            ));
        }
        let mut settings = Vec::with_capacity(arms.len() * self.methods.len());
        for arm in &arms {
            for &method in &self.methods {
                let name = format!("{}{}", method.name(), arm.suffix);
                settings.push((name, self.settings(method, arm)?));
            }
        }
        let names: Vec<&str> = settings.iter().map(|(name, _)| name.as_str()).collect();
        distinct("variants", &names)?;
        different(&settings)?;
        let jobs = self.seeds.iter().flat_map(|&seed| {
            settings.iter().map(move |(name, experiment)| SweepJob {
                folder_name: format!("{name}-seed{seed}"),
                experiment: experiment.clone().with_seed(seed),
            })
        });
        Ok(jobs.collect())
    }

    /// Returns a warning if methods of the plan see different streams; `jobs` are those of the plan.
    pub fn stream_warning(&self, jobs: &[SweepJob]) -> Option<String> {
        let [first, other] = jobs.chunks(self.methods.len()).find_map(|of_variant| {
            let (first, others) = of_variant.split_first()?;
            let stream = &first.experiment.schedule;
            let other = others.iter().find(|job| job.experiment.schedule != *stream)?;
            Some([first, other].map(|job| &job.folder_name))
        })?;
        Some(format!(
            "{first} and {other} see different streams, which `covers report` does not compare: \
             set `schedule.groups` in the plan, or write a plan for each"
        ))
    }

    /// Returns the variants with all their overrides; without variants, one arm without a name.
    fn arms(&self) -> Result<Vec<Arm<'_>>, RunError> {
        if self.variants.is_empty() {
            return Ok(vec![Arm::new(None, &self.set, &[])?]);
        }
        let names: Vec<&str> = self.variants.iter().map(|own| own.name.as_str()).collect();
        distinct("variants", &names)?;
        let variants = self.variants.iter();
        let arms = variants.map(|own| Arm::new(Some(&own.name), &self.set, &own.set));
        arms.collect()
    }

    /// Returns the settings of a method in one arm, whose seed is to be set.
    fn settings(&self, method: Method, arm: &Arm) -> Result<Experiment, RunError> {
        let preset = self.budget.preset_experiment(method);
        // two seeds, so that an override is found even if it sets one of them
        let [settings, other] =
            [0, 1].map(|seed| overrides::apply_overrides(&arm.set, preset.clone().with_seed(seed)));
        let (settings, other) = (settings?, other?);
        if settings.learner.seed() == other.learner.seed() {
            return Err(RunError::invalid(
                "set",
                serde_json::json!(arm.text),
                "no seed: `seeds` lists them",
            ));
        }
        Ok(method.adapt_to_stream(settings, &arm.set).with_threads(1))
    }
}

/// Variant of a sweep's settings with parsed overrides.
struct Arm<'a> {
    suffix: String,
    text: Vec<&'a str>,
    set: Vec<SettingOverride>,
}

impl<'a> Arm<'a> {
    fn new(name: Option<&str>, all: &'a [String], own: &'a [String]) -> Result<Self, RunError> {
        let text: Vec<&str> = all.iter().chain(own).map(String::as_str).collect();
        let set = text.iter().map(|text| text.parse()).collect::<Result<_, _>>()?;
        let suffix = match name {
            None => String::new(),
            Some(name) => format!("-{}", folder_part(name)?),
        };
        Ok(Self { suffix, text, set })
    }
}

/// Rejects names of variants that could not be told apart from method and seed in a folder's name.
fn folder_part(name: &str) -> Result<&str, RunError> {
    let plain = |letter: char| letter.is_ascii_alphanumeric() || letter == '-' || letter == '.';
    if (1..=MAX_VARIANT_NAME).contains(&name.len())
        && name.chars().all(plain)
        && !name.starts_with("seed")
        && !name.contains("-seed")
    {
        return Ok(name);
    }
    Err(RunError::invalid(
        "variants",
        serde_json::json!(name),
        "a name of at most 100 letters, digits, dots and hyphens, of which no part \
            begins with `seed`",
    ))
}

impl SweepJob {
    /// Returns the path of the job's run folder in the folder `runs`.
    pub fn folder_path(&self, runs: &Path) -> PathBuf {
        runs.join(&self.folder_name)
    }
}

/// Rejects equal settings under different names, whose comparison would be meaningless.
fn different(settings: &[(String, Experiment)]) -> Result<(), RunError> {
    let mut names = HashMap::new();
    for (name, experiment) in settings {
        let text = serde_json::json!(experiment).to_string();
        if let Some(same) = names.insert(text, name) {
            return Err(RunError::invalid(
                "variants",
                format!("{same} and {name}, which are the same run"),
                "settings that differ, those of the preset included",
            ));
        }
    }
    Ok(())
}

/// Rejects a list that is empty or holds a value twice.
fn distinct<T: Eq + Hash + Display>(name: &'static str, values: &[T]) -> Result<(), RunError> {
    let mut seen = HashSet::new();
    let twice = values.iter().find(|value| !seen.insert(*value));
    let (value, expected) = match twice {
        Some(value) => (
            format!("a list that holds {value} twice"),
            "every value once: equal runs would share a folder",
        ),
        None if values.is_empty() => ("empty".to_owned(), "at least one value"),
        None => return Ok(()),
    };
    Err(RunError::invalid(name, value, expected))
}

#[cfg(test)]
mod tests {
    use super::*;
    use learner::LearnerSettings;

    const TEXT: &str = r#"{"methods": ["covers", "covers-gt"], "seeds": [20, 21],
        "budget": "smoke", "set": ["covers.ppo.gamma=0.9"]}"#;

    #[test]
    fn every_method_runs_with_a_seed_before_the_next_seed() {
        let jobs = SweepPlan::parse(TEXT).unwrap().jobs().unwrap();
        let names: Vec<&str> = jobs.iter().map(|job| job.folder_name.as_str()).collect();
        let expected = ["covers-seed20", "covers-gt-seed20", "covers-seed21", "covers-gt-seed21"];
        assert_eq!(names, expected);
        assert_eq!(jobs[3].experiment.learner.seed(), 21);
    }

    #[test]
    fn plans_that_make_no_sense_are_refused_by_name() {
        for (from, to, named) in [
            ("\"covers-gt\"", "\"covers\"", "`methods` is a list that holds covers twice"),
            ("20, 21", "", "`seeds` is empty"),
            ("20, 21", "7, 20, 20", "`seeds` is a list that holds 20 twice"),
            ("covers.ppo.gamma=0.9", "covers.seed=20", "`set` is [\"covers.seed=20\"]"),
            (
                "gamma=0.9",
                "gamma=7",
                "`covers.ppo.gamma` is 7, expected a number in [0, 1] (0.95 with",
            ),
            ("covers.ppo.gamma=0.9", "covers.seed=1", "expected no seed: `seeds` lists them"),
            ("\"budget\"", "\"budgit\"", "`budget`"),
            ("covers-gt", "covers-gtt", "; did you mean `covers-gt`?"),
            ("\"budget\"", "\"seeds\": [], \"budget\"", "duplicate field `seeds`"),
        ] {
            let changed = SweepPlan::parse(&TEXT.replace(from, to)).and_then(|plan| plan.jobs());
            let message = changed.unwrap_err().to_string();
            assert!(message.contains(named), "{message}");
        }
    }

    #[test]
    fn methods_that_see_different_streams_are_told() {
        let warning = |text: &str| {
            let plan = SweepPlan::parse(text).unwrap();
            plan.stream_warning(&plan.jobs().unwrap())
        };
        assert_eq!(warning(TEXT), None);
        let plan = r#"{"methods": ["covers", "covers-sac"], "seeds": [1], "budget": "short"}"#;
        let told = warning(plan).unwrap();
        assert!(told.starts_with("covers-seed1 and covers-sac-seed1 see different"), "{told}");
        let groups = r#"[{"group": "goal-reach", "decisions": 4000, "variants": ["identity"]}]"#;
        let set = serde_json::json!([format!("schedule.groups={groups}")]);
        assert_eq!(
            warning(&plan.replace("\"short\"", &format!("\"short\", \"set\": {set}"))),
            None
        );
    }

    #[test]
    fn variants_that_set_what_the_preset_has_are_refused() {
        let own =
            r#""variants": [{"name": "own"}, {"name": "same", "set": ["covers.ppo.clip=0.2"]}],"#;
        let text = TEXT.replace("\"budget\"", &format!("{own} \"budget\""));
        let message = SweepPlan::parse(&text).unwrap().jobs().unwrap_err().to_string();
        assert!(message.contains("covers-own and covers-same, which are the same"), "{message}");
        let text = text.replace("clip=0.2", "clip=0.3");
        assert!(SweepPlan::parse(&text).unwrap().jobs().is_ok());
    }

    #[test]
    fn a_plan_of_very_many_jobs_is_listed_in_no_time_or_refused() {
        let plan =
            |count| SweepPlan { seeds: (0..count).collect(), ..SweepPlan::parse(TEXT).unwrap() };
        let clock = std::time::Instant::now();
        assert_eq!(plan(20_000).jobs().unwrap().len(), 40_000);
        // comparing all pairs of jobs or seeds would take minutes
        assert!(clock.elapsed().as_secs() < 20, "{:?}", clock.elapsed());
        let message = plan(50_001).jobs().unwrap_err().to_string();
        assert!(message.contains("a list that makes 100002 jobs"), "{message}");
    }

    #[test]
    fn a_plan_that_is_no_file_is_refused() {
        let pipe = std::env::temp_dir().join(format!("covers-pipe-{}", std::process::id()));
        let made = std::process::Command::new("mkfifo").arg(&pipe).status();
        assert!(made.unwrap().success());
        for path in ["/dev/zero", "/dev/null", "/dev"].map(Path::new).into_iter().chain([&*pipe]) {
            let message = SweepPlan::read(path).unwrap_err().to_string();
            assert!(message.contains("it is not a regular file"), "{message}");
        }
        std::fs::remove_file(pipe).unwrap();
    }

    /// Returns the plans of the repository with their names.
    fn plans() -> Vec<(String, SweepPlan)> {
        let folder = Path::new(env!("CARGO_MANIFEST_DIR")).join("docs/results/plans");
        let files = std::fs::read_dir(folder).unwrap();
        let paths = files.map(|file| file.unwrap().path());
        let name = |path: &Path| path.file_stem().unwrap().to_string_lossy().into_owned();
        paths.map(|path| (name(&path), SweepPlan::read(&path).unwrap())).collect()
    }

    #[test]
    fn the_plans_of_the_project_have_jobs_that_can_be_finished() {
        for (name, plan) in plans() {
            let variants = plan.variants.len().max(1);
            let runs = plan.methods.len() * plan.seeds.len() * variants;
            assert_eq!(plan.jobs().unwrap().len(), runs, "{name}");
            let budget = Budget::Smoke;
            assert_eq!(SweepPlan { budget, ..plan }.jobs().unwrap().len(), runs, "{name}");
        }
    }

    /// Seeds below 1000 are reserved for published results, with a range for each family of plans;
    /// for the table, five for methods with PPO and three for all others.
    #[test]
    fn the_plans_of_the_table_run_every_method_on_the_same_stream() {
        let (tables, others): (Vec<_>, Vec<_>) =
            plans().into_iter().partition(|(name, _)| name.starts_with("table-"));
        for (name, plan) in others {
            let (seeds, number) = match name.split('-').next() {
                Some("efficiency") => (20..30, Some(10)),
                Some("groups") => (130..140, Some(10)),
                Some("ten") => (40..45, Some(5)),
                Some("all") => (49..50, Some(1)),
                Some("mt10") => (46..49, Some(3)),
                Some("sac") => (50..60, Some(10)),
                Some("factorial") => (60..70, Some(10)),
                Some("zero") => (90..100, Some(10)),
                Some("wide") => (90..100, Some(3)),
                Some("misaligned") => (80..85, Some(5)),
                Some("robot") => (85..90, Some(5)),
                _ => (1000..u64::MAX, None),
            };
            assert!(plan.seeds.iter().all(|seed| seeds.contains(seed)), "{name}");
            assert!(number.is_none_or(|n| plan.seeds.len() == n), "{name}");
        }
        let mut methods = Vec::new();
        for (name, plan) in tables {
            let seeds = if name == "table-sac" { 20..23 } else { 20..25 };
            assert!(plan.seeds.iter().copied().eq(seeds), "{name}");
            assert_eq!(plan.budget, Budget::TableProtocol, "{name}");
            assert!(plan.set.is_empty(), "{name}: presets and nothing else");
            for &method in &plan.methods {
                let sac = matches!(method.learner_settings(), LearnerSettings::OffPolicy(_));
                assert_eq!(sac, name == "table-sac", "{method:?}");
                methods.push(method);
            }
        }
        let all = Method::ALL.into_iter();
        let missing: Vec<Method> = all.filter(|method| !methods.contains(method)).collect();
        let expected =
            [Method::CoversRandomised, Method::CnnDrac, Method::CoversSac, Method::Paper];
        assert_eq!(missing, expected);
    }

    const STUDY: &str = r#"{"methods": ["covers"], "seeds": [1000], "budget": "smoke",
        "set": ["covers.ppo.gamma=0.9", "covers.ppo.epochs=3"],
        "variants": [{"name": "base"}, {"name": "far", "set": ["covers.ppo.gamma=0.99"]}]}"#;

    #[test]
    fn a_variant_sets_after_the_plan() {
        let jobs = SweepPlan::parse(STUDY).unwrap().jobs().unwrap();
        let names: Vec<&str> = jobs.iter().map(|job| job.folder_name.as_str()).collect();
        assert_eq!(names, ["covers-base-seed1000", "covers-far-seed1000"]);
        let ppo = jobs.iter().map(|job| match &job.experiment.learner {
            LearnerSettings::Covers(settings) => (settings.ppo.gamma, settings.ppo.epochs),
            other => panic!("{other:?}"),
        });
        assert_eq!(ppo.collect::<Vec<_>>(), [(0.9, 3), (0.99, 3)]);
    }

    #[test]
    fn variants_that_make_no_folders_are_refused_by_name() {
        for (name, named) in [
            ("base", "`variants` is a list that holds base twice"),
            ("a/b", "`variants` is \"a/b\""),
            ("", "`variants` is \"\""),
            ("seed1", "`variants` is \"seed1\""),
            ("x-seed1", "`variants` is \"x-seed1\""),
            (&"x".repeat(101), "at most 100 letters"),
        ] {
            let text = STUDY.replace("\"far\"", &format!("\"{name}\""));
            let message = SweepPlan::parse(&text).unwrap().jobs().unwrap_err().to_string();
            assert!(message.contains(named), "{message}");
        }
    }

    #[test]
    fn jobs_do_not_depend_on_threads() {
        let text = TEXT.replace("covers.ppo.gamma=0.9", "envs.threads=2");
        for job in SweepPlan::parse(&text).unwrap().jobs().unwrap() {
            assert_eq!(job.experiment.envs.threads, 1, "{}", job.folder_name);
        }
    }
}
