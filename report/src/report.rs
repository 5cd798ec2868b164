//! Tables and drawings of a report, and the files that it is written to.

use std::ffi::OsStr;
use std::io::ErrorKind;
use std::path::Path;

use experiments::{RunData, RunError};

use super::error::ReportError;
use super::format::smoke_test_notice;
use super::method::MethodRuns;
use super::page::report_html;
use super::table::ReportTable;
use super::{charts, curves, learning_curves, tables};

/// Report on some runs: tables that compare their methods, and curves.
#[derive(Clone, Debug)]
pub struct Report {
    methods: Vec<MethodRuns>,
    /// Tables, each with the name of its files.
    tables: Vec<(&'static str, ReportTable)>,
}

impl Report {
    /// Computes the report's tables from the data of these runs. The method of the first run is
    /// compared with the others.
    ///
    /// # Errors
    /// [`ReportError::IncomparableRuns`] for runs that cannot stand in one table.
    pub fn new(runs: Vec<RunData>) -> Result<Self, ReportError> {
        let methods = MethodRuns::group_by_method(runs)?;
        Ok(Self { tables: tables::report_tables(&methods), methods })
    }

    /// Returns the report's tables in Markdown.
    pub fn markdown(&self) -> String {
        let notice = smoke_test_notice(&self.methods);
        let notice = notice.map(|notice| format!("**{notice}**\n\n"));
        let tables = self.tables.iter().map(|(_, table)| table.markdown() + "\n");
        notice.into_iter().chain(tables).collect()
    }

    /// Returns the report as one self-contained HTML page, which needs neither network nor other
    /// files.
    pub fn html(&self) -> String {
        report_html(&self.methods, &tables::common_groups(&self.methods), &self.tables)
    }

    /// Writes `report.html`, `report.md`, each table as CSV and LaTeX, and the curves of each run,
    /// each seed and each group and the chart of success as SVG, to a folder, which is created.
    /// Files of these names that an earlier report left there are removed.
    ///
    /// # Errors
    /// [`RunError::Write`] for a file that cannot be written or removed.
    pub fn write(&self, folder: &Path) -> Result<(), RunError> {
        std::fs::create_dir_all(folder).map_err(RunError::write_error_mapper(folder))?;
        let write = |name: &str, text: String| {
            let path = folder.join(name);
            std::fs::write(&path, text).map_err(RunError::write_error_mapper(&path))
        };
        write("report.html", self.html())?;
        write("report.md", self.markdown())?;
        // an earlier report may have left tables and drawings that this one does not have
        for name in tables::OPTIONAL_REPORT_TABLES {
            for ending in ["csv", "tex"] {
                remove(&folder.join(format!("{name}.{ending}")))?;
            }
        }
        for (name, table) in &self.tables {
            write(&format!("{name}.csv"), table.csv())?;
            write(&format!("{name}.tex"), table.latex())?;
        }
        for entry in std::fs::read_dir(folder).map_err(RunError::write_error_mapper(folder))? {
            let path = entry.map_err(RunError::write_error_mapper(folder))?.path();
            if is_drawing_of_report(&path) {
                remove(&path)?;
            }
        }
        for (name, svg) in self.drawings() {
            write(&format!("{name}.svg"), svg)?;
        }
        Ok(())
    }

