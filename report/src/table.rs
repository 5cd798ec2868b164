//! A table, and how it is written.

use std::fmt::Write;

use super::svg::escaped;

/// Columns of Markdown's prose.
const COLUMNS: usize = 100;

/// A table with a caption.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct Table {
    /// What it shows, a sentence.
    pub caption: String,
    /// Names of the columns.
    pub header: Vec<String>,
    /// Rows of as many cells.
    pub rows: Vec<Vec<String>>,
    /// Sentences below it.
    pub notes: Vec<String>,
}

impl Table {
    /// A table without rows.
    pub fn new(caption: &str, header: &[&str]) -> Self {
        Self {
            caption: caption.to_owned(),
            header: header.iter().map(|&name| name.to_owned()).collect(),
            rows: Vec::new(),
            notes: Vec::new(),
        }
    }

    /// The sign of a remark, which stands below the table once.
    pub fn note(&mut self, remark: &str) -> String {
        let known = self.notes.iter().position(|note| note == remark);
        let number = known.unwrap_or_else(|| {
            self.notes.push(remark.to_owned());
            self.notes.len() - 1
        });
        format!("({})", number + 1)
    }

    /// The table in Markdown, caption first.
    pub fn markdown(&self) -> String {
        let line = |cells: &[String]| format!("| {} |\n", cells.join(" | "));
        let mut text = format!("{}\n\n{}", wrapped(&self.caption), line(&self.header));
        text.push_str(&line(&vec!["---".to_owned(); self.header.len()]));
        for row in &self.rows {
            text.push_str(&line(row));
        }
        if !self.notes.is_empty() {
            text.push('\n');
        }
        for (number, note) in (1..).zip(&self.notes) {
            // writing to a String cannot fail
            let _ = writeln!(text, "{}  ", wrapped(&format!("({number}) {note}.")));
        }
        text
    }

    /// The table in columns for a terminal, without its caption; numbers stand to the right.
    pub fn text(&self) -> String {
        let columns = 0..self.header.len();
        let width = |column: usize| {
            let cells = self.rows.iter().map(|row| &row[column]);
            let widths = cells.chain([&self.header[column]]);
            widths.map(|cell| cell.chars().count()).max().unwrap_or(0)
        };
        let widths: Vec<usize> = columns.map(width).collect();
        let line = |cells: &[String]| {
            let cells = cells.iter().zip(&widths);
            let cells = cells.map(|(cell, &width)| match cell.parse::<f64>() {
                Ok(_) => format!("{cell:>width$}"),
                Err(_) => format!("{cell:<width$}"),
            });
            cells.collect::<Vec<_>>().join("  ").trim_end().to_owned()
        };
        let rule: Vec<String> = widths.iter().map(|&width| "-".repeat(width)).collect();
        let rows = self.rows.iter().map(|row| line(row));
        let head = [line(&self.header), rule.join("  ")];
        let notes = (1..).zip(&self.notes);
        let notes = notes.map(|(number, note)| format!("({number}) {note}."));
        let lines: Vec<String> = head.into_iter().chain(rows).chain(notes).collect();
        lines.join("\n")
    }

    /// The table in HTML, in a box that scrolls where the screen is narrow.
    pub fn html(&self) -> String {
        let line = |tag: &str, cells: &[String]| {
            let cells = cells.iter().map(|cell| escaped(cell));
            let cells = cells.map(|cell| format!("<{tag}>{cell}</{tag}>"));
            format!("<tr>{}</tr>\n", cells.collect::<String>())
        };
        let rows = self.rows.iter().map(|row| line("td", row));
        let notes = (1..).zip(&self.notes);
        let notes =
            notes.map(|(n, note)| format!("<p class=\"note\">({n}) {}.</p>\n", escaped(note)));
        format!(
            "<p class=\"caption\">{}</p>\n<div class=\"wide\"><table>\n{}{}</table></div>\n{}",
            escaped(&self.caption),
            line("th", &self.header),
            rows.collect::<String>(),
            notes.collect::<String>()
        )
    }

    /// The rows as CSV (RFC 4180), the header first.
    pub fn csv(&self) -> String {
        let quoted = |cell: &String| format!("\"{}\"", cell.replace('"', "\"\""));
        let line = |cells: &Vec<String>| cells.iter().map(quoted).collect::<Vec<_>>().join(",");
        let rows = std::iter::once(&self.header).chain(&self.rows);
        rows.map(|row| line(row) + "\r\n").collect()
    }

