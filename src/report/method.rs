//! Runs of one method with different seeds.

use crate::error::CoversError;
use crate::experiment::Experiment;
use crate::overrides::differences;

use super::figures::{Figures, GroupFigures};
use super::run_data::RunData;
use super::statistics::Scores;

/// The part of a folder's name before the seed.
const SEED: &str = "-seed";

/// The runs of one method, which differ in their seeds alone.
#[derive(Clone, Debug)]
pub struct MethodRuns {
    /// The method: the name of the runs' folders up to their seeds.
    pub name: String,
    /// The runs.
    pub runs: Vec<RunData>,
    /// The figures of each.
    pub figures: Vec<Figures>,
}

impl MethodRuns {
    /// Sorts runs into methods, in the order in which they appear.
    ///
    /// # Errors
    /// [`CoversError::MixedRuns`] for runs of one name whose settings differ in more than the seed
    /// and the number of threads, and for two of one seed.
    pub fn sort(runs: Vec<RunData>) -> Result<Vec<Self>, CoversError> {
        let mut methods: Vec<Self> = Vec::new();
        for run in runs {
            let name = run.name.split(SEED).next().unwrap_or(&run.name).to_owned();
            match methods.iter_mut().find(|method| method.name == name) {
                Some(method) => method.add(run)?,
                None => methods.push(Self {
                    name,
                    figures: vec![Figures::of(&run)],
                    runs: vec![run],
                }),
            }
        }
        Ok(methods)
    }

    fn add(&mut self, run: RunData) -> Result<(), CoversError> {
        let seed = |run: &RunData| run.experiment.learner.seed();
        let mut others = self.runs.iter();
        let differences = match others.find(|other| seed(other) == seed(&run)) {
            Some(_) => format!("two runs have seed {}", seed(&run)),
            None => differences(&unseeded(&self.runs[0]), &unseeded(&run))?,
        };
        if !differences.is_empty() {
            return Err(CoversError::MixedRuns {
                method: self.name.clone(),
                run: run.name,
                differences,
            });
        }
        self.figures.push(Figures::of(&run));
        self.runs.push(run);
        Ok(())
    }

    /// A figure `[groups][seeds]` of these groups.
    pub fn scores(&self, groups: &[String], figure: fn(&GroupFigures) -> f64) -> Scores {
        let of = |group: &String| -> Vec<f64> {
            let figures = self.figures.iter().flat_map(|figures| &figures.groups);
            figures
                .filter(|own| own.group == *group)
                .map(figure)
                .collect()
        };
        Scores(groups.iter().map(of).collect())
    }
}

/// The settings without what runs of one method may differ in.
fn unseeded(run: &RunData) -> Experiment {
    run.experiment.clone().with_seed(0).with_threads(1)
}
