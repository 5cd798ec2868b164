//! CSV file of a run with a copy in memory, from which a lost or changed file is restored.

use std::fs;
use std::io::Error;
use std::path::{Path, PathBuf};
use std::sync::Arc;

use serde::Serialize;

use crate::error::RunError;
use learner::disk::{Disk, write_atomically};

/// CSV table of a run as a file, with a copy of the file's contents in memory.
#[derive(Debug)]
pub(crate) struct CsvFile {
    path: PathBuf,
    disk: Arc<dyn Disk>,
    text: Vec<u8>,
    /// Names of the table's columns; empty before the first row.
    names: Vec<String>,
}

impl CsvFile {
    /// Opens a CSV file and makes it hold exactly `text`: later rows are removed, and a lost tail
    /// is restored. A file with other contents is first renamed.
    pub fn open(path: PathBuf, disk: Arc<dyn Disk>, text: Vec<u8>) -> Result<Self, RunError> {
        let names = header(&text).map_err(RunError::read_error_mapper(&path))?;
        let table = Self { path, disk, text, names };
        table.restore()?;
        Ok(table)
    }

    /// Makes the file hold exactly the contents of the copy in memory.
    fn restore(&self) -> Result<(), RunError> {
        let file = fs::read(&self.path).ok();
        let found = file.as_deref().unwrap_or_default();
        // a beginning or a continuation of the contents is the run's own work; anything else is
        // somebody's edit, which must not be lost
        if !found.starts_with(&self.text) && !self.text.starts_with(found) {
            rename_old(&*self.disk, &self.path)?;
        }
        if file.as_ref() != Some(&self.text) {
            self.rewrite()?;
        }
        Ok(())
    }

    /// Returns the contents that the table's file has unless another program changed it.
    pub fn text(&self) -> &[u8] {
        &self.text
    }

    /// Returns the name of the table's file.
    pub fn name(&self) -> String {
        let name = self.path.file_name().unwrap_or_default();
        name.to_string_lossy().into_owned()
    }

    /// Appends one row to the table: pairs of a column's name and the cell's text.
    ///
    /// # Errors
    /// [`RunError::Write`], also for duplicate names and for names that earlier rows do not have.
    pub fn append_row(&mut self, row: Vec<(String, String)>) -> Result<(), RunError> {
        let (names, cells) = row.into_iter().unzip::<_, _, Vec<String>, Vec<String>>();
        if let Some(twice) = (1..names.len()).find(|&i| names[..i].contains(&names[i])) {
            return Err(self.refuse(format!("two columns are called `{}`", names[twice])));
        }
        let mut writer = csv::Writer::from_writer(Vec::new());
        if self.names.is_empty() {
            writer.write_record(&names).map_err(RunError::write_error_mapper(&self.path))?;
            self.names = names;
        } else if self.names != names {
            let (names, known) = (names.join(", "), self.names.join(", "));
            return Err(self.refuse(format!("a row of {names} does not fit the columns {known}")));
        }
        writer.write_record(&cells).map_err(RunError::write_error_mapper(&self.path))?;
        self.add(writer)
    }

    /// Appends rows to the table, with a header if the table is empty.
    pub fn append_rows<R: Serialize>(
        &mut self,
        rows: impl IntoIterator<Item = R>,
    ) -> Result<(), RunError> {
        let mut writer =
            csv::WriterBuilder::new().has_headers(self.text.is_empty()).from_writer(Vec::new());
        rows.into_iter()
            .try_for_each(|row| writer.serialize(row))
            .map_err(RunError::write_error_mapper(&self.path))?;
        self.add(writer)
    }

    /// Restores the table's file if another program changed it, and syncs it to the disk.
    pub fn sync(&self) -> Result<(), RunError> {
        self.restore()?;
        self.disk.sync(&self.path).map_err(RunError::write_error_mapper(&self.path))
    }

    fn add(&mut self, writer: csv::Writer<Vec<u8>>) -> Result<(), RunError> {
        let rows = writer.into_inner();
        let rows = rows.map_err(|error| RunError::cannot_write(&self.path, error.into_error()))?;
        let before = self.text.len();
        self.text.extend(&rows);
        if self.has_length(before) {
            return self
                .disk
                .append(&self.path, &rows)
                .map_err(RunError::write_error_mapper(&self.path));
        }
        self.restore()
    }

    /// Returns `true` if the file has this length in bytes: a cheap test for files that were
    /// removed or cut. [`CsvFile::sync`] finds other changes by reading the whole file.
    fn has_length(&self, length: usize) -> bool {
        fs::metadata(&self.path).is_ok_and(|file| file.len() == length as u64)
    }

    fn rewrite(&self) -> Result<(), RunError> {
        Ok(write_atomically(&*self.disk, &self.path, &self.text)?)
    }