    /// Returns the curves of each run, each seed and each group, and the chart of success, as SVG
    /// with their names.
    fn drawings(&self) -> Vec<(String, String)> {
        let runs = self.methods.iter().flat_map(|method| {
            method.runs.iter().map(|run| {
                let seed = run.experiment.learner.seed();
                (format!("{}-seed{seed}", method.name), curves::run_curves_svg(run))
            })
        });
        let seeds = curves::success_svg_per_seed(&self.methods)
            .into_iter()
            .map(|(seed, drawing)| (format!("seed{seed}"), drawing));
        let groups = tables::common_groups(&self.methods);
        let success = ("success".to_owned(), charts::success_svg(&self.methods, &groups));
        let groups = groups.into_iter().filter_map(|group| {
            let drawing = learning_curves::group_learning_curves_svg(&self.methods, &group)?;
            Some((format!("learning-{group}"), drawing))
        });
        runs.chain(seeds).chain(groups).chain([success]).collect()
    }
}

/// Returns `true` if a report writes drawings of this name: of a run, of a seed or of a group.
fn is_drawing_of_report(path: &Path) -> bool {
    let name = path.file_name().and_then(OsStr::to_str);
    let Some(name) = name.and_then(|name| name.strip_suffix(".svg")) else {
        return false;
    };
    let is_number = |text: &str| !text.is_empty() && text.bytes().all(|byte| byte.is_ascii_digit());
    let ends_in_seed = name.rsplit_once("seed").is_some_and(|(method, seed)| {
        (method.is_empty() || method.ends_with('-')) && is_number(seed)
    });
    ends_in_seed || name.starts_with("learning-")
}

/// Removes a file if it exists.
fn remove(path: &Path) -> Result<(), RunError> {
    match std::fs::remove_file(path) {
        Err(error) if error.kind() == ErrorKind::NotFound => Ok(()),
        removed => removed.map_err(RunError::write_error_mapper(path)),
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::fixtures::{run, scored_run};
    use experiments::presets::Method;

    /// Returns a run that was stopped before its first evaluation, with success in training.
    fn unevaluated(method: Method) -> RunData {
        let mut stopped = run(method, &[("a", 0), ("a", 0), ("b", 1)]);
        stopped.is_finished = false;
        for (row, success) in stopped.rollouts.iter_mut().zip([0.0, 0.25, 0.5]) {
            row.success = Some(success);
            row.permutation_z_scores = vec![Some(1.0)];
        }
        stopped
    }

    /// Returns the tables and the page of a report, which must not show numbers of missing
    /// evaluations.
    fn texts(runs: Vec<RunData>) -> [String; 2] {
        let report = Report::new(runs).unwrap();
        for (name, table) in &report.tables {
            assert!(table.rows.iter().all(|row| row.len() == table.header.len()), "{name}");
        }
        for (name, svg) in report.drawings() {
            assert!(!svg.contains("NaN"), "{name}: {svg}");
        }
        let page = report.html();
        let texts = [report.markdown(), page.split("<script>").next().unwrap().to_owned()];
        for text in &texts {
            assert!(!text.contains("NaN"), "{text}");
        }
        texts
    }

    #[test]
    fn a_run_before_its_first_evaluation_is_reported_by_its_training() {
        let [tables, page] = texts(vec![unevaluated(Method::CoversSac)]);
        let average =
            "| covers-sac (1) | not evaluated yet | not evaluated yet | not evaluated yet |";
        assert!(tables.contains(average), "{tables}");
        assert!(tables.contains("decisions, and was not evaluated yet"), "{tables}");
        assert!(page.contains("<dd>not evaluated yet</dd>") && page.contains("<dd>0.250</dd>"));
        for part in ["Success in training", "distance (sd)", "policy 1", ">b</text>"] {
            assert!(page.contains(part), "{part}: {page}");
        }
    }

    #[test]
    fn an_unevaluated_run_leaves_the_scores_of_others_alone() {
        let scored = || scored_run(&["a", "a"], &[(0, 0.0), (1, 0.5), (2, 0.75)]);
        for runs in [
            vec![unevaluated(Method::CoversSac), scored()],
            vec![scored(), unevaluated(Method::CoversSac)],
        ] {
            let [tables, _] = texts(runs);
            assert!(tables.contains("0.750 / "), "{tables}");
            assert!(tables.contains("| covers-sac-seed0 (1) | not evaluated yet |"), "{tables}");
        }
    }

    #[test]
    fn the_first_screen_of_a_single_run_is_titled_in_words_and_explains_what_is_missing() {
        let mut single = unevaluated(Method::CoversSac);
        single.scores = scored_run(&["a"], &[(3, 0.5)]).scores;
        single.experiment.schedule.groups.truncate(1);
        let group = &single.experiment.schedule.groups[0].group;
        let title = format!("<h1>COVERS with soft actor-critic: {group}</h1>");
        let mut short = single.clone();
        short.rollouts.iter_mut().for_each(|row| row.success = None);
        let [_, page] = texts(vec![single]);
        assert!(page.contains(&title), "{page}");
        let first_screen = page.split("<nav").next().unwrap();
        for part in [
            "<title>Success in training</title>",
            "needs two of them",
            "two or more evaluated seeds",
        ] {
            assert!(first_screen.contains(part), "{part}: {first_screen}");
        }
        let [_, bare] = texts(vec![short]);
        assert!(bare.contains("<p>No curve: "), "{bare}");
    }
}
