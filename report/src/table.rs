//! Table of text cells, written as Markdown, plain text, HTML, CSV or LaTeX.

use std::fmt::Write;

use super::svg::escape_xml;

/// Width to which captions and notes are wrapped in Markdown (characters).
const COLUMNS: usize = 100;

/// Table of a report, with a caption and footnotes.
#[derive(Clone, Debug, PartialEq, Eq)]
pub struct ReportTable {
    /// Text above the table that says what it shows.
    pub caption: String,
    /// Names of the columns.
    pub header: Vec<String>,
    /// Cells of the table `[rows][columns]`.
    pub rows: Vec<Vec<String>>,
    /// Footnotes, without their full stops.
    pub footnotes: Vec<String>,
}

impl ReportTable {
    /// Creates a table without rows.
    pub fn new(caption: &str, header: &[&str]) -> Self {
        Self {
            caption: caption.to_owned(),
            header: header.iter().map(|&name| name.to_owned()).collect(),
            rows: Vec::new(),
            footnotes: Vec::new(),
        }
    }

    /// Adds a footnote to the table unless it has it, and returns its mark, such as `(1)`.
    pub fn add_footnote(&mut self, remark: &str) -> String {
        let known = self.footnotes.iter().position(|note| note == remark);
        let index = known.unwrap_or_else(|| {
            self.footnotes.push(remark.to_owned());
            self.footnotes.len() - 1
        });
        format!("({})", index + 1)
    }

    /// Returns the table in Markdown, the caption first.
    pub fn markdown(&self) -> String {
        let line = |cells: &[String]| format!("| {} |\n", cells.join(" | "));
        let mut text = format!("{}\n\n{}", wrapped(&self.caption), line(&self.header));
        text.push_str(&line(&vec!["---".to_owned(); self.header.len()]));
        for row in &self.rows {
            text.push_str(&line(row));
        }
        if !self.footnotes.is_empty() {
            text.push('\n');
        }
        for (number, note) in (1..).zip(&self.footnotes) {
            // two spaces end a line in Markdown; writing to a String cannot fail
            let _ = writeln!(text, "{}  ", wrapped(&format!("({number}) {note}.")));
        }
        text
    }

    /// Returns the table in columns for a terminal, without its caption. Numbers are aligned to the
    /// right.
    pub fn text(&self) -> String {
        let column_width = |column: usize| {
            let cells = self.rows.iter().map(|row| &row[column]).chain([&self.header[column]]);
            cells.map(|cell| cell.chars().count()).max().unwrap_or(0)
        };
        let widths: Vec<usize> = (0..self.header.len()).map(column_width).collect();
        let line = |cells: &[String]| {
            let padded = cells.iter().zip(&widths).map(|(cell, &width)| {
                let is_number = cell.parse::<f64>().is_ok();
                if is_number { format!("{cell:>width$}") } else { format!("{cell:<width$}") }
            });
            padded.collect::<Vec<_>>().join("  ").trim_end().to_owned()
        };
        let rule: Vec<String> = widths.iter().map(|&width| "-".repeat(width)).collect();
        let rows = self.rows.iter().map(|row| line(row));
        let head = [line(&self.header), rule.join("  ")];
        let notes = (1..).zip(&self.footnotes).map(|(number, note)| format!("({number}) {note}."));
        let lines: Vec<String> = head.into_iter().chain(rows).chain(notes).collect();
        lines.join("\n")
    }

    /// Returns the table in HTML, in a box that scrolls on narrow screens. Columns of numbers are
    /// aligned to the right.
    pub fn html(&self) -> String {
        let numeric: Vec<bool> = (0..self.header.len())
            .map(|column| self.rows.iter().all(|row| is_figure(&row[column])))
            .collect();
        let line = |tag: &str, cells: &[String]| {
            let cells = cells.iter().zip(&numeric).map(|(cell, numeric)| {
                let class = if *numeric { " class=\"figure\"" } else { "" };
                let scope = if tag == "th" { " scope=\"col\"" } else { "" };
                format!("<{tag}{scope}{class}>{}</{tag}>", cell_html(cell))
            });
            format!("<tr>{}</tr>\n", cells.collect::<String>())
        };
        let rows = self.rows.iter().map(|row| line("td", row));
        let note = |(number, note): (usize, &String)| {
            format!("<p class=\"note\">({number}) {}.</p>\n", code_html(note))
        };
        let notes = (1..).zip(&self.footnotes).map(note);
        format!(
            "<figure class=\"scroll\" tabindex=\"0\">\n<figcaption>{}</figcaption>\n\
             <table class=\"sortable\">\n<thead>\n{}</thead>\n<tbody>\n{}</tbody>\n</table>\n\
             {}</figure>\n",
            code_html(&self.caption),
            line("th", &self.header),
            rows.collect::<String>(),
            notes.collect::<String>()
        )
    }

