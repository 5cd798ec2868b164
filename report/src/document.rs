//! All that a report holds, and its files.

use std::io::ErrorKind;
use std::path::Path;

use experiments::{RunData, RunError};

use super::error::ReportError;

use super::method::MethodRuns;
use super::page::page;
use super::table::Table;
use super::{bands, curves, tables};

/// Tables and curves of some runs.
#[derive(Clone, Debug)]
pub struct Report {
    methods: Vec<MethodRuns>,
    /// The tables, each with the name of its files.
    tables: Vec<(&'static str, Table)>,
}

impl Report {
    /// Makes the tables. The method that comes first is compared with the others.
    ///
    /// # Errors
    /// [`ReportError::MixedRuns`].
    pub fn new(runs: Vec<RunData>) -> Result<Self, ReportError> {
        let methods = MethodRuns::sort(runs)?;
        Ok(Self { tables: tables::all(&methods), methods })
    }

    /// The tables in Markdown.
    pub fn markdown(&self) -> String {
        let tables = self.tables.iter();
        tables.map(|(_, table)| table.markdown() + "\n").collect()
    }

    /// The report as one HTML page, which needs no network and nothing beside it.
    pub fn html(&self) -> String {
        page(&self.methods, &tables::common_groups(&self.methods), &self.tables)
    }

    /// Writes `report.html`, `report.md`, each table as CSV and LaTeX, and the curves of each run,
    /// each seed and each group as SVG, to a folder, which is created.
    ///
    /// # Errors
    /// [`RunError::Write`].
    pub fn write(&self, folder: &Path) -> Result<(), RunError> {
        std::fs::create_dir_all(folder).map_err(|error| RunError::write(folder, error))?;
        let write = |name: &str, text: String| {
            let path = folder.join(name);
            std::fs::write(&path, text).map_err(|error| RunError::write(&path, error))
        };
        write("report.html", self.html())?;
        write("report.md", self.markdown())?;
        // what an earlier report left, and this one has not
        for name in tables::SOMETIMES {
            for ending in ["csv", "tex"] {
                remove(&folder.join(format!("{name}.{ending}")))?;
            }
        }
        for (name, table) in &self.tables {
            write(&format!("{name}.csv"), table.csv())?;
            write(&format!("{name}.tex"), table.latex())?;
        }
        for (name, svg) in self.drawings() {
            write(&format!("{name}.svg"), svg)?;
        }
        Ok(())
    }

    /// The curves of each run, each seed and each group as SVG, with their names.
    fn drawings(&self) -> Vec<(String, String)> {
        let runs = self.methods.iter().flat_map(|method| {
            method.runs.iter().map(|run| {
                let seed = run.experiment.learner.seed();
                (format!("{}-seed{seed}", method.name), curves::run(run))
            })
        });
        let seeds = curves::seeds(&self.methods).into_iter();
        let seeds = seeds.map(|(seed, drawing)| (format!("seed{seed}"), drawing));
        let groups = tables::common_groups(&self.methods).into_iter();
        let groups = groups.filter_map(|group| {
            let drawing = bands::of_group(&self.methods, &group)?;
            Some((format!("learning-{group}"), drawing))
        });
        runs.chain(seeds).chain(groups).collect()
    }
}

/// Removes a file, where there is one.
fn remove(path: &Path) -> Result<(), RunError> {
    match std::fs::remove_file(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(()),
        removed => removed.map_err(|error| RunError::write(path, error)),
    }
}
