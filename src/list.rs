//! `covers list`: the runs of a folder with their state, success and size.

use std::collections::HashSet;
use std::fs;
use std::io::Write;
use std::path::{Path, PathBuf};

use clap::Args;
use experiments::cli::print_escaped;
use experiments::evaluation::mean;
use experiments::presets::Method;
use experiments::text::format_number;
use experiments::{RunData, RunError, RunFolder};
use report::ReportTable;

/// Options of `covers list`.
#[derive(Clone, Debug, Args)]
#[command(after_help = "Examples:\n  covers list\n  covers list /data/runs")]
pub struct ListRunsOptions {
    /// Folder of runs, which may lie in folders of their own.
    #[arg(default_value = "runs")]
    pub folder: PathBuf,
}

impl ListRunsOptions {
    /// Prints a table of the runs in the folder and all folders inside it: method, state, number of
    /// policies, success and size.
    ///
    /// # Errors
    /// [`RunError::NoRun`] for a folder that does not exist; a folder that cannot be read, or an
    /// `out` that cannot be written to.
    pub fn run(&self, out: &mut impl Write) -> Result<(), RunError> {
        let exists = self.folder.try_exists().map_err(RunError::read_error_mapper(&self.folder))?;
        if !exists {
            return Err(RunFolder::from_path(&self.folder).no_run());
        }
        let header = ["run", "method", "state", "policies", "success", "MB"];
        let (mut table, mut reasons) = (ReportTable::new("", &header), Vec::new());
        let (mut folders, mut visited) = (vec![self.folder.clone()], HashSet::new());
        while let Some(folder) = folders.pop() {
            // a link may lead back to a folder above
            let real = folder.canonicalize().map_err(RunError::read_error_mapper(&folder))?;
            if !visited.insert(real) {
                continue;
            }
            if RunFolder::from_path(&folder).holds_run() {
                table.rows.push(row(&folder, &mut reasons));
                continue;
            }
            for entry in fs::read_dir(&folder).map_err(RunError::read_error_mapper(&folder))? {
                let path = entry.map_err(RunError::read_error_mapper(&folder))?.path();
                folders.extend(path.is_dir().then_some(path));
            }
        }
        table.rows.sort();
        reasons.sort();
        let reasons: String = reasons.iter().map(|reason| format!("\n{reason}")).collect();
        print_escaped(out, &(table.text() + &reasons))
    }
}

/// Returns the table cells of a run, for an unfinished one from its files so far. Adds the reason
/// to `reasons` where the files cannot be read.
fn row(folder: &Path, reasons: &mut Vec<String>) -> Vec<String> {
    let (name, megabytes) = (folder.display().to_string(), bytes(folder) as f64 / 1e6);
    let run_folder = RunFolder::from_path(folder);
    // tables of a finished run must be whole
    let read = if run_folder.is_finished() { RunData::read } else { RunData::read_partial };
    let run = match read(folder) {
        Ok(run) => run,
        Err(error) => {
            reasons.push(format!("{name}: {error}"));
            let unreadable = ["?", "unreadable", "-", "-"].map(str::to_owned);
            return [vec![name], unreadable.to_vec(), vec![format!("{megabytes:.1}")]].concat();
        }
    };
    let decisions = run.rollouts.last().map_or(0, |row| row.decisions) as f64;
    let share = 100.0 * decisions / run.experiment.schedule.total_decisions() as f64;
    let successes: Vec<f64> = run.last_scores().map(|row| row.success).collect();
    let percent = format!("{:.0} %", share.min(100.0));
    let is_packed = run_folder.is_packed();
    let unfinished = || match run_folder.is_in_use() {
        _ if is_packed => "packed".to_owned(),
        Some(true) => format!("running, {percent}"),
        Some(false) => format!("stopped at {percent}"),
        None => format!("at {percent}"),
    };
    let state = if run.is_finished { "finished".to_owned() } else { unfinished() };
    vec![
        name,
        Method::from_experiment(&run.experiment).map_or("own settings", Method::name).to_owned(),
        state,
        if is_packed { "-".to_owned() } else { run.policy_count().to_string() },
        // the mean of no scores is no number
        format_number(Some(mean(&successes)), 3),
        format!("{megabytes:.1}"),
    ]
}

/// Returns the size of all files in a folder (bytes); what cannot be read counts as nothing.
fn bytes(folder: &Path) -> u64 {
    let entries = fs::read_dir(folder).into_iter().flatten().flatten();
    let size = |entry: fs::DirEntry| match entry.metadata() {
        Ok(file) if file.is_dir() => bytes(&entry.path()),
        Ok(file) => file.len(),
        Err(_) => 0,
    };
    entries.map(size).sum()
}
