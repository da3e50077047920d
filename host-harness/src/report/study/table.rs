//! A table of text, as HTML and as Markdown.

use std::fmt::Write as _;

/// Cell of a value that was measured and does not exist.
pub const NONE: &str = "-";

/// A table with a row of headings. The first column holds names, the others names or numbers.
#[derive(Debug, Clone, Default, PartialEq, Eq)]
pub struct Table {
    /// Title above the table.
    pub title: String,
    /// Explains the columns and what was measured.
    pub caption: String,
    /// Headings of the columns.
    pub head: Vec<String>,
    /// Cells row by row, one per heading.
    pub rows: Vec<Vec<String>>,
}

impl Table {
    /// Makes a table without rows.
    #[must_use]
    pub fn new(title: &str, caption: &str, head: &[&str]) -> Self {
        Self {
            title: title.to_owned(),
            caption: caption.to_owned(),
            head: head.iter().map(|cell| (*cell).to_owned()).collect(),
            rows: Vec::new(),
        }
    }

    /// Returns whether a column holds names, which are aligned to the left.
    fn is_text(&self, column: usize) -> bool {
        let is_number = |cell: &str| {
            ["n/a", NONE].contains(&cell) || cell.trim_matches('*').parse::<f64>().is_ok()
        };
        let mut cells = self.rows.iter().filter_map(|row| row.get(column));
        column == 0 || cells.any(|cell| !is_number(cell))
    }

    /// Formats the table as HTML, in a box that scrolls if it is too wide. Cells between asterisks are bold.
    #[must_use]
    pub fn html(&self) -> String {
        let mut html = format!(
            "<section><h3>{}</h3>\n<p>{}</p>\n<div class=\"wide\"><table>\n<thead><tr>",
            escape(&self.title),
            escape(&self.caption)
        );
        let class: Vec<&str> = (0..self.head.len())
            .map(|column| {
                if self.is_text(column) {
                    " class=\"text\""
                } else {
                    ""
                }
            })
            .collect();
        for (cell, class) in self.head.iter().zip(&class) {
            let _ = write!(html, "<th scope=\"col\"{class}>{}</th>", escape(cell));
        }
        html += "</tr></thead>\n<tbody>\n";
        for row in &self.rows {
            html += "<tr>";
            for (column, (cell, class)) in row.iter().zip(&class).enumerate() {
                let bold = cell
                    .strip_prefix("**")
                    .and_then(|cell| cell.strip_suffix("**"));
                let cell = bold.map_or_else(
                    || escape(cell),
                    |cell| format!("<strong>{}</strong>", escape(cell)),
                );
                let _ = if column == 0 {
                    write!(html, "<th scope=\"row\"{class}>{cell}</th>")
                } else {
                    write!(html, "<td{class}>{cell}</td>")
                };
            }
            html += "</tr>\n";
        }
        html + "</tbody></table></div></section>\n"
    }

    /// Formats the table as Markdown, without title and caption.
    #[must_use]
    pub fn markdown(&self) -> String {
        let line = |cells: &[String]| format!("| {} |\n", cells.join(" | "));
        let rule = format!("|{}\n", "---|".repeat(self.head.len()));
        let rows: String = self.rows.iter().map(|row| line(row)).collect();
        line(&self.head) + &rule + &rows
    }
}

/// Escapes text for HTML.
#[must_use]
pub fn escape(text: &str) -> String {
    text.replace('&', "&amp;")
        .replace('<', "&lt;")
        .replace('>', "&gt;")
        .replace('"', "&quot;")
}

#[cfg(test)]
mod tests {
    use super::*;

    #[test]
    fn both_forms_have_every_cell() {
        let mut table = Table::new("T < 1", "of & for", &["name", "x", "kind"]);
        let row = |cells: [&str; 3]| cells.map(str::to_owned).to_vec();
        table.rows.push(row(["a\"b", "**1**", "2"]));
        table.rows.push(row(["c", "n/a", "odd"]));
        assert_eq!(
            table.markdown(),
            "| name | x | kind |\n|---|---|---|\n| a\"b | **1** | 2 |\n| c | n/a | odd |\n"
        );
        let html = table.html();
        for part in [
            "<h3>T &lt; 1</h3>",
            "<p>of &amp; for</p>",
            "<th scope=\"col\">x</th>",
            "<th scope=\"row\" class=\"text\">a&quot;b</th><td><strong>1</strong></td><td class=\"text\">2</td>",
            "<td>n/a</td><td class=\"text\">odd</td>",
        ] {
            assert!(html.contains(part), "{part}: {html}");
        }
    }
}