    fn refuse(&self, problem: String) -> RunError {
        RunError::cannot_write(&self.path, Error::other(problem))
    }
}

/// Renames a file to a free name with the extension `.old`, `.old2` and so on.
fn rename_old(disk: &dyn Disk, path: &Path) -> Result<(), RunError> {
    let aside = free_name(path);
    disk.rename(path, &aside).map_err(RunError::write_error_mapper(&aside))
}

/// Returns the path with the first added extension of `old`, `old2` and so on that is free.
fn free_name(path: &Path) -> PathBuf {
    let mut aside = path.with_added_extension("old");
    let mut number = 2;
    while aside.exists() {
        aside = path.with_added_extension(format!("old{number}"));
        number += 1;
    }
    aside
}

/// Returns the names of a table's columns.
fn header(text: &[u8]) -> Result<Vec<String>, csv::Error> {
    let mut reader = csv::Reader::from_reader(text);
    let names = reader.headers()?;
    Ok(names.iter().map(str::to_owned).collect())
}

#[cfg(test)]
mod tests {
    use super::*;
    use learner::disk::LocalDisk;

    fn cells(row: &[(&str, &str)]) -> Vec<(String, String)> {
        let row = row.iter();
        row.map(|(name, cell)| (name.to_string(), cell.to_string())).collect()
    }

    fn table(name: &str) -> CsvFile {
        let path = std::env::temp_dir().join(format!("covers-{name}-{}.csv", std::process::id()));
        let _ = fs::remove_file(&path);
        let mut table = reopen(path, b"");
        table.append_row(cells(&[("rollout", "0"), ("loss", "1.5")])).unwrap();
        table
    }

    fn reopen(path: PathBuf, text: &[u8]) -> CsvFile {
        CsvFile::open(path, Arc::new(LocalDisk), text.to_vec()).unwrap()
    }

    const ONE: &[u8] = b"rollout,loss\n0,1.5\n";

    #[test]
    fn rows_of_other_columns_are_refused_also_after_a_resumption() {
        let mut table = table("columns");
        let mut resumed = reopen(table.path.clone(), ONE);
        let other = [("rollout", "1"), ("entropy", "2")];
        for each in [&mut table, &mut resumed] {
            let message = each.append_row(cells(&other)).unwrap_err().to_string();
            assert!(message.contains("entropy") && message.contains("loss"));
        }
        let same = cells(&[("rollout", "1"), ("loss", "2")]);
        resumed.append_row(same).unwrap();
        let twice = cells(&[("rollout", "1"), ("rollout", "2")]);
        let message = resumed.append_row(twice).unwrap_err().to_string();
        assert!(message.contains("two columns are called `rollout`"), "{message}");
        let text = fs::read_to_string(&table.path).unwrap();
        assert_eq!(text, "rollout,loss\n0,1.5\n1,2\n");
        fs::remove_file(&table.path).unwrap();
    }

    #[test]
    fn a_file_that_lost_its_tail_or_has_more_is_made_right() {
        let path = table("tail").path;
        for there in [&ONE[..5], b"", b"rollout,loss\n0,1.5\n1,7\n2,", ONE] {
            fs::write(&path, there).unwrap();
            assert_eq!(reopen(path.clone(), ONE).text(), ONE);
            assert_eq!(fs::read(&path).unwrap(), ONE);
        }
        fs::remove_file(&path).unwrap();
        reopen(path.clone(), ONE);
        assert_eq!(fs::read(&path).unwrap(), ONE);
        fs::remove_file(path).unwrap();
    }

    #[test]
    fn a_file_of_other_contents_is_put_aside() {
        let path = table("aside").path;
        for (notes, ending) in [("notes of my own", "old"), ("and others", "old2")] {
            fs::write(&path, notes).unwrap();
            reopen(path.clone(), ONE);
            assert_eq!(fs::read(&path).unwrap(), ONE);
            let aside = fs::read_to_string(path.with_added_extension(ending));
            assert_eq!(aside.unwrap(), notes);
        }
        for ending in ["old", "old2"] {
            fs::remove_file(path.with_added_extension(ending)).unwrap();
        }
        fs::remove_file(path).unwrap();
    }

    #[test]
    fn an_edit_that_keeps_the_length_is_found_and_put_aside() {
        let table = table("edited");
        let edited = b"rollout,loss\n0,9.9\n";
        assert_eq!(edited.len(), ONE.len());
        fs::write(&table.path, edited).unwrap();
        table.sync().unwrap();
        assert_eq!(fs::read(&table.path).unwrap(), ONE);
        let aside = table.path.with_added_extension("old");
        assert_eq!(fs::read(&aside).unwrap(), edited);
        fs::remove_file(aside).unwrap();
        fs::remove_file(&table.path).unwrap();
    }
}
