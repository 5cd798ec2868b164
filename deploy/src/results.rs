//! Folder for the results of a deployment.

use std::path::{Path, PathBuf};

use envs::TaskGroup;

use crate::DeployError;
use experiments::new_file::NewOutputFile;
use learner::disk::{LocalDisk, write_atomically};

use super::faults::SimulatedFault;
use super::sweep::{FaultSweepResults, fault_sweep_csv, fault_sweep_svg};
use super::table::{TrialResult, deployment_markdown, trials_csv};

/// Folder with `table.md` and `trials.csv`, and for each sweep a table (CSV) and a figure (SVG)
/// named after the fault.
pub struct ResultsFolder {
    folder: PathBuf,
}

impl ResultsFolder {
    /// Creates the folder if there is none, and rejects one with a file that would be written
    /// later. `faults` are those that will be swept.
    ///
    /// # Errors
    /// As [`NewOutputFile::new`] and [`NewOutputFile::prepare_folder`].
    pub fn create(
        folder: &Path,
        faults: impl Iterator<Item = SimulatedFault>,
    ) -> Result<Self, DeployError> {
        // check all files before any trial runs, which takes minutes
        let results = Self { folder: folder.to_owned() };
        let swept = faults.flat_map(|fault| ["csv", "svg"].map(|ending| results.of(fault, ending)));
        let table = ["table.md", "trials.csv"].map(|name| folder.join(name));
        for path in table.into_iter().chain(swept) {
            NewOutputFile::new(&path)?.prepare_folder()?;
        }
        Ok(results)
    }

    /// Writes `trials.csv`, with a row for each trial, and `table.md`, the table of success.
    ///
    /// # Errors
    /// Files that cannot be written.
    pub fn write_trials(&self, scores: &[TrialResult]) -> Result<(), DeployError> {
        let write = |name: &str, text: String| {
            write_atomically(&LocalDisk, &self.folder.join(name), text.as_bytes())
        };
        write("trials.csv", trials_csv(scores))?;
        Ok(write("table.md", deployment_markdown(scores))?)
    }

    /// Writes the table (CSV) and the figure (SVG) of a sweep so far, in place of earlier ones.
    ///
    /// # Errors
    /// Files that cannot be written.
    pub fn write_sweep(
        &self,
        fault: SimulatedFault,
        groups: &[TaskGroup],
        swept: &FaultSweepResults,
    ) -> Result<(), DeployError> {
        let write = |ending, text: String| {
            write_atomically(&LocalDisk, &self.of(fault, ending), text.as_bytes())
        };
        write("csv", fault_sweep_csv(fault, swept))?;
        Ok(write("svg", fault_sweep_svg(fault, groups, swept))?)
    }

    fn of(&self, fault: SimulatedFault, ending: &str) -> PathBuf {
        self.folder.join(format!("{}.{ending}", fault.name()))
    }
}

#[cfg(test)]
mod tests {
    use super::*;
    use crate::table::tests::score;

    #[test]
    fn what_another_run_wrote_is_kept() {
        let folder = std::env::temp_dir().join(format!("covers-results-{}", std::process::id()));
        let create = |fault: SimulatedFault| ResultsFolder::create(&folder, std::iter::once(fault));
        let results = create(SimulatedFault::MaskMargin).unwrap();
        let groups = [TaskGroup::BUTTON_PRESS];
        let scores = [(0, true), (1, false)].map(|(n, success)| score(groups[0], n, success));
        let swept = vec![(0.0, scores[..1].to_vec()), (10.0, scores[1..].to_vec())];
        for _ in 0..2 {
            results.write_sweep(SimulatedFault::MaskMargin, &groups, &swept).unwrap();
        }
        let refused = create(SimulatedFault::MaskMargin).err().unwrap();
        assert!(refused.to_string().contains("mask-growth.csv"), "{refused}");
        create(SimulatedFault::AngleError).unwrap();
        let read = |name: &str| std::fs::read_to_string(folder.join(name)).unwrap();
        assert_eq!(read("mask-growth.csv"), fault_sweep_csv(SimulatedFault::MaskMargin, &swept));
        results.write_trials(&scores).unwrap();
        let lines = "button-press,flip x,0,1,1,1,0,2\nbutton-press,flip x,1,1,1,0,0,2\n";
        assert!(read("trials.csv").ends_with(lines));
        assert!(read("table.md").contains("| button-press | 2 | 0.50 |"));
        let again = create(SimulatedFault::AngleError).err().unwrap();
        assert!(again.to_string().contains("table.md"), "{again}");
        let below_a_file = folder.join("table.md/results");
        let unwritable = ResultsFolder::create(&below_a_file, std::iter::empty()).err().unwrap();
        assert!(unwritable.to_string().contains("cannot write"), "{unwritable}");
        std::fs::remove_dir_all(&folder).unwrap();
    }
}