    /// Returns the table's rows as CSV (RFC 4180), the header first, without caption and footnotes.
    /// All cells are quoted.
    pub fn csv(&self) -> String {
        let quoted = |cell: &String| format!("\"{}\"", cell.replace('"', "\"\""));
        let line = |cells: &Vec<String>| cells.iter().map(quoted).collect::<Vec<_>>().join(",");
        let rows = std::iter::once(&self.header).chain(&self.rows);
        rows.map(|row| line(row) + "\r\n").collect()
    }

    /// Returns the table as a LaTeX `tabular` with the rules of `booktabs`, and caption and
    /// footnotes as comments.
    pub fn latex(&self) -> String {
        let line = |cells: &Vec<String>| {
            let cells: Vec<String> = cells.iter().map(|cell| latex(cell)).collect();
            format!("{} \\\\\n", cells.join(" & "))
        };
        let columns = "l".repeat(self.header.len());
        let rows: String = self.rows.iter().map(line).collect();
        let header = line(&self.header);
        let numbered = (1..).zip(&self.footnotes);
        let notes: String = numbered.map(|(n, note)| format!("% ({n}) {note}.\n")).collect();
        format!(
            "% {}\n{notes}\\begin{{tabular}}{{{columns}}}\n\\toprule\n{header}\\midrule\n{rows}\\bottomrule\n\\end{{tabular}}\n",
            self.caption
        )
    }
}

/// Returns `true` for a cell that begins with a number, or stands for one that is missing.
fn is_figure(cell: &str) -> bool {
    let digits = cell.trim_start_matches(['(', '[', '<', '+', '-', ' ']);
    digits.starts_with(|first: char| first.is_ascii_digit()) || matches!(cell, "-" | "never")
}

/// Returns a cell as HTML: an interval in brackets goes to a second line.
fn cell_html(cell: &str) -> String {
    let parts =
        cell.split_once(" [").and_then(|(value, rest)| Some((value, rest.split_once(']')?)));
    match parts {
        Some((value, (interval, rest))) => format!(
            "{}{} <small>[{}]</small>",
            code_html(value),
            code_html(rest),
            escape_xml(interval)
        ),
        None => code_html(cell),
    }
}

/// Returns text as HTML, with words between backticks as code.
pub(super) fn code_html(text: &str) -> String {
    let parts = text.split('`').enumerate().map(|(number, part)| {
        let part = escape_xml(part);
        if number % 2 == 1 { format!("<code>{part}</code>") } else { part }
    });
    parts.collect()
}

/// Wraps text at [`COLUMNS`] characters. A longer word gets a line of its own.
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

/// Escapes the special characters of LaTeX.
fn latex(text: &str) -> String {
    let mut escaped = String::with_capacity(text.len());
    for character in text.chars() {
        match character {
            '&' | '%' | '$' | '#' | '_' | '{' | '}' => escaped.extend(['\\', character]),
            '\\' => escaped.push_str("\\textbackslash{}"),
            '~' => escaped.push_str("\\textasciitilde{}"),
            '^' => escaped.push_str("\\textasciicircum{}"),
            _ => escaped.push(character),
        }
    }
    escaped
}

#[cfg(test)]
mod tests {
    use super::*;

    fn table() -> ReportTable {
        let mut table = ReportTable::new("Two figures.", &["method", "success"]);
        let mark = table.add_footnote("one policy");
        assert_eq!(table.add_footnote("one policy"), mark);
        table.rows.push(vec!["a_b, \"c\"".to_owned(), format!("5 % {mark}")]);
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
        let row = "<tr><td>a_b, &quot;c&quot;</td><td class=\"figure\">5 % (1)</td></tr>";
        assert!(text.contains(row), "{text}");
        assert!(text.contains("(1) one policy.</p>"), "{text}");
        let interval = "0.50 / 3 <small>[0.1, 1.0]</small>";
        assert_eq!(cell_html("0.50 [0.1, 1.0] / 3"), interval);
        assert_eq!(code_html("no `a<b` there"), "no <code>a&lt;b</code> there");
    }

    #[test]
    fn latex_characters_are_escaped() {
        let text = table().latex();
        assert!(text.contains("a\\_b, \"c\" & 5 \\% (1) \\\\\n"), "{text}");
        assert!(text.contains("\\begin{tabular}{ll}"));
    }
}