    /// The table as a LaTeX `tabular` with the rules of `booktabs`.
    pub fn latex(&self) -> String {
        let line = |cells: &Vec<String>| {
            let cells: Vec<String> = cells.iter().map(|cell| latex(cell)).collect();
            format!("{} \\\\\n", cells.join(" & "))
        };
        let columns = "l".repeat(self.header.len());
        let rows: String = self.rows.iter().map(line).collect();
        let header = line(&self.header);
        let notes = self.notes.iter().zip(1..);
        let notes: String = notes.map(|(note, n)| format!("% ({n}) {note}.\n")).collect();
        format!(
            "% {}\n{notes}\\begin{{tabular}}{{{columns}}}\n\\toprule\n{header}\\midrule\n{rows}\\bottomrule\n\\end{{tabular}}\n",
            self.caption
        )
    }
}

/// Words in lines of at most [`COLUMNS`], where no word is longer.
fn wrapped(text: &str) -> String {
    let mut lines: Vec<String> = Vec::new();
    for word in text.split_whitespace() {
        match lines.last_mut() {
            Some(line) if line.chars().count() + 1 + word.chars().count() <= COLUMNS => {
                line.push(' ');
                line.push_str(word);
            }
            _ => lines.push(word.to_owned()),
        }
    }
    lines.join("\n")
}

/// Text with LaTeX's own signs escaped.
fn latex(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for sign in text.chars() {
        match sign {
            '&' | '%' | '$' | '#' | '_' | '{' | '}' => escaped.extend(['\\', sign]),
            '\\' => escaped.push_str("\\textbackslash{}"),
            '~' => escaped.push_str("\\textasciitilde{}"),
            '^' => escaped.push_str("\\textasciicircum{}"),
            _ => escaped.push(sign),
        }
    }
    escaped
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table() -> Table {
        let mut table = Table::new("Two figures.", &["method", "success"]);
        let sign = table.note("one policy");
        assert_eq!(table.note("one policy"), sign);
        table.rows.push(vec!["a_b, \"c\"".to_owned(), format!("5 % {sign}")]);
        table
    }

    #[test]
    fn markdown_has_notes_below() {
        let expected = "Two figures.\n\n| method | success |\n| --- | --- |\n\
            | a_b, \"c\" | 5 % (1) |\n\n(1) one policy.  \n";
        assert_eq!(table().markdown(), expected);
    }

    #[test]
    fn long_captions_are_wrapped() {
        let words = [&"x".repeat(60)[..], &"y".repeat(39), "z"];
        let expected = format!("{} {}\nz", words[0], words[1]);
        assert_eq!(wrapped(&words.join(" ")), expected);
        assert_eq!(wrapped(""), "");
    }

    #[test]
    fn text_has_columns_and_numbers_to_the_right() {
        let mut table = table();
        table.rows.push(vec!["b".to_owned(), "0.5".to_owned()]);
        let expected = "method    success\n--------  -------\na_b, \"c\"  5 % (1)\n\
            b             0.5\n(1) one policy.";
        assert_eq!(table.text(), expected);
    }

    #[test]
    fn csv_is_read_back_as_it_was() {
        let text = table().csv();
        let mut reader = csv::Reader::from_reader(text.as_bytes());
        assert_eq!(reader.headers().unwrap(), vec!["method", "success"]);
        let row = reader.records().next().unwrap().unwrap();
        assert_eq!(row, vec!["a_b, \"c\"", "5 % (1)"]);
    }

    #[test]
    fn html_has_rows_and_notes() {
        let text = table().html();
        assert!(text.contains("<tr><td>a_b, &quot;c&quot;</td><td>5 % (1)</td></tr>"), "{text}");
        assert!(text.contains("(1) one policy.</p>"), "{text}");
    }

    #[test]
    fn latex_signs_are_escaped() {
        let text = table().latex();
        assert!(text.contains("a\\_b, \"c\" & 5 \\% (1) \\\\\n"), "{text}");
        assert!(text.contains("\\begin{tabular}{ll}"));
    }
}
